//! Curves as trajectories of a plan.

use crate::trajectory::Curve;

use super::{ArmTrajectory, TrajectoryPoint};

impl From<&Curve> for ArmTrajectory {
    /// The curve's points on its own clock, each with the acceleration just after it (zero after
    /// the last).
    fn from(curve: &Curve) -> Self {
        let points = curve.points().iter().enumerate().map(|(index, point)| TrajectoryPoint {
            t: point.t,
            q: point.q.to_vec(),
            qd: point.qd.to_vec(),
            qdd: curve.acceleration_after(index).to_vec(),
        });
        Self { points: points.collect() }
    }
}
