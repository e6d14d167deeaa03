//! Whether a plan can be read at all: sizes, ids, numbers, times. What fails here ends the
//! judgement, since nothing else could be computed.

use nalgebra::UnitQuaternion;

use super::verdict::{Report, Rule};
use crate::geometry::Pose;
use crate::plan::{Action, ActionKind, ArmTrajectory, Plan};
use crate::problem::Problem;

/// The most points that a plan may have over all arms.
pub(super) const MAX_POINTS: usize = 200_000;
/// The most actions that a plan may have.
pub(super) const MAX_ACTIONS: usize = 2_000;
/// The longest plan (s).
pub(super) const MAX_DURATION: f64 = 1e5;
/// The greatest joint value (rad or m), velocity, or position (m) that makes sense.
const MAX_NUMBER: f64 = 1e6;
/// The greatest acceleration (rad/s^2 or m/s^2) that makes sense.
const MAX_ACCELERATION: f64 = 1e12;
/// Points are at least this far apart (s), but for rounding.
const MIN_SPACING: f64 = 1e-3 - 1e-9;
/// What counts as one time (s).
pub(super) const SAME_TIME: f64 = 1e-9;

/// Reports what cannot be read; `false` when there is such.
pub(super) fn check(problem: &Problem, plan: &Plan, report: &mut Report) -> bool {
    if plan.problem_digest != problem.digest {
        let message =
            format!("the plan is for problem {}, not {}", clip(&plan.problem_digest), problem.digest);
        report.add(Rule::ProblemDigest, None, &[], 0.0, message);
    }
    let points: usize = plan.arms.iter().map(|arm| arm.points.len()).sum();
    if points > MAX_POINTS || plan.actions.len() > MAX_ACTIONS {
        let message = format!(
            "{points} points and {} actions; the judge takes at most {MAX_POINTS} and {MAX_ACTIONS}",
            plan.actions.len()
        );
        report.add(Rule::TooLarge, None, &[], 0.0, message);
        return false;
    }
    if plan.arms.len() != problem.workcell.arms.len() {
        let message = format!("{} trajectories for {} arms", plan.arms.len(), problem.workcell.arms.len());
        report.add(Rule::Shape, None, &[], 0.0, message);
        return false;
    }
    let mut readable = true;
    for (arm, trajectory) in problem.workcell.arms.iter().zip(&plan.arms) {
        readable &= check_numbers(&arm.id, arm.model.dof(), trajectory, report)
            && check_times(&arm.id, trajectory, report);
    }
    for (index, action) in plan.actions.iter().enumerate() {
        readable &= check_action(problem, index, action, report);
    }
    readable && check_durations(problem, plan, report)
}

/// At most 80 characters of outside text.
fn clip(text: &str) -> String {
    if text.is_empty() { "(none)".to_owned() } else { text.chars().take(80).collect() }
}

/// Lengths and numbers of one arm's points.
fn check_numbers(id: &str, dof: usize, trajectory: &ArmTrajectory, report: &mut Report) -> bool {
    if trajectory.points.len() < 2 {
        let message = format!("{} points; a trajectory needs at least two", trajectory.points.len());
        report.add(Rule::Shape, None, &[id], 0.0, message);
        return false;
    }
    for (index, point) in trajectory.points.iter().enumerate() {
        if [&point.q, &point.qd, &point.qdd].iter().any(|values| values.len() != dof) {
            let message = format!("point {index} does not have {dof} values each of q, qd and qdd");
            report.add(Rule::Shape, None, &[id], 0.0, message);
            return false;
        }
        let sensible = |value: &f64| value.abs() <= MAX_NUMBER;
        let fine = point.t.is_finite()
            && point.q.iter().chain(&point.qd).all(sensible)
            && point.qdd.iter().all(|value| value.abs() <= MAX_ACCELERATION);
        if !fine {
            let message = format!("point {index} holds a number that is not finite or beyond any sense");
            report.add(Rule::BadNumber, None, &[id], 0.0, message);
            return false;
        }
    }
    true
}

/// Times of one arm's points.
fn check_times(id: &str, trajectory: &ArmTrajectory, report: &mut Report) -> bool {
    let first = trajectory.points.first().map_or(0.0, |point| point.t);
    if first.abs() > SAME_TIME {
        let message = format!("the first point is at {first} s, not at 0");
        report.add(Rule::PointTimes, None, &[id], first.abs(), message);
        return false;
    }
    for (index, pair) in trajectory.points.windows(2).enumerate() {
        let [from, to] = pair else { continue };
        let spacing = to.t - from.t;
        if spacing < MIN_SPACING {
            let message =
                format!("point {} comes {spacing:e} s after the one before; at least 1 ms", index + 1);
            report.add(Rule::PointTimes, Some(to.t), &[id], MIN_SPACING - spacing, message);
            return false;
        }
    }
    true
}

/// Every arm's last point at the plan's duration.
fn check_durations(problem: &Problem, plan: &Plan, report: &mut Report) -> bool {
    let last = |trajectory: &ArmTrajectory| trajectory.points.last().map_or(0.0, |point| point.t);
    let duration = plan.arms.iter().map(last).fold(0.0, f64::max);
    let mut fits = true;
    for (arm, trajectory) in problem.workcell.arms.iter().zip(&plan.arms) {
        let short = duration - last(trajectory);
        if short > SAME_TIME {
            let message = format!("its last point is {short} s before the end of the plan at {duration} s");
            report.add(Rule::Duration, Some(last(trajectory)), &[&arm.id], short, message);
            fits = false;
        }
    }
    if duration > MAX_DURATION {
        let message = format!("the plan lasts {duration} s; the judge takes at most {MAX_DURATION}");
        report.add(Rule::TooLarge, None, &[], duration - MAX_DURATION, message);
        fits = false;
    }
    for (index, action) in plan.actions.iter().enumerate() {
        let outside = (-action.t).max(action.t - duration);
        if outside > SAME_TIME {
            let message = format!("action {index} at {} s is outside of the plan's {duration} s", action.t);
            report.add(Rule::ActionTime, Some(action.t), &[], outside, message);
            fits = false;
        }
    }
    for (index, pair) in plan.actions.windows(2).enumerate() {
        let [before, after] = pair else { continue };
        if after.t < before.t {
            let message = format!("action {} comes before action {index}; sort them by t", index + 1);
            report.add(Rule::ActionTime, Some(after.t), &[], before.t - after.t, message);
            fits = false;
        }
    }
    fits
}

/// Ids and numbers of one action.
fn check_action(problem: &Problem, index: usize, action: &Action, report: &mut Report) -> bool {
    let arm_known = |arm: usize| arm < problem.workcell.arms.len();
    let surface_known = |surface: usize| surface < problem.workcell.surfaces.len();
    let (known, poses): (bool, [Option<&Pose>; 2]) = match &action.kind {
        ActionKind::Pick { arm, object_in_tcp, surface } => {
            (arm_known(arm.0) && surface_known(surface.0), [Some(object_in_tcp), None])
        }
        ActionKind::Place { arm, object_in_tcp, object_pose, surface } => {
            (arm_known(arm.0) && surface_known(surface.0), [Some(object_in_tcp), Some(object_pose)])
        }
        ActionKind::Handoff { arm, to_arm, object_in_tcp, to_object_in_tcp } => (
            arm_known(arm.0) && arm_known(to_arm.0) && arm != to_arm,
            [Some(object_in_tcp), Some(to_object_in_tcp)],
        ),
    };
    if !known || action.object.0 >= problem.objects.len() {
        let message = format!("action {index} names an arm, object or surface that does not fit the problem");
        report.add(Rule::Shape, None, &[], 0.0, message);
        return false;
    }
    if !action.t.is_finite() || !poses.into_iter().flatten().all(is_sound_pose) {
        let message =
            format!("action {index} holds a number that is not finite, or a quaternion not of norm 1");
        report.add(Rule::BadNumber, None, &[], 0.0, message);
        return false;
    }
    true
}

/// Finite, in bounds, with a unit quaternion.
fn is_sound_pose(pose: &Pose) -> bool {
    let rotation: &UnitQuaternion<f64> = &pose.rotation;
    pose.translation.vector.iter().all(|x| x.abs() <= MAX_NUMBER)
        && (rotation.as_ref().norm() - 1.0).abs() <= 1e-6
}
