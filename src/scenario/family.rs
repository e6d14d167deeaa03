//! Families of problems (DESIGN section 12).

use std::str::FromStr;

use super::ScenarioError;

/// What the objects have to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Family {
    /// Half of the objects stand on each table and trade tables.
    Switch,
    /// All objects go from the first table to the second.
    SideToSide,
    /// Each object starts on a random table and goes to the other.
    Random,
    /// Two objects trade their exact places.
    InPlaceSwap,
    /// All objects trade their exact places in one cycle.
    Derangement,
    /// Arms in a ring, each with a table of its own; each object starts on a random table and goes
    /// to another.
    Ring,
}

impl Family {
    /// All families.
    pub const ALL: [Family; 6] = [
        Family::Switch,
        Family::SideToSide,
        Family::Random,
        Family::InPlaceSwap,
        Family::Derangement,
        Family::Ring,
    ];

    /// Its name in file names and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Family::Switch => "switch",
            Family::SideToSide => "side_to_side",
            Family::Random => "random",
            Family::InPlaceSwap => "in_place_swap",
            Family::Derangement => "derangement",
            Family::Ring => "ring",
        }
    }
}

impl FromStr for Family {
    type Err = ScenarioError;

    fn from_str(text: &str) -> Result<Self, ScenarioError> {
        Family::ALL
            .into_iter()
            .find(|family| family.name() == text)
            .ok_or_else(|| ScenarioError::UnknownFamily(text.chars().take(80).collect()))
    }
}
