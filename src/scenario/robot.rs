//! Kinds of robots of which cells are generated: those of the robot library.

use std::str::FromStr;

use super::ScenarioError;

/// A robot of the library, as generated cells use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RobotKind {
    /// KUKA LBR iiwa 14 R820.
    Iiwa14,
    /// A 6-axis arm of the UR type.
    UrType,
    /// A 7-axis arm of the Panda type, with offset elbow and wrist.
    PandaType,
}

impl RobotKind {
    /// All kinds.
    pub const ALL: [RobotKind; 3] = [RobotKind::Iiwa14, RobotKind::UrType, RobotKind::PandaType];

    /// Its name in the library.
    pub fn name(self) -> &'static str {
        match self {
            Self::Iiwa14 => "iiwa14",
            Self::UrType => "ur_type",
            Self::PandaType => "panda_type",
        }
    }

    /// Home in generated cells (deg), joint after joint, of an arm whose base is turned by `yaw` (deg) against the
    /// direction of a table.
    pub(super) fn home_deg(self, yaw: f64) -> Vec<f64> {
        match self {
            Self::Iiwa14 => vec![0.0, -20.0, 0.0, -110.0, 0.0, 60.0, 0.0],
            // It is longer than the others, and leans along the tables.
            Self::UrType => vec![270.0 - yaw, -110.0, -120.0, -40.0, 90.0, 0.0],
            Self::PandaType => vec![0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0],
        }
    }

    /// The links that may touch the pedestal under the arm.
    pub(super) fn on_the_pedestal(self) -> &'static [&'static str] {
        match self {
            Self::Iiwa14 | Self::UrType => &["link_0"],
            // Its first link's shape reaches down to the mounting plane.
            Self::PandaType => &["link_0", "link_1"],
        }
    }
}

impl FromStr for RobotKind {
    type Err = ScenarioError;

    fn from_str(text: &str) -> Result<Self, ScenarioError> {
        let found = Self::ALL.into_iter().find(|kind| kind.name() == text);
        found.ok_or_else(|| ScenarioError::UnknownRobot(text.chars().take(80).collect()))
    }
}
