//! Pairs of shapes.

// Lanes are counted: the same index goes through several arrays at once.
#![allow(clippy::needless_range_loop)]

use std::hint::black_box;

use parry3d_f64::math::{Pose as ParryPose, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::{Capsule, Cuboid};
use rand::Rng as _;

use crate::geometry::Vec3;
use crate::geometry::lanes::{
    Float8, InstructionSet, Kernel, Segment8, V3, segment_box_outside, segment_box_squared,
    segment_segment_squared,
};
use crate::run::Rng;

/// Blocks of eight in the batches of the narrow phase.
const BLOCKS: usize = 32;

/// Segments of eight cases: start and direction, by component.
type Segments = Vec<[[f32; 8]; 6]>;

/// Length (m) of the segments' axes and radius of the capsules around them.
const LENGTH: f32 = 0.4;
const RADIUS: f32 = 0.1;

struct Pairs<'a>(&'a Segments, &'a Segments);
struct InBox<'a>(&'a Segments, [f32; 3]);

#[inline(always)]
fn segment<F: Float8>(numbers: &[[f32; 8]; 6]) -> Segment8<F> {
    let vector = |at: usize| -> V3<F> {
        [F::load(&numbers[at]), F::load(&numbers[at + 1]), F::load(&numbers[at + 2])]
    };
    Segment8::with_length(vector(0), vector(3), LENGTH)
}

impl Kernel for Pairs<'_> {
    type Output = u32;
    #[inline(always)]
    fn run<F: Float8>(self) -> u32 {
        let limit = F::splat(4.0 * RADIUS * RADIUS);
        let mut hits = 0;
        for (p, q) in self.0.iter().zip(self.1) {
            hits += F::bits(segment_segment_squared::<F>(&segment(p), &segment(q)).less(limit)).count_ones();
        }
        hits
    }
}

impl Kernel for InBox<'_> {
    type Output = u32;
    #[inline(always)]
    fn run<F: Float8>(self) -> u32 {
        let limit = F::splat(RADIUS * RADIUS);
        let half = [F::splat(self.1[0]), F::splat(self.1[1]), F::splat(self.1[2])];
        let mut hits = 0;
        for p in self.0 {
            let segment = segment::<F>(p);
            if F::bits(segment_box_outside(&segment, &half).less(limit)) != 0 {
                hits += F::bits(segment_box_squared(&segment, &half).less(limit)).count_ones();
            }
        }
        hits
    }
}

fn random_segments(rng: &mut Rng) -> Segments {
    (0..BLOCKS)
        .map(|_| {
            let mut block = [[0.0; 8]; 6];
            for lane in 0..8 {
                let mut r = || rng.random_range(-1.0..1.0_f32);
                let (start, along) = ([r(), r(), r()], Vec3::new(r().into(), r().into(), r().into()));
                let along = along.normalize() * f64::from(LENGTH);
                for k in 0..3 {
                    block[k][lane] = start[k];
                    block[k + 3][lane] = along[k] as f32;
                }
            }
            block
        })
        .collect()
}

fn capsules(segments: &Segments) -> Vec<Capsule> {
    let number = |block: &[[f32; 8]; 6], k: usize, lane: usize| f64::from(block[k][lane]);
    let mut all = Vec::new();
    for block in segments {
        for lane in 0..8 {
            let start = Vector::new(number(block, 0, lane), number(block, 1, lane), number(block, 2, lane));
            let along = Vector::new(number(block, 3, lane), number(block, 4, lane), number(block, 5, lane));
            all.push(Capsule::new(start, start + along, f64::from(RADIUS)));
        }
    }
    all
}

/// Random capsules against capsules and a box, in lanes and by parry.
#[derive(Debug)]
pub struct Narrow {
    set: InstructionSet,
    segments: (Segments, Segments),
    capsules: (Vec<Capsule>, Vec<Capsule>),
    half: [f32; 3],
    cuboid: Cuboid,
}

impl Narrow {
    /// How many pairs each call looks at.
    pub const PAIRS: usize = 8 * BLOCKS;

    /// Draws the pairs.
    pub fn new(rng: &mut Rng) -> Self {
        let (p, q) = (random_segments(rng), random_segments(rng));
        let capsules = (capsules(&p), capsules(&q));
        let half = [0.3, 0.2, 0.4];
        let cuboid = Cuboid::new(Vector::new(half[0].into(), half[1].into(), half[2].into()));
        Self { set: InstructionSet::best(), segments: (p, q), capsules, half, cuboid }
    }

    /// Capsule against capsule.
    pub fn capsule_capsule(&self) -> u32 {
        self.set.run(Pairs(black_box(&self.segments.0), black_box(&self.segments.1)))
    }

    /// The same by parry.
    pub fn capsule_capsule_by_parry(&self) -> usize {
        let still = ParryPose::IDENTITY;
        let pairs = self.capsules.0.iter().zip(&self.capsules.1);
        let hit = |(a, b): &(&Capsule, &Capsule)| {
            query::intersection_test(&still, black_box(*a), &still, black_box(*b))
                .is_ok_and(|hit| hit.intersecting)
        };
        pairs.filter(hit).count()
    }

    /// Capsule against box.
    pub fn capsule_box(&self) -> u32 {
        self.set.run(InBox(black_box(&self.segments.0), black_box(self.half)))
    }

    /// The same by parry.
    pub fn capsule_box_by_parry(&self) -> usize {
        let still = ParryPose::IDENTITY;
        let hit = |a: &&Capsule| {
            query::intersection_test(&still, black_box(*a), &still, black_box(&self.cuboid))
                .is_ok_and(|hit| hit.intersecting)
        };
        self.capsules.0.iter().filter(hit).count()
    }
}
