//! The rotations of an object that make no difference.

use std::f64::consts::FRAC_PI_2;

use nalgebra::UnitQuaternion;

use super::Symmetry;
use crate::geometry::{PlacedShape, Shape, Vec3};

/// Extents that differ by less than this (m) count as equal.
const EQUAL_EXTENT: f64 = 1.0e-9;

/// The rotations about the object's frame that `symmetry` allows, the identity first: those that
/// map a box of the object's extents onto itself for [`Symmetry::Box`] (4, 8 or 24; the identity
/// alone when the object is no box), the identity alone for the others, of which some are
/// infinitely many.
pub fn symmetry_rotations(symmetry: Symmetry, shapes: &[PlacedShape]) -> Vec<UnitQuaternion<f64>> {
    let identity = vec![UnitQuaternion::identity()];
    let half_extents = match (symmetry, shapes) {
        (Symmetry::Box, [PlacedShape { shape: Shape::Box { half_extents }, .. }]) => half_extents,
        _ => return identity,
    };
    let mut out = identity;
    for candidate in cube_rotations() {
        let mapped = (candidate * half_extents).abs();
        let same = (mapped - half_extents).amax() < EQUAL_EXTENT;
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
    use super::*;
    use crate::geometry::Pose;

    fn count(x: f64, y: f64, z: f64) -> usize {
        let shape = Shape::Box { half_extents: Vec3::new(x, y, z) };
        let shapes = [PlacedShape { shape, pose: Pose::identity() }];
        let rotations = symmetry_rotations(Symmetry::Box, &shapes);
        assert_eq!(rotations[0], UnitQuaternion::identity());
        // A group: every product is a member.
        for a in &rotations {
            for b in &rotations {
                assert!(rotations.iter().any(|c| c.angle_to(&(a * b)) < 1e-9));
            }
        }
        rotations.len()
    }

    #[test]
    fn boxes_have_4_8_or_24() {
        assert_eq!(count(0.03, 0.03, 0.03), 24);
        assert_eq!(count(0.03, 0.03, 0.05), 8);
        assert_eq!(count(0.02, 0.05, 0.02), 8);
        assert_eq!(count(0.02, 0.03, 0.05), 4);
    }

    #[test]
    fn the_rest_has_the_identity() {
        let shapes = [PlacedShape { shape: Shape::Sphere { radius: 0.1 }, pose: Pose::identity() }];
        for symmetry in [Symmetry::None, Symmetry::Box, Symmetry::CylinderZ, Symmetry::Sphere] {
            assert_eq!(symmetry_rotations(symmetry, &shapes).len(), 1);
        }
    }
}
