//! Plans on the mode graph, and what is known about how good they are.

use super::instance::{ModeState, NodeId};
use super::timetable::Route;

/// One object takes one edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Move {
    /// Index of the object.
    pub object: usize,
    /// Where it was.
    pub from: NodeId,
    /// Where it is afterwards.
    pub to: NodeId,
}

/// A plan on the mode graph: the moves of every step, by object.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solution {
    /// The state before the first step.
    pub start: ModeState,
    /// The steps; each lists its moves in ascending order of objects. None is empty.
    pub steps: Vec<Vec<Move>>,
    /// Sum of the weights of the edges taken.
    pub weight: f64,
}

impl Solution {
    /// The states along the plan: the start, then the state after each step.
    pub fn states(&self) -> Vec<ModeState> {
        let mut state = self.start.clone();
        let mut states = vec![state.clone()];
        for step in &self.steps {
            for action in step {
                if let Some(node) = state.get_mut(action.object) {
                    *node = action.to;
                }
            }
            states.push(state.clone());
        }
        states
    }

    /// The routes of the objects, which rest at the plan's end until `horizon`.
    pub(super) fn routes(&self, horizon: usize) -> Vec<Route> {
        let states = self.states();
        let last = states.len() - 1;
        let route = |object: usize| {
            let at = |step: usize| states[step.min(last)][object].0 as u16;
            (0..=horizon).map(at).collect()
        };
        (0..self.start.len()).map(route).collect()
    }
}

/// How a number of steps was proved to be the least.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Proof {
    /// It was not.
    None,
    /// A lower bound (static loads, or exhaustive search below the plan's length) meets the plan.
    Bounds,
    /// An integer program showed that one step less is impossible.
    Ilp,
}

/// What is known about the least number of steps on the instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Certificate {
    /// Steps of the plan that it comes with.
    pub steps: usize,
    /// No plan has fewer steps than this; 0 when cuts were in force.
    pub lower_bound: usize,
    /// The least number of steps, where proved.
    pub optimum: Option<usize>,
    /// How.
    pub proof: Proof,
}

/// Why no plan exists. Each of these is a proof.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Infeasible {
    /// An object has no path to its goal even if it were alone.
    #[error("object {0} has no path to its goal")]
    NoPath(usize),
    /// The goals cannot all be met at once.
    #[error("the goals of {0} objects leave no room for all of them at once")]
    NoRoom(usize),
    /// Every state that can be reached was looked at.
    #[error("none of the {0} reachable states meets all goals")]
    Exhausted(usize),
}

/// The answer of a solver.
#[derive(Debug, Clone, PartialEq)]
pub enum Answer {
    /// A plan, and what is known about it.
    Solved(Solution, Certificate),
    /// There is no plan on this instance.
    Infeasible(Infeasible),
    /// Neither a plan nor a proof that there is none.
    Unknown {
        /// No plan has fewer steps than this; 0 when cuts were in force.
        lower_bound: usize,
    },
}

impl Answer {
    /// The plan, if there is one.
    pub fn solution(&self) -> Option<&Solution> {
        match self {
            Self::Solved(solution, _) => Some(solution),
            _ => None,
        }
    }

    /// The certificate, if there is a plan.
    pub fn certificate(&self) -> Option<&Certificate> {
        match self {
            Self::Solved(_, certificate) => Some(certificate),
            _ => None,
        }
    }
}
