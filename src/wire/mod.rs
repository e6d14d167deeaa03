//! The documents of FORMAT.md and their conversion to and from the domain types.
//!
//! The only room that gives JSON its shape; the core never does. What is read is walked value by
//! value, so that all faults come back at once; what is written goes through serde.

mod canonical;
mod digest;
mod fault;
mod job;
mod json;
pub mod plan;
mod pose;
mod problem;
mod reader;
mod resources;
mod workcell;

pub use digest::{digest_of, sha256};
pub use fault::{Fault, FaultCode};
pub use job::{JobFields, MAX_LABEL_VALUE, MAX_LABELS, MAX_PRIORITY, read_job};
pub use json::{parse as parse_json, parse_bounded as parse_json_bounded};
pub use pose::{PoseDocument, QuaternionDocument, VectorDocument};
pub use problem::{
    KnownRobots, ReadLimits, ReadProblem, read_around_workcell, read_problem, read_problem_value,
};
pub use reader::is_id;
pub use resources::{Folder, LibraryOnly, Remembering, ResourceError, Resources, normalise};
pub use workcell::{ReadWorkcell, read_workcell_value, unknown_workcell, with_workcell, workcell_reference};
