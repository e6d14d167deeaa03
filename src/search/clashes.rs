//! Handoffs that cannot be done at once: what is learnt about them becomes part of the network of
//! guidance.
//!
//! The mode graph says which arms can meet, pair by pair. Whether two pairs can meet in the same step
//! depends on where they are and how they hold what they hand over; two that cross, as on the diagonals of
//! a square of arms, mostly cannot. This is asked when it matters: when a guide has two handoffs in one
//! step and no meetings are found that keep their arms apart, time after time, the network gains a
//! [`Clash`]. Like the graph's edges it rests on samples. A plan that keeps the rules learnt so far and has as few
//! steps as any that does is shortest on the graph with all such rules, since further rules only take
//! plans away.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::guidance::{Clash, Cuts, Effort, Memo, Move, Network, NodeId, solve};
use crate::run::Control;
use crate::workcell::ArmId;

use super::smart::Search;

/// Vain searches for meetings of two handoffs after which they are taken to clash.
const LEARNT_AFTER: u32 = 3;

/// Two pairs of arms, giver and receiver, in ascending order.
type Pairs = [(ArmId, ArmId); 2];

/// How often no meetings were found for two handoffs in one step.
pub(super) type Suspicions = BTreeMap<Pairs, u32>;

impl Search<'_> {
    /// Notes that no meetings of two handoffs were found that are apart.
    pub(super) fn suspect(&mut self, one: &Move, two: &Move, control: &Control) {
        let (Some(a), Some(b)) = (self.handing(one), self.handing(two)) else { return };
        let pairs = [a.min(b), a.max(b)];
        let count = self.suspicions.entry(pairs).or_default();
        *count += 1;
        if *count == LEARNT_AFTER {
            self.learn_clash(&pairs, control);
        }
    }

    /// The arms between which something changes hands.
    fn handing(&self, action: &Move) -> Option<(ArmId, ArmId)> {
        Some((self.map.arm(action.from)?, self.map.arm(action.to)?))
    }

    fn learn_clash(&mut self, pairs: &Pairs, control: &Control) {
        let mut instance = self.network.instance().clone();
        let mut edges: Vec<(NodeId, NodeId)> = instance
            .edges
            .iter()
            .map(|edge| (edge.from, edge.to))
            .filter(|&(from, to)| {
                let arms = self.map.arm(from).zip(self.map.arm(to));
                arms.is_some_and(|arms| pairs.contains(&arms))
            })
            .collect();
        edges.sort_unstable();
        edges.dedup();
        instance.clashes.push(Clash { edges });
        let Ok(network) = Network::new(instance) else { return };
        self.network = Arc::new(network);
        (self.memo, self.detours) = (Memo::new(), Memo::new());
        self.version += 1;
        let start = self.tree[0].mode.clone();
        let (cuts, effort) = (Cuts::none(), Effort::quick());
        if let Ok(answer) = solve(&self.network, &start, &cuts, &effort, self.seed, control) {
            self.memo.keep(&start, &answer, &cuts);
            self.certificate = answer.certificate().copied();
            self.examined = false;
        }
    }
}
