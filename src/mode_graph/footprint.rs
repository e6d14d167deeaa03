//! Footprints: what an object covers of a surface, as a convex polygon in the surface's plane.

use std::f64::consts::TAU;

use crate::geometry::{PlacedShape, Pose, Shape, Vec3};

/// Corners of the polygon that encloses a round outline.
const ROUND_CORNERS: usize = 16;

/// A convex polygon in a surface's frame (m), counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Footprint {
    corners: Vec<[f64; 2]>,
    centre: [f64; 2],
    radius: f64,
}

impl Footprint {
    /// What `shapes` cover when the object's frame stands at `in_surface` (in the surface's frame),
    /// seen from above. Exact for boxes and hulls, enclosing for round shapes.
    pub(super) fn of(shapes: &[PlacedShape], in_surface: &Pose) -> Self {
        let mut points = Vec::new();
        for placed in shapes {
            let at = in_surface * placed.pose;
            let mut push = |point: Vec3| {
                let p = at.rotation * point + at.translation.vector;
                points.push([p.x, p.y]);
            };
            match &placed.shape {
                Shape::Box { half_extents: h } => {
                    for corner in 0..8 {
                        let sign = |bit: i32| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
                        push(Vec3::new(h.x * sign(0), h.y * sign(1), h.z * sign(2)));
                    }
                }
                Shape::Convex(hull) => hull.vertices().iter().for_each(|vertex| push(*vertex)),
                Shape::Cylinder { radius, half_length } => {
                    for [x, y] in circle(*radius) {
                        push(Vec3::new(x, y, *half_length));
                        push(Vec3::new(x, y, -half_length));
                    }
                }
                Shape::Sphere { radius } => {
                    let centre = at.translation.vector;
                    points.extend(circle(*radius).map(|[x, y]| [centre.x + x, centre.y + y]));
                }
                Shape::Capsule { radius, half_length } => {
                    for end in [*half_length, -half_length] {
                        let centre = at.translation.vector + at.rotation * Vec3::new(0.0, 0.0, end);
                        points.extend(circle(*radius).map(|[x, y]| [centre.x + x, centre.y + y]));
                    }
                }
            }
        }
        Self::from_corners(convex_hull(points))
    }

    fn from_corners(corners: Vec<[f64; 2]>) -> Self {
        let count = corners.len().max(1) as f64;
        let centre = corners.iter().fold([0.0, 0.0], |c, p| [c[0] + p[0] / count, c[1] + p[1] / count]);
        let radius = corners.iter().map(|p| (p[0] - centre[0]).hypot(p[1] - centre[1])).fold(0.0, f64::max);
        Self { corners, centre, radius }
    }

    /// The footprint shifted by `by` (m).
    pub(super) fn shifted(&self, by: [f64; 2]) -> Self {
        let shift = |p: &[f64; 2]| [p[0] + by[0], p[1] + by[1]];
        Self {
            corners: self.corners.iter().map(shift).collect(),
            centre: shift(&self.centre),
            radius: self.radius,
        }
    }

    /// Least and greatest coordinate along the frame's x and y (m).
    pub(super) fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        let mut bounds = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in &self.corners {
            for (axis, &at) in corner.iter().enumerate() {
                bounds.0[axis] = bounds.0[axis].min(at);
                bounds.1[axis] = bounds.1[axis].max(at);
            }
        }
        bounds
    }

    /// Whether every corner of `other` lies in this polygon, up to `slack` (m).
    pub(super) fn contains(&self, other: &Self, slack: f64) -> bool {
        self.edges().all(|(a, b)| {
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let length = dx.hypot(dy);
            other.corners.iter().all(|p| dx * (p[1] - a[1]) - dy * (p[0] - a[0]) >= -slack * length)
        })
    }

    /// Whether the two polygons are closer than `gap` (m), overlap included.
    pub(super) fn is_nearer(&self, other: &Self, gap: f64) -> bool {
        let between = (self.centre[0] - other.centre[0]).hypot(self.centre[1] - other.centre[1]);
        between < self.radius + other.radius + gap && self.distance(other) < gap
    }

    /// Distance (m) between the two polygons, 0 when they overlap.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        if !self.is_parted_from(other) && !other.is_parted_from(self) {
            return 0.0;
        }
        let near = |a: &Self, b: &Self| {
            let pairs = a.corners.iter().flat_map(|p| b.edges().map(move |edge| (p, edge)));
            pairs.map(|(p, (from, to))| distance_to_segment(p, from, to)).fold(f64::INFINITY, f64::min)
        };
        near(self, other).min(near(other, self))
    }

    /// Whether one of this polygon's sides has all of `other` strictly beyond it.
    fn is_parted_from(&self, other: &Self) -> bool {
        self.edges().any(|(a, b)| {
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            other.corners.iter().all(|p| dx * (p[1] - a[1]) - dy * (p[0] - a[0]) < 0.0)
        })
    }

    fn edges(&self) -> impl Iterator<Item = (&[f64; 2], &[f64; 2])> + '_ {
        self.corners.iter().zip(self.corners.iter().cycle().skip(1))
    }
}

/// Corners of a regular polygon that encloses the circle of `radius`.
fn circle(radius: f64) -> impl Iterator<Item = [f64; 2]> {
    let step = TAU / ROUND_CORNERS as f64;
    let corner = radius / (0.5 * step).cos();
    (0..ROUND_CORNERS).map(move |k| {
        let (sin, cos) = (step * k as f64).sin_cos();
        [corner * cos, corner * sin]
    })
}

fn distance_to_segment(p: &[f64; 2], a: &[f64; 2], b: &[f64; 2]) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let square = dx * dx + dy * dy;
    let along = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / square.max(f64::MIN_POSITIVE);
    let along = along.clamp(0.0, 1.0);
    (p[0] - a[0] - along * dx).hypot(p[1] - a[1] - along * dy)
}

/// The convex hull of `points`, counter-clockwise (Andrew's monotone chain).
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup_by(|a, b| (a[0] - b[0]).abs() < 1e-9 && (a[1] - b[1]).abs() < 1e-9);
    let mut hull: Vec<[f64; 2]> = Vec::with_capacity(points.len() + 1);
    let turns_left = |o: &[f64; 2], a: &[f64; 2], b: &[f64; 2]| {
        (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]) > 1e-15
    };
    for pass in 0..2 {
        let base = hull.len();
        for index in 0..points.len() {
            let point = if pass == 0 { points[index] } else { points[points.len() - 1 - index] };
            while hull.len() >= base + 2 && !turns_left(&hull[hull.len() - 2], &hull[hull.len() - 1], &point)
            {
                hull.pop();
            }
            hull.push(point);
        }
        // The last point of each chain starts the other one.
        hull.pop();
    }
    if hull.is_empty() { points } else { hull }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose_from_parts;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn cuboid(x: f64, y: f64) -> Vec<PlacedShape> {
        let shape = Shape::Box { half_extents: Vec3::new(x, y, 0.05) };
        vec![PlacedShape { shape, pose: Pose::identity() }]
    }

    fn at(x: f64, y: f64, yaw: f64) -> Pose {
        pose_from_parts([x, y, 0.05], [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()])
    }

    proptest! {
        /// The polygons' distance against parry's between the solids, which stand on one plane.
        #[test]
        fn distance_is_that_of_the_solids(
            x in -0.4..0.4_f64, y in -0.4..0.4_f64, yaw in 0.0..6.0_f64, other_yaw in 0.0..6.0_f64,
            a in 0.02..0.1_f64, b in 0.02..0.1_f64,
        ) {
            use crate::geometry::ExactShape;
            let (first, second) = (cuboid(a, b), cuboid(b, 0.05));
            let (here, there) = (at(0.0, 0.0, yaw), at(x, y, other_yaw));
            let exact = ExactShape::new(&first[0]).signed_distance(&here, &ExactShape::new(&second[0]), &there, 1.0);
            let flat = Footprint::of(&first, &here).distance(&Footprint::of(&second, &there));
            prop_assert!((flat - exact.max(0.0)).abs() < 1e-6, "{flat} {exact}");
        }

        #[test]
        fn gap_is_asked_of_the_distance(x in -0.4..0.4_f64, y in -0.4..0.4_f64, yaw in 0.0..6.0_f64, gap in 0.0..0.1_f64) {
            let first = Footprint::of(&cuboid(0.03, 0.06), &at(0.0, 0.0, 0.0));
            let second = Footprint::of(&cuboid(0.03, 0.03), &at(x, y, yaw));
            prop_assert_eq!(first.is_nearer(&second, gap), first.distance(&second) < gap);
        }
    }

    #[test]
    fn round_footprints_enclose_the_circle() {
        let shape = Shape::Cylinder { radius: 0.04, half_length: 0.1 };
        let footprint = Footprint::of(&[PlacedShape { shape, pose: Pose::identity() }], &at(0.1, 0.2, 0.3));
        for k in 0..100 {
            let angle = f64::from(k) * 0.0628;
            let p = [0.1 + 0.04 * angle.cos(), 0.2 + 0.04 * angle.sin()];
            assert!(footprint.contains(&Footprint::from_corners(vec![p]), 1e-12));
        }
        assert!(footprint.radius < 0.0409);
    }

    #[test]
    fn containing_is_about_all_corners() {
        let square = Footprint::of(&cuboid(0.05, 0.05), &at(0.0, 0.0, 0.0));
        assert!(square.contains(&Footprint::of(&cuboid(0.05, 0.05), &at(0.0, 0.0, FRAC_PI_2)), 1e-9));
        assert!(!square.contains(&Footprint::of(&cuboid(0.05, 0.05), &at(0.0, 0.0, 0.3)), 1e-9));
        assert!(square.contains(&Footprint::of(&cuboid(0.02, 0.03), &at(0.01, 0.0, 0.3)), 1e-9));
    }
}
