//! Grounded picks and places: one arm, one object, one pose.

use crate::collision::{CollisionWorld, Exemption, Held, PathMotion, Scene};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::line::Line;

/// Unit vectors whose difference squared is less are one direction.
const SAME_DIRECTION: f64 = 1e-20;

/// Whether the object is taken or put down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ContactKind {
    /// The object is at rest and the arm takes it.
    Pick,
    /// The arm holds the object and puts it down.
    Place,
}

/// Which contact is asked for.
#[derive(Debug, Clone, Copy)]
pub struct ContactQuery {
    /// Pick or place.
    pub kind: ContactKind,
    /// The arm.
    pub arm: ArmId,
    /// The object.
    pub object: ObjectId,
    /// The object's frame in the world while it rests.
    pub pose: Pose,
    /// The surface under it.
    pub surface: SurfaceId,
}

/// An arm at an object's pose with one grasp, and its lines before and after.
#[derive(Debug, Clone)]
pub struct Contact {
    /// The object's frame in the TCP frame.
    pub object_in_tcp: Pose,
    /// The contact configuration.
    pub q: Config,
    /// The line before the contact, from the contact outwards.
    pub approach: Line,
    /// The line after it, from the contact outwards.
    pub retreat: Line,
}

impl Contact {
    /// The same backwards in time.
    pub(super) fn reversed(&self) -> Self {
        Self {
            object_in_tcp: self.object_in_tcp,
            q: self.q.clone(),
            approach: self.retreat.clone(),
            retreat: self.approach.clone(),
        }
    }
}

/// Makes contacts for one query and one hold, one at a time.
pub(super) struct Grounding<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    query: ContactQuery,
    held: Held,
    touching: Exemption,
    tcp: Pose,
}

impl<'a> Grounding<'a> {
    pub(super) fn new(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        query: &ContactQuery,
        object_in_tcp: &Pose,
    ) -> Self {
        let carrier = problem.workcell.surfaces[query.surface.0].carrier;
        Self {
            problem,
            world,
            query: *query,
            held: Held { object: query.object, object_in_tcp: *object_in_tcp },
            touching: Exemption { hand_with: Some(query.object), held_with: carrier },
            tcp: query.pose * object_in_tcp.inverse(),
        }
    }

    /// Of up to `most` configurations at the contact those at which arm and object are free.
    pub(super) fn configurations(&self, most: usize, rng: &mut Rng) -> Vec<Config> {
        let (held, empty) = (Some(&self.held), Scene::default());
        let targets = (&[self.tcp][..], most);
        let found = self.world.inverse_free(self.query.arm, targets, held, &empty, self.touching, rng);
        found.into_iter().flatten().collect()
    }

    /// Whether the arm can follow the lines from `q`, one of [`Self::configurations`].
    pub(super) fn seems_good(&self, q: &Config) -> bool {
        self.lines(q).is_some()
    }

    /// The directions (world) of the lines of approach and retreat, from the contact outwards.
    fn directions(&self) -> (Vec3, Vec3) {
        let own_z = self.tcp.rotation * Vec3::z();
        let normal = self.problem.workcell.surfaces[self.query.surface.0].normal();
        match self.query.kind {
            ContactKind::Pick => (-own_z, normal),
            ContactKind::Place => (normal, -own_z),
        }
    }

    /// Whether a line leads beyond what the arm can reach, so that there is no contact.
    pub(super) fn leads_beyond(&self) -> bool {
        let arm = &self.problem.workcell.arms[self.query.arm.0];
        let object = &self.problem.objects[self.query.object.0];
        let (approach, retreat) = self.directions();
        let (to_base, to_mount) = (arm.base.inverse(), arm.tool.tcp.inverse());
        [(approach, object.approach), (retreat, object.retreat)].into_iter().any(|(direction, distance)| {
            let mut far = self.tcp;
            far.translation.vector += direction * distance;
            arm.model.is_beyond(&arm.limits, &(to_base * far * to_mount))
        })
    }

    /// The lines of approach and retreat at `q`.
    fn lines(&self, q: &Config) -> Option<(Line, Line)> {
        let arm = &self.problem.workcell.arms[self.query.arm.0];
        let object = &self.problem.objects[self.query.object.0];
        let (approach_direction, retreat_direction) = self.directions();
        let approach = Line::follow(arm, q, &approach_direction, object.approach)?;
        // From above both are one line.
        let is_same = (approach_direction - retreat_direction).norm_squared() < SAME_DIRECTION;
        let retreat = match is_same && object.approach == object.retreat {
            true => approach.clone(),
            false => Line::follow(arm, q, &retreat_direction, object.retreat)?,
        };
        Some((approach, retreat))
    }

    /// The contact at `q`, one of [`Self::configurations`], with its lines, if arm and object are free of the static workcell and of
    /// each other on the whole way.
    pub(super) fn ground(&self, q: &Config) -> Option<Contact> {
        let (arm_id, held, touching) = (self.query.arm, &self.held, self.touching);
        let (approach, retreat) = self.lines(q)?;
        let empty = Scene::default();
        let (holding, without) = match self.query.kind {
            ContactKind::Pick => (&retreat, &approach),
            ContactKind::Place => (&approach, &retreat),
        };
        let along = |line: &Line, held: Option<&Held>, scene: &Scene| {
            self.world.motion_free(arm_id, &PathMotion::new(&line.waypoints), held, scene, touching)
        };
        let alone = Scene { resting: vec![(self.query.object, self.query.pose)] };
        let free = along(holding, Some(held), &empty) && along(without, None, &alone);
        free.then(|| Contact { object_in_tcp: held.object_in_tcp, q: q.clone(), approach, retreat })
    }
}
