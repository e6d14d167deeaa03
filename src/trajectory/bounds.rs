//! How fast and how far a curve moves: closed-form bounds for certification, and arc length.

use std::ops::Range;

use crate::kinematics::Config;

use super::hermite::Cubic;
use super::{Curve, CurvePoint};

/// Nodes and weights of the five-point Gauss-Legendre rule on [-1, 1].
const GAUSS: [(f64, f64); 5] = [
    (0.0, 0.568_888_888_888_888_9),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    (0.906_179_845_938_664, 0.236_926_885_056_189_08),
];

/// The same of the three-point rule.
const GAUSS_THREE: [(f64, f64); 3] = [
    (0.0, 0.888_888_888_888_889),
    (-0.774_596_669_241_483_4, 0.555_555_555_555_555_6),
    (0.774_596_669_241_483_4, 0.555_555_555_555_555_6),
];

/// Arc length is exact to about this (rad or m) on each segment.
const ARC_TOLERANCE: f64 = 1e-10;

/// Where the rules of three and of five points differ by less (rad or m), the latter is taken: mostly far more exact than
/// that, and less exact only where nearly all joints reverse within moments of each other.
const ALIKE: f64 = 1e-9;

/// Velocities count as along a way where no more than this part of them is aside.
const SIDEWAYS: f64 = 1e-7;

impl Curve {
    /// Calls `visit` with joint `joint` on every segment that meets `[t0, t1]` and the part of it,
    /// in the segment's own time.
    fn for_pieces(&self, joint: usize, t0: f64, t1: f64, mut visit: impl FnMut(&Cubic, f64, f64)) {
        if self.segments() == 0 {
            return;
        }
        let (t0, t1) = (t0.max(self.start_time()), t1.min(self.end_time()));
        let mut segment = self.segment_at(t0);
        while segment < self.segments() && self.points()[segment].t <= t1 {
            let (cubic, h) = self.cubic(segment, joint);
            let start = self.points()[segment].t;
            let (from, to) = ((t0 - start).clamp(0.0, h), (t1 - start).clamp(0.0, h));
            if from <= to {
                visit(&cubic, from, to);
            }
            segment += 1;
        }
    }

    /// Greatest |velocity| of `joint` between the times `t0` and `t1`, exactly.
    pub fn max_speed(&self, joint: usize, t0: f64, t1: f64) -> f64 {
        let mut most = 0.0_f64;
        self.for_pieces(joint, t0, t1, |cubic, from, to| most = most.max(cubic.max_speed(from, to)));
        most
    }

    /// Greatest |velocity| of every joint on the segments `range`, exactly.
    pub fn max_abs_speeds_on(&self, range: Range<usize>) -> Config {
        let range = range.start..range.end.min(self.segments());
        (0..self.joints())
            .map(|joint| {
                let speed = |segment| {
                    let (cubic, h) = self.cubic(segment, joint);
                    cubic.max_speed(0.0, h)
                };
                range.clone().map(speed).fold(0.0, f64::max)
            })
            .collect()
    }

    /// Least and greatest value of `joint` between the times `t0` and `t1`, exactly.
    pub fn joint_range(&self, joint: usize, t0: f64, t1: f64) -> (f64, f64) {
        let at = |t: f64| self.state_at(t).0[joint];
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        self.for_pieces(joint, t0, t1, |cubic, from, to| {
            let (low, high) = cubic.position_range(from, to);
            range = (range.0.min(low), range.1.max(high));
        });
        if range.0 > range.1 { (at(t0).min(at(t1)), at(t0).max(at(t1))) } else { range }
    }

    /// For every joint the greatest distance between its values at any two instants between `t0`
    /// and `t1`, exactly (rad or m).
    pub fn displacement_bounds(&self, t0: f64, t1: f64) -> Config {
        (0..self.joints())
            .map(|joint| {
                let (low, high) = self.joint_range(joint, t0, t1);
                high - low
            })
            .collect()
    }

    /// For every joint the greatest distance between its value at `t` and those between `t0` and
    /// `t1`, exactly (rad or m).
    pub fn displacement_from(&self, t: f64, t0: f64, t1: f64) -> Config {
        let centre = self.position_at(t);
        centre
            .iter()
            .enumerate()
            .map(|(joint, value)| {
                let (low, high) = self.joint_range(joint, t0, t1);
                (high - value).max(value - low).max(0.0)
            })
            .collect()
    }

    /// Euclidean length of the joint path.
    pub fn arc_length(&self) -> f64 {
        let mut cubics: Vec<Cubic> = Vec::with_capacity(self.joints());
        let mut cuts: Vec<f64> = Vec::with_capacity(2 + 2 * self.joints());
        let mut length = 0.0;
        for segment in 0..self.segments() {
            if let Some(straight) = straight_length(&self.points()[segment], &self.points()[segment + 1]) {
                length += straight;
                continue;
            }
            cubics.clear();
            cubics.extend((0..self.joints()).map(|joint| self.cubic(segment, joint).0));
            let h = self.points()[segment + 1].t - self.points()[segment].t;
            // The speed has kinks only where joints stand still.
            cuts.clear();
            cuts.extend([0.0, h]);
            cuts.extend(cubics.iter().flat_map(Cubic::standstills).filter(|t| *t > 0.0 && *t < h));
            cuts.sort_by(f64::total_cmp);
            for part in cuts.windows(2) {
                let (from, to) = (part[0], part[1]);
                let [three, five]: [f64; 2] =
                    [&GAUSS_THREE[..], &GAUSS].map(|rule| gauss_length(&cubics, from, to, rule));
                length += match (three - five).abs() <= ALIKE {
                    true => five,
                    false => refined_length(&cubics, from, to, five, 0),
                };
            }
        }
        length
    }
}

/// The length of a segment whose joints all go straight on from one point to the next and never back; `None` where they may
/// not. Both velocities lie along the way, and neither is more than three times what takes it there at an even pace, so
/// that the cubic ascends (Fritsch and Carlson 1980).
fn straight_length(from: &CurvePoint, to: &CurvePoint) -> Option<f64> {
    let square: f64 = from.q.iter().zip(&to.q).map(|(a, b)| (b - a).powi(2)).sum();
    let length = square.sqrt();
    let time = to.t - from.t;
    for speeds in [&from.qd, &to.qd] {
        let along: f64 = from.q.iter().zip(&to.q).zip(speeds).map(|((a, b), v)| (b - a) * v).sum();
        // In terms of the even pace.
        let pace = if square > 0.0 { along * time / square } else { 0.0 };
        let aside: f64 =
            from.q.iter().zip(&to.q).zip(speeds).map(|((a, b), v)| (v * time - (b - a) * pace).powi(2)).sum();
        // Aside by so little the way is longer by less than its tolerance, even where it comes to a stop.
        if !(0.0..=3.0).contains(&pace) || aside > SIDEWAYS * SIDEWAYS * square {
            return None;
        }
    }
    Some(length)
}

/// Length over `[from, to]` by one application of a rule.
fn gauss_length(cubics: &[Cubic], from: f64, to: f64, rule: &[(f64, f64)]) -> f64 {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let speed = |t: f64| cubics.iter().map(|cubic| cubic.velocity(t).powi(2)).sum::<f64>().sqrt();
    half * rule.iter().map(|(node, weight)| weight * speed(middle + half * node)).sum::<f64>()
}

/// Length over `[from, to]`, halved until two halves agree with the whole.
fn refined_length(cubics: &[Cubic], from: f64, to: f64, whole: f64, depth: usize) -> f64 {
    let middle = 0.5 * (from + to);
    let [left, right] = [(from, middle), (middle, to)].map(|(a, b)| gauss_length(cubics, a, b, &GAUSS));
    if depth >= 24 || (left + right - whole).abs() <= ARC_TOLERANCE {
        return left + right;
    }
    refined_length(cubics, from, middle, left, depth + 1)
        + refined_length(cubics, middle, to, right, depth + 1)
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::run::Seed;

    #[test]
    fn ways_count_as_straight_only_where_they_are() {
        let mut rng = Seed(12).stream("straight");
        let (mut straight, mut others) = (0, 0);
        for case in 0..2000 {
            let time = rng.random_range(0.01..3.0);
            let way: [f64; 4] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let norm = way.iter().map(|d| d * d).sum::<f64>().sqrt();
            // Square to the way.
            let square = [way[1], -way[0], way[3], -way[2]];
            let mut point = |t: f64, part: f64| {
                let pace = [0.0, 3.0, 2.9, rng.random_range(-0.5..3.5)][rng.random_range(0..4)];
                let aside = [0.0, 0.9 * SIDEWAYS, 1.1 * SIDEWAYS][case % 3];
                let qd = (0..4).map(|k| (way[k] * pace + square[k] * aside) / time).collect();
                CurvePoint { t, q: way.iter().map(|d| 0.2 + d * part).collect(), qd }
            };
            let (from, to) = (point(0.0, 0.0), point(time, 1.0));
            let Some(found) = straight_length(&from, &to) else {
                others += 1;
                continue;
            };
            straight += 1;
            assert!((found - norm).abs() < 1e-12);
            let curve = Curve::new(vec![from, to]).unwrap();
            let cubics: Vec<Cubic> = (0..4).map(|joint| curve.cubic(0, joint).0).collect();
            let whole = gauss_length(&cubics, 0.0, time, &GAUSS);
            let refined = refined_length(&cubics, 0.0, time, whole, 0);
            assert!((found - refined).abs() < 3e-9, "{found} {refined}");
        }
        assert!(straight > 400 && others > 400, "{straight} {others}");
    }
}
