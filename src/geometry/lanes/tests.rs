//! Every kernel on both instruction sets, against double precision and against parry.

// Lanes are counted: the same index goes through several arrays at once.
#![allow(clippy::needless_range_loop)]

use parry3d_f64::math::{Pose as ParryPose, Rotation, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::{Capsule, Cuboid};
use rand::Rng as _;

use super::*;
use crate::geometry::Vec3;
use crate::run::{Rng, Seed};

/// What single precision may err by (m) in scenes of this size; the planner allows for more.
const INFLATION: f64 = 1e-5;

/// Whether distances of axes agree. Below the least radius of a capsule (here 2 cm) it is their
/// squares that count, whose error the root makes larger.
fn agree(distance: f64, truth: f64) -> bool {
    let squares = (distance * distance - truth * truth).abs();
    (distance - truth).abs() < INFLATION || (truth < 0.02 && squares < 2.0 * 0.02 * INFLATION)
}

/// Blocks of eight cases for each kernel and instruction set: a million cases in all.
const BLOCKS: usize = 65_000;

type Numbers<const N: usize> = [[f32; 8]; N];

struct Segments<'a>(&'a Numbers<12>);
struct SegmentBox<'a>(&'a Numbers<9>);
struct Boxes<'a>(&'a Numbers<30>);
struct Angles<'a>(&'a Numbers<1>);

#[inline(always)]
fn vector<F: Float8, const N: usize>(numbers: &Numbers<N>, at: usize) -> V3<F> {
    [F::load(&numbers[at]), F::load(&numbers[at + 1]), F::load(&numbers[at + 2])]
}

impl Kernel for Segments<'_> {
    type Output = [f32; 8];
    #[inline(always)]
    fn run<F: Float8>(self) -> [f32; 8] {
        let p = Segment8::<F>::new(vector(self.0, 0), vector(self.0, 3));
        let q = Segment8::<F>::new(vector(self.0, 6), vector(self.0, 9));
        segment_segment_squared(&p, &q).sqrt().store()
    }
}

impl Kernel for SegmentBox<'_> {
    type Output = ([f32; 8], [f32; 8]);
    #[inline(always)]
    fn run<F: Float8>(self) -> Self::Output {
        let p = Segment8::<F>::new(vector(self.0, 0), vector(self.0, 3));
        let half = vector(self.0, 6);
        let outside = segment_box_outside(&p, &half).sqrt();
        (segment_box_squared(&p, &half).sqrt().store(), outside.store())
    }
}

impl Kernel for Boxes<'_> {
    type Output = [f32; 8];
    #[inline(always)]
    fn run<F: Float8>(self) -> [f32; 8] {
        let a = Box8::<F> {
            centre: vector(self.0, 0),
            axes: [vector(self.0, 3), vector(self.0, 6), vector(self.0, 9)],
            half: vector(self.0, 12),
        };
        let b = Box8::<F> {
            centre: vector(self.0, 15),
            axes: [vector(self.0, 18), vector(self.0, 21), vector(self.0, 24)],
            half: vector(self.0, 27),
        };
        box_box_gap(&a, &b).store()
    }
}

impl Kernel for Angles<'_> {
    type Output = ([f32; 8], [f32; 8]);
    #[inline(always)]
    fn run<F: Float8>(self) -> Self::Output {
        let (sine, cosine) = sin_cos(F::load(&self.0[0]));
        (sine.store(), cosine.store())
    }
}

fn sets() -> Vec<InstructionSet> {
    let mut sets = vec![InstructionSet::best(), InstructionSet::portable()];
    sets.dedup();
    sets
}

fn put<const N: usize>(numbers: &mut Numbers<N>, at: usize, lane: usize, v: &[f32]) {
    for (k, x) in v.iter().enumerate() {
        numbers[at + k][lane] = *x;
    }
}

fn read<const N: usize>(numbers: &Numbers<N>, at: usize, lane: usize) -> Vector {
    let x = |k: usize| f64::from(numbers[at + k][lane]);
    Vector::new(x(0), x(1), x(2))
}

/// A vector with components up to `size`, now and then with zeros, a point, or along an axis.
fn vector_of(rng: &mut Rng, size: f32) -> [f32; 3] {
    let mut v = [0.0; 3].map(|_: f32| rng.random_range(-size..size));
    match rng.random_range(0..12) {
        0 => v = [0.0; 3],
        1 => v[rng.random_range(0..3)] = 0.0,
        2 => {
            let kept = rng.random_range(0..3);
            for (k, x) in v.iter_mut().enumerate() {
                if k != kept {
                    *x = 0.0;
                }
            }
        }
        _ => {}
    }
    v
}

#[test]
fn capsules_agree_with_parry() {
    let mut rng = Seed(31).stream("capsules");
    let mut contacts = 0;
    for block in 0..BLOCKS {
        let mut numbers = [[0.0; 8]; 12];
        for lane in 0..8 {
            let along = vector_of(&mut rng, 0.5);
            put(&mut numbers, 0, lane, &vector_of(&mut rng, 0.6));
            put(&mut numbers, 3, lane, &along);
            put(&mut numbers, 6, lane, &vector_of(&mut rng, 0.6));
            // Parallel, or nearly so, now and then.
            let other = match rng.random_range(0..10) {
                0 => along.map(|x| x * rng.random_range(-1.0..1.0)),
                1 => along.map(|x| x + rng.random_range(-1e-4..1e-4)),
                _ => vector_of(&mut rng, 0.5),
            };
            put(&mut numbers, 9, lane, &other);
        }
        let found: Vec<[f32; 8]> = sets().into_iter().map(|set| set.run(Segments(&numbers))).collect();
        for lane in 0..8 {
            let (p, q) = (read(&numbers, 0, lane), read(&numbers, 6, lane));
            let (d, e) = (read(&numbers, 3, lane), read(&numbers, 9, lane));
            let radii = (rng.random_range(0.02..0.2), rng.random_range(0.02..0.2));
            // In double precision always, by parry for the verdict on an eighth of the cases.
            let truth = segments_apart(&p, &d, &q, &e);
            for distances in &found {
                let distance = f64::from(distances[lane]);
                assert!(agree(distance, truth), "{distance} {truth}");
            }
            if lane == block % 8 {
                let (a, b) = (Capsule::new(p, p + d, radii.0), Capsule::new(q, q + e, radii.1));
                let still = ParryPose::IDENTITY;
                let hit = query::intersection_test(&still, &a, &still, &b).unwrap().intersecting;
                contacts += usize::from(hit);
                for distances in &found {
                    let gap = f64::from(distances[lane]) - radii.0 - radii.1;
                    assert!(!hit || gap < INFLATION, "a contact was missed: {gap}");
                    assert!(hit || gap > -INFLATION, "a false contact: {gap}");
                }
            }
        }
    }
    assert!(contacts > BLOCKS / 20 && contacts < BLOCKS * 19 / 20, "{contacts}");
}

fn segments_apart(p: &Vector, d: &Vector, q: &Vector, e: &Vector) -> f64 {
    // Every clamped stationary point is a candidate: the inner one and the four ends.
    let at = |s: f64, t: f64| (*p + *d * s - *q - *e * t).length();
    let (a, b, c) = (d.dot(*d), d.dot(*e), e.dot(*e));
    let r = *p - *q;
    let nearest = |along: &Vector, square: f64, from: Vector| {
        if square > 0.0 { (along.dot(from) / square).clamp(0.0, 1.0) } else { 0.0 }
    };
    let mut least = f64::INFINITY;
    for s in [0.0, 1.0] {
        least = least.min(at(s, nearest(e, c, *p + *d * s - *q)));
    }
    for t in [0.0, 1.0] {
        least = least.min(at(nearest(d, a, *q + *e * t - *p), t));
    }
    let determinant = a * c - b * b;
    if determinant > 1e-14 * a * c {
        let s = (b * e.dot(r) - c * d.dot(r)) / determinant;
        let t = (a * e.dot(r) - b * d.dot(r)) / determinant;
        if (0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t) {
            least = least.min(at(s, t));
        }
    }
    least
}

#[test]
fn capsules_and_boxes_agree_with_parry() {
    let mut rng = Seed(32).stream("capsule box");
    let mut contacts = 0;
    for block in 0..BLOCKS {
        let mut numbers = [[0.0; 8]; 9];
        for lane in 0..8 {
            put(&mut numbers, 0, lane, &vector_of(&mut rng, 0.9));
            put(&mut numbers, 3, lane, &vector_of(&mut rng, 0.6));
            let half: [f32; 3] = [0.0; 3].map(|_: f32| rng.random_range(0.01..0.5));
            put(&mut numbers, 6, lane, &half);
        }
        let found: Vec<_> = sets().into_iter().map(|set| set.run(SegmentBox(&numbers))).collect();
        for lane in 0..8 {
            let (p, d, half) = (read(&numbers, 0, lane), read(&numbers, 3, lane), read(&numbers, 6, lane));
            let native = |v: Vector| Vec3::new(v.x, v.y, v.z);
            let truth = segment_box(&native(p), &native(p + d), &native(half));
            for (distances, outside) in &found {
                let distance = f64::from(distances[lane]);
                assert!(agree(distance, truth), "{distance} {truth} {p:?} {d:?} {half:?}");
                assert!(f64::from(outside[lane]) < truth + INFLATION, "culled what is near");
            }
            if lane == block % 8 {
                let radius = rng.random_range(0.02..0.2);
                let capsule = Capsule::new(p, p + d, radius);
                let still = ParryPose::IDENTITY;
                let hit = query::intersection_test(&still, &capsule, &still, &Cuboid::new(half));
                let hit = hit.unwrap().intersecting;
                contacts += usize::from(hit);
                for (distances, _) in &found {
                    let gap = f64::from(distances[lane]) - radius;
                    assert!(!hit || gap < INFLATION, "a contact was missed: {gap}");
                    assert!(hit || gap > -INFLATION, "a false contact: {gap}");
                }
            }
        }
    }
    assert!(contacts > BLOCKS / 20 && contacts < BLOCKS * 19 / 20, "{contacts}");
}

/// By golden section; the distance to a box is convex along a segment.
fn segment_box(a: &Vec3, b: &Vec3, half: &Vec3) -> f64 {
    let at = |t: f64| {
        let p = a + (b - a) * t;
        Vec3::from_fn(|k, _| (p[k].abs() - half[k]).max(0.0)).norm()
    };
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (0.0, 1.0);
    let (mut x, mut y) = (1.0 - golden, golden);
    let (mut at_x, mut at_y) = (at(x), at(y));
    for _ in 0..45 {
        if at_x <= at_y {
            (high, y, at_y) = (y, x, at_x);
            x = high - golden * (high - low);
            at_x = at(x);
        } else {
            (low, x, at_x) = (x, y, at_y);
            y = low + golden * (high - low);
            at_y = at(y);
        }
    }
    at_x.min(at_y).min(at(0.0)).min(at(1.0))
}

#[test]
fn gaps_between_boxes_are_bounds() {
    let mut rng = Seed(33).stream("boxes");
    let (mut contacts, mut cases) = (0, 0);
    for _ in 0..BLOCKS / 8 {
        let mut numbers = [[0.0; 8]; 30];
        let mut turns = [[Rotation::IDENTITY; 2]; 8];
        for lane in 0..8 {
            for (k, at) in [0, 15].into_iter().enumerate() {
                let mut r = || rng.random_range(-1.0..1.0_f64);
                let axis = Vec3::new(r(), r(), r());
                // Every fourth one straight.
                let angle = if lane % 4 == 0 { 0.0 } else { 3.0 * r() };
                let turn =
                    nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Unit::new_normalize(axis), angle);
                let matrix = turn.to_rotation_matrix();
                let c = turn.coords;
                turns[lane][k] = Rotation::from_xyzw(c.x, c.y, c.z, c.w);
                put(&mut numbers, at, lane, &vector_of(&mut rng, 0.5));
                for column in 0..3 {
                    let axis: Vec<f32> = matrix.matrix().column(column).iter().map(|x| *x as f32).collect();
                    put(&mut numbers, at + 3 + 3 * column, lane, &axis);
                }
                let half: [f32; 3] = [0.0; 3].map(|_: f32| rng.random_range(0.01..0.3));
                put(&mut numbers, at + 12, lane, &half);
            }
        }
        let found: Vec<_> = sets().into_iter().map(|set| set.run(Boxes(&numbers))).collect();
        for lane in 0..8 {
            let place = |at: usize, k: usize| {
                (
                    ParryPose::from_parts(read(&numbers, at, lane), turns[lane][k]),
                    Cuboid::new(read(&numbers, at + 12, lane)),
                )
            };
            let ((pa, a), (pb, b)) = (place(0, 0), place(15, 1));
            let distance = query::distance(&pa, &a, &pb, &b).unwrap().distance;
            contacts += usize::from(distance == 0.0);
            cases += 1;
            for gaps in &found {
                let gap = f64::from(gaps[lane]);
                assert!(gap < distance + INFLATION, "{gap} {distance}");
                // Boxes that are apart have an axis that says so.
                assert!(distance < INFLATION || gap > -INFLATION, "{gap} {distance}");
                assert!(gap > distance / 3.0_f64.sqrt() - INFLATION || distance == 0.0, "{gap} {distance}");
            }
        }
    }
    assert!(contacts > cases / 20 && contacts < cases * 19 / 20, "{contacts}");
}

#[test]
fn sines_and_cosines_agree() {
    let mut rng = Seed(34).stream("angles");
    for _ in 0..BLOCKS {
        let size = [3.2_f32, 7.0, 200.0][rng.random_range(0..3)];
        let numbers = [[0.0; 8].map(|_: f32| rng.random_range(-size..size))];
        for set in sets() {
            let (sine, cosine) = set.run(Angles(&numbers));
            for lane in 0..8 {
                let (s, c) = f64::from(numbers[0][lane]).sin_cos();
                assert!((f64::from(sine[lane]) - s).abs() < 2e-7, "{}", numbers[0][lane]);
                assert!((f64::from(cosine[lane]) - c).abs() < 2e-7, "{}", numbers[0][lane]);
            }
        }
    }
}
