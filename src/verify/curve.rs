//! An arm's curve: the cubic Hermite interpolant of its points, with its extrema.

use crate::plan::ArmTrajectory;

/// The polynomial of one joint on one segment, in seconds since the segment's start:
/// `c[0] + c[1] s + c[2] s^2 + c[3] s^3`.
type Cubic = [f64; 4];

/// The greatest magnitude of something along a curve, and when it is met.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// The magnitude.
    pub value: f64,
    /// Time (s).
    pub t: f64,
}

impl Peak {
    fn none(t: f64) -> Self {
        Self { value: 0.0, t }
    }

    /// Takes over a greater magnitude; one that is not a number counts as infinite.
    fn raise(&mut self, value: f64, t: f64) {
        let value = if value.is_nan() { f64::INFINITY } else { value };
        if value > self.value {
            *self = Self { value, t };
        }
    }
}

/// One arm's trajectory as a piecewise cubic.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    dof: usize,
    /// Times of the points (s); at least two, increasing.
    times: Vec<f64>,
    /// Per segment and joint, segment-major.
    cubics: Vec<Cubic>,
    /// Per segment and joint: bounds of the joint's value, segment-major.
    ranges: Vec<[f64; 2]>,
}

fn value(c: &Cubic, s: f64) -> f64 {
    c[0] + s * (c[1] + s * (c[2] + s * c[3]))
}

fn slope(c: &Cubic, s: f64) -> f64 {
    c[1] + s * (2.0 * c[2] + s * 3.0 * c[3])
}

fn bend(c: &Cubic, s: f64) -> f64 {
    2.0 * c[2] + 6.0 * c[3] * s
}

/// Bounds of the cubic on `[s0, s1]`: the hull of its Bezier points there.
fn hull(c: &Cubic, s0: f64, s1: f64) -> [f64; 2] {
    let third = (s1 - s0) / 3.0;
    let first = value(c, s0);
    let last = value(c, s1);
    let second = first + third * slope(c, s0);
    let before_last = last - third * slope(c, s1);
    [first.min(second).min(before_last.min(last)), first.max(second).max(before_last.max(last))]
}

/// Where the cubic's slope is zero, in seconds since the segment's start; up to two values.
fn turning_points(c: &Cubic) -> [Option<f64>; 2] {
    // 3 c3 s^2 + 2 c2 s + c1 = 0, by the form that does not cancel.
    let (a, half_b, k) = (3.0 * c[3], c[2], c[1]);
    let discriminant = half_b * half_b - a * k;
    if discriminant < 0.0 || discriminant.is_nan() {
        return [None, None];
    }
    let root = -(half_b + half_b.signum() * discriminant.sqrt());
    [Some(root / a).filter(|s| s.is_finite()), Some(k / root).filter(|s| s.is_finite())]
}

impl Curve {
    /// The curve through the points of `trajectory`, of which every point has `dof` values; the
    /// structure has been checked before.
    pub(super) fn new(trajectory: &ArmTrajectory, dof: usize) -> Self {
        let times: Vec<f64> = trajectory.points.iter().map(|point| point.t).collect();
        let mut cubics = Vec::with_capacity(times.len().saturating_sub(1) * dof);
        let mut ranges = Vec::with_capacity(cubics.capacity());
        for pair in trajectory.points.windows(2) {
            let [from, to] = pair else { continue };
            let h = to.t - from.t;
            for joint in 0..dof {
                let (q0, v0, q1, v1) = (from.q[joint], from.qd[joint], to.q[joint], to.qd[joint]);
                let rise = (q1 - q0) / h;
                let c = [q0, v0, (3.0 * rise - 2.0 * v0 - v1) / h, (v0 + v1 - 2.0 * rise) / (h * h)];
                ranges.push(hull(&c, 0.0, h));
                cubics.push(c);
            }
        }
        Self { dof, times, cubics, ranges }
    }

    /// When it ends (s).
    pub(super) fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// Number of segments.
    pub(super) fn segments(&self) -> usize {
        self.times.len().saturating_sub(1)
    }

    /// The segment that holds `t`, the later one at a point.
    fn segment_at(&self, t: f64) -> usize {
        let after = self.times.partition_point(|&time| time <= t);
        after.saturating_sub(1).min(self.segments().saturating_sub(1))
    }

    /// How many segments meet `[a, b]`.
    pub(super) fn segments_between(&self, a: f64, b: f64) -> u64 {
        (self.segment_at(b) - self.segment_at(a)) as u64 + 1
    }

    fn cubics_of(&self, segment: usize) -> &[Cubic] {
        &self.cubics[segment * self.dof..(segment + 1) * self.dof]
    }

    /// Start and length of a segment (s).
    fn span(&self, segment: usize) -> (f64, f64) {
        (self.times[segment], self.times[segment + 1] - self.times[segment])
    }

    /// Joint values at `t`, written to `out`.
    pub(super) fn position(&self, t: f64, out: &mut Vec<f64>) {
        out.clear();
        let segment = self.segment_at(t);
        let (start, length) = self.span(segment);
        let s = (t - start).clamp(0.0, length);
        out.extend(self.cubics_of(segment).iter().map(|c| value(c, s)));
    }

    /// For every joint how far it gets from its value in `middle` while time runs over `[a, b]`,
    /// at most; written to `out`.
    pub(super) fn excursions(&self, a: f64, b: f64, middle: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.resize(self.dof, 0.0);
        let (first, last) = (self.segment_at(a), self.segment_at(b));
        for segment in first..=last {
            let (start, length) = self.span(segment);
            let whole = a <= start && start + length <= b;
            let (s0, s1) = ((a - start).clamp(0.0, length), (b - start).clamp(0.0, length));
            if s1 <= s0 && first != last {
                continue;
            }
            let from = segment * self.dof;
            for joint in 0..self.dof {
                let [low, high] =
                    if whole { self.ranges[from + joint] } else { hull(&self.cubics[from + joint], s0, s1) };
                let off = (middle[joint] - low).max(high - middle[joint]);
                out[joint] = out[joint].max(off);
            }
        }
        // Rounding of values near 1 stays below this.
        for off in out.iter_mut() {
            *off = if *off <= 1e-14 { 0.0 } else { *off + 1e-15 };
        }
    }

    /// Calls `visit` with every segment that meets `[a, b]` and the part of it that does.
    fn for_each_part(&self, a: f64, b: f64, mut visit: impl FnMut(usize, f64, f64, f64)) {
        for segment in self.segment_at(a)..=self.segment_at(b) {
            let (start, length) = self.span(segment);
            visit(segment, start, (a - start).clamp(0.0, length), (b - start).clamp(0.0, length));
        }
    }

    /// The greatest joint speed over `[a, b]`, over all joints.
    pub(super) fn peak_speed(&self, a: f64, b: f64) -> Peak {
        let mut peak = Peak::none(a);
        self.for_each_part(a, b, |segment, start, s0, s1| {
            for c in self.cubics_of(segment) {
                for s in [s0, s1] {
                    peak.raise(slope(c, s).abs(), start + s);
                }
                let flat = -c[2] / (3.0 * c[3]);
                if flat > s0 && flat < s1 {
                    peak.raise(slope(c, flat).abs(), start + flat);
                }
            }
        });
        peak
    }

    /// By how much joint `joint` leaves `[lower, upper]`, at most, and when it first does by more
    /// than `tolerance`.
    pub(super) fn peak_outside(&self, joint: usize, lower: f64, upper: f64, tolerance: f64) -> (Peak, f64) {
        self.scan(joint, tolerance, |c, length| {
            let turns = turning_points(c);
            let inner = turns.map(|s| s.filter(|s| *s > 0.0 && *s < length));
            let at = |s: f64| (s, (value(c, s) - upper).max(lower - value(c, s)));
            [Some(at(0.0)), inner[0].map(at), inner[1].map(at), Some(at(length))]
        })
    }

    /// The greatest speed of joint `joint`, and when it first exceeds `bound`.
    pub(super) fn peak_joint_speed(&self, joint: usize, bound: f64) -> (Peak, f64) {
        self.scan(joint, bound, |c, length| {
            let flat = Some(-c[2] / (3.0 * c[3])).filter(|s| *s > 0.0 && *s < length);
            let at = |s: f64| (s, slope(c, s).abs());
            [Some(at(0.0)), flat.map(at), None, Some(at(length))]
        })
    }

    /// The greatest acceleration of joint `joint`, and when it first exceeds `bound`.
    pub(super) fn peak_joint_acceleration(&self, joint: usize, bound: f64) -> (Peak, f64) {
        self.scan(joint, bound, |c, length| {
            let at = |s: f64| (s, bend(c, s).abs());
            [Some(at(0.0)), None, None, Some(at(length))]
        })
    }

    /// Runs over all segments of a joint; `candidates` gives the extrema of one.
    fn scan(
        &self,
        joint: usize,
        bound: f64,
        candidates: impl Fn(&Cubic, f64) -> [Option<(f64, f64)>; 4],
    ) -> (Peak, f64) {
        let mut peak = Peak::none(0.0);
        let mut first = f64::INFINITY;
        for segment in 0..self.segments() {
            let (start, length) = self.span(segment);
            let c = &self.cubics[segment * self.dof + joint];
            for (s, magnitude) in candidates(c, length).into_iter().flatten() {
                peak.raise(magnitude, start + s);
                if (magnitude > bound || magnitude.is_nan()) && start + s < first {
                    first = start + s;
                }
            }
        }
        (peak, first)
    }

    /// The second derivative of joint `joint` just after point `index` (just before, at the last).
    pub(super) fn acceleration_at_point(&self, index: usize, joint: usize) -> f64 {
        if index < self.segments() {
            bend(&self.cubics[index * self.dof + joint], 0.0)
        } else {
            let segment = self.segments() - 1;
            bend(&self.cubics[segment * self.dof + joint], self.span(segment).1)
        }
    }

    /// The Euclidean length of the joint path, to about 1e-10 of itself.
    pub(super) fn arc_length(&self) -> f64 {
        let mut total = 0.0;
        for segment in 0..self.segments() {
            let (_, length) = self.span(segment);
            let cubics = self.cubics_of(segment);
            let speed = |s: f64| cubics.iter().map(|c| slope(c, s).powi(2)).sum::<f64>().sqrt();
            let whole = gauss(&speed, 0.0, length);
            total += refine(&speed, 0.0, length, whole, 14);
        }
        total
    }
}

/// Gauss-Legendre quadrature with five nodes.
fn gauss(f: &impl Fn(f64) -> f64, a: f64, b: f64) -> f64 {
    const NODES: [(f64, f64); 2] = [
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
        (0.906_179_845_938_664, 0.236_926_885_056_189_08),
    ];
    let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
    let mut sum = 0.568_888_888_888_888_9 * f(middle);
    for (node, weight) in NODES {
        sum += weight * (f(middle - half * node) + f(middle + half * node));
    }
    sum * half
}

/// Halves the interval until the quadrature agrees with itself.
fn refine(f: &impl Fn(f64) -> f64, a: f64, b: f64, whole: f64, depth: u32) -> f64 {
    let middle = 0.5 * (a + b);
    let (left, right) = (gauss(f, a, middle), gauss(f, middle, b));
    if depth == 0 || (left + right - whole).abs() <= 1e-10 * (left + right) + 1e-14 {
        return left + right;
    }
    refine(f, a, middle, left, depth - 1) + refine(f, middle, b, right, depth - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::TrajectoryPoint;

    fn point(t: f64, q: &[f64], qd: &[f64]) -> TrajectoryPoint {
        TrajectoryPoint { t, q: q.to_vec(), qd: qd.to_vec(), qdd: vec![0.0; q.len()] }
    }

    fn wavy() -> Curve {
        let points = vec![
            point(0.0, &[0.0, 1.0], &[0.0, 0.0]),
            point(0.7, &[1.0, 1.3], &[-2.0, 0.4]),
            point(1.1, &[0.4, -0.5], &[1.0, 3.0]),
            point(3.0, &[0.5, 0.2], &[0.0, 0.0]),
        ];
        Curve::new(&ArmTrajectory { points }, 2)
    }

    #[test]
    fn passes_through_its_points_with_their_velocity() {
        let curve = wavy();
        let mut q = Vec::new();
        curve.position(0.7, &mut q);
        assert!((q[0] - 1.0).abs() < 1e-12 && (q[1] - 1.3).abs() < 1e-12);
        let (mut before, mut after) = (Vec::new(), Vec::new());
        curve.position(0.7 - 1e-6, &mut before);
        curve.position(0.7 + 1e-6, &mut after);
        assert!(((after[0] - before[0]) / 2e-6 + 2.0).abs() < 1e-4);
    }

    #[test]
    fn extrema_bound_dense_samples_and_are_met() {
        let curve = wavy();
        for joint in 0..2 {
            let (speed, _) = curve.peak_joint_speed(joint, 0.0);
            let (high, _) = curve.peak_outside(joint, f64::NEG_INFINITY, 0.0, 0.0);
            let (mut sampled_speed, mut sampled_high) = (0.0_f64, 0.0_f64);
            let (mut q, mut last) = (Vec::new(), Vec::new());
            curve.position(0.0, &mut last);
            for i in 1..=30_000 {
                curve.position(f64::from(i) * 1e-4, &mut q);
                sampled_speed = sampled_speed.max((q[joint] - last[joint]).abs() / 1e-4);
                sampled_high = sampled_high.max(q[joint]);
                std::mem::swap(&mut q, &mut last);
            }
            assert!(sampled_speed <= speed.value + 1e-9 && sampled_speed > speed.value - 1e-2);
            assert!(sampled_high <= high.value + 1e-12 && sampled_high > high.value - 1e-6);
        }
    }

    #[test]
    fn excursions_hold_what_is_sampled() {
        let curve = wavy();
        let (mut q, mut middle, mut off) = (Vec::new(), Vec::new(), Vec::new());
        for (a, b) in [(0.0, 3.0), (0.1, 0.2), (0.65, 1.15), (0.7, 1.1), (2.0, 2.0)] {
            curve.position(0.5 * (a + b), &mut middle);
            curve.excursions(a, b, &middle, &mut off);
            for i in 0..=1000 {
                curve.position(a + (b - a) * f64::from(i) / 1000.0, &mut q);
                for joint in 0..2 {
                    assert!((q[joint] - middle[joint]).abs() <= off[joint] + 1e-14);
                }
            }
            assert!(b > a || off.iter().all(|&o| o == 0.0));
        }
    }

    #[test]
    fn arc_length_is_the_limit_of_chords() {
        let curve = wavy();
        let (mut q, mut last) = (Vec::new(), Vec::new());
        curve.position(0.0, &mut last);
        let mut chords = 0.0;
        for i in 1..=300_000 {
            curve.position(f64::from(i) * 1e-5, &mut q);
            chords += (q[0] - last[0]).hypot(q[1] - last[1]);
            std::mem::swap(&mut q, &mut last);
        }
        assert!((curve.arc_length() - chords).abs() < 1e-7 * chords);
    }
}
