//! The tree's vertices: where everything is after a sequence of actions.

use std::sync::Arc;

use crate::geometry::Pose;
use crate::guidance::{Guide, ModeState};
use crate::kinematics::Config;
use crate::motion::{Departure, StepMotion, StepTask};
use crate::plan::ActionKind;
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::chain::Chains;

/// Where an object is.
#[derive(Debug, Clone)]
pub(super) enum Whereabouts {
    Resting { pose: Pose, surface: SurfaceId },
    Held { arm: ArmId, object_in_tcp: Pose },
}

/// An arm between two steps.
#[derive(Debug, Clone)]
pub(super) struct ArmState {
    pub(super) q: Config,
    /// The line on which it must leave.
    pub(super) departure: Option<Departure>,
    /// The giver that must have left first.
    pub(super) wait_for: Option<ArmId>,
    /// How long it must rest first (s).
    pub(super) dwell: f64,
}

/// A step that was carried out.
#[derive(Debug)]
pub(super) struct Step {
    pub(super) actions: Vec<(ObjectId, ActionKind)>,
    pub(super) motion: StepMotion,
    /// What the motion was asked for.
    pub(super) task: StepTask,
}

/// A vertex with its tau.
#[derive(Debug, Clone)]
pub(super) struct Vertex {
    pub(super) parent: Option<usize>,
    /// The step from the parent.
    pub(super) step: Option<Arc<Step>>,
    /// The mode state: every object's node on the mode graph.
    pub(super) mode: ModeState,
    pub(super) objects: Vec<Whereabouts>,
    pub(super) arms: Vec<ArmState>,
    /// Seconds from the start.
    pub(super) elapsed: f64,
    /// Joint path length so far, by arm.
    pub(super) arc: Vec<f64>,
    /// Steps from the start.
    pub(super) depth: usize,
    /// Guidance for this tau, once asked.
    pub(super) guide: Option<Guide>,
    /// The fewest steps that any guide said remain, since the network last gained a rule.
    pub(super) fewest: Option<usize>,
    /// Under which version of the cuts it was asked, and what they add to its steps.
    pub(super) guided_at: u64,
    pub(super) penalty: f64,
    /// What was planned for objects on their way, by object.
    pub(super) chains: Chains,
    /// How often it was expanded, and in vain.
    pub(super) expansions: u32,
    pub(super) failures: u32,
    /// Whether all goals are met here.
    pub(super) is_goal: bool,
}

/// What the way to a vertex costs in all.
#[derive(Debug)]
pub(super) struct CostsAfter {
    elapsed: f64,
    arc: Vec<f64>,
    depth: usize,
}

impl CostsAfter {
    /// The costs after `step` from `parent`.
    pub(super) fn new(parent: &Vertex, step: Option<&Step>) -> Self {
        let lengths = |step: &Step| -> Vec<f64> {
            let arms = step.motion.arms.iter().zip(&parent.arc);
            arms.map(|(arm, sum)| sum + arm.curve.arc_length()).collect()
        };
        Self {
            elapsed: parent.elapsed + step.map_or(0.0, |step| step.motion.duration),
            arc: step.map_or_else(|| parent.arc.clone(), lengths),
            depth: parent.depth + 1,
        }
    }
}

impl Vertex {
    pub(super) fn set_costs(&mut self, costs: CostsAfter) {
        (self.elapsed, self.arc, self.depth) = (costs.elapsed, costs.arc, costs.depth);
    }

    /// Steps that the guidance says remain.
    pub(super) fn remaining(&self) -> Option<usize> {
        self.guide.as_ref().and_then(|guide| guide.remaining_steps)
    }
}
