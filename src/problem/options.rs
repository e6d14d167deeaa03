//! Options of a run, with FORMAT.md's defaults.

/// Which guidance steers the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GuidanceKind {
    /// Path finding for all objects at once on the mode graph (the paper's SMART).
    Smart,
    /// One unfinished object after the other.
    Sequential,
    /// Every object's own next move, regardless of the others.
    Greedy,
}

/// How the steps are laid out in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schedule {
    /// All actions of a step end together.
    Synchronous,
}

/// What makes one plan better than another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Objective {
    /// Seconds until all is done.
    Duration,
    /// The largest Euclidean length over the arms of their joint paths.
    ArcLength,
    /// Synchronised steps, then duration.
    Steps,
}

impl Objective {
    /// The cost of a plan with these figures (s, rad or m, steps): what comes first counts first, and
    /// less is better.
    pub fn cost(self, duration: f64, arc_length: f64, steps: usize) -> [f64; 2] {
        match self {
            Self::Duration => [duration, arc_length],
            Self::ArcLength => [arc_length, duration],
            Self::Steps => [steps as f64, duration],
        }
    }
}

/// When to stop before the budget ends.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stop {
    /// At the first plan.
    pub first_solution: bool,
    /// At a plan of at most this duration (s).
    pub target_duration_s: Option<f64>,
    /// When the best plan has not improved for this long (s).
    pub no_improvement_s: Option<f64>,
}

/// Options of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Wall-clock budget (s), validation included.
    pub time_budget_s: f64,
    /// Budget of iterations of Algorithm 1; with it a run on one thread repeats bit for bit.
    pub max_iterations: Option<u64>,
    /// Seed of all randomness.
    pub seed: u64,
    /// Planner threads.
    pub threads: usize,
    /// Guidance.
    pub guidance: GuidanceKind,
    /// Schedule.
    pub schedule: Schedule,
    /// Objective.
    pub objective: Objective,
    /// Whether all arms go back home in the end.
    pub return_home: bool,
    /// IK solutions per transition.
    pub ik_solutions: usize,
    /// Stop conditions.
    pub stop: Stop,
    /// Clearance (m) that the planner certifies.
    pub clearance_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            time_budget_s: 30.0,
            max_iterations: None,
            seed: 0,
            threads: 1,
            guidance: GuidanceKind::Smart,
            schedule: Schedule::Synchronous,
            objective: Objective::Duration,
            return_home: false,
            ik_solutions: 5,
            stop: Stop::default(),
            clearance_m: 0.002,
        }
    }
}
