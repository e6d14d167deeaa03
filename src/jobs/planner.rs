//! What a job's thread runs.

use crate::planner::{Outcome, PlannerCache, PlannerEvent};
use crate::problem::Problem;
use crate::run::Control;

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
}

/// The planner of this crate, [`crate::planner::plan_with`]; clones share compiled workcells.
#[derive(Debug, Clone, Default)]
pub struct SmartPlanner {
    cache: std::sync::Arc<PlannerCache>,
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
