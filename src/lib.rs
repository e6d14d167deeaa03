//! Quadrille plans for robot arms that work together: picks, places and handoffs, from one
//! arrangement of objects to another, as joint trajectories that a judge has checked.
//!
//! The flow runs one way; each room knows only rooms to its left:
//!
//! ```text
//! run, geometry -> kinematics -> workcell -> problem -> collision -> mode_graph -> guidance
//!     -> transition -> trajectory -> plan -> motion -> search -> verify -> planner
//!     -> scenario, wire -> bench, jobs -> service -> cli
//! ```
//!
//! Some know less than lies to their left: [`guidance`] sees the mode graph alone, [`mode_graph`]
//! learns what can be grounded through [`mode_graph::Reach`], which [`transition`] implements, and
//! [`verify`] shares no code with the planning that it judges.
//!
//! Everything up to [`planner`] is free of async runtimes, HTTP and wall clocks (except through
//! [`run::Deadline`]); a library user plans without tokio.

pub mod bench;
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
