//! Handoffs that cannot be done at once: what is learnt about them becomes part of the network of
//! guidance.
//!
//! The mode graph says which arms can meet, pair by pair. Whether two pairs can meet in the same step
//! depends on where they are and how they hold what they hand over; two that cross, as on the diagonals of
//! a square of arms, mostly cannot. This is asked when it matters: when a guide has two handoffs in one
//! step and no meetings are found that keep their arms apart, time after time, the network gains a
//! [`Clash`]. So it does when two arms that pick or place at exact places touch each other there whatever
//! the grasps and however the arms bend. (An object that left the place of its start, and is back in the
//! same region, counts as if it stood there still.) Like the graph's edges such rules rest on samples. A plan
//! that keeps the rules learnt so far and has as few steps as any that does is shortest on the graph with
//! all such rules, since further rules only take plans away.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::guidance::{Clash, Clashing, Cuts, Effort, Guide, Memo, Move, Network, NodeId, solve};
use crate::problem::{GuidanceKind, InitialPlacement};
use crate::run::Control;
use crate::transition::ContactKind;
use crate::workcell::{ArmId, ObjectId, Symmetry};

use super::chain::query;
use super::smart::Search;
use super::together::End;
use super::tree::Whereabouts;

/// Vain searches for meetings of two handoffs after which they are taken to clash.
const LEARNT_AFTER: u32 = 3;

/// Two pairs of arms, giver and receiver, in ascending order.
type Pairs = [(ArmId, ArmId); 2];

/// How often no meetings were found for two handoffs in one step.
pub(super) type Suspicions = BTreeMap<Pairs, u32>;

/// Samplings of contacts in one hold before two actions are said to clash.
const SAMPLINGS: usize = 3;

impl Search<'_> {
    /// Looks into two arms that touch each other at the end of a step from `tau`, where they act on objects at
    /// rest; whether it is learnt that they always do.
    pub(super) fn look_into(
        &mut self,
        tau: usize,
        guide: &Guide,
        (one, two): (ArmId, ArmId),
        control: &Control,
    ) -> bool {
        let by = |arm: ArmId| {
            let mut all = guide.immediate.iter().copied();
            all.find(|action| [action.from, action.to].iter().any(|&node| self.map.arm(node) == Some(arm)))
        };
        let (Some(a), Some(b)) = (by(one), by(two)) else { return false };
        let pair = [a.min(b), a.max(b)];
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        if a == b || !is_smart || !self.looked_into.insert(pair) {
            return false;
        }
        let (Some(ends), Some(others)) = (self.ends_of(tau, &a, control), self.ends_of(tau, &b, control))
        else {
            return false;
        };
        let possible = ends.iter().any(|end| others.iter().any(|other| self.grounder.ends_apart(end, other)));
        if possible || control.should_stop() {
            return false;
        }
        let mut actions = Vec::new();
        for action in [a, b] {
            let same = |from, to| self.map.is_same(from, action.from) && self.map.is_same(to, action.to);
            let edges = self.edges_where(same).into_iter();
            actions.extend(edges.map(|(from, to)| Clashing { from, to, object: Some(action.object) }));
        }
        self.learn_clash(actions, control);
        true
    }

    /// Where the arm of a pick from the object's start, or of a place at one exact pose, may be; `None` for other
    /// actions.
    fn ends_of(&mut self, tau: usize, action: &Move, control: &Control) -> Option<Vec<End>> {
        let object = ObjectId(action.object);
        let (kind, arm, places) = match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(arm)) => {
                let Whereabouts::Resting { pose, surface } = self.tree[tau].objects[action.object] else {
                    return None;
                };
                let at_start = matches!(&self.problem.initial[action.object],
                    InitialPlacement::Resting { pose: start, .. } if *start == pose);
                if !at_start {
                    return None;
                }
                (ContactKind::Pick, arm, vec![(pose, surface)])
            }
            (Some(arm), None) if !self.map.is_region(action.to) => {
                (ContactKind::Place, arm, self.map.placements(action.object, action.to))
            }
            _ => return None,
        };
        let symmetry = &self.problem.objects[action.object].symmetry;
        let endless = matches!(symmetry, Symmetry::CylinderZ | Symmetry::Sphere);
        if endless && kind == ContactKind::Place {
            return None;
        }
        let mut ends = Vec::new();
        for at in places {
            let asked = query(kind, arm, object, at);
            for (_, hold) in self.grounder.contacts.holds(&asked) {
                for _ in 0..SAMPLINGS {
                    if control.should_stop() || !self.grounder.contacts.more(&asked, &hold) {
                        break;
                    }
                }
                ends.extend(self.grounder.contact_ends(&asked, &hold));
            }
        }
        Some(ends)
    }

    /// Notes that no meetings of two handoffs were found that are apart.
    pub(super) fn suspect(&mut self, one: &Move, two: &Move, control: &Control) {
        let (Some(a), Some(b)) = (self.handing(one), self.handing(two)) else { return };
        let pairs = [a.min(b), a.max(b)];
        let count = self.suspicions.entry(pairs).or_default();
        *count += 1;
        if *count == LEARNT_AFTER {
            let edges = self.edges_where(|from, to| {
                let arms = self.map.arm(from).zip(self.map.arm(to));
                arms.is_some_and(|arms| pairs.contains(&arms))
            });
            self.learn_clash(edges.into_iter().map(Clashing::from).collect(), control);
        }
    }

    /// The arms between which something changes hands.
    fn handing(&self, action: &Move) -> Option<(ArmId, ArmId)> {
        Some((self.map.arm(action.from)?, self.map.arm(action.to)?))
    }

    /// The edges between nodes that fit.
    fn edges_where(&self, fit: impl Fn(NodeId, NodeId) -> bool) -> Vec<(NodeId, NodeId)> {
        let edges = self.network.instance().edges.iter().map(|edge| (edge.from, edge.to));
        let mut found: Vec<(NodeId, NodeId)> = edges.filter(|&(from, to)| fit(from, to)).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    fn learn_clash(&mut self, actions: Vec<Clashing>, control: &Control) {
        let mut instance = self.network.instance().clone();
        instance.clashes.push(Clash { actions });
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
