//! Exhaustive search over the joint states of few objects: depth-first with a bound on the depth
//! and a table of refuted states. Decides small instances exactly, where relaxations are too weak.

use super::network::{FAR, Network};
use crate::run::Control;
use smallvec::SmallVec;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// What an exhaustive search found out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Verdict {
    /// A plan, as the states along it.
    Found(Vec<Vec<u16>>),
    /// There is none within the depth (or, without a depth, none at all; so many states are reachable).
    Refuted(usize),
    /// The limit on states came first, or the run was told to stop.
    Limit,
}

/// By object, its node.
type State = SmallVec<[u16; 16]>;

/// The search, with its table of refuted states, which is good for one network.
#[derive(Debug, Clone)]
pub(super) struct Exhaustive<'a> {
    network: &'a Network,
    /// Bits that a node takes in a packed state.
    bits: u32,
    /// Objects of one kind, where there are several.
    alike: Vec<Vec<usize>>,
    /// For every kind, node and arm, the steps that the arm must spend on an object that is there.
    duty: Vec<Vec<u8>>,
    /// For a packed state, the greatest depth to which it was refuted.
    refuted: HashMap<u128, u16, BuildHasherDefault<Mix>>,
    states_left: usize,
    /// Partial joint steps that may still be looked at.
    choices_left: usize,
    way: Vec<State>,
}

/// Partial joint steps looked at for each state that may be expanded, on average: a state of many objects has
/// more joint steps than can be listed.
const CHOICES: usize = 64;

/// The fewest of them that a search may look at.
const FEWEST_CHOICES: usize = 4_096;

/// Most successors of one state that are listed.
const MOST_SUCCESSORS: usize = 20_000;

/// Partial joint steps between two looks at whether to stop.
const LOOK: usize = 1_024;

impl<'a> Exhaustive<'a> {
    /// A search on `network`; `None` if its states do not fit into 128 bits.
    pub(super) fn new(network: &'a Network) -> Option<Self> {
        let bits = usize::BITS - network.node_count().saturating_sub(1).leading_zeros();
        let bits = bits.max(1);
        if bits as usize * network.object_count() > 128 {
            return None;
        }
        let mut alike: Vec<Vec<usize>> = vec![Vec::new(); network.kinds.len()];
        for (object, &kind) in network.kind_of.iter().enumerate() {
            alike[kind].push(object);
        }
        alike.retain(|objects| objects.len() > 1);
        let duty = duties(network);
        Some(Self {
            network,
            bits,
            alike,
            duty,
            refuted: HashMap::default(),
            states_left: 0,
            choices_left: 0,
            way: Vec::new(),
        })
    }

    /// Looks for a plan of at most `depth` steps, expanding at most `states` states.
    pub(super) fn within(
        &mut self,
        start: &[u16],
        depth: usize,
        states: usize,
        control: &Control,
    ) -> Verdict {
        self.states_left = states;
        self.choices_left = (CHOICES * states).max(FEWEST_CHOICES);
        self.way.clear();
        self.way.push(State::from_slice(start));
        match self.descend(depth, control) {
            Some(true) => Verdict::Found(self.way.drain(..).map(State::into_vec).collect()),
            Some(false) => Verdict::Refuted(states - self.states_left),
            None => Verdict::Limit,
        }
    }

    /// Looks at every state that can be reached from `start`, at most `states` of them: a plan of the
    /// fewest single moves, one in a step, or the proof that there is none.
    pub(super) fn all(&mut self, start: &[u16], states: usize, control: &Control) -> Verdict {
        self.choices_left = usize::MAX;
        let mut seen: HashMap<u128, (), BuildHasherDefault<Mix>> = HashMap::default();
        // The states in the order in which they were reached, each with the one before it.
        let mut reached = vec![(State::from_slice(start), 0)];
        seen.insert(self.pack(start), ());
        let mut next_open = 0;
        while let Some((state, _)) = reached.get(next_open).cloned() {
            let from = next_open;
            next_open += 1;
            if seen.len() > states {
                return Verdict::Limit;
            }
            let mut moves = Vec::new();
            // Every joint step can be taken apart into single moves unless arms trade objects, which
            // the rules exclude; so single moves reach all that can be reached.
            if self.successors(&state, FAR as usize - 1, true, &mut moves, control).is_none() {
                return Verdict::Limit;
            }
            for next in moves {
                if self.solved(&next) {
                    let mut way = vec![next.into_vec()];
                    let mut at = from;
                    while at != 0 {
                        way.push(reached[at].0.to_vec());
                        at = reached[at].1;
                    }
                    way.push(start.to_vec());
                    way.reverse();
                    return Verdict::Found(way);
                }
                if seen.insert(self.pack(&next), ()).is_none() {
                    reached.push((next, from));
                }
            }
        }
        Verdict::Refuted(seen.len())
    }

    fn solved(&self, state: &[u16]) -> bool {
        state.iter().enumerate().all(|(object, &node)| self.network.kind(object).is_goal[node as usize])
    }

    /// Packs a state, the same for states that differ by a swap of interchangeable objects.
    fn pack(&self, state: &[u16]) -> u128 {
        let mut canonical;
        let mut state = state;
        if !self.alike.is_empty() {
            canonical = State::from_slice(state);
            for objects in &self.alike {
                let mut nodes: State = objects.iter().map(|&object| state[object]).collect();
                nodes.sort_unstable();
                for (&object, node) in objects.iter().zip(nodes) {
                    canonical[object] = node;
                }
            }
            state = &canonical;
        }
        state.iter().fold(0, |packed, &node| (packed << self.bits) | u128::from(node))
    }

    /// Whether the last state of the way can be finished in `depth` steps; `None` at the limit.
    fn descend(&mut self, depth: usize, control: &Control) -> Option<bool> {
        let state = self.way.last().cloned().unwrap_or_default();
        if self.solved(&state) {
            return Some(true);
        }
        if !self.may_finish(&state, depth) {
            return Some(false);
        }
        let key = self.pack(&state);
        if self.refuted.get(&key).is_some_and(|&refuted| refuted as usize >= depth) {
            return Some(false);
        }
        if self.states_left == 0 {
            return None;
        }
        self.states_left -= 1;
        let mut next = Vec::new();
        self.successors(&state, depth - 1, false, &mut next, control)?;
        // Making many successors is work, too.
        self.states_left = self.states_left.saturating_sub(next.len() / 8);
        for state in next {
            self.way.push(state);
            if self.descend(depth - 1, control)? {
                return Some(true);
            }
            self.way.pop();
        }
        self.refuted.insert(key, depth as u16);
        Some(false)
    }

    /// Whether distances and the arms' duties leave it open that `depth` steps are enough.
    fn may_finish(&self, state: &[u16], depth: usize) -> bool {
        let network = self.network;
        let near = |(object, &node): (usize, &u16)| network.to_goal(object, node as usize) as usize <= depth;
        if !state.iter().enumerate().all(near) {
            return false;
        }
        let arms = network.arms.len();
        (0..arms).all(|arm| {
            let due: usize = state
                .iter()
                .enumerate()
                .map(|(object, &node)| {
                    usize::from(self.duty[network.kind_of[object]][node as usize * arms + arm])
                })
                .sum();
            due <= depth
        })
    }

    /// The states one step on, from which distances leave `left` steps possible; joint steps, or
    /// single moves only. `None` at the limit.
    fn successors(
        &mut self,
        state: &[u16],
        left: usize,
        single: bool,
        found: &mut Vec<State>,
        control: &Control,
    ) -> Option<()> {
        if control.should_stop() {
            return None;
        }
        let mut load = vec![0_u16; self.network.capacities.len()];
        for &node in state {
            for &resource in self.network.resources.get(node as usize) {
                load[resource as usize] += 1;
            }
        }
        let mut choice = Choice {
            network: self.network,
            state,
            left,
            single,
            load,
            next: State::from_slice(state),
            found,
            choices_left: self.choices_left,
            control,
        };
        let listed = choice.go_on(0);
        self.choices_left = choice.choices_left;
        listed
    }
}

/// The joint steps from one state, chosen object by object.
struct Choice<'c> {
    network: &'c Network,
    state: &'c [u16],
    left: usize,
    single: bool,
    load: Vec<u16>,
    next: State,
    found: &'c mut Vec<State>,
    choices_left: usize,
    control: &'c Control,
}

impl Choice<'_> {
    /// Lists the joint steps by what the objects from number `object` on do; `None` at the limit.
    fn go_on(&mut self, object: usize) -> Option<()> {
        self.choices_left = self.choices_left.checked_sub(1)?;
        if self.choices_left.is_multiple_of(LOOK) && self.control.should_stop() {
            return None;
        }
        let Some(&node) = self.state.get(object) else {
            if self.next.as_slice() != self.state {
                if self.found.len() == MOST_SUCCESSORS {
                    return None;
                }
                self.found.push(self.next.clone());
            }
            return Some(());
        };
        let (network, left) = (self.network, self.left);
        let far = |node: u16| network.to_goal(object, node as usize) as usize > left;
        if self.single && self.next[..object] != self.state[..object] {
            return if far(node) { Some(()) } else { self.go_on(object + 1) };
        }
        // Moves towards the goal first.
        for nearer in [true, false] {
            for &to in network.graph(object).successors(node as usize) {
                let comes_nearer =
                    network.to_goal(object, to as usize) < network.to_goal(object, node as usize);
                if comes_nearer != nearer || far(to) {
                    continue;
                }
                let entered = network.resources.get(to as usize).iter().copied();
                let crossed = network.crossing(network.kind_of[object], node as usize, to as usize);
                let resources = entered.chain(crossed);
                let full =
                    |resource: u16| self.load[resource as usize] >= network.capacities[resource as usize];
                if resources.clone().any(full) {
                    continue;
                }
                for resource in resources.clone() {
                    self.load[resource as usize] += 1;
                }
                self.next[object] = to;
                self.go_on(object + 1)?;
                self.next[object] = node;
                for resource in resources {
                    self.load[resource as usize] -= 1;
                }
            }
            if nearer && !far(node) {
                self.go_on(object + 1)?;
            }
        }
        Some(())
    }
}

/// For every kind, and every node and arm, how many steps the arm must spend on an object of that
/// kind at that node: two if every path to the goal passes through it, one if the object is in it.
fn duties(network: &Network) -> Vec<Vec<u8>> {
    let (count, arms) = (network.node_count(), network.arms.len());
    let mut all = Vec::with_capacity(network.kinds.len());
    let mut queue: Vec<u16> = Vec::new();
    for kind in &network.kinds {
        let graph = &network.graphs[kind.graph];
        let mut duty = vec![0; count * arms];
        for index in 0..arms {
            let is_hand = |node: usize| network.arm_number[node] == index;
            // A hand that is itself a goal need not pass anything on.
            if kind.goals.iter().any(|&goal| is_hand(goal as usize)) {
                continue;
            }
            let mut reached = vec![false; count];
            queue.clear();
            queue.extend(&kind.goals);
            for &goal in &kind.goals {
                reached[goal as usize] = true;
            }
            while let Some(node) = queue.pop() {
                for &before in graph.predecessors(node as usize) {
                    if !is_hand(before as usize) && !reached[before as usize] {
                        reached[before as usize] = true;
                        queue.push(before);
                    }
                }
            }
            for node in 0..count {
                duty[node * arms + index] = match reached[node] {
                    true => 0,
                    false if is_hand(node) => 1,
                    false => 2,
                };
            }
        }
        all.push(duty);
    }
    all
}

/// A quick hasher for packed states (multiply and fold).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Mix(u64);

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(u64::from(byte));
        }
    }

    fn write_u64(&mut self, value: u64) {
        let mixed = u128::from(self.0 ^ value ^ 0x9e37_79b9_7f4a_7c15) * 0xd1b5_4a32_d192_ed03_u128;
        self.0 = (mixed as u64) ^ ((mixed >> 64) as u64);
    }

    fn write_u128(&mut self, value: u128) {
        self.write_u64(value as u64);
        self.write_u64((value >> 64) as u64);
    }
}
