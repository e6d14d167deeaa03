//! Plan documents, both ways. What we write comes back as it was, bit for bit.

mod document;
mod metrics;
mod read;

pub use document::{
    ActionDocument, ArmDocument, PlanDocument, PointDocument, VerificationDocument, WitnessDocument,
};
pub use metrics::{MetricsDocument, StepsProofDocument};
pub use read::{read_plan, read_plan_value};

use crate::plan::Plan;
use crate::problem::Problem;

/// The schema that this version reads and writes.
pub const SCHEMA: &str = "quadrille.plan/1";

/// `plan`, which solves `problem`, as JSON on one line without a line break.
pub fn to_json(problem: &Problem, plan: &Plan) -> String {
    // Plain structs with text keys always serialise.
    serde_json::to_string(&PlanDocument::new(problem, plan)).unwrap_or_default()
}

#[cfg(test)]
mod tests;
