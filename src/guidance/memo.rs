//! What guidance remembers: plans by the mode states that they pass through. From a state on a
//! known plan's way the rest of that plan is the answer, and its certificate carries over: what is
//! left of a shortest plan is a shortest plan.

use super::cuts::{Cut, Cuts};
use super::instance::{ModeState, NodeId};
use super::network::Network;
use super::solution::{Answer, Certificate, Infeasible, Proof, Solution};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Remembered answers of one network and one strategy. Plans found under cuts are good for exactly
/// those cuts, and forgotten when others come into force.
#[derive(Debug, Clone, Default)]
pub struct Memo {
    free: BTreeMap<ModeState, Entry>,
    dead: BTreeMap<ModeState, Infeasible>,
    cuts: Vec<Cut>,
    tolled: BTreeMap<ModeState, Entry>,
    /// The latest plans under any cuts.
    hints: BTreeMap<ModeState, Entry>,
}

/// States for which a plan under other cuts is remembered.
const MOST_HINTS: usize = 4000;

#[derive(Debug, Clone)]
struct Entry {
    plan: Arc<Solution>,
    offset: usize,
    lower_bound: usize,
    proof: Proof,
}

impl Entry {
    fn left(&self) -> usize {
        self.plan.steps.len() - self.offset
    }
}

impl Memo {
    /// Remembers nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of states with a known answer.
    pub fn len(&self) -> usize {
        self.free.len() + self.dead.len() + self.tolled.len()
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What is known about `state` under `cuts`.
    pub fn find(&self, network: &Network, state: &[NodeId], cuts: &Cuts) -> Option<Answer> {
        let known = if cuts.is_empty() {
            if let Some(&reason) = self.dead.get(state) {
                return Some(Answer::Infeasible(reason));
            }
            &self.free
        } else if self.cuts == cuts.active() {
            &self.tolled
        } else {
            return None;
        };
        let entry = known.get(state)?;
        let steps = entry.plan.steps.get(entry.offset..)?.to_vec();
        let count = steps.len();
        let certificate = Certificate {
            steps: count,
            lower_bound: entry.lower_bound,
            optimum: (entry.proof != Proof::None).then_some(count),
            proof: entry.proof,
        };
        let weight = network.weight_of_steps(&steps);
        Some(Answer::Solved(Solution { start: state.to_vec(), steps, weight }, certificate))
    }

    /// A plan from `state` that was good under some cuts, or under none.
    pub(super) fn hint(&self, network: &Network, state: &[NodeId]) -> Option<Solution> {
        let entry = self.hints.get(state).or_else(|| self.free.get(state))?;
        let steps = entry.plan.steps.get(entry.offset..)?.to_vec();
        let weight = network.weight_of_steps(&steps);
        Some(Solution { start: state.to_vec(), steps, weight })
    }

    /// Remembers `plan` as something to begin with under cuts, for every state on its way.
    pub fn suggest(&mut self, plan: &Solution) {
        let shared = Arc::new(plan.clone());
        for (offset, state) in plan.states().into_iter().enumerate() {
            if self.hints.len() >= MOST_HINTS {
                self.hints.clear();
            }
            let entry = Entry { plan: shared.clone(), offset, lower_bound: 0, proof: Proof::None };
            self.hints.insert(state, entry);
        }
    }

    /// Remembers `answer` to `state` under `cuts`, for every state on its way. A state keeps its
    /// shorter plan, and of two equal ones the proved one.
    pub fn keep(&mut self, state: &[NodeId], answer: &Answer, cuts: &Cuts) {
        if !cuts.is_empty() && self.cuts != cuts.active() {
            self.cuts = cuts.active().to_vec();
            self.tolled.clear();
        }
        let known = if cuts.is_empty() { &mut self.free } else { &mut self.tolled };
        match answer {
            Answer::Solved(solution, certificate) => {
                let plan = Arc::new(solution.clone());
                for (offset, state) in solution.states().into_iter().enumerate() {
                    let entry = Entry {
                        plan: plan.clone(),
                        offset,
                        lower_bound: certificate.lower_bound.saturating_sub(offset),
                        proof: certificate.proof,
                    };
                    if !cuts.is_empty() {
                        if self.hints.len() >= MOST_HINTS {
                            self.hints.clear();
                        }
                        self.hints.insert(state.clone(), entry.clone());
                    }
                    let old = known.get(&state);
                    let better = old.is_none_or(|old| {
                        (entry.left(), entry.proof == Proof::None) < (old.left(), old.proof == Proof::None)
                    });
                    if better {
                        known.insert(state, entry);
                    }
                }
            }
            Answer::Infeasible(reason) => {
                self.dead.insert(state.to_vec(), *reason);
            }
            Answer::Unknown { .. } => {}
        }
    }
}
