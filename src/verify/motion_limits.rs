//! The limits of single arms: start, rest at the ends, range, speed, acceleration, home.

use super::curve::Curve;
use super::verdict::{Report, Rule, beyond};
use crate::plan::Plan;
use crate::problem::Problem;

/// How far a joint may leave its range (rad or m), or its start and home.
const POSITION_TOLERANCE: f64 = 1e-6;
/// By which part of itself a velocity limit may be exceeded.
const VELOCITY_TOLERANCE: f64 = 1e-4;
/// By which part of itself an acceleration limit may be exceeded.
const ACCELERATION_TOLERANCE: f64 = 1e-3;
/// An arm rests while no joint is as fast as this (rad/s or m/s).
pub(super) const REST_SPEED: f64 = 1e-3;

/// Checks every arm's curve against the limits of its joints.
pub(super) fn check(problem: &Problem, plan: &Plan, curves: &[Curve], report: &mut Report) {
    for (index, (arm, curve)) in problem.workcell.arms.iter().zip(curves).enumerate() {
        let points = &plan.arms[index].points;
        let (Some(first), Some(last)) = (points.first(), points.last()) else { continue };
        if let Some(start) = problem.initial_joints.get(index) {
            let off = farthest(&first.q, start);
            if beyond(off, POSITION_TOLERANCE) {
                let message = format!("a joint starts {off:.3e} away from its initial value");
                report.add(Rule::Start, Some(0.0), &[&arm.id], off, message);
            }
        }
        if problem.options.return_home {
            let off = farthest(&last.q, &arm.home);
            if beyond(off, POSITION_TOLERANCE) {
                let message = format!("a joint ends {off:.3e} away from home");
                report.add(Rule::ReturnHome, Some(last.t), &[&arm.id], off, message);
            }
        }
        for point in [first, last] {
            let speed = point.qd.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            if beyond(speed, REST_SPEED) {
                let message = format!("a joint moves at {speed:.3e} where the arm should rest");
                report.add(Rule::RestAtEnds, Some(point.t), &[&arm.id], speed, message);
            }
        }
        for (joint, limits) in arm.limits.iter().enumerate().take(arm.model.dof()) {
            let name = &arm.model.joints[joint].name;
            let (outside, t) = curve.peak_outside(joint, limits.lower, limits.upper, POSITION_TOLERANCE);
            if beyond(outside.value, POSITION_TOLERANCE) {
                let message = format!(
                    "{name} leaves its range [{}, {}] by {:.3e}, most at t={:.3} s",
                    limits.lower, limits.upper, outside.value, outside.t
                );
                report.add(Rule::PositionLimit, Some(t), &[&arm.id], outside.value, message);
            }
            let bound = limits.velocity * (1.0 + VELOCITY_TOLERANCE);
            let (speed, t) = curve.peak_joint_speed(joint, bound);
            if beyond(speed.value, bound) {
                let message = format!(
                    "{name} reaches a speed of {:.5}, limit {}, most at t={:.3} s",
                    speed.value, limits.velocity, speed.t
                );
                report.add(Rule::VelocityLimit, Some(t), &[&arm.id], speed.value - limits.velocity, message);
            }
            let bound = limits.acceleration * (1.0 + ACCELERATION_TOLERANCE);
            let (acceleration, t) = curve.peak_joint_acceleration(joint, bound);
            if beyond(acceleration.value, bound) {
                let message = format!(
                    "{name} reaches an acceleration of {:.5}, limit {}, most at t={:.3} s",
                    acceleration.value, limits.acceleration, acceleration.t
                );
                let excess = acceleration.value - limits.acceleration;
                report.add(Rule::AccelerationLimit, Some(t), &[&arm.id], excess, message);
            }
            check_stated_acceleration(
                plan,
                index,
                joint,
                limits.acceleration,
                (&arm.id, name),
                curve,
                report,
            );
        }
    }
}

/// The `qdd` of one joint's points against the curve. What the last point states may also be
/// zero: the arm rests from there on.
fn check_stated_acceleration(
    plan: &Plan,
    arm: usize,
    joint: usize,
    limit: f64,
    (id, name): (&str, &str),
    curve: &Curve,
    report: &mut Report,
) {
    let points = &plan.arms[arm].points;
    let mut worst: Option<(f64, f64)> = None;
    let mut first = 0.0;
    for (index, point) in points.iter().enumerate() {
        let real = curve.acceleration_at_point(index, joint);
        let stated = point.qdd[joint];
        let tolerance = ACCELERATION_TOLERANCE * limit.max(real.abs());
        let off = (stated - real).abs();
        let at_rest = index + 1 == points.len() && stated.abs() <= tolerance;
        if beyond(off, tolerance) && !at_rest {
            first = worst.map_or(point.t, |_| first);
            if worst.is_none_or(|(most, _)| off > most) {
                worst = Some((off, point.t));
            }
        }
    }
    if let Some((off, t)) = worst {
        let message =
            format!("{name}: qdd is {off:.3e} away from the curve's second derivative at t={t:.3} s");
        report.add(Rule::AccelerationValue, Some(first), &[id], off, message);
    }
}

/// The greatest difference of two configurations; infinite when their lengths differ.
fn farthest(a: &[f64], b: &[f64]) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    a.iter().zip(b).fold(0.0, |most, (x, y)| most.max((x - y).abs()))
}
