//! How much work the solvers may spend.

/// Objects times steps up to which plans that avoid cuts are made anew in haste.
const FEW_STOPS: usize = 200;

/// How hard a solver tries. All limits count work, never time, so that the same call gives the
/// same answer; a [`crate::run::Control`] only ends it early.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Effort {
    /// Neighbourhoods of repair at each horizon before a longer one is tried.
    pub first_rounds: usize,
    /// Rounds of the relaxation at each horizon before a longer one is tried.
    pub first_refutations: usize,
    /// Neighbourhoods of repair, restarts included, spent on one step less than the best plan.
    pub repair_rounds: usize,
    /// Rounds of the relaxation spent on the shortest horizon that is still open.
    pub refutations: usize,
    /// Bound on each batch of either kind of rounds: how many pairs of a node and a step the routes
    /// planned in it may look at together. Keeps large instances from taking long.
    pub batch: usize,
    /// States that the exhaustive search may expand in all.
    pub states: usize,
    /// Neighbourhoods spent on less weight at the final number of steps.
    pub polish_rounds: usize,
    /// Iterations of linear programs that the integer program may spend on each horizon; 0: none.
    pub program_iterations: u64,
    /// Nodes of its tree.
    pub program_nodes: u64,
    /// Under cuts, plans that are several steps longer and plans made anew are looked at only where objects times
    /// steps, the stops of all routes, are at most this many.
    pub most_stops: usize,
}

impl Effort {
    /// What a planner can afford many times a second.
    pub fn quick() -> Self {
        Self {
            first_rounds: 60,
            first_refutations: 60,
            repair_rounds: 200,
            refutations: 100,
            batch: 3_000_000,
            states: 2_000,
            polish_rounds: 16,
            program_iterations: 0,
            program_nodes: 0,
            most_stops: usize::MAX,
        }
    }

    /// For a first plan with few objects: more work hardly ever makes it shorter, and may take longer than its motions. The
    /// number of steps is proved less often.
    pub fn brief() -> Self {
        Self { first_rounds: 30, repair_rounds: 50, refutations: 40, states: 400, ..Self::quick() }
    }

    /// What a planner can afford where most of what is planned fails, so that little is gained by the best of plans.
    pub fn hasty() -> Self {
        Self { most_stops: FEW_STOPS, ..Self::quick() }
    }

    /// For any plan, where a quick look finds none.
    pub fn any_plan() -> Self {
        let thorough = Self::thorough();
        Self { repair_rounds: 0, refutations: 0, states: 0, program_iterations: 0, ..thorough }
    }

    /// For an answer that is to be proved.
    pub fn thorough() -> Self {
        Self {
            first_rounds: 60,
            first_refutations: 60,
            repair_rounds: 16_000,
            refutations: 1_500,
            batch: 60_000_000,
            states: 100_000,
            polish_rounds: 100,
            program_iterations: 400_000,
            program_nodes: 20_000,
            most_stops: usize::MAX,
        }
    }
}

impl Default for Effort {
    fn default() -> Self {
        Self::quick()
    }
}
