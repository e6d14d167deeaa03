//! What a run reports, and how it ends.

use crate::plan::Plan;

/// What a run reports while it goes on.
#[derive(Debug)]
pub enum PlannerEvent<'a> {
    /// A sign of life; at most a few a second.
    Progress {
        /// Seconds since the run started.
        elapsed_s: f64,
        /// What it does from now on: `workcell`, `mode_graph`, `guidance`, `search`, `improve`, in
        /// this order; each is reported when it begins.
        phase: &'static str,
        /// Iterations of Algorithm 1 so far.
        iterations: u64,
        /// Lower bound on the steps of any synchronised plan, once known.
        steps_lower_bound: Option<usize>,
    },
    /// The judge has looked at a candidate. When it has accepted it and the candidate is still better
    /// than what is known, [`PlannerEvent::Incumbent`] follows.
    Judged {
        /// When the candidate was complete, in seconds since the run started.
        candidate_s: f64,
        /// When the judge got it, with the proof of how few steps any plan needs, in seconds since the run started.
        handed_in_s: f64,
        /// How long (s) the search that found it had been timing paths until then, since it began.
        timing_s: f64,
        /// When the judge had spoken, in seconds since the run started.
        judged_s: f64,
        /// What the judge said.
        valid: bool,
    },
    /// A better plan, already accepted by the judge.
    Incumbent(&'a Plan),
}

/// Why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Termination {
    /// The time or iteration budget ended with a plan in hand.
    TimeLimit,
    /// The objective `steps` was proved to be at its least.
    Optimal,
    /// `stop.target_duration_s` was reached.
    TargetReached,
    /// `stop.first_solution` was asked for.
    FirstSolution,
    /// `stop.no_improvement_s` passed without a better plan.
    NoImprovement,
    /// The optimistic graph has no solution: no plan exists.
    Infeasible,
    /// The budget ended without a plan.
    NoSolutionFound,
    /// The run was cancelled.
    Cancelled,
}

/// How a run ended.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Why.
    pub termination: Termination,
    /// The best plan, if any.
    pub best: Option<Plan>,
    /// The likely cause, when there is no plan.
    pub diagnosis: Option<String>,
}
