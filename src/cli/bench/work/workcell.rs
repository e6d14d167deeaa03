//! From the cache to a workcell that is ready to be planned on.

use super::shipped;
use crate::planner::PlannerCache;
use crate::problem::Problem;
use crate::run::Control;

/// A workcell that a cache knows.
#[derive(Debug)]
pub struct KnownWorkcell {
    cache: PlannerCache,
    problem: Problem,
}

impl KnownWorkcell {
    /// That of the shipped scenario `name`, compiled; `None` without it.
    pub fn new(name: &str) -> Option<Self> {
        let (cache, problem) = (PlannerCache::default(), shipped(name)?);
        cache.prepare(&problem, &Control::unbounded());
        Some(Self { cache, problem })
    }

    /// Looks it up and makes it ready for a run; how many arms it has.
    pub fn ready(&self) -> usize {
        self.cache.prepare(&self.problem, &Control::unbounded())
    }
}
