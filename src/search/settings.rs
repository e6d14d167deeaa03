//! Settings of the tree search.

/// Settings of the tree search; all defaults are here.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Chance of selecting the tau that has made the most progress; below 1.
    pub goal_bias: f64,
    /// The same while a first plan is sought for many objects: there are so many other taus that looking at them costs
    /// more than it gains.
    pub crowded_bias: f64,
    /// Chance of another sequence of actions than the guided one, once there is an incumbent: with
    /// another first action, or under a passing cut. Above 0.
    pub wander: f64,
    /// The same before there is one, where a tau has failed. Above 0.
    pub stuck_wander: f64,
    /// Chance of sampling new transitions although some are known. Above 0.
    pub fresh_transitions: f64,
    /// Chance of planning a window of the incumbent again instead of growing the tree; below 1.
    pub refinement: f64,
    /// Iterations after the first plan in which one with fewer steps is sought before windows are planned again,
    /// where there may be one.
    pub fewer_steps_first: u64,
    /// Vertices that each roadmap gains on each growth; above 0.
    pub growth: usize,
    /// A growth happens once in so many iterations.
    pub growth_period: u64,
    /// Groundings tried for one expansion.
    pub groundings: usize,
    /// Draws of a meeting place tried for one handoff.
    pub handoff_tries: usize,
    /// Iterations for which a cut lasts.
    pub cut_lifetime: u64,
    /// The same while the incumbent has more steps than the mode graph asks for.
    pub brief_lifetime: u64,
    /// Iterations for which it is remembered that one object stands in the way of an action on
    /// another.
    pub block_lifetime: u64,
    /// Failed expansions after which a tau is set aside for good by the biased selection.
    pub surrender: u32,
    /// Vertices of the tree; beyond, those that lie on no way to the incumbent are dropped.
    pub greatest_tree: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            goal_bias: 0.85,
            crowded_bias: 0.95,
            wander: 0.1,
            stuck_wander: 0.5,
            fresh_transitions: 0.15,
            refinement: 0.6,
            fewer_steps_first: 100,
            growth: 20,
            growth_period: 50,
            groundings: 6,
            handoff_tries: 120,
            cut_lifetime: 60,
            brief_lifetime: 6,
            block_lifetime: 500,
            surrender: 12,
            greatest_tree: 4000,
        }
    }
}
