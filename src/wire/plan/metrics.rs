//! A plan's figures as a document.

use serde::{Deserialize, Serialize};

use crate::plan::{Metrics, StepsProof};

/// `metrics` of FORMAT's plan, event and job documents.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MetricsDocument {
    /// Duration (s).
    pub duration_s: f64,
    /// Duration of the synchronous schedule that it came from (s).
    pub duration_synchronous_s: f64,
    /// The largest over the arms of the Euclidean length of its joint path.
    pub arc_length: f64,
    /// Picks, places and handoffs.
    pub actions: usize,
    /// Synchronised steps with at least one action.
    pub steps: usize,
    /// The proved optimum on the mode graph that guided, or null.
    pub mode_graph_optimum: Option<usize>,
    /// Lower bound over all synchronised plans with the given grasps.
    pub steps_lower_bound: usize,
    /// How the optimum was proved.
    pub steps_proof: StepsProofDocument,
    /// When the verified plan was published (s since the run's start).
    pub found_after_s: f64,
}

/// `steps_proof`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepsProofDocument {
    /// Not proved.
    None,
    /// Bounds met.
    Bounds,
    /// By an integer program.
    Ilp,
}

impl From<&Metrics> for MetricsDocument {
    fn from(metrics: &Metrics) -> Self {
        Self {
            duration_s: metrics.duration_s,
            duration_synchronous_s: metrics.duration_synchronous_s,
            arc_length: metrics.arc_length,
            actions: metrics.actions,
            steps: metrics.steps,
            mode_graph_optimum: metrics.mode_graph_optimum,
            steps_lower_bound: metrics.steps_lower_bound,
            steps_proof: match metrics.steps_proof {
                StepsProof::None => StepsProofDocument::None,
                StepsProof::Bounds => StepsProofDocument::Bounds,
                StepsProof::Ilp => StepsProofDocument::Ilp,
            },
            found_after_s: metrics.found_after_s,
        }
    }
}

impl From<MetricsDocument> for Metrics {
    fn from(document: MetricsDocument) -> Self {
        Self {
            duration_s: document.duration_s,
            duration_synchronous_s: document.duration_synchronous_s,
            arc_length: document.arc_length,
            actions: document.actions,
            steps: document.steps,
            mode_graph_optimum: document.mode_graph_optimum,
            steps_lower_bound: document.steps_lower_bound,
            steps_proof: match document.steps_proof {
                StepsProofDocument::None => StepsProof::None,
                StepsProofDocument::Bounds => StepsProof::Bounds,
                StepsProofDocument::Ilp => StepsProof::Ilp,
            },
            found_after_s: document.found_after_s,
        }
    }
}
