//! Whether an object rests on a surface.

use nalgebra::Vector2;

use super::gap::Frame;
use super::verdict::beyond;
use crate::geometry::{PlacedShape, Shape, Vec3};
use crate::workcell::{ObjectModel, Surface};

/// How far the lowest points may be from the surface's plane and outside its rectangle (m).
const TOLERANCE: f64 = 2e-3;
/// Into how many points the rim of a round shape is divided.
const RIM: usize = 64;

/// Why an object does not rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NotResting {
    /// What is wrong, as the end of a sentence.
    pub why: &'static str,
    /// By how much (m); 0 where there is no measure.
    pub amount: f64,
}

/// Checks the rule "Resting" of FORMAT.md for `object` at `frame` on `surface`.
pub(super) fn check(object: &ObjectModel, frame: &Frame, surface: &Surface) -> Result<(), NotResting> {
    let in_surface = Frame::of(&surface.pose).inverse().compose(frame);
    let lowest =
        object.shapes.iter().map(|shape| lowest_point(shape, &in_surface)).fold(f64::INFINITY, f64::min);
    if beyond(lowest.abs(), TOLERANCE) {
        let why = if lowest > 0.0 { "it floats above the surface" } else { "it sinks into the surface" };
        return Err(NotResting { why, amount: lowest.abs() });
    }
    let mut touching: Vec<Vector2<f64>> = Vec::new();
    for shape in &object.shapes {
        extreme_points(shape, &in_surface, &mut |point| {
            if point.z <= TOLERANCE {
                touching.push(Vector2::new(point.x, point.y));
            }
        });
    }
    let [half_x, half_y] = surface.half_extents;
    let outside = touching.iter().map(|p| (p.x.abs() - half_x).max(p.y.abs() - half_y));
    let outside = outside.fold(f64::NEG_INFINITY, f64::max);
    if beyond(outside, TOLERANCE) {
        return Err(NotResting { why: "it stands over the rim of the surface", amount: outside });
    }
    let centre = in_surface.apply(&centre_of_volume(&object.shapes));
    let hull = convex_hull(touching);
    if !contains(&hull, Vector2::new(centre.x, centre.y)) {
        return Err(NotResting { why: "its centre is not above the points that touch", amount: 0.0 });
    }
    Ok(())
}

/// Height of a shape's lowest point over the surface's plane (m).
fn lowest_point(shape: &PlacedShape, body: &Frame) -> f64 {
    let frame = body.compose(&Frame::of(&shape.pose));
    let down = frame.rotation.tr_mul(&-Vec3::z());
    frame.position.z - shape.shape.support(&down)
}

/// Visits points of the shape, in the surface's frame, among which are its lowest: corners, and
/// points along rims. A round side gives the points within 2 mm above its lowest ones, where a real
/// one would yield.
fn extreme_points(shape: &PlacedShape, body: &Frame, visit: &mut impl FnMut(Vec3)) {
    let frame = body.compose(&Frame::of(&shape.pose));
    match &shape.shape {
        Shape::Box { half_extents: h } => {
            for corner in 0..8 {
                let sign = |bit: i32| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
                visit(frame.apply(&Vec3::new(h.x * sign(0), h.y * sign(1), h.z * sign(2))));
            }
        }
        Shape::Convex(hull) => hull.vertices().iter().for_each(|vertex| visit(frame.apply(vertex))),
        Shape::Sphere { radius } => cap(&frame.position, *radius, visit),
        Shape::Capsule { radius, half_length } => {
            for end in [-*half_length, *half_length] {
                cap(&frame.apply(&Vec3::new(0.0, 0.0, end)), *radius, visit);
            }
        }
        Shape::Cylinder { radius, half_length } => {
            // Counted from the rim's lowest direction, so that a lying cylinder's line is met.
            let down = frame.rotation.tr_mul(&-Vec3::z());
            let start = if down.x.hypot(down.y) > 1e-9 { down.y.atan2(down.x) } else { 0.0 };
            for end in [-*half_length, *half_length] {
                for index in 0..RIM {
                    let angle = start + index as f64 / RIM as f64 * std::f64::consts::TAU;
                    let (sin, cos) = angle.sin_cos();
                    visit(frame.apply(&Vec3::new(radius * cos, radius * sin, end)));
                }
            }
        }
    }
}

/// The lowest point of a ball and the circle on it 1 mm higher.
fn cap(centre: &Vec3, radius: f64, visit: &mut impl FnMut(Vec3)) {
    let height = radius.min(0.5 * TOLERANCE);
    let across = (radius * radius - (radius - height).powi(2)).max(0.0).sqrt();
    visit(centre - Vec3::z() * radius);
    for index in 0..RIM {
        let (sin, cos) = (index as f64 / RIM as f64 * std::f64::consts::TAU).sin_cos();
        visit(centre + Vec3::new(across * cos, across * sin, height - radius));
    }
}

/// The centre of volume of a union of shapes, in their body's frame; overlaps count twice.
fn centre_of_volume(shapes: &[PlacedShape]) -> Vec3 {
    if let [only] = shapes
        && !matches!(only.shape, Shape::Convex(_))
    {
        return only.pose.translation.vector;
    }
    let (mut sum, mut volume) = (Vec3::zeros(), 0.0);
    for shape in shapes {
        let properties = shape.shape.to_parry().mass_properties(1.0);
        let centre = Vec3::new(properties.local_com.x, properties.local_com.y, properties.local_com.z);
        sum += (shape.pose * nalgebra::Point3::from(centre)).coords * properties.mass();
        volume += properties.mass();
    }
    if volume > 0.0 { sum / volume } else { sum }
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut hull: Vec<Vector2<f64>> = Vec::new();
    for pass in 0..2 {
        let start = hull.len();
        let in_order: Box<dyn Iterator<Item = &Vector2<f64>>> =
            if pass == 0 { Box::new(points.iter()) } else { Box::new(points.iter().rev()) };
        for point in in_order {
            while hull.len() >= start + 2 && turn(&hull[hull.len() - 2], &hull[hull.len() - 1], point) <= 0.0
            {
                hull.pop();
            }
            hull.push(*point);
        }
        hull.pop();
    }
    hull
}

/// Twice the signed area of a triangle (m^2).
fn turn(a: &Vector2<f64>, b: &Vector2<f64>, c: &Vector2<f64>) -> f64 {
    (b - a).perp(&(c - a))
}

/// Whether a counter-clockwise hull with an area holds the point. What stands on a point or an
/// edge alone does not rest.
fn contains(hull: &[Vector2<f64>], point: Vector2<f64>) -> bool {
    let area: f64 = (1..hull.len().saturating_sub(1)).map(|i| turn(&hull[0], &hull[i], &hull[i + 1])).sum();
    if area < 1e-8 {
        return false;
    }
    (0..hull.len()).all(|i| {
        let (a, b) = (&hull[i], &hull[(i + 1) % hull.len()]);
        turn(a, b, &point) >= -1e-9
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{ConvexHull, Pose};
    use crate::workcell::Symmetry;
    use nalgebra::{Translation3, UnitQuaternion};
    use std::sync::Arc;

    fn object(shape: Shape) -> ObjectModel {
        ObjectModel {
            id: "thing".into(),
            shapes: vec![PlacedShape { shape, pose: Pose::identity() }],
            mass: 1.0,
            symmetry: Symmetry::None,
            symmetry_rotations: vec![UnitQuaternion::identity()],
            grasps: Vec::new(),
            approach: 0.08,
            retreat: 0.08,
            class: 0,
        }
    }

    fn surface() -> Surface {
        let pose = Pose::from_parts(
            Translation3::new(1.0, 2.0, 0.5),
            UnitQuaternion::from_axis_angle(&Vec3::z_axis(), 0.4),
        );
        Surface { id: "top".into(), carrier: None, pose, half_extents: [0.2, 0.1], capacity: None }
    }

    fn rests(object: &ObjectModel, x: f64, z: f64, turn: UnitQuaternion<f64>) -> Result<(), NotResting> {
        let pose = surface().pose * Pose::from_parts(Translation3::new(x, 0.0, z), turn);
        check(object, &Frame::of(&pose), &surface())
    }

    fn tilt(angle: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vec3::x_axis(), angle)
    }

    #[test]
    fn a_box_rests_on_a_face_inside_the_rectangle_only() {
        let cube = object(Shape::Box { half_extents: Vec3::repeat(0.03) });
        assert_eq!(rests(&cube, 0.0, 0.03, tilt(0.0)), Ok(()));
        assert_eq!(rests(&cube, 0.0, 0.0315, tilt(std::f64::consts::FRAC_PI_2)), Ok(()));
        assert!(rests(&cube, 0.0, 0.0325, tilt(0.0)).is_err());
        assert!(rests(&cube, 0.0, 0.0275, tilt(0.0)).is_err());
        assert_eq!(rests(&cube, 0.171, 0.03, tilt(0.0)), Ok(()));
        assert!(rests(&cube, 0.173, 0.03, tilt(0.0)).is_err());
        let on_edge = tilt(std::f64::consts::FRAC_PI_4);
        assert!(rests(&cube, 0.0, 0.03 * 2.0_f64.sqrt(), on_edge).is_err());
    }

    #[test]
    fn round_things_rest_standing_and_lying() {
        let cylinder = object(Shape::Cylinder { radius: 0.03, half_length: 0.05 });
        assert_eq!(rests(&cylinder, 0.0, 0.05, tilt(0.0)), Ok(()));
        assert_eq!(rests(&cylinder, 0.0, 0.03, tilt(std::f64::consts::FRAC_PI_2)), Ok(()));
        assert!(rests(&cylinder, 0.0, 0.06, tilt(0.5)).is_err());
        let ball = object(Shape::Sphere { radius: 0.03 });
        assert_eq!(rests(&ball, 0.0, 0.03, tilt(1.0)), Ok(()));
        let capsule = object(Shape::Capsule { radius: 0.03, half_length: 0.05 });
        assert_eq!(rests(&capsule, 0.0, 0.03, tilt(std::f64::consts::FRAC_PI_2)), Ok(()));
        assert_eq!(rests(&capsule, 0.0, 0.08, tilt(0.0)), Ok(()));
    }

    #[test]
    fn a_hull_that_leans_over_its_foot_does_not_rest() {
        let leaning = |lean: f64| {
            let mut points = Vec::new();
            for (x, y) in [(0.0, 0.0), (0.04, 0.0), (0.04, 0.04), (0.0, 0.04)] {
                points.push(Vec3::new(x, y, 0.0));
                points.push(Vec3::new(x + lean, y, 0.1));
            }
            object(Shape::Convex(Arc::new(ConvexHull::new(&points).expect("a solid hull"))))
        };
        assert_eq!(rests(&leaning(0.03), 0.0, 0.0, tilt(0.0)), Ok(()));
        assert!(rests(&leaning(0.06), 0.0, 0.0, tilt(0.0)).is_err());
    }
}
