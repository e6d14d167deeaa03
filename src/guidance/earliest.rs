//! The same actions in fewer steps: each as early as those before it allow.

use super::network::Network;
use super::solution::Move;
use std::collections::BTreeMap;

/// When a resource was drawn on last.
#[derive(Clone, Copy)]
struct Drawn {
    /// In which of the steps given.
    number: usize,
    /// How many of the new steps are over when all that drew on it so far is done.
    until: usize,
    /// The same of what drew on it in earlier steps than `number`.
    before: usize,
}

/// The actions of `steps`, each in the first step that comes after all actions of earlier steps that move the
/// same object, or draw on the same arm, place, conflict set, block or clash. What was allowed stays allowed,
/// and the steps become no more.
pub fn earliest(network: &Network, steps: &[Vec<Move>]) -> Vec<Vec<Move>> {
    let mut early: Vec<Vec<Move>> = Vec::new();
    let mut objects: BTreeMap<usize, usize> = BTreeMap::new();
    let mut resources: BTreeMap<u16, Drawn> = BTreeMap::new();
    for (number, moves) in steps.iter().enumerate() {
        for action in moves {
            let (from, to) = (action.from.0, action.to.0);
            let ends = [from, to].into_iter().flat_map(|node| network.resources.get(node)).copied();
            let drawn: Vec<u16> =
                ends.chain(network.crossing(network.kind_of[action.object], from, to)).collect();
            let free = |resource| match resources.get(resource) {
                Some(last) if last.number == number => last.before,
                Some(last) => last.until,
                None => 0,
            };
            let moved = objects.get(&action.object).copied().unwrap_or(0);
            let first = drawn.iter().map(free).fold(moved, usize::max);
            objects.insert(action.object, first + 1);
            for resource in drawn {
                let last = resources.entry(resource).or_insert(Drawn { number, until: 0, before: 0 });
                if last.number != number {
                    *last = Drawn { number, before: last.until, ..*last };
                }
                last.until = last.until.max(first + 1);
            }
            if early.len() <= first {
                early.resize(first + 1, Vec::new());
            }
            early[first].push(*action);
        }
    }
    early.iter_mut().for_each(|moves| moves.sort_unstable());
    early
}

#[cfg(test)]
mod tests {
    use super::super::oracle::random_instance;
    use super::super::{Cuts, Effort, check, solve};
    use super::*;
    use crate::run::{Control, Seed};
    use rand::Rng as _;

    #[test]
    fn what_was_allowed_stays_allowed_in_no_more_steps() {
        let mut rng = Seed(31).stream("guidance/earliest");
        let (mut compared, mut shorter) = (0, 0);
        for case in 0..1500 {
            let network = Network::new(random_instance(&mut rng)).unwrap();
            let start = network.instance().start();
            let answer =
                solve(&network, &start, &Cuts::none(), &Effort::quick(), Seed(case), &Control::unbounded());
            let answer = answer.unwrap();
            let Some(plan) = answer.solution() else { continue };
            // Each step in two, where that is allowed: then there is something to gain.
            let mut stretched = plan.steps.clone();
            for number in (0..plan.steps.len()).rev() {
                let (late, on_time): (Vec<Move>, Vec<Move>) =
                    stretched[number].iter().partition(|_| rng.random_bool(0.5));
                if late.is_empty() || on_time.is_empty() {
                    continue;
                }
                let mut apart = stretched.clone();
                apart.splice(number..=number, [on_time, late]);
                if check(network.instance(), &network.solution(start.clone(), apart.clone())).is_ok() {
                    stretched = apart;
                }
            }
            for steps in [&plan.steps, &stretched] {
                let early = earliest(&network, steps);
                let found = network.solution(start.clone(), early.clone());
                check(network.instance(), &found)
                    .unwrap_or_else(|fault| panic!("{fault}: {:?} {steps:?} {early:?}", network.instance()));
                assert!(early.len() <= steps.len(), "{steps:?} {early:?}");
                assert_eq!(
                    early.iter().map(Vec::len).sum::<usize>(),
                    steps.iter().map(Vec::len).sum::<usize>()
                );
                shorter += usize::from(early.len() < steps.len());
                compared += 1;
            }
        }
        assert!(compared > 1000 && shorter > 60, "{compared} {shorter}");
    }
}
