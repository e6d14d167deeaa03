//! Actions that cannot be done at once: what is learnt about them becomes part of the network of
//! guidance.
//!
//! The mode graph says which arms can meet, pair by pair, and what each can pick and place. Whether two
//! actions go together in one step depends on where the arms are and how they hold what they move. Two
//! handoffs that cross, as on the diagonals of a square of arms, mostly cannot be done at once; a pick
//! beside a place sometimes cannot, with the grasps that the handoffs before and after allow. This is asked
//! when it matters: when a guide has two such actions in one step and no contacts are found that keep their
//! arms apart, time after time, the network gains a [`Clash`]. It is of all objects where two handoffs
//! clash, which happen in the air, and of the two objects alone where one is picked from where it stood at
//! the start or placed in a slot. (One that is back in the region of its start counts as if it stood there
//! still.) Such rules rest on samples and prove nothing: they say where a plan is sought, and from how many steps on,
//! while the certificate stays that of the map's own network.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::guidance::{Answer, Clash, Clashing, Cuts, Effort, Guide, Memo, Move, Network, NodeId, solve};
use crate::problem::{GuidanceKind, InitialPlacement};
use crate::run::Control;
use crate::workcell::ArmId;

use super::smart::Search;
use super::tree::Whereabouts;

/// Vain searches for meetings of two handoffs after which they are taken to clash.
const LEARNT_AFTER: u32 = 3;

/// Vain expansions, of several groundings each, after which two contacts are taken to clash.
const CONTACTS_LEARNT_AFTER: u32 = 8;

/// What is suspected to clash, in ascending order.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Pair {
    /// Handoffs of any objects, by giver and receiver.
    Handoffs([(ArmId, ArmId); 2]),
    /// A pick or place of one object and one of another.
    Contacts([Move; 2]),
}

/// How often no contacts were found for two actions in one step that keep their arms apart.
pub(super) type Suspicions = BTreeMap<Pair, u32>;

impl Search<'_> {
    /// Notes that no meetings of two handoffs were found that are apart.
    pub(super) fn suspect(&mut self, one: &Move, two: &Move, control: &Control) {
        let (Some(a), Some(b)) = (self.handing(one), self.handing(two)) else { return };
        let pairs = [a.min(b), a.max(b)];
        if self.is_learnt(Pair::Handoffs(pairs), LEARNT_AFTER) {
            let edges = self.edges_where(|from, to| {
                let arms = self.map.arm(from).zip(self.map.arm(to));
                arms.is_some_and(|arms| pairs.contains(&arms))
            });
            self.learn_clash(edges.into_iter().map(Clashing::from).collect(), control);
        }
    }

    /// Notes an expansion of `tau` in vain; `crowds` has the arms that touched each other at the end of the step,
    /// grounding by grounding.
    pub(super) fn note_crowds(
        &mut self,
        tau: usize,
        guide: &Guide,
        crowds: &[Option<(ArmId, ArmId)>],
        control: &Control,
    ) {
        let Some(&Some((one, two))) = crowds.first() else { return };
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        if !is_smart || crowds.iter().any(|crowd| *crowd != Some((one, two))) {
            return;
        }
        let by = |arm: ArmId| {
            let acts =
                |action: &&Move| [action.from, action.to].iter().any(|&n| self.map.arm(n) == Some(arm));
            guide.immediate.iter().find(acts).copied().filter(|action| self.is_bound(tau, action))
        };
        let (Some(a), Some(b)) = (by(one), by(two)) else { return };
        if a != b && self.is_learnt(Pair::Contacts([a.min(b), a.max(b)]), CONTACTS_LEARNT_AFTER) {
            let mut actions = Vec::new();
            for action in [a, b] {
                let same = |from, to| self.map.is_same(from, action.from) && self.map.is_same(to, action.to);
                let edges = self.edges_where(same).into_iter();
                actions.extend(edges.map(|(from, to)| Clashing { from, to, object: Some(action.object) }));
            }
            self.learn_clash(actions, control);
        }
    }

    /// Whether `action` takes an object up where it stood at the start, or puts it down in a slot.
    fn is_bound(&self, tau: usize, action: &Move) -> bool {
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(_)) => matches!(
                (&self.tree[tau].objects[action.object], &self.problem.initial[action.object]),
                (Whereabouts::Resting { pose, .. }, InitialPlacement::Resting { pose: start, .. })
                    if pose == start
            ),
            (Some(_), None) => !self.map.is_region(action.to),
            _ => false,
        }
    }

    /// Counts a failure; whether it is the one after which the pair is taken to clash.
    fn is_learnt(&mut self, pair: Pair, after: u32) -> bool {
        let count = self.suspicions.entry(pair).or_default();
        *count += 1;
        *count == after
    }

    /// The edges between nodes that fit.
    fn edges_where(&self, fit: impl Fn(NodeId, NodeId) -> bool) -> Vec<(NodeId, NodeId)> {
        let edges = self.network.instance().edges.iter().map(|edge| (edge.from, edge.to));
        let mut found: Vec<(NodeId, NodeId)> = edges.filter(|&(from, to)| fit(from, to)).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// The arms between which something changes hands.
    fn handing(&self, action: &Move) -> Option<(ArmId, ArmId)> {
        Some((self.map.arm(action.from)?, self.map.arm(action.to)?))
    }

    fn learn_clash(&mut self, actions: Vec<Clashing>, control: &Control) {
        let mut instance = self.network.instance().clone();
        instance.clashes.push(Clash { actions });
        let Ok(network) = Network::new(instance) else { return };
        let start = self.tree[0].mode.clone();
        let (cuts, effort) = (Cuts::none(), Effort::quick());
        let answer = solve(&network, &start, &cuts, &effort, self.seed, control);
        // Samples do not prove that a problem has no solution, nor may they make one hard to find.
        let Ok(answer @ Answer::Solved(..)) = answer else { return };
        self.network = Arc::new(network);
        (self.memo, self.detours) = (Memo::new(), Memo::new());
        self.version += 1;
        for vertex in &mut self.tree {
            vertex.fewest = None;
        }
        self.memo.keep(&start, &answer, &cuts);
        let bound = answer.certificate().map_or(0, |certificate| certificate.lower_bound);
        self.least_steps = self.least_steps.max(bound);
        self.examined = false;
    }
}
