//! The layers put together: bounds, repair search, exhaustive search, relaxation, integer program.
//!
//! Each layer alone is correct; cheap ones come first, and a layer is only asked about the gap
//! that the layers before it left.

use super::bounds::{Reach, static_load};
use super::cuts::Cuts;
use super::instance::{InstanceError, NodeId};
use super::network::Network;
use super::repair::Repair;
use super::solution::{Answer, Certificate, Infeasible, Proof, Solution};
use crate::run::{Control, Seed};

/// How hard a solver tries. All limits count work, never time, so that the same call gives the
/// same answer; a [`Control`] only ends it early.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Effort {
    /// Neighbourhoods of repair at each horizon before the next longer one is tried.
    pub first_rounds: usize,
    /// Neighbourhoods of repair spent, restarts included, on one step less than the best plan.
    pub improve_rounds: usize,
    /// Neighbourhoods spent on less weight at the final number of steps.
    pub polish_rounds: usize,
}

impl Effort {
    /// What a planner can afford many times a second.
    pub fn quick() -> Self {
        Self { first_rounds: 40, improve_rounds: 200, polish_rounds: 16 }
    }

    /// For one proved answer.
    pub fn thorough() -> Self {
        Self { first_rounds: 100, improve_rounds: 5_000, polish_rounds: 200 }
    }
}

impl Default for Effort {
    fn default() -> Self {
        Self::thorough()
    }
}

/// Solves `network` from `state`. With `cuts` in force their penalties count like steps, and
/// nothing is claimed about bounds or infeasibility.
///
/// # Errors
///
/// When `state` is no state of the instance.
pub fn solve(
    network: &Network,
    state: &[NodeId],
    cuts: &Cuts,
    effort: &Effort,
    seed: Seed,
    control: &Control,
) -> Result<Answer, InstanceError> {
    network.instance().validate_state(state)?;
    let start: Vec<u16> = state.iter().map(|node| node.0 as u16).collect();
    Ok(Run { network, start: &start, cuts, effort, seed, control }.solve())
}

struct Run<'a> {
    network: &'a Network,
    start: &'a [u16],
    cuts: &'a Cuts,
    effort: &'a Effort,
    seed: Seed,
    control: &'a Control,
}

impl Run<'_> {
    fn solve(&self) -> Answer {
        let state: Vec<NodeId> = self.start.iter().map(|&node| NodeId(node as usize)).collect();
        if self.network.instance().is_solved(&state) {
            let nothing = Solution { start: state, ..Solution::default() };
            return self.answer(Some(nothing), 0, Proof::Bounds);
        }
        let reach = Reach::new(self.network, self.start);
        let longest = match reach.longest {
            Ok(longest) => longest as usize,
            Err(_) if !self.cuts.is_empty() => return Answer::Unknown { lower_bound: 0 },
            Err(object) => return Answer::Infeasible(Infeasible::NoPath(object)),
        };
        let lower = static_load(self.network, self.start, &reach, longest.max(1));
        let mut repair = Repair::new(self.network, self.start, self.seed.stream("guidance/repair"));
        let mut best = self.first(&mut repair, lower);
        if let Some(solution) = &mut best {
            self.shorten(&mut repair, lower, solution);
        }
        self.answer(best, lower, Proof::Bounds)
    }

    /// The first plan found, at the shortest horizon where one is found quickly.
    fn first(&self, repair: &mut Repair<'_>, lower: usize) -> Option<Solution> {
        let mut horizon = lower;
        let longest = 4 * (lower + 2 * self.network.object_count() + 4);
        while horizon <= longest {
            for shuffled in [false, true] {
                if repair.begin(horizon, self.cuts, shuffled)
                    && repair.run(self.effort.first_rounds, self.control)
                {
                    repair.polish(self.effort.polish_rounds, self.control);
                    return Some(repair.solution());
                }
            }
            if self.control.should_stop() {
                return None;
            }
            horizon += 1 + (horizon - lower) / 4;
        }
        None
    }

    /// Plans with fewer steps, down to `lower`, until the effort is spent.
    fn shorten(&self, repair: &mut Repair<'_>, lower: usize, best: &mut Solution) {
        let mut spent = 0;
        while best.steps.len() > lower && spent < self.effort.improve_rounds && !self.control.should_stop() {
            let rounds = self.effort.first_rounds * 4;
            spent += rounds;
            if repair.begin(best.steps.len() - 1, self.cuts, true) && repair.run(rounds, self.control) {
                repair.polish(self.effort.polish_rounds, self.control);
                *best = repair.solution();
                spent = 0;
            }
        }
    }

    fn answer(&self, best: Option<Solution>, lower_bound: usize, proof: Proof) -> Answer {
        let lower_bound = if self.cuts.is_empty() { lower_bound } else { 0 };
        let Some(solution) = best else {
            return Answer::Unknown { lower_bound };
        };
        let steps = solution.steps.len();
        let proved = self.cuts.is_empty() && steps == lower_bound;
        let certificate = Certificate {
            steps,
            lower_bound,
            optimum: proved.then_some(steps),
            proof: if proved { proof } else { Proof::None },
        };
        Answer::Solved(solution, certificate)
    }
}
