//! The paper's two baselines: one object after another, and every object for itself.

use super::cuts::Cuts;
use super::guide::{Advice, Guidance, Guide, first_actions};
use super::instance::{InstanceError, ModeState, NodeId};
use super::memo::Memo;
use super::network::{FAR, Network};
use super::solution::{Answer, Certificate, Infeasible, Move, Proof, Solution};
use crate::run::Control;
use std::collections::BTreeSet;

/// Moves one object at a time, in the order of the objects: the next unfinished one goes all the
/// way to its goal while the others rest. One in hand goes first. An object that is blocked waits for
/// the next one that is not; when all are blocked, one that blocks is put aside.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sequential;

/// Every object takes the next edge of its own shortest path, whatever the others need; where two
/// want the same arm or place, the one listed first gets it. Knows no cuts and no way out.
#[derive(Debug, Clone, Copy, Default)]
pub struct Greedy;

impl Guidance for Sequential {
    fn name(&self) -> &'static str {
        "sequential"
    }

    fn guide(
        &self,
        network: &Network,
        state: &[NodeId],
        cuts: &Cuts,
        memo: &mut Memo,
        control: &Control,
    ) -> Result<Advice, InstanceError> {
        network.instance().validate_state(state)?;
        let answer = match memo.find(network, state, cuts) {
            Some(answer) => answer,
            None => {
                let answer = one_by_one(network, state, cuts, control);
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

/// The whole plan that moves one object at a time.
pub(super) fn one_by_one(network: &Network, start: &[NodeId], cuts: &Cuts, control: &Control) -> Answer {
    let mut state: Vec<u16> = start.iter().map(|node| node.0 as u16).collect();
    let mut solution = Solution { start: start.to_vec(), ..Solution::default() };
    let mut seen: BTreeSet<Vec<u16>> = BTreeSet::new();
    let mut unfinished: Vec<usize> = Vec::new();
    loop {
        unfinished.clear();
        unfinished.extend((0..state.len()).filter(|&o| !network.kind(o).is_goal[state[o] as usize]));
        if unfinished.is_empty() {
            break;
        }
        if let Some(&object) = unfinished.iter().find(|&&o| network.to_goal(o, state[o] as usize) == FAR) {
            // Only at the start is this a proof: later, something was put aside where it is stuck.
            return match cuts.is_empty() && solution.steps.is_empty() {
                true => Answer::Infeasible(Infeasible::NoPath(object)),
                false => Answer::Unknown { lower_bound: 0 },
            };
        }
        if !seen.insert(state.clone()) || control.should_stop() {
            return Answer::Unknown { lower_bound: 0 };
        }
        unfinished.sort_by_key(|&object| (!network.is_arm[state[object] as usize], object));
        let walk = unfinished
            .iter()
            .find_map(|&object| {
                let goal = |node: usize| network.kind(object).is_goal[node];
                Some((object, walk(network, &state, object, cuts, &goal)?))
            })
            .or_else(|| put_aside(network, &state, &unfinished, cuts));
        let Some((object, path)) = walk else {
            return Answer::Unknown { lower_bound: 0 };
        };
        for ends in path.windows(2) {
            let (from, to) = (NodeId(ends[0] as usize), NodeId(ends[1] as usize));
            solution.steps.push(vec![Move { object, from, to }]);
        }
        if let Some(&end) = path.last() {
            state[object] = end;
        }
    }
    solution.weight = network.weight_of_steps(&solution.steps);
    let steps = solution.steps.len();
    Answer::Solved(solution, Certificate { steps, lower_bound: 0, optimum: None, proof: Proof::None })
}

/// Moves something out of the way of the first unfinished object that this helps.
fn put_aside(
    network: &Network,
    state: &[u16],
    unfinished: &[usize],
    cuts: &Cuts,
) -> Option<(usize, Vec<u16>)> {
    let wanted: BTreeSet<u16> =
        unfinished.iter().flat_map(|&object| network.kind(object).goals.iter().copied()).collect();
    // First places that nobody waits for, then any; in the last resort a hand.
    for patience in 0..3 {
        for &object in unfinished {
            for blocker in blockers(network, state, object) {
                let aside = |node: usize| {
                    node != state[blocker] as usize
                        && network.to_goal(blocker, node) != FAR
                        && match patience {
                            0 => !network.is_arm[node] && !wanted.iter().any(|&w| shares(network, node, w)),
                            1 => !network.is_arm[node],
                            _ => true,
                        }
                };
                if let Some(path) = walk(network, state, blocker, cuts, &aside) {
                    return Some((blocker, path));
                }
            }
        }
    }
    None
}

/// Whether two nodes draw on a common limited resource.
fn shares(network: &Network, one: usize, other: u16) -> bool {
    let theirs = network.resources.get(other as usize);
    one == other as usize || network.resources.get(one).iter().any(|resource| theirs.contains(resource))
}

/// The objects that stand on nodes or in conflict sets along a shortest path of `object` that ignores
/// all others.
fn blockers(network: &Network, state: &[u16], object: usize) -> Vec<usize> {
    let mut found = Vec::new();
    let mut at = state[object] as usize;
    while let Some(next) = next_on_shortest(network, object, at) {
        for (other, &place) in state.iter().enumerate() {
            let blocks = || {
                let theirs = network.resources.get(place as usize);
                network.crossing(network.kind_of[object], at, next).any(|resource| theirs.contains(&resource))
            };
            if other != object && (shares(network, next, place) || blocks()) && !found.contains(&other) {
                found.push(other);
            }
        }
        at = next;
    }
    found
}

/// The next node of the lightest of the shortest paths to the goal.
pub(super) fn next_on_shortest(network: &Network, object: usize, at: usize) -> Option<usize> {
    let left = network.to_goal(object, at);
    if left == 0 || left == FAR {
        return None;
    }
    let graph = network.graph(object);
    graph
        .successors(at)
        .iter()
        .zip(graph.weights(at))
        .filter(|&(&next, _)| network.to_goal(object, next as usize) == left - 1)
        .min_by_key(|&(&next, &weight)| (weight, next))
        .map(|(&next, _)| next as usize)
}

/// The shortest walk of `object` to a node that `is_goal`, while all others rest: fewest steps and
/// penalties first, then least weight (Dijkstra 1959).
fn walk(
    network: &Network,
    state: &[u16],
    object: usize,
    cuts: &Cuts,
    is_goal: &dyn Fn(usize) -> bool,
) -> Option<Vec<u16>> {
    let mut load = vec![0_u16; network.capacities.len()];
    for (other, &node) in state.iter().enumerate() {
        if other != object {
            for &resource in network.resources.get(node as usize) {
                load[resource as usize] += 1;
            }
        }
    }
    let free = |from: usize, to: usize| {
        let entered = network.resources.get(to).iter().copied();
        let mut drawn = entered.chain(network.crossing(network.kind_of[object], from, to));
        drawn.all(|resource| load[resource as usize] < network.capacities[resource as usize])
    };
    let graph = network.graph(object);
    let start = state[object];
    let mut best = vec![(u64::MAX, u64::MAX); network.node_count()];
    let mut parent = vec![start; network.node_count()];
    let mut open = BTreeSet::new();
    best[start as usize] = (0, 0);
    open.insert(((0, 0), start));
    while let Some((cost, node)) = open.pop_first() {
        if is_goal(node as usize) {
            let mut path = vec![node];
            while let Some(&last) = path.last().filter(|&&last| last != start) {
                path.push(parent[last as usize]);
            }
            path.reverse();
            return Some(path);
        }
        let at = node as usize;
        for (&next, &weight) in graph.successors(at).iter().zip(graph.weights(at)) {
            if !free(at, next as usize) {
                continue;
            }
            let toll = if cuts.is_empty() {
                0
            } else {
                let action = Move { object, from: NodeId(at), to: NodeId(next as usize) };
                let here: Vec<NodeId> = state.iter().map(|&node| NodeId(usize::from(node))).collect();
                cuts.penalty(&here, &[vec![action]])
            };
            let new = (cost.0 + 1 + toll, cost.1 + u64::from(weight));
            if new < best[next as usize] {
                open.remove(&(best[next as usize], next));
                best[next as usize] = new;
                parent[next as usize] = node;
                open.insert((new, next));
            }
        }
    }
    None
}

impl Guidance for Greedy {
    fn name(&self) -> &'static str {
        "greedy"
    }

    fn guide(
        &self,
        network: &Network,
        state: &[NodeId],
        _cuts: &Cuts,
        _memo: &mut Memo,
        _control: &Control,
    ) -> Result<Advice, InstanceError> {
        network.instance().validate_state(state)?;
        let places: Vec<u16> = state.iter().map(|node| node.0 as u16).collect();
        let mut load = vec![0_u16; network.capacities.len()];
        for &node in &places {
            for &resource in network.resources.get(node as usize) {
                load[resource as usize] += 1;
            }
        }
        let mut immediate = Vec::new();
        let mut wishes: Vec<Vec<Move>> = Vec::new();
        for (object, &node) in places.iter().enumerate() {
            let mut at = node as usize;
            if network.to_goal(object, at) == FAR {
                return Ok(Advice::Infeasible(Infeasible::NoPath(object)));
            }
            let mut step = 0;
            while let Some(next) = next_on_shortest(network, object, at) {
                let action = Move { object, from: NodeId(at), to: NodeId(next) };
                if wishes.len() == step {
                    wishes.push(Vec::new());
                }
                wishes[step].push(action);
                let entered = network.resources.get(next).iter().copied();
                let drawn = entered.chain(network.crossing(network.kind_of[object], at, next));
                let free = drawn.clone().all(|r| load[r as usize] < network.capacities[r as usize]);
                if step == 0 && free && !takes_part(network, &immediate, action) {
                    for resource in drawn {
                        load[resource as usize] += 1;
                    }
                    immediate.push(action);
                }
                at = next;
                step += 1;
            }
        }
        let solved = network.instance().is_solved(state);
        if immediate.is_empty() && !solved {
            return Ok(Advice::Unknown { lower_bound: 0 });
        }
        let steps: ModeSteps = if immediate.is_empty() { Vec::new() } else { vec![immediate.clone()] };
        let weight = network.weight_of_steps(&steps);
        Ok(Advice::Go(Guide {
            immediate,
            heuristic: first_actions(network, &wishes),
            remaining_steps: solved.then_some(0),
            certificate: None,
            solution: Solution { start: ModeState::from(state), steps, weight },
        }))
    }
}

type ModeSteps = Vec<Vec<Move>>;

/// Whether an arm of `action` already takes part in one of `moves`.
fn takes_part(network: &Network, moves: &[Move], action: Move) -> bool {
    [action.from, action.to]
        .into_iter()
        .filter(|node| network.is_arm[node.0])
        .any(|arm| moves.iter().any(|other| other.from == arm || other.to == arm))
}
