//! Window re-planning: one or two steps of the incumbent are planned again between the states
//! before and after them, so that all the rest stays as it is.
//!
//! In a window of two steps the state between them is changed: another contact for a pick or a
//! place, another meeting for a handoff, another place for an arm that waits.

use std::sync::Arc;

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::Exemption;
use crate::motion::{ArmGoal, Departure, StepMotion, StepTask};
use crate::plan::ActionKind;
use crate::problem::Objective;
use crate::run::Control;
use crate::workcell::ArmId;

use super::smart::Search;
use super::tree::{ArmState, CostsAfter, Step};

/// Least gain (s, or rad and m) for which a window is replaced.
const LEAST_GAIN: f64 = 1e-6;

/// Chance that a window of two steps changes where an arm waits in between, rather than how one acts: it gains less.
const WAITING: f64 = 0.1;

/// A changed state between two steps.
struct Between {
    /// The first step's task, and the second's.
    tasks: [StepTask; 2],
    /// The arm that waits elsewhere: it starts the second step where the first one leaves it.
    waits: Option<ArmId>,
    /// The arms between the steps.
    arms: Vec<ArmState>,
}

impl Search<'_> {
    /// Plans a window of the incumbent again; the vertex at the end of the better plan, if it is one.
    pub(super) fn refine(&mut self, control: &Control) -> Option<usize> {
        let steps = self.best_way.len().checked_sub(1).filter(|&steps| steps > 0)?;
        // The longer a step takes, the more there is to gain.
        let durations: Vec<f64> = self.best_way[1..]
            .iter()
            .map(|&v| self.tree[v].step.as_ref().map_or(0.0, |s| s.motion.duration))
            .collect();
        let mut point = self.rng.random_range(0.0..durations.iter().sum::<f64>().max(1e-9));
        let mut number = 1;
        while number < steps && point > durations[number - 1] {
            point -= durations[number - 1];
            number += 1;
        }
        if number == steps || self.rng.random_bool(0.3) {
            return self.refine_step(number, control);
        }
        self.refine_two(number, control)
    }

    /// Whether the incumbent's way is better with the steps `new` in place of `old`: shorter in time, or in the
    /// longest of the arms' joint paths where that is the objective.
    fn gains(&self, old: &[&StepMotion], new: &[&StepMotion]) -> bool {
        if !matches!(self.problem.options.objective, Objective::ArcLength) {
            let sum = |steps: &[&StepMotion]| steps.iter().map(|step| step.duration).sum::<f64>();
            return sum(new) + LEAST_GAIN <= sum(old);
        }
        let Some(&end) = self.best_way.last() else { return false };
        let length = |steps: &[&StepMotion], arm: usize| {
            steps.iter().map(|step| step.arms[arm].curve.arc_length()).sum::<f64>()
        };
        let before = &self.tree[end].arc;
        let longest = |arms: &mut dyn Iterator<Item = f64>| arms.fold(0.0, f64::max);
        let after =
            &mut before.iter().enumerate().map(|(arm, all)| all - length(old, arm) + length(new, arm));
        longest(after) + LEAST_GAIN <= longest(&mut before.iter().copied())
    }

    fn step(&self, number: usize) -> Option<Arc<Step>> {
        self.best_way.get(number).and_then(|&vertex| self.tree[vertex].step.clone())
    }

    fn refine_step(&mut self, number: usize, control: &Control) -> Option<usize> {
        let old = self.step(number)?;
        let motion = self.planner.plan(&pinned(&old.task, &old.motion, None), false, control).ok()?;
        if !self.gains(&[&old.motion], &[&motion]) {
            return None;
        }
        let arms = self.tree[*self.best_way.get(number)?].arms.clone();
        let step = Step { actions: old.actions.clone(), motion, task: old.task.clone() };
        Some(self.replace(number, vec![(step, arms)]))
    }

    fn refine_two(&mut self, number: usize, control: &Control) -> Option<usize> {
        let (first, second) = (self.step(number)?, self.step(number + 1)?);
        let between = self.vary(number, &first, &second)?;
        // Kept as they are: who waits may wait elsewhere another time.
        let [task, mut next] = between.tasks;
        let mut arms = between.arms;
        let old = [&first.motion, &second.motion];
        let motion = self.planner.plan(&pinned(&task, &first.motion, between.waits), false, control).ok()?;
        if !self.gains(&old, &[&motion]) {
            return None;
        }
        if let Some(ArmId(arm)) = between.waits {
            let end = motion.arms[arm].curve.last().q.clone();
            next.arms[arm].start = end.clone();
            arms[arm].q = end;
        }
        let after = self.planner.plan(&pinned(&next, &second.motion, None), false, control).ok()?;
        if !self.gains(&old, &[&motion, &after]) {
            return None;
        }
        let later = self.tree[*self.best_way.get(number + 1)?].arms.clone();
        let steps = vec![
            (Step { actions: first.actions.clone(), motion, task }, arms),
            (Step { actions: second.actions.clone(), motion: after, task: next }, later),
        ];
        Some(self.replace(number, steps))
    }

    /// Changes how one arm, or the two of a handoff, end the step with this number.
    fn vary(&mut self, number: usize, first: &Step, second: &Step) -> Option<Between> {
        let vertex = *self.best_way.get(number)?;
        let before = *self.best_way.get(number - 1)?;
        let mut arms = self.tree[vertex].arms.clone();
        let mut tasks = [first.task.clone(), second.task.clone()];
        let idle: Vec<usize> = (0..arms.len()).filter(|&arm| !first.task.arms[arm].acts()).collect();
        if !idle.is_empty() && self.rng.random_bool(WAITING) {
            let arm = *idle.choose(&mut self.rng)?;
            let q = self.waiting_place(arm, second)?;
            tasks[0].arms[arm].goal = ArmGoal::Toward(q);
            return Some(Between { tasks, waits: Some(ArmId(arm)), arms });
        }
        let (object, action) = first.actions.choose(&mut self.rng)?.clone();
        let now = |arm: ArmId| first.motion.arms[arm.0].curve.first().q.clone();
        let departs = |line| {
            Some(Departure { line, exemption: Exemption { hand_with: Some(object), held_with: None } })
        };
        match action {
            ActionKind::Pick { .. } | ActionKind::Place { .. } => {
                let (arm, contact) = self.grounder.another_contact(&self.tree[before], object, &action)?;
                let ArmGoal::Contact { q, approach, .. } = &mut tasks[0].arms[arm.0].goal else {
                    return None;
                };
                *q = contact.q.clone();
                *approach = Some(contact.approach);
                let exemption = arms[arm.0].departure.as_ref()?.exemption;
                arms[arm.0].q = contact.q.clone();
                arms[arm.0].departure = Some(Departure { line: contact.retreat, exemption });
                tasks[1].arms[arm.0].start = contact.q;
                tasks[1].arms[arm.0].departure = arms[arm.0].departure.clone();
            }
            ActionKind::Handoff { arm, to_arm, object_in_tcp, to_object_in_tcp } => {
                let holds = [object_in_tcp, to_object_in_tcp];
                let near = [now(arm), now(to_arm)];
                let meeting = self.grounder.another_meeting(object, [arm, to_arm], holds, &near)?;
                let ArmGoal::Contact { q, .. } = &mut tasks[0].arms[arm.0].goal else { return None };
                *q = meeting.giver_q.clone();
                let ArmGoal::Contact { q, approach, .. } = &mut tasks[0].arms[to_arm.0].goal else {
                    return None;
                };
                *q = meeting.receiver_q.clone();
                *approach = Some(meeting.receiver_approach);
                arms[arm.0].q = meeting.giver_q.clone();
                arms[arm.0].departure = departs(meeting.giver_retreat);
                arms[to_arm.0].q = meeting.receiver_q.clone();
                tasks[1].arms[arm.0].start = meeting.giver_q;
                tasks[1].arms[arm.0].departure = arms[arm.0].departure.clone();
                tasks[1].arms[to_arm.0].start = meeting.receiver_q;
            }
        }
        Some(Between { tasks, waits: None, arms })
    }

    /// Somewhere on an arm's way in the step to come, or home.
    fn waiting_place(&mut self, arm: usize, second: &Step) -> Option<crate::kinematics::Config> {
        let curve = &second.motion.arms[arm].curve;
        let moves = curve.first().q != curve.last().q;
        if moves && self.rng.random_bool(0.8) {
            let t = self.rng.random_range(0.0..=curve.end_time());
            return Some(curve.position_at(t));
        }
        Some(self.problem.workcell.arms[arm].home.clone())
    }

    /// The incumbent's way with other steps from `number` on, as new vertices; its end.
    fn replace(&mut self, number: usize, steps: Vec<(Step, Vec<ArmState>)>) -> usize {
        let way = self.best_way.clone();
        let mut parent = way[number - 1];
        let mut replaced = steps.into_iter();
        for &old in &way[number..] {
            let mut vertex = self.tree[old].clone();
            if let Some((step, arms)) = replaced.next() {
                vertex.step = Some(Arc::new(step));
                vertex.arms = arms;
                vertex.chains.clear();
            }
            vertex.set_costs(CostsAfter::new(&self.tree[parent], vertex.step.as_deref()));
            vertex.parent = Some(parent);
            (vertex.expansions, vertex.failures) = (1, 0);
            self.tree.push(vertex);
            parent = self.tree.len() - 1;
        }
        parent
    }
}

/// `task` where arms without an action have to end as they did, all but the one that waits elsewhere.
pub(super) fn pinned(task: &StepTask, motion: &StepMotion, but: Option<ArmId>) -> StepTask {
    let mut task = task.clone();
    for (index, (arm, was)) in task.arms.iter_mut().zip(&motion.arms).enumerate() {
        if !arm.acts() && but != Some(ArmId(index)) {
            arm.goal = ArmGoal::Contact {
                q: was.curve.last().q.clone(),
                approach: None,
                exemption: Exemption::default(),
                after: None,
            };
        }
    }
    task
}
