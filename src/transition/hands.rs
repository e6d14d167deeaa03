//! Hands that differ in nothing that matters, and pairs of holds in which two of them fit around
//! one object.

use std::collections::BTreeMap;

use crate::collision::CollisionWorld;
use crate::geometry::Pose;
use crate::problem::Problem;
use crate::workcell::ArmId;

use super::contacts::same_hand;

/// Relative poses are told apart down to this (m, and unit of quaternion).
const GRAIN: f64 = 1.0e-9;

/// Two kinds of hands and where the second's TCP is in the first's frame, in grains.
type Key = (usize, usize, [i64; 7]);

/// The kinds of hands in a workcell, with a memory of which relative poses of two hands are free
/// of contact between them.
#[derive(Debug, Clone)]
pub struct Hands<'a> {
    world: &'a CollisionWorld,
    /// By arm, the first arm with an equal hand.
    kinds: Vec<usize>,
    apart: BTreeMap<Key, bool>,
}

impl<'a> Hands<'a> {
    /// The hands of the problem's arms.
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld) -> Self {
        let count = problem.workcell.arms.len();
        let first =
            |arm: usize| (0..arm).find(|&other| same_hand(problem, ArmId(other), ArmId(arm))).unwrap_or(arm);
        Self { world, kinds: (0..count).map(first).collect(), apart: BTreeMap::new() }
    }

    /// The kind of the arm's hand.
    pub(super) fn kind(&self, arm: ArmId) -> usize {
        self.kinds.get(arm.0).copied().unwrap_or(arm.0)
    }

    /// Whether the hands are clear of each other when both arms hold one object in the given ways
    /// (its frame in their TCP frames): this depends on nothing else.
    pub(super) fn fit(&mut self, giver: (ArmId, &Pose), receiver: (ArmId, &Pose)) -> bool {
        let between = giver.1 * receiver.1.inverse();
        let (t, mut r) = (between.translation.vector, between.rotation.coords);
        // A quaternion and its negative are one rotation.
        if let Some(first) = r.iter().find(|c| c.abs() > 0.1)
            && *first < 0.0
        {
            r = -r;
        }
        let grains = [t.x, t.y, t.z, r.x, r.y, r.z, r.w].map(|c| (c / GRAIN).round() as i64);
        let key = (self.kind(giver.0), self.kind(receiver.0), grains);
        let world = self.world;
        *self.apart.entry(key).or_insert_with(|| world.hands_apart(giver.0, receiver.0, &between))
    }
}
