//! How far two convex shapes are apart, with a proof.
//!
//! Whatever an iterative algorithm says, the separation along the axis that it found follows from
//! the two support functions alone, and bounds the signed distance from below. The judge relies on
//! that bound only.

use std::sync::Arc;

use nalgebra::Matrix3;
use parry3d_f64::math::{Pose as ParryPose, Vector as ParryVector};
use parry3d_f64::query::epa::EPA;
use parry3d_f64::query::gjk::{self, CsoPoint, GJKResult, VoronoiSimplex};
use parry3d_f64::shape::SupportMap;

use crate::geometry::{ConvexHull, PlacedShape, Pose, Shape, Vec3};

/// A rigid frame in the world, as a rotation matrix and a translation (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub rotation: Matrix3<f64>,
    pub position: Vec3,
}

impl Frame {
    pub(super) fn identity() -> Self {
        Self { rotation: Matrix3::identity(), position: Vec3::zeros() }
    }

    pub(super) fn of(pose: &Pose) -> Self {
        Self { rotation: *pose.rotation.to_rotation_matrix().matrix(), position: pose.translation.vector }
    }

    pub(super) fn to_pose(self) -> Pose {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.rotation);
        let rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
        Pose::from_parts(self.position.into(), rotation)
    }

    pub(super) fn compose(&self, other: &Frame) -> Self {
        Self { rotation: self.rotation * other.rotation, position: self.apply(&other.position) }
    }

    pub(super) fn apply(&self, point: &Vec3) -> Vec3 {
        self.rotation * point + self.position
    }

    pub(super) fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, position: -(rotation * self.position) }
    }
}

/// What is left of a shape when its rounding is taken off.
#[derive(Debug, Clone)]
enum Core {
    Point,
    /// Along z.
    Segment {
        half_length: f64,
    },
    Box {
        half_extents: Vec3,
    },
    /// Along z.
    Cylinder {
        radius: f64,
        half_length: f64,
    },
    Hull(Arc<ConvexHull>),
}

impl Core {
    /// The core's point farthest along `direction`, in its frame.
    fn support(&self, direction: &Vec3) -> Vec3 {
        match self {
            Core::Point => Vec3::zeros(),
            Core::Segment { half_length } => Vec3::new(0.0, 0.0, half_length.copysign(direction.z)),
            Core::Box { half_extents: h } => {
                Vec3::new(h.x.copysign(direction.x), h.y.copysign(direction.y), h.z.copysign(direction.z))
            }
            Core::Cylinder { radius, half_length } => {
                let across = direction.x.hypot(direction.y);
                let scale = if across > 0.0 { radius / across } else { 0.0 };
                Vec3::new(direction.x * scale, direction.y * scale, half_length.copysign(direction.z))
            }
            Core::Hull(hull) => {
                let mut best = (f64::NEG_INFINITY, Vec3::zeros());
                for vertex in hull.vertices() {
                    let along = vertex.dot(direction);
                    if along > best.0 {
                        best = (along, *vertex);
                    }
                }
                best.1
            }
        }
    }
}

/// One convex shape of a body.
#[derive(Debug, Clone)]
pub(super) struct Part {
    core: Core,
    /// Rounding around the core (m).
    pad: f64,
    /// The core's frame in the body's frame.
    local: Frame,
    /// Centre of a ball around the part, in the body's frame.
    pub centre: Vec3,
    /// That ball's radius (m).
    pub radius: f64,
}

/// What is known of the distance between two parts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gap {
    /// The signed distance is at least this (m).
    pub lower: f64,
    /// The signed distance is about this, or at least the distance asked for (m).
    pub estimate: f64,
    /// The axis along which `lower` holds, from the first part to the second, of unit length.
    pub axis: Vec3,
}

impl Part {
    /// Prepares a shape.
    pub(super) fn new(placed: &PlacedShape) -> Self {
        let (core, pad) = match &placed.shape {
            Shape::Box { half_extents } => (Core::Box { half_extents: *half_extents }, 0.0),
            Shape::Sphere { radius } => (Core::Point, *radius),
            Shape::Cylinder { radius, half_length } => {
                (Core::Cylinder { radius: *radius, half_length: *half_length }, 0.0)
            }
            Shape::Capsule { radius, half_length } => (Core::Segment { half_length: *half_length }, *radius),
            Shape::Convex(hull) => (Core::Hull(hull.clone()), 0.0),
        };
        let local = Frame::of(&placed.pose);
        let (middle, radius) = match &placed.shape {
            Shape::Convex(hull) => {
                let low = hull.vertices().iter().copied().reduce(|a, b| a.inf(&b)).unwrap_or_default();
                let high = hull.vertices().iter().copied().reduce(|a, b| a.sup(&b)).unwrap_or_default();
                let middle = (low + high) * 0.5;
                let radius = hull.vertices().iter().map(|v| (v - middle).norm()).fold(0.0, f64::max);
                (middle, radius)
            }
            other => (Vec3::zeros(), other.bounding_radius()),
        };
        Self { core, pad, local, centre: local.apply(&middle), radius: radius * (1.0 + 1e-12) }
    }

    /// Prepares a shape whose frame of reference stands at `frame` in the body's frame.
    pub(super) fn placed(shape: &PlacedShape, frame: &Frame) -> Self {
        let part = Self::new(shape);
        Self { local: frame.compose(&part.local), centre: frame.apply(&part.centre), ..part }
    }

    /// How far the part reaches along the unit vector `axis` (both in the world), the body at
    /// `body`.
    pub(super) fn reach(&self, body: &Frame, axis: &Vec3) -> f64 {
        let in_body = body.rotation.tr_mul(axis);
        let in_core = self.local.rotation.tr_mul(&in_body);
        self.core.support(&in_core).dot(&in_core)
            + self.local.position.dot(&in_body)
            + body.position.dot(axis)
            + self.pad
    }
}

/// By how much (m) an algorithm's claim may exceed what its axis shows before other axes are tried.
const DOUBT: f64 = 1e-5;

/// A lower bound (m) on the signed distance of `b` from `a`: how far they are apart along the unit
/// vector `axis`.
pub(super) fn lower_along(a: &Part, at: &Frame, b: &Part, b_at: &Frame, axis: &Vec3) -> f64 {
    -b.reach(b_at, &-axis) - a.reach(at, axis)
}

/// A core in the world, for parry.
struct WorldCore<'a> {
    core: &'a Core,
    frame: Frame,
}

impl SupportMap for WorldCore<'_> {
    fn local_support_point(&self, direction: ParryVector) -> ParryVector {
        let direction = Vec3::new(direction.x, direction.y, direction.z);
        let local = self.frame.rotation.tr_mul(&direction);
        self.frame.apply(&self.core.support(&local)).into()
    }

    fn support_point(&self, _world: &ParryPose, direction: ParryVector) -> ParryVector {
        self.local_support_point(direction)
    }
}

/// The gap between two parts. Stops early once the distance is shown to exceed `enough` (m).
pub(super) fn gap(a: &Part, at: &Frame, b: &Part, b_at: &Frame, enough: f64) -> Gap {
    let first = WorldCore { core: &a.core, frame: at.compose(&a.local) };
    let second = WorldCore { core: &b.core, frame: b_at.compose(&b.local) };
    let pad = a.pad + b.pad;
    if let (Some(half), Some(other_half)) = (line_half(&a.core), line_half(&b.core)) {
        let (p, r) = closest_on_segments(
            (first.frame.position, first.frame.rotation.column(2) * half),
            (second.frame.position, second.frame.rotation.column(2) * other_half),
        );
        let offset = r - p;
        let distance = offset.norm();
        if distance > 1e-9 {
            let axis = offset / distance;
            return Gap { lower: lower_along(a, at, b, b_at, &axis), estimate: distance - pad, axis };
        }
    }
    let start = second.frame.position - first.frame.position;
    let start = start.try_normalize(1e-9).unwrap_or_else(Vec3::x);
    let (axes, claim) = closest(&first, &second, &start, enough.max(0.0) + pad);
    let mut best = (f64::NEG_INFINITY, start);
    let mut consider = |axis: Vec3| {
        let lower = lower_along(a, at, b, b_at, &axis);
        if lower > best.0 {
            best = (lower, axis);
        }
        best
    };
    for axis in axes.into_iter().flatten() {
        consider(axis);
    }
    let (lower, _) = consider(start);
    let claim = claim.map(|claim| claim - pad);
    // Where the algorithms fail, or claim more than their axes show (as they do where shapes just
    // touch), the shapes' own axes help, and those found with the shapes moved apart.
    if lower <= enough && claim.is_none_or(|claim| lower < claim - DOUBT) {
        let (mut lower, mut axis) = (lower, start);
        for own in own_axes(&first, &second) {
            (lower, axis) = consider(own);
        }
        for _ in 0..3 {
            let mut frame = second.frame;
            frame.position += axis * (1e-3 - lower.min(0.0));
            let moved = WorldCore { core: second.core, frame };
            let before = lower;
            let (axes, _) = closest(&first, &moved, &axis, f64::MAX);
            for axis in axes.into_iter().flatten() {
                consider(axis);
            }
            (lower, axis) = consider(axis);
            if lower < before + 1e-7 {
                break;
            }
        }
    }
    let (lower, axis) = best;
    Gap { lower, estimate: claim.unwrap_or(lower).max(lower), axis }
}

/// What GJK, or EPA where the cores overlap, says: axes along which the cores seem farthest apart
/// or overlap least, and their distance if it is known, negative where they overlap. Stops early
/// beyond `limit`.
fn closest(
    first: &WorldCore<'_>,
    second: &WorldCore<'_>,
    start: &Vec3,
    limit: f64,
) -> ([Option<Vec3>; 2], Option<f64>) {
    let unit = |axis: ParryVector| {
        let axis = Vec3::new(axis.x, axis.y, axis.z).try_normalize(1e-9)?;
        axis.iter().all(|x| x.is_finite()).then_some(axis)
    };
    let mut simplex = VoronoiSimplex::new();
    let identity = ParryPose::IDENTITY;
    simplex.reset(CsoPoint::from_shapes(&identity, first, second, (*start).into()));
    match gjk::closest_points(&identity, first, second, limit, true, &mut simplex) {
        GJKResult::ClosestPoints(p, r, axis) => {
            let distance = (r - p).length();
            ([unit(axis), unit(r - p)], Some(distance).filter(|distance| distance.is_finite()))
        }
        GJKResult::NoIntersection(axis) | GJKResult::Proximity(axis) => ([unit(axis), None], None),
        GJKResult::Intersection => match EPA::new().closest_points(&identity, first, second, &simplex) {
            Some((p, r, axis)) => {
                let distance = (r - p).dot(axis);
                ([unit(axis), None], Some(distance).filter(|distance| distance.is_finite()))
            }
            None => ([None, None], None),
        },
    }
}

/// Half the length of a core that is a line or a point.
fn line_half(core: &Core) -> Option<f64> {
    match core {
        Core::Point => Some(0.0),
        Core::Segment { half_length } => Some(*half_length),
        _ => None,
    }
}

/// Axes to try when nothing else is known: the frames' axes and their cross products, each both
/// ways. For two boxes these are all that count.
fn own_axes(first: &WorldCore<'_>, second: &WorldCore<'_>) -> impl Iterator<Item = Vec3> {
    let (one, two) = (first.frame.rotation, second.frame.rotation);
    let single =
        move |i: usize| if i < 3 { one.column(i).into_owned() } else { two.column(i - 3).into_owned() };
    let crosses = move |i: usize| one.column(i / 3).cross(&two.column(i % 3)).try_normalize(1e-6);
    (0..6).map(single).chain((0..9).filter_map(crosses)).flat_map(|axis| [axis, -axis])
}

/// The closest points of two segments, each by its centre and its half vector (Ericson, Real-Time
/// Collision Detection, 5.1.9).
fn closest_on_segments((c1, h1): (Vec3, Vec3), (c2, h2): (Vec3, Vec3)) -> (Vec3, Vec3) {
    let (p, d1, q, d2) = (c1 - h1, h1 * 2.0, c2 - h2, h2 * 2.0);
    let r = p - q;
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let tiny = 1e-18;
    let (s, t) = if a <= tiny && e <= tiny {
        (0.0, 0.0)
    } else if a <= tiny {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else {
        let c = d1.dot(&r);
        if e <= tiny {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else {
            let b = d1.dot(&d2);
            let denominator = a * e - b * b;
            let s = if denominator > 1e-12 * a * e {
                ((b * f - c * e) / denominator).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let t = (b * s + f) / e;
            if t < 0.0 {
                ((-c / a).clamp(0.0, 1.0), 0.0)
            } else if t > 1.0 {
                (((b - c) / a).clamp(0.0, 1.0), 1.0)
            } else {
                (s, t)
            }
        }
    };
    (p + d1 * s, q + d2 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::ExactShape;
    use crate::run::Seed;
    use nalgebra::{Translation3, UnitQuaternion};
    use rand::Rng as _;

    fn random_pose(rng: &mut crate::run::Rng, spread: f64) -> Pose {
        let mut axis = || {
            Vec3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0))
        };
        let (position, turn) = (axis() * spread, axis() * 3.0);
        Pose::from_parts(Translation3::from(position), UnitQuaternion::from_scaled_axis(turn))
    }

    fn random_shape(rng: &mut crate::run::Rng) -> Shape {
        let mut size = || rng.random_range(0.02..0.3);
        let (a, b, c) = (size(), size(), size());
        match rng.random_range(0..5) {
            0 => Shape::Box { half_extents: Vec3::new(a, b, c) },
            1 => Shape::Sphere { radius: a },
            2 => Shape::Cylinder { radius: a, half_length: b },
            3 => Shape::Capsule { radius: a, half_length: b },
            _ => {
                let points: Vec<Vec3> = (0..12).map(|_| random_pose(rng, 0.2).translation.vector).collect();
                Shape::Convex(Arc::new(ConvexHull::new(&points).expect("a solid hull")))
            }
        }
    }

    #[test]
    fn agrees_with_parry_where_shapes_are_apart_and_proves_it() {
        let mut rng = Seed(5).stream("gap");
        let (mut apart, mut overlapping) = (0, 0);
        for _ in 0..4000 {
            let placed = PlacedShape { shape: random_shape(&mut rng), pose: random_pose(&mut rng, 0.1) };
            let other = PlacedShape { shape: random_shape(&mut rng), pose: random_pose(&mut rng, 0.1) };
            let (at, other_at) = (random_pose(&mut rng, 0.5), random_pose(&mut rng, 0.5));
            let (a, b) = (Part::new(&placed), Part::new(&other));
            let found = gap(&a, &Frame::of(&at), &b, &Frame::of(&other_at), 10.0);
            let oracle =
                ExactShape::new(&placed).signed_distance(&at, &ExactShape::new(&other), &other_at, 10.0);
            assert!(found.lower <= found.estimate + 1e-9);
            if oracle > 1e-6 {
                apart += 1;
                assert!((found.estimate - oracle).abs() < 1e-5, "{found:?} {oracle}");
                // GJK stops within some 1e-5 of the truth on round shapes; the bound stays on the safe side.
                assert!(found.lower > oracle - 5e-5, "{found:?} {oracle}");
            } else if oracle < -1e-6 {
                overlapping += 1;
                assert!(found.lower < 1e-9, "{found:?} {oracle}");
            }
        }
        assert!(apart > 1000 && overlapping > 500, "{apart} {overlapping}");
    }

    #[test]
    fn what_just_touches_is_shown_to() {
        let cube = Part::new(&PlacedShape {
            shape: Shape::Box { half_extents: Vec3::repeat(0.03) },
            pose: Pose::identity(),
        });
        let table = Shape::Box { half_extents: Vec3::new(0.3, 0.3, 0.25) };
        let table = Part::new(&PlacedShape { shape: table, pose: Pose::identity() });
        let mut rng = Seed(7).stream("gap");
        for _ in 0..2000 {
            let turn = UnitQuaternion::from_axis_angle(&Vec3::z_axis(), rng.random_range(-3.0..3.0));
            let world = random_pose(&mut rng, 1.0);
            let (x, y) = (rng.random_range(-0.25..0.25), rng.random_range(-0.25..0.25));
            let above = Pose::from_parts(Translation3::new(x, y, 0.28), turn);
            let found = gap(&cube, &Frame::of(&(world * above)), &table, &Frame::of(&world), 0.1);
            assert!(found.lower > -1e-9 && found.estimate < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn shallow_overlaps_are_measured() {
        let mut rng = Seed(6).stream("gap");
        let mut seen = 0;
        for _ in 0..3000 {
            let placed = PlacedShape { shape: random_shape(&mut rng), pose: Pose::identity() };
            let other = PlacedShape { shape: random_shape(&mut rng), pose: Pose::identity() };
            let (a, b) = (Part::new(&placed), Part::new(&other));
            let at = Frame::of(&random_pose(&mut rng, 0.5));
            let mut other_at = Frame::of(&random_pose(&mut rng, 0.5));
            let apart = gap(&a, &at, &b, &other_at, 10.0);
            if apart.lower < 1e-3 {
                continue;
            }
            // Push the second shape into the first: the depth is at most what it was pushed.
            seen += 1;
            other_at.position -= apart.axis * (apart.estimate + 0.001);
            let pushed = gap(&a, &at, &b, &other_at, 10.0);
            assert!(
                pushed.estimate > -0.001 - 2e-5 && pushed.lower > -0.001 - 2e-5,
                "{pushed:?} {placed:?} {other:?}"
            );
            assert!(pushed.estimate < 1e-6, "{pushed:?}");
        }
        assert!(seen > 500);
    }
}
