//! Search for a plan of a given length: routes are planned one object after another with conflicts
//! allowed at a price, then neighbourhoods of 2 to 6 objects around a conflict are taken out and
//! planned again until no conflict is left. Cells that stay contested grow dearer (negotiated
//! congestion).
//!
//! Prioritised planning after Silver (2005), repair after MAPF-LNS2 (Li et al. 2022), prices after
//! PathFinder (McMurchie and Ebeling 1995).

use super::cuts::{Cuts, Tolls};
use super::instance::NodeId;
use super::network::Network;
use super::route::RouteSearch;
use super::solution::{Move, Solution};
use super::timetable::{Route, Timetable};
use crate::run::{Control, Rng};
use rand::Rng as _;
use rand::seq::{IndexedRandom as _, SliceRandom as _};

/// Largest neighbourhood, and that where there are more than [`MANY`] objects.
const LARGEST: usize = 6;
const LARGEST_OF_MANY: usize = 4;
/// Objects beyond which plans are crowded, and much of the search is in vain.
pub(super) const MANY: usize = 16;
/// By how much the price of a contested cell grows.
const RAISE: u32 = 4;

/// The search at one horizon after another, with its buffers.
pub(super) struct Repair<'a> {
    network: &'a Network,
    start: &'a [u16],
    timetable: Timetable,
    tolls: Tolls,
    search: RouteSearch,
    routes: Vec<Route>,
    rng: Rng,
    chosen: Vec<usize>,
}

impl<'a> Repair<'a> {
    /// A search from `start`, which places every object of `network`.
    pub(super) fn new(network: &'a Network, start: &'a [u16], rng: Rng) -> Self {
        Self {
            network,
            start,
            timetable: Timetable::default(),
            tolls: Tolls::new(network, &Cuts::none(), 0),
            search: RouteSearch::new(network.object_count() > MANY),
            routes: Vec::new(),
            rng,
            chosen: Vec::new(),
        }
    }

    /// Plans all objects at `horizon`: farthest from its goal first, or in a random order if
    /// `shuffled`. False if the horizon is too short for some object alone.
    pub(super) fn begin(&mut self, horizon: usize, cuts: &Cuts, shuffled: bool) -> bool {
        self.timetable.reset(self.network, horizon);
        self.tolls = Tolls::new(self.network, cuts, horizon);
        let count = self.network.object_count();
        self.routes = vec![Vec::new(); count];
        let mut order: Vec<usize> = (0..count).collect();
        if shuffled {
            order.shuffle(&mut self.rng);
        } else {
            order.sort_by_key(|&object| {
                let distance = self.network.to_goal(object, self.start[object] as usize);
                (std::cmp::Reverse(distance), object)
            });
        }
        order.into_iter().all(|object| self.plan(object, u64::from(shuffled)))
    }

    /// What being at each node costs beyond conflicts; see [`RouteSearch::bias`].
    pub(super) fn bias(&mut self) -> &mut Vec<u64> {
        &mut self.search.bias
    }

    /// By arm, whether it should take in odd steps; `None` for no beat.
    pub(super) fn beat(&mut self, turns: Option<&[bool]>) {
        let beat = &mut self.search.beat;
        beat.clear();
        if let Some(turns) = turns {
            beat.extend(self.network.arm_number.iter().map(|&arm| turns.get(arm).copied()));
        }
    }

    /// Whether routes may rest on any slot, or only on one of each neighbourhood.
    pub(super) fn all_slots(&mut self, all: bool) {
        self.search.all_slots = all;
    }

    /// Takes over routes found elsewhere, one per object and equally long.
    pub(super) fn take_over(&mut self, routes: Vec<Route>, cuts: &Cuts) {
        let horizon = routes.first().map_or(0, |route| route.len() - 1);
        self.timetable.reset(self.network, horizon);
        self.tolls = Tolls::new(self.network, cuts, horizon);
        self.routes = routes;
        for object in 0..self.routes.len() {
            self.enter(object);
        }
    }

    /// Repairs until no conflict is left (true), or for `rounds` neighbourhoods, or until `control`
    /// says stop.
    pub(super) fn run(&mut self, rounds: usize, control: &Control) -> bool {
        for round in 0..=rounds {
            let overfilled = self.timetable.overfilled();
            if overfilled == 0 {
                return true;
            }
            if round == rounds || (round % 16 == 15 && control.should_stop()) {
                return false;
            }
            let cell = self.timetable.overfilled_cell(self.rng.random_range(0..overfilled));
            self.choose_around(cell);
            self.replan(false);
            self.timetable.raise(self.network, cell.0, cell.1, RAISE);
        }
        false
    }

    /// Lowers the weight of a plan without conflicts, `rounds` neighbourhoods long.
    pub(super) fn polish(&mut self, rounds: usize, control: &Control) {
        let count = self.network.object_count();
        for round in 0..rounds {
            if count == 0 || (round % 16 == 15 && control.should_stop()) {
                return;
            }
            self.chosen.clear();
            if round < count {
                self.chosen.push(round);
            } else {
                let size = self.rng.random_range(2..=4.min(count).max(2));
                for _ in 0..size {
                    let object = self.rng.random_range(0..count);
                    if !self.chosen.contains(&object) {
                        self.chosen.push(object);
                    }
                }
            }
            self.replan(true);
        }
    }

    /// Lowers the tolls of a plan without conflicts, until there are none or for `rounds`
    /// neighbourhoods.
    pub(super) fn dodge(&mut self, rounds: usize, control: &Control) {
        let count = self.network.object_count();
        for round in 0..rounds {
            let payers = self.payers();
            if payers.is_empty() || (round % 16 == 15 && control.should_stop()) {
                return;
            }
            self.chosen.clear();
            self.chosen.extend(payers.choose_multiple(&mut self.rng, 2));
            let another = self.rng.random_range(0..count);
            if self.rng.random() && !self.chosen.contains(&another) {
                self.chosen.push(another);
            }
            self.replan(true);
        }
    }

    /// The plan, with steps in which nothing moves left out.
    pub(super) fn solution(&self) -> Solution {
        let mut solution = Solution {
            start: self.start.iter().map(|&node| NodeId(node as usize)).collect(),
            ..Solution::default()
        };
        for step in 0..self.timetable.horizon {
            let mut moves = Vec::new();
            for (object, route) in self.routes.iter().enumerate() {
                let (from, to) = (route[step] as usize, route[step + 1] as usize);
                if from != to {
                    moves.push(Move { object, from: NodeId(from), to: NodeId(to) });
                    solution.weight += self.network.weight_of(object, from, to);
                }
            }
            if !moves.is_empty() {
                solution.steps.push(moves);
            }
        }
        solution
    }

    fn plan(&mut self, object: usize, noise: u64) -> bool {
        let start = self.start[object] as usize;
        let old = &self.routes[object];
        match self.search.cheapest(self.network, &self.timetable, &self.tolls, object, start, old, noise) {
            Some(route) => {
                self.routes[object] = route;
                self.enter(object);
                true
            }
            None => false,
        }
    }

    fn enter(&mut self, object: usize) {
        self.timetable.add(self.network, self.network.kind_of[object], &self.routes[object]);
        self.tolls.enter(object, &self.routes[object], 1);
    }

    fn take_out(&mut self, object: usize) {
        self.timetable.remove(self.network, self.network.kind_of[object], &self.routes[object]);
        self.tolls.enter(object, &self.routes[object], u16::MAX);
    }

    /// What a change of the chosen objects is judged by: conflicts, then tolls, then, if `weighed`,
    /// the weight of their routes.
    fn cost(&self, weighed: bool) -> (u64, u64, u64) {
        let tolls = if self.tolls.is_empty() { 0 } else { self.toll() };
        let weight = if weighed {
            self.chosen.iter().map(|&object| self.network.route_weight(object, &self.routes[object])).sum()
        } else {
            0
        };
        (self.timetable.priced_conflicts(), tolls, weight)
    }

    /// Sum of the tolls of all routes; a pair, and a block, counts at both its sides.
    fn toll(&self) -> u64 {
        (0..self.routes.len()).map(|object| self.toll_of(object)).sum()
    }

    fn toll_of(&self, object: usize) -> u64 {
        let mut sum = 0;
        for (step, ends) in self.routes[object].windows(2).enumerate() {
            sum += self.tolls.of_presence(object, ends[0] as usize, step);
            if ends[0] != ends[1] {
                sum += self.tolls.of_move(object, ends[0] as usize, ends[1] as usize, step);
            }
        }
        sum
    }

    /// The objects whose routes are tolled.
    fn payers(&self) -> Vec<usize> {
        if self.tolls.is_empty() {
            return Vec::new();
        }
        (0..self.routes.len()).filter(|&object| self.toll_of(object) > 0).collect()
    }

    /// The objects to plan again: those on a contested cell, then some that use the same arms at
    /// about the same time, then any.
    fn choose_around(&mut self, (step, resource): (usize, usize)) {
        let count = self.network.object_count();
        self.chosen.clear();
        for object in 0..count {
            if Timetable::draws(
                self.network,
                self.network.kind_of[object],
                &self.routes[object],
                step,
                resource,
            ) {
                self.chosen.push(object);
            }
        }
        self.chosen.shuffle(&mut self.rng);
        let largest = if count > MANY { LARGEST_OF_MANY } else { LARGEST };
        let size = self.rng.random_range(2..=largest).min(count);
        self.chosen.truncate(size);
        for _ in 0..4 * LARGEST {
            if self.chosen.len() >= size {
                return;
            }
            let object = self.rng.random_range(0..count);
            if self.chosen.contains(&object) {
                continue;
            }
            let seed = self.chosen[self.rng.random_range(0..self.chosen.len())];
            if self.rng.random_ratio(1, 4) || self.meet(seed, object) {
                self.chosen.push(object);
            }
        }
    }

    /// Whether the routes of two objects share an arm.
    fn meet(&self, one: usize, other: usize) -> bool {
        let arm = |&node: &u16| self.network.arm_number[node as usize];
        self.routes[one]
            .iter()
            .any(|node| arm(node) != usize::MAX && self.routes[other].iter().any(|at| arm(at) == arm(node)))
    }

    /// Takes out the chosen objects, plans them again in a random order, and goes back to the old
    /// routes if the cost got worse.
    fn replan(&mut self, weighed: bool) {
        let before = self.cost(weighed);
        let old: Vec<Route> = self.chosen.iter().map(|&object| self.routes[object].clone()).collect();
        let chosen = std::mem::take(&mut self.chosen);
        for &object in &chosen {
            self.take_out(object);
        }
        let mut order = chosen.clone();
        order.shuffle(&mut self.rng);
        let mut done = 0;
        for &object in &order {
            let noise = self.rng.random::<u64>() | 1;
            if !self.plan(object, noise) {
                break;
            }
            done += 1;
        }
        if done < order.len() || {
            self.chosen = chosen.clone();
            self.cost(weighed) > before
        } {
            for &object in &order[..done] {
                self.take_out(object);
            }
            for (&object, route) in chosen.iter().zip(old) {
                self.routes[object] = route;
                self.enter(object);
            }
        }
        self.chosen = chosen;
    }
}
