//! The portfolio that plans one synchronised step.

use crate::collision::{CollisionWorld, Exemption};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::{Control, Rng, Seed, share};
use crate::workcell::{ArmId, Workcell};

use super::arm_path::{Avoid, Surroundings, find_path, shortcut};
use super::composite;
use super::connect::connect;
use super::legs::{Legs, time_legs};
use super::right_of_way::{Idle, RightOfWay, Round};
use super::roadmap::Roadmap;
use super::schedule::{PairTimes, schedule};
use super::task::{ArmGoal, StepTask};
use super::timed::StepMotion;

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
    /// See [`Self::timing_s`].
    timing_s: f64,
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
    (share(count, threads, || (), |(), index| build(index)), !control.should_stop())
}

impl<'a> StepPlanner<'a> {
    /// A planner that starts from `roadmaps`, one for every arm: see [`first_roadmaps`].
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, roadmaps: Vec<Roadmap>, seed: Seed) -> Self {
        Self {
            problem,
            world,
            roadmaps,
            rng: seed.stream("motion"),
            failed: None,
            is_hasty: false,
            timing_s: 0.0,
        }
    }

    /// Whether attempts that are not thorough give up sooner, where other contacts may be easier, and leave arms without an
    /// action where they are unless they are in the way.
    pub fn set_hasty(&mut self, is_hasty: bool) {
        self.is_hasty = is_hasty;
    }

    /// How long (s) it has been timing paths so far: making curves of them, and finding delays under which they pass each
    /// other, with all that certifies them.
    pub fn timing_s(&self) -> f64 {
        self.timing_s
    }

    /// Where the arms move.
    pub fn world(&self) -> &'a CollisionWorld {
        self.world
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
                let aside = self.right_of_way(task).make_way(&mut round, &legs);
                renewed = self.renew_legs(task, &mut round, &aside, &mut legs, control);
                fresh.extend(aside);
            }
            if let Err(stuck) = renewed {
                failure.get_or_insert(StepFailure::Stuck(ArmId(stuck)));
                legs.clear();
                break;
            }
            known.forget(&fresh);
            let began_s = control.deadline.elapsed_s();
            let scheduled =
                schedule(self.world, task, &legs, &mut known, self.is_hasty && !thorough, control);
            self.timing_s += control.deadline.elapsed_s() - began_s;
            match scheduled {
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
                    fresh = self.right_of_way(task).settle(&mut round, &legs, conflict, dispute);
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
        let Self { problem, world, roadmaps, rng, timing_s, .. } = self;
        composite::plan(problem, world, roadmaps, task, control, rng, timing_s).ok_or(StepFailure::Stopped)
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

    fn right_of_way<'p>(&'p mut self, task: &'p StepTask) -> RightOfWay<'p> {
        let Self { problem, world, roadmaps, rng, .. } = self;
        RightOfWay { problem, world, task, roadmaps, rng }
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
            let to = round.destination(task, index, &from);
            let avoid: Vec<Avoid> = round.avoid[index]
                .iter()
                .filter_map(|&(other, at_end)| round.standing(task, other, at_end))
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
            let around = Surroundings { world: self.world, arm: id, held, resting, avoid };
            let may_grow = found.is_none() && arm.acts() && avoid.is_empty() && !control.should_stop();
            // Where an end is blocked no roadmap is large enough.
            if may_grow && [from, to].into_iter().all(|end| around.edge_free(end, end)) {
                roadmap.grow(self.world, model, GROWTH, control, &mut self.rng);
                found = ask(roadmap, avoid, &mut self.rng);
            }
            if found.is_none() && may_grow {
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
        let began_s = control.deadline.elapsed_s();
        let legs = time_legs(self.world, id, model, arm, &path, resting);
        self.timing_s += control.deadline.elapsed_s() - began_s;
        legs
    }
}
