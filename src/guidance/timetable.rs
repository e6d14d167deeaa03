//! Who is where when, at a fixed horizon: one route per object, and the load that the routes put
//! on every limited node and conflict set in every step.
//!
//! In a step an object draws once on what it is at before the step, and once on what it enters.
//! A load over the capacity is a conflict if anything enters in that step. For arms, whose
//! capacity is 1, this alone gives "one action per arm and step".

use super::network::Network;

/// Where one object is before each step and after the last: `horizon + 1` nodes.
pub(super) type Route = Vec<u16>;

/// Loads of routes at a fixed horizon.
#[derive(Debug, Clone, Default)]
pub(super) struct Timetable {
    /// Number of steps.
    pub(super) horizon: usize,
    /// Number of limited resources.
    width: usize,
    /// Number of nodes.
    nodes: usize,
    load: Vec<u16>,
    enters: Vec<u16>,
    /// Extra price of an overfilled cell, grown by cells that stay overfilled.
    price: Vec<u32>,
    /// Sum over all cells of what they hold too much, each weighed with its price.
    conflicts: u64,
    /// What being at a node before a step costs, and entering it, on top of the routes entered; by step,
    /// then node.
    presence: Vec<u64>,
    entry: Vec<u64>,
    /// The overfilled cells, and by cell its place among them.
    over: Vec<u32>,
    place: Vec<u32>,
}

impl Timetable {
    /// Empties the table for `horizon` steps and forgets all prices.
    pub(super) fn reset(&mut self, network: &Network, horizon: usize) {
        self.horizon = horizon;
        self.width = network.capacities.len();
        let cells = horizon * self.width;
        self.load.clear();
        self.load.resize(cells, 0);
        self.enters.clear();
        self.enters.resize(cells, 0);
        self.price.clear();
        self.price.resize(cells, 0);
        self.nodes = network.node_count();
        for toll in [&mut self.presence, &mut self.entry] {
            toll.clear();
            toll.resize(horizon * self.nodes, 0);
        }
        for (resource, _) in network.capacities.iter().enumerate().filter(|&(_, &capacity)| capacity == 0) {
            for &node in network.users.get(resource) {
                (0..horizon)
                    .for_each(|step| self.entry[step * self.nodes + node as usize] += u64::from(PRICE));
            }
        }
        self.conflicts = 0;
        self.over.clear();
        self.place.clear();
        self.place.resize(cells, NOWHERE);
    }

    fn visit(&mut self, network: &Network, kind: usize, route: &[u16], sign: u16) {
        for (step, pair) in route.windows(2).enumerate() {
            for &resource in network.resources.get(pair[0] as usize) {
                self.change(network, step, resource, sign, 0);
            }
            if pair[0] != pair[1] {
                let entered = network.resources.get(pair[1] as usize).iter().copied();
                for resource in entered.chain(network.crossing(kind, pair[0] as usize, pair[1] as usize)) {
                    self.change(network, step, resource, sign, sign);
                }
            }
        }
    }

    fn change(&mut self, network: &Network, step: usize, resource: u16, load: u16, enters: u16) {
        let cell = step * self.width + resource as usize;
        let capacity = network.capacities[resource as usize];
        let (before, tolls) = (self.excess(capacity, cell), self.tolls(capacity, cell));
        self.load[cell] = self.load[cell].wrapping_add(load);
        self.enters[cell] = self.enters[cell].wrapping_add(enters);
        let after = self.excess(capacity, cell);
        self.retoll(network, step, resource, tolls);
        if before == after {
            return;
        }
        let unit = u64::from(PRICE + self.price[cell]);
        self.conflicts = self.conflicts - u64::from(before) * unit + u64::from(after) * unit;
        if before == 0 {
            self.place[cell] = self.over.len() as u32;
            self.over.push(cell as u32);
        } else if after == 0 {
            let place = std::mem::replace(&mut self.place[cell], NOWHERE) as usize;
            self.over.swap_remove(place);
            if let Some(&moved) = self.over.get(place) {
                self.place[moved as usize] = place as u32;
            }
        }
    }

    /// What drawing on a cell costs by being there, and by entering.
    fn tolls(&self, capacity: u16, cell: usize) -> (u64, u64) {
        let (load, enters) = (self.load[cell], self.enters[cell]);
        if load < capacity {
            return (0, 0);
        }
        let unit = u64::from(PRICE + self.price[cell]);
        if enters > 0 {
            (unit, unit)
        } else {
            // Where nothing entered so far, an entry makes all the excess count.
            (0, u64::from(load - capacity + 1) * unit)
        }
    }

    /// Tells the nodes that draw on a cell of its tolls, which were `before`.
    fn retoll(&mut self, network: &Network, step: usize, resource: u16, before: (u64, u64)) {
        let cell = step * self.width + resource as usize;
        let after = self.tolls(network.capacities[resource as usize], cell);
        if before == after {
            return;
        }
        for &node in network.users.get(resource as usize) {
            let place = step * self.nodes + node as usize;
            self.presence[place] = self.presence[place] - before.0 + after.0;
            self.entry[place] = self.entry[place] - before.1 + after.1;
        }
    }

    /// Enters a route of an object of `kind`.
    pub(super) fn add(&mut self, network: &Network, kind: usize, route: &[u16]) {
        self.visit(network, kind, route, 1);
    }

    /// Takes out a route that was entered.
    pub(super) fn remove(&mut self, network: &Network, kind: usize, route: &[u16]) {
        self.visit(network, kind, route, u16::MAX);
    }

    fn excess(&self, capacity: u16, cell: usize) -> u16 {
        if self.enters[cell] == 0 { 0 } else { self.load[cell].saturating_sub(capacity) }
    }

    /// Sum over all cells of what they hold too much, each weighed with its price.
    pub(super) fn priced_conflicts(&self) -> u64 {
        self.conflicts
    }

    /// How many cells are overfilled.
    pub(super) fn overfilled(&self) -> usize {
        self.over.len()
    }

    /// The overfilled cell of number `index`, as (step, resource).
    pub(super) fn overfilled_cell(&self, index: usize) -> (usize, usize) {
        let cell = self.over[index] as usize;
        (cell / self.width, cell % self.width)
    }

    /// Raises the price of a cell.
    pub(super) fn raise(&mut self, network: &Network, step: usize, resource: usize, by: u32) {
        let cell = step * self.width + resource;
        let raised = self.price[cell].saturating_add(by).min(1 << 20);
        let by = raised - self.price[cell];
        let tolls = self.tolls(network.capacities[resource], cell);
        self.price[cell] = raised;
        self.retoll(network, step, resource as u16, tolls);
        let excess = self.excess(network.capacities[resource], cell);
        self.conflicts += u64::from(excess) * u64::from(by);
    }

    /// Price of being at `node` before `step`, on top of the routes entered.
    pub(super) fn presence(&self, node: usize, step: usize) -> u64 {
        self.presence[step * self.nodes + node]
    }

    /// Price of entering `node` in `step`, on top of the routes entered.
    pub(super) fn entry(&self, node: usize, step: usize) -> u64 {
        self.entry[step * self.nodes + node]
    }

    /// Price for objects of `kind` of taking an edge in `step` beyond that of entering its end.
    pub(super) fn crossing(
        &self,
        network: &Network,
        kind: usize,
        (from, to): (usize, usize),
        step: usize,
    ) -> u64 {
        let toll = |resource: u16| {
            let capacity = network.capacities[resource as usize];
            self.tolls(capacity, step * self.width + resource as usize).1
        };
        network.crossing(kind, from, to).map(toll).sum()
    }

    /// Whether a route of an object of `kind` draws on `resource` in `step`.
    pub(super) fn draws(network: &Network, kind: usize, route: &[u16], step: usize, resource: usize) -> bool {
        let resource = resource as u16;
        let (from, to) = (route[step] as usize, route[step + 1] as usize);
        network.resources.get(from).contains(&resource)
            || network.resources.get(to).contains(&resource)
            || from != to && network.crossing(kind, from, to).any(|drawn| drawn == resource)
    }
}

/// Place of a cell that is not overfilled.
const NOWHERE: u32 = u32::MAX;

/// Price of one conflict before any raise.
pub(super) const PRICE: u32 = 16;
