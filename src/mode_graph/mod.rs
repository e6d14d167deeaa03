//! The mode graph: which arms reach which placements, which arms can meet, and how many objects
//! fit where (design section 5; the paper's "mode graph").
//!
//! [`build_mode_graph`] computes the graph that guides from the workcell's geometry and the
//! answers of a [`Reach`]; [`optimistic_mode_graph`] the one that bounds, from geometry alone.
//! Both become instances of guidance in [`crate::guidance`].
//!
//! This room must not know planners: what can be grounded it learns through [`Reach`] only.

mod build;
mod carries;
mod fingers;
mod footprint;
mod graph;
mod handoffs;
mod holds;
mod optimistic;
mod packing;
mod print;
mod proof;
mod reach;
mod regions;
mod slots;
mod stance;
mod survey;
mod witness;

pub use build::{ModeGraphOptions, build_mode_graph};
pub use graph::{
    BarredCarry, Blockage, BlockedPart, CarryEnd, GraphKind, ModeEdge, ModeGoal, ModeGraph, ModeNode,
    ModeObject, NodeConflict, Place, Placement, Region, Slot, Spot,
};
pub use optimistic::optimistic_mode_graph;
pub use reach::{HandoffWitness, Hold, Reach, RestAction, RestContact};
pub use witness::{RestWitness, Witness, find_witnesses};

#[cfg(test)]
mod tests;
