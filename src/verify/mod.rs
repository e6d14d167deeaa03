//! The judge: whether a plan, from wherever it comes, solves a problem and touches nothing.
//!
//! It shares geometry, kinematics and the domain types with the planner, and nothing else: no
//! search, no motion or timing code, no fast kernels. It reads the emitted curve (the cubic Hermite
//! interpolant of the points) and the actions, derives from them who holds what, which ways are
//! straight and what may touch when, and certifies that nothing else comes into contact at any
//! time. It never panics on a hostile plan, and its work is bounded.

mod arms;
mod chain;
mod contact;
mod curve;
mod custody;
mod figures;
mod gap;
mod motion_limits;
mod scene;
mod spans;
mod straight;
mod structure;
#[cfg(test)]
mod tests;
mod units;
mod verdict;

pub use verdict::{Clearance, Figures, Rule, Verdict, Violation};

use std::sync::atomic::{AtomicBool, Ordering};

use crate::plan::Plan;
use crate::problem::Problem;
use verdict::Report;

/// Judges `plan` as a solution of `problem`.
///
/// A plan that cannot be read (sizes, ids, numbers or times that make no sense) is judged on that
/// alone; else every rule is checked and every violation counted.
pub fn verify(problem: &Problem, plan: &Plan) -> Verdict {
    let (report, clearance, figures) = judge(problem, plan, 1, &|| false);
    report.conclude(clearance, figures)
}

/// [`verify`] by up to `threads` threads, for as long as `stop`, which is asked about every millisecond, says `false`;
/// `None` when it did not. How many threads there are makes no difference, but to what else is said of a plan that takes too
/// much work.
pub fn verify_unless(
    problem: &Problem,
    plan: &Plan,
    threads: usize,
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Verdict> {
    let stopped = AtomicBool::new(false);
    let (report, clearance, figures) = judge(problem, plan, threads, &|| {
        let now = stopped.load(Ordering::Relaxed) || stop();
        stopped.fetch_or(now, Ordering::Relaxed);
        now
    });
    (!stopped.into_inner()).then(|| report.conclude(clearance, figures))
}

/// What is found out about `plan`; not all of it where `stop` says so.
fn judge(
    problem: &Problem,
    plan: &Plan,
    threads: usize,
    stop: &(dyn Fn() -> bool + Sync),
) -> (Report, Option<Clearance>, Option<Figures>) {
    let mut report = Report::default();
    if !structure::check(problem, plan, &mut report) {
        return (report, None, None);
    }
    let cell = &problem.workcell;
    let chains = cell.arms.iter().map(chain::Chain::new).collect();
    let curves: Vec<curve::Curve> = plan
        .arms
        .iter()
        .zip(&cell.arms)
        .map(|(trajectory, arm)| curve::Curve::new(trajectory, arm.model.dof()))
        .collect();
    let figures = figures::compute(plan, &curves);
    figures::check(plan, &figures, &mut report);
    motion_limits::check(problem, plan, &curves, &mut report);
    let mut arms = arms::Arms::new(chains, curves);
    custody::check_steps(problem, plan, &mut report);
    let timeline = custody::follow(problem, plan, &mut arms, &mut report);
    custody::check_goal(problem, &timeline, figures.duration_s, &mut report);
    let windows = straight::check(problem, &timeline, &mut arms, &mut report);
    let mut scene = scene::Scene::new(problem, |arm| arms.chain(arm));
    let clearance = spans::check(&mut scene, &timeline, &windows, &arms, threads, stop, &mut report);
    (report, clearance, Some(figures))
}
