//! How objects of a class can stand on a surface.

use nalgebra::{Translation3, UnitQuaternion};
use std::f64::consts::FRAC_PI_2;

use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::problem::{GoalPlacement, InitialPlacement, Problem};
use crate::workcell::{ObjectId, Surface, rests_on};

use super::footprint::Footprint;

/// Two stances whose upward axes differ by less than this (rad) are one.
const SAME_STANCE: f64 = 1e-3;
/// A direction this close (rad) to a coordinate axis is that axis.
const SAME_AXIS: f64 = 1e-6;

/// A stable orientation, with the object's frame above the origin of a surface's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stance {
    /// The object's frame in the surface's frame.
    pub(super) pose: Pose,
}

impl Stance {
    /// The object on `surface` with its frame above `(x, y)`, turned by `yaw` about the normal.
    pub(super) fn on(&self, surface: &Surface, [x, y]: [f64; 2], yaw: f64) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vec3::z_axis(), yaw);
        surface.pose * Translation3::new(x, y, 0.0) * turn * self.pose
    }
}

/// The stances of the objects of `class`, those first in which they start or end; at most six.
pub(super) fn stances(problem: &Problem, class: usize) -> Vec<Stance> {
    let mut found: Vec<Stance> = Vec::new();
    let members = (0..problem.objects.len()).filter(|&index| problem.objects[index].class == class);
    let mut orientations = Vec::new();
    let mut shapes: &[PlacedShape] = &[];
    for index in members.map(ObjectId) {
        shapes = &problem.objects[index.0].shapes;
        if let InitialPlacement::Resting { pose, surface } = &problem.initial[index.0] {
            orientations.push(problem.workcell.surfaces[surface.0].pose.rotation.inverse() * pose.rotation);
        }
        if let GoalPlacement::Pose { pose, surface } = &problem.goal[index.0] {
            orientations.push(problem.workcell.surfaces[surface.0].pose.rotation.inverse() * pose.rotation);
        }
    }
    let quarter = |axis: Vec3, turns: f64| UnitQuaternion::from_scaled_axis(axis * (FRAC_PI_2 * turns));
    orientations.extend([
        UnitQuaternion::identity(),
        quarter(Vec3::x(), 1.0),
        quarter(Vec3::x(), 2.0),
        quarter(Vec3::x(), 3.0),
        quarter(Vec3::y(), 1.0),
        quarter(Vec3::y(), 3.0),
    ]);
    for orientation in orientations {
        let up = snapped(orientation.inverse() * Vec3::z());
        let known =
            found.iter().any(|stance| (stance.pose.rotation.inverse() * Vec3::z()).angle(&up) < SAME_STANCE);
        if !known && let Some(stance) = stand(shapes, &up) {
            found.push(stance);
        }
    }
    found.truncate(6);
    found
}

/// The coordinate axis that `direction` is but for rounding, else itself: so that the stance of one
/// class is the same to the bit wherever its objects stand.
fn snapped(direction: Vec3) -> Vec3 {
    let rounded = direction.map(f64::round);
    if (direction - rounded).norm() < SAME_AXIS { rounded } else { direction }
}

/// The object with its axis `up` upwards, if that is stable.
fn stand(shapes: &[PlacedShape], up: &Vec3) -> Option<Stance> {
    let half_turn = UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
    let rotation = UnitQuaternion::rotation_between(up, &Vec3::z()).unwrap_or(half_turn);
    let down = rotation.inverse() * -Vec3::z();
    let depth = shapes.iter().map(|placed| {
        placed.shape.support(&(placed.pose.rotation.inverse() * down))
            + placed.pose.translation.vector.dot(&down)
    });
    let height = depth.fold(f64::NEG_INFINITY, f64::max);
    if !height.is_finite() {
        return None;
    }
    let pose = Pose::from_parts(Translation3::new(0.0, 0.0, height), rotation);
    let plane = Surface {
        id: String::new(),
        carrier: None,
        pose: Pose::identity(),
        half_extents: [1.0e3, 1.0e3],
        capacity: None,
    };
    rests_on(shapes, &pose, &plane).is_ok().then_some(Stance { pose })
}

/// Stances and quarter turns that stay within the footprint of the first stance unturned, as
/// poses in the surface's frame above its origin; that one first.
pub(super) fn alternatives(shapes: &[PlacedShape], stances: &[Stance]) -> Vec<(Stance, f64)> {
    let Some(first) = stances.first() else { return Vec::new() };
    let outline = Footprint::of(shapes, &first.pose);
    let mut kept = Vec::new();
    for stance in stances {
        for yaw in [0.0, FRAC_PI_2, 2.0 * FRAC_PI_2, 3.0 * FRAC_PI_2] {
            let turned = UnitQuaternion::from_axis_angle(&Vec3::z_axis(), yaw) * stance.pose;
            if outline.contains(&Footprint::of(shapes, &turned), 1e-6) {
                kept.push((*stance, yaw));
            }
        }
    }
    kept
}
