//! Quadrille plans for robot arms that work together: picks, places and handoffs, from one
//! arrangement of objects to another, as joint trajectories that a judge has checked.
//!
//! The flow runs one way; each room knows only rooms to its left:
//!
//! ```text
//! geometry -> kinematics -> workcell -> problem -> mode_graph -> guidance -> transition -> motion
//!          -> search -> trajectory -> plan -> verify -> planner -> wire -> jobs -> service, cli
//! ```
//!
//! Everything up to [`planner`] is free of async runtimes, HTTP and wall clocks (except through
//! [`run::Deadline`]); a library user plans without tokio.

pub mod cli;
pub mod collision;
pub mod geometry;
pub mod guidance;
pub mod jobs;
pub mod kinematics;
pub mod mode_graph;
pub mod motion;
pub mod plan;
pub mod planner;
pub mod problem;
pub mod run;
pub mod scenario;
pub mod search;
pub mod service;
pub mod trajectory;
pub mod transition;
pub mod verify;
pub mod wire;
pub mod workcell;
