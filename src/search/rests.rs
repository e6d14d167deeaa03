//! Where objects rest at first and where they must end: places that hands must be able to reach, so that what is put down
//! somewhere in between is put down away from them.

use std::cmp::Reverse;

use crate::geometry::{Pose, Vec3};
use crate::problem::{InitialPlacement, Problem};
use crate::workcell::{ObjectId, SurfaceId};

use super::forecast::Neighbour;
use super::map::Map;

/// Room between two objects (m) with which neither is in the way of a hand at the other.
const AMPLE: f64 = 0.12;

/// Room is told apart in steps of this (m).
const GRAIN: f64 = 0.03;

/// The starts and goals of all objects.
#[derive(Debug)]
pub(super) struct Rests {
    places: Vec<(ObjectId, Vec3)>,
    /// By object, the radius (m) about its frame that encloses it.
    radii: Vec<f64>,
}

impl Rests {
    pub(super) fn of(problem: &Problem, map: &Map) -> Self {
        let starts = problem.initial.iter().enumerate().filter_map(|(object, placement)| match placement {
            InitialPlacement::Resting { pose, .. } => Some((ObjectId(object), pose.translation.vector)),
            InitialPlacement::Held { .. } => None,
        });
        let goals = map.graph().objects.iter().enumerate().filter_map(|(object, known)| {
            known.goal_poses.first().map(|pose| (ObjectId(object), pose.translation.vector))
        });
        let radii = problem.objects.iter().map(|object| object.bounding_radius()).collect();
        Self { places: starts.chain(goals).collect(), radii }
    }

    /// Sorts the `targets` of `object`: those first that leave the most room to where other objects start or
    /// end and to `others`, as far as more room is of use; else in their order.
    pub(super) fn roomiest_first(
        &self,
        object: ObjectId,
        others: &[Neighbour],
        targets: &mut [(Pose, SurfaceId)],
    ) {
        let foreign = self.places.iter().filter(|(owner, _)| *owner != object).copied();
        let others = others.iter().map(|other| (other.object, other.pose.translation.vector));
        let all: Vec<(ObjectId, Vec3)> = foreign.chain(others).collect();
        let radius = |object: ObjectId| self.radii.get(object.0).copied().unwrap_or(0.0);
        targets.sort_by_cached_key(|(pose, _)| {
            let room = |&(other, at): &(ObjectId, Vec3)| {
                (pose.translation.vector - at).norm() - radius(other) - radius(object)
            };
            let least = all.iter().map(room).fold(AMPLE, f64::min);
            Reverse((least / GRAIN).floor() as i64)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// No target comes before one with clearly more room, as far as that is of use; what leaves ample room keeps its
        /// order, and none is lost.
        #[test]
        fn more_room_comes_first(
            at in prop::collection::vec((-0.5..0.5_f64, -0.5..0.5_f64), 1..20),
            needed in prop::collection::vec((-0.5..0.5_f64, -0.5..0.5_f64), 0..6),
        ) {
            let radius = 0.05;
            let place = |&(x, y): &(f64, f64)| (ObjectId(1), Vec3::new(x, y, 0.7));
            // The object's own start and goal do not count.
            let own = (ObjectId(0), Vec3::new(0.0, 0.0, 0.7));
            let rests = Rests {
                places: needed.iter().map(place).chain([own]).collect(),
                radii: vec![radius, radius],
            };
            let pose = |&(x, y): &(f64, f64)| (Pose::translation(x, y, 0.7), SurfaceId(0));
            let before: Vec<(Pose, SurfaceId)> = at.iter().map(pose).collect();
            let mut after = before.clone();
            rests.roomiest_first(ObjectId(0), &[], &mut after);
            let room = |(pose, _): &(Pose, SurfaceId)| {
                let apart = needed.iter().map(|n| (pose.translation.vector - place(n).1).norm() - 2.0 * radius);
                apart.fold(f64::INFINITY, f64::min)
            };
            for pair in after.windows(2) {
                let (first, second) = (room(&pair[0]).min(AMPLE), room(&pair[1]).min(AMPLE));
                prop_assert!(second < first + GRAIN + 1e-9, "{first} before {second}");
            }
            let ample = |targets: &[(Pose, SurfaceId)]| {
                targets.iter().filter(|target| room(target) > AMPLE).copied().collect::<Vec<_>>()
            };
            prop_assert_eq!(ample(&before), ample(&after));
            prop_assert_eq!(before.len(), after.len());
            for target in &before {
                prop_assert!(after.contains(target));
            }
        }
    }
}
