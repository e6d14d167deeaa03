//! Hands that differ in nothing that matters.

use crate::problem::Problem;
use crate::workcell::ArmId;

use super::contacts::same_hand;

/// The kinds of hands in a workcell.
#[derive(Debug, Clone)]
pub(super) struct Hands {
    /// By arm, the first arm with an equal hand.
    kinds: Vec<usize>,
}

impl Hands {
    /// The hands of the problem's arms.
    pub(super) fn new(problem: &Problem) -> Self {
        let count = problem.workcell.arms.len();
        let first =
            |arm: usize| (0..arm).find(|&other| same_hand(problem, ArmId(other), ArmId(arm))).unwrap_or(arm);
        Self { kinds: (0..count).map(first).collect() }
    }

    /// The kind of the arm's hand.
    pub(super) fn kind(&self, arm: ArmId) -> usize {
        self.kinds.get(arm.0).copied().unwrap_or(arm.0)
    }
}
