//! Damped least squares (Levenberg-Marquardt) with restarts, for any chain.
//!
//! Joint limits are kept throughout: a joint at a limit that the step would push on is frozen and
//! the step taken anew without it.

use std::f64::consts::{PI, TAU};

use nalgebra::{Cholesky, Matrix6, Vector6};
use rand::Rng as _;
use smallvec::SmallVec;

use super::angles::{fit, turn_between, weighted_square};
use crate::geometry::Pose;
use crate::kinematics::chain::{Chain, Columns, StepKind};
use crate::kinematics::{Config, JointLimits};
use crate::run::Rng;

/// Greatest iterations of one descent.
const MAX_ITERATIONS: usize = 60;
/// A descent has arrived when the error (m and rad together) is below this.
const ARRIVED: f64 = 1e-10;
/// A descent that cannot get below `ARRIVED` for rounding still counts below this.
const ACCEPTED: f64 = 1e-8;
/// Least damping.
const LEAST_DAMPING: f64 = 1e-12;
/// Greatest error (m, rad) that one step works on.
const TRUSTED_ERROR: f64 = 0.5;
/// Restarts for each solution that is still missing, and in all without any.
const RESTARTS_PER_SOLUTION: usize = 6;
const RESTARTS: usize = 30;
/// Random restarts when the closest solution is asked for.
const RESTARTS_CLOSEST: usize = 12;
/// Two solutions whose joints all agree within this (rad or m) are one.
const SAME: f64 = 1e-4;
/// Steps within the null space towards the reference.
const NULL_STEPS: usize = 12;

/// A chain with limits and a target.
pub(super) struct Descent<'a> {
    pub chain: &'a Chain,
    pub limits: &'a [JointLimits],
    pub target: &'a Pose,
}

impl Descent<'_> {
    /// Up to `max` solutions within the limits, from random starts.
    pub fn spread(&self, max: usize, rng: &mut Rng, out: &mut Vec<Config>) {
        let mut left = RESTARTS;
        while out.len() < max && left > 0 {
            left -= 1;
            let Some(q) = self.from(&self.random_start(rng)) else { continue };
            if !out.iter().any(|other| same(other, &q)) {
                out.push(q);
                left = left.max(RESTARTS_PER_SOLUTION);
            }
        }
    }

    /// The solution of least weighted square distance to `reference` that descents from it and
    /// from random starts find.
    pub fn closest(&self, reference: &[f64], weights: &[f64], rng: &mut Rng) -> Option<Config> {
        let mut best: Option<(f64, Config)> = None;
        for attempt in 0..=RESTARTS_CLOSEST {
            let start = match attempt {
                0 => self.confined(reference),
                _ => self.random_start(rng),
            };
            let Some(q) = self.from(&start) else { continue };
            let mut q = self.drawn_to(q, reference, weights);
            self.unwind(&mut q, reference);
            let cost = weighted_square(&q, reference, weights);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, q));
            }
        }
        best.map(|(_, q)| q)
    }

    /// The solution that a descent from `start` arrives at, if it arrives.
    pub fn from(&self, start: &[f64]) -> Option<Config> {
        let mut q: Config = self.confined(start);
        let mut columns = Columns::new();
        let mut pose = self.chain.mount_pose_and_jacobian(&q, &mut columns);
        let mut error = self.error(&pose);
        let mut size = error.norm();
        let mut damping = 1e-3;
        for _ in 0..MAX_ITERATIONS {
            if size < ARRIVED {
                return Some(q);
            }
            let trial = self.step(&q, &columns, &error, damping);
            let mut trial_columns = Columns::new();
            pose = self.chain.mount_pose_and_jacobian(&trial, &mut trial_columns);
            let trial_error = self.error(&pose);
            let trial_size = trial_error.norm();
            // Also refuses NaN.
            if trial_size < size {
                let gain = size - trial_size;
                (q, columns, error) = (trial, trial_columns, trial_error);
                damping = (damping * 0.1).max(LEAST_DAMPING);
                // Far from the target and hardly moving: a local minimum.
                let stuck = trial_size > 1e-3 && gain < 1e-4 * trial_size;
                size = trial_size;
                if stuck {
                    return None;
                }
            } else {
                if damping > 1e3 {
                    break;
                }
                damping *= 10.0;
            }
        }
        (size < ACCEPTED).then_some(q)
    }

    /// Moves `q` along its null space towards `reference` as far as that shortens the way.
    fn drawn_to(&self, q: Config, reference: &[f64], weights: &[f64]) -> Config {
        if self.chain.dof <= 6 {
            return q;
        }
        let mut best = q;
        let mut cost = weighted_square(&best, reference, weights);
        for _ in 0..NULL_STEPS {
            let mut columns = Columns::new();
            self.chain.mount_pose_and_jacobian(&best, &mut columns);
            let pull: Config =
                best.iter().zip(reference).zip(weights).map(|((q, r), w)| w * (r - q)).collect();
            let moved: Vector6<f64> = columns.iter().zip(&pull).map(|(column, pull)| column * *pull).sum();
            let Some(factor) = damped_normal(&columns, &[], 1e-9) else { break };
            let back = factor.solve(&moved);
            let trial: Config = (0..best.len())
                .map(|joint| best[joint] + 0.5 * (pull[joint] - columns[joint].dot(&back)))
                .collect();
            let Some(trial) = self.from(&trial) else { break };
            let trial_cost = weighted_square(&trial, reference, weights);
            if trial_cost >= cost - 1e-9 {
                break;
            }
            (best, cost) = (trial, trial_cost);
        }
        best
    }

    /// Turns every revolute joint by whole turns to come as near to `reference` as limits allow.
    pub fn unwind(&self, q: &mut Config, reference: &[f64]) {
        for step in &self.chain.steps {
            let joint = step.joint;
            // A mimicking link may not repeat after a turn of the joint that drives it.
            let repeats = self
                .chain
                .steps
                .iter()
                .filter(|other| other.joint == joint)
                .all(|other| other.kind == StepKind::Turn && other.multiplier.fract() == 0.0);
            if repeats && let Some(value) = fit(q[joint], &self.limits[joint], reference[joint]) {
                q[joint] = value;
            }
        }
    }

    fn error(&self, pose: &Pose) -> Vector6<f64> {
        let linear = self.target.translation.vector - pose.translation.vector;
        let angular = (self.target.rotation * pose.rotation.inverse()).scaled_axis();
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// A damped step against `error`, within the limits.
    fn step(&self, q: &Config, columns: &Columns, error: &Vector6<f64>, damping: f64) -> Config {
        let size = error.norm();
        let error = if size > TRUSTED_ERROR { error * (TRUSTED_ERROR / size) } else { *error };
        let mut frozen: SmallVec<[bool; 8]> = SmallVec::from_elem(false, q.len());
        for _ in 0..3 {
            let Some(factor) = damped_normal(columns, &frozen, damping) else { break };
            let force = factor.solve(&error);
            let mut trial = q.clone();
            let mut stopped = false;
            for (joint, limits) in self.limits.iter().enumerate() {
                if frozen[joint] {
                    continue;
                }
                let value = q[joint] + columns[joint].dot(&force);
                trial[joint] = value.max(limits.lower).min(limits.upper);
                if trial[joint] != value && trial[joint] == q[joint] {
                    frozen[joint] = true;
                    stopped = true;
                }
            }
            if !stopped {
                return trial;
            }
        }
        q.clone()
    }

    fn confined(&self, q: &[f64]) -> Config {
        q.iter().zip(self.limits).map(|(value, limits)| value.max(limits.lower).min(limits.upper)).collect()
    }

    fn random_start(&self, rng: &mut Rng) -> Config {
        self.limits
            .iter()
            .map(|limits| {
                let (lower, upper) = match (limits.lower.is_finite(), limits.upper.is_finite()) {
                    (true, true) => (limits.lower, limits.upper),
                    (true, false) => (limits.lower, limits.lower + TAU),
                    (false, true) => (limits.upper - TAU, limits.upper),
                    (false, false) => (-PI, PI),
                };
                lower + rng.random::<f64>() * (upper - lower)
            })
            .collect()
    }
}

/// The Cholesky factor of J J^T + damping, without the frozen columns.
fn damped_normal(
    columns: &Columns,
    frozen: &[bool],
    damping: f64,
) -> Option<Cholesky<f64, nalgebra::Const<6>>> {
    let mut normal = Matrix6::from_diagonal_element(damping.max(LEAST_DAMPING));
    for (joint, column) in columns.iter().enumerate() {
        if !frozen.get(joint).copied().unwrap_or(false) {
            normal.ger(1.0, column, column, 1.0);
        }
    }
    Cholesky::new(normal)
}

fn same(a: &Config, b: &Config) -> bool {
    a.iter().zip(b).all(|(x, y)| turn_between(*x, *y) < SAME)
}
