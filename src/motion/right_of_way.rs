//! Who gives way to whom in a step: where arms without an action go, and what the others' ways avoid.

use rand::Rng as _;

use crate::collision::{CollisionWorld, Exemption, StraightMotion};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::trajectory::{Curve, CurveTable};
use crate::workcell::ArmId;

use super::arm_path::Avoid;
use super::legs::{Leg, Legs};
use super::roadmap::Roadmap;
use super::schedule::Conflict;
use super::task::{ArmGoal, StepTask};
use super::timed::{CurveMotion, Instants, Window, pieces};

/// How an arm without an action behaves in one round.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Idle {
    /// As its task says.
    Ahead,
    /// Stays where its departure leaves it.
    Stay,
    /// Goes to a place of refuge.
    Refuge(Config),
}

/// What one round tries.
pub(super) struct Round {
    /// By arm, what those without an action do.
    pub(super) idle: Vec<Idle>,
    /// For each arm the arms that its path avoids, at rest at their start (`false`) or end.
    pub(super) avoid: Vec<Vec<(usize, bool)>>,
}

impl Round {
    /// Where an arm's free path leads: the far end of its approach line, its contact, or the place
    /// where an idle arm goes.
    pub(super) fn destination(&self, task: &StepTask, index: usize, from: &Config) -> Config {
        match (&task.arms[index].goal, &self.idle[index]) {
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
    pub(super) fn standing(&self, task: &StepTask, other: usize, at_end: bool) -> Option<Avoid> {
        let arm = &task.arms[other];
        let from = arm.after_departure();
        let q = match (&arm.goal, at_end) {
            (_, false) => from.clone(),
            (ArmGoal::Contact { q, .. }, true) => q.clone(),
            (_, true) => self.destination(task, other, from),
        };
        Some(Avoid { arm: ArmId(other), q, held: arm.held })
    }
}

/// The way of an arm that others should not be in.
struct Way<'l> {
    arm: usize,
    curve: &'l Curve,
    /// What may touch, and when.
    windows: &'l [Window],
    table: CurveTable,
}

/// Settles who gives way, in one round of a step.
pub(super) struct RightOfWay<'a> {
    pub(super) problem: &'a Problem,
    pub(super) world: &'a CollisionWorld,
    pub(super) task: &'a StepTask,
    /// Where refuges come from, by arm.
    pub(super) roadmaps: &'a [Roadmap],
    pub(super) rng: &'a mut Rng,
}

impl RightOfWay<'_> {
    /// Changes the round's terms so that two arms that met may pass each other. Returns the arms that need other legs for
    /// it: ways that are clear of who stands still beside them are kept.
    pub(super) fn settle(
        &mut self,
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
        let idle = [a, b].into_iter().filter(|&i| !self.task.arms[i].acts()).collect::<Vec<_>>();
        if let Some(&arm) = idle.first() {
            // The arm without an action gives way.
            let arm = if idle.len() == 2 && dispute.is_multiple_of(2) { b } else { arm };
            let (all, model) = (self.ways(legs), &self.task.arms[arm]);
            let ways = self.past(&all, arm);
            round.idle[arm] = match (&round.idle[arm], &model.goal) {
                (Idle::Ahead, ArmGoal::Toward(_))
                    if !self.is_in_any_way(&ways, arm, model.after_departure()) =>
                {
                    Idle::Stay
                }
                _ => Idle::Refuge(self.refuge(round, &ways, arm)),
            };
            let other = if arm == a { b } else { a };
            let at_end = dispute.is_multiple_of(2);
            if dispute > 1 {
                set(round, other, arm, at_end);
            }
            let avoids_it = |other: &usize| round.avoid[*other].iter().any(|&(avoided, _)| avoided == arm);
            let passes = |by: &usize| *by == other && self.passes(round, legs, other, (arm, at_end));
            return (0..legs.len()).filter(|by| *by == arm || avoids_it(by) && !passes(by)).collect();
        }
        // One first, the other afterwards: who comes second avoids where the first will rest, and
        // who comes first avoids where the second waits.
        let (first, second) = if dispute % 2 == 1 { (a, b) } else { (b, a) };
        set(round, second, first, true);
        set(round, first, second, false);
        let meets = |arm: usize, beside| !self.passes(round, legs, arm, beside);
        match (dispute == 1).then(|| (meets(first, (second, false)), meets(second, (first, true)))) {
            Some((true, false)) => vec![first],
            Some((false, true)) => vec![second],
            // Each passes the other at rest, and still they found no time to do so; or once was not enough.
            _ => vec![first.min(second), first.max(second)],
        }
    }

    /// Has arms that would stay in the way of others step aside: ahead, as their task says, or else to a refuge. Returns
    /// which.
    pub(super) fn make_way(&mut self, round: &mut Round, legs: &[Legs]) -> Vec<usize> {
        let stays = |index: &usize| !self.task.arms[*index].acts() && round.idle[*index] == Idle::Stay;
        let all = self.ways(legs);
        let mut aside = Vec::new();
        for index in (0..legs.len()).filter(stays).collect::<Vec<_>>() {
            let ways = self.past(&all, index);
            let here = self.task.arms[index].after_departure();
            let blocked: Vec<usize> =
                ways.iter().filter(|way| self.is_in_the_way(way, index, here)).map(|way| way.arm).collect();
            if blocked.is_empty() {
                continue;
            }
            let is_clear =
                |q: &Config| !self.is_in_any_way(&ways, index, q) && self.is_clear_of_idle(round, index, q);
            round.idle[index] = match &self.task.arms[index].goal {
                ArmGoal::Toward(q) if is_clear(q) => Idle::Ahead,
                _ => Idle::Refuge(self.refuge(round, &ways, index)),
            };
            // The others wait for it.
            round.avoid[index].extend(blocked.into_iter().map(|other| (other, false)));
            aside.push(index);
        }
        aside
    }

    /// Whether an arm on its leg, be it in one flow or with a rest before the approach, is clear of another arm that stands
    /// still where it is before the step, or after it.
    fn passes(&self, round: &Round, legs: &[Legs], arm: usize, (other, at_end): (usize, bool)) -> bool {
        let Some(other) = round.standing(self.task, other, at_end) else { return true };
        let (held, none) = (self.task.arms[arm].held.as_ref(), Exemption::default());
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
    /// out of all `ways` where one is found: home, or a roadmap vertex.
    fn refuge(&mut self, round: &Round, ways: &[&Way<'_>], index: usize) -> Config {
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
        let held = self.task.arms[index].held.as_ref();
        let none = Exemption::default();
        let clear = |q: &Config| {
            self.world.config_free(ArmId(index), q, held, &self.task.scene, none)
                && self.is_clear_of_idle(round, index, q)
                && self.task.arms.iter().enumerate().all(|(other, arm)| {
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
        let mut first = None;
        for q in candidates.into_iter().filter(clear) {
            if !self.is_in_any_way(ways, index, &q) {
                return q;
            }
            first.get_or_insert(q);
        }
        first.unwrap_or(home)
    }

    /// Whether an arm at `q` is clear of all arms without an action where these go or stay.
    fn is_clear_of_idle(&self, round: &Round, index: usize, q: &Config) -> bool {
        let (held, none) = (self.task.arms[index].held.as_ref(), Exemption::default());
        let others =
            (0..self.task.arms.len()).filter(|&other| other != index && !self.task.arms[other].acts());
        others.filter_map(|other| round.standing(self.task, other, true)).all(|other| {
            self.world
                .arms_apart((ArmId(index), q, held, none), (other.arm, &other.q, other.held.as_ref(), none))
        })
    }

    /// The ways of acting arms, laid out for sampling.
    fn ways<'l>(&self, legs: &'l [Legs]) -> Vec<Way<'l>> {
        let acting = legs.iter().zip(&self.task.arms).enumerate().filter(|(_, (_, arm))| arm.acts());
        acting
            .map(|(arm, (legs, _))| {
                let Leg { curve, windows, .. } = &legs.through;
                Way { arm, curve, windows, table: CurveTable::new(curve) }
            })
            .collect()
    }

    /// Those of `ways` that may come near arm `index`.
    fn past<'w, 'l>(&self, ways: &'w [Way<'l>], index: usize) -> Vec<&'w Way<'l>> {
        let arm = |index: usize| (ArmId(index), self.task.arms[index].held.as_ref());
        let comes_near = |way: &&Way<'_>| way.arm != index && self.world.may_meet(arm(index), arm(way.arm));
        ways.iter().filter(comes_near).collect()
    }

    /// Whether an arm that stands still at `q` is in one of the `ways`, at one of a few instants.
    fn is_in_any_way(&self, ways: &[&Way<'_>], index: usize, q: &Config) -> bool {
        ways.iter().any(|way| self.is_in_the_way(way, index, q))
    }

    /// The same of one way.
    fn is_in_the_way(&self, way: &Way<'_>, index: usize, q: &Config) -> bool {
        let Way { arm, curve, windows, table } = way;
        let (rest, none) = (StraightMotion::rest(q), Exemption::default());
        let held = |arm: usize| self.task.arms[arm].held.as_ref();
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
    use crate::motion::planner::{StepPlanner, first_roadmaps};
    use crate::motion::schedule::find_conflict;
    use crate::motion::task::ArmTask;
    use crate::run::{Control, Seed};
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

    fn two_arms() -> Problem {
        let document = generate(Family::Switch, 2, 2, 1).unwrap();
        read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem
    }

    /// Free configurations of an arm, at random.
    fn drawing(roadmaps: &[Roadmap], mut rng: Rng) -> impl FnMut(usize) -> Config {
        let vertices: Vec<Vec<Config>> = roadmaps.iter().map(|roadmap| roadmap.vertices().to_vec()).collect();
        move |arm| vertices[arm][rng.random_range(0..vertices[arm].len())].clone()
    }

    /// Who has to come where another is busy waits for it, however long that is.
    #[test]
    fn waiting_takes_as_long_as_it_must() {
        let problem = two_arms();
        let world = CollisionWorld::new(&problem);
        let control = Control::with_budget(std::time::Duration::from_secs(600));
        let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
        let none = Exemption::default();
        let apart =
            |p: &[f64], q: &[f64]| world.arms_apart((ArmId(0), p, None, none), (ArmId(1), q, None, none));
        let mut any = drawing(&roadmaps, Seed(5).stream("waiting"));
        let homes = [problem.workcell.arms[0].home.clone(), problem.workcell.arms[1].home.clone()];
        let (mut waited, mut failed) = (0, 0);
        for trial in 0..4000 {
            let (busy, wanted) = (any(0), any(1));
            if apart(&busy, &wanted) || !apart(&busy, &homes[1]) || !apart(&homes[0], &wanted) {
                continue;
            }
            let contact =
                |q: &Config| ArmGoal::Contact { q: q.clone(), approach: None, exemption: none, after: None };
            let mut step = task([(&busy, contact(&homes[0])), (&homes[1], contact(&wanted))]);
            step.arms[0].dwell = 12.0;
            let mut planner = StepPlanner::new(&problem, &world, roadmaps.clone(), Seed(trial));
            match planner.plan(&step, false, &control) {
                Ok(motion) => {
                    assert_eq!(find_conflict(&world, &motion), None);
                    assert!(motion.duration > 12.0);
                    waited += 1;
                }
                Err(_) => failed += 1,
            }
            if waited + failed == 40 {
                break;
            }
        }
        assert!(waited > 4 * failed && waited > 20, "{waited} {failed}");
    }

    #[test]
    fn in_haste_an_arm_without_an_action_moves_only_out_of_the_way() {
        let problem = two_arms();
        let world = CollisionWorld::new(&problem);
        let control = Control::with_budget(std::time::Duration::from_secs(600));
        let (roadmaps, _) = first_roadmaps(&problem.workcell, &world, 1, &control);
        let none = Exemption::default();
        let apart =
            |p: &[f64], q: &[f64]| world.arms_apart((ArmId(0), p, None, none), (ArmId(1), q, None, none));
        let mut any = drawing(&roadmaps, Seed(11).stream("idle"));
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
