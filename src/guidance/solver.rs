//! The layers put together: bounds, repair search, exhaustive search, relaxation, integer program.
//!
//! Each layer alone is correct; cheap ones come first, and a layer is only asked about the gap
//! that the layers before it left.

use super::beat::turns;
use super::bounds::{Reach, static_load};
use super::cuts::Cuts;
use super::effort::Effort;
use super::exhaustive::{Exhaustive, Verdict};
use super::instance::{InstanceError, NodeId};
use super::interruptible::Limits;
use super::network::Network;
use super::program::{Commodities, Outcome, decide};
use super::relaxation::Relaxation;
use super::repair::{MANY, Repair};
use super::route::BIAS;
use super::solution::{Answer, Certificate, Infeasible, Proof, Solution};
use crate::run::{Control, Part, Seed};

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
    solve_near(network, state, cuts, effort, seed, control, None)
}

/// [`solve`]; under cuts the plan `hint` from the same state, where there is one, is changed to
/// avoid them rather than a new one made.
pub(super) fn solve_near(
    network: &Network,
    state: &[NodeId],
    cuts: &Cuts,
    effort: &Effort,
    seed: Seed,
    control: &Control,
    hint: Option<&Solution>,
) -> Result<Answer, InstanceError> {
    control.spent.during(Part::Guidance, || solve_timed(network, state, cuts, effort, seed, control, hint))
}

/// [`solve_near`], for which the clock runs.
fn solve_timed(
    network: &Network,
    state: &[NodeId],
    cuts: &Cuts,
    effort: &Effort,
    seed: Seed,
    control: &Control,
    hint: Option<&Solution>,
) -> Result<Answer, InstanceError> {
    network.instance().validate_state(state)?;
    if network.instance().is_solved(state) {
        let nothing = Solution { start: state.to_vec(), ..Solution::default() };
        return Ok(answer(Some(nothing), 0, Proof::Bounds, cuts));
    }
    let start: Vec<u16> = state.iter().map(|node| node.0 as u16).collect();
    let reach = Reach::new(network, &start);
    let longest = match reach.longest {
        Ok(longest) => usize::from(longest),
        Err(_) if !cuts.is_empty() => return Ok(Answer::Unknown { lower_bound: 0 }),
        Err(object) => return Ok(Answer::Infeasible(Infeasible::NoPath(object))),
    };
    let (lower, weights) = static_load(network, &start, &reach, longest.max(1));
    let mut relaxation = Relaxation::default();
    relaxation.begin(network, &start, lower);
    relaxation.price_arms(network, &weights);
    let run = Run {
        network,
        start: &start,
        cuts,
        effort,
        control,
        reach: &reach,
        lower,
        proof: Proof::Bounds,
        repair: Repair::new(network, &start, seed.stream("guidance/repair")),
        relaxation,
        exhaustive: None,
        states: effort.states,
        best: None,
        hint,
        turns: None,
        attempts: ["guidance/near", "guidance/far"].map(|name| Attempt {
            repair: Repair::new(network, &start, seed.stream(name)),
            horizon: usize::MAX,
            rounds: 0,
            tries: 0,
        }),
    };
    Ok(run.solve())
}

/// Neighbourhoods of repair before the relaxation has its first word on a horizon.
const OPENING: usize = 6;
/// States that the exhaustive search expands at each horizon before a longer one is tried.
const FIRST_STATES: usize = 150;
/// Objects in a neighbourhood, on average.
const USUAL_NEIGHBOURHOOD: usize = 4;
/// Horizons that fail before it is suspected that there is no plan at all.
const SUSPICIOUS: usize = 5;
/// What a plan costs beyond its steps from which on others are made anew.
const DEAR: u64 = 6;
/// Objects up to which that is done.
const FEW_OBJECTS: usize = 16;
/// How many steps those may have beyond.
const LITTLE_LONGER: usize = 6;
/// States looked at upon that suspicion.
const FEW_STATES: usize = 1_000;

struct Run<'a> {
    network: &'a Network,
    start: &'a [u16],
    cuts: &'a Cuts,
    effort: &'a Effort,
    control: &'a Control,
    reach: &'a Reach,
    /// How `lower` was found.
    proof: Proof,
    /// No plan has fewer steps (cuts aside); the horizon at which `relaxation` works.
    lower: usize,
    repair: Repair<'a>,
    relaxation: Relaxation,
    /// The exhaustive search, once it was asked for; `None` in it where states are too large for it.
    exhaustive: Option<Option<Exhaustive<'a>>>,
    /// What is left for the exhaustive search.
    states: usize,
    best: Option<Solution>,
    hint: Option<&'a Solution>,
    /// By arm, when it takes on the beat; once that was asked for.
    turns: Option<Vec<bool>>,
    /// The search for shorter plans, one step shorter ([`NEAR`]) and as short as may be ([`FAR`]).
    attempts: [Attempt<'a>; 2],
}

const NEAR: usize = 0;
const FAR: usize = 1;

/// Bound on the pairs of a node and a step that the relaxation looks at in 64 rounds: many of its rounds
/// are worth their while on small instances only.
const RELAXED: usize = 4_000_000;

/// Rounds of repair after which an attempt is begun anew.
const PATIENCE: usize = 6_000;

/// Repair at one horizon that goes on over several shares of effort.
struct Attempt<'a> {
    repair: Repair<'a>,
    horizon: usize,
    /// Rounds since it was begun.
    rounds: usize,
    /// How often it was begun.
    tries: usize,
}

impl<'a> Run<'a> {
    fn solve(mut self) -> Answer {
        if !self.cuts.is_empty() {
            self.under_cuts();
            return answer(self.best, 0, Proof::None, self.cuts);
        }
        if let Some(reason) = self.first() {
            return Answer::Infeasible(reason);
        }
        self.close();
        if self.effort.program_iterations > 0 {
            self.decide();
        }
        answer(self.best, self.lower, self.proof, self.cuts)
    }

    /// Asks the integer program about one step less than the best plan, until that is impossible.
    fn decide(&mut self) {
        let limits = Limits {
            control: self.control,
            iterations: self.effort.program_iterations,
            nodes: self.effort.program_nodes,
        };
        let mut merge = Commodities::Twins;
        while self.best.is_some() && !self.is_over() {
            let horizon = self.steps() - 1;
            match decide(self.network, self.start, self.reach, horizon, merge, &limits) {
                Outcome::Infeasible => {
                    self.lower = horizon + 1;
                    self.proof = Proof::Ilp;
                }
                Outcome::Routes(routes) => {
                    self.repair.all_slots(true);
                    self.repair.take_over(routes, self.cuts);
                    if self.repair.run(self.effort.repair_rounds, self.control) {
                        self.keep();
                    } else if merge == Commodities::Twins {
                        merge = Commodities::Kinds;
                    } else {
                        return;
                    }
                }
                Outcome::Unclear if merge == Commodities::Twins => merge = Commodities::Kinds,
                Outcome::Unclear | Outcome::Limit => return,
            }
        }
    }

    fn steps(&self) -> usize {
        self.best.as_ref().map_or(usize::MAX, |best| best.steps.len())
    }

    /// How many of `rounds` rounds that plan `routes` routes each fit into one batch.
    fn affordable(&self, rounds: usize, routes: usize, horizon: usize) -> usize {
        let each = (routes * self.network.node_count() * horizon).max(1);
        rounds.min((self.effort.batch / each).max(1))
    }

    /// Plans all objects anew at `horizon`, along the prices of the relaxation: what is cheap there
    /// leaves the others the most room.
    fn begin(&mut self, horizon: usize, shuffled: bool) -> bool {
        self.relaxation.node_prices(self.network, horizon, BIAS, self.repair.bias());
        self.repair.begin(horizon, self.cuts, shuffled)
    }

    /// Repairs the current routes at `horizon`.
    fn mend(&mut self, rounds: usize, horizon: usize) -> bool {
        let rounds = self.affordable(rounds, USUAL_NEIGHBOURHOOD, horizon);
        self.repair.run(rounds, self.control)
    }

    /// Tries to refute the horizon `lower`.
    fn refute(&mut self, rounds: usize) -> bool {
        let routes = self.network.object_count();
        let most = RELAXED / (routes * self.network.node_count() * self.lower).max(1);
        let rounds = self.affordable(rounds, routes, self.lower).min(most * rounds / 64 + 1);
        self.relaxation.refute(self.network, self.start, rounds, self.control)
    }

    /// Rounds of the relaxation that plan about as many routes as the repairs of a share do.
    fn as_much_as_repairs(&self, share: usize) -> usize {
        (16 * USUAL_NEIGHBOURHOOD * share / self.network.object_count().max(1)).clamp(1, 8 * share)
    }

    /// Whether there is nothing left to do, or no leave to do it.
    fn is_over(&self) -> bool {
        self.steps() <= self.lower || self.control.should_stop()
    }

    fn raise_lower(&mut self) {
        self.lower += 1;
        self.relaxation.lengthen();
    }

    fn keep(&mut self) {
        self.repair.bias().clear();
        self.repair.beat(None);
        self.repair.polish(self.effort.polish_rounds, self.control);
        let found = self.repair.solution();
        if found.steps.len() < self.steps() {
            self.best = Some(found);
        }
    }

    /// The first plan, at the shortest horizon that is not quickly seen to be too short; horizons
    /// are refuted on the way as far as that is quick. Where no plan turns up, all states are looked
    /// at, if they are few: then the reason why there is none is returned.
    fn first(&mut self) -> Option<Infeasible> {
        let longest = 4 * (self.lower + 2 * self.network.object_count() + 4);
        let mut horizon = self.lower;
        let (mut open, mut tried) = (false, 0);
        while horizon <= longest {
            tried += 1;
            if tried == SUSPICIOUS {
                if let Some(reason) = self.exhaust(FEW_STATES) {
                    return Some(reason);
                }
                if self.best.is_some() {
                    return None;
                }
            }
            self.repair.all_slots(false);
            if self.begin(horizon, false) && self.mend(OPENING, horizon) {
                self.keep();
                return None;
            }
            if !open && self.refute(self.effort.first_refutations / 4) {
                self.raise_lower();
                horizon += 1;
                continue;
            }
            if !open && self.search(horizon, FIRST_STATES) {
                if self.best.is_some() {
                    return None;
                }
                horizon += 1;
                continue;
            }
            if self.mend(self.effort.first_rounds, horizon) {
                self.keep();
                return None;
            }
            if !open && self.refute(self.effort.first_refutations) {
                self.raise_lower();
                horizon += 1;
                continue;
            }
            self.repair.all_slots(true);
            let turns = self.turns();
            self.repair.beat(Some(&turns));
            if self.begin(horizon, true) && self.mend(self.effort.first_rounds, horizon) {
                self.keep();
                return None;
            }
            self.repair.beat(None);
            if self.control.should_stop() {
                return None;
            }
            open = true;
            horizon += 1 + (horizon - self.lower) / 4;
        }
        self.exhaust(self.effort.states)
    }

    /// Looks at all states that can be reached, if they are at most `states`: for the reason why there
    /// is no plan, or for any plan.
    fn exhaust(&mut self, states: usize) -> Option<Infeasible> {
        let (start, states) = (self.start, states.min(self.effort.states));
        let control = self.control;
        match self.exhaustive()?.all(start, states, control) {
            Verdict::Refuted(states) => return Some(Infeasible::Exhausted(states)),
            Verdict::Found(states) => self.keep_states(&states),
            Verdict::Limit => {}
        }
        None
    }

    /// Keeps the plan that leads through `states`.
    fn keep_states(&mut self, states: &[Vec<u16>]) {
        let objects = 0..self.network.object_count();
        let routes = objects.map(|object| states.iter().map(|state| state[object]).collect());
        self.repair.take_over(routes.collect(), self.cuts);
        self.keep();
    }

    /// The exhaustive search, if states are small enough for it.
    fn exhaustive(&mut self) -> Option<&mut Exhaustive<'a>> {
        self.exhaustive.get_or_insert_with(|| Exhaustive::new(self.network)).as_mut()
    }

    /// Exhaustive search at `horizon`: true if it found a plan or raised the lower bound beyond.
    fn search(&mut self, horizon: usize, states: usize) -> bool {
        let states = states.min(self.states);
        let (start, control) = (self.start, self.control);
        let Some(exhaustive) = self.exhaustive().filter(|_| states > 0) else {
            return false;
        };
        let verdict = exhaustive.within(start, horizon, states, control);
        self.states -= states;
        match verdict {
            Verdict::Found(states) => {
                self.keep_states(&states);
                true
            }
            Verdict::Refuted(spent) => {
                self.states += states - spent;
                while self.lower <= horizon {
                    self.raise_lower();
                }
                true
            }
            Verdict::Limit => false,
        }
    }

    /// Closes the gap from both sides, with shares of effort that double: by plans of one step less than
    /// the best, by plans as short as nothing is known against, and by proofs that there are none.
    fn close(&mut self) {
        let (mut repairs, mut refutations) = (self.effort.repair_rounds, self.effort.refutations);
        let mut share = 1;
        while self.best.is_some() && !self.is_over() {
            let horizon = self.steps() - 1;
            let mut found = false;
            // Of many objects the bound is rarely attained at once.
            let far = if self.network.object_count() > MANY { 4 * share } else { 16 * share };
            for (which, horizon, rounds) in [(NEAR, horizon, 16 * share), (FAR, self.lower, far)] {
                let rounds = rounds.min(repairs);
                let twice = which == FAR && horizon + 1 == self.steps();
                if rounds > 0 && !twice && !found && !self.control.should_stop() {
                    repairs -= rounds;
                    found = self.attempt(which, horizon, rounds);
                }
            }
            if found {
                (repairs, share) = (self.effort.repair_rounds, 1);
                continue;
            }
            let rounds = self.as_much_as_repairs(share).min(refutations);
            refutations -= rounds;
            if self.refute(rounds) {
                self.raise_lower();
                refutations = self.effort.refutations;
                continue;
            }
            if self.search(horizon, 50 * share) {
                continue;
            }
            let states_left = self.states > 0 && self.exhaustive().is_some();
            if repairs == 0 && refutations == 0 && !states_left {
                return;
            }
            share *= 2;
        }
    }

    /// By arm, when it takes on the beat.
    fn turns(&mut self) -> Vec<bool> {
        self.turns.get_or_insert_with(|| turns(self.network, self.start, self.reach)).clone()
    }

    /// Goes on with the attempt at `horizon`, or begins one; true if it came to a plan.
    fn attempt(&mut self, which: usize, horizon: usize, rounds: usize) -> bool {
        let Attempt { repair, horizon: old, rounds: spent, tries } = &mut self.attempts[which];
        std::mem::swap(repair, &mut self.repair);
        let (fresh, tried) = (*old != horizon || *spent >= PATIENCE, *tries);
        if fresh {
            (*old, *spent, *tries) = (horizon, 0, tried + 1);
        }
        *spent += rounds;
        if fresh {
            // On the beat, off it, and on the other.
            let turned: Vec<bool> = self.turns().iter().map(|turn| turn ^ (tried % 3 == 2)).collect();
            self.repair.beat((tried % 3 != 1).then_some(&turned));
            self.repair.all_slots(tried % 2 == 1);
        }
        let found = (!fresh || self.begin(horizon, true)) && self.mend(rounds, horizon);
        if found {
            self.keep();
        }
        std::mem::swap(&mut self.attempts[which].repair, &mut self.repair);
        if found {
            self.attempts[which].horizon = usize::MAX;
        }
        found
    }

    /// The plan with the least sum of steps and penalties that is found at a few horizons.
    fn under_cuts(&mut self) {
        if let Some(hint) = self.hint {
            self.away_from_cuts(hint);
            return;
        }
        let longest = 4 * (self.lower + 2 * self.network.object_count() + 4);
        let mut least = u64::MAX;
        self.anew_under_cuts(self.lower, longest, &mut least);
    }

    /// Makes plans anew that avoid the cuts, from `shortest` steps on, as long as a longer one can cost less than
    /// `least`.
    fn anew_under_cuts(&mut self, shortest: usize, longest: usize, least: &mut u64) {
        let mut horizon = shortest;
        while horizon <= longest && (horizon as u64) < *least && !self.control.should_stop() {
            for shuffled in [false, true] {
                self.repair.all_slots(shuffled);
                if self.repair.begin(horizon, self.cuts, shuffled)
                    && self.mend(self.effort.first_rounds, horizon)
                {
                    self.repair.dodge(2 * self.effort.polish_rounds, self.control);
                    self.repair.polish(self.effort.polish_rounds, self.control);
                    self.keep_cheapest(least);
                }
            }
            horizon += 1 + (horizon - shortest) / 4;
        }
    }

    /// Changes the routes of a known plan, at its own and at a few longer horizons; where that leaves a plan that
    /// is dear, a few are made anew.
    fn away_from_cuts(&mut self, hint: &Solution) {
        let steps = hint.steps.len();
        let mut least = steps as u64 + self.cuts.penalty(&hint.start, &hint.steps);
        self.best = Some(hint.clone());
        self.repair.all_slots(true);
        let objects = self.network.object_count();
        let few = objects <= FEW_OBJECTS && objects * steps <= self.effort.most_stops;
        for horizon in [steps, steps + 1, steps + 2, steps + 4] {
            if !few && horizon > steps + 1 || least <= horizon as u64 || self.control.should_stop() {
                return;
            }
            self.repair.take_over(hint.routes(horizon), self.cuts);
            let rounds = self.affordable(2 * self.effort.polish_rounds, 3, horizon);
            self.repair.dodge(rounds, self.control);
            self.keep_cheapest(&mut least);
        }
        if least >= steps as u64 + DEAR && few {
            self.anew_under_cuts(steps, steps + LITTLE_LONGER, &mut least);
        }
    }

    fn keep_cheapest(&mut self, least: &mut u64) {
        let found = self.repair.solution();
        let cost = found.steps.len() as u64 + self.cuts.penalty(&found.start, &found.steps);
        if cost < *least {
            *least = cost;
            self.best = Some(found);
        }
    }
}

fn answer(best: Option<Solution>, lower_bound: usize, proof: Proof, cuts: &Cuts) -> Answer {
    let lower_bound = if cuts.is_empty() { lower_bound } else { 0 };
    let Some(solution) = best else {
        return Answer::Unknown { lower_bound };
    };
    let steps = solution.steps.len();
    let proved = cuts.is_empty() && steps == lower_bound;
    let certificate = Certificate {
        steps,
        lower_bound,
        optimum: proved.then_some(steps),
        proof: if proved { proof } else { Proof::None },
    };
    Answer::Solved(solution, certificate)
}
