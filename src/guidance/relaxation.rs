//! Lagrangian relaxation of the plan of a given length: proves that a horizon is too short.
//!
//! Give every cell (limited node or conflict set, step) a price `p >= 0`. If all objects fit into
//! the horizon, `sum_i (cost of the cheapest route of object i) <= sum_cells p * capacity`, whatever
//! the prices. Prices that break this prove that the horizon is too short; they exist exactly when
//! the linear relaxation of the time-expanded flow problem is infeasible. The search for them raises
//! the price of cells that the cheapest routes overfill and lowers that of the others
//! (subgradient steps, as queues in the method of Held and Karp 1971). All arithmetic is in
//! integers: a proof is exact.
//!
//! Slots that are neither an object's start nor its goal count as free rests for it, one or two for all
//! slots with the same neighbours: a further relaxation that keeps the routes' graphs small. The way to such
//! a rest and from there is that of any of them, so that nothing is asked for edges there.

use super::network::Network;
use crate::run::Control;

/// Price that one unit of surplus adds per round.
const STEP: i64 = 1;
/// Sum over the arms of the prices that the static game starts them with.
const ARM_PRICES: f64 = 40.0;

/// The prices at one horizon, kept between calls.
#[derive(Debug, Clone, Default)]
pub(super) struct Relaxation {
    horizon: usize,
    width: usize,
    /// Price of each cell, by step, then resource.
    price: Vec<i64>,
    /// How many routes draw on each cell, less its capacity.
    surplus: Vec<i64>,
    /// Resources that are fuller than their capacity at the start: not priced.
    overfull: Vec<bool>,
    /// Objects that answer alike: (object, how many).
    groups: Vec<(usize, i64)>,
    cost: Vec<i64>,
    parent: Vec<u16>,
    active: Vec<Vec<u16>>,
    /// Sum of the prices of what each node draws on, by step, then node.
    node_price: Vec<i64>,
    /// Where the last route ends.
    end: u16,
}

impl Relaxation {
    /// Starts at `horizon` with no prices.
    pub(super) fn begin(&mut self, network: &Network, start: &[u16], horizon: usize) {
        self.horizon = horizon;
        self.width = network.capacities.len();
        self.price.clear();
        self.price.resize(horizon * self.width, 0);
        let mut load = vec![0_u16; self.width];
        self.groups.clear();
        for (object, &node) in start.iter().enumerate() {
            for &resource in network.resources.get(node as usize) {
                load[resource as usize] += 1;
            }
            let kind = network.kind_of[object];
            let alike = |other: usize| start[other] == node && network.kind_of[other] == kind;
            match self.groups.iter_mut().find(|group| alike(group.0)) {
                Some(group) => group.1 += 1,
                None => self.groups.push((object, 1)),
            }
        }
        self.overfull =
            load.iter().zip(&network.capacities).map(|(load, capacity)| load > capacity).collect();
    }

    /// Goes on to the next longer horizon with the prices found so far, stretched in the middle.
    pub(super) fn lengthen(&mut self) {
        let middle = (self.horizon / 2).min(self.horizon.saturating_sub(1)) * self.width;
        let row: Vec<i64> =
            self.price.get(middle..middle + self.width).map(<[i64]>::to_vec).unwrap_or_default();
        self.price.splice(middle..middle, row);
        self.horizon += 1;
        self.price.resize(self.horizon * self.width, 0);
    }

    /// Sets the price of every arm to its weight in the static game while anything can be there.
    pub(super) fn price_arms(&mut self, network: &Network, weights: &[f64]) {
        for (nodes, &weight) in network.arms.iter().zip(weights) {
            let Some(&arm) = nodes.first() else { continue };
            for &resource in network.resources.get(arm as usize) {
                for step in 0..self.horizon {
                    self.price[step * self.width + resource as usize] = (weight * ARM_PRICES).round() as i64;
                }
            }
        }
    }

    /// What the prices found so far make of being at each node in each step of a plan of `horizon`
    /// steps, written to `out` by step, then node: stretched in the middle where it is longer.
    pub(super) fn node_prices(&self, network: &Network, horizon: usize, unit: u64, out: &mut Vec<u64>) {
        out.clear();
        if horizon < self.horizon || self.horizon == 0 {
            return;
        }
        let middle = self.horizon / 2;
        let surplus = horizon - self.horizon;
        for step in 0..horizon {
            let own = if step < middle { step } else { step.saturating_sub(surplus).max(middle) };
            let own = own.min(self.horizon - 1);
            let row = &self.price[own * self.width..(own + 1) * self.width];
            for node in 0..network.node_count() {
                let resources = network.resources.get(node).iter();
                let price: i64 = resources.map(|&resource| row[resource as usize]).sum();
                out.push(unit * price.max(0) as u64);
            }
        }
    }

    /// Up to `rounds` steps, or until `control` says stop; true once the horizon is proved too short.
    pub(super) fn refute(
        &mut self,
        network: &Network,
        start: &[u16],
        rounds: usize,
        control: &Control,
    ) -> bool {
        for round in 0..rounds {
            if round % 16 == 15 && control.should_stop() {
                return false;
            }
            self.surplus.clear();
            self.surplus.resize(self.horizon * self.width, 0);
            self.node_price.clear();
            for row in self.price.chunks_exact(self.width.max(1)) {
                for node in 0..network.node_count() {
                    let resources = network.resources.get(node).iter();
                    self.node_price.push(resources.map(|&resource| row[resource as usize]).sum());
                }
            }
            let mut total = 0;
            for group in 0..self.groups.len() {
                let (object, size) = self.groups[group];
                match self.cheapest(network, start[object], object) {
                    Some(cost) => total += cost * size,
                    None => return true,
                }
                self.draw(network, object, start[object], size);
            }
            let mut room = 0;
            for (cell, &price) in self.price.iter().enumerate() {
                if price > 0 {
                    room += price * i64::from(network.capacities[cell % self.width]);
                }
            }
            if total > room {
                return true;
            }
            for (cell, price) in self.price.iter_mut().enumerate() {
                let resource = cell % self.width;
                if !self.overfull[resource] {
                    let surplus = self.surplus[cell] - i64::from(network.capacities[resource]);
                    *price = (*price + surplus * STEP).max(0);
                }
            }
        }
        false
    }

    /// Enters the route found last, for `size` objects.
    fn draw(&mut self, network: &Network, object: usize, start: u16, size: i64) {
        let count = network.node_count();
        let stands_in = &network.kind(object).stands_in;
        let free = |node: u16| stands_in[node as usize] && node != start;
        let mut node = self.end;
        for step in (0..self.horizon).rev() {
            let before = self.parent[(step + 1) * count + node as usize];
            if !free(before) {
                for &resource in network.resources.get(before as usize) {
                    self.surplus[step * self.width + resource as usize] += size;
                }
            }
            if before != node && !free(node) {
                for &resource in network.resources.get(node as usize) {
                    self.surplus[step * self.width + resource as usize] += size;
                }
            }
            if before != node && !free(before) && !free(node) {
                for resource in network.crossing(network.kind_of[object], before as usize, node as usize) {
                    self.surplus[step * self.width + resource as usize] += size;
                }
            }
            node = before;
        }
    }

    /// Cost of the cheapest route of `object`; leaves it in `self.parent` and `self.active`.
    fn cheapest(&mut self, network: &Network, start: u16, object: usize) -> Option<i64> {
        let count = network.node_count();
        let horizon = self.horizon;
        let kind = network.kind(object);
        let graph = &kind.relaxed;
        if usize::from(kind.to_goal[start as usize]) > horizon {
            return None;
        }
        self.cost.clear();
        self.cost.resize((horizon + 1) * count, i64::MAX);
        self.parent.resize((horizon + 1) * count, 0);
        self.active.resize(horizon + 1, Vec::new());
        for layer in &mut self.active {
            layer.clear();
        }
        self.cost[start as usize] = 0;
        self.active[0].push(start);
        for step in 0..horizon {
            let (done, open) = self.active.split_at_mut(step + 1);
            let reached = &mut open[0];
            let remaining = (horizon - step - 1) as u16;
            let row = &self.node_price[step * count..(step + 1) * count];
            let prices = &self.price[step * self.width..(step + 1) * self.width];
            let free = |node: u16| kind.stands_in[node as usize] && node != start;
            let priced = |node: usize| -> i64 { if free(node as u16) { 0 } else { row[node] } };
            let (now, then) = self.cost.split_at_mut((step + 1) * count);
            let now = &now[step * count..];
            let parents = &mut self.parent[(step + 1) * count..(step + 2) * count];
            for &node in &done[step] {
                let base = now[node as usize] + priced(node as usize);
                let mut offer = |next: u16, cost: i64| {
                    let known = &mut then[next as usize];
                    if cost < *known {
                        if *known == i64::MAX {
                            reached.push(next);
                        }
                        *known = cost;
                        parents[next as usize] = node;
                    }
                };
                if kind.to_goal[node as usize] <= remaining {
                    offer(node, base);
                }
                let crosses = !free(node) && network.has_crossings(node as usize);
                for &next in graph.successors(node as usize) {
                    if kind.to_goal[next as usize] <= remaining {
                        let mut cost = base + priced(next as usize);
                        if crosses && !free(next) {
                            let drawn =
                                network.crossing(network.kind_of[object], node as usize, next as usize);
                            cost += drawn.map(|resource| prices[resource as usize]).sum::<i64>();
                        }
                        offer(next, cost);
                    }
                }
            }
        }
        let last = &self.cost[horizon * count..];
        let end = self.active[horizon].iter().min_by_key(|&&node| (last[node as usize], node)).copied()?;
        self.end = end;
        Some(last[end as usize])
    }
}
