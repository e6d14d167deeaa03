//! `select_mode`, and what the guidance says to the tau that it selects.

use std::collections::BTreeSet;

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::guidance::{Advice, CutKind, Cuts, Guide, Memo, Move, check};
use crate::motion::StepFailure;
use crate::problem::{GuidanceKind, Objective};
use crate::run::Control;
use crate::workcell::ArmId;

use super::chain::Misfit;
use super::forecast::Neighbour;
use super::ground::GroundingFailure;
use super::outline::{Obstruction, Outline};
use super::smart::Search;
use super::tree::Vertex;

/// Times that a guide is asked for again before it is followed in spite of what is known to be in
/// its way.
const REVISIONS: usize = 6;

/// The same where there are many objects.
const FEW_REVISIONS: usize = 2;

/// Vertices whose guides are asked for again in one selection.
const MOST_ASKED: usize = 4;

/// Objects up to which a new plan for all that follows is asked for freely.
const MOST_REPLANNED: usize = 16;

/// Expansions before the first plan that may fail, or do a step in part only, before the search goes about it as with
/// many objects.
const SETBACKS_BORNE: u32 = 8;

/// Steps that a plan may take rather than do what another object blocks, or rather than rely on
/// grasps that were not found to fit together.
const BLOCKED_PENALTY: u32 = 6;
const MISFIT_PENALTY: u32 = 2;

impl Search<'_> {
    /// `select_mode`: mostly the tau from which the fewest steps lead to the goals in all, sometimes
    /// any.
    pub(super) fn select_mode(&mut self, control: &Control) -> Option<usize> {
        if self.tree[0].is_goal {
            return Some(0);
        }
        let settings = &self.settings;
        let bias = if self.is_crowded() { settings.crowded_bias } else { settings.goal_bias };
        let biased = self.rng.random_bool(bias);
        let best = self.best;
        let open = |vertex: &Vertex| !vertex.is_goal && !self.is_beaten(vertex);
        let candidates: Vec<usize> = (0..self.tree.len()).filter(|&i| open(&self.tree[i])).collect();
        if !biased {
            return candidates.choose(&mut self.rng).copied().or(Some(0));
        }
        // After an incumbent only what is new is driven on, or may do with fewer steps; else the way
        // of the incumbent is branched from.
        let short = self.wants_fewer_steps() && self.rng.random_bool(0.5);
        let most = self.best_way.len().saturating_sub(1);
        let is_driven = |i: usize, vertex: &Vertex| {
            let unspoilt =
                vertex.expansions == 0 || vertex.failures == vertex.expansions && vertex.failures < 3;
            match (best.is_some(), short) {
                (false, _) => vertex.failures < self.settings.surrender,
                (true, true) => vertex.fewest.is_none_or(|left| vertex.depth + left < most),
                (true, false) => unspoilt && i != 0,
            }
        };
        let mut driven: Vec<usize> =
            candidates.iter().copied().filter(|&i| is_driven(i, &self.tree[i])).collect();
        // Guides asked under other cuts are asked again before they decide, but not too many at once.
        let mut asked = 0;
        while let Some(position) = (0..driven.len()).min_by(|&a, &b| {
            let (a, b) = (driven[a], driven[b]);
            self.prospect(a).total_cmp(&self.prospect(b)).then(a.cmp(&b))
        }) {
            let chosen = driven[position];
            let promises =
                |vertex: &Vertex| vertex.remaining().is_some_and(|left| vertex.depth + left < most);
            if short && self.tree[chosen].guided_at == self.version && !promises(&self.tree[chosen]) {
                driven.swap_remove(position);
                continue;
            }
            if self.tree[chosen].guided_at == self.version || asked == MOST_ASKED || control.should_stop() {
                return Some(chosen);
            }
            let before = self.prospect(chosen);
            self.guide(chosen, control);
            asked += 1;
            if self.prospect(chosen) <= before && (!short || promises(&self.tree[chosen])) {
                return Some(chosen);
            }
        }
        let on_way: Vec<usize> = self.best_way.iter().copied().filter(|&i| candidates.contains(&i)).collect();
        on_way.choose(&mut self.rng).or_else(|| candidates.choose(&mut self.rng)).copied().or(Some(0))
    }

    /// Whether no plan by way of `vertex` can be better than the incumbent.
    pub(super) fn is_beaten(&self, vertex: &Vertex) -> bool {
        let objective = self.problem.options.objective;
        let mut least = cost_so_far(vertex, objective);
        if matches!(objective, Objective::Steps) && !vertex.is_goal {
            least[0] += 1.0;
        }
        let second = if matches!(objective, Objective::Steps) { 1 } else { 0 };
        self.best.is_some_and(|best| least[..=second] >= best[..=second])
    }

    /// Whether the incumbent has more steps than the mode graph asks for.
    pub fn wants_fewer_steps(&self) -> bool {
        self.best.is_some() && self.best_way.len() > self.least_steps + 1
    }

    /// What a tau promises: steps in all, those to come weighed more, and what speaks against it. A first
    /// plan for many objects, or one that is struggled for, is sought with little regard to the steps behind.
    fn prospect(&self, tau: usize) -> f64 {
        let vertex = &self.tree[tau];
        let remaining = vertex.remaining().map_or(1e6, |steps| steps as f64) + vertex.penalty;
        let behind = if self.is_crowded() { 0.2 } else { 1.0 };
        behind * vertex.depth as f64
            + 1.3 * remaining
            + 0.7 * f64::from(vertex.failures)
            + 0.2 * f64::from(vertex.expansions)
            + 1e-3 * vertex.elapsed
    }

    /// Asks for the guidance of a tau under the cuts in force.
    pub(super) fn guide(&mut self, tau: usize, control: &Control) {
        let mode = self.tree[tau].mode.clone();
        self.tree[tau].guided_at = self.version;
        tracing::debug!(tau, cuts = self.cuts.active().len(), "asking the guidance");
        match self.guidance.guide(&self.network, &mode, &self.cuts, &mut self.memo, control) {
            Ok(Advice::Go(guide)) => self.follow(tau, guide),
            Ok(Advice::Infeasible(reason)) => {
                self.cause = Some(format!("on the mode graph there is no way to the goals: {reason:?}"));
            }
            Ok(Advice::Unknown { lower_bound }) => {
                self.cause = Some(format!(
                    "the guidance found no sequence of actions on the mode graph (at least {lower_bound} steps)"
                ));
            }
            Err(error) => self.cause = Some(format!("the mode graph makes no sense: {error}")),
        }
    }

    /// Takes `guide` for that of a tau under the cuts in force.
    pub(super) fn follow(&mut self, tau: usize, guide: Guide) {
        let vertex = &mut self.tree[tau];
        vertex.guided_at = self.version;
        vertex.penalty = self.cuts.penalty(&vertex.mode, &guide.solution.steps) as f64;
        vertex.fewest = guide.remaining_steps.map(|left| left.min(vertex.fewest.unwrap_or(left)));
        vertex.guide = Some(guide);
    }

    /// The guide to follow now, with the chains of its legs: that of the tau, or now and then another.
    /// What is found to be in its way is learnt, and the guidance asked again. `None` when there is
    /// none, or when another tau has become more promising; with many objects that would hold for one tau after
    /// the other, until all have been asked again.
    pub(super) fn advise(&mut self, tau: usize, control: &Control) -> Option<(Guide, Outline)> {
        if self.tree[tau].guide.is_none() || self.tree[tau].guided_at != self.version {
            self.guide(tau, control);
        }
        let guide = self.guidance_for(tau, control)?;
        self.unobstructed(tau, guide, control)
    }

    /// [`Self::advise`] along `guide`.
    pub(super) fn unobstructed(
        &mut self,
        tau: usize,
        mut guide: Guide,
        control: &Control,
    ) -> Option<(Guide, Outline)> {
        let learns = !matches!(self.problem.options.guidance, GuidanceKind::Greedy);
        let before = self.prospect(tau);
        for round in 0.. {
            let outline = self.grounder.outline(&self.tree[tau], &guide);
            let hopeful = learns && !control.should_stop();
            if outline.obstructions.is_empty() || !hopeful {
                return Some((guide, outline));
            }
            for Obstruction { leg, why } in &outline.obstructions {
                tracing::debug!(tau, round, object = leg.object, ?why, "something is in the way");
            }
            self.learn(&outline.obstructions);
            if round == if self.asks_freely() { REVISIONS } else { FEW_REVISIONS } {
                return Some((guide, outline));
            }
            self.guide(tau, control);
            let now = self.prospect(tau);
            let others = (0..self.tree.len()).filter(|&i| i != tau && !self.tree[i].is_goal);
            let gives_way = self.best.is_none() && self.asks_freely();
            if now > before && gives_way && others.into_iter().any(|i| self.prospect(i) < now) {
                return None;
            }
            guide = self.tree[tau].guide.clone()?;
        }
        None
    }

    /// Turns what is in the way into cuts.
    fn learn(&mut self, obstructions: &[Obstruction]) {
        for Obstruction { leg, why } in obstructions {
            let (pick, place) = (leg.pick(), leg.place());
            match why {
                Misfit::Pick => self.cut_all(pick.as_slice(), MISFIT_PENALTY),
                Misfit::Place => self.cut_all(place.as_slice(), MISFIT_PENALTY),
                Misfit::Between => {
                    let meetings: Vec<Move> = leg
                        .moves
                        .iter()
                        .map(|(_, action)| *action)
                        .filter(|action| self.map.is_handoff(action))
                        .collect();
                    let blamed = if meetings.is_empty() { place.as_slice() } else { &meetings };
                    self.cut_all(blamed, MISFIT_PENALTY);
                }
                Misfit::Blocked { pick: at_pick, place: at_place } => {
                    if let Some(pick) = pick {
                        self.blocked(pick, at_pick);
                    }
                    if let Some(place) = place {
                        self.blocked(place, at_place);
                    }
                }
            }
            if let Some(action) = pick.or(place) {
                self.cause = Some(self.explain(action, "no grasps were found that fit together"));
            }
        }
    }

    fn cut_all(&mut self, actions: &[Move], penalty: u32) {
        for action in actions {
            self.cuts.add(CutKind::Action(*action), penalty, self.settings.cut_lifetime);
            self.version += 1;
        }
    }

    fn blocked(&mut self, action: Move, by: &[Neighbour]) {
        for neighbour in by {
            let kind = CutKind::Blocked { action, by: neighbour.object.0, at: neighbour.node };
            let settings = &self.settings;
            // Elsewhere in the same region it need not be in the way; and once there is a plan there is
            // time to try again.
            let (penalty, lifetime) = match (self.map.is_region(neighbour.node), self.best.is_some()) {
                (true, _) => (MISFIT_PENALTY, settings.cut_lifetime),
                (false, true) => (BLOCKED_PENALTY, settings.cut_lifetime),
                (false, false) => (BLOCKED_PENALTY, settings.block_lifetime),
            };
            self.cuts.add(kind, penalty, lifetime);
            self.version += 1;
        }
    }

    /// The guidance to follow now: that of the tau, or now and then another.
    fn guidance_for(&mut self, tau: usize, control: &Control) -> Option<Guide> {
        let guide = self.tree[tau].guide.clone()?;
        if !matches!(self.problem.options.guidance, GuidanceKind::Smart) {
            return Some(guide);
        }
        let chance = match (self.best.is_some(), self.tree[tau].failures) {
            (true, _) => self.settings.wander,
            (false, 0) => 0.0,
            (false, _) => self.settings.stuck_wander,
        };
        if !self.rng.random_bool(chance) {
            return Some(guide);
        }
        // A whole new plan for what follows is dear where there are many objects.
        let other = if self.rng.random_bool(if self.asks_freely() { 0.7 } else { 0.05 }) {
            self.another_first_action(tau, &guide, control)
        } else {
            self.under_a_cut(tau, &guide, control)
        };
        other.or(Some(guide))
    }

    /// Whether a new plan for all objects is asked for freely: there are few, and the search does not struggle.
    pub(super) fn asks_freely(&self) -> bool {
        self.problem.objects.len() <= MOST_REPLANNED && !self.struggles()
    }

    /// Whether the guidance for all objects at once met [`SETBACKS_BORNE`] before there is a plan: from then on as
    /// much as can be is done of each step, rather than the guidance asked again, and idle arms are given nowhere to go.
    pub(super) fn struggles(&self) -> bool {
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        is_smart && self.best.is_none() && self.setbacks >= SETBACKS_BORNE
    }

    /// Whether a first plan is sought with many objects, or struggled for: not all that the guide says can be asked to
    /// succeed.
    pub(super) fn is_crowded(&self) -> bool {
        self.best.is_none() && !self.asks_freely()
    }

    /// A guide that begins with another action than the tau's own, and is mostly hardly longer.
    pub(super) fn another_first_action(
        &mut self,
        tau: usize,
        guide: &Guide,
        control: &Control,
    ) -> Option<Guide> {
        let network = self.network.clone();
        let network = network.as_ref();
        let instance = network.instance();
        let mode = self.tree[tau].mode.clone();
        let mut actions = Vec::new();
        for (object, &from) in mode.iter().enumerate() {
            let class = instance.objects.get(object)?.class;
            let edges = instance.edges.iter().filter(|edge| edge.from == from);
            let fitting = edges.filter(|edge| edge.class.is_none_or(|only| only == class));
            actions.extend(fitting.map(|edge| Move { object, from, to: edge.to }));
        }
        actions.retain(|action| !guide.immediate.contains(action));
        let action = *actions.choose(&mut self.rng)?;
        let mut next = mode.clone();
        next[action.object] = action.to;
        let rest = match self.guidance.guide(network, &next, &Cuts::none(), &mut self.detours, control) {
            Ok(Advice::Go(rest)) => rest.solution,
            _ => return None,
        };
        let excess = (rest.steps.len() + 1).saturating_sub(guide.remaining_steps?);
        // The longer it is, the rarer it is followed, but every one keeps a chance.
        if !self.rng.random_bool(0.5_f64.powi(excess.min(1000) as i32)) {
            return None;
        }
        let mut steps = vec![vec![action]];
        steps.extend(rest.steps);
        let solution = network.solution(mode, steps);
        check(instance, &solution).ok()?;
        Some(Guide::along(network, solution, None))
    }

    /// A guide under a passing cut on one of the tau's coming actions.
    fn under_a_cut(&mut self, tau: usize, guide: &Guide, control: &Control) -> Option<Guide> {
        let actions: Vec<Move> = guide.solution.steps.iter().flatten().copied().collect();
        let mut cuts = self.cuts.clone();
        cuts.add(CutKind::Action(*actions.choose(&mut self.rng)?), 2, 1);
        let mut memo = Memo::new();
        memo.suggest(&guide.solution);
        match self.guidance.guide(&self.network, &self.tree[tau].mode, &cuts, &mut memo, control) {
            Ok(Advice::Go(other)) => Some(other),
            _ => None,
        }
    }

    /// Counts a failed expansion against the tau and against what led there.
    pub(super) fn note_failure(&mut self, tau: usize) {
        self.tree[tau].failures += 1;
        // Every second failure puts the step that led here in doubt, every fourth the one before.
        let mut doubtful = tau;
        while self.tree[doubtful].failures.is_multiple_of(2)
            && let Some(parent) = self.tree[doubtful].parent
        {
            self.tree[parent].failures += 1;
            doubtful = parent;
        }
    }

    /// Makes the actions dear for a while that no motion was found for: those of two arms that
    /// could not be kept apart in one step, or that of an arm that found no way.
    pub(super) fn note_motion_failures(&mut self, guide: &Guide, failures: &[StepFailure]) {
        if !matches!(self.problem.options.guidance, GuidanceKind::Smart) {
            return;
        }
        let action_of = |arm: ArmId| {
            let takes_part =
                |action: &&Move| [action.from, action.to].iter().any(|&node| self.map.arm(node) == Some(arm));
            guide.immediate.iter().find(takes_part).copied()
        };
        let mut blamed: BTreeSet<CutKind> = BTreeSet::new();
        for failure in failures {
            match *failure {
                StepFailure::Stuck(arm) => blamed.extend(action_of(arm).map(CutKind::Action)),
                StepFailure::Conflict(a, b) => match (action_of(a), action_of(b)) {
                    (Some(a), Some(b)) if a != b => {
                        blamed.insert(CutKind::Pair(a.min(b), a.max(b)));
                    }
                    (one, other) => blamed.extend(one.or(other).map(CutKind::Action)),
                },
                StepFailure::Stopped => {}
            }
        }
        // Fewer steps than the incumbent's are tried again and again, with other contacts and motions.
        let settings = &self.settings;
        let lifetime = if self.wants_fewer_steps() { settings.brief_lifetime } else { settings.cut_lifetime };
        for kind in blamed {
            self.cuts.add(kind, 1, lifetime);
            self.version += 1;
        }
    }

    /// Learns from a step that could not be grounded.
    pub(super) fn note_grounding_failure(&mut self, failure: &GroundingFailure, control: &Control) {
        let (action, what) = match failure {
            GroundingFailure::NoChain(action) => (action, "no grasps were found that fit together"),
            GroundingFailure::NoContact(action, by) => {
                if !matches!(self.problem.options.guidance, GuidanceKind::Greedy) {
                    self.blocked(*action, by);
                }
                (action, "no contact was found")
            }
            GroundingFailure::Clash(one, two) => {
                if matches!(self.problem.options.guidance, GuidanceKind::Smart) {
                    self.cuts.add(CutKind::Pair(*one, *two), 1, self.settings.cut_lifetime);
                    self.version += 1;
                    self.suspect(one, two, control);
                }
                (two, "no meeting apart from that of another handoff was found")
            }
        };
        self.cause = Some(self.explain(*action, what));
    }

    fn explain(&self, action: Move, what: &str) -> String {
        let object = self.problem.objects.get(action.object).map_or("", |o| o.id.as_str());
        let name = |node| self.map.name(node, self.problem);
        format!("{what} to move {object:?} from {} to {}", name(action.from), name(action.to))
    }
}

/// What the way to `vertex` costs already, a lower bound on the whole; what comes first counts first.
pub(super) fn cost_so_far(vertex: &Vertex, objective: Objective) -> [f64; 2] {
    match objective {
        Objective::Duration => [vertex.elapsed, 0.0],
        Objective::ArcLength => [vertex.arc.iter().copied().fold(0.0, f64::max), 0.0],
        Objective::Steps => [vertex.depth as f64, vertex.elapsed],
    }
}
