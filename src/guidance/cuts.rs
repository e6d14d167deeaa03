//! Cuts: actions that motion planning failed on are made dear for a while, never forbidden. A
//! failure of a sampling planner proves nothing, so every cut expires, and under cuts neither a
//! bound nor "infeasible" is claimed.

use super::instance::NodeId;
use super::network::Network;
use super::solution::Move;

/// What a cut makes dear.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CutKind {
    /// One action of one object.
    Action(Move),
    /// Every action of an arm.
    Arm(NodeId),
    /// Two actions in the same step.
    Pair(Move, Move),
    /// An action while another object is in its way: at `at` before the step or after it.
    Blocked {
        /// What cannot be done.
        action: Move,
        /// The object in the way.
        by: usize,
        /// Where that one is.
        at: NodeId,
    },
}

/// A penalty on each occurrence of something in a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// On what.
    pub kind: CutKind,
    /// How many more steps a plan may take rather than do it once.
    pub penalty: u32,
    /// The tick of [`Cuts::advance`] at which it is lifted.
    pub expires_at: u64,
}

/// The cuts in force, and the clock that lifts them: it counts calls, not time.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cuts {
    tick: u64,
    cuts: Vec<Cut>,
}

impl Cuts {
    /// No cuts.
    pub fn none() -> Self {
        Self::default()
    }

    /// Adds a cut for `lifetime` ticks. A cut of the same kind that is in force is made dearer by
    /// `penalty` and kept until the later of the two ends.
    pub fn add(&mut self, kind: CutKind, penalty: u32, lifetime: u64) {
        let kind = match kind {
            CutKind::Pair(a, b) if b < a => CutKind::Pair(b, a),
            other => other,
        };
        let expires_at = self.tick.saturating_add(lifetime);
        match self.cuts.iter_mut().find(|cut| cut.kind == kind) {
            Some(cut) => {
                cut.penalty = cut.penalty.saturating_add(penalty).min(MOST_PENALTY);
                cut.expires_at = cut.expires_at.max(expires_at);
            }
            None => self.cuts.push(Cut { kind, penalty: penalty.min(MOST_PENALTY), expires_at }),
        }
        self.cuts.retain(|cut| cut.expires_at > self.tick);
        self.cuts.sort_by_key(|cut| cut.kind);
    }

    /// Lets one tick pass and lifts what has expired.
    pub fn advance(&mut self) {
        self.tick += 1;
        self.cuts.retain(|cut| cut.expires_at > self.tick);
    }

    /// Lifts all cuts.
    pub fn clear(&mut self) {
        self.cuts.clear();
    }

    /// The cuts in force, in a fixed order.
    pub fn active(&self) -> &[Cut] {
        &self.cuts
    }

    /// Whether none is in force.
    pub fn is_empty(&self) -> bool {
        self.cuts.is_empty()
    }

    /// Sum of the penalties that `steps` incur, taken from the state `start`.
    pub fn penalty(&self, start: &[NodeId], steps: &[Vec<Move>]) -> u64 {
        let mut state = start.to_vec();
        let mut sum = 0;
        for moves in steps {
            let before = state.clone();
            for action in moves {
                if let Some(place) = state.get_mut(action.object) {
                    *place = action.to;
                }
            }
            let is_at = |object: usize, node| [&before, &state].iter().any(|s| s.get(object) == Some(&node));
            for cut in &self.cuts {
                let times = match cut.kind {
                    CutKind::Action(action) => usize::from(moves.contains(&action)),
                    CutKind::Arm(arm) => {
                        moves.iter().filter(|action| action.from == arm || action.to == arm).count()
                    }
                    CutKind::Pair(a, b) => usize::from(moves.contains(&a) && moves.contains(&b)),
                    CutKind::Blocked { action, by, at } => {
                        usize::from(moves.contains(&action) && is_at(by, at))
                    }
                };
                sum += times as u64 * u64::from(cut.penalty);
            }
        }
        sum
    }
}

/// No penalty grows beyond this many steps.
const MOST_PENALTY: u32 = 64;

/// Cuts compiled for the route search, with the occurrences of paired actions in the routes of
/// the other objects.
#[derive(Debug, Clone, Default)]
pub(super) struct Tolls {
    /// By object.
    actions: Vec<Vec<(Move, u32)>>,
    arms: Vec<u32>,
    pairs: Vec<Pair>,
    /// By object, the pairs of which it takes one side, and which one.
    pairs_of: Vec<Vec<(u32, u8)>>,
    blocks: Vec<Block>,
    /// By object, the blocks in which it is the one that acts or the one in the way.
    blocks_of: Vec<Vec<u32>>,
    empty: bool,
}

/// An action that another object blocks, and when the routes entered have the one do it and the
/// other be there.
#[derive(Debug, Clone)]
struct Block {
    action: Move,
    by: usize,
    at: NodeId,
    penalty: u32,
    /// How often the action happens in each step of the routes entered.
    happens: Vec<u16>,
    /// Whether the other is there before each step or after it.
    is_there: Vec<u16>,
}

#[derive(Debug, Clone)]
struct Pair {
    sides: [Move; 2],
    penalty: u32,
    /// How often each side happens in each step of the routes entered.
    happens: [Vec<u16>; 2],
}

impl Tolls {
    /// Compiles `cuts` for plans of at most `horizon` steps.
    pub(super) fn new(network: &Network, cuts: &Cuts, horizon: usize) -> Self {
        let mut tolls = Self { empty: cuts.is_empty(), ..Self::default() };
        if tolls.empty {
            return tolls;
        }
        tolls.arms = vec![0; network.node_count()];
        tolls.actions = vec![Vec::new(); network.object_count()];
        tolls.blocks_of = vec![Vec::new(); network.object_count()];
        tolls.pairs_of = vec![Vec::new(); network.object_count()];
        for cut in cuts.active() {
            match cut.kind {
                CutKind::Action(action) => {
                    if let Some(own) = tolls.actions.get_mut(action.object) {
                        own.push((action, cut.penalty));
                    }
                }
                CutKind::Arm(arm) => {
                    let number = network.arm_number.get(arm.0).copied().unwrap_or(usize::MAX);
                    for &node in network.arms.get(number).into_iter().flatten() {
                        tolls.arms[node as usize] += cut.penalty;
                    }
                }
                CutKind::Pair(a, b) => {
                    for (side, action) in [a, b].into_iter().enumerate() {
                        if let Some(own) = tolls.pairs_of.get_mut(action.object) {
                            own.push((tolls.pairs.len() as u32, side as u8));
                        }
                    }
                    tolls.pairs.push(Pair {
                        sides: [a, b],
                        penalty: cut.penalty,
                        happens: [vec![0; horizon], vec![0; horizon]],
                    });
                }
                CutKind::Blocked { action, by, at } => {
                    for object in [action.object, by] {
                        if let Some(own) = tolls.blocks_of.get_mut(object) {
                            own.push(tolls.blocks.len() as u32);
                        }
                    }
                    tolls.blocks.push(Block {
                        action,
                        by,
                        at,
                        penalty: cut.penalty,
                        happens: vec![0; horizon],
                        is_there: vec![0; horizon],
                    });
                }
            }
        }
        tolls
    }

    /// Whether there is nothing to pay anywhere.
    pub(super) fn is_empty(&self) -> bool {
        self.empty
    }

    /// Enters (`sign` 1) or takes out (`u16::MAX`) the route of `object`.
    pub(super) fn enter(&mut self, object: usize, route: &[u16], sign: u16) {
        for &(index, side) in self.pairs_of.get(object).into_iter().flatten() {
            let pair = &mut self.pairs[index as usize];
            let (action, happens) = (pair.sides[side as usize], &mut pair.happens[side as usize]);
            for (step, ends) in route.windows(2).enumerate() {
                if action.from.0 == ends[0] as usize && action.to.0 == ends[1] as usize {
                    happens[step] = happens[step].wrapping_add(sign);
                }
            }
        }
        for &index in self.blocks_of.get(object).into_iter().flatten() {
            let block = &mut self.blocks[index as usize];
            let (from, to, at) = (block.action.from.0, block.action.to.0, block.at.0);
            for (step, ends) in route.windows(2).enumerate() {
                let (before, after) = (usize::from(ends[0]), usize::from(ends[1]));
                if block.action.object == object && before == from && after == to {
                    block.happens[step] = block.happens[step].wrapping_add(sign);
                }
                if block.by == object && (before == at || after == at) {
                    block.is_there[step] = block.is_there[step].wrapping_add(sign);
                }
            }
        }
    }

    fn blocks_with(&self, object: usize) -> impl Iterator<Item = &Block> {
        self.blocks_of.get(object).into_iter().flatten().map(|&index| &self.blocks[index as usize])
    }

    /// What it costs `object` to be at `node` before `step`, given the routes entered.
    pub(super) fn of_presence(&self, object: usize, node: usize, step: usize) -> u64 {
        let paid = self.blocks_with(object).filter(|block| {
            block.by == object && block.at.0 == node && block.happens.get(step).is_some_and(|&n| n > 0)
        });
        paid.map(|block| u64::from(block.penalty)).sum()
    }

    /// What a move costs in `step`, given the routes entered.
    pub(super) fn of_move(&self, object: usize, from: usize, to: usize, step: usize) -> u64 {
        let mut sum = u64::from(self.arms[from]) + u64::from(self.arms[to]);
        let same = |action: &Move| action.object == object && action.from.0 == from && action.to.0 == to;
        for (action, penalty) in self.actions.get(object).into_iter().flatten() {
            if same(action) {
                sum += u64::from(*penalty);
            }
        }
        for block in self.blocks_with(object) {
            // Where it is there already, presence is paid for.
            let enters = block.by == object && block.at.0 == to && block.at.0 != from;
            if (same(&block.action) && block.is_there[step] > 0) || (enters && block.happens[step] > 0) {
                sum += u64::from(block.penalty);
            }
        }
        for &(index, side) in self.pairs_of.get(object).into_iter().flatten() {
            let pair = &self.pairs[index as usize];
            if same(&pair.sides[side as usize]) && pair.happens[1 - side as usize][step] > 0 {
                sum += u64::from(pair.penalty);
            }
        }
        sum
    }
}
