//! The plan's figures, computed anew and compared with what it states.

use super::curve::Curve;
use super::verdict::{Figures, Report, Rule, beyond};
use crate::plan::Plan;

/// Relative tolerance of stated figures.
const TOLERANCE: f64 = 1e-6;

/// Computes the figures.
pub(super) fn compute(plan: &Plan, curves: &[Curve]) -> Figures {
    let mut steps: Vec<usize> = plan.actions.iter().map(|action| action.step).collect();
    steps.sort_unstable();
    steps.dedup();
    Figures {
        duration_s: curves.iter().map(Curve::duration).fold(0.0, f64::max),
        arc_length: curves.iter().map(Curve::arc_length).fold(0.0, f64::max),
        actions: plan.actions.len(),
        steps: steps.len(),
    }
}

/// Compares them with what the plan states.
pub(super) fn check(plan: &Plan, figures: &Figures, report: &mut Report) {
    let stated = &plan.metrics;
    let end = Some(figures.duration_s);
    let mut compare = |name: &str, stated: f64, real: f64| {
        let off = (stated - real).abs();
        if beyond(off, TOLERANCE * real.abs() + 1e-9) {
            let message = format!("{name} is stated as {stated}, and is {real}");
            report.add(Rule::Metrics, end, &[], off, message);
        }
    };
    compare("duration_s", stated.duration_s, figures.duration_s);
    compare("duration_synchronous_s", stated.duration_synchronous_s, figures.duration_s);
    compare("arc_length", stated.arc_length, figures.arc_length);
    compare("actions", stated.actions as f64, figures.actions as f64);
    compare("steps", stated.steps as f64, figures.steps as f64);
    if stated.steps_lower_bound > figures.steps {
        let message = format!(
            "steps_lower_bound is stated as {}, yet the plan has {} steps",
            stated.steps_lower_bound, figures.steps
        );
        report.add(Rule::Metrics, end, &[], 0.0, message);
    }
}
