//! Algorithm 1.

use std::collections::BTreeMap;
use std::sync::Arc;

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{CollisionWorld, Exemption};
use crate::guidance::{
    Advice, Certificate, CutKind, Cuts, Effort, Greedy, Guidance, Guide, Memo, Move, Sequential, Smart,
    Solution, check,
};
use crate::motion::{ArmGoal, ArmTask, StepMotion, StepPlanner, StepTask};
use crate::problem::{GuidanceKind, InitialPlacement, Objective, Problem};
use crate::run::{Control, Rng, Seed};
use crate::transition::Contacts;
use crate::workcell::ArmId;

use super::candidate::Candidate;
use super::ground::{Grounder, GroundingFailure, held_by, scene};
use super::map::Map;
use super::settings::Settings;
use super::tree::{ArmState, Step, Vertex, Whereabouts};

/// What one iteration brought.
#[derive(Debug)]
pub enum Report {
    /// A complete plan that is better than the incumbent, to be judged.
    Candidate(Candidate),
    /// Nothing that the caller must act on.
    Nothing,
    /// Every goal is met at the start: the plan, to be judged, is to stand still, and no search can
    /// better it.
    Solved(Candidate),
}

/// The anytime tree search.
#[derive(Debug)]
pub struct Search<'a> {
    problem: &'a Problem,
    map: &'a Map,
    settings: Settings,
    planner: StepPlanner<'a>,
    grounder: Grounder<'a>,
    guidance: Box<dyn Guidance>,
    memo: Memo,
    /// Answers without cuts, for states beside the way.
    detours: Memo,
    cuts: Cuts,
    tree: Vec<Vertex>,
    /// Cost of the best plan that the caller accepted.
    best: Option<[f64; 2]>,
    /// Vertices from the root to the goal of the best plan found here.
    best_way: Vec<usize>,
    rng: Rng,
    iterations: u64,
    certificate: Option<Certificate>,
    cause: Option<String>,
}

impl<'a> Search<'a> {
    /// A search whose tree holds the start only; `contacts` may know some transitions already.
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        map: &'a Map,
        contacts: Contacts<'a>,
        settings: Settings,
        seed: Seed,
        control: &Control,
    ) -> Self {
        let guidance: Box<dyn Guidance> = match problem.options.guidance {
            GuidanceKind::Smart => Box::new(Smart { effort: Effort::quick(), seed }),
            GuidanceKind::Sequential => Box::new(Sequential),
            GuidanceKind::Greedy => Box::new(Greedy),
        };
        let root = root(problem, map);
        let mut search = Self {
            problem,
            map,
            planner: StepPlanner::new(problem, world, seed, control),
            grounder: Grounder::new(problem, world, map, contacts, &settings, seed),
            settings,
            guidance,
            memo: Memo::new(),
            detours: Memo::new(),
            cuts: Cuts::none(),
            tree: vec![root],
            best: None,
            best_way: Vec::new(),
            rng: seed.stream("search"),
            iterations: 0,
            certificate: None,
            cause: None,
        };
        search.guide(0, control);
        search.certificate = search.tree[0].guide.as_ref().and_then(|guide| guide.certificate);
        search
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u64 {
        self.iterations
    }

    /// What is proved about the number of steps on the mode graph.
    pub fn certificate(&self) -> Option<&Certificate> {
        self.certificate.as_ref()
    }

    /// The likely cause when nothing has been found.
    pub fn cause(&self) -> Option<&str> {
        self.cause.as_deref()
    }

    /// Tells the search the cost of the best accepted plan, found here or by another thread.
    pub fn set_incumbent(&mut self, cost: [f64; 2]) {
        if self.best.is_none_or(|best| cost < best) {
            self.best = Some(cost);
        }
    }

    /// One loop of Algorithm 1.
    pub fn iterate(&mut self, control: &Control) -> Report {
        self.iterations += 1;
        self.cuts.advance();
        if self.iterations.is_multiple_of(self.settings.growth_period) {
            self.planner.grow(self.settings.growth, control);
        }
        if self.tree.len() > self.settings.greatest_tree {
            self.prune();
        }
        let Some(tau) = self.select_mode() else {
            return Report::Nothing;
        };
        if self.tree[tau].is_goal {
            // Only the root can be selected as a goal: nothing has to be done.
            return self.finish(tau, control);
        }
        let Some(guide) = self.guidance_for(tau, control) else {
            self.tree[tau].failures += 1;
            return Report::Nothing;
        };
        self.tree[tau].expansions += 1;
        match self.extend(tau, &guide, control) {
            Some(new) => {
                if self.tree[new].is_goal {
                    return self.finish(new, control);
                }
                Report::Nothing
            }
            None => {
                if !control.should_stop() {
                    self.note_failure(tau, &guide);
                }
                Report::Nothing
            }
        }
    }

    /// `select_mode`: mostly the tau that has made the most progress, sometimes any.
    fn select_mode(&mut self) -> Option<usize> {
        if self.tree[0].is_goal {
            return Some(0);
        }
        let open = |vertex: &Vertex, best: Option<[f64; 2]>, objective: Objective| {
            !vertex.is_goal && best.is_none_or(|best| cost_so_far(vertex, objective) < best[0])
        };
        let (best, objective) = (self.best, self.problem.options.objective);
        let biased = self.rng.random_bool(self.settings.goal_bias);
        let candidates: Vec<usize> =
            (0..self.tree.len()).filter(|&i| open(&self.tree[i], best, objective)).collect();
        if !biased {
            return candidates.choose(&mut self.rng).copied().or(Some(0));
        }
        // After an incumbent only what is new is driven on; else the way of the incumbent is
        // branched from.
        let fresh: Vec<usize> = candidates
            .iter()
            .copied()
            .filter(|&i| {
                let vertex = &self.tree[i];
                if self.best.is_some() {
                    vertex.expansions == 0 || vertex.failures == vertex.expansions && vertex.failures < 3
                } else {
                    vertex.failures < self.settings.surrender
                }
            })
            .collect();
        let progress = |i: usize| {
            let vertex = &self.tree[i];
            let remaining = vertex.remaining().map_or(1e6, |r| r as f64);
            remaining
                + 0.7 * f64::from(vertex.failures)
                + 0.2 * f64::from(vertex.expansions)
                + 1e-3 * vertex.elapsed
        };
        let driven = fresh
            .into_iter()
            .filter(|&i| i != 0 || self.best.is_none())
            .min_by(|&a, &b| progress(a).total_cmp(&progress(b)).then(a.cmp(&b)));
        if driven.is_some() {
            return driven;
        }
        let on_way: Vec<usize> = self.best_way.iter().copied().filter(|&i| candidates.contains(&i)).collect();
        on_way.choose(&mut self.rng).or_else(|| candidates.choose(&mut self.rng)).copied().or(Some(0))
    }

    /// The guidance of a tau, asked once.
    fn guide(&mut self, tau: usize, control: &Control) {
        let mode = self.tree[tau].mode.clone();
        let network = self.map.network();
        match self.guidance.guide(network, &mode, &self.cuts, &mut self.memo, control) {
            Ok(Advice::Go(guide)) => self.tree[tau].guide = Some(guide),
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

    /// The guidance to follow now: that of the tau, or now and then one under a passing cut.
    fn guidance_for(&mut self, tau: usize, control: &Control) -> Option<Guide> {
        let stuck = self.tree[tau].failures >= self.settings.patience;
        if self.tree[tau].guide.is_none() || (stuck && !self.cuts.is_empty()) {
            self.guide(tau, control);
        }
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
        let other = if self.rng.random_bool(0.7) {
            self.another_first_action(tau, &guide, control)
        } else {
            self.under_a_cut(tau, &guide, control)
        };
        other.or(Some(guide))
    }

    /// A guide that begins with another action than the tau's own, and is hardly longer.
    fn another_first_action(&mut self, tau: usize, guide: &Guide, control: &Control) -> Option<Guide> {
        let network = self.map.network();
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
        if excess > 2 || (excess > 0 && self.rng.random_bool(0.5)) {
            return None;
        }
        let mut steps = vec![vec![action]];
        steps.extend(rest.steps);
        let solution = Solution { start: mode, steps, weight: rest.weight };
        check(instance, &solution).ok()?;
        Some(Guide::along(network, solution, None))
    }

    /// A guide under a passing cut on one of the tau's coming actions.
    fn under_a_cut(&mut self, tau: usize, guide: &Guide, control: &Control) -> Option<Guide> {
        let actions: Vec<Move> = guide.solution.steps.iter().flatten().copied().collect();
        let mut cuts = self.cuts.clone();
        cuts.add(CutKind::Action(*actions.choose(&mut self.rng)?), 2, 1);
        let mut memo = Memo::new();
        match self.guidance.guide(self.map.network(), &self.tree[tau].mode, &cuts, &mut memo, control) {
            Ok(Advice::Go(other)) => Some(other),
            _ => None,
        }
    }

    /// `sample_trans`, `select`, `extend` and `modal_check`: grounds the guide's next actions and
    /// moves all arms there; the new vertex with a tau of its own.
    fn extend(&mut self, tau: usize, guide: &Guide, control: &Control) -> Option<usize> {
        let thorough = self.tree[tau].failures > 0;
        let mut moved = None;
        let mut barren = 0;
        for attempt in 0..self.settings.groundings {
            if control.should_stop() {
                return None;
            }
            let anew = attempt > 0 || self.tree[tau].expansions > 1;
            let grounding = match self.grounder.ground(&self.tree[tau], guide, anew) {
                Ok(grounding) => grounding,
                Err(failure) => {
                    self.explain(&failure);
                    // Sampling chains is dear; what stands in the way is more likely elsewhere.
                    barren += 1;
                    if barren > 1 {
                        return None;
                    }
                    continue;
                }
            };
            let last = attempt + 1 == self.settings.groundings;
            if let Some(motion) = self.planner.plan(&grounding.task, thorough && last, control) {
                moved = Some((grounding, motion));
                break;
            }
            self.cause = Some("no motion was found for the arms that does not collide".to_owned());
        }
        let (grounding, motion) = moved?;
        let from = &self.tree[tau];
        let mut mode = from.mode.clone();
        for action in &guide.immediate {
            mode[action.object] = grounding.landed.get(&action.object).copied().unwrap_or(action.to);
        }
        let mut arms: Vec<ArmState> = motion
            .arms
            .iter()
            .map(|arm| ArmState {
                q: arm.curve.last().q.clone(),
                departure: None,
                wait_for: None,
                dwell: 0.0,
            })
            .collect();
        let dwell = |arm: ArmId| self.problem.workcell.arms[arm.0].tool.grasp_time;
        for (arm, departure) in grounding.departures {
            arms[arm].departure = Some(departure);
            arms[arm].dwell = dwell(ArmId(arm));
        }
        for (receiver, giver) in grounding.waits {
            let both = dwell(giver).max(dwell(ArmId(receiver)));
            arms[receiver].wait_for = Some(giver);
            arms[receiver].dwell = both;
            arms[giver.0].dwell = both;
        }
        let arc = from.arc.iter().zip(&motion.arms).map(|(sum, arm)| sum + arm.curve.arc_length()).collect();
        let is_goal = self.map.network().instance().is_solved(&mode);
        let vertex = Vertex {
            parent: Some(tau),
            elapsed: from.elapsed + motion.duration,
            arc,
            depth: from.depth + 1,
            mode,
            objects: grounding.objects,
            arms,
            guide: None,
            chains: grounding.chains,
            expansions: 0,
            failures: 0,
            is_goal,
            step: Some(Arc::new(Step { actions: grounding.actions, motion })),
        };
        let objective = self.problem.options.objective;
        if self.best.is_some_and(|best| cost_so_far(&vertex, objective) >= best[0]) {
            return None;
        }
        self.tree.push(vertex);
        let new = self.tree.len() - 1;
        if !is_goal {
            self.guide(new, control);
            self.hold_back(new);
        }
        Some(new)
    }

    /// Does not drive on what is already behind the incumbent at the same number of steps to go;
    /// the unbiased selection may still pick it.
    fn hold_back(&mut self, new: usize) {
        let Some(best) = self.best else { return };
        if !matches!(self.problem.options.objective, Objective::Duration) {
            return;
        }
        let Some(remaining) = self.tree[new].remaining() else { return };
        let reference = self.best_way.iter().rev().nth(remaining).map(|&i| self.tree[i].elapsed);
        if let Some(reference) = reference {
            let rest = best[0] - reference;
            if self.tree[new].elapsed + 0.95 * rest > best[0] {
                self.tree[new].expansions += 1;
            }
        }
    }

    fn note_failure(&mut self, tau: usize, guide: &Guide) {
        self.tree[tau].failures += 1;
        let failures = self.tree[tau].failures;
        // Every second failure puts the step that led here in doubt, every fourth the one before.
        let mut doubtful = tau;
        while self.tree[doubtful].failures.is_multiple_of(2)
            && let Some(parent) = self.tree[doubtful].parent
        {
            self.tree[parent].failures += 1;
            doubtful = parent;
        }
        if failures.is_multiple_of(self.settings.patience)
            && matches!(self.problem.options.guidance, GuidanceKind::Smart)
            && let Some(action) = guide.immediate.choose(&mut self.rng)
        {
            self.cuts.add(CutKind::Action(*action), 2, self.settings.cut_lifetime);
        }
    }

    fn explain(&mut self, failure: &GroundingFailure) {
        let (action, what) = match failure {
            GroundingFailure::NoChain(action) => (action, "no grasps were found that fit together"),
            GroundingFailure::NoContact(action) => (action, "no contact was found"),
        };
        let object = self.problem.objects.get(action.object).map_or("", |o| o.id.as_str());
        let name = |node| self.map.name(node, self.problem);
        self.cause =
            Some(format!("{what} to move {object:?} from {} to {}", name(action.from), name(action.to)));
    }

    /// `retrace`: the plan that ends at `goal`, with the arms leaving their last contacts.
    fn finish(&mut self, goal: usize, control: &Control) -> Report {
        let tail = match self.tail(goal, control) {
            Some(tail) => tail,
            None => {
                if let Some(parent) = self.tree[goal].parent {
                    self.tree[parent].failures += 1;
                    self.cause = Some("the arms cannot leave after the last action".to_owned());
                }
                return Report::Nothing;
            }
        };
        let mut way = vec![goal];
        while let Some(parent) = self.tree[way[way.len() - 1]].parent {
            way.push(parent);
        }
        way.reverse();
        let steps: Vec<Arc<Step>> = way.iter().filter_map(|&i| self.tree[i].step.clone()).collect();
        let mut parts: Vec<(&StepMotion, &[_])> =
            steps.iter().map(|step| (&step.motion, step.actions.as_slice())).collect();
        if let Some(tail) = &tail {
            parts.push((tail, &[]));
        }
        if parts.is_empty() {
            return Report::Solved(Candidate::standing(&self.problem.initial_joints));
        }
        let Some(candidate) = Candidate::join(&parts) else { return Report::Nothing };
        let cost = candidate.cost(self.problem.options.objective);
        if self.best.is_some_and(|best| cost >= best) {
            return Report::Nothing;
        }
        self.best_way = way;
        Report::Candidate(candidate)
    }

    /// The motion after the last action: arms leave on their lines, and go home where that is
    /// asked for. `Some(None)` when there is nothing to move.
    #[allow(clippy::option_option)]
    fn tail(&mut self, goal: usize, control: &Control) -> Option<Option<StepMotion>> {
        let vertex = &self.tree[goal];
        let home = self.problem.options.return_home;
        let arms: Vec<ArmTask> = vertex
            .arms
            .iter()
            .enumerate()
            .map(|(index, arm)| ArmTask {
                start: arm.q.clone(),
                held: held_by(vertex, ArmId(index)),
                departure: arm.departure.clone(),
                wait_for: arm.wait_for,
                dwell: arm.dwell,
                goal: if home {
                    ArmGoal::Contact {
                        q: self.problem.workcell.arms[index].home.clone(),
                        approach: None,
                        exemption: Exemption::default(),
                        after: None,
                    }
                } else {
                    ArmGoal::Anywhere
                },
            })
            .collect();
        let still = arms.iter().enumerate().all(|(index, arm)| {
            arm.departure.is_none() && (!home || arm.start == self.problem.workcell.arms[index].home)
        });
        if still {
            return Some(None);
        }
        let task = StepTask { arms, scene: scene(vertex) };
        self.planner.plan(&task, true, control).map(Some)
    }

    /// Drops all vertices but the root's and the incumbent's.
    fn prune(&mut self) {
        let mut keep: Vec<usize> = self.best_way.clone();
        if keep.first() != Some(&0) {
            keep.insert(0, 0);
        }
        let renumbered: BTreeMap<usize, usize> =
            keep.iter().enumerate().map(|(new, &old)| (old, new)).collect();
        let mut kept = Vec::with_capacity(keep.len());
        for (index, mut vertex) in std::mem::take(&mut self.tree).into_iter().enumerate() {
            if renumbered.contains_key(&index) {
                vertex.parent = vertex.parent.and_then(|parent| renumbered.get(&parent).copied());
                vertex.failures = 0;
                kept.push(vertex);
            }
        }
        self.tree = kept;
        self.best_way = self.best_way.iter().filter_map(|old| renumbered.get(old).copied()).collect();
    }
}

/// What the way to `vertex` costs already, a lower bound on the whole.
fn cost_so_far(vertex: &Vertex, objective: Objective) -> f64 {
    match objective {
        Objective::Duration => vertex.elapsed,
        Objective::ArcLength => vertex.arc.iter().copied().fold(0.0, f64::max),
        Objective::Steps => vertex.depth as f64,
    }
}

/// The vertex of the start.
fn root(problem: &Problem, map: &Map) -> Vertex {
    let objects = problem
        .initial
        .iter()
        .map(|placement| match placement {
            InitialPlacement::Resting { pose, surface } => {
                Whereabouts::Resting { pose: *pose, surface: *surface }
            }
            InitialPlacement::Held { arm, object_in_tcp } => {
                Whereabouts::Held { arm: *arm, object_in_tcp: *object_in_tcp }
            }
        })
        .collect();
    let arms = problem
        .initial_joints
        .iter()
        .map(|q| ArmState { q: q.clone(), departure: None, wait_for: None, dwell: 0.0 })
        .collect();
    let mode = map.network().instance().start();
    let is_goal = map.network().instance().is_solved(&mode);
    Vertex {
        parent: None,
        step: None,
        mode,
        objects,
        arms,
        elapsed: 0.0,
        arc: vec![0.0; problem.workcell.arms.len()],
        depth: 0,
        guide: None,
        chains: BTreeMap::new(),
        expansions: 0,
        failures: 0,
        is_goal,
    }
}
