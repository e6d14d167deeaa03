//! Motions of the arms within one synchronised step.
//!
//! Each arm has a roadmap of its own over its free configurations; a step is planned by a
//! portfolio, cheapest first: every arm on its own path at once, the same with waits, paths that
//! avoid where other arms rest, one arm after the other, and at last the search over the tensor
//! product of the roadmaps (dRRT, Shome et al. 2019). Where an arm that acts has no way, even with all others out of
//! the way, its roadmap grows, and then two trees towards each other (RRT-Connect). Whatever comes out is timed, and the
//! timed curves are certified.
//!
//! This room knows no objects' goals, no modes and no trees.

mod arm_path;
mod composite;
mod connect;
mod legs;
mod planner;
mod right_of_way;
mod roadmap;
mod schedule;
mod task;
mod timed;

pub use legs::windows;
pub use planner::{StepFailure, StepPlanner, first_roadmaps};
pub use roadmap::Roadmap;
pub use task::{ArmGoal, ArmTask, Departure, StepTask};
pub use timed::{ArmMotion, StepMotion, Window};
