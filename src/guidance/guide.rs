//! What the search asks of guidance: from a mode state, what to do next and where to head.

use super::cuts::Cuts;
use super::effort::Effort;
use super::instance::{InstanceError, NodeId};
use super::memo::Memo;
use super::network::Network;
use super::solution::{Answer, Certificate, Infeasible, Move, Solution};
use super::solver::{solve, solve_near};
use crate::run::{Control, Seed};

/// The first action in a plan in which an arm takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArmAction {
    /// The arm, by the least of its nodes.
    pub arm: NodeId,
    /// In which step, from 1.
    pub step: usize,
    /// The action.
    pub action: Move,
}

/// A way to go.
#[derive(Debug, Clone, PartialEq)]
pub struct Guide {
    /// The moves of the next step: the paper's modal goal. Empty when all goals are met.
    pub immediate: Vec<Move>,
    /// For every arm that the plan uses at all, its first action, by ascending arm: the paper's
    /// longer-range heuristic.
    pub heuristic: Vec<ArmAction>,
    /// Steps from here to the end, where the guide knows a way to the end.
    pub remaining_steps: Option<usize>,
    /// How good the whole plan is, where that is known.
    pub certificate: Option<Certificate>,
    /// The plan that the guide follows; for a guide without foresight, its next step only.
    pub solution: Solution,
}

impl Guide {
    /// The guide that follows `solution`, which ends with all goals met.
    pub fn along(network: &Network, solution: Solution, certificate: Option<Certificate>) -> Self {
        Self {
            immediate: solution.steps.first().cloned().unwrap_or_default(),
            heuristic: first_actions(network, &solution.steps),
            remaining_steps: Some(solution.steps.len()),
            certificate,
            solution,
        }
    }
}

/// What guidance says.
#[derive(Debug, Clone, PartialEq)]
pub enum Advice {
    /// Go this way.
    Go(Guide),
    /// No plan exists from here. Never said under cuts.
    Infeasible(Infeasible),
    /// No way is known from here.
    Unknown {
        /// No plan has fewer steps than this; 0 under cuts.
        lower_bound: usize,
    },
}

/// A strategy on the mode graph.
pub trait Guidance: std::fmt::Debug + Send + Sync {
    /// Its name on the wire.
    fn name(&self) -> &'static str;

    /// What to do from `state`. `memo` belongs to this network and this strategy; `cuts` are what
    /// motion failed on lately.
    ///
    /// # Errors
    ///
    /// When `state` is no state of the network's instance.
    fn guide(
        &self,
        network: &Network,
        state: &[NodeId],
        cuts: &Cuts,
        memo: &mut Memo,
        control: &Control,
    ) -> Result<Advice, InstanceError>;
}

/// All objects together: the solver of [`super::solve`].
#[derive(Debug, Clone)]
pub struct Smart {
    /// How hard to try from each new state. Where that gives neither a plan nor a proof that there is
    /// none, [`Effort::thorough`] follows.
    pub effort: Effort,
    /// For the random choices of the solver.
    pub seed: Seed,
}

impl Guidance for Smart {
    fn name(&self) -> &'static str {
        "smart"
    }

    fn guide(
        &self,
        network: &Network,
        state: &[NodeId],
        cuts: &Cuts,
        memo: &mut Memo,
        control: &Control,
    ) -> Result<Advice, InstanceError> {
        let answer = match memo.find(network, state, cuts) {
            Some(answer) => answer,
            None => {
                let mut hint = if cuts.is_empty() { None } else { memo.hint(network, state) };
                if hint.is_none() && !cuts.is_empty() && network.object_count() > FEW_OBJECTS {
                    hint = self.without_cuts(network, state, memo, control)?;
                }
                let mut answer =
                    solve_near(network, state, cuts, &self.effort, self.seed, control, hint.as_ref())?;
                if matches!(answer, Answer::Unknown { .. }) && !control.should_stop() {
                    // Better late than lost, and better dear than none.
                    if cuts.is_empty() {
                        answer = solve(network, state, cuts, &Effort::thorough(), self.seed, control)?;
                    } else if let Some(plan) = self.without_cuts(network, state, memo, control)? {
                        answer =
                            solve_near(network, state, cuts, &self.effort, self.seed, control, Some(&plan))?;
                    }
                }
                memo.keep(state, &answer, cuts);
                answer
            }
        };
        Ok(match answer {
            Answer::Solved(solution, certificate) => {
                Advice::Go(Guide::along(network, solution, Some(certificate)))
            }
            Answer::Infeasible(reason) => Advice::Infeasible(reason),
            Answer::Unknown { lower_bound } => Advice::Unknown { lower_bound },
        })
    }
}

/// Objects up to which a plan that avoids cuts is made at once; with more it is easier to change one that does
/// not.
const FEW_OBJECTS: usize = 16;

impl Smart {
    /// A plan from `state` that minds no cuts.
    fn without_cuts(
        &self,
        network: &Network,
        state: &[NodeId],
        memo: &mut Memo,
        control: &Control,
    ) -> Result<Option<Solution>, InstanceError> {
        let none = Cuts::none();
        let answer = match memo.find(network, state, &none) {
            Some(answer) => answer,
            None => {
                let mut answer = solve(network, state, &none, &self.effort, self.seed, control)?;
                if matches!(answer, Answer::Unknown { .. }) && !control.should_stop() {
                    answer = solve(network, state, &none, &Effort::any_plan(), self.seed, control)?;
                }
                memo.keep(state, &answer, &none);
                answer
            }
        };
        Ok(answer.solution().cloned())
    }
}

/// The first action of every arm in `steps`, by ascending arm.
pub(super) fn first_actions(network: &Network, steps: &[Vec<Move>]) -> Vec<ArmAction> {
    let mut first = Vec::new();
    for (number, nodes) in network.arms.iter().enumerate() {
        let is_this = |node: NodeId| network.arm_number[node.0] == number;
        let found = steps.iter().enumerate().find_map(|(index, moves)| {
            let action = moves.iter().find(|action| is_this(action.from) || is_this(action.to))?;
            Some(ArmAction { arm: NodeId(*nodes.first()? as usize), step: index + 1, action: *action })
        });
        first.extend(found);
    }
    first
}
