//! The whole pipeline behind one call: mode graph, search, judge, incumbents.

mod event;
mod pipeline;
mod rough;

pub use event::{Outcome, PlannerEvent, Termination};
pub use pipeline::plan;
