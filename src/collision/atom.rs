//! Atoms: convex pieces with a cheap enclosing core.

use crate::geometry::{ExactShape, PlacedShape, Pose, Shape, Vec3};

use super::cylinder_box::cylinder_box;
use super::cylinder_capsule::cylinder_capsule;
use super::segment_distance::{segment_box, segment_segment_squared};

/// Boxes that overlap by less than this (m) along every axis are looked at exactly.
const TOUCHING: f64 = 1e-9;
/// Edges of two boxes count as parallel when the sine between them is below this.
const SKIPPED_SINE: f64 = 1e-6;

/// What encloses an atom, in the frame of its body.
#[derive(Debug, Clone)]
pub(super) enum Core {
    /// All points within `radius` of the segment `a b`.
    Capsule {
        /// One end (m).
        a: Vec3,
        /// The other end (m).
        b: Vec3,
        /// Metres.
        radius: f64,
    },
    /// A box at `pose` in the body's frame.
    Box {
        /// Its frame.
        pose: Pose,
        /// Its half extents (m).
        half: Vec3,
    },
}

/// One convex piece of a body.
#[derive(Debug, Clone)]
pub struct Atom {
    pub(super) core: Core,
    /// Whether the core is the shape itself.
    pub(super) core_is_exact: bool,
    /// A box around the shape (frame in the body's frame, half extents in m), where the core is a capsule that is not the
    /// shape itself: flat ends are flat in it.
    pub(super) beside: Option<(Pose, Vec3)>,
    pub(super) exact: ExactShape,
    /// Whether the core is a capsule whose axis lies in the shape.
    has_axis: bool,
    /// Whether the shape is a cylinder, along z in the box beside it and as long and as wide.
    is_cylinder: bool,
    /// Centre of a ball that holds core and shape, in the body's frame (m).
    pub(super) centre: Vec3,
    /// Its radius (m).
    pub(super) radius: f64,
}

/// An atom placed in the world.
#[derive(Debug, Clone)]
pub(super) struct PlacedAtom {
    pub(super) body: Pose,
    pub(super) centre: Vec3,
    a: Vec3,
    b: Vec3,
    frame: Pose,
}

impl PlacedAtom {
    /// A place to be overwritten.
    pub(super) fn nowhere() -> Self {
        let zero = Vec3::zeros();
        Self { body: Pose::identity(), centre: zero, a: zero, b: zero, frame: Pose::identity() }
    }
}

impl Atom {
    /// Encloses `placed`, a shape in the frame of its body.
    pub fn new(placed: &PlacedShape) -> Self {
        let exact = ExactShape::new(placed);
        let along_z = |half_length: f64| {
            let axis = placed.pose.rotation * Vec3::new(0.0, 0.0, half_length);
            (placed.pose.translation.vector - axis, placed.pose.translation.vector + axis)
        };
        let (core, core_is_exact) = match &placed.shape {
            Shape::Sphere { radius } => {
                let centre = placed.pose.translation.vector;
                (Core::Capsule { a: centre, b: centre, radius: *radius }, true)
            }
            Shape::Capsule { radius, half_length } => {
                let (a, b) = along_z(*half_length);
                (Core::Capsule { a, b, radius: *radius }, true)
            }
            Shape::Cylinder { radius, half_length } => {
                let (a, b) = along_z(*half_length);
                (Core::Capsule { a, b, radius: *radius }, false)
            }
            Shape::Box { half_extents } => (Core::Box { pose: placed.pose, half: *half_extents }, true),
            Shape::Convex(hull) => (enclosing_capsule(hull.vertices(), &placed.pose), false),
        };
        let beside = match &placed.shape {
            Shape::Cylinder { radius, half_length } => {
                Some((placed.pose, Vec3::new(*radius, *radius, *half_length)))
            }
            Shape::Convex(hull) => Some(enclosing_box(hull.vertices(), &placed.pose)),
            _ => None,
        };
        let has_axis =
            matches!(&placed.shape, Shape::Sphere { .. } | Shape::Capsule { .. } | Shape::Cylinder { .. });
        let is_cylinder = matches!(&placed.shape, Shape::Cylinder { .. });
        let (centre, radius) = match &core {
            Core::Capsule { a, b, radius } => ((a + b) / 2.0, (b - a).norm() / 2.0 + radius),
            Core::Box { pose, half } => (pose.translation.vector, half.norm()),
        };
        Self { core, core_is_exact, beside, exact, has_axis, is_cylinder, centre, radius }
    }

    /// The greatest distance (m) of the enclosing core from the body's origin.
    pub fn reach(&self) -> f64 {
        match &self.core {
            Core::Capsule { a, b, radius } => a.norm().max(b.norm()) + radius,
            Core::Box { .. } => self.centre.norm() + self.radius,
        }
    }

    /// The atom with its body at `body`.
    #[inline]
    pub(super) fn place(&self, body: &Pose, out: &mut PlacedAtom) {
        out.body = *body;
        match &self.core {
            Core::Capsule { a, b, .. } => {
                out.a = body.rotation * a + body.translation.vector;
                out.b = body.rotation * b + body.translation.vector;
                out.centre = (out.a + out.b) / 2.0;
                if let Some((pose, _)) = &self.beside {
                    out.frame = body * pose;
                }
            }
            Core::Box { pose, .. } => {
                out.frame = body * pose;
                out.centre = out.frame.translation.vector;
            }
        }
    }

    /// The atom placed with its body at `body`.
    #[inline]
    pub(super) fn placed(&self, body: &Pose) -> PlacedAtom {
        let mut out = PlacedAtom::nowhere();
        self.place(body, &mut out);
        out
    }

    /// The distance (m) of the exact shapes with their bodies at `body` and `other_body`, negative
    /// where they overlap, or some lower bound of at least `need`.
    pub(super) fn distance(&self, body: &Pose, other: &Atom, other_body: &Pose, need: f64) -> f64 {
        let far = self.exact.ball_distance(body, &other.exact, other_body);
        if far > need {
            return far;
        }
        let told = self
            .beside_capsule(body, other, other_body, need)
            .or_else(|| other.beside_capsule(other_body, self, body, need));
        told.unwrap_or_else(|| self.exact.gap(body, &other.exact, other_body, need))
    }

    /// [`Self::distance`] of a cylinder from a capsule; `None` for others.
    fn beside_capsule(&self, body: &Pose, other: &Atom, other_body: &Pose, need: f64) -> Option<f64> {
        let (pose, half) = self.beside.as_ref().filter(|_| self.is_cylinder)?;
        let Core::Capsule { a, b, radius } = &other.core else { return None };
        if !other.core_is_exact {
            return None;
        }
        let place = |point: &Vec3| other_body.rotation * point + other_body.translation.vector;
        Some(cylinder_capsule((&(body * pose), half.x, half.z), (&place(a), &place(b), *radius), need))
    }

    /// A lower bound (m) on the distance between two placed atoms. It is either at least `need`,
    /// or the distance itself (with some negative value where they overlap).
    pub(super) fn separation(&self, at: &PlacedAtom, other: &Atom, other_at: &PlacedAtom, need: f64) -> f64 {
        let reach = self.radius + other.radius + need;
        let between = at.centre - other_at.centre;
        let squared = between.norm_squared();
        if squared >= reach * reach {
            return squared.sqrt() - self.radius - other.radius;
        }
        let told = match (self.cylinder(at), other.cylinder(other_at), &self.core, &other.core) {
            (Some(cylinder), _, _, Core::Box { half, .. }) => {
                cylinder_box(cylinder, (&other_at.frame, half), need)
            }
            (_, Some(cylinder), Core::Box { half, .. }, _) => cylinder_box(cylinder, (&at.frame, half), need),
            _ => None,
        };
        if let Some(distance) = told {
            return distance;
        }
        let bound = match (&self.core, &other.core) {
            (Core::Capsule { radius, .. }, Core::Capsule { radius: other_radius, .. }) => {
                segment_segment_squared(&at.a, &at.b, &other_at.a, &other_at.b).sqrt() - radius - other_radius
            }
            (Core::Capsule { radius, .. }, Core::Box { half, .. }) => {
                let bound = capsule_box(&at.a, &at.b, *radius, &other_at.frame, half);
                if self.has_axis && bound == -radius {
                    // The axis itself meets the box, which is the other shape.
                    return f64::NEG_INFINITY;
                }
                bound
            }
            (Core::Box { half, .. }, Core::Capsule { radius, .. }) => {
                let bound = capsule_box(&other_at.a, &other_at.b, *radius, &at.frame, half);
                if other.has_axis && bound == -radius {
                    return f64::NEG_INFINITY;
                }
                bound
            }
            (Core::Box { half, .. }, Core::Box { half: other_half, .. }) => {
                // Boxes that no axis separates overlap.
                let gap = box_gap((&at.frame, half), (&other_at.frame, other_half));
                if gap >= need {
                    return gap;
                }
                if gap < -SKIPPED_SINE * (half.norm() + other_half.norm()) - TOUCHING {
                    return f64::NEG_INFINITY;
                }
                return self.exact.gap(&at.body, &other.exact, &other_at.body, need);
            }
        };
        if bound >= need || (self.core_is_exact && other.core_is_exact) {
            return bound;
        }
        match self.box_separation(at, other, other_at) {
            Some(bound) if bound >= need => bound,
            _ => self.distance(&at.body, other, &other_at.body, need),
        }
    }

    /// A lower bound (m) on the distance between two placed atoms by the boxes around them, where one has such a box
    /// beside its core.
    fn box_separation(&self, at: &PlacedAtom, other: &Atom, other_at: &PlacedAtom) -> Option<f64> {
        if self.beside.is_none() && other.beside.is_none() {
            return None;
        }
        Some(match ((self.half(), &self.core), (other.half(), &other.core)) {
            ((Some(half), _), (Some(other_half), _)) => {
                box_gap((&at.frame, half), (&other_at.frame, other_half))
            }
            ((Some(half), _), (None, Core::Capsule { radius, .. })) => {
                capsule_box(&other_at.a, &other_at.b, *radius, &at.frame, half)
            }
            ((None, Core::Capsule { radius, .. }), (Some(half), _)) => {
                capsule_box(&at.a, &at.b, *radius, &other_at.frame, half)
            }
            _ => return None,
        })
    }

    /// The cylinder that the shape is: its frame, its radius and half its length (m).
    fn cylinder<'p>(&self, at: &'p PlacedAtom) -> Option<(&'p Pose, f64, f64)> {
        let (_, half) = self.beside.as_ref().filter(|_| self.is_cylinder)?;
        Some((&at.frame, half.x, half.z))
    }

    /// Half extents (m) of the box that is the core, or beside it.
    fn half(&self) -> Option<&Vec3> {
        match (&self.core, &self.beside) {
            (Core::Box { half, .. }, _) | (_, Some((_, half))) => Some(half),
            _ => None,
        }
    }
}

/// Distance between a capsule and a box: minus the radius where the segment meets the box.
#[inline]
fn capsule_box(a: &Vec3, b: &Vec3, radius: f64, frame: &Pose, half: &Vec3) -> f64 {
    let inverse = frame.rotation.inverse();
    let p0 = inverse * (a - frame.translation.vector);
    let p1 = inverse * (b - frame.translation.vector);
    segment_box(&p0, &p1, half) - radius
}

/// The widest gap (m) between two boxes, given as frame and half extents, along the 15 axes that can separate them:
/// never more than their distance, and negative only where they overlap (Gottschalk, Lin and Manocha 1996). Cross
/// products of nearly parallel edges say nothing that the faces do not, and are left out.
fn box_gap((frame, half): (&Pose, &Vec3), (other, other_half): (&Pose, &Vec3)) -> f64 {
    let (a, b) = (frame.rotation.to_rotation_matrix(), other.rotation.to_rotation_matrix());
    let offset = other.translation.vector - frame.translation.vector;
    let cosines = a.matrix().tr_mul(b.matrix());
    let sizes = cosines.abs();
    let (in_a, in_b) = (a.matrix().tr_mul(&offset), b.matrix().tr_mul(&offset));
    let of_faces = (in_a.abs() - half - sizes * other_half).max();
    let mut widest = of_faces.max((in_b.abs() - other_half - sizes.tr_mul(half)).max());
    for i in 0..3 {
        let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            // Of the cross product; one less the squared cosine would be lost in rounding.
            let square = cosines[(i1, j)] * cosines[(i1, j)] + cosines[(i2, j)] * cosines[(i2, j)];
            if square < SKIPPED_SINE * SKIPPED_SINE {
                continue;
            }
            let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
            let reach = half[i1] * sizes[(i2, j)]
                + half[i2] * sizes[(i1, j)]
                + other_half[j1] * sizes[(i, j2)]
                + other_half[j2] * sizes[(i, j1)];
            let between = (in_a[i2] * cosines[(i1, j)] - in_a[i1] * cosines[(i2, j)]).abs();
            widest = widest.max((between - reach) / square.sqrt());
        }
    }
    widest
}

/// A box around `vertices` (placed at `pose`): its frame and half extents (m).
fn enclosing_box(vertices: &[Vec3], pose: &Pose) -> (Pose, Vec3) {
    let (low, high) = corners(vertices);
    let middle = pose * Pose::from_parts(((low + high) / 2.0).into(), nalgebra::UnitQuaternion::identity());
    // Rounding must not leave a vertex outside.
    (middle, (high - low) / 2.0 + Vec3::repeat(1e-9))
}

/// The least and the greatest coordinates of `vertices`.
fn corners(vertices: &[Vec3]) -> (Vec3, Vec3) {
    let none = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    vertices.iter().fold(none, |(low, high), vertex| (low.inf(vertex), high.sup(vertex)))
}

/// A capsule around `vertices` (placed at `pose`) along the longest side of their box.
fn enclosing_capsule(vertices: &[Vec3], pose: &Pose) -> Core {
    let (low, high) = corners(vertices);
    let middle = (low + high) / 2.0;
    let axis = (high - low).imax();
    let mut radius = 0.0_f64;
    let radial = |v: &Vec3| {
        let mut offset = v - middle;
        offset[axis] = 0.0;
        offset.norm()
    };
    for vertex in vertices {
        radius = radius.max(radial(vertex));
    }
    // The caps cover what lies within the radius of the segment's ends.
    let mut start = f64::INFINITY;
    let mut end = f64::NEG_INFINITY;
    for vertex in vertices {
        let cap = (radius * radius - radial(vertex).powi(2)).max(0.0).sqrt();
        let along = vertex[axis] - middle[axis];
        start = start.min(along + cap);
        end = end.max(along - cap);
    }
    if start > end {
        let centre = (start + end) / 2.0;
        // Either end alone covers everything on its side; the midpoint covers both.
        (start, end) = (centre, centre);
    }
    let mut a = middle;
    let mut b = middle;
    a[axis] += start;
    b[axis] += end;
    // Rounding must not leave a vertex outside.
    let a = pose.rotation * a + pose.translation.vector;
    let b = pose.rotation * b + pose.translation.vector;
    Core::Capsule { a, b, radius: radius + 1e-9 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{ConvexHull, pose_from_parts};
    use rand::Rng as _;

    fn random_pose(rng: &mut crate::run::Rng) -> Pose {
        let mut r = || rng.random_range(-1.0..1.0);
        pose_from_parts([r(), r(), r()], [r(), r(), r(), r() + 1.5])
    }

    fn random_shape(rng: &mut crate::run::Rng) -> Shape {
        let mut r = || rng.random_range(0.05..0.4);
        let (x, y, z) = (r(), r(), r());
        match rng.random_range(0..5) {
            0 => Shape::Box { half_extents: Vec3::new(x, y, z) },
            1 => Shape::Sphere { radius: x },
            2 => Shape::Cylinder { radius: x, half_length: y },
            3 => Shape::Capsule { radius: x, half_length: y },
            _ => {
                let points: Vec<Vec3> = (0..12)
                    .map(|_| Vec3::from_fn(|i, _| rng.random_range(-1.0..1.0) * [x, y, z][i]))
                    .collect();
                Shape::Convex(std::sync::Arc::new(
                    ConvexHull::new(&points).expect("random points span a volume"),
                ))
            }
        }
    }

    #[test]
    fn separation_agrees_with_parry() {
        let mut rng = crate::run::Seed(3).stream("atoms");
        for case in 0..20_000 {
            let make =
                |rng: &mut crate::run::Rng| PlacedShape { shape: random_shape(rng), pose: random_pose(rng) };
            let (a, b) = (make(&mut rng), make(&mut rng));
            let (atom_a, atom_b) = (Atom::new(&a), Atom::new(&b));
            let (pose_a, pose_b) = (random_pose(&mut rng), random_pose(&mut rng));
            let need = rng.random_range(0.0..0.3);
            let found = atom_a.separation(&atom_a.placed(&pose_a), &atom_b, &atom_b.placed(&pose_b), need);
            let truth = ExactShape::new(&a).signed_distance(&pose_a, &ExactShape::new(&b), &pose_b, 10.0);
            if truth > 1e-6 {
                assert!(found <= truth + 1e-5, "case {case}: {found} exceeds {truth}");
            } else {
                assert!(found <= 1e-6, "case {case}: overlap missed, {found} against {truth}");
            }
            if found < need && truth > 0.0 {
                assert!(
                    (found - truth).abs() < 1e-5,
                    "case {case}: {found} is not {truth}, {:?} {:?}",
                    a.shape,
                    b.shape
                );
            }
        }
    }

    #[test]
    fn cylinders_beside_boxes_are_as_far_as_parry_says() {
        let mut rng = crate::run::Seed(5).stream("cylinders");
        let (mut apart, mut overlapping, mut touching) = (0, 0, 0);
        for case in 0..100_000 {
            let mut r = |low: f64, high: f64| rng.random_range(low..high);
            let cylinder = Shape::Cylinder { radius: r(0.01, 0.2), half_length: r(0.01, 0.4) };
            let table = Shape::Box { half_extents: Vec3::new(r(0.05, 0.6), r(0.05, 0.6), r(0.01, 0.3)) };
            let upright = r(0.0, 1.0) < 0.3;
            let need = r(0.0, 0.05);
            let mut pose = random_pose(&mut rng);
            pose.translation.vector *= 0.5;
            if upright {
                let tilt = [0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-3][rng.random_range(0..6)];
                pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(
                    std::f64::consts::FRAC_PI_2 * f64::from(rng.random_range(0..4)) + tilt,
                    0.0,
                    rng.random_range(-3.0..3.0),
                );
            }
            let placed = |shape| PlacedShape { shape, pose: Pose::identity() };
            let (a, b) = (placed(cylinder), placed(table));
            let (atom_a, atom_b) = (Atom::new(&a), Atom::new(&b));
            let origin = if upright { Pose::identity() } else { random_pose(&mut rng) };
            let (at, other_at) = (atom_a.placed(&pose), atom_b.placed(&origin));
            let found = atom_a.separation(&at, &atom_b, &other_at, need);
            let swapped = atom_b.separation(&other_at, &atom_a, &at, need);
            assert!(found == swapped || (found - swapped).abs() < 1e-6, "case {case}: {found} and {swapped}");
            let truth = ExactShape::new(&a).signed_distance(&pose, &ExactShape::new(&b), &origin, 10.0);
            if truth > 1e-6 {
                assert!(found <= truth + 1e-5, "case {case}: {found} exceeds {truth}");
                assert!(found >= need || (found - truth).abs() < 1e-5, "case {case}: {found} is not {truth}");
                apart += 1;
            } else if truth < -1e-6 {
                assert!(found <= 0.0, "case {case}: overlap missed, {found} against {truth}");
                overlapping += 1;
            } else {
                touching += 1;
            }
        }
        assert!(apart > 10_000 && overlapping > 5_000 && touching < 1000, "{apart} {overlapping} {touching}");
    }

    #[test]
    fn cylinders_beside_capsules_are_as_far_as_points_of_their_axes() {
        let mut rng = crate::run::Seed(6).stream("cylinders");
        let (mut apart, mut overlapping, mut touching) = (0, 0, 0);
        for case in 0..20_000 {
            let mut r = |low: f64, high: f64| rng.random_range(low..high);
            let cylinder = Shape::Cylinder { radius: r(0.01, 0.2), half_length: r(0.01, 0.4) };
            let other = match case % 5 {
                0 => Shape::Sphere { radius: r(0.01, 0.2) },
                _ => Shape::Capsule { radius: r(0.01, 0.2), half_length: r(0.0, 0.6) },
            };
            let need = [0.0, 0.002, r(0.0, 0.05), 10.0][case % 4];
            let mut pose = random_pose(&mut rng);
            pose.translation.vector *= 0.7;
            if case % 3 == 0 {
                // Side by side, end on end, and nearly so.
                let tilt = [0.0, 1e-9, 1e-7, 1e-3, std::f64::consts::FRAC_PI_2][rng.random_range(0..5)];
                pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(tilt, 0.0, 0.0);
            }
            let placed = |shape| PlacedShape { shape, pose: Pose::identity() };
            let (a, b) = (placed(cylinder), placed(other));
            let (atom_a, atom_b) = (Atom::new(&a), Atom::new(&b));
            let origin = if case % 3 == 0 { Pose::identity() } else { random_pose(&mut rng) };
            let found = atom_a.distance(&pose, &atom_b, &origin, need);
            let swapped = atom_b.distance(&origin, &atom_a, &pose, need);
            assert!(
                found == swapped || (found - swapped).abs() < 1e-12,
                "case {case}: {found} and {swapped}"
            );
            // Parry errs by 20 um where they are parallel.
            let parry = ExactShape::new(&a).signed_distance(&pose, &ExactShape::new(&b), &origin, 10.0);
            assert!(parry < 0.0 || found < parry + 1e-4, "case {case}: {found} exceeds {parry}");
            let (radius, half, inwards) = match &a.shape {
                Shape::Cylinder { radius, half_length } => (*radius, *half_length, pose.inverse() * origin),
                _ => unreachable!(),
            };
            let (thick, reach) = match &b.shape {
                Shape::Capsule { radius, half_length } => (*radius, *half_length),
                Shape::Sphere { radius } => (*radius, 0.0),
                _ => unreachable!(),
            };
            let truth = (0..=2000).map(|i| {
                let p = inwards * nalgebra::Point3::new(0.0, 0.0, reach * (f64::from(i) / 1000.0 - 1.0));
                let (beside, beyond) = ((p.x.hypot(p.y) - radius).max(0.0), (p.z.abs() - half).max(0.0));
                beside.hypot(beyond) - thick
            });
            let truth = truth.fold(f64::INFINITY, f64::min);
            if truth > 1e-5 {
                assert!(found <= truth + 1e-9, "case {case}: {found} exceeds {truth}");
                assert!(found >= need || found > truth - 1e-5, "case {case}: {found} is not {truth}");
                apart += 1;
            } else if truth < -1e-5 {
                assert!(found < 0.0, "case {case}: overlap missed, {found} against {truth}");
                overlapping += 1;
            } else {
                touching += 1;
            }
        }
        assert!(apart > 10_000 && overlapping > 500 && touching < 100, "{apart} {overlapping} {touching}");
    }

    #[test]
    fn boxes_that_only_almost_parallel_edges_separate_are_apart() {
        let half = Vec3::new(0.5, 0.02, 0.02);
        let atom =
            Atom::new(&PlacedShape { shape: Shape::Box { half_extents: half }, pose: Pose::identity() });
        let roll = |yaw: f64, height: f64| {
            let turn = nalgebra::UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_4, 0.0, 0.0);
            let yaw = nalgebra::UnitQuaternion::from_axis_angle(&Vec3::z_axis(), yaw);
            Pose::from_parts(Vec3::new(0.0, 0.0, height).into(), yaw * turn)
        };
        // Edge on edge: the lower one's upper edge stands 0.02 sqrt 2 above its middle.
        let touching = 2.0 * 0.02 * 2.0_f64.sqrt();
        for yaw in [1e-7, 1e-5, 9e-4, 5e-3, 0.3] {
            for gap in [1e-4, 3e-4, 5e-3] {
                let (below, above) = (roll(0.0, 0.0), roll(yaw, touching + gap));
                let found = atom.separation(&atom.placed(&below), &atom, &atom.placed(&above), 0.0);
                assert!(found >= 0.0, "yaw {yaw}: {found} at {gap}");
                // How far apart they are is left to parry, which errs by up to a tenth upwards here.
                let close = atom.separation(&atom.placed(&below), &atom, &atom.placed(&above), 0.1);
                assert!(close > gap - 1e-6, "yaw {yaw}: {close} at {gap}");
            }
        }
    }
}
