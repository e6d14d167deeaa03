//! Guidances as they are given on the command line.

use clap::ValueEnum;

use crate::problem::GuidanceKind;

/// What steers the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Guidance {
    /// All objects at once, on the mode graph
    Smart,
    /// One unfinished object after the other
    Sequential,
    /// Every object's own next move
    Greedy,
}

impl From<Guidance> for GuidanceKind {
    fn from(guidance: Guidance) -> Self {
        match guidance {
            Guidance::Smart => GuidanceKind::Smart,
            Guidance::Sequential => GuidanceKind::Sequential,
            Guidance::Greedy => GuidanceKind::Greedy,
        }
    }
}
