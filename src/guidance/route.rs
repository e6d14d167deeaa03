//! The cheapest route of one object through space and time among the routes of the others: dynamic
//! programming over the layers of a fixed horizon.

use super::cuts::Tolls;
use super::network::{FAR, Network};
use super::timetable::{Route, Timetable};

/// Cost of one unit of conflict price; weights of whole routes stay below it.
const CONFLICT: u64 = 1 << 32;
/// Cost of one unit of toll.
const TOLL: u64 = 1 << 26;
/// Cost of not being at the goal for one step: breaks ties between routes of equal weight.
const LATE: u64 = 1;
/// Cost of one unit of bias: more than any weight.
pub(super) const BIAS: u64 = 1 << 16;
/// Cost of being taken by an arm off its beat: more than all bias of a route, less than a conflict.
const OFF_BEAT: u64 = 1 << 28;
/// Cost of waiting in a hand for one step: elsewhere it keeps nobody from working.
const HOLD: u64 = 1 << 18;
/// Weights are shifted up by this, to leave room for ties.
const WEIGHT_SHIFT: u32 = 6;

/// Buffers of the route search, kept between calls.
#[derive(Debug, Clone, Default)]
pub(super) struct RouteSearch {
    cost: [Vec<u64>; 2],
    active: [Vec<u16>; 2],
    parent: Vec<u16>,
    /// Whether routes without conflicts are looked for first: worth while where there are many objects.
    free_first: bool,
    /// Whether routes may rest on any slot, or only on one of each neighbourhood.
    pub(super) all_slots: bool,
    /// What being at a node before a step, or entering it in the step, costs beyond conflicts, by
    /// step, then node; empty for nothing.
    pub(super) bias: Vec<u64>,
    /// By node, whether it is an arm that should take in odd steps, or one that should in even ones;
    /// empty for no beat.
    pub(super) beat: Vec<Option<bool>>,
    /// What entering each node costs in the step that is looked at, where that is known yet; else
    /// `u64::MAX`.
    entry: Vec<u64>,
    entered: Vec<u16>,
}

impl RouteSearch {
    /// Empty buffers; `free_first` whether routes without conflicts are looked for first.
    pub(super) fn new(free_first: bool) -> Self {
        Self { free_first, ..Self::default() }
    }

    /// Finds the cheapest route of `object` from `start` to its goal within the horizon of
    /// `timetable`, in which its own old route `old` is not entered. Conflicts with other routes cost
    /// most, then tolls, then weight. Ties are broken by `noise`. `None` if the horizon is too
    /// short even for an object that is alone. An old route of the same length makes the search quicker:
    /// nothing dearer is looked at.
    #[allow(clippy::too_many_arguments)]
    pub(super) fn cheapest(
        &mut self,
        network: &Network,
        timetable: &Timetable,
        tolls: &Tolls,
        object: usize,
        start: usize,
        old: &[u16],
        noise: u64,
    ) -> Option<Route> {
        let horizon = timetable.horizon;
        let most = match old.len() == horizon + 1 {
            true => self.cost_of(network, timetable, tolls, object, old) + JITTER * horizon as u64,
            false => u64::MAX - 1,
        };
        // Few ways have no conflict, and the cheapest of these is the cheapest of all.
        let free = CONFLICT - 1;
        let freely = if self.free_first && most > free {
            self.within(network, timetable, tolls, object, start, free, noise)
        } else {
            None
        };
        freely.or_else(|| self.within(network, timetable, tolls, object, start, most, noise))
    }

    /// [`Self::cheapest`] among the routes that cost `most` at most.
    #[allow(clippy::too_many_arguments)]
    fn within(
        &mut self,
        network: &Network,
        timetable: &Timetable,
        tolls: &Tolls,
        object: usize,
        start: usize,
        most: u64,
        noise: u64,
    ) -> Option<Route> {
        let horizon = timetable.horizon;
        let count = network.node_count();
        let kind = network.kind(object);
        let graph = if self.all_slots { network.graph(object) } else { &kind.lean };
        for layer in 0..2 {
            self.cost[layer].clear();
            self.cost[layer].resize(count, u64::MAX);
            self.active[layer].clear();
        }
        if self.parent.len() < (horizon + 1) * count {
            self.parent.resize((horizon + 1) * count, 0);
        }
        let left = |step: usize| (horizon - step) as u16;
        if kind.to_goal[start] == FAR || kind.to_goal[start] > left(0) {
            return None;
        }
        let tolled = !tolls.is_empty();
        self.entry.clear();
        self.entry.resize(count, u64::MAX);
        self.entered.clear();
        self.cost[0][start] = 0;
        self.active[0].push(start as u16);
        for step in 0..horizon {
            let (now, then) = (step % 2, (step + 1) % 2);
            let active = std::mem::take(&mut self.active[now]);
            let mut reached = std::mem::take(&mut self.active[then]);
            let remaining = left(step + 1);
            let parents = (step + 1) * count;
            for node in self.entered.drain(..) {
                self.entry[node as usize] = u64::MAX;
            }
            for &node in &active {
                let node = node as usize;
                let so_far = self.cost[now][node];
                self.cost[now][node] = u64::MAX;
                let mut base = so_far
                    + CONFLICT * timetable.presence(node, step)
                    + self.bias.get(step * count + node).copied().unwrap_or(0)
                    + if kind.is_goal[node] { 0 } else { LATE };
                if tolled {
                    base += TOLL * tolls.of_presence(object, node, step);
                }
                if kind.to_goal[node] <= remaining {
                    let wait = if network.is_arm[node] { HOLD } else { 0 };
                    let cost = base + wait + jitter(noise, node, node, step);
                    let known = &mut self.cost[then][node];
                    if cost < *known && cost <= most {
                        if *known == u64::MAX {
                            reached.push(node as u16);
                        }
                        *known = cost;
                        self.parent[parents + node] = node as u16;
                    }
                }
                let successors = graph.successors(node);
                for (&next, &weight) in successors.iter().zip(graph.weights(node)) {
                    let next = next as usize;
                    if kind.to_goal[next] > remaining {
                        continue;
                    }
                    let mut cost = base + (u64::from(weight) << WEIGHT_SHIFT);
                    if cost >= self.cost[then][next] || cost > most {
                        continue;
                    }
                    if self.entry[next] == u64::MAX {
                        self.entry[next] = self.entering(timetable, count, next, step);
                        self.entered.push(next as u16);
                    }
                    cost += self.entry[next] + jitter(noise, node, next, step);
                    if network.has_crossings(node) {
                        cost += CONFLICT
                            * timetable.crossing(network, network.kind_of[object], (node, next), step);
                    }
                    if tolled {
                        cost += TOLL * tolls.of_move(object, node, next, step);
                    }
                    let known = &mut self.cost[then][next];
                    if cost < *known && cost <= most {
                        if *known == u64::MAX {
                            reached.push(next as u16);
                        }
                        *known = cost;
                        self.parent[parents + next] = node as u16;
                    }
                }
            }
            let mut spent = active;
            spent.clear();
            self.active[now] = spent;
            self.active[then] = reached;
        }
        let last = horizon % 2;
        let end = self.active[last]
            .iter()
            .filter(|&&node| kind.is_goal[node as usize])
            .min_by_key(|&&node| (self.cost[last][node as usize], node))?;
        let mut route = vec![0; horizon + 1];
        route[horizon] = *end;
        for step in (0..horizon).rev() {
            route[step] = self.parent[(step + 1) * count + route[step + 1] as usize];
        }
        Some(route)
    }

    /// What entering `node` in `step` costs beyond weight and tolls.
    fn entering(&self, timetable: &Timetable, count: usize, node: usize, step: usize) -> u64 {
        let biased = self.bias.get(step * count + node).copied().unwrap_or(0);
        let on_beat = match self.beat.get(node) {
            Some(&Some(odd)) => odd == (step % 2 == 1),
            _ => true,
        };
        biased + if on_beat { 0 } else { OFF_BEAT } + CONFLICT * timetable.entry(node, step)
    }

    /// What a route costs, ties aside.
    fn cost_of(
        &self,
        network: &Network,
        timetable: &Timetable,
        tolls: &Tolls,
        object: usize,
        route: &[u16],
    ) -> u64 {
        let count = network.node_count();
        let kind = network.kind(object);
        let graph = network.graph(object);
        let mut sum = 0;
        for (step, ends) in route.windows(2).enumerate() {
            let (node, next) = (ends[0] as usize, ends[1] as usize);
            sum += CONFLICT * timetable.presence(node, step)
                + self.bias.get(step * count + node).copied().unwrap_or(0)
                + if kind.is_goal[node] { 0 } else { LATE };
            if !tolls.is_empty() {
                sum += TOLL * tolls.of_presence(object, node, step);
            }
            if node == next {
                sum += if network.is_arm[node] { HOLD } else { 0 };
                continue;
            }
            sum += u64::from(graph.weight_to(node, next)) << WEIGHT_SHIFT;
            sum += self.entering(timetable, count, next, step);
            sum += CONFLICT * timetable.crossing(network, network.kind_of[object], (node, next), step);
            if !tolls.is_empty() {
                sum += TOLL * tolls.of_move(object, node, next, step);
            }
        }
        sum
    }
}

/// Most that ties add to the cost of a step.
const JITTER: u64 = 0x1f;

/// A few pseudo-random low bits for each (move, step), none for `noise` 0.
fn jitter(noise: u64, from: usize, to: usize, step: usize) -> u64 {
    if noise == 0 {
        return 0;
    }
    let key = (from as u64) | ((to as u64) << 16) | ((step as u64) << 32);
    ((key ^ noise).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 58) & JITTER
}
