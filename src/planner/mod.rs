//! The whole pipeline behind one call: mode graph, search, judge, incumbents.

mod cache;
mod event;
mod folder;
mod pipeline;

pub use cache::PlannerCache;
pub use event::{Outcome, PlannerEvent, Termination};
pub use pipeline::{improve_with, plan, plan_with, settled_mode_graph};

#[cfg(test)]
mod folder_tests;
#[cfg(test)]
mod problem_tests;
#[cfg(test)]
mod tests;
