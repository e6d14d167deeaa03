//! The documents of FORMAT.md and their conversion to and from the domain types.
//!
//! The only room that gives JSON its shape; the core never does. What is read is walked value by
//! value, so that all faults come back at once; what is written goes through serde.

mod digest;
mod fault;
mod json;
pub mod plan;
mod pose;
mod problem;
mod reader;
mod resources;

pub use fault::{Fault, FaultCode};
pub use json::parse as parse_json;
pub use pose::{PoseDocument, QuaternionDocument, VectorDocument};
pub use problem::{ReadLimits, ReadProblem, read_problem, read_problem_value};
pub use resources::{Folder, LibraryOnly, ResourceError, Resources};
