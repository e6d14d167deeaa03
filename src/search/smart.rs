//! Algorithm 1.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use rand::Rng as _;

use crate::collision::CollisionWorld;
use crate::guidance::{
    Answer, Certificate, Cuts, Effort, Greedy, Guidance, Guide, Memo, Network, Sequential, Smart, solve,
};
use crate::motion::{Roadmap, StepPlanner};
use crate::problem::{GuidanceKind, InitialPlacement, Objective, Problem};
use crate::run::{Control, Rng, Seed};
use crate::transition::Contacts;
use crate::workcell::ArmId;

use super::candidate::Candidate;
use super::clashes::Suspicions;
use super::ground::Grounder;
use super::map::Map;
use super::outline::Outline;
use super::settings::Settings;
use super::tree::{ArmState, Step, Vertex, Whereabouts};

/// The share of the time left that a thorough look into the least number of steps may take, as one over this, and what it
/// may take at least.
const THOROUGH_SHARE: u32 = 10;
const THOROUGH_LEAST: Duration = Duration::from_secs(2);

/// Objects up to which a first plan is not worth more than a brief effort of the guidance.
const FEW_OBJECTS: usize = 8;

/// Failures that count against a tau from which a step was done in part only.
const DONE_IN_PART: u32 = 2;

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
    pub(super) problem: &'a Problem,
    pub(super) map: &'a Map,
    pub(super) settings: Settings,
    pub(super) planner: StepPlanner<'a>,
    pub(super) grounder: Grounder<'a>,
    /// The map's network with what was learnt since.
    pub(super) network: Arc<Network>,
    pub(super) suspicions: Suspicions,
    pub(super) guidance: Box<dyn Guidance>,
    pub(super) memo: Memo,
    /// Answers without cuts, for states beside the way.
    pub(super) detours: Memo,
    pub(super) cuts: Cuts,
    /// Counts changes of the cuts in force.
    pub(super) version: u64,
    pub(super) tree: Vec<Vertex>,
    /// Cost of the best plan that the caller accepted.
    pub(super) best: Option<[f64; 2]>,
    /// Vertices from the root to the goal of the best plan found here.
    pub(super) best_way: Vec<usize>,
    /// The same of the candidate that was reported last.
    pub(super) offered: Vec<usize>,
    pub(super) rng: Rng,
    pub(super) seed: Seed,
    pub(super) iterations: u64,
    /// What is proved about the map's network.
    pub(super) certificate: Option<Certificate>,
    /// Fewer steps than these are not sought: the bound of `network`, which has the rules learnt, too.
    pub(super) least_steps: usize,
    pub(super) cause: Option<String>,
    /// Whether the number of steps was looked into thoroughly, since the network last gained a rule; and whether that
    /// of the map's own network was.
    pub(super) examined: bool,
    certified: bool,
    /// Expansions before the first plan that failed or did a step in part only.
    pub(super) setbacks: u32,
    /// The iteration that came to the first plan.
    first_at: u64,
    /// What to do from the start, where that was worked out already under the cuts of a version.
    pub(super) prepared: Option<(u64, Guide, Outline)>,
}

impl<'a> Search<'a> {
    /// A search whose tree holds the start only; `contacts` may know some transitions already,
    /// `roadmaps` has one for every arm.
    #[allow(clippy::too_many_arguments)]
    pub fn new(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        map: &'a Map,
        contacts: Contacts<'a>,
        roadmaps: Vec<Roadmap>,
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
            planner: StepPlanner::new(problem, world, roadmaps, seed),
            grounder: Grounder::new(problem, world, map, contacts, &settings, seed, control),
            settings,
            network: map.network().clone(),
            suspicions: Suspicions::new(),
            guidance,
            memo: Memo::new(),
            detours: Memo::new(),
            cuts: Cuts::none(),
            version: 0,
            tree: vec![root],
            best: None,
            best_way: Vec::new(),
            offered: Vec::new(),
            rng: seed.stream("search"),
            seed,
            iterations: 0,
            certificate: None,
            least_steps: 0,
            cause: None,
            examined: false,
            certified: false,
            setbacks: 0,
            first_at: 0,
            prepared: None,
        };
        search.set_hasty(matches!(problem.options.guidance, GuidanceKind::Smart));
        search.guide(0, control);
        search.certificate = search.tree[0].guide.as_ref().and_then(|guide| guide.certificate);
        search.certified = search.certificate.is_some_and(|known| known.optimum.is_some());
        search.least_steps = search.proved();
        search
    }

    /// A search like this one, with what it knows of contacts and roadmaps, that begins from the start on another map.
    pub fn anew_on(&self, map: &'a Map, control: &Control) -> Self {
        let (contacts, roadmaps) = (self.contacts().clone(), self.planner.roadmaps().to_vec());
        let (world, settings) = (self.planner.world(), self.settings.clone());
        Self::new(self.problem, world, map, contacts, roadmaps, settings, self.seed, control)
    }

    /// The mode graph with its network.
    pub fn map(&self) -> &'a Map {
        self.map
    }

    /// The contacts found so far, for another search.
    pub fn contacts(&self) -> &Contacts<'a> {
        &self.grounder.contacts
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u64 {
        self.iterations
    }

    /// [`StepPlanner::timing_s`] of the planner that plans its steps.
    pub fn timing_s(&self) -> f64 {
        self.planner.timing_s()
    }

    /// What is proved about the number of steps on the mode graph.
    pub fn certificate(&self) -> Option<&Certificate> {
        self.certificate.as_ref()
    }

    /// The likely cause when nothing has been found.
    pub fn cause(&self) -> Option<&str> {
        self.cause.as_deref()
    }

    /// Whether what is good enough for a first plan will do.
    fn set_hasty(&mut self, is_hasty: bool) {
        self.planner.set_hasty(is_hasty);
        self.grounder.is_hasty = is_hasty;
        self.grounder.contacts.prefer_facing(is_hasty);
        self.set_effort();
    }

    /// Tells the search the cost of the best accepted plan, found here or by another thread.
    pub fn set_incumbent(&mut self, cost: [f64; 2]) {
        if self.best.is_none() {
            self.first_at = self.iterations;
            self.set_hasty(false);
            // What stood in the way of the first plan may be tried again.
            self.cuts.clear();
            self.version += 1;
        }
        if self.best.is_none_or(|best| cost < best) {
            self.best = Some(cost);
        }
        self.set_pace();
    }

    /// What depends on whether the search struggles.
    pub(super) fn set_pace(&mut self) {
        let struggles = self.struggles();
        if struggles != self.grounder.stays_put {
            self.grounder.stays_put = struggles;
            self.set_effort();
        }
    }

    /// How hard the guidance tries, where it is for all objects at once.
    fn set_effort(&mut self) {
        if !matches!(self.problem.options.guidance, GuidanceKind::Smart) {
            return;
        }
        let effort = match (self.grounder.stays_put, self.grounder.is_hasty) {
            (true, _) => Effort::hasty(),
            (_, true) if self.problem.objects.len() <= FEW_OBJECTS => Effort::brief(),
            _ => Effort::quick(),
        };
        self.guidance = Box::new(Smart { effort, seed: self.seed });
    }

    /// Tells the search that the candidate which it reported last was accepted, at this cost.
    pub fn accept(&mut self, cost: [f64; 2]) {
        if !self.offered.is_empty() {
            self.best_way = std::mem::take(&mut self.offered);
        }
        self.set_incumbent(cost);
    }

    /// One loop of Algorithm 1.
    pub fn iterate(&mut self, control: &Control) -> Report {
        self.iterations += 1;
        self.offered.clear();
        let in_force = self.cuts.active().len();
        self.cuts.advance();
        self.version += u64::from(self.cuts.active().len() != in_force);
        if self.iterations.is_multiple_of(self.settings.growth_period) {
            self.planner.grow(self.settings.growth, control);
        }
        if self.tree.len() > self.settings.greatest_tree {
            self.prune();
        }
        if self.best.is_some() && !self.examined {
            self.examine(control);
        }
        let refines = self.best.is_some() && !self.seeks_fewer_steps();
        if refines && self.rng.random_bool(self.settings.refinement) {
            return match self.refine(control) {
                Some(end) => self.finish(end, control),
                None => Report::Nothing,
            };
        }
        let Some(tau) = self.select_mode(control) else {
            return Report::Nothing;
        };
        if self.tree[tau].is_goal {
            // Only the root can be selected as a goal: nothing has to be done.
            return self.finish(tau, control);
        }
        let prepared = self.prepared.take().filter(|(version, ..)| tau == 0 && *version == self.version);
        let prepared = prepared.map(|(_, guide, outline)| (guide, outline));
        let Some((guide, outline)) = prepared.or_else(|| self.advise(tau, control)) else {
            if self.tree[tau].guide.is_none() {
                self.tree[tau].failures += 1;
            }
            return Report::Nothing;
        };
        self.tree[tau].expansions += 1;
        let vertex = &self.tree[tau];
        tracing::debug!(
            iteration = self.iterations,
            tau,
            depth = vertex.depth,
            remaining = vertex.remaining(),
            penalty = vertex.penalty,
            cuts = self.cuts.active().len(),
            actions = guide.immediate.len(),
            "extending"
        );
        match self.extend(tau, &guide, outline, control) {
            Some(new) => {
                let is_goal = self.tree[new].is_goal;
                let end =
                    if self.best.is_some() { self.rewire(new, control) } else { is_goal.then_some(new) };
                end.map_or(Report::Nothing, |end| self.finish(end, control))
            }
            None => {
                if !control.should_stop() {
                    self.note_failure(tau);
                }
                Report::Nothing
            }
        }
    }

    /// Whether the first plan is still so young that one with fewer steps is sought before its windows are planned
    /// again: they would make it hard to beat in duration.
    fn seeks_fewer_steps(&self) -> bool {
        self.iterations < self.first_at + self.settings.fewer_steps_first && self.wants_fewer_steps()
    }

    /// Once there is a plan there is time to look into the least number of steps thoroughly, where
    /// that is not known yet: a shorter plan on the mode graph, or the proof that there is none. What is proved is
    /// about the map's own network; the rules learnt since say only what is not worth seeking.
    pub fn examine(&mut self, control: &Control) {
        self.examined = true;
        if !matches!(self.problem.options.guidance, GuidanceKind::Smart) {
            return;
        }
        let has_rules = !Arc::ptr_eq(&self.network, self.map.network());
        if !std::mem::replace(&mut self.certified, true)
            && let Some(answer) = self.solve_thoroughly(&self.map.network().clone(), control)
        {
            let known = answer.certificate().copied();
            if known.map_or(0, |known| known.lower_bound) >= self.proved() {
                self.certificate = known;
            }
            self.least_steps = self.least_steps.max(self.proved());
            if !has_rules {
                self.begin_with(&answer, control);
            }
        }
        let fewest = self.tree[0].fewest;
        if has_rules
            && fewest.is_none_or(|fewest| fewest > self.least_steps)
            && let Some(answer) = self.solve_thoroughly(&self.network.clone(), control)
        {
            let bound = answer.certificate().map_or(0, |certificate| certificate.lower_bound);
            self.least_steps = self.least_steps.max(bound);
            self.begin_with(&answer, control);
        }
    }

    /// The least number of steps that is proved on the map's network.
    fn proved(&self) -> usize {
        self.certificate.map_or(0, |certificate| certificate.lower_bound)
    }

    /// A thorough answer from the start. It is bounded by its effort; and, where the run need not repeat bit for bit, by
    /// a part of the time that is left, so that plans get shorter where the proof is out of reach.
    fn solve_thoroughly(&self, network: &Network, control: &Control) -> Option<Answer> {
        let start = &self.tree[0].mode;
        let (left, repeats) = (control.deadline.remaining(), self.problem.options.max_iterations.is_some());
        let control = match left {
            Some(left) if !repeats => control.within((left / THOROUGH_SHARE).max(THOROUGH_LEAST)),
            _ => control.clone(),
        };
        let answer = solve(network, start, &Cuts::none(), &Effort::thorough(), self.seed, &control);
        answer.ok().filter(|answer| answer.solution().is_some())
    }

    /// Remembers an answer from the start, and goes that way.
    fn begin_with(&mut self, answer: &Answer, control: &Control) {
        let start = self.tree[0].mode.clone();
        self.memo.keep(&start, answer, &Cuts::none());
        if let Some(solution) = answer.solution() {
            self.memo.suggest(solution);
        }
        self.version += 1;
        self.guide(0, control);
    }

    /// `sample_trans`, `select`, `extend` and `modal_check`: grounds the guide's next actions and
    /// moves all arms there; the new vertex with a tau of its own.
    pub(super) fn extend(
        &mut self,
        tau: usize,
        guide: &Guide,
        mut outline: Outline,
        control: &Control,
    ) -> Option<usize> {
        // Where not all can succeed a second try mends what failed, and then the rest is done without it.
        let more = if self.is_crowded() { 1 } else { 2 };
        let attempts = self.settings.groundings.min(2 + more * self.tree[tau].failures as usize);
        let (part, (grounding, motion)) = match self.step_from(tau, guide, &mut outline, attempts, control) {
            Ok(moved) => (None, moved),
            Err(setback) => {
                let partly = self.step_in_part(tau, guide, &outline, &setback, control);
                // With many objects, or where much fails, it is dear to ask the guidance again, so that it is done
                // without where only some actions have to come later.
                if partly.is_none() || self.asks_freely() {
                    self.note_setback(tau, guide, &setback, control);
                }
                if self.best.is_none() && !control.should_stop() {
                    self.setbacks += 1;
                    self.set_pace();
                }
                let (part, moved) = partly?;
                (Some(part), moved)
            }
        };
        let immediate = part.as_ref().map_or(&guide.immediate, |part| &part.immediate);
        let from = &self.tree[tau];
        let mut mode = from.mode.clone();
        for action in immediate {
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
            fewest: None,
            guided_at: 0,
            penalty: 0.0,
            chains: grounding.chains,
            expansions: 0,
            failures: 0,
            is_goal,
            step: Some(Arc::new(Step { actions: grounding.actions, motion, task: grounding.task })),
        };
        // What to do from there, where it need not be asked for.
        let mut known = None;
        match &part {
            None => self.memo.suggest(&guide.solution),
            Some(part) => {
                if !self.asks_freely() {
                    // It goes on from there, and not from here again.
                    self.tree[tau].failures += DONE_IN_PART;
                }
                if let Some(rest) = self.rest_after(guide, part, &vertex.mode) {
                    self.memo.suggest(&rest);
                    known = Some(rest).filter(|_| !self.asks_freely());
                }
            }
        }
        if self.is_beaten(&vertex) {
            return None;
        }
        self.tree.push(vertex);
        let new = self.tree.len() - 1;
        if !is_goal {
            match known {
                Some(rest) => {
                    let guide = Guide::along(&self.network, rest, None);
                    self.follow(new, guide);
                }
                None => self.guide(new, control),
            }
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
        fewest: None,
        guided_at: 0,
        penalty: 0.0,
        chains: BTreeMap::new(),
        expansions: 0,
        failures: 0,
        is_goal,
    }
}
