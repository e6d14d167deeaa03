//! Joints that follow cubics: where they are in the middle of an interval, and how far they stray from there.

use super::mover::Samples;
use crate::collision::certify::JointMotion;
use crate::geometry::lanes::Float8;

/// Joints side by side in one row.
const ROW: usize = 8;

/// A row of a segment: positions, velocities, and the coefficients of the square and the cube, on the segment's own
/// clock; as tables of curves have it.
pub type CubicRow = [[f32; ROW]; 4];

/// Relative and absolute (rad or m) rounding of single precision, added to what joints stray.
const ROUNDING: (f32, f32) = (1.0 + 1e-5, 3e-7);

/// Joints that follow a cubic in each of some segments. Before the first and after the last they stand still.
#[derive(Debug, Clone, Copy)]
pub struct Cubics<'a> {
    /// Number of joints.
    pub joints: usize,
    /// When each segment starts, and when the last one ends (s); at least two, in order.
    pub times: &'a [f64],
    /// By segment, a row for each eight joints.
    pub rows: &'a [CubicRow],
    /// Whether only the middles of intervals count, as if nothing moved about them.
    pub instants: bool,
}

/// Samples a motion; the same as its own [`JointMotion::sample`] up to rounding, in the lanes at hand.
#[inline(always)]
pub(super) fn sample<F: Float8>(motion: &dyn JointMotion, intervals: &[(f64, f64); 8], out: &mut Samples) {
    match motion.cubics() {
        Some(cubics) => cubics.sample::<F>(intervals, out),
        None => motion.sample(intervals, out),
    }
}

impl Cubics<'_> {
    /// Joint values in the middle of each interval, and for each joint a bound on how far it is from there anywhere in
    /// it (rad or m).
    #[inline(always)]
    pub(in crate::collision) fn sample<F: Float8>(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        out.resize(self.joints);
        let (values, deviations) = (out.values.as_mut_slice(), out.deviations.as_mut_slice());
        let segments = self.times.len() - 1;
        let (begin, end) = (self.times[0], self.times[segments]);
        let blocks = self.joints.div_ceil(ROW);
        if blocks == 1 && self.sample_one_segment::<F>(intervals, values, deviations) {
            return;
        }
        let mut first = 0;
        for (lane, &(from, to)) in intervals.iter().enumerate() {
            if lane > 0 && intervals[lane - 1] == (from, to) {
                for row in values.iter_mut().chain(deviations.iter_mut()) {
                    row[lane] = row[lane - 1];
                }
                continue;
            }
            let middle = ((from + to) / 2.0).clamp(begin, end);
            let (from, to) =
                if self.instants { (middle, middle) } else { (from.clamp(begin, end), to.clamp(begin, end)) };
            first = self.segment(from, first);
            let mut centre = first;
            while centre + 1 < segments && self.times[centre + 1] <= middle {
                centre += 1;
            }
            let at_middle = F::splat((middle - self.times[centre]) as f32);
            for block in 0..blocks {
                let value = position(&load::<F>(&self.rows[centre * blocks + block]), at_middle);
                let mut stray = F::splat(0.0);
                if !self.instants {
                    let mut segment = first;
                    loop {
                        let (start, stop) = (self.times[segment], self.times[segment + 1]);
                        let span =
                            [from.max(start), to.min(stop)].map(|t| F::splat((t - start) as f32)).into();
                        stray = widened(&load::<F>(&self.rows[segment * blocks + block]), span, value, stray);
                        segment += 1;
                        if segment >= segments || self.times[segment] >= to {
                            break;
                        }
                    }
                    stray = stray.mul_add(F::splat(ROUNDING.0), F::splat(ROUNDING.1));
                }
                let (value, stray) = (value.store(), stray.store());
                let rows = values.iter_mut().zip(deviations.iter_mut()).skip(block * ROW);
                for ((values, deviations), (value, stray)) in rows.zip(value.into_iter().zip(stray)) {
                    (values[lane], deviations[lane]) = (value, stray);
                }
            }
        }
    }

    /// [`Self::sample`] where all intervals are within one segment: joint by joint, with nothing to be turned about.
    #[inline(always)]
    fn sample_one_segment<F: Float8>(
        &self,
        intervals: &[(f64, f64); 8],
        values: &mut [[f32; 8]],
        deviations: &mut [[f32; 8]],
    ) -> bool {
        let ends = intervals.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (from, to)| {
            (low.min(*from), high.max(*to))
        });
        let last = self.times.len() - 1;
        let clamp = |t: f64| t.clamp(self.times[0], self.times[last]);
        let segment = self.segment(clamp(ends.0), 0);
        if clamp(ends.1) > self.times[segment + 1] {
            return false;
        }
        let start = self.times[segment];
        let (mut from, mut middle, mut to) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for (lane, interval) in intervals.iter().enumerate() {
            from[lane] = (clamp(interval.0) - start) as f32;
            middle[lane] = (clamp((interval.0 + interval.1) / 2.0) - start) as f32;
            to[lane] = (clamp(interval.1) - start) as f32;
        }
        let (from, middle, to) = (F::load(&from), F::load(&middle), F::load(&to));
        let row = &self.rows[segment];
        for (joint, (values, deviations)) in values.iter_mut().zip(deviations).enumerate() {
            let cubic = [0, 1, 2, 3].map(|k| F::splat(row[k][joint]));
            let value = position(&cubic, middle);
            *values = value.store();
            *deviations = if self.instants {
                [0.0; 8]
            } else {
                let stray = widened(&cubic, (from, to), value, F::splat(0.0));
                stray.mul_add(F::splat(ROUNDING.0), F::splat(ROUNDING.1)).store()
            };
        }
        true
    }

    /// The segment that holds `t`, which is not before the start; `hint` is looked at first.
    #[inline(always)]
    fn segment(&self, t: f64, hint: usize) -> usize {
        let last = self.times.len() - 2;
        let mut at = hint.min(last);
        if self.times[at] > t || at + 8 < last && self.times[at + 8] < t {
            at = self.times.partition_point(|start| *start <= t).clamp(1, last + 1) - 1;
        }
        while at < last && self.times[at + 1] <= t {
            at += 1;
        }
        at
    }
}

#[inline(always)]
fn load<F: Float8>(row: &CubicRow) -> [F; 4] {
    [F::load(&row[0]), F::load(&row[1]), F::load(&row[2]), F::load(&row[3])]
}

#[inline(always)]
fn position<F: Float8>([q, v, square, cube]: &[F; 4], t: F) -> F {
    cube.mul_add(t, *square).mul_add(t, *v).mul_add(t, *q)
}

/// `stray` widened to how far the cubics are from `value` on `[t0, t1]`: no farther than the control points of their
/// Bernstein forms there.
#[inline(always)]
fn widened<F: Float8>(row: &[F; 4], (t0, t1): (F, F), value: F, stray: F) -> F {
    let [_, v, square, cube] = row;
    let third = (t1 - t0).max(F::splat(0.0)) * F::splat(1.0 / 3.0);
    let speed = |t: F| cube.mul_add(t * F::splat(3.0), *square + *square).mul_add(t, *v);
    let (a, d) = (position(row, t0) - value, position(row, t1) - value);
    let (b, c) = (speed(t0).mul_add(third, a), speed(t1).neg_mul_add(third, d));
    stray.max(a.abs()).max(b.abs()).max(c.abs()).max(d.abs())
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::geometry::lanes::{InstructionSet, Kernel};
    use crate::run::Seed;

    struct Sampling<'a>(Cubics<'a>, &'a [(f64, f64); 8]);

    impl Kernel for Sampling<'_> {
        type Output = Samples;

        #[inline(always)]
        fn run<F: Float8>(self) -> Samples {
            let mut found = Samples::default();
            self.0.sample::<F>(self.1, &mut found);
            found
        }
    }

    #[test]
    fn nothing_strays_farther_than_is_said() {
        let mut rng = Seed(41).stream("cubics");
        for case in 0..400 {
            let (joints, segments) = ([1_usize, 7, 8, 12][case % 4], rng.random_range(1..20));
            let blocks = joints.div_ceil(ROW);
            let mut times = vec![rng.random_range(-2.0..2.0)];
            for _ in 0..segments {
                times.push(times[times.len() - 1] + rng.random_range(0.02..0.8));
            }
            let rows: Vec<CubicRow> = (0..segments * blocks)
                .map(|_| {
                    [2.0, 1.0, 1.5, 3.0].map(|size| std::array::from_fn(|_| rng.random_range(-size..size)))
                })
                .collect();
            let (begin, end) = (times[0], times[segments]);
            let truth = |t: f64, joint: usize, segment: usize| {
                let row = &rows[segment * blocks + joint / ROW];
                let [q, v, square, cube] = [0, 1, 2, 3].map(|k| f64::from(row[k][joint % ROW]));
                let t = t - times[segment];
                q + t * (v + t * (square + t * cube))
            };
            let holds = |t: f64| (times[1..segments].partition_point(|start| *start <= t)).min(segments - 1);
            let intervals: [(f64, f64); 8] = std::array::from_fn(|lane| {
                let from = rng.random_range(begin - 0.5..end + 0.5);
                (from, from + [1e-4, 0.03, 0.3, 2.0][lane % 4])
            });
            for set in [InstructionSet::best(), InstructionSet::portable()] {
                let cubics = Cubics { joints, times: &times, rows: &rows, instants: false };
                let found = set.run(Sampling(cubics, &intervals));
                let still = set.run(Sampling(Cubics { instants: true, ..cubics }, &intervals));
                for (lane, (from, to)) in intervals.into_iter().enumerate() {
                    let middle = ((from + to) / 2.0).clamp(begin, end);
                    let (from, to) = (from.clamp(begin, end), to.clamp(begin, end));
                    for joint in 0..joints {
                        let (value, stray) = (found.values[joint][lane], found.deviations[joint][lane]);
                        let centre = truth(middle, joint, holds(middle));
                        assert!((f64::from(value) - centre).abs() < 1e-5);
                        assert_eq!((still.values[joint][lane], still.deviations[joint][lane]), (value, 0.0));
                        for segment in 0..segments {
                            let (start, stop) = (from.max(times[segment]), to.min(times[segment + 1]));
                            for part in 0..=10 {
                                let t = start + (stop - start) * f64::from(part) / 10.0;
                                if start <= stop && t < end {
                                    let away = (truth(t, joint, segment) - centre).abs();
                                    assert!(away <= f64::from(stray) + 3e-6, "{away} {stray}");
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
