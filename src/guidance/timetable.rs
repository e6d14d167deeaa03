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
    load: Vec<u16>,
    enters: Vec<u16>,
    /// Extra price of an overfilled cell, grown by cells that stay overfilled.
    price: Vec<u32>,
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
    }

    fn visit(&mut self, network: &Network, route: &[u16], sign: u16) {
        for (step, pair) in route.windows(2).enumerate() {
            let row = step * self.width;
            for &resource in network.resources.get(pair[0] as usize) {
                let cell = row + resource as usize;
                self.load[cell] = self.load[cell].wrapping_add(sign);
            }
            if pair[0] != pair[1] {
                let entered = network.resources.get(pair[1] as usize).iter().copied();
                for resource in entered.chain(network.crossing(pair[0] as usize, pair[1] as usize)) {
                    let cell = row + resource as usize;
                    self.load[cell] = self.load[cell].wrapping_add(sign);
                    self.enters[cell] = self.enters[cell].wrapping_add(sign);
                }
            }
        }
    }

    /// Enters a route.
    pub(super) fn add(&mut self, network: &Network, route: &[u16]) {
        self.visit(network, route, 1);
    }

    /// Takes out a route that was entered.
    pub(super) fn remove(&mut self, network: &Network, route: &[u16]) {
        self.visit(network, route, u16::MAX);
    }

    fn excess(&self, capacity: u16, cell: usize) -> u16 {
        if self.enters[cell] == 0 { 0 } else { self.load[cell].saturating_sub(capacity) }
    }

    /// Sum over all cells of what they hold too much, each weighed with its price.
    pub(super) fn priced_conflicts(&self, network: &Network) -> u64 {
        let mut sum = 0;
        for row in 0..self.horizon {
            for (resource, &capacity) in network.capacities.iter().enumerate() {
                let cell = row * self.width + resource;
                let excess = self.excess(capacity, cell);
                if excess > 0 {
                    sum += u64::from(excess) * u64::from(PRICE + self.price[cell]);
                }
            }
        }
        sum
    }

    /// The overfilled cells as (step, resource).
    pub(super) fn overfilled(&self, network: &Network, cells: &mut Vec<(usize, usize)>) {
        cells.clear();
        for step in 0..self.horizon {
            for (resource, &capacity) in network.capacities.iter().enumerate() {
                if self.excess(capacity, step * self.width + resource) > 0 {
                    cells.push((step, resource));
                }
            }
        }
    }

    /// Raises the price of a cell.
    pub(super) fn raise(&mut self, step: usize, resource: usize, by: u32) {
        let price = &mut self.price[step * self.width + resource];
        *price = price.saturating_add(by).min(1 << 20);
    }

    /// Price of being at `node` before `step`, on top of the routes entered.
    pub(super) fn presence(&self, network: &Network, node: usize, step: usize) -> u64 {
        let mut sum = 0;
        for &resource in network.resources.get(node) {
            let cell = step * self.width + resource as usize;
            if self.enters[cell] > 0 && self.load[cell] >= network.capacities[resource as usize] {
                sum += u64::from(PRICE + self.price[cell]);
            }
        }
        sum
    }

    /// Price of entering `node` in `step`, on top of the routes entered.
    pub(super) fn entry(&self, network: &Network, node: usize, step: usize) -> u64 {
        self.draw(network, network.resources.get(node).iter().copied(), step)
    }

    /// Price of taking an edge in `step` beyond that of entering its end.
    pub(super) fn crossing(&self, network: &Network, from: usize, to: usize, step: usize) -> u64 {
        self.draw(network, network.crossing(from, to), step)
    }

    fn draw(&self, network: &Network, resources: impl Iterator<Item = u16>, step: usize) -> u64 {
        let mut sum = 0;
        for resource in resources {
            let cell = step * self.width + resource as usize;
            let capacity = network.capacities[resource as usize];
            if self.load[cell] >= capacity {
                // Where nothing entered so far, this entry makes all the excess count.
                let excess = if self.enters[cell] == 0 { self.load[cell] - capacity + 1 } else { 1 };
                sum += u64::from(excess) * u64::from(PRICE + self.price[cell]);
            }
        }
        sum
    }

    /// Whether a route draws on `resource` in `step`.
    pub(super) fn draws(network: &Network, route: &[u16], step: usize, resource: usize) -> bool {
        let resource = resource as u16;
        let (from, to) = (route[step] as usize, route[step + 1] as usize);
        network.resources.get(from).contains(&resource)
            || network.resources.get(to).contains(&resource)
            || from != to && network.crossing(from, to).any(|drawn| drawn == resource)
    }
}

/// Price of one conflict before any raise.
pub(super) const PRICE: u32 = 16;
