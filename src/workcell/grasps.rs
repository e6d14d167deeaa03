//! Grasp generators: from a shape to the ways to hold it (FORMAT "`grasps`").
//!
//! Frames: the TCP's z points out of the gripper into the object, y is the closing direction of
//! the fingers. A generated grasp is made as a TCP frame in the object's frame and stored as its
//! inverse, the object in the TCP.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};

use super::Grasp;
use crate::geometry::{PlacedShape, Pose, Shape, Vec3};

/// Greatest default depth (m) of the TCP below a face.
const DEFAULT_DEPTH: f64 = 0.03;

/// Greatest default depth (m) of the TCP below an edge: half the diagonal of a 6 cm square.
const DEFAULT_EDGE_DEPTH: f64 = 0.0425;

/// Play (m) that rounding may take when an extent is compared with the gripper's opening.
const OPENING_PLAY: f64 = 1.0e-9;

/// A rule that makes grasps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GraspGenerator {
    /// On each face of a box, four rolls.
    BoxFaces {
        /// TCP below the face (m); `None`: the lesser of the half extent and 0.03.
        depth: Option<f64>,
    },
    /// On each edge of a box, along the bisector of its faces, both ways round.
    BoxEdges {
        /// TCP below the edge (m); `None`: the lesser of half the diagonal and 0.0425.
        depth: Option<f64>,
    },
    /// From the object's own +z side.
    Top {
        /// TCP below the top (m); `None`: the lesser of half the height and 0.03.
        depth: Option<f64>,
        /// How many rolls, counted from x.
        yaw_steps: usize,
    },
    /// Towards the axis of a cylinder or capsule and perpendicular to it, both ways round.
    CylinderSide {
        /// TCP below the side (m); `None`: the lesser of the radius and 0.03.
        depth: Option<f64>,
        /// How many directions around the axis.
        yaw_steps: usize,
    },
}

/// Why a generator makes nothing of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum GraspError {
    /// The generator is for boxes.
    #[error("this generator is for boxes; use `top` or explicit grasps")]
    NeedsBox,
    /// The generator is for cylinders and capsules.
    #[error("this generator is for cylinders and capsules; use `top` or explicit grasps")]
    NeedsCylinder,
}

impl GraspGenerator {
    /// FORMAT's default generators for an object of these shapes.
    pub fn defaults(shapes: &[PlacedShape]) -> Vec<GraspGenerator> {
        let top = GraspGenerator::Top { depth: None, yaw_steps: 8 };
        match shapes {
            [PlacedShape { shape: Shape::Box { .. }, .. }] => {
                vec![GraspGenerator::BoxFaces { depth: None }, GraspGenerator::BoxEdges { depth: None }]
            }
            [PlacedShape { shape: Shape::Cylinder { .. }, .. }] => {
                vec![GraspGenerator::CylinderSide { depth: None, yaw_steps: 8 }, top]
            }
            _ => vec![top],
        }
    }

    /// The grasps of an object of `shapes` for grippers that open at most `max_opening` (m), in a
    /// fixed order.
    ///
    /// # Errors
    /// When the generator does not go with the shape.
    pub fn expand(&self, shapes: &[PlacedShape], max_opening: f64) -> Result<Vec<Grasp>, GraspError> {
        let mut out = Vec::new();
        match *self {
            GraspGenerator::BoxFaces { depth } => {
                box_faces(box_half_extents(shapes)?, depth, max_opening, &mut out);
            }
            GraspGenerator::BoxEdges { depth } => {
                box_edges(box_half_extents(shapes)?, depth, max_opening, &mut out);
            }
            GraspGenerator::Top { depth, yaw_steps } => top(shapes, depth, yaw_steps, max_opening, &mut out),
            GraspGenerator::CylinderSide { depth, yaw_steps } => {
                let radius = match shapes {
                    [PlacedShape { shape: Shape::Cylinder { radius, .. }, .. }]
                    | [PlacedShape { shape: Shape::Capsule { radius, .. }, .. }] => *radius,
                    _ => return Err(GraspError::NeedsCylinder),
                };
                cylinder_side(radius, depth, yaw_steps, max_opening, &mut out);
            }
        }
        Ok(out)
    }
}

fn box_half_extents(shapes: &[PlacedShape]) -> Result<Vec3, GraspError> {
    match shapes {
        [PlacedShape { shape: Shape::Box { half_extents }, .. }] => Ok(*half_extents),
        _ => Err(GraspError::NeedsBox),
    }
}

/// The grasp whose TCP frame in the object's frame stands at `at` with axes y = `closing` and
/// z = `approach` (orthonormal).
fn grasp(id: String, at: Vec3, closing: Vec3, approach: Vec3, opening: f64) -> Grasp {
    let rotation = Matrix3::from_columns(&[closing.cross(&approach), closing, approach]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let tcp_in_object = Pose::from_parts(Translation3::from(at), rotation);
    Grasp { id, object_in_tcp: tcp_in_object.inverse(), opening }
}

fn axis(index: usize, sign: f64) -> Vec3 {
    let mut out = Vec3::zeros();
    out[index % 3] = sign;
    out
}

const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];
const SIGNS: [(f64, &str); 2] = [(1.0, "+"), (-1.0, "-")];

fn box_faces(h: Vec3, depth: Option<f64>, max_opening: f64, out: &mut Vec<Grasp>) {
    for normal in 0..3 {
        for (side, side_name) in SIGNS {
            let depth = depth.unwrap_or(h[normal].min(DEFAULT_DEPTH));
            let at = axis(normal, side * (h[normal] - depth));
            for lateral in [(normal + 1) % 3, (normal + 2) % 3] {
                let opening = 2.0 * h[lateral];
                if opening > max_opening + OPENING_PLAY {
                    continue;
                }
                for (turn, turn_name) in SIGNS {
                    let id = format!(
                        "box_faces/{side_name}{}/{turn_name}{}",
                        AXIS_NAMES[normal], AXIS_NAMES[lateral]
                    );
                    out.push(grasp(id, at, axis(lateral, turn), axis(normal, -side), opening));
                }
            }
        }
    }
}

fn box_edges(h: Vec3, depth: Option<f64>, max_opening: f64, out: &mut Vec<Grasp>) {
    for along in 0..3 {
        let (a, b) = ((along + 1) % 3, (along + 2) % 3);
        let opening = 2.0 * h[along];
        if opening > max_opening + OPENING_PLAY {
            continue;
        }
        let depth = depth.unwrap_or(h[a].hypot(h[b]).min(DEFAULT_EDGE_DEPTH));
        for (side_a, name_a) in SIGNS {
            for (side_b, name_b) in SIGNS {
                let edge = axis(a, side_a * h[a]) + axis(b, side_b * h[b]);
                let approach = axis(a, -side_a * FRAC_1_SQRT_2) + axis(b, -side_b * FRAC_1_SQRT_2);
                for (turn, turn_name) in SIGNS {
                    let id = format!(
                        "box_edges/{name_a}{}{name_b}{}/{turn_name}{}",
                        AXIS_NAMES[a], AXIS_NAMES[b], AXIS_NAMES[along]
                    );
                    out.push(grasp(id, edge + approach * depth, axis(along, turn), approach, opening));
                }
            }
        }
    }
}

fn top(shapes: &[PlacedShape], depth: Option<f64>, yaw_steps: usize, max_opening: f64, out: &mut Vec<Grasp>) {
    let (low, high) = bounding_box(shapes);
    let centre = (low + high) / 2.0;
    let half_height = (high.z - low.z) / 2.0;
    let depth = depth.unwrap_or(half_height.min(DEFAULT_DEPTH));
    let at = Vec3::new(centre.x, centre.y, high.z - depth);
    for step in 0..yaw_steps {
        let yaw = TAU * step as f64 / yaw_steps as f64;
        // The TCP's x at this yaw from the object's x; z downwards makes y = z cross x.
        let closing = (-Vec3::z()).cross(&Vec3::new(yaw.cos(), yaw.sin(), 0.0));
        let opening = extent(shapes, &closing) + extent(shapes, &-closing);
        if opening <= max_opening + OPENING_PLAY {
            out.push(grasp(format!("top/{step}"), at, closing, -Vec3::z(), opening));
        }
    }
}

fn cylinder_side(radius: f64, depth: Option<f64>, yaw_steps: usize, max_opening: f64, out: &mut Vec<Grasp>) {
    let opening = 2.0 * radius;
    if opening > max_opening + OPENING_PLAY {
        return;
    }
    let depth = depth.unwrap_or(radius.min(DEFAULT_DEPTH));
    for step in 0..yaw_steps {
        let yaw = TAU * step as f64 / yaw_steps as f64;
        let outward = Vec3::new(yaw.cos(), yaw.sin(), 0.0);
        for (turn, turn_name) in SIGNS {
            let closing = Vec3::z().cross(&outward) * turn;
            let at = outward * (radius - depth);
            out.push(grasp(format!("cylinder_side/{step}/{turn_name}"), at, closing, -outward, opening));
        }
    }
}

/// How far the shapes reach along the unit vector `direction` from the object's origin (m).
pub(super) fn extent(shapes: &[PlacedShape], direction: &Vec3) -> f64 {
    shapes
        .iter()
        .map(|placed| {
            let local = placed.pose.rotation.inverse() * direction;
            placed.pose.translation.vector.dot(direction) + placed.shape.support(&local)
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

/// Width and depth (m) of the shapes' bounding box along the object's x and y.
pub fn footprint(shapes: &[PlacedShape]) -> [f64; 2] {
    let (low, high) = bounding_box(shapes);
    [high.x - low.x, high.y - low.y]
}

/// Least and greatest corner of the shapes' axis-aligned bounding box in the object's frame (m).
pub(super) fn bounding_box(shapes: &[PlacedShape]) -> (Vec3, Vec3) {
    let high = Vec3::from_fn(|index, _| extent(shapes, &axis(index, 1.0)));
    let low = Vec3::from_fn(|index, _| -extent(shapes, &axis(index, -1.0)));
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn boxed(x: f64, y: f64, z: f64) -> Vec<PlacedShape> {
        vec![PlacedShape { shape: Shape::Box { half_extents: Vec3::new(x, y, z) }, pose: Pose::identity() }]
    }

    fn cylinder(radius: f64, half_length: f64) -> Vec<PlacedShape> {
        vec![PlacedShape { shape: Shape::Cylinder { radius, half_length }, pose: Pose::identity() }]
    }

    /// TCP position, closing and approach direction in the object's frame.
    fn tcp(grasp: &Grasp) -> (Vec3, Vec3, Vec3) {
        let tcp = grasp.object_in_tcp.inverse();
        (tcp.translation.vector, tcp.rotation * Vec3::y(), tcp.rotation * Vec3::z())
    }

    fn no_grasp_twice(grasps: &[Grasp]) {
        for (index, a) in grasps.iter().enumerate() {
            for b in &grasps[index + 1..] {
                assert_ne!(a.id, b.id);
                let apart = a.object_in_tcp.rotation.angle_to(&b.object_in_tcp.rotation);
                assert!(apart > 1e-3, "{} and {} are the same", a.id, b.id);
            }
        }
    }

    const FACES: GraspGenerator = GraspGenerator::BoxFaces { depth: None };
    const EDGES: GraspGenerator = GraspGenerator::BoxEdges { depth: None };

    #[test]
    fn a_cube_has_24_and_24() {
        let cube = boxed(0.03, 0.03, 0.03);
        let faces = FACES.expand(&cube, 0.10).unwrap();
        let edges = EDGES.expand(&cube, 0.10).unwrap();
        assert_eq!((faces.len(), edges.len()), (24, 24));
        let all: Vec<_> = faces.into_iter().chain(edges).collect();
        no_grasp_twice(&all);
        // The TCP is at the centre of a 6 cm cube (DESIGN section 11).
        for grasp in &all {
            assert!(tcp(grasp).0.norm() < 1e-4, "{}", grasp.id);
        }
    }

    #[test]
    fn generators_refuse_other_shapes() {
        assert_eq!(FACES.expand(&cylinder(0.02, 0.1), 0.1).unwrap_err(), GraspError::NeedsBox);
        let side = GraspGenerator::CylinderSide { depth: None, yaw_steps: 8 };
        assert_eq!(side.expand(&boxed(0.1, 0.1, 0.1), 0.1).unwrap_err(), GraspError::NeedsCylinder);
    }

    #[test]
    fn nothing_wider_than_the_opening() {
        let plate = boxed(0.2, 0.2, 0.01);
        let faces = FACES.expand(&plate, 0.10).unwrap();
        // Only the four narrow faces, closing over the thickness.
        assert_eq!(faces.len(), 8);
        assert!(faces.iter().all(|g| tcp(g).1.z.abs() > 0.999 && g.opening == 0.02));
        assert_eq!(EDGES.expand(&plate, 0.10).unwrap().len(), 8);
        assert!(
            GraspGenerator::Top { depth: None, yaw_steps: 8 }
                .expand(&cylinder(0.06, 0.1), 0.1)
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn explicit_depth_is_kept() {
        let shapes = boxed(0.05, 0.04, 0.08);
        for grasp in (GraspGenerator::BoxFaces { depth: Some(0.01) }).expand(&shapes, 1.0).unwrap() {
            let (at, _, approach) = tcp(&grasp);
            assert!((at.dot(&approach) + extent(&shapes, &-approach) - 0.01).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn face_grasps_follow_the_format(x in 0.005..0.2, y in 0.005..0.2, z in 0.005..0.2, opening in 0.02..0.3) {
            let shapes = boxed(x, y, z);
            let h = Vec3::new(x, y, z);
            let grasps = FACES.expand(&shapes, opening).unwrap();
            let fitting = (0..3).filter(|&i| 2.0 * h[i] <= opening).count();
            // Each fitting closing axis serves the four faces beside it, both ways round.
            prop_assert_eq!(grasps.len(), fitting * 8);
            no_grasp_twice(&grasps);
            for grasp in &grasps {
                let (at, closing, approach) = tcp(grasp);
                let width = extent(&shapes, &closing) + extent(&shapes, &-closing);
                prop_assert!((width - grasp.opening).abs() < 1e-9 && width <= opening + 1e-9);
                prop_assert!(closing.dot(&approach).abs() < 1e-12);
                // On the line through the face's centre, d below the face that z enters.
                let half = extent(&shapes, &-approach);
                prop_assert!((at + approach * (half - half.min(0.03))).norm() < 1e-9);
            }
        }

        #[test]
        fn edge_grasps_follow_the_format(x in 0.005..0.2, y in 0.005..0.2, z in 0.005..0.2, opening in 0.02..0.3) {
            let shapes = boxed(x, y, z);
            let h = Vec3::new(x, y, z);
            let grasps = EDGES.expand(&shapes, opening).unwrap();
            prop_assert_eq!(grasps.len(), (0..3).filter(|&i| 2.0 * h[i] <= opening).count() * 8);
            no_grasp_twice(&grasps);
            for grasp in &grasps {
                let (at, closing, approach) = tcp(grasp);
                let along = closing.iamax();
                prop_assert!((closing[along].abs() - 1.0).abs() < 1e-12);
                let (a, b) = ((along + 1) % 3, (along + 2) % 3);
                prop_assert!((approach[a].abs() - FRAC_1_SQRT_2).abs() < 1e-12);
                prop_assert!((approach[b].abs() - FRAC_1_SQRT_2).abs() < 1e-12);
                // Going back from the TCP against z meets the edge after the depth.
                let edge = at - approach * h[a].hypot(h[b]).min(0.0425);
                prop_assert!((edge[a].abs() - h[a]).abs() < 1e-9 && (edge[b].abs() - h[b]).abs() < 1e-9);
                prop_assert!(edge[along].abs() < 1e-9);
                prop_assert!(edge.dot(&approach) < 0.0);
            }
        }

        #[test]
        fn cylinder_grasps_follow_the_format(r in 0.005..0.05, l in 0.01..0.2, steps in 1_usize..12) {
            let shapes = cylinder(r, l);
            let side = GraspGenerator::CylinderSide { depth: None, yaw_steps: steps }.expand(&shapes, 0.1).unwrap();
            prop_assert_eq!(side.len(), 2 * steps);
            no_grasp_twice(&side);
            for grasp in &side {
                let (at, closing, approach) = tcp(grasp);
                prop_assert!(approach.z.abs() < 1e-12 && closing.z.abs() < 1e-12);
                prop_assert!((at + approach * (r - r.min(0.03))).norm() < 1e-9);
            }
            let top = GraspGenerator::Top { depth: None, yaw_steps: steps }.expand(&shapes, 0.1).unwrap();
            prop_assert_eq!(top.len(), steps);
            no_grasp_twice(&top);
            for (step, grasp) in top.iter().enumerate() {
                let (at, _, approach) = tcp(grasp);
                prop_assert!((approach + Vec3::z()).norm() < 1e-12);
                prop_assert!((at - Vec3::new(0.0, 0.0, l - l.min(0.03))).norm() < 1e-9);
                let x = grasp.object_in_tcp.inverse().rotation * Vec3::x();
                let yaw = TAU * step as f64 / steps as f64;
                prop_assert!((x - Vec3::new(yaw.cos(), yaw.sin(), 0.0)).norm() < 1e-9);
            }
        }
    }
}
