//! Grounded picks and places: one arm, one object, one pose.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::collision::{CollisionWorld, Exemption, Held, Scene, StraightMotion};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::line::Line;

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

/// Objects farther away (m) than this are in nobody's way while one is picked or placed.
const NEIGHBOURHOOD: f64 = 0.6;

/// A cache key: kind, arm, class, pose and hold to the bit.
type Key = (ContactKind, usize, usize, [u64; 7], [u64; 7]);

/// Samples contacts, and remembers them.
#[derive(Debug, Clone)]
pub struct Contacts<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    rng: Rng,
    known: BTreeMap<Key, Arc<Vec<Contact>>>,
}

impl<'a> Contacts<'a> {
    /// A sampler that draws from `rng`.
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, rng: Rng) -> Self {
        Self { problem, world, rng, known: BTreeMap::new() }
    }

    /// The same knowledge, drawing from another stream from now on.
    pub fn with_rng(mut self, rng: Rng) -> Self {
        self.rng = rng;
        self
    }

    /// Contacts that hold the object at `object_in_tcp`: at most the problem's `ik_solutions`,
    /// sampled once and then remembered. Empty when none is found.
    pub fn at(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> Arc<Vec<Contact>> {
        let key = self.key(query, object_in_tcp);
        if let Some(known) = self.known.get(&key) {
            return known.clone();
        }
        let found = Arc::new(self.sample(query, object_in_tcp));
        self.known.insert(key, found.clone());
        found
    }

    /// Samples once more and adds what is found to what is remembered; whether there was any.
    pub fn more(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> bool {
        let fresh = self.sample(query, object_in_tcp);
        if fresh.is_empty() {
            return false;
        }
        let key = self.key(query, object_in_tcp);
        let known = self.known.entry(key).or_default();
        let mut all = known.as_ref().clone();
        all.extend(fresh);
        // The oldest go first, so that a long run keeps sampling densely in bounded memory.
        let most = 8 * self.problem.options.ik_solutions.max(1);
        if all.len() > most {
            all.drain(..all.len() - most);
        }
        *known = Arc::new(all);
        true
    }

    /// The holds (grasp number and object frame in the TCP frame) by which the contact can be had.
    pub fn holds(&mut self, query: &ContactQuery) -> Vec<(usize, Pose)> {
        let problem = self.problem;
        let opening = problem.workcell.arms[query.arm.0].tool.max_opening;
        let grasps = &problem.objects[query.object.0].grasps;
        grasps
            .iter()
            .enumerate()
            .filter(|(_, grasp)| grasp.fits(opening))
            .map(|(number, grasp)| (number, grasp.object_in_tcp))
            .filter(|(_, hold)| !self.at(query, hold).is_empty())
            .collect()
    }

    /// Whether a contact and its lines are clear of the other objects at rest in `scene` (the
    /// object itself may be among them).
    pub fn is_clear(&self, query: &ContactQuery, contact: &Contact, scene: &Scene) -> bool {
        let near =
            |pose: &Pose| (pose.translation.vector - query.pose.translation.vector).norm() < NEIGHBOURHOOD;
        let others: Vec<(ObjectId, Pose)> =
            scene.resting.iter().filter(|(id, pose)| *id != query.object && near(pose)).copied().collect();
        if others.is_empty() {
            return true;
        }
        let surface = &self.problem.workcell.surfaces[query.surface.0];
        let touching = Exemption { hand_with: Some(query.object), held_with: surface.carrier };
        let held = Held { object: query.object, object_in_tcp: contact.object_in_tcp };
        let around = self.world.resting_atoms(&Scene { resting: others });
        let (holding, without) = match query.kind {
            ContactKind::Pick => (&contact.retreat, &contact.approach),
            ContactKind::Place => (&contact.approach, &contact.retreat),
        };
        let along = |line: &Line, held: Option<&Held>| {
            line.waypoints.windows(2).all(|pair| {
                let motion = StraightMotion::new(&pair[0], &pair[1]);
                self.world.static_free(query.arm, &motion, held, &around, touching)
            })
        };
        along(holding, Some(&held)) && along(without, None)
    }

    /// [`Self::holds`] for which some known contact is clear of the objects in `scene`.
    pub fn clear_holds(&mut self, query: &ContactQuery, scene: &Scene) -> Vec<(usize, Pose)> {
        let mut holds = self.holds(query);
        holds.retain(|(_, hold)| {
            let known = self.at(query, hold);
            known.iter().any(|contact| self.is_clear(query, contact, scene))
        });
        holds
    }

    /// Whether the contact can be had by any grasp.
    pub fn any(&mut self, query: &ContactQuery) -> bool {
        let problem = self.problem;
        problem.objects[query.object.0]
            .grasps
            .iter()
            .any(|grasp| !self.at(query, &grasp.object_in_tcp).is_empty())
    }

    fn key(&self, query: &ContactQuery, object_in_tcp: &Pose) -> Key {
        let class = self.problem.objects[query.object.0].class;
        (query.kind, query.arm.0, class, pose_bits(&query.pose), pose_bits(object_in_tcp))
    }

    fn sample(&mut self, query: &ContactQuery, object_in_tcp: &Pose) -> Vec<Contact> {
        let most = self.problem.options.ik_solutions.max(1);
        let workcell = &self.problem.workcell;
        let arm = &workcell.arms[query.arm.0];
        let surface = &workcell.surfaces[query.surface.0];
        let object = &self.problem.objects[query.object.0];
        let tcp = query.pose * object_in_tcp.inverse();
        let mount = arm.base.inverse() * tcp * arm.tool.tcp.inverse();
        let mut solutions = Vec::new();
        arm.model.inverse(&arm.limits, &mount, 3 * most, &mut self.rng, &mut solutions);
        let own_z = tcp.rotation * Vec3::z();
        let (approach_direction, retreat_direction) = match query.kind {
            ContactKind::Pick => (-own_z, surface.normal()),
            ContactKind::Place => (surface.normal(), -own_z),
        };
        let held = Held { object: query.object, object_in_tcp: *object_in_tcp };
        let empty = Scene::default();
        let alone = Scene { resting: vec![(query.object, query.pose)] };
        let touching = Exemption { hand_with: Some(query.object), held_with: surface.carrier };
        let mut contacts = Vec::new();
        for q in solutions {
            if contacts.len() >= most {
                break;
            }
            let free = self.world.config_free(query.arm, &q, Some(&held), &empty, touching)
                && self.world.config_free(query.arm, &q, None, &alone, touching);
            if !free {
                continue;
            }
            let Some(approach) = Line::follow(arm, &q, &approach_direction, object.approach) else {
                continue;
            };
            let Some(retreat) = Line::follow(arm, &q, &retreat_direction, object.retreat) else { continue };
            let (holding, without) = match query.kind {
                ContactKind::Pick => (&retreat, &approach),
                ContactKind::Place => (&approach, &retreat),
            };
            let along = |line: &Line, held: Option<&Held>, scene: &Scene| {
                let edges: Vec<(&[f64], &[f64])> =
                    line.waypoints.windows(2).map(|pair| (&pair[0][..], &pair[1][..])).collect();
                self.world.edges_free(query.arm, &edges, held, scene, touching).into_iter().all(|free| free)
            };
            if along(holding, Some(&held), &empty) && along(without, None, &alone) {
                contacts.push(Contact { object_in_tcp: *object_in_tcp, q, approach, retreat });
            }
        }
        contacts
    }
}

/// A pose's numbers to the bit, as a key.
fn pose_bits(pose: &Pose) -> [u64; 7] {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(f64::to_bits)
}
