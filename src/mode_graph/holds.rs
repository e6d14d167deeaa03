//! In which ways each arm may hold the objects of one class, and where from.

use crate::geometry::Pose;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::reach::{Hold, Reach, RestAction};

/// Placements at which one hold is looked for.
const MOST_SOURCES: usize = 12;

/// The holds in which one arm may come by objects of the class, or get rid of them, at rest.
#[derive(Debug, Clone, Default)]
pub(super) struct ArmHolds {
    /// Holds that it may have: those that `sources` may give, and those that are certain.
    pub(super) likely: Vec<Hold>,
    /// Holds that need no source: the object is in the hand at the start, or comes from another arm.
    certain: Vec<Hold>,
    /// Where it picks or places.
    sources: Vec<(ObjectId, Pose, SurfaceId)>,
}

impl ArmHolds {
    pub(super) fn is_empty(&self) -> bool {
        self.likely.is_empty()
    }

    /// Adds holds that need no source.
    pub(super) fn add_certain(&mut self, holds: &[Hold]) {
        merge(&mut self.certain, holds);
        merge(&mut self.likely, holds);
    }

    /// Adds what may be had of `object` at rest at each of `poses`.
    pub(super) fn add(&mut self, object: ObjectId, poses: &[Pose], surface: SurfaceId, likely: &[Hold]) {
        self.sources.extend(poses.iter().map(|&pose| (object, pose, surface)));
        merge(&mut self.likely, likely);
    }

    /// Whether `arm` really has `hold` at one of its sources; if not it is forgotten.
    pub(super) fn confirm(
        &mut self,
        reach: &mut dyn Reach,
        action: RestAction,
        arm: ArmId,
        hold: &Hold,
    ) -> bool {
        if self.certain.iter().any(|known| is_same(known, hold)) {
            return true;
        }
        // Of many sources a few, evenly spread.
        let stride = self.sources.len().div_ceil(MOST_SOURCES).max(1);
        let mut asked = self.sources.iter().step_by(stride);
        if asked.any(|(object, pose, surface)| reach.has_hold(action, arm, *object, pose, *surface, hold)) {
            self.certain.push(*hold);
            return true;
        }
        self.likely.retain(|known| !is_same(known, hold));
        false
    }
}

/// How each arm may hold an object of the class when it takes it off a surface, and when it puts
/// it on one.
#[derive(Debug, Clone)]
pub(super) struct RestHolds {
    /// By arm, from picks (or from the start, in the hand).
    pub(super) picked: Vec<ArmHolds>,
    /// By arm, for places.
    pub(super) placeable: Vec<ArmHolds>,
}

impl RestHolds {
    /// None, for `arms` arms.
    pub(super) fn none(arms: usize) -> Self {
        Self { picked: vec![ArmHolds::default(); arms], placeable: vec![ArmHolds::default(); arms] }
    }
}

/// Adds to `known` the holds of `found` that are not there yet.
pub(super) fn merge(known: &mut Vec<Hold>, found: &[Hold]) {
    for hold in found {
        if !known.iter().any(|other| is_same(other, hold)) {
            known.push(*hold);
        }
    }
}

/// Whether two holds of one class are the same.
pub(super) fn is_same(a: &Hold, b: &Hold) -> bool {
    match (a.grasp, b.grasp) {
        (Some(a), Some(b)) => a == b,
        _ => is_close(&a.object_in_tcp, &b.object_in_tcp),
    }
}

/// Whether two holds are one, but for rounding.
pub(super) fn is_close(a: &Pose, b: &Pose) -> bool {
    (a.translation.vector - b.translation.vector).norm() < 1e-6 && a.rotation.angle_to(&b.rotation) < 1e-5
}
