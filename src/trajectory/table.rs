//! A curve's coefficients laid out for being asked often.

use super::Curve;

/// Joints side by side in one row.
const ROW: usize = 8;

/// A row of a segment: positions, velocities, and the coefficients of the square and the cube, on the segment's own
/// clock; as checks for collision take it.
pub type TableRow = [[f32; ROW]; 4];

/// A [`Curve`] in single precision, for sampling.
#[derive(Debug, Clone)]
pub struct CurveTable {
    joints: usize,
    times: Vec<f64>,
    rows: Vec<TableRow>,
}

impl CurveTable {
    /// Lays out `curve`.
    pub fn new(curve: &Curve) -> Self {
        let joints = curve.joints();
        let mut times: Vec<f64> = curve.points().iter().map(|point| point.t).collect();
        let mut rows = Vec::with_capacity(curve.segments().max(1) * joints.div_ceil(ROW));
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
        if curve.segments() == 0 {
            // One that takes no time.
            times.push(curve.end_time());
            rows.extend(curve.first().q.chunks(ROW).map(|q| {
                let mut row = [[0.0; ROW]; 4];
                row[0].iter_mut().zip(q).for_each(|(value, q)| *value = *q as f32);
                row
            }));
        }
        Self { joints, times, rows }
    }

    /// Number of joints.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// When each segment starts, and when the last one ends (s): at least two, and equal for a curve without segments.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// By segment, a row for each eight joints.
    pub fn rows(&self) -> &[TableRow] {
        &self.rows
    }
}
