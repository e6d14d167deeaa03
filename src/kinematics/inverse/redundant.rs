//! Choosing among the solutions of a 7R arm: spread over psi and branches, continued from a
//! seed, or closest to a reference.

use std::f64::consts::TAU;

use rand::Rng as _;
use smallvec::SmallVec;

use super::angles::{fit, neutral, turn_between, weighted_square};
use super::euler::Side;
use super::spherical_seven::{Aim, Branch, SphericalSeven, Window};
use crate::geometry::Pose;
use crate::kinematics::{Config, JointLimits};
use crate::run::Rng;

/// Psi advances by the golden angle, which spreads any number of draws evenly.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Draws of psi without any solution before the windows are computed.
const BLIND_DRAWS: usize = 8;
/// Steps of psi in the sweep for the closest solution.
const SWEEP: usize = 36;
/// Two solutions whose joints all agree within this (rad) are one.
const SAME: f64 = 1e-7;
/// What angles (rad) may err by.
const ROUNDING: f64 = 1e-6;

impl SphericalSeven {
    /// Up to `max` solutions within `limits`, spread over psi and the branches.
    pub fn spread(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        max: usize,
        rng: &mut Rng,
        out: &mut Vec<Config>,
    ) {
        let Some(aim) = self.aim(target, None) else { return };
        let near = neutral_all(limits);
        let per_psi = max.div_ceil(4);
        let start = rng.random::<f64>() * TAU;
        let first_elbow: usize = rng.random_range(0..2);
        let middles = self.middles(limits);
        for draw in 0..BLIND_DRAWS + 4 * max {
            if out.len() >= max || (draw >= BLIND_DRAWS && out.is_empty()) {
                break;
            }
            let elbow = (first_elbow + draw) % 2;
            let psi = start + draw as f64 * GOLDEN_ANGLE;
            let first: usize = rng.random_range(0..4);
            let Some(angles) = self.angles_if(&aim.elbows[elbow], psi, &near, &middles) else { continue };
            let mut taken = 0;
            for index in 0..4 {
                if taken == per_psi || out.len() >= max {
                    break;
                }
                let branch = branch_of((((first + index) % 4) << 1) | elbow);
                if let Some(q) = angles.within(branch, limits, &near) {
                    taken += push_new(out, &q);
                }
            }
        }
        if out.len() < max {
            self.fill_from_windows(&aim, limits, &near, max, rng, out);
        }
    }

    /// Draws from the windows, which miss nothing however narrow, until there are `max`.
    fn fill_from_windows(
        &self,
        aim: &Aim,
        limits: &[JointLimits],
        near: &[f64; 7],
        max: usize,
        rng: &mut Rng,
        out: &mut Vec<Config>,
    ) {
        let mut windows = SmallVec::new();
        self.windows(aim, limits, near, &mut windows);
        if windows.is_empty() {
            return;
        }
        let first = rng.random_range(0..windows.len());
        for draw in 0..4 * max + windows.len() {
            if out.len() >= max {
                return;
            }
            let window: &Window = &windows[(first + draw) % windows.len()];
            // The first round tries the middles, where nothing can fall to rounding.
            let part = if draw < windows.len() { 0.5 } else { rng.random::<f64>() };
            let psi = window.from + part * (window.to - window.from);
            let angles = self.angles(&aim.elbows[window.branch.elbow], psi, near);
            if let Some(q) = angles.within(window.branch, limits, near) {
                push_new(out, &q);
            }
        }
    }

    /// The solution that continues from `seed`: same branch, psi kept, or moved as little as the
    /// limits ask for; no joint farther than `max_step` (rad) from the seed.
    pub fn near(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        seed: &[f64; 7],
        max_step: f64,
    ) -> Option<Config> {
        let (elbow, angles) = self.continued(target, seed)?;
        let (shoulder, wrist) = self.sides_of(seed);
        let same = Branch { elbow, shoulder, wrist };
        // The elbow is where it is, whatever psi.
        fit(angles.q4, &limits[3], seed[3]).filter(|q4| (q4 - seed[3]).abs() <= max_step)?;
        // Near a singular shoulder or wrist another branch may be as good a continuation.
        let kept = std::iter::once(same)
            .chain(branches_of(elbow).filter(|branch| *branch != same))
            .filter_map(|branch| angles.within(branch, limits, seed))
            .find(|q| within_step(q, seed, max_step));
        if let Some(q) = kept {
            return Some(q.into_iter().collect());
        }
        if angles.within(same, limits, seed).is_some() {
            // The limits do not ask for another psi.
            return None;
        }
        // The shoulder turns at least as far as psi, less the least rotation, and at most by the steps of its joints.
        let (aim, turn) = self.aim_one(target, seed, elbow)?;
        let farthest = 3.0 * max_step + turn + ROUNDING;
        let mut windows = SmallVec::new();
        self.elbow_windows((elbow, &aim), limits, seed, Some((same, farthest)), &mut windows);
        windows
            .iter()
            .filter_map(|window| {
                let psi = nearest_to_zero(window);
                self.angles(&aim, psi, seed).within(window.branch, limits, seed)
            })
            .filter(|q| within_step(q, seed, max_step))
            .min_by(|a, b| square(a, seed).total_cmp(&square(b, seed)))
            .map(|q| q.into_iter().collect())
    }

    /// The solution of least weighted square distance to `reference`, over all branches and psi.
    pub fn closest(
        &self,
        limits: &[JointLimits],
        target: &Pose,
        reference: &[f64; 7],
        weights: &[f64],
    ) -> Option<Config> {
        let aim = self.aim(target, Some(reference))?;
        let cost_at = |branch: Branch, psi: f64| {
            let q =
                self.angles(&aim.elbows[branch.elbow], psi, reference).within(branch, limits, reference)?;
            Some((weighted_square(&q, reference, weights), q))
        };
        let mut best: Option<(f64, [f64; 7], Branch, f64)> = None;
        for step in 0..SWEEP {
            let psi = step as f64 * TAU / SWEEP as f64;
            for elbow in 0..2 {
                let angles = self.angles(&aim.elbows[elbow], psi, reference);
                for branch in branches_of(elbow) {
                    if let Some(q) = angles.within(branch, limits, reference) {
                        let cost = weighted_square(&q, reference, weights);
                        keep_better(&mut best, cost, q, branch, psi);
                    }
                }
            }
        }
        if best.is_none() {
            let mut windows = SmallVec::new();
            self.windows(&aim, limits, reference, &mut windows);
            for window in &windows {
                let psi = (window.from + window.to) / 2.0;
                if let Some((cost, q)) = cost_at(window.branch, psi) {
                    keep_better(&mut best, cost, q, window.branch, psi);
                }
            }
        }
        let (mut least, mut q, branch, mut psi) = best?;
        // Halving steps about the best of the sweep; each keeps to the limits.
        let mut step = TAU / SWEEP as f64 / 2.0;
        while step > 1e-4 {
            let better = [psi - step, psi + step]
                .into_iter()
                .filter_map(|psi| cost_at(branch, psi).map(|(cost, q)| (cost, q, psi)))
                .find(|(cost, ..)| *cost < least);
            match better {
                Some((cost, found, at)) => (least, q, psi) = (cost, found, at),
                None => step /= 2.0,
            }
        }
        Some(q.into_iter().collect())
    }
}

fn keep_better(
    best: &mut Option<(f64, [f64; 7], Branch, f64)>,
    cost: f64,
    q: [f64; 7],
    branch: Branch,
    psi: f64,
) {
    if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
        *best = Some((cost, q, branch, psi));
    }
}

fn branch_of(index: usize) -> Branch {
    Branch { elbow: index & 1, shoulder: Side::BOTH[(index >> 1) & 1], wrist: Side::BOTH[(index >> 2) & 1] }
}

fn branches_of(elbow: usize) -> impl Iterator<Item = Branch> {
    (0..4).map(move |index| branch_of((index << 1) | elbow))
}

fn neutral_all(limits: &[JointLimits]) -> [f64; 7] {
    std::array::from_fn(|joint| neutral(&limits[joint]))
}

/// The psi of the window, or of it a turn away, that is nearest to 0, a little inside.
fn nearest_to_zero(window: &Window) -> f64 {
    let inset = (0.01 * (window.to - window.from)).min(1e-6);
    let (from, to) = (window.from + inset, window.to - inset);
    [0.0, TAU]
        .map(|turn| 0.0_f64.max(from - turn).min(to - turn))
        .into_iter()
        .min_by(|a, b| a.abs().total_cmp(&b.abs()))
        .unwrap_or_default()
}

fn within_step(q: &[f64; 7], seed: &[f64; 7], max_step: f64) -> bool {
    q.iter().zip(seed).all(|(a, b)| (a - b).abs() <= max_step)
}

fn square(q: &[f64; 7], seed: &[f64; 7]) -> f64 {
    weighted_square(q, seed, &[1.0; 7])
}

/// Adds `q` unless it is there; how many were added.
fn push_new(out: &mut Vec<Config>, q: &[f64; 7]) -> usize {
    let known = out.iter().any(|other| other.iter().zip(q).all(|(a, b)| turn_between(*a, *b) < SAME));
    if known {
        return 0;
    }
    out.push(q.iter().copied().collect());
    1
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::geometry::Vec3;
    use crate::kinematics::inverse::Structure;
    use crate::kinematics::{ArmModel, NoMeshes, library};
    use crate::run::Seed;

    #[test]
    fn windows_that_are_not_looked_at_are_out_of_reach() {
        let urdf = library("iiwa14").unwrap().urdf;
        let model = ArmModel::from_urdf("r", urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0;
        let Structure::SphericalSeven(seven) = &model.solver.0 else { panic!("an iiwa14 is such an arm") };
        let mut rng = Seed(14).stream("windows");
        let (mut moved, mut none, mut left_out) = (0, 0, 0);
        for case in 0..20_000 {
            let q: [f64; 7] = std::array::from_fn(|joint| {
                let limit = &model.joints[joint].limits;
                rng.random_range(limit.lower..limit.upper)
            });
            let mut target = model.mount_pose(&q);
            let way = Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * [0.005, 0.02, 0.06][case % 3];
            target.translation.vector += way;
            let max_step = [0.02, 0.1, 0.35, 2.0][case % 4];
            // Ranges that leave little room on one side.
            let limits: Vec<JointLimits> = (0..7)
                .map(|joint| {
                    let mut room = || [0.005, 0.05, 2.0][rng.random_range(0..3)];
                    let (lower, upper) = (q[joint] - room(), q[joint] + room());
                    JointLimits { lower, upper, ..model.joints[joint].limits }
                })
                .collect();
            let found = seven.near(&limits, &target, &q, max_step);
            let Some((elbow, angles)) = seven.continued(&target, &q) else { continue };
            let (shoulder, wrist) = seven.sides_of(&q);
            let same = Branch { elbow, shoulder, wrist };
            if angles.within(same, &limits, &q).is_some() {
                continue;
            }
            let aim = seven.aim(&target, Some(&q)).unwrap();
            let mut windows = SmallVec::new();
            seven.elbow_windows(
                (elbow, &aim.elbows[elbow]),
                &limits,
                &q,
                Some((same, f64::INFINITY)),
                &mut windows,
            );
            let all = windows.iter().filter_map(|window| {
                let psi = nearest_to_zero(window);
                seven.angles(&aim.elbows[elbow], psi, &q).within(same, &limits, &q)
            });
            let near = all.filter(|other| within_step(other, &q, max_step)).map(|other| square(&other, &q));
            let least = near.fold(f64::INFINITY, f64::min);
            match found {
                // Another branch may do as well.
                Some(found) if least.is_finite() => {
                    let distance = weighted_square(&found, &q, &[1.0; 7]);
                    let turned: [f64; 7] = std::array::from_fn(|joint| found[joint]);
                    let is_same = seven.sides_of(&turned) == (shoulder, wrist);
                    assert!(!is_same || distance <= least + 1e-9, "{distance} {least}");
                    moved += 1;
                }
                Some(_) => {}
                None => {
                    assert!(least.is_infinite(), "{least}");
                    none += 1;
                    left_out += usize::from(!windows.is_empty());
                }
            }
        }
        assert!(moved > 100 && none > 1000 && left_out > 100, "{moved} {none} {left_out}");
    }
}
