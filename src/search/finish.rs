//! `retrace`: a plan from the way to a goal vertex; and pruning.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::collision::Exemption;
use crate::motion::{ArmGoal, ArmTask, StepMotion, StepTask};
use crate::run::Control;
use crate::workcell::ArmId;

use super::candidate::Candidate;
use super::ground::{held_by, scene};
use super::smart::{Report, Search};
use super::tree::Step;

impl Search<'_> {
    /// `retrace`: the plan that ends at `goal`, with the arms leaving their last contacts.
    pub(super) fn finish(&mut self, goal: usize, control: &Control) -> Report {
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
        let after = |arm: usize| tail.as_ref().map_or(0.0, |tail| tail.arms[arm].curve.arc_length());
        let lengths = self.tree[goal].arc.iter().enumerate().map(|(arm, before)| before + after(arm));
        let arc_length = lengths.fold(0.0, f64::max);
        let Some(candidate) = Candidate::join(&parts, arc_length) else { return Report::Nothing };
        let cost = candidate.cost(self.problem.options.objective);
        if self.best.is_some_and(|best| cost >= best) {
            return Report::Nothing;
        }
        self.offered = way;
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
        self.planner.plan(&task, true, control).ok().map(Some)
    }

    /// Drops all vertices but the root's and the incumbent's.
    pub(super) fn prune(&mut self) {
        let mut keep: Vec<usize> = self.best_way.clone();
        if keep.first() != Some(&0) {
            keep.insert(0, 0);
        }
        let renumbered: BTreeMap<usize, usize> =
            keep.iter().enumerate().map(|(new, &old)| (old, new)).collect();
        // In the order of the way: rewiring gives vertices parents that came later.
        let kept = keep.iter().map(|&old| {
            let mut vertex = self.tree[old].clone();
            vertex.parent = vertex.parent.and_then(|parent| renumbered.get(&parent).copied());
            vertex.failures = 0;
            vertex
        });
        self.tree = kept.collect();
        self.best_way = self.best_way.iter().filter_map(|old| renumbered.get(old).copied()).collect();
    }
}
