//! A cylinder beside a box, where the faces of the box tell all.

use crate::geometry::{Pose, Vec3};

/// Directions whose part across a cylinder's axis is less are along it.
const ALONG: f64 = 1e-9;

/// A lower bound (m) on the distance between a cylinder and a box that is at least `need`, or that distance, or negative
/// infinity where they overlap; `None` where the faces of the box do not tell. The cylinder is given by its frame
/// (its axis is z), its radius and half its length (m), the box by its frame and half extents (m).
///
/// Along the normal of a face the cylinder's farthest point is nearest to the box or deepest in it: where that point lies over
/// the face it is the nearest of all, and where it lies in the box the two overlap.
pub(super) fn cylinder_box(
    (frame, radius, half_length): (&Pose, f64, f64),
    (box_frame, half): (&Pose, &Vec3),
    need: f64,
) -> Option<f64> {
    let to_box = box_frame.rotation.inverse();
    let centre = to_box * (frame.translation.vector - box_frame.translation.vector);
    let axis = to_box * (frame.rotation * Vec3::z());
    // By component of the axis, the length of the others.
    let squares = axis.component_mul(&axis);
    let across =
        Vec3::new(squares.y + squares.z, squares.z + squares.x, squares.x + squares.y).map(f64::sqrt);
    let gaps = centre.abs() - half - half_length * axis.abs() - radius * across;
    let face = gaps.imax();
    if gaps[face] >= need {
        return Some(gaps[face]);
    }
    // The point that is farthest towards the middle plane of a pair of faces.
    let farthest = |face: usize| {
        let sign = if centre[face] < 0.0 { 1.0 } else { -1.0 };
        let end = centre + axis * (half_length * sign * axis[face].signum());
        if across[face] < ALONG {
            return end;
        }
        // The unit vector that points there, less its part along the axis.
        let mut outwards = axis * (-sign * axis[face] / across[face]);
        outwards[face] = sign * across[face];
        end + outwards * radius
    };
    let is_over = |point: &Vec3, face: usize| (0..3).all(|i| i == face || point[i].abs() <= half[i]);
    if gaps[face] >= 0.0 {
        return is_over(&farthest(face), face).then_some(gaps[face]);
    }
    let is_inside = |point: Vec3| (0..3).all(|i| point[i].abs() <= half[i]);
    (0..3).any(|face| is_inside(farthest(face))).then_some(f64::NEG_INFINITY)
}
