//! A curve's coefficients laid out for being asked often: where the joints are in the middle of an
//! interval, and how far they stray from there.

use super::Curve;

/// Joints side by side in one row.
const ROW: usize = 8;

/// Relative and absolute (rad or m) rounding of single precision, added to what joints stray.
const ROUNDING: (f32, f32) = (1.0 + 1e-5, 3e-7);

/// A [`Curve`] in single precision, for sampling.
#[derive(Debug, Clone)]
pub struct CurveTable {
    joints: usize,
    /// When each segment starts, and when the last one ends (s).
    times: Vec<f64>,
    /// By segment, for each eight joints: position, velocity, and the coefficients of the square and the
    /// cube, on the segment's own clock.
    rows: Vec<[[f32; ROW]; 4]>,
    /// Joint values at the start, for a curve without segments.
    start: Vec<f32>,
}

impl CurveTable {
    /// Lays out `curve`.
    pub fn new(curve: &Curve) -> Self {
        let joints = curve.joints();
        let times = curve.points().iter().map(|point| point.t).collect();
        let mut rows = Vec::with_capacity(curve.segments() * joints.div_ceil(ROW));
        for pair in curve.points().windows(2) {
            let per_second = 1.0 / (pair[1].t - pair[0].t);
            for first in (0..joints).step_by(ROW) {
                let mut row = [[0.0; ROW]; 4];
                for joint in first..joints.min(first + ROW) {
                    let (q0, v0) = (pair[0].q[joint], pair[0].qd[joint]);
                    let (q1, v1) = (pair[1].q[joint], pair[1].qd[joint]);
                    let slope = (q1 - q0) * per_second;
                    let square = (3.0 * slope - 2.0 * v0 - v1) * per_second;
                    let cube = (v0 + v1 - 2.0 * slope) * per_second * per_second;
                    for (k, value) in [q0, v0, square, cube].into_iter().enumerate() {
                        row[k][joint - first] = value as f32;
                    }
                }
                rows.push(row);
            }
        }
        Self { joints, times, rows, start: curve.first().q.iter().map(|q| *q as f32).collect() }
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Joint values in the middle of `[from, to]`, and for each joint a bound on how far it is from there
    /// anywhere in the interval (rad or m); `hint` is a segment to look for first, and becomes that
    /// in which the interval starts. Before its start and after its end the curve stands still.
    ///
    /// `put` is called with joint, value and bound.
    pub fn sample(&self, (from, to): (f64, f64), hint: &mut usize, mut put: impl FnMut(usize, f32, f32)) {
        let segments = self.times.len().saturating_sub(1);
        if segments == 0 {
            for (joint, value) in self.start.iter().enumerate() {
                put(joint, *value, 0.0);
            }
            return;
        }
        let (begin, end) = (self.times[0], self.times[segments]);
        let middle = ((from + to) / 2.0).clamp(begin, end);
        let (from, to) = (from.clamp(begin, end), to.clamp(begin, end));
        let first = self.segment(from, *hint);
        *hint = first;
        let mut centre = first;
        while centre + 1 < segments && self.times[centre + 1] <= middle {
            centre += 1;
        }
        let blocks = self.joints.div_ceil(ROW);
        for block in 0..blocks {
            let row = &self.rows[centre * blocks + block];
            let value = position(row, (middle - self.times[centre]) as f32);
            let mut stray = [0.0_f32; ROW];
            let mut segment = first;
            loop {
                let (start, stop) = (self.times[segment], self.times[segment + 1]);
                let (t0, t1) = (from.max(start) - start, to.min(stop) - start);
                widen(&self.rows[segment * blocks + block], (t0 as f32, t1 as f32), &value, &mut stray);
                segment += 1;
                if segment >= segments || self.times[segment] >= to {
                    break;
                }
            }
            for lane in 0..ROW.min(self.joints - block * ROW) {
                put(block * ROW + lane, value[lane], stray[lane] * ROUNDING.0 + ROUNDING.1);
            }
        }
    }

    /// The segment that holds `t`, which is not before the start.
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

fn position(row: &[[f32; ROW]; 4], t: f32) -> [f32; ROW] {
    let mut out = [0.0; ROW];
    for lane in 0..ROW {
        out[lane] = row[0][lane] + t * (row[1][lane] + t * (row[2][lane] + t * row[3][lane]));
    }
    out
}

/// Widens `stray` to how far the row's cubics are from `value` on `[t0, t1]`: no farther than the
/// control points of their Bernstein forms there.
fn widen(row: &[[f32; ROW]; 4], (t0, t1): (f32, f32), value: &[f32; ROW], stray: &mut [f32; ROW]) {
    let third = (t1 - t0).max(0.0) * (1.0 / 3.0);
    for lane in 0..ROW {
        let [q, v, square, cube] = [row[0][lane], row[1][lane], row[2][lane], row[3][lane]];
        let at = |t: f32| q + t * (v + t * (square + t * cube));
        let speed = |t: f32| v + t * (2.0 * square + t * 3.0 * cube);
        let (a, d) = (at(t0) - value[lane], at(t1) - value[lane]);
        let (b, c) = (a + speed(t0) * third, d - speed(t1) * third);
        let mut most = stray[lane];
        for x in [a, b, c, d] {
            let x = x.abs();
            most = if x > most { x } else { most };
        }
        stray[lane] = most;
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::kinematics::Config;
    use crate::trajectory::CurvePoint;

    #[test]
    fn samples_hold_what_the_curve_does() {
        let mut rng = crate::run::Seed(5).stream("table");
        for case in 0..300 {
            let joints = [1, 6, 7, 8, 11][case % 5];
            let mut t = -1.0;
            let points = (0..rng.random_range(1..30))
                .map(|_| {
                    t += rng.random_range(0.05..0.7);
                    let mut many = |size: f64| -> Config {
                        (0..joints).map(|_| rng.random_range(-size..size)).collect()
                    };
                    CurvePoint { t, q: many(2.0), qd: many(1.5) }
                })
                .collect();
            let curve = Curve::new(points).unwrap();
            let table = CurveTable::new(&curve);
            let mut hint = 0;
            for _ in 0..40 {
                let from = rng.random_range(-1.5..t + 0.5);
                let width = [1e-4, 0.05, 1.0][rng.random_range(0..3)];
                let (middle, to) = (from + width / 2.0, from + width);
                let truth = curve.position_at(middle);
                let exact = curve.displacement_from(middle, from, to);
                let mut seen = 0;
                table.sample((from, to), &mut hint, |joint, value, stray| {
                    assert!((f64::from(value) - truth[joint]).abs() < 1e-5);
                    assert!(f64::from(stray) + 1e-5 >= exact[joint], "{stray} {}", exact[joint]);
                    // And not much more on short intervals, where nearly all is velocity.
                    if width < 1e-3 {
                        assert!(f64::from(stray) < 1.2 * exact[joint] + 1e-4, "{stray} {}", exact[joint]);
                    }
                    seen += 1;
                });
                assert_eq!(seen, joints);
            }
        }
    }
}
