//! One step: all of a guide's immediate actions at once, or as many of them as go together.

use crate::guidance::{Guide, ModeState, Move, Solution, Violation, check, earliest};
use crate::motion::{StepFailure, StepMotion};
use crate::problem::GuidanceKind;
use crate::run::Control;
use crate::workcell::ArmId;

use super::ground::{Grounding, GroundingFailure};
use super::outline::Outline;
use super::smart::Search;

/// Failures of a tau, where not all can succeed ([`Search::is_crowded`]), before all means are used on its step.
const FAILURES_BORNE: u32 = 3;

/// A step that was grounded, and its motion.
type Moved = (Grounding, StepMotion);

/// Why a step could not be done.
#[derive(Debug)]
pub(super) enum Setback {
    /// Not even its contacts were found.
    Grounding(GroundingFailure),
    /// No motion was found, grounding by grounding; and the arms that touched each other at the end of each.
    Motion(Vec<StepFailure>, Vec<Option<(ArmId, ArmId)>>),
    /// The run was told to stop.
    Stopped,
}

impl Search<'_> {
    /// Grounds the guide's immediate actions from `tau` and plans the motion, with up to `attempts` groundings.
    pub(super) fn step_from(
        &mut self,
        tau: usize,
        guide: &Guide,
        outline: &mut Outline,
        attempts: usize,
        control: &Control,
    ) -> Result<Moved, Setback> {
        // Before there is a plan what failed is mended, and the ways of the others are kept where they still have the
        // same to do. With many objects to look at all arms as one robot is dearer than to do the rest without those
        // that failed.
        let is_crowded = self.is_crowded();
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        let mends = is_crowded || is_smart && self.best.is_none();
        let borne = if is_crowded && is_smart && guide.immediate.len() > 1 { FAILURES_BORNE } else { 0 };
        let thorough = self.tree[tau].failures > borne;
        let (mut failures, mut crowds) = (Vec::new(), Vec::new());
        for attempt in 0..attempts {
            if control.should_stop() {
                return Err(Setback::Stopped);
            }
            let blamed = failures.last().filter(|_| mends).map_or_else(Vec::new, StepFailure::arms);
            if attempt > 0 || self.tree[tau].expansions > 1 {
                self.grounder.renew(&self.tree[tau], guide, outline, &blamed);
            }
            let grounding = match self.grounder.ground(&self.tree[tau], guide, outline) {
                Ok(grounding) => grounding,
                Err(failure) => {
                    tracing::debug!(tau, ?failure, "no contacts for the step");
                    return Err(Setback::Grounding(failure));
                }
            };
            let last = attempt + 1 == attempts;
            let motion = match blamed.is_empty() || thorough && last {
                true => self.planner.plan(&grounding.task, thorough && last, control),
                false => self.planner.plan_less(&grounding.task, control),
            };
            match motion {
                Ok(motion) => return Ok((grounding, motion)),
                Err(failure) => {
                    tracing::debug!(tau, ?failure, crowd = ?grounding.crowd, "no motion for the step");
                    failures.push(failure);
                    crowds.push(grounding.crowd);
                }
            }
            self.cause = Some("no motion was found for the arms that does not collide".to_owned());
        }
        Err(Setback::Motion(failures, crowds))
    }

    /// Learns from a step that could not be done.
    pub(super) fn note_setback(&mut self, tau: usize, guide: &Guide, setback: &Setback, control: &Control) {
        match setback {
            Setback::Grounding(failure) => self.note_grounding_failure(failure, control),
            Setback::Motion(failures, crowds) => {
                self.note_motion_failures(guide, failures);
                self.note_crowds(tau, guide, crowds, control);
            }
            Setback::Stopped => {}
        }
    }

    /// The guide with fewer immediate actions after a `setback`, and the step that does them: one action after
    /// the other that is in the way is left for later. With many arms there is little hope that all can do at once
    /// what the guide says. Only before there is a plan; afterwards fewer steps are what counts.
    pub(super) fn step_in_part(
        &mut self,
        tau: usize,
        guide: &Guide,
        outline: &Outline,
        setback: &Setback,
        control: &Control,
    ) -> Option<(Guide, Moved)> {
        if self.best.is_some() || !matches!(self.problem.options.guidance, GuidanceKind::Smart) {
            return None;
        }
        let mut part = guide.clone();
        let mut latest;
        let mut setback = setback;
        while part.immediate.len() > 1 && !control.should_stop() {
            self.postpone(tau, &mut part, setback)?;
            latest = match self.grounder.ground(&self.tree[tau], &part, outline) {
                Err(failure) => Setback::Grounding(failure),
                Ok(grounding) => match self.plan_less(&grounding, control) {
                    Ok(motion) => {
                        let (done, of) = (part.immediate.len(), guide.immediate.len());
                        tracing::debug!(tau, done, of, "the step is done in part");
                        return Some((part, (grounding, motion)));
                    }
                    Err(failure) => Setback::Motion(vec![failure], Vec::new()),
                },
            };
            setback = &latest;
        }
        None
    }

    /// The motion of a step that differs from the one before in few arms.
    fn plan_less(&mut self, grounding: &Grounding, control: &Control) -> Result<StepMotion, StepFailure> {
        match self.asks_freely() {
            true => self.planner.plan(&grounding.task, false, control),
            false => self.planner.plan_less(&grounding.task, control),
        }
    }

    /// A plan from the state after `part` of the guide's first step was done, as something to begin with: what
    /// was left comes with the second step, and the objects it is about are one step late from then on; or with
    /// many objects, all that has to wait for them is; or else all that follows.
    pub(super) fn rest_after(&self, guide: &Guide, part: &Guide, after: &ModeState) -> Option<Solution> {
        let (first, rest) = guide.solution.steps.split_first()?;
        let left: Vec<Move> =
            first.iter().filter(|action| !part.immediate.contains(action)).copied().collect();
        let late = |action: &&Move| left.iter().any(|other| other.object == action.object);
        let mut delayed = left.clone();
        let mut woven: Vec<Vec<Move>> = Vec::with_capacity(rest.len() + 1);
        for step in rest {
            let (behind, on_time): (Vec<Move>, Vec<Move>) = step.iter().partition(late);
            woven.push(delayed.into_iter().chain(on_time).collect());
            delayed = behind;
        }
        woven.push(delayed);
        let apart: Vec<Vec<Move>> = std::iter::once(left.clone()).chain(rest.iter().cloned()).collect();
        let early = if self.asks_freely() { Vec::new() } else { earliest(&self.network, &apart) };
        [woven, early, apart].into_iter().filter(|steps| !steps.is_empty()).find_map(|mut steps| {
            steps.retain(|moves| !moves.is_empty());
            for moves in &mut steps {
                moves.sort_unstable();
            }
            let solution = self.network.solution(after.clone(), steps);
            check(self.network.instance(), &solution).is_ok().then_some(solution)
        })
    }

    /// Takes an action out of the guide's immediate ones that had to do with the setback; `None` when what is left
    /// would not be allowed.
    fn postpone(&mut self, tau: usize, part: &mut Guide, setback: &Setback) -> Option<()> {
        let by = |arm: ArmId| {
            let acts =
                |action: &&Move| [action.from, action.to].iter().any(|&n| self.map.arm(n) == Some(arm));
            part.immediate.iter().find(acts).copied()
        };
        let blamed: Vec<Move> = match setback {
            Setback::Grounding(
                GroundingFailure::NoChain(action) | GroundingFailure::NoContact(action, _),
            ) => {
                vec![*action]
            }
            Setback::Grounding(GroundingFailure::Clash(one, two)) => vec![*two, *one],
            Setback::Motion(failures, _) => match failures.last()? {
                StepFailure::Conflict(one, two) => by(*two).into_iter().chain(by(*one)).collect(),
                StepFailure::Stuck(arm) => by(*arm).into_iter().collect(),
                StepFailure::Stopped => return None,
            },
            Setback::Stopped => return None,
        };
        let is_allowed = |actions: &[Move]| {
            let solution = self.network.solution(self.tree[tau].mode.clone(), vec![actions.to_vec()]);
            matches!(check(self.network.instance(), &solution), Ok(()) | Err(Violation::GoalMissed(_)))
        };
        let without = |action: &Move| -> Vec<Move> {
            part.immediate.iter().filter(|other| *other != action).copied().collect()
        };
        let fewer = blamed.iter().map(without).find(|actions| is_allowed(actions))?;
        part.immediate = fewer;
        Some(())
    }
}
