//! Collision shapes of a link: from URDF geometry, with capsules put together again.

use super::document::{CollisionElement, GeometryElement, LinkElement, cut};
use super::error::{UrdfError, UrdfWarning};
use super::mesh::MeshResolver;
use crate::geometry::{PlacedShape, Shape, Vec3};

/// How closely (m) two spheres must sit at a cylinder's ends to make a capsule of it.
const CAPSULE_TOLERANCE: f64 = 1e-6;

/// The shapes of `link`.
pub(super) fn link_shapes(
    link: &LinkElement,
    meshes: &dyn MeshResolver,
    warnings: &mut Vec<UrdfWarning>,
) -> Result<Vec<PlacedShape>, UrdfError> {
    let mut shapes = Vec::with_capacity(link.collisions.len());
    for CollisionElement { pose, geometry } in &link.collisions {
        let shape = match geometry {
            GeometryElement::Mesh { uri, scale } => {
                let mesh = meshes.pieces(uri, scale).map_err(|error| UrdfError::Mesh {
                    link: cut(&link.name),
                    uri: cut(uri),
                    error,
                })?;
                if let Some(filled) = mesh.filled {
                    warnings.push(UrdfWarning::MeshFilled { link: cut(&link.name), uri: cut(uri), filled });
                }
                shapes.extend(
                    mesh.hulls
                        .into_iter()
                        .map(|hull| PlacedShape { shape: Shape::Convex(hull), pose: *pose }),
                );
                continue;
            }
            GeometryElement::Box { size } => Shape::Box { half_extents: size / 2.0 },
            GeometryElement::Sphere { radius } => Shape::Sphere { radius: *radius },
            GeometryElement::Cylinder { radius, length } => {
                Shape::Cylinder { radius: *radius, half_length: length / 2.0 }
            }
            GeometryElement::Capsule { radius, length } => {
                Shape::Capsule { radius: *radius, half_length: length / 2.0 }
            }
        };
        shapes.push(PlacedShape { shape, pose: *pose });
    }
    Ok(merge_capsules(shapes))
}

/// Puts every cylinder with spheres of its radius at both ends together into one capsule, in
/// place of the cylinder. A sphere may end two cylinders; it goes when both became capsules or
/// when nothing else needs it.
pub(super) fn merge_capsules(shapes: Vec<PlacedShape>) -> Vec<PlacedShape> {
    let mut capped = vec![false; shapes.len()];
    let mut swallowed = vec![false; shapes.len()];
    for (index, placed) in shapes.iter().enumerate() {
        let Shape::Cylinder { radius, half_length } = placed.shape else { continue };
        let axis = placed.pose.rotation * Vec3::new(0.0, 0.0, half_length);
        let cap_at = |end: Vec3| {
            shapes.iter().position(|other| match other.shape {
                Shape::Sphere { radius: r } => {
                    (r - radius).abs() < CAPSULE_TOLERANCE
                        && (other.pose.translation.vector - end).norm() < CAPSULE_TOLERANCE
                }
                _ => false,
            })
        };
        let centre = placed.pose.translation.vector;
        if let (Some(top), Some(bottom)) = (cap_at(centre + axis), cap_at(centre - axis))
            && top != bottom
        {
            capped[index] = true;
            // The capsule holds both spheres, so they add nothing any more.
            swallowed[top] = true;
            swallowed[bottom] = true;
        }
    }
    let mut merged = Vec::with_capacity(shapes.len());
    for (index, placed) in shapes.into_iter().enumerate() {
        match placed.shape {
            Shape::Cylinder { radius, half_length } if capped[index] => {
                merged.push(PlacedShape { shape: Shape::Capsule { radius, half_length }, pose: placed.pose })
            }
            _ if swallowed[index] => {}
            _ => merged.push(placed),
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, pose_from_parts};

    fn sphere(x: f64, radius: f64) -> PlacedShape {
        let pose = pose_from_parts([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        PlacedShape { shape: Shape::Sphere { radius }, pose }
    }

    fn cylinder_along_x(x: f64) -> PlacedShape {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = pose_from_parts([x, 0.0, 0.0], [0.0, half, 0.0, half]);
        PlacedShape { shape: Shape::Cylinder { radius: 0.1, half_length: 0.5 }, pose }
    }

    #[test]
    fn a_capped_cylinder_becomes_a_capsule() {
        let merged = merge_capsules(vec![sphere(0.5, 0.1), cylinder_along_x(0.0), sphere(-0.5, 0.1)]);
        assert_eq!(merged.len(), 1);
        assert!(matches!(merged[0].shape, Shape::Capsule { radius: 0.1, half_length: 0.5 }));
    }

    #[test]
    fn two_cylinders_may_share_a_sphere() {
        let shapes = vec![
            cylinder_along_x(0.0),
            cylinder_along_x(1.0),
            sphere(-0.5, 0.1),
            sphere(0.5, 0.1),
            sphere(1.5, 0.1),
        ];
        let merged = merge_capsules(shapes);
        assert_eq!(merged.len(), 2);
        assert!(merged.iter().all(|p| matches!(p.shape, Shape::Capsule { .. })));
    }

    #[test]
    fn other_shapes_stay() {
        let shapes = vec![cylinder_along_x(0.0), sphere(0.5, 0.1), sphere(-0.5, 0.11), sphere(2.0, 0.1)];
        assert_eq!(merge_capsules(shapes).len(), 4);
        let lone = PlacedShape { shape: Shape::Sphere { radius: 1.0 }, pose: Pose::identity() };
        assert_eq!(merge_capsules(vec![lone]).len(), 1);
    }
}
