//! The mode graph: which arms reach which placements, which arms can meet, and how many objects
//! fit where (design section 5; the paper's "mode graph").
//!
//! There are two: the graph that guides, from the workcell's geometry and the answers of a
//! [`Reach`]; and the one that bounds, from geometry alone. Both become instances of guidance in
//! [`crate::guidance`].
//!
//! This room must not know planners: what can be grounded it learns through [`Reach`] only.

mod graph;
mod reach;

pub use graph::{
    GraphKind, ModeEdge, ModeGoal, ModeGraph, ModeNode, ModeObject, NodeConflict, Place, Placement, Region,
    Slot, Spot,
};
pub use reach::{HandoffWitness, Hold, Reach, RestAction};
