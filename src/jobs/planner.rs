//! What a job's thread runs.

use crate::plan::Plan;
use crate::planner::{Outcome, PlannerCache, PlannerEvent};
use crate::problem::Problem;
use crate::run::Control;

use super::JobRequest;

/// Something that plans. The product has one ([`SmartPlanner`]); tests hand in scripted ones.
pub trait Planner: Send + Sync {
    /// Plans for `problem` until it is solved as asked or `control` says stop, reporting to
    /// `observe`. Must look at `control` at least every 50 ms.
    fn plan(
        &self,
        problem: &Problem,
        control: &Control,
        observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
    ) -> Outcome;

    /// As [`Planner::plan`], with a plan in hand that the judge has accepted. What is reported need
    /// not be better than it: the caller drops what is not.
    fn improve(
        &self,
        problem: &Problem,
        known: &Plan,
        control: &Control,
        observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
    ) -> Outcome {
        let _ = known;
        self.plan(problem, control, observe)
    }
}

/// Reads again what was accepted once, when an earlier process has left it waiting.
pub trait ProblemReader: Send + Sync {
    /// The problem of a request that is in the store, and the plan to begin from.
    ///
    /// # Errors
    /// Says why it cannot be read any more.
    fn read(&self, request: &JobRequest) -> Result<(Problem, Option<Plan>), String>;
}

/// The planner of this crate, [`crate::planner::plan_with`]; clones share compiled workcells.
#[derive(Debug, Clone, Default)]
pub struct SmartPlanner {
    cache: std::sync::Arc<PlannerCache>,
}

impl SmartPlanner {
    /// The planner with what `cache` knows of workcells.
    pub fn new(cache: PlannerCache) -> Self {
        Self { cache: std::sync::Arc::new(cache) }
    }
}

impl Planner for SmartPlanner {
    fn plan(
        &self,
        problem: &Problem,
        control: &Control,
        observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
    ) -> Outcome {
        crate::planner::plan_with(&self.cache, problem, control, observe)
    }

    fn improve(
        &self,
        problem: &Problem,
        known: &Plan,
        control: &Control,
        observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
    ) -> Outcome {
        crate::planner::improve_with(&self.cache, problem, known, control, observe)
    }
}

impl<F> Planner for F
where
    F: Fn(&Problem, &Control, &mut (dyn FnMut(PlannerEvent<'_>) + Send)) -> Outcome + Send + Sync,
{
    fn plan(
        &self,
        problem: &Problem,
        control: &Control,
        observe: &mut (dyn FnMut(PlannerEvent<'_>) + Send),
    ) -> Outcome {
        self(problem, control, observe)
    }
}
