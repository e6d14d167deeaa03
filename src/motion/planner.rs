//! The portfolio that plans one synchronised step.

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, StraightMotion};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::{Control, Rng, Seed};
use crate::trajectory::{Curve, CurveTable};
use crate::workcell::{ArmId, Workcell};

use super::arm_path::{Avoid, Surroundings, find_path, shortcut};
use super::composite;
use super::connect::connect;
use super::legs::{Leg, Legs, time_legs};
use super::roadmap::Roadmap;
use super::schedule::{Conflict, PairTimes, schedule};
use super::task::{ArmGoal, StepTask};
use super::timed::{CurveMotion, Instants, StepMotion, Window, pieces};

/// Vertices that a fresh roadmap gets.
const FIRST_VERTICES: usize = 300;

/// Vertices that a roadmap gains when it holds no path.
const GROWTH: usize = 150;

/// Rounds of repair in a first attempt, and before the composite search.
const FIRST_ROUNDS: usize = 5;
const ROUNDS: usize = 10;

/// Random shortcuts tried on a path with more than two waypoints; and where time is short.
const SHORTCUTS: usize = 24;
const HASTY_SHORTCUTS: usize = 8;

/// Disputes of two arms that act, one going first and then the other, after which other contacts are more promising
/// where time is short: a third round helps in one of seven cases, and a fourth in fewer.
const MOST_DISPUTES: usize = 2;

/// Plans steps; owns the arms' roadmaps, which grow as it is used.
#[derive(Debug)]
pub struct StepPlanner<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    roadmaps: Vec<Roadmap>,
    rng: Rng,
    /// The step that failed last where its arms found ways, but not past each other.
    failed: Option<(StepTask, Begun)>,
    /// See [`Self::set_hasty`].
    is_hasty: bool,
}

/// How an arm without an action behaves in one round.
#[derive(Debug, Clone, PartialEq)]
enum Idle {
    /// As its task says.
    Ahead,
    /// Stays where its departure leaves it.
    Stay,
    /// Goes to a place of refuge.
    Refuge(Config),
}

/// Why a step was not planned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepFailure {
    /// This arm found no way, all others at rest.
    Stuck(ArmId),
    /// These two, in the first place, could not be kept apart.
    Conflict(ArmId, ArmId),
    /// There was no leave to go on.
    Stopped,
}

impl StepFailure {
    /// The arms that it is about.
    pub fn arms(&self) -> Vec<ArmId> {
        match *self {
            Self::Stuck(arm) => vec![arm],
            Self::Conflict(one, other) => vec![one, other],
            Self::Stopped => Vec::new(),
        }
    }
}

/// What the first round of a step begins with.
#[derive(Debug)]
struct Begun {
    idle: Vec<Idle>,
    /// The ways of all arms, or none.
    legs: Vec<Legs>,
    /// Those whose ways are planned in the round; what the others do stays as it was.
    fresh: Vec<usize>,
    known: PairTimes,
}

/// The way of an arm that others should not be in.
struct Way<'l> {
    arm: usize,
    curve: &'l Curve,
    /// What may touch, and when.
    windows: &'l [Window],
    table: CurveTable,
}

/// What one round tries.
struct Round {
    idle: Vec<Idle>,
    /// For each arm the arms that its path avoids, at rest at their start (`false`) or end.
    avoid: Vec<Vec<(usize, bool)>>,
}

/// A small roadmap for every arm of `workcell`, built by up to `threads` threads; which of them
/// builds what makes no difference. They depend on the workcell alone, and clones share what is
/// found out about their edges. The second value is `false` when `control` stopped it: then they
/// are smaller than they should be.
pub fn first_roadmaps(
    workcell: &Workcell,
    world: &CollisionWorld,
    threads: usize,
    control: &Control,
) -> (Vec<Roadmap>, bool) {
    let build = |index: usize| {
        let arm = &workcell.arms[index];
        let mut roadmap = Roadmap::new(ArmId(index), arm);
        let mut rng = Seed(0).stream(&format!("roadmap/{}", arm.id));
        roadmap.grow(world, arm, FIRST_VERTICES, control, &mut rng);
        roadmap.share_checks();
        roadmap
    };
    let count = workcell.arms.len();
    let threads = threads.clamp(1, count.max(1));
    let mut parts: Vec<Vec<Roadmap>> = Vec::new();
    if threads == 1 {
        parts.push((0..count).map(build).collect());
    } else {
        let build = &build;
        std::thread::scope(|scope| {
            let part = |first: usize| (first..count).step_by(threads).map(build).collect::<Vec<_>>();
            let workers: Vec<_> = (0..threads).map(|first| scope.spawn(move || part(first))).collect();
            parts = workers.into_iter().filter_map(|worker| worker.join().ok()).collect();
        });
    }
    let mut roadmaps: Vec<Roadmap> = parts.into_iter().flatten().collect();
    roadmaps.sort_by_key(Roadmap::arm);
    (roadmaps, !control.should_stop())
}

impl<'a> StepPlanner<'a> {
    /// A planner that starts from `roadmaps`, one for every arm: see [`first_roadmaps`].
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, roadmaps: Vec<Roadmap>, seed: Seed) -> Self {
        Self { problem, world, roadmaps, rng: seed.stream("motion"), failed: None, is_hasty: false }
    }

    /// Whether attempts that are not thorough give up sooner, where other contacts may be easier, and leave arms without an
    /// action where they are unless they are in the way.
    pub fn set_hasty(&mut self, is_hasty: bool) {
        self.is_hasty = is_hasty;
    }

    /// The roadmaps, by arm.
    pub fn roadmaps(&self) -> &[Roadmap] {
        &self.roadmaps
    }

    /// Adds vertices to every arm's roadmap, so that paths keep getting better.
    pub fn grow(&mut self, count: usize, control: &Control) {
        for (index, roadmap) in self.roadmaps.iter_mut().enumerate() {
            roadmap.grow(self.world, &self.problem.workcell.arms[index], count, control, &mut self.rng);
        }
    }

    /// Plans a step, from the cheapest means to the most thorough. With `thorough` there are more
    /// attempts, and the composite search is used in the end.
    ///
    /// # Errors
    /// What stood in the way, when nothing succeeds or `control` stops it.
    pub fn plan(
        &mut self,
        task: &StepTask,
        thorough: bool,
        control: &Control,
    ) -> Result<StepMotion, StepFailure> {
        self.failed = None;
        let count = task.arms.len();
        let begun = Begun {
            idle: vec![self.idle_at_first(thorough); count],
            legs: Vec::with_capacity(count),
            fresh: (0..count).collect(),
            known: PairTimes::default(),
        };
        self.plan_from(task, begun, thorough, control)
    }

    /// [`Self::plan`], where arms that had the same to do in the step that failed last keep their ways.
    ///
    /// # Errors
    /// The same.
    pub fn plan_less(&mut self, task: &StepTask, control: &Control) -> Result<StepMotion, StepFailure> {
        if let Some((a, b)) = self.ends_that_meet(task) {
            return Err(StepFailure::Conflict(ArmId(a), ArmId(b)));
        }
        let Some((before, mut begun)) = self.failed.take().filter(|(before, _)| before.scene == task.scene)
        else {
            return self.plan(task, false, control);
        };
        let pairs = before.arms.iter().zip(&task.arms).enumerate();
        begun.fresh = pairs.filter(|(_, (old, new))| old != new).map(|(arm, _)| arm).collect();
        for &arm in &begun.fresh {
            begun.idle[arm] = self.idle_at_first(false);
        }
        self.plan_from(task, begun, false, control)
    }

    /// How arms without an action begin. In haste they stay where they are: who moves may be in somebody's way, and one
    /// more way has to be found.
    fn idle_at_first(&self, thorough: bool) -> Idle {
        if self.is_hasty && !thorough { Idle::Stay } else { Idle::Ahead }
    }

    fn plan_from(
        &mut self,
        task: &StepTask,
        begun: Begun,
        thorough: bool,
        control: &Control,
    ) -> Result<StepMotion, StepFailure> {
        let count = task.arms.len();
        if let Some((a, b)) = self.ends_that_meet(task) {
            return Err(StepFailure::Conflict(ArmId(a), ArmId(b)));
        }
        let Begun { idle, mut legs, mut fresh, mut known } = begun;
        let mut round = Round { idle, avoid: vec![Vec::new(); count] };
        let mut disputes = std::collections::BTreeMap::<(usize, usize), usize>::new();
        let mut failure = None;
        for number in 0..if thorough { ROUNDS } else { FIRST_ROUNDS } {
            if control.should_stop() {
                return Err(StepFailure::Stopped);
            }
            let mut renewed = self.renew_legs(task, &mut round, &fresh, &mut legs, control);
            if number == 0 && renewed.is_ok() && self.is_hasty && !thorough {
                let aside = self.make_way(task, &mut round, &legs);
                renewed = self.renew_legs(task, &mut round, &aside, &mut legs, control);
                fresh.extend(aside);
            }
            if let Err(stuck) = renewed {
                failure.get_or_insert(StepFailure::Stuck(ArmId(stuck)));
                legs.clear();
                break;
            }
            known.forget(&fresh);
            match schedule(self.world, task, &legs, &mut known, self.is_hasty && !thorough, control) {
                Ok(motion) => return Ok(motion),
                Err(None) => return Err(failure.unwrap_or(StepFailure::Stopped)),
                Err(Some(conflict)) => {
                    let (first, second) = (ArmId(conflict.first), ArmId(conflict.second));
                    let both_act = task.arms[first.0].acts() && task.arms[second.0].acts();
                    if both_act || failure.is_none() {
                        failure = Some(StepFailure::Conflict(first, second));
                    }
                    let dispute = disputes.entry((conflict.first, conflict.second)).or_default();
                    *dispute += 1;
                    let dispute = *dispute;
                    tracing::trace!(?first, ?second, both_act, dispute, "two arms meet");
                    if self.is_hasty && both_act && dispute > MOST_DISPUTES && !thorough {
                        break;
                    }
                    fresh = self.settle(task, &mut round, &legs, conflict, dispute);
                }
            }
        }
        if thorough && let Ok(motion) = self.plan_as_one_robot(task, control) {
            return Ok(motion);
        }
        if legs.len() == count {
            self.failed = Some((task.clone(), Begun { idle: round.idle, legs, fresh: Vec::new(), known }));
        }
        Err(failure.unwrap_or(StepFailure::Stopped))
    }

    /// Plans a step by the composite search alone: all arms as one robot, over the tensor product of
    /// their roadmaps. The dearest of the means, and the one on which completeness rests.
    ///
    /// # Errors
    /// When the search ends without a path, or `control` stops it.
    pub fn plan_as_one_robot(
        &mut self,
        task: &StepTask,
        control: &Control,
    ) -> Result<StepMotion, StepFailure> {
        composite::plan(self.problem, self.world, &mut self.roadmaps, task, control, &mut self.rng)
            .ok_or(StepFailure::Stopped)
    }

    /// Two arms that act and would touch each other at the end of the step.
    fn ends_that_meet(&self, task: &StepTask) -> Option<(usize, usize)> {
        let ends: Vec<(usize, &Config, Exemption)> = task
            .arms
            .iter()
            .enumerate()
            .filter_map(|(i, arm)| match &arm.goal {
                ArmGoal::Contact { q, exemption, .. } => Some((i, q, *exemption)),
                _ => None,
            })
            .collect();
        ends.iter().enumerate().find_map(|(n, (i, q, exempt))| {
            let meets = |(j, p, other): &&(usize, &Config, Exemption)| {
                let (a, b) = (&task.arms[*i], &task.arms[*j]);
                !self.world.arms_apart(
                    (ArmId(*i), q, a.held.as_ref(), *exempt),
                    (ArmId(*j), p, b.held.as_ref(), *other),
                )
            };
            ends[n + 1..].iter().find(meets).map(|(j, _, _)| (*i, *j))
        })
    }

    /// Paths and timed legs of the arms `fresh` under the round's terms, in place of their old ones in
    /// `all` (or appended, where there are none yet); the arm that is stuck otherwise.
    fn renew_legs(
        &mut self,
        task: &StepTask,
        round: &mut Round,
        fresh: &[usize],
        all: &mut Vec<Legs>,
        control: &Control,
    ) -> Result<(), usize> {
        let resting = self.world.resting_atoms(&task.scene);
        for &index in fresh {
            let arm = &task.arms[index];
            let from = arm.after_departure().clone();
            let to = self.destination(task, round, index, &from);
            let avoid: Vec<Avoid> = round.avoid[index]
                .iter()
                .filter_map(|&(other, at_end)| self.standing(task, round, other, at_end))
                .collect();
            let legs = self.legs(task, index, (&from, &to), &avoid, &resting, control);
            let legs = match legs {
                Some(legs) => legs,
                None if arm.acts() => return Err(index),
                // An arm without an action is not worth a failure.
                None => {
                    round.idle[index] = Idle::Stay;
                    self.legs(task, index, (&from, &from), &avoid, &resting, control).ok_or(index)?
                }
            };
            match all.get_mut(index) {
                Some(old) => *old = legs,
                None => all.push(legs),
            }
        }
        Ok(())
    }

    fn legs(
        &mut self,
        task: &StepTask,
        index: usize,
        (from, to): (&Config, &Config),
        avoid: &[Avoid],
        resting: &crate::collision::Resting,
        control: &Control,
    ) -> Option<Legs> {
        let arm = &task.arms[index];
        let model = &self.problem.workcell.arms[index];
        let id = ArmId(index);
        let held = arm.held.as_ref();
        let path = if from == to {
            vec![from.clone()]
        } else {
            let ask = |roadmap: &mut Roadmap, avoid: &[Avoid], rng: &mut Rng| {
                let shortcuts = if self.is_hasty { HASTY_SHORTCUTS } else { SHORTCUTS };
                let around = Surroundings { world: self.world, arm: id, held, resting, avoid };
                find_path(&around, roadmap, (from, to), shortcuts, control, rng)
            };
            let roadmap = &mut self.roadmaps[index];
            let mut found = ask(roadmap, avoid, &mut self.rng);
            if found.is_none() && arm.acts() && avoid.is_empty() && !control.should_stop() {
                roadmap.grow(self.world, model, GROWTH, control, &mut self.rng);
                found = ask(roadmap, avoid, &mut self.rng);
            }
            if found.is_none() && arm.acts() && avoid.is_empty() {
                let around = Surroundings { world: self.world, arm: id, held, resting, avoid };
                found = connect(&around, roadmap, model, (from, to), control, &mut self.rng).map(|path| {
                    let path = shortcut(&around, roadmap, path, SHORTCUTS, &mut self.rng);
                    roadmap.learn(&path);
                    path
                });
            }
            if found.is_none() && !avoid.is_empty() {
                found = ask(roadmap, &[], &mut self.rng);
            }
            found?
        };
        time_legs(self.world, id, model, arm, &path, resting)
    }

    /// Where an arm's free path leads: the far end of its approach line, its contact, or the place
    /// where an idle arm goes.
    fn destination(&self, task: &StepTask, round: &Round, index: usize, from: &Config) -> Config {
        match (&task.arms[index].goal, &round.idle[index]) {
            (ArmGoal::Contact { approach: Some(line), q, .. }, _) => {
                line.waypoints.last().unwrap_or(q).clone()
            }
            (ArmGoal::Contact { q, .. }, _) => q.clone(),
            (_, Idle::Refuge(q)) => q.clone(),
            (ArmGoal::Toward(q), Idle::Ahead) => q.clone(),
            _ => from.clone(),
        }
    }

    /// Another arm at rest before or after its motion.
    fn standing(&self, task: &StepTask, round: &Round, other: usize, at_end: bool) -> Option<Avoid> {
        let arm = &task.arms[other];
        let from = arm.after_departure();
        let q = match (&arm.goal, at_end) {
            (_, false) => from.clone(),
            (ArmGoal::Contact { q, .. }, true) => q.clone(),
            (_, true) => self.destination(task, round, other, from),
        };
        Some(Avoid { arm: ArmId(other), q, held: arm.held })
    }

    /// Changes the round's terms so that two arms that met may pass each other. Returns the arms that need other legs for
    /// it: ways that are clear of who stands still beside them are kept.
    fn settle(
        &mut self,
        task: &StepTask,
        round: &mut Round,
        legs: &[Legs],
        conflict: Conflict,
        dispute: usize,
    ) -> Vec<usize> {
        let (a, b) = (conflict.first, conflict.second);
        let set = |round: &mut Round, arm: usize, other: usize, at_end: bool| {
            round.avoid[arm].retain(|&(o, _)| o != other);
            round.avoid[arm].push((other, at_end));
        };
        let idle = [a, b].into_iter().filter(|&i| !task.arms[i].acts()).collect::<Vec<_>>();
        if let Some(&arm) = idle.first() {
            // The arm without an action gives way.
            let arm = if idle.len() == 2 && dispute.is_multiple_of(2) { b } else { arm };
            round.idle[arm] = match &round.idle[arm] {
                Idle::Ahead
                    if matches!(task.arms[arm].goal, ArmGoal::Toward(_))
                        && !self.is_in_any_way(
                            task,
                            &self.ways_past(task, legs, arm),
                            arm,
                            task.arms[arm].after_departure(),
                        ) =>
                {
                    Idle::Stay
                }
                _ => Idle::Refuge(self.refuge(task, round, legs, arm)),
            };
            let other = if arm == a { b } else { a };
            let at_end = dispute.is_multiple_of(2);
            if dispute > 1 {
                set(round, other, arm, at_end);
            }
            let avoids_it = |other: &usize| round.avoid[*other].iter().any(|&(avoided, _)| avoided == arm);
            let passes = |by: &usize| *by == other && self.passes(task, round, legs, other, (arm, at_end));
            return (0..legs.len()).filter(|by| *by == arm || avoids_it(by) && !passes(by)).collect();
        }
        // One first, the other afterwards: who comes second avoids where the first will rest, and
        // who comes first avoids where the second waits.
        let (first, second) = if dispute % 2 == 1 { (a, b) } else { (b, a) };
        set(round, second, first, true);
        set(round, first, second, false);
        let meets = |arm: usize, beside| !self.passes(task, round, legs, arm, beside);
        match (dispute == 1).then(|| (meets(first, (second, false)), meets(second, (first, true)))) {
            Some((true, false)) => vec![first],
            Some((false, true)) => vec![second],
            // Each passes the other at rest, and still they found no time to do so; or once was not enough.
            _ => vec![first.min(second), first.max(second)],
        }
    }

    /// Has arms that would stay in the way of others step aside: ahead, as their task says, or else to a refuge. Returns
    /// which.
    fn make_way(&mut self, task: &StepTask, round: &mut Round, legs: &[Legs]) -> Vec<usize> {
        let stays = |index: &usize| !task.arms[*index].acts() && round.idle[*index] == Idle::Stay;
        let mut aside = Vec::new();
        for index in (0..legs.len()).filter(stays).collect::<Vec<_>>() {
            let ways = self.ways_past(task, legs, index);
            let here = task.arms[index].after_departure();
            let blocked: Vec<usize> = ways
                .iter()
                .filter(|way| self.is_in_the_way(task, way, index, here))
                .map(|way| way.arm)
                .collect();
            if blocked.is_empty() {
                continue;
            }
            let is_clear = |q: &Config| {
                !self.is_in_any_way(task, &ways, index, q) && self.is_clear_of_idle(task, round, index, q)
            };
            round.idle[index] = match &task.arms[index].goal {
                ArmGoal::Toward(q) if is_clear(q) => Idle::Ahead,
                _ => Idle::Refuge(self.refuge(task, round, legs, index)),
            };
            // The others wait for it.
            round.avoid[index].extend(blocked.into_iter().map(|other| (other, false)));
            aside.push(index);
        }
        aside
    }

    /// Whether an arm on its leg, be it in one flow or with a rest before the approach, is clear of another arm that stands
    /// still where it is before the step, or after it.
    fn passes(
        &self,
        task: &StepTask,
        round: &Round,
        legs: &[Legs],
        arm: usize,
        (other, at_end): (usize, bool),
    ) -> bool {
        let Some(other) = self.standing(task, round, other, at_end) else { return true };
        let (held, none) = (task.arms[arm].held.as_ref(), Exemption::default());
        let rest = StraightMotion::rest(&other.q);
        let is_clear = |leg: &Leg| {
            let (curve, table) = (&leg.curve, CurveTable::new(&leg.curve));
            pieces(&leg.windows, curve.start_time(), curve.end_time()).into_iter().all(
                |(from, to, exemption)| {
                    let span = (from, to);
                    self.world.motions_apart(
                        (ArmId(arm), &CurveMotion { curve, table: &table, span }, held, exemption),
                        (other.arm, &rest, other.held.as_ref(), none),
                        span,
                    )
                },
            )
        };
        let Legs { through, split } = &legs[arm];
        is_clear(through) && split.iter().all(|(before, after)| is_clear(before) && is_clear(after))
    }

    /// A configuration out of the way of all acting arms at both ends of their ways, and of the others where these go, and
    /// out of the way all along `legs` where one is found: home, or a roadmap vertex.
    fn refuge(&mut self, task: &StepTask, round: &Round, legs: &[Legs], index: usize) -> Config {
        let home = self.problem.workcell.arms[index].home.clone();
        let mut candidates = vec![home.clone()];
        let vertices = self.roadmaps[index].vertices();
        for _ in 0..24 {
            if vertices.is_empty() {
                break;
            }
            candidates.push(vertices[self.rng.random_range(0..vertices.len())].clone());
        }
        if self.rng.random_bool(0.5) {
            candidates.rotate_left(1);
        }
        let held = task.arms[index].held.as_ref();
        let none = Exemption::default();
        let clear = |q: &Config| {
            self.world.config_free(ArmId(index), q, held, &task.scene, none)
                && self.is_clear_of_idle(task, round, index, q)
                && task.arms.iter().enumerate().all(|(other, arm)| {
                    let ends: Vec<&Config> = match &arm.goal {
                        _ if other == index => Vec::new(),
                        ArmGoal::Contact { q, .. } => vec![q, &arm.start],
                        _ => Vec::new(),
                    };
                    ends.into_iter().all(|p| {
                        self.world.arms_apart(
                            (ArmId(index), q, held, none),
                            (ArmId(other), p, arm.held.as_ref(), none),
                        )
                    })
                })
        };
        let ways = self.ways_past(task, legs, index);
        let mut first = None;
        for q in candidates.into_iter().filter(clear) {
            if !self.is_in_any_way(task, &ways, index, &q) {
                return q;
            }
            first.get_or_insert(q);
        }
        first.unwrap_or(home)
    }

    /// Whether an arm at `q` is clear of all arms without an action where these go or stay.
    fn is_clear_of_idle(&self, task: &StepTask, round: &Round, index: usize, q: &Config) -> bool {
        let (held, none) = (task.arms[index].held.as_ref(), Exemption::default());
        let others = (0..task.arms.len()).filter(|&other| other != index && !task.arms[other].acts());
        others.filter_map(|other| self.standing(task, round, other, true)).all(|other| {
            self.world
                .arms_apart((ArmId(index), q, held, none), (other.arm, &other.q, other.held.as_ref(), none))
        })
    }

    /// The ways of acting arms that may come near arm `index`, laid out for sampling.
    fn ways_past<'l>(&self, task: &StepTask, legs: &'l [Legs], index: usize) -> Vec<Way<'l>> {
        let here = (ArmId(index), task.arms[index].held.as_ref());
        let past = legs.iter().zip(&task.arms).enumerate().filter(|(other, (_, arm))| {
            *other != index && arm.acts() && self.world.may_meet(here, (ArmId(*other), arm.held.as_ref()))
        });
        past.map(|(arm, (legs, _))| {
            let Leg { curve, windows, .. } = &legs.through;
            Way { arm, curve, windows, table: CurveTable::new(curve) }
        })
        .collect()
    }

    /// Whether an arm that stands still at `q` is in one of the `ways`, at one of a few instants.
    fn is_in_any_way(&self, task: &StepTask, ways: &[Way<'_>], index: usize, q: &Config) -> bool {
        ways.iter().any(|way| self.is_in_the_way(task, way, index, q))
    }

    /// The same of one way.
    fn is_in_the_way(&self, task: &StepTask, way: &Way<'_>, index: usize, q: &Config) -> bool {
        let Way { arm, curve, windows, table } = way;
        let (rest, none) = (StraightMotion::rest(q), Exemption::default());
        let held = |arm: usize| task.arms[arm].held.as_ref();
        pieces(windows, curve.start_time(), curve.end_time()).into_iter().any(|(from, to, exemption)| {
            let span = (from, to);
            let instants = Instants(CurveMotion { curve, table, span });
            !self.world.motions_apart(
                (ArmId(index), &rest, held(index), none),
                (ArmId(*arm), &instants, held(*arm), exemption),
                span,
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::Scene;
    use crate::motion::schedule::find_conflict;
    use crate::motion::task::ArmTask;
    use crate::scenario::{Family, generate};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

    fn task(arms: [(&Config, ArmGoal); 2]) -> StepTask {
        let arms = arms.map(|(start, goal)| ArmTask {
            start: start.clone(),
            held: None,
            departure: None,
            wait_for: None,
            dwell: 0.0,
            goal,
        });
        StepTask { arms: arms.into(), scene: Scene::default() }
    }

    #[test]
    fn in_haste_an_arm_without_an_action_moves_only_out_of_the_way() {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        let problem = read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        let world = CollisionWorld::new(&problem);
        let control = Control::with_budget(std::time::Duration::from_secs(600));
        let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
        let none = Exemption::default();
        let apart =
            |p: &[f64], q: &[f64]| world.arms_apart((ArmId(0), p, None, none), (ArmId(1), q, None, none));
        let vertices: Vec<Vec<Config>> = roadmaps.iter().map(|roadmap| roadmap.vertices().to_vec()).collect();
        let mut rng = Seed(11).stream("idle");
        let mut any = |arm: usize| vertices[arm][rng.random_range(0..vertices[arm].len())].clone();
        let (mut stayed, mut made_way, mut needless, mut failed) = (0, 0, 0, 0);
        for trial in 0..600 {
            let (from, to, idle, ahead) = (any(0), any(0), any(1), any(1));
            if from == to || !apart(&from, &idle) {
                continue;
            }
            let mut planner = StepPlanner::new(&problem, &world, roadmaps.clone(), Seed(trial));
            planner.set_hasty(true);
            let goal = ArmGoal::Contact { q: to.clone(), approach: None, exemption: none, after: None };
            let step = task([(&from, goal), (&idle, ArmGoal::Toward(ahead))]);
            let Ok(motion) = planner.plan(&step, false, &control) else {
                failed += 1;
                continue;
            };
            assert_eq!(find_conflict(&world, &motion), None);
            let curve = &motion.arms[0].curve;
            assert!(curve.last().q.iter().zip(&to).all(|(a, b)| (a - b).abs() < 1e-9));
            let meets = (0..=2000).any(|i| {
                let t = curve.start_time() + (curve.end_time() - curve.start_time()) * f64::from(i) / 2000.0;
                !apart(&curve.position_at(t), &idle)
            });
            let end = &motion.arms[1].curve.last().q;
            let moves = end.iter().zip(&idle).any(|(a, b)| (a - b).abs() > 1e-9);
            if moves {
                // Whoever acts may have got another way since, past where the other stood.
                made_way += usize::from(meets);
                needless += usize::from(!meets);
            } else {
                assert!(!meets);
                stayed += 1;
            }
        }
        assert!(
            stayed > 100 && made_way > 15 && needless < made_way && failed < made_way,
            "{stayed} {made_way} {needless} {failed}"
        );
    }
}
