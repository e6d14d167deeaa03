//! `retrace`: from a goal vertex back to the root, as trajectories and actions.

use crate::kinematics::Config;
use crate::motion::StepMotion;
use crate::plan::{Action, ActionKind, ArmTrajectory};
use crate::problem::Objective;
use crate::trajectory::{Curve, MIN_SPACING_S};
use crate::workcell::ObjectId;

/// A complete plan as the search found it, not yet judged.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// One curve per arm, from 0 to the duration.
    pub curves: Vec<Curve>,
    /// The actions, in order of time.
    pub actions: Vec<Action>,
    /// Seconds.
    pub duration: f64,
    /// The largest over the arms of the Euclidean length of its joint path.
    pub arc_length: f64,
    /// Synchronised steps.
    pub steps: usize,
}

impl Candidate {
    /// The plan of a problem whose goals are all met at the start: a moment's rest.
    pub(super) fn standing(joints: &[Config]) -> Self {
        let duration = MIN_SPACING_S;
        let curves = joints.iter().map(|q| Curve::rest(q, duration)).collect();
        Self { curves, actions: Vec::new(), duration, arc_length: 0.0, steps: 0 }
    }

    /// Joins the motions of the steps; the last may be a motion without actions (the arms leave,
    /// or go home). The longest of the arms' paths has `arc_length`.
    pub(super) fn join(steps: &[(&StepMotion, &[(ObjectId, ActionKind)])], arc_length: f64) -> Option<Self> {
        let arms = steps.first()?.0.arms.len();
        let mut curves: Vec<Curve> = Vec::with_capacity(arms);
        let mut actions = Vec::new();
        let mut count = 0;
        for (index, (motion, ends_with)) in steps.iter().enumerate() {
            if index == 0 {
                curves = motion.arms.iter().map(|arm| arm.curve.clone()).collect();
            } else {
                for (curve, arm) in curves.iter_mut().zip(&motion.arms) {
                    curve.append(&arm.curve).ok()?;
                }
            }
            if !ends_with.is_empty() {
                count += 1;
                let t = curves.first()?.end_time();
                let happens = ends_with.iter().map(|(object, kind)| Action {
                    step: count,
                    t,
                    object: *object,
                    kind: kind.clone(),
                });
                actions.extend(happens);
            }
        }
        // Sums of the same durations in another order may differ in the last bits.
        let duration = curves.first()?.end_time();
        let same = curves.iter().all(|curve| (curve.end_time() - duration).abs() < 1e-9);
        same.then_some(Self { curves, actions, duration, arc_length, steps: count })
    }

    /// Its cost under `objective`: what comes first counts first.
    pub fn cost(&self, objective: Objective) -> [f64; 2] {
        objective.cost(self.duration, self.arc_length, self.steps)
    }

    /// The arms' trajectories as a plan holds them: one clock, the same last instant for all.
    pub fn trajectories(&self) -> Vec<ArmTrajectory> {
        self.curves.iter().map(ArmTrajectory::from).collect()
    }
}
