//! The rotations of an object that make no difference.

use std::f64::consts::FRAC_PI_2;

use nalgebra::UnitQuaternion;

use super::Symmetry;
use super::grasps::bounding_box;
use crate::geometry::{PlacedShape, Shape, Vec3};

/// Half extents of a box that differ by less than this (m) are equal.
const EQUAL_EXTENT: f64 = 1.0e-9;

/// As much (m) makes no difference where an object counts as the box around it: more than the numbers
/// of a mesh are rounded by, and less than any pose is met to.
const NO_DIFFERENCE: f64 = 1.0e-4;

/// Why an object has no such symmetry.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum SymmetryError {
    /// Rotations about the object's origin do not map its bounding box onto itself.
    #[error(
        "`box` means rotations about the object's origin that map its bounding box onto itself, but that box has its \
         centre at ({:.6}, {:.6}, {:.6}) m; move the shape there or give `none`",
        .centre.x, .centre.y, .centre.z
    )]
    OffCentre {
        /// The centre of the bounding box in the object's frame (m).
        centre: Vec3,
    },
}

/// The rotations about the object's frame that `symmetry` allows, the identity first: those that
/// map the bounding box of `shapes` (along the frame's axes) onto itself for [`Symmetry::Box`] (4, 8 or
/// 24), the identity alone for the others, of which some are infinitely many.
///
/// # Errors
/// [`SymmetryError::OffCentre`] when that box is not about the frame's origin.
pub fn symmetry_rotations(
    symmetry: Symmetry,
    shapes: &[PlacedShape],
) -> Result<Vec<UnitQuaternion<f64>>, SymmetryError> {
    if symmetry != Symmetry::Box {
        return Ok(vec![UnitQuaternion::identity()]);
    }
    let (low, high) = bounding_box(shapes);
    let centre = (low + high) / 2.0;
    if centre.amax() > NO_DIFFERENCE {
        return Err(SymmetryError::OffCentre { centre });
    }
    Ok(box_rotations(&((high - low) / 2.0), NO_DIFFERENCE))
}

/// Rotations about its frame that map `shape` itself onto itself, the identity first: all (4, 8 or 24) of
/// a box, of any other shape the identity alone.
pub fn shape_rotations(shape: &Shape) -> Vec<UnitQuaternion<f64>> {
    match shape {
        Shape::Box { half_extents } => box_rotations(half_extents, EQUAL_EXTENT),
        _ => vec![UnitQuaternion::identity()],
    }
}

/// The rotations that map a box of these half extents (m) onto itself, up to `play` (m).
fn box_rotations(half_extents: &Vec3, play: f64) -> Vec<UnitQuaternion<f64>> {
    let mut out = vec![UnitQuaternion::identity()];
    for candidate in cube_rotations() {
        let mapped = (candidate * half_extents).abs();
        let same = (mapped - half_extents).amax() < play;
        if same && out.iter().all(|rotation| rotation.angle_to(&candidate) > 0.1) {
            out.push(candidate);
        }
    }
    out
}

/// The 24 rotations of a cube.
fn cube_rotations() -> Vec<UnitQuaternion<f64>> {
    let quarter =
        |axis: Vec3, turns: usize| UnitQuaternion::from_scaled_axis(axis * (FRAC_PI_2 * turns as f64));
    // Bring each of the six faces up, then turn about z.
    let faces = [
        UnitQuaternion::identity(),
        quarter(Vec3::x(), 1),
        quarter(Vec3::x(), 2),
        quarter(Vec3::x(), 3),
        quarter(Vec3::y(), 1),
        quarter(Vec3::y(), 3),
    ];
    (0..4).flat_map(|turns| faces.iter().map(move |face| quarter(Vec3::z(), turns) * face)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::geometry::{ConvexHull, Pose};

    fn alone(shape: Shape) -> [PlacedShape; 1] {
        [PlacedShape { shape, pose: Pose::identity() }]
    }

    fn count(shape: Shape) -> usize {
        let rotations = symmetry_rotations(Symmetry::Box, &alone(shape)).unwrap();
        assert_eq!(rotations[0], UnitQuaternion::identity());
        // A group: every product is a member.
        for a in &rotations {
            for b in &rotations {
                assert!(rotations.iter().any(|c| c.angle_to(&(a * b)) < 1e-9));
            }
        }
        rotations.len()
    }

    fn boxed(x: f64, y: f64, z: f64) -> Shape {
        Shape::Box { half_extents: Vec3::new(x, y, z) }
    }

    /// A wedge whose bounding box has these half extents, about `centre`.
    fn wedge(half: [f64; 3], centre: [f64; 3]) -> Shape {
        let corners = [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [-1, 1, 1]];
        let at = |corner: &[i32; 3]| Vec3::from_fn(|i, _| centre[i] + half[i] * f64::from(corner[i]));
        let points: Vec<Vec3> = corners.iter().map(at).collect();
        Shape::Convex(Arc::new(ConvexHull::new(&points).unwrap()))
    }

    #[test]
    fn boxes_have_4_8_or_24() {
        for (half, expected) in [
            ([0.03, 0.03, 0.03], 24),
            ([0.03, 0.03, 0.05], 8),
            ([0.02, 0.05, 0.02], 8),
            ([0.02, 0.03, 0.05], 4),
        ] {
            let [x, y, z] = half;
            assert_eq!(count(boxed(x, y, z)), expected);
            assert_eq!(shape_rotations(&boxed(x, y, z)).len(), expected);
            // Whatever else fills such a box counts as it.
            assert_eq!(count(wedge(half, [0.0; 3])), expected);
        }
        assert_eq!(count(Shape::Cylinder { radius: 0.03, half_length: 0.05 }), 8);
        assert_eq!(count(Shape::Capsule { radius: 0.03, half_length: 0.05 }), 8);
        assert_eq!(count(Shape::Sphere { radius: 0.03 }), 24);
        // As a file in single precision has it.
        assert_eq!(count(boxed(f64::from(0.03_f32), 0.03, f64::from(0.05_f32))), 8);
    }

    #[test]
    fn a_box_off_the_origin_has_none() {
        let shapes = alone(wedge([0.03; 3], [0.0, 0.0, 0.03]));
        match symmetry_rotations(Symmetry::Box, &shapes) {
            Err(SymmetryError::OffCentre { centre }) => assert!((centre.z - 0.03).abs() < 1e-12),
            other => panic!("{other:?}"),
        }
        let near = alone(wedge([0.03; 3], [0.0, 0.0, 1e-8]));
        assert_eq!(symmetry_rotations(Symmetry::Box, &near).unwrap().len(), 24);
    }

    #[test]
    fn the_rest_has_the_identity() {
        for shape in [Shape::Sphere { radius: 0.1 }, wedge([0.03; 3], [0.1; 3])] {
            for symmetry in [Symmetry::None, Symmetry::CylinderZ, Symmetry::Sphere] {
                assert_eq!(symmetry_rotations(symmetry, &alone(shape.clone())).unwrap().len(), 1);
            }
            // What fills a box is not mapped onto itself as the box is.
            assert_eq!(shape_rotations(&shape).len(), 1);
        }
        assert_eq!(shape_rotations(&Shape::Cylinder { radius: 0.03, half_length: 0.03 }).len(), 1);
    }
}
