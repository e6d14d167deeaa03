//! Options of a run.

use super::ReadLimits;
use crate::problem::{GuidanceKind, Objective, Options, Schedule, Stop};
use crate::wire::fault::{FaultCode, Faults};
use crate::wire::reader::{Node, Range};

/// Greatest number of seconds in a stop condition.
const MAX_SECONDS: f64 = 1.0e6;

/// The options at `node`; what is absent or at fault has its default.
pub fn read_options(node: &Node<'_>, limits: &ReadLimits, faults: &mut Faults) -> Options {
    let mut options = Options { time_budget_s: limits.default_time_budget_s, ..Options::default() };
    let Some(mut fields) = node.fields(faults) else { return options };
    if let Some(node) = fields.optional("time_budget_s") {
        let range = Range::Positive(limits.max_time_budget_s);
        options.time_budget_s = node.number(faults, range).unwrap_or(options.time_budget_s);
    }
    if let Some(node) = fields.nullable("max_iterations") {
        options.max_iterations = node.whole(faults, 1, 1 << 53);
    }
    if let Some(node) = fields.optional("seed") {
        options.seed = node.whole(faults, 0, u64::MAX).unwrap_or(options.seed);
    }
    if let Some(node) = fields.optional("threads") {
        let most = limits.max_threads.clamp(1, 64);
        options.threads = node.whole(faults, 1, most).map_or(options.threads, |threads| threads as usize);
    }
    if let Some(node) = fields.optional("guidance") {
        let choices = [
            ("smart", GuidanceKind::Smart),
            ("sequential", GuidanceKind::Sequential),
            ("greedy", GuidanceKind::Greedy),
        ];
        options.guidance = node.choice(faults, &choices).unwrap_or(options.guidance);
    }
    if let Some(node) = fields.optional("schedule") {
        let choices = [("synchronous", Some(Schedule::Synchronous)), ("asynchronous", None)];
        match node.choice(faults, &choices) {
            Some(Some(schedule)) => options.schedule = schedule,
            Some(None) => {
                let message = "asynchronous schedules come in a later version; ask for `synchronous`";
                node.fault(faults, FaultCode::NotImplemented, message);
            }
            None => {}
        }
    }
    if let Some(node) = fields.optional("objective") {
        let choices = [
            ("duration", Objective::Duration),
            ("arc_length", Objective::ArcLength),
            ("steps", Objective::Steps),
        ];
        options.objective = node.choice(faults, &choices).unwrap_or(options.objective);
    }
    if let Some(node) = fields.optional("return_home") {
        options.return_home = node.boolean(faults).unwrap_or(options.return_home);
    }
    if let Some(node) = fields.optional("ik_solutions") {
        options.ik_solutions =
            node.whole(faults, 1, 100).map_or(options.ik_solutions, |count| count as usize);
    }
    if let Some(node) = fields.optional("clearance_m") {
        let range = Range::NonNegative(0.1);
        options.clearance_m = node.number(faults, range).unwrap_or(options.clearance_m);
    }
    if let Some(node) = fields.optional("stop") {
        options.stop = read_stop(&node, faults);
    }
    fields.finish(faults);
    options
}

fn read_stop(node: &Node<'_>, faults: &mut Faults) -> Stop {
    let mut stop = Stop::default();
    let Some(mut fields) = node.fields(faults) else { return stop };
    if let Some(node) = fields.optional("first_solution") {
        stop.first_solution = node.boolean(faults).unwrap_or(false);
    }
    let mut seconds =
        |key| fields.nullable(key).and_then(|node| node.number(faults, Range::Positive(MAX_SECONDS)));
    stop.target_duration_s = seconds("target_duration_s");
    stop.no_improvement_s = seconds("no_improvement_s");
    fields.finish(faults);
    stop
}
