//! What the arms have to do in one synchronised step.

use crate::collision::{Exemption, Held, Scene};
use crate::kinematics::Config;
use crate::transition::Line;
use crate::workcell::ArmId;

/// The straight line by which an arm leaves its last action.
#[derive(Debug, Clone, PartialEq)]
pub struct Departure {
    /// The line, from the contact outwards.
    pub line: Line,
    /// What may touch on the way.
    pub exemption: Exemption,
}

/// Where an arm shall be at the end of the step.
#[derive(Debug, Clone, PartialEq)]
pub enum ArmGoal {
    /// At rest at a contact, when the step's actions happen.
    Contact {
        /// The contact configuration.
        q: Config,
        /// The straight line before it, from the contact outwards; none for a giver.
        approach: Option<Line>,
        /// What may touch on that line.
        exemption: Exemption,
        /// The line may begin only when this arm (the giver) rests at its own contact.
        after: Option<ArmId>,
    },
    /// Near this configuration, if that costs nothing: an arm without an action that positions
    /// itself ahead.
    Toward(Config),
    /// Anywhere; the arm has no action in this step.
    Anywhere,
}

/// One arm's part of a step.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmTask {
    /// Where it starts, at rest.
    pub start: Config,
    /// What it holds during the step.
    pub held: Option<Held>,
    /// The line on which it must leave first.
    pub departure: Option<Departure>,
    /// It must not move before this arm (the giver of the last handoff) has left on its line.
    pub wait_for: Option<ArmId>,
    /// It must not move before this time (s) since the step began: the dwell of its last action.
    pub dwell: f64,
    /// Where it shall be at the end.
    pub goal: ArmGoal,
}

/// A step: one task per arm, and the objects at rest throughout.
#[derive(Debug, Clone, PartialEq)]
pub struct StepTask {
    /// By arm.
    pub arms: Vec<ArmTask>,
    /// Objects at rest.
    pub scene: Scene,
}

impl ArmTask {
    /// Where it is once it has left its last action.
    pub(super) fn after_departure(&self) -> &Config {
        self.departure.as_ref().and_then(|departure| departure.line.waypoints.last()).unwrap_or(&self.start)
    }

    /// Whether the arm takes part in an action at the step's end.
    pub fn acts(&self) -> bool {
        matches!(self.goal, ArmGoal::Contact { .. })
    }
}
