//! Guidance: path finding for many objects at once on a mode graph with capacities, and what the
//! search reads from it (the paper's sections 4 and 5).
//!
//! An [`Instance`] says what the mode graph is: arms, regions and slots as nodes with capacities,
//! picks, places and handoffs as edges, starts and goals. A [`Network`] is an instance compiled once
//! for many questions. [`solve`] answers from any state with a plan and a [`Certificate`] of how
//! good it is; [`check`] replays a plan and shares nothing with the solvers. A [`Guidance`] turns
//! that into what the search wants: the next step, and the first action of every arm.
//!
//! This room knows no geometry, no kinematics and no motion: only numbers of nodes and objects.

mod baselines;
mod beat;
mod bounds;
mod check;
mod cuts;
mod earliest;
mod effort;
mod exhaustive;
mod from_mode_graph;
pub mod generate;
mod guide;
mod instance;
mod interruptible;
#[cfg(test)]
mod known;
mod memo;
mod network;
#[cfg(test)]
mod oracle;
mod passage;
mod program;
mod relaxation;
mod repair;
mod route;
mod single_call;
mod solution;
mod solver;
mod timetable;

pub use baselines::{Greedy, Sequential};
pub use check::{Violation, check};
pub use cuts::{Cut, CutKind, Cuts};
pub use earliest::earliest;
pub use effort::Effort;
pub use from_mode_graph::instance_of;
pub use guide::{Advice, ArmAction, Guidance, Guide, Smart};
pub use instance::{
    Block, Clash, Clashing, ConflictSet, Edge, Goal, Instance, InstanceError, ModeState, Node, NodeId,
    NodeKind, Object,
};
pub use memo::Memo;
pub use network::Network;
pub use single_call::{SingleCallError, single_call};
pub use solution::{Answer, Certificate, Infeasible, Move, Proof, Solution};
pub use solver::solve;
