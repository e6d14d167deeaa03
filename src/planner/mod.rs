//! The whole pipeline behind one call: mode graph, search, judge, incumbents.

mod event;
mod pipeline;

pub use event::{Outcome, PlannerEvent, Termination};
pub use pipeline::plan;
