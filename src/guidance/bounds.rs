//! Lower bounds on the steps of any plan: the longest shortest path, and the static load of the
//! arms.
//!
//! # Static load
//!
//! Carrying an object costs an arm two steps (one if it holds the object at the start or may keep
//! it in the end). With head times `h_a` (steps before anything can come to arm `a`) and tail
//! times `t_a` (steps that anything needs after it left), `h_a + load_a + t_a <= T` in any plan of
//! `T` steps. The least such `T` over all fractional choices of paths is the value of a zero-sum
//! game between arms and objects: for any weights `w_a >= 0` with sum 1,
//! `T >= sum_a w_a (h_a + t_a) + sum_i (least w-weighted load of a path of object i)`. The weights are
//! found by regret matching (RM+: Tammelin 2014) against best answers; every round gives a valid bound.

use super::network::{FAR, Network, distances};
use super::passage::passage;

/// Rounds of regret matching.
const ROUNDS: usize = 240;
/// After how many rounds the average of the weights is tried, too.
const AVERAGED: usize = 8;

/// Distances of the objects of a state, and what follows from them alone.
#[derive(Debug, Clone)]
pub(super) struct Reach {
    /// For every object, fewest edges from its place to each node.
    pub(super) from_start: Vec<Vec<u16>>,
    /// The longest of the objects' shortest paths to their goals, or the first object without one.
    pub(super) longest: Result<u16, usize>,
}

impl Reach {
    /// Distances from `start`.
    pub(super) fn new(network: &Network, start: &[u16]) -> Self {
        let mut from_start: Vec<Vec<u16>> = Vec::with_capacity(start.len());
        for (object, &node) in start.iter().enumerate() {
            let same = (0..object).find(|&other| {
                start[other] == node && network.kind(other).graph == network.kind(object).graph
            });
            let list = match same {
                Some(other) => from_start[other].clone(),
                None => distances(&[node], network.node_count(), |at| network.graph(object).successors(at)),
            };
            from_start.push(list);
        }
        let mut longest = Ok(0);
        for (object, &node) in start.iter().enumerate() {
            let distance = network.to_goal(object, node as usize);
            longest = match longest {
                Ok(_) if distance == FAR => Err(object),
                Ok(so_far) => Ok(distance.max(so_far)),
                fault => fault,
            };
        }
        Self { from_start, longest }
    }
}

/// The static load bound, and the weights of the arms that gave it; `at_least` is a bound that is
/// known already.
pub(super) fn static_load(
    network: &Network,
    start: &[u16],
    reach: &Reach,
    at_least: usize,
) -> (usize, Vec<f64>) {
    let arms = network.arms.len();
    let objects = network.object_count();
    if arms == 0 || objects == 0 {
        return (at_least, vec![0.0; arms]);
    }
    let offsets = head_and_tail(network, reach, at_least);
    let mut game = Game::new(network, start);
    let mut best = (at_least as f64, vec![1.0 / arms as f64; arms]);
    let mut loads = vec![0.0; arms];
    let try_out = |game: &mut Game, weights: &[f64], loads: &mut Vec<f64>, best: &mut (f64, Vec<f64>)| {
        loads.fill(0.0);
        let least = game.respond(weights, loads);
        let value = least + weights.iter().zip(&offsets).map(|(weight, offset)| weight * offset).sum::<f64>();
        if value > best.0 {
            *best = (value, weights.to_vec());
        }
    };
    let mut weights = best.1.clone();
    let mut regrets = vec![0.0; arms];
    let mut totals = vec![0.0; arms];
    let mut average = vec![0.0; arms];
    let mut rounds = 0.0;
    for round in 1..=ROUNDS {
        try_out(&mut game, &weights, &mut loads, &mut best);
        // Later rounds count more.
        let share = round as f64;
        rounds += share;
        let mut worst: f64 = 0.0;
        let mean: f64 = (0..arms).map(|arm| weights[arm] * (loads[arm] + offsets[arm])).sum();
        for arm in 0..arms {
            totals[arm] += share * loads[arm];
            average[arm] += share * weights[arm];
            worst = worst.max(totals[arm] / rounds + offsets[arm]);
            regrets[arm] = f64::max(0.0, regrets[arm] + loads[arm] + offsets[arm] - mean);
        }
        // The average of the answers is a fractional plan: no weights can prove more than that.
        if round_up(best.0) >= round_up(worst) {
            break;
        }
        if round % AVERAGED == 0 {
            let averaged: Vec<f64> = average.iter().map(|weight| weight / rounds).collect();
            try_out(&mut game, &averaged, &mut loads, &mut best);
        }
        let sum: f64 = regrets.iter().sum();
        if sum <= 0.0 {
            break;
        }
        for arm in 0..arms {
            weights[arm] = regrets[arm] / sum;
        }
    }
    let least = round_up(best.0);
    let sets = sets_of_arms(&offsets, &best.1);
    let carries = whole_carries(network, start, &mut game, &offsets, &sets, least);
    let through = sets.iter().map(|set| passage(network, start, reach, set, carries)).max();
    (carries.max(through.unwrap_or(0)), best.1)
}

/// Sets of arms that are weighed alike, or have equal heads and tails.
fn sets_of_arms(offsets: &[f64], weights: &[f64]) -> Vec<Vec<bool>> {
    let mut sets: Vec<Vec<bool>> = Vec::new();
    let heaviest = weights.iter().copied().fold(0.0, f64::max);
    for share in [0.1, 0.3, 0.6] {
        sets.push(weights.iter().map(|&weight| weight >= share * heaviest).collect());
    }
    for &offset in offsets {
        sets.push(offsets.iter().map(|&other| other == offset).collect());
    }
    sets.sort();
    sets.dedup();
    sets
}

/// A bound from carries being whole: an arm whose hand is empty at the start and in the end acts an
/// even number of times, in the steps that its head and tail leave it. Each of `sets` must together make
/// all the acts that any plan needs of it. Returns that or `at_least`.
fn whole_carries(
    network: &Network,
    start: &[u16],
    game: &mut Game,
    offsets: &[f64],
    sets: &[Vec<bool>],
    at_least: usize,
) -> usize {
    let arms = offsets.len();
    let holds = |arm: usize| network.arms[arm].iter().any(|node| start.contains(node));
    let keeps = |node: u16| network.kinds.iter().any(|kind| kind.is_goal[node as usize]);
    let may_keep = |arm: usize| network.arms[arm].iter().any(|&node| keeps(node));
    let mut loads = vec![0.0; arms];
    let mut bound = at_least;
    for set in sets {
        let counted: Vec<f64> = set.iter().map(|&inside| f64::from(u8::from(inside))).collect();
        let needed = round_up(game.respond(&counted, &mut loads));
        let room = |horizon: usize| -> usize {
            let of_arm = |arm: usize| {
                let acts = horizon.saturating_sub(offsets[arm] as usize);
                match (may_keep(arm), holds(arm)) {
                    (true, _) => acts,
                    (false, false) => acts - acts % 2,
                    (false, true) => acts.saturating_sub(1 - acts % 2),
                }
            };
            (0..arms).filter(|&arm| set[arm]).map(of_arm).sum()
        };
        if set.contains(&true) {
            while room(bound) < needed {
                bound += 1;
            }
        }
    }
    bound
}

/// The least whole number not under `value`, forgiving rounding errors on the safe side.
fn round_up(value: f64) -> usize {
    (value - 1e-6).ceil().max(0.0) as usize
}

/// For each arm, the steps at the beginning and at the end in which it cannot act, at most
/// `at_least` (beyond that the inequality would be wrong for an arm that is never used).
fn head_and_tail(network: &Network, reach: &Reach, at_least: usize) -> Vec<f64> {
    network
        .arms
        .iter()
        .map(|nodes| {
            let (mut head, mut tail) = (FAR, FAR);
            for (object, from_start) in reach.from_start.iter().enumerate() {
                for &node in nodes {
                    let (come, go) = (from_start[node as usize], network.to_goal(object, node as usize));
                    if come != FAR && go != FAR {
                        head = head.min(come.saturating_sub(1));
                        tail = tail.min(go.saturating_sub(1));
                    }
                }
            }
            if head == FAR { 0.0 } else { f64::from(head + tail).min(at_least as f64) }
        })
        .collect()
}

/// One class's arms: which arm can pass an object to which, directly or over a placement.
struct ArmGraph {
    passes: Vec<bool>,
    /// Least weighted load of a path between two arms, the first arm left out.
    cost: Vec<f64>,
    /// The first arm after the first on such a path.
    via: Vec<usize>,
}

/// One group of objects that answer alike: same kind, same start.
struct Group {
    size: f64,
    graph: usize,
    /// Arms that can have the object first, and the steps that this costs them.
    first: Vec<(usize, f64)>,
    /// Arms that can have it last, and the steps that this saves them.
    last: Vec<(usize, f64)>,
}

/// The game's answering side.
struct Game {
    arms: usize,
    graphs: Vec<ArmGraph>,
    groups: Vec<Group>,
}

impl Game {
    fn new(network: &Network, start: &[u16]) -> Self {
        let arms = network.arms.len();
        let number = &network.arm_number;
        let graphs = network
            .graphs
            .iter()
            .map(|graph| {
                let mut passes = vec![false; arms * arms];
                for (index, nodes) in network.arms.iter().enumerate() {
                    for &next in nodes.iter().flat_map(|&node| graph.successors(node as usize)) {
                        if network.is_arm[next as usize] {
                            passes[index * arms + number[next as usize]] = true;
                        } else {
                            for &other in graph.successors(next as usize) {
                                if number[other as usize] != usize::MAX {
                                    passes[index * arms + number[other as usize]] = true;
                                }
                            }
                        }
                    }
                }
                ArmGraph { passes, cost: vec![0.0; arms * arms], via: vec![0; arms * arms] }
            })
            .collect();
        let mut groups: Vec<Group> = Vec::new();
        let mut known: Vec<(usize, u16, usize)> = Vec::new();
        for (object, &node) in start.iter().enumerate() {
            let kind = network.kind(object);
            if kind.is_goal[node as usize] {
                continue;
            }
            let key = (network.kind_of[object], node);
            if let Some(&(.., group)) = known.iter().find(|&&(kind, at, _)| (kind, at) == key) {
                groups[group].size += 1.0;
                continue;
            }
            let graph = &network.graphs[kind.graph];
            let first = if network.is_arm[node as usize] {
                vec![(number[node as usize], 1.0)]
            } else {
                graph.successors(node as usize).iter().map(|&arm| (number[arm as usize], 2.0)).collect()
            };
            let mut last = Vec::new();
            for (index, nodes) in network.arms.iter().enumerate() {
                let mut next = nodes.iter().flat_map(|&node| graph.successors(node as usize));
                if nodes.iter().any(|&node| kind.is_goal[node as usize]) {
                    last.push((index, 1.0));
                } else if next.any(|&next| kind.is_goal[next as usize]) {
                    last.push((index, 0.0));
                }
            }
            known.push((key.0, key.1, groups.len()));
            groups.push(Group { size: 1.0, graph: kind.graph, first, last });
        }
        Self { arms, graphs, groups }
    }

    /// The least total load weighted by `weights`, and in `loads` the load of each arm under it.
    fn respond(&mut self, weights: &[f64], loads: &mut [f64]) -> f64 {
        let arms = self.arms;
        for graph in &mut self.graphs {
            for from in 0..arms {
                for (to, weight) in weights.iter().enumerate() {
                    let cell = from * arms + to;
                    graph.via[cell] = to;
                    graph.cost[cell] = if from == to {
                        0.0
                    } else if graph.passes[cell] {
                        2.0 * weight
                    } else {
                        f64::INFINITY
                    };
                }
            }
            for middle in 0..arms {
                for from in 0..arms {
                    let half = graph.cost[from * arms + middle];
                    if half == f64::INFINITY || from == middle {
                        continue;
                    }
                    for to in 0..arms {
                        let cost = half + graph.cost[middle * arms + to];
                        if cost < graph.cost[from * arms + to] {
                            graph.cost[from * arms + to] = cost;
                            graph.via[from * arms + to] = graph.via[from * arms + middle];
                        }
                    }
                }
            }
        }
        let mut total = 0.0;
        for group in &self.groups {
            let graph = &self.graphs[group.graph];
            let mut best = (f64::INFINITY, 0, 0, 0.0, 0.0);
            for &(first, steps) in &group.first {
                for &(last, saved) in &group.last {
                    let cost =
                        steps * weights[first] + graph.cost[first * arms + last] - saved * weights[last];
                    if cost < best.0 {
                        best = (cost, first, last, steps, saved);
                    }
                }
            }
            let (cost, first, last, steps, saved) = best;
            if cost == f64::INFINITY {
                continue;
            }
            total += group.size * cost;
            loads[first] += group.size * steps;
            loads[last] -= group.size * saved;
            let mut at = first;
            while at != last {
                at = graph.via[at * arms + last];
                loads[at] += group.size * 2.0;
            }
        }
        total
    }
}
