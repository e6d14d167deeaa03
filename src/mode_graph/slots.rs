//! Start and goal poses as slots, and which of them exclude each other.

use crate::geometry::{ExactShape, Pose, Vec3};
use crate::problem::{ContactPartner, GoalPlacement, InitialPlacement, Problem};
use crate::workcell::{ObjectId, ObjectModel, Surface, Symmetry, rests_on};

use super::graph::Slot;

/// Two poses of one class closer than this (m, rad) are one slot.
const SAME_SLOT: (f64, f64) = (1.0e-4, 1.0e-3);
/// Turns that stand for the infinitely many of a cylinder.
const TURNS: usize = 8;

/// The slots, and by object the number of its start slot and of its goal slot, where it has one.
#[derive(Debug, Default)]
pub(super) struct Slots {
    pub(super) slots: Vec<Slot>,
    pub(super) start: Vec<Option<usize>>,
    pub(super) goal: Vec<Option<usize>>,
}

impl Slots {
    /// The slots of `problem`: starts and goals, coinciding ones once.
    pub(super) fn new(problem: &Problem) -> Self {
        let mut out = Self::default();
        for (index, initial) in problem.initial.iter().enumerate() {
            let slot = match initial {
                InitialPlacement::Resting { pose, surface } => {
                    let class = problem.objects[index].class;
                    let start_of = Some(ObjectId(index));
                    out.slots.push(Slot { pose: *pose, surface: *surface, class, start_of, goal_of: None });
                    Some(out.slots.len() - 1)
                }
                InitialPlacement::Held { .. } => None,
            };
            out.start.push(slot);
        }
        for (index, goal) in problem.goal.iter().enumerate() {
            let GoalPlacement::Pose { pose, surface } = goal else {
                out.goal.push(None);
                continue;
            };
            let object = &problem.objects[index];
            let is_there =
                |slot: &Slot| slot.start_of == Some(ObjectId(index)) && object.is_at_goal(&slot.pose, pose);
            let same = out.slots.iter().position(|slot| {
                slot.class == object.class
                    && slot.surface == *surface
                    && slot.goal_of.is_none()
                    && (object.is_within(&slot.pose, pose, SAME_SLOT) || is_there(slot))
            });
            let number = same.unwrap_or_else(|| {
                let class = object.class;
                out.slots.push(Slot { pose: *pose, surface: *surface, class, start_of: None, goal_of: None });
                out.slots.len() - 1
            });
            out.slots[number].goal_of = Some(ObjectId(index));
            out.goal.push(Some(number));
        }
        out
    }

    /// Pairs of slots (ascending) that cannot both be occupied: the objects there come closer
    /// than `clearance` (m, negative for overlap). With `certain_only`, pairs of which one stands
    /// for poses in which its object takes other room are left out.
    pub(super) fn overlaps(
        &self,
        problem: &Problem,
        clearance: f64,
        certain_only: bool,
    ) -> Vec<(usize, usize)> {
        let mut exact: Vec<Option<Vec<ExactShape>>> =
            vec![None; 1 + self.slots.iter().map(|s| s.class).max().unwrap_or(0)];
        for object in &problem.objects {
            if let Some(shapes) = exact.get_mut(object.class)
                && shapes.is_none()
            {
                *shapes = Some(object.shapes.iter().map(ExactShape::new).collect());
            }
        }
        let shapes_of = |slot: &Slot| exact[slot.class].as_deref().unwrap_or_default();
        let is_vague = |slot: &Slot| {
            slot.goal_of.map(|o| &problem.objects[o.0]).is_some_and(|object| {
                matches!(object.symmetry, Symmetry::CylinderZ | Symmetry::Sphere)
                    || object.only_counts_as_box()
            })
        };
        let vague: Vec<bool> = self.slots.iter().map(|slot| certain_only && is_vague(slot)).collect();
        let mut pairs = Vec::new();
        for (a, first) in self.slots.iter().enumerate() {
            for (b, second) in self.slots.iter().enumerate().skip(a + 1) {
                if vague[a] || vague[b] {
                    continue;
                }
                let near = shapes_of(first).iter().any(|x| {
                    shapes_of(second).iter().any(|y| {
                        x.ball_distance(&first.pose, y, &second.pose) < clearance.max(0.0)
                            && x.signed_distance(&first.pose, y, &second.pose, clearance.max(0.0) + 1e-3)
                                < clearance
                    })
                });
                if near && !may_share(problem, first, second) {
                    pairs.push((a, b));
                }
            }
        }
        pairs
    }
}

/// Whether any two objects that may come to the two slots may touch for good.
fn may_share(problem: &Problem, a: &Slot, b: &Slot) -> bool {
    let members = |class: usize| {
        let all = problem.objects.iter().enumerate().filter(move |(_, object)| object.class == class);
        all.map(|(index, _)| ObjectId(index))
    };
    members(a.class)
        .all(|x| members(b.class).all(|y| x == y || problem.may_touch(x, ContactPartner::Object(y))))
}

/// The poses that meet a goal `pose` for `object`: that pose, then what its symmetry makes of it.
pub(super) fn symmetric_poses(object: &ObjectModel, pose: &Pose) -> Vec<Pose> {
    let mut poses: Vec<Pose> = object.symmetry_rotations.iter().map(|rotation| pose * rotation).collect();
    if matches!(object.symmetry, Symmetry::CylinderZ | Symmetry::Sphere) {
        poses.clear();
        let flip = nalgebra::UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
        for side in [nalgebra::UnitQuaternion::identity(), flip] {
            for turn in 0..TURNS {
                let angle = std::f64::consts::TAU * turn as f64 / TURNS as f64;
                poses.push(pose * nalgebra::UnitQuaternion::from_axis_angle(&Vec3::z_axis(), angle) * side);
            }
        }
    }
    poses
}

/// Those of [`symmetric_poses`] in which `object` is put down on `surface`: not what stands for the box
/// around it there, and topples. The given one stays.
pub(super) fn resting_poses(object: &ObjectModel, pose: &Pose, surface: &Surface) -> Vec<Pose> {
    let mut poses = symmetric_poses(object, pose);
    if object.only_counts_as_box() {
        poses.retain(|other| other == pose || rests_on(&object.shapes, other, surface).is_ok());
    }
    poses
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::{ConvexHull, PlacedShape, Shape};
    use crate::workcell::symmetry_rotations;

    fn object(shape: Shape) -> ObjectModel {
        let shapes = vec![PlacedShape { shape, pose: Pose::identity() }];
        ObjectModel {
            id: "it".to_owned(),
            symmetry: Symmetry::Box,
            symmetry_rotations: symmetry_rotations(Symmetry::Box, &shapes).unwrap(),
            shapes,
            mass: 0.1,
            grasps: Vec::new(),
            approach: 0.08,
            retreat: 0.08,
            class: 0,
        }
    }

    #[test]
    fn what_counts_as_its_box_is_put_down_as_it_rests() {
        let surface = Surface {
            id: "top".to_owned(),
            carrier: None,
            pose: Pose::identity(),
            half_extents: [0.5, 0.5],
            capacity: None,
        };
        let pose = Pose::translation(0.1, 0.0, 0.03);
        let cube = object(Shape::Box { half_extents: Vec3::repeat(0.03) });
        assert!(!cube.only_counts_as_box());
        assert_eq!(resting_poses(&cube, &pose, &surface), symmetric_poses(&cube, &pose));
        // A wedge rests on its foot, its back and both its ends, four ways round each, and topples from its edges.
        let corners = [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [-1, 1, 1]];
        let points: Vec<Vec3> = corners.iter().map(|c| Vec3::from(c.map(|s| 0.03 * f64::from(s)))).collect();
        let wedge = object(Shape::Convex(Arc::new(ConvexHull::new(&points).unwrap())));
        assert!(wedge.only_counts_as_box());
        assert_eq!(symmetric_poses(&wedge, &pose).len(), 24);
        let resting = resting_poses(&wedge, &pose, &surface);
        assert_eq!(resting[0], pose);
        assert!(resting.iter().all(|pose| rests_on(&wedge.shapes, pose, &surface).is_ok()));
        assert_eq!(resting.len(), 16);
    }
}
