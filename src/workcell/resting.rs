//! Whether an object rests on a surface (FORMAT "Resting").

use std::f64::consts::TAU;

use super::{Surface, SurfaceId};
use crate::geometry::{PlacedShape, Pose, Shape, Vec3};

/// Play of resting: height over the plane, and over the rectangle's edge (m).
const TOLERANCE: f64 = 0.002;

/// Corners of the polygon that stands for a rim.
const RIM_CORNERS: usize = 32;

/// Why an object does not rest on a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RestFault {
    /// Its lowest point is this far (m) above the surface's plane (negative: below).
    Height(f64),
    /// Points that touch the plane lie this far (m) outside the rectangle.
    Outside(f64),
    /// Its centre is this far (m) outside the hull of the points that touch.
    Topples(f64),
}

impl RestFault {
    /// How far it is from resting (m).
    pub fn by(&self) -> f64 {
        match *self {
            RestFault::Height(by) | RestFault::Outside(by) | RestFault::Topples(by) => by.abs(),
        }
    }
}

/// Checks whether an object of `shapes` at `pose` (world) rests on `surface`: its lowest points
/// are within 2 mm of the plane and inside the rectangle (2 mm), and its centre projects into the
/// hull of the points that touch (2 mm).
///
/// # Errors
/// The first rule that it breaks, in the order height, rectangle, hull.
pub fn rests_on(shapes: &[PlacedShape], pose: &Pose, surface: &Surface) -> Result<(), RestFault> {
    let in_surface = surface.pose.inverse() * pose;
    let down = in_surface.rotation.inverse() * -Vec3::z();
    let lowest = in_surface.translation.vector.z - super::grasps::extent(shapes, &down);
    if lowest.abs() > TOLERANCE {
        return Err(RestFault::Height(lowest));
    }
    let touching: Vec<[f64; 2]> = low_points(shapes, &in_surface)
        .into_iter()
        .filter(|point| point.z <= TOLERANCE)
        .map(|point| [point.x, point.y])
        .collect();
    let beyond = |point: &[f64; 2]| {
        let over = |index: usize| point[index].abs() - surface.half_extents[index];
        over(0).max(over(1))
    };
    let outside = touching.iter().map(beyond).fold(f64::NEG_INFINITY, f64::max);
    if outside > TOLERANCE {
        return Err(RestFault::Outside(outside));
    }
    let centre = in_surface * nalgebra::Point3::from(centre(shapes));
    let topples = distance_to_hull([centre.x, centre.y], touching);
    if topples > TOLERANCE { Err(RestFault::Topples(topples)) } else { Ok(()) }
}

/// The surfaces on which an object of `shapes` at `pose` rests; a good placement has exactly one.
pub fn surfaces_under(shapes: &[PlacedShape], pose: &Pose, surfaces: &[Surface]) -> Vec<SurfaceId> {
    surfaces
        .iter()
        .enumerate()
        .filter(|(_, surface)| rests_on(shapes, pose, surface).is_ok())
        .map(|(index, _)| SurfaceId(index))
        .collect()
}

/// The centre of volume of the shapes in the object's frame (m), overlaps counted twice.
pub fn centre(shapes: &[PlacedShape]) -> Vec3 {
    if let [only] = shapes {
        return local_centre(only);
    }
    let mut total = 0.0;
    let mut weighted = Vec3::zeros();
    for placed in shapes {
        let mass = placed.shape.to_parry().mass_properties(1.0).mass();
        total += mass;
        weighted += local_centre(placed) * mass;
    }
    if total > 0.0 { weighted / total } else { Vec3::zeros() }
}

fn local_centre(placed: &PlacedShape) -> Vec3 {
    let own = match &placed.shape {
        Shape::Convex(_) => {
            let centre = placed.shape.to_parry().mass_properties(1.0).local_com;
            Vec3::new(centre.x, centre.y, centre.z)
        }
        _ => Vec3::zeros(),
    };
    placed.pose.rotation * own + placed.pose.translation.vector
}

/// Points of the shapes' surface, in the frame in which they stand at `pose`, among which are all
/// corners and the lowest points of round parts.
fn low_points(shapes: &[PlacedShape], pose: &Pose) -> Vec<Vec3> {
    let mut out = Vec::new();
    for placed in shapes {
        let at = pose * placed.pose;
        let world = |local: Vec3| at.rotation * local + at.translation.vector;
        match &placed.shape {
            Shape::Box { half_extents: h } => {
                for corner in 0..8 {
                    let sign = |bit: u32| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
                    out.push(world(Vec3::new(h.x * sign(0), h.y * sign(1), h.z * sign(2))));
                }
            }
            Shape::Convex(hull) => out.extend(hull.vertices().iter().map(|vertex| world(*vertex))),
            Shape::Sphere { radius } => out.push(world(Vec3::zeros()) - Vec3::z() * *radius),
            Shape::Capsule { radius, half_length } => {
                for end in [*half_length, -*half_length] {
                    out.push(world(Vec3::z() * end) - Vec3::z() * *radius);
                }
            }
            Shape::Cylinder { radius, half_length } => {
                let down = at.rotation.inverse() * -Vec3::z();
                let lowest = down.y.atan2(down.x);
                for end in [*half_length, -*half_length] {
                    for corner in 0..RIM_CORNERS {
                        let angle = lowest + TAU * corner as f64 / RIM_CORNERS as f64;
                        out.push(world(Vec3::new(radius * angle.cos(), radius * angle.sin(), end)));
                    }
                }
            }
        }
    }
    out
}

/// Distance (m) from `point` to the convex hull of `points`; 0 inside, infinity when there is none.
fn distance_to_hull(point: [f64; 2], points: Vec<[f64; 2]>) -> f64 {
    let hull = convex_hull(points);
    let Some(&last) = hull.last() else { return f64::INFINITY };
    let mut inside = hull.len() > 2;
    let mut nearest = f64::INFINITY;
    let mut from = last;
    for &to in &hull {
        inside &= turn(from, to, point) >= 0.0;
        nearest = nearest.min(segment_distance(point, from, to));
        from = to;
    }
    if inside { 0.0 } else { nearest }
}

/// Twice the signed area of the triangle `a`, `b`, `c`: positive when it turns left.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn segment_distance(point: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0] * along[0] + along[1] * along[1];
    let offset = [point[0] - a[0], point[1] - a[1]];
    let share = if length > 0.0 { (offset[0] * along[0] + offset[1] * along[1]) / length } else { 0.0 };
    let share = share.clamp(0.0, 1.0);
    (offset[0] - share * along[0]).hypot(offset[1] - share * along[1])
}

/// Andrew's monotone chain, counter-clockwise.
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if turn(a, b, point) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{ConvexHull, pose_from_parts};
    use proptest::prelude::*;
    use std::sync::Arc;

    fn surface() -> Surface {
        Surface {
            id: "top".to_owned(),
            carrier: None,
            pose: pose_from_parts([1.0, 2.0, 0.65], [0.0, 0.0, 0.0, 1.0]),
            half_extents: [0.25, 0.4],
            capacity: None,
        }
    }

    fn alone(shape: Shape) -> Vec<PlacedShape> {
        vec![PlacedShape { shape, pose: Pose::identity() }]
    }

    fn at(x: f64, y: f64, z: f64, axis: Vec3, angle: f64) -> Pose {
        let rotation = nalgebra::UnitQuaternion::from_scaled_axis(axis * angle);
        Pose::from_parts(nalgebra::Translation3::new(1.0 + x, 2.0 + y, 0.65 + z), rotation)
    }

    #[test]
    fn a_cube_rests_flat_and_not_on_its_edge() {
        let cube = alone(Shape::Box { half_extents: Vec3::repeat(0.03) });
        let check = |pose| rests_on(&cube, &pose, &surface());
        assert_eq!(check(at(0.0, 0.0, 0.03, Vec3::z(), 0.7)), Ok(()));
        assert_eq!(check(at(0.0, 0.0, 0.0315, Vec3::z(), 0.0)), Ok(()));
        assert!(
            matches!(check(at(0.0, 0.0, 0.04, Vec3::z(), 0.0)), Err(RestFault::Height(h)) if (h - 0.01).abs() < 1e-9)
        );
        assert!(matches!(check(at(0.0, 0.0, 0.02, Vec3::z(), 0.0)), Err(RestFault::Height(_))));
        assert!(
            matches!(check(at(0.23, 0.0, 0.03, Vec3::z(), 0.0)), Err(RestFault::Outside(o)) if (o - 0.01).abs() < 1e-9)
        );
        // On an edge, tilted so that the centre is not over it.
        let tilt = 0.4_f64;
        let height = 0.03 * (tilt.cos() + tilt.sin());
        assert!(matches!(check(at(0.0, 0.0, height, Vec3::x(), tilt)), Err(RestFault::Topples(_))));
    }

    #[test]
    fn round_things_rest() {
        let ball = alone(Shape::Sphere { radius: 0.05 });
        assert_eq!(rests_on(&ball, &at(0.0, 0.0, 0.05, Vec3::x(), 1.0), &surface()), Ok(()));
        let can = alone(Shape::Cylinder { radius: 0.04, half_length: 0.06 });
        assert_eq!(rests_on(&can, &at(0.0, 0.0, 0.06, Vec3::z(), 1.0), &surface()), Ok(()));
        assert_eq!(rests_on(&can, &at(0.0, 0.0, 0.04, Vec3::x(), TAU / 4.0), &surface()), Ok(()));
        assert!(matches!(
            rests_on(&can, &at(0.22, 0.0, 0.06, Vec3::z(), 0.0), &surface()),
            Err(RestFault::Outside(_))
        ));
        let tilted = at(0.0, 0.0, 0.06 * 0.5_f64.cos() + 0.04 * 0.5_f64.sin(), Vec3::x(), 0.5);
        assert!(matches!(rests_on(&can, &tilted, &surface()), Err(RestFault::Topples(_))));
    }

    #[test]
    fn a_hull_needs_its_centre_over_its_foot() {
        // A wedge that leans out beyond its foot by more than its own length.
        let foot = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.02, 0.02, 0.0]];
        let head = foot.map(|[x, y, _]| [x + 0.2, y, 0.1]);
        let points: Vec<Vec3> = foot.iter().chain(&head).map(|p| Vec3::from(*p)).collect();
        let wedge = alone(Shape::Convex(Arc::new(ConvexHull::new(&points).unwrap())));
        let result = rests_on(&wedge, &at(0.0, 0.0, 0.0, Vec3::z(), 0.0), &surface());
        assert!(matches!(result, Err(RestFault::Topples(_))));
    }

    proptest! {
        #[test]
        fn the_distance_to_a_hull_is_that_to_its_nearest_half_plane_or_less(
            points in prop::collection::vec([-1.0..1.0_f64, -1.0..1.0_f64], 3..12),
            weights in prop::collection::vec(0.01..1.0_f64, 12),
        ) {
            // Any convex combination is inside.
            let total: f64 = weights.iter().take(points.len()).sum();
            let mut inside = [0.0, 0.0];
            for (point, weight) in points.iter().zip(&weights) {
                inside[0] += point[0] * weight / total;
                inside[1] += point[1] * weight / total;
            }
            prop_assert!(distance_to_hull(inside, points.clone()) < 1e-9);
            // Far to the right, the distance is at least the gap in x.
            let right = points.iter().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
            let gap = distance_to_hull([right + 2.0, 0.0], points);
            prop_assert!((2.0 - 1e-9..=2.0 + 2.0).contains(&gap));
        }
    }
}
