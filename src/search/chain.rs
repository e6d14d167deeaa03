//! Chains: how one object travels from where it is to its next place of rest, hand by hand, with
//! grasps that fit together all the way.
//!
//! A pick's grasp must suit the handoff that follows, and that one's the place at the end; so the
//! chain is grounded backwards from the place, before the pick is made.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{CollisionWorld, Scene};
use crate::geometry::Pose;
use crate::guidance::NodeId;
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::transition::{ContactKind, ContactQuery, Contacts, HandoffContact, HandoffQuery, travel_time};
use crate::workcell::{ArmId, ObjectId, SurfaceId, Symmetry};

use super::tree::Whereabouts;

/// A grasp number and the object's frame in the TCP frame.
type Hold = (usize, Pose);

/// One object's way to its next place of rest.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    /// The arms that carry it, and how.
    pub(super) carriers: Vec<(ArmId, Pose)>,
    /// The handoffs between them.
    pub(super) handoffs: Vec<HandoffContact>,
    /// Where it is put down.
    pub(super) target: (Pose, SurfaceId),
    /// The node of the mode graph there, and the one that the guide wanted.
    pub(super) node: NodeId,
    pub(super) wanted: NodeId,
}

/// What a chain is asked for.
pub(super) struct ChainRequest<'a> {
    pub(super) object: ObjectId,
    pub(super) from: &'a Whereabouts,
    /// The arms on the way, first to last; the one that holds it now included.
    pub(super) arms: &'a [ArmId],
    /// Where it may be put down, in order of preference.
    pub(super) targets: &'a [(Pose, SurfaceId)],
    /// Where each arm is now.
    pub(super) arms_at: &'a [Config],
    /// The other objects at rest when it is put down, as far as known.
    pub(super) scene: &'a Scene,
    /// The node of the targets, and the one that the guide wants.
    pub(super) node: NodeId,
    pub(super) wanted: NodeId,
}

/// Grounds chains.
pub(super) struct ChainPlanner<'p, 'a> {
    pub(super) problem: &'a Problem,
    pub(super) world: &'a CollisionWorld,
    pub(super) contacts: &'p mut Contacts<'a>,
    pub(super) rng: &'p mut Rng,
    pub(super) handoff_tries: usize,
}

impl ChainPlanner<'_, '_> {
    /// A chain for the request, or `None` when none was found this time.
    pub(super) fn plan(&mut self, request: &ChainRequest<'_>) -> Option<Chain> {
        let (&first, &last) = (request.arms.first()?, request.arms.last()?);
        let target = self.choose_target(request, last)?;
        let place = |arm| query(ContactKind::Place, arm, request.object, target);
        let start: Vec<Hold> = match request.from {
            Whereabouts::Resting { pose, surface } => {
                let pick = query(ContactKind::Pick, first, request.object, (*pose, *surface));
                let clear = self.contacts.clear_holds(&pick, request.scene);
                // What is in the way now may have gone by then.
                if clear.is_empty() { self.contacts.holds(&pick) } else { clear }
            }
            Whereabouts::Held { object_in_tcp, .. } => vec![(usize::MAX, *object_in_tcp)],
        };
        if start.is_empty() {
            return None;
        }
        if request.arms.len() == 1 {
            let fitting: Vec<Hold> =
                start.into_iter().filter(|(_, hold)| self.contacts.has(&place(first), hold)).collect();
            let hold = self.cheapest_hold(request, first, &target, &fitting)?;
            let (node, wanted) = (request.node, request.wanted);
            return Some(Chain { carriers: vec![(first, hold)], handoffs: Vec::new(), target, node, wanted });
        }
        let mut receiver_holds = self.contacts.clear_holds(&place(last), request.scene);
        if receiver_holds.is_empty() {
            receiver_holds = self.contacts.holds(&place(last));
        }
        let mut carriers = Vec::new();
        let mut handoffs = Vec::new();
        for hop in (0..request.arms.len() - 1).rev() {
            let (giver, receiver) = (request.arms[hop], request.arms[hop + 1]);
            let any = if hop == 0 { Vec::new() } else { self.grasps_of(request.object, giver) };
            let giver_holds = if hop == 0 { &start } else { &any };
            let giver_near = self.near(request, giver, hop == 0, &target, false);
            let receiver_near = self.near(request, receiver, false, &target, hop + 2 == request.arms.len());
            let asked = HandoffQuery {
                giver,
                receiver,
                object: request.object,
                giver_holds,
                receiver_holds: &receiver_holds,
                giver_near: &giver_near,
                receiver_near: &receiver_near,
            };
            let found = self.contacts.handoffs(&asked, self.handoff_tries, 4, self.rng);
            let chosen =
                if self.rng.random_bool(0.7) { found.first() } else { found.choose(self.rng) }?.clone();
            receiver_holds = vec![(usize::MAX, chosen.giver_hold)];
            carriers.push((receiver, chosen.receiver_hold));
            if hop == 0 {
                carriers.push((giver, chosen.giver_hold));
            }
            handoffs.push(chosen);
        }
        carriers.reverse();
        handoffs.reverse();
        Some(Chain { carriers, handoffs, target, node: request.node, wanted: request.wanted })
    }

    /// Every grasp of `object` that fits the arm's gripper.
    fn grasps_of(&self, object: ObjectId, arm: ArmId) -> Vec<Hold> {
        let opening = self.problem.workcell.arms[arm.0].tool.max_opening;
        let grasps = self.problem.objects[object.0].grasps.iter().enumerate();
        grasps
            .filter(|(_, grasp)| grasp.fits(opening))
            .map(|(number, grasp)| (number, grasp.object_in_tcp))
            .collect()
    }

    /// The first target (up to symmetry) that is free and that the last arm can serve.
    fn choose_target(&mut self, request: &ChainRequest<'_>, last: ArmId) -> Option<(Pose, SurfaceId)> {
        let surfaces = &self.problem.workcell.surfaces;
        let several = request.targets.len() > 1;
        let mut order: Vec<usize> = (0..request.targets.len()).collect();
        if several && self.rng.random_bool(0.5) {
            let turn = self.rng.random_range(0..order.len());
            order.rotate_left(turn);
        }
        for index in order {
            let (pose, surface) = request.targets[index];
            let pose = if several { pose } else { self.turned(request.object, pose) };
            let carrier = surfaces.get(surface.0).and_then(|s| s.carrier);
            if several && !self.world.placement_free(request.object, &pose, carrier, request.scene) {
                continue;
            }
            if self.contacts.any(&query(ContactKind::Place, last, request.object, (pose, surface))) {
                return Some((pose, surface));
            }
        }
        None
    }

    /// A pose that is the same up to the object's symmetry.
    fn turned(&mut self, object: ObjectId, pose: Pose) -> Pose {
        let model = &self.problem.objects[object.0];
        let turn = match model.symmetry {
            Symmetry::CylinderZ | Symmetry::Sphere => nalgebra::UnitQuaternion::from_axis_angle(
                &crate::geometry::Vec3::z_axis(),
                self.rng.random_range(0.0..std::f64::consts::TAU),
            ),
            _ => match model.symmetry_rotations.choose(self.rng) {
                Some(rotation) => *rotation,
                None => return pose,
            },
        };
        pose * turn
    }

    /// Configurations near which an arm will be before or after a handoff.
    fn near(
        &mut self,
        request: &ChainRequest<'_>,
        arm: ArmId,
        picks: bool,
        target: &(Pose, SurfaceId),
        places: bool,
    ) -> Vec<Config> {
        let mut near: Vec<Config> = request.arms_at.get(arm.0).cloned().into_iter().collect();
        let mut contact = |kind, at: (Pose, SurfaceId)| {
            let asked = query(kind, arm, request.object, at);
            let holds = self.contacts.holds(&asked);
            let (_, hold) = holds.choose(self.rng)?;
            self.contacts.at(&asked, hold).choose(self.rng).map(|contact| contact.q.clone())
        };
        if picks && let Whereabouts::Resting { pose, surface } = request.from {
            near.extend(contact(ContactKind::Pick, (*pose, *surface)));
        }
        if places {
            near.extend(contact(ContactKind::Place, *target));
        }
        near
    }

    /// Of the holds that suit pick and place by one arm the one with the least travel, or now and
    /// then any.
    fn cheapest_hold(
        &mut self,
        request: &ChainRequest<'_>,
        arm: ArmId,
        target: &(Pose, SurfaceId),
        holds: &[Hold],
    ) -> Option<Pose> {
        if self.rng.random_bool(0.3) {
            return holds.choose(self.rng).map(|(_, hold)| *hold);
        }
        let model = &self.problem.workcell.arms[arm.0];
        let place = query(ContactKind::Place, arm, request.object, *target);
        let mut best: Option<(f64, Pose)> = None;
        for (_, hold) in holds {
            let places = self.contacts.at(&place, hold);
            let picks: Vec<Config> = match request.from {
                Whereabouts::Resting { pose, surface } => {
                    let pick = query(ContactKind::Pick, arm, request.object, (*pose, *surface));
                    self.contacts.at(&pick, hold).iter().map(|c| c.q.clone()).collect()
                }
                Whereabouts::Held { .. } => request.arms_at.get(arm.0).cloned().into_iter().collect(),
            };
            for pick in &picks {
                let before = request.arms_at.get(arm.0).map_or(0.0, |now| travel_time(model, now, pick));
                for contact in places.iter() {
                    let cost = before + travel_time(model, pick, &contact.q);
                    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, *hold));
                    }
                }
            }
        }
        best.map(|(_, hold)| hold)
    }
}

/// A contact query.
pub(super) fn query(kind: ContactKind, arm: ArmId, object: ObjectId, at: (Pose, SurfaceId)) -> ContactQuery {
    ContactQuery { kind, arm, object, pose: at.0, surface: at.1 }
}
