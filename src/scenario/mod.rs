//! Benchmark problems: the paper's families on generated cells, and the files that ship.
//!
//! A scenario is a problem document like any other; nothing here knows how it is read or planned.

mod catalog;
mod family;
mod generate;
mod layout;
#[cfg(test)]
mod reach;
mod robot;
mod sampling;
mod text;

pub use catalog::{CatalogEntry, catalog, find};
pub use family::Family;
pub use generate::{generate, generate_with};
pub use layout::MAX_ARMS;
pub use robot::RobotKind;
pub use text::to_text;

/// Why a scenario could not be generated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScenarioError {
    /// No such family.
    #[error(
        "there is no family `{0}`; give switch, side_to_side, random, in_place_swap, derangement or ring"
    )]
    UnknownFamily(String),
    /// No such robot.
    #[error("there is no robot `{0}`; give iiwa14, ur_type or panda_type")]
    UnknownRobot(String),
    /// No robot at all.
    #[error("name at least one robot")]
    NoRobots,
    /// No layout for so many arms.
    #[error("{0} arms cannot be laid out; give 1 to {MAX_ARMS}")]
    Arms(usize),
    /// Too few arms for a ring.
    #[error("a ring needs at least 3 arms, not {0}")]
    NoRing(usize),
    /// The family takes another number of arms.
    #[error("`{family}` needs two tables and so at least 2 arms")]
    TooFewArms {
        /// The family.
        family: &'static str,
    },
    /// The family takes another number of objects.
    #[error("`{family}` takes {takes} objects, not {given}")]
    Objects {
        /// The family.
        family: &'static str,
        /// How many it takes.
        takes: &'static str,
        /// How many were asked for.
        given: usize,
    },
    /// The objects do not fit on the tables.
    #[error("{0} objects and their goals do not fit on the tables; ask for fewer, or for more arms")]
    NoRoom(usize),
}
