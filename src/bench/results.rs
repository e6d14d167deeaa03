//! What was measured, as `results.json` holds it.

use serde::{Deserialize, Serialize};

use super::machine::{Conditions, Machine};

/// The whole document.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// `quadrille.bench/1`.
    pub schema: String,
    /// Where it was measured.
    pub machine: Machine,
    /// What else was going on.
    pub conditions: Conditions,
    /// What was asked for.
    pub setup: Setup,
    /// One entry per run, in the order of the runs.
    pub runs: Vec<Run>,
    /// Runs of which there is more to say.
    #[serde(default)]
    pub remarks: Vec<Remark>,
}

impl Results {
    /// The document's kind and version.
    pub const SCHEMA: &'static str = "quadrille.bench/1";

    /// The document as JSON text, one line per run.
    ///
    /// # Errors
    /// When a part cannot be written as JSON.
    pub fn to_json(&self) -> serde_json::Result<String> {
        let mut out = String::from("{\n");
        let mut field = |name: &str, value: String| out.push_str(&format!("\"{name}\": {value},\n"));
        field("schema", serde_json::to_string(&self.schema)?);
        field("machine", serde_json::to_string(&self.machine)?);
        field("conditions", serde_json::to_string(&self.conditions)?);
        field("setup", serde_json::to_string(&self.setup)?);
        field("runs", lines(&self.runs)?);
        out.push_str(&format!("\"remarks\": {}\n}}\n", lines(&self.remarks)?));
        Ok(out)
    }
}

/// A list with a line per member.
fn lines<T: Serialize>(list: &[T]) -> serde_json::Result<String> {
    let members = list.iter().map(serde_json::to_string).collect::<serde_json::Result<Vec<_>>>()?;
    Ok(if members.is_empty() { "[]".to_owned() } else { format!("[\n{}\n]", members.join(",\n")) })
}

/// Whether the workcell is known before a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WorkcellAge {
    /// Nothing is known: what is compiled of the workcell is part of the run.
    New,
    /// Another arrangement in the same workcell was planned before the run, in the same process.
    Known,
    /// The same in an earlier process, which has left its knowledge in a folder.
    Stored,
}

/// What holds for all runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Trials per family, size and guidance; trial n has scenario seed and planner seed n.
    pub trials: u64,
    /// Time budget of a run (s), validation included.
    pub budget_s: f64,
    /// Planner threads.
    pub threads: usize,
    /// Whether the workcell is known before a run.
    pub workcell: WorkcellAge,
    /// Whether runs ended at their first plan.
    pub first_solution: bool,
}

/// Which run.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunKey {
    /// The family.
    pub family: String,
    /// The size, such as `9x4`.
    pub size: String,
    /// The guidance.
    pub guidance: String,
    /// The trial.
    pub trial: u64,
}

/// One run. Figures of plans are null where there is none; times are seconds since the run's start,
/// at which the problem lay in memory as bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The family.
    pub family: String,
    /// Arms x objects.
    pub size: String,
    /// The guidance.
    pub guidance: String,
    /// The trial, which is the scenario's and the planner's seed.
    pub trial: u64,
    /// Whether it ended with a plan that the judge accepts.
    pub solved: bool,
    /// When the first accepted plan was complete, before the judge looked at it.
    pub candidate_s: Option<f64>,
    /// When the first accepted plan was published.
    pub first_plan_s: Option<f64>,
    /// Synchronised steps of the last plan.
    pub steps: Option<usize>,
    /// The proved optimum of steps on the mode graph, where there is a proof.
    pub mode_graph_optimum: Option<usize>,
    /// Lower bound on the steps of any synchronised plan.
    pub steps_lower_bound: Option<usize>,
    /// Picks, places and handoffs of the last plan.
    pub actions: Option<usize>,
    /// Duration (s) of the first plan.
    pub duration_first_s: Option<f64>,
    /// Duration (s) of the last plan.
    pub duration_s: Option<f64>,
    /// What the last plan's duration (s) cannot fall below with the same rests at the ends of steps:
    /// [`super::duration_lower_bound`].
    pub duration_lower_bound_s: Option<f64>,
    /// Arc length of the last plan.
    pub arc_length: Option<f64>,
    /// Most memory in use (10^6 bytes), of the process since the run's start.
    pub peak_rss_mb: Option<f64>,
    /// When each plan was published, and its duration (s).
    pub incumbents: Vec<(f64, f64)>,
    /// Where the time to the first plan went; to the end where there is none.
    pub phases: Phases,
}

/// Seconds spent on the way to the first plan; null for what was not reached.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Phases {
    /// Reading and validating the document.
    pub validation_s: Option<f64>,
    /// Compiling the workcell: bodies, roadmaps.
    pub workcell_s: Option<f64>,
    /// Building the mode graph.
    pub mode_graph_s: Option<f64>,
    /// Bounds, and the first answer of the guidance.
    pub guidance_s: Option<f64>,
    /// The search, but for timing and judging.
    pub search_s: Option<f64>,
    /// Timing of paths: their curves, and the delays under which arms pass each other. In documents of versions before it
    /// was told apart there is none, and the search has it.
    pub timing_s: Option<f64>,
    /// Judging, rejected candidates included.
    pub judge_s: Option<f64>,
}

impl Phases {
    /// Their names, in order, as in documents.
    pub const NAMES: [&'static str; 7] =
        ["validation_s", "workcell_s", "mode_graph_s", "guidance_s", "search_s", "timing_s", "judge_s"];

    /// The values in the order of [`Self::NAMES`].
    pub fn values(&self) -> [Option<f64>; 7] {
        let &Self { validation_s, workcell_s, mode_graph_s, guidance_s, search_s, timing_s, judge_s } = self;
        [validation_s, workcell_s, mode_graph_s, guidance_s, search_s, timing_s, judge_s]
    }

    /// From values in the order of [`Self::NAMES`].
    pub fn from_values(values: [Option<f64>; 7]) -> Self {
        let [validation_s, workcell_s, mode_graph_s, guidance_s, search_s, timing_s, judge_s] = values;
        Self { validation_s, workcell_s, mode_graph_s, guidance_s, search_s, timing_s, judge_s }
    }
}

impl Run {
    /// Which run it is.
    pub fn key(&self) -> RunKey {
        RunKey {
            family: self.family.clone(),
            size: self.size.clone(),
            guidance: self.guidance.clone(),
            trial: self.trial,
        }
    }

    /// The last plan's duration over its lower bound.
    pub fn duration_ratio(&self) -> Option<f64> {
        let (duration, bound) = (self.duration_s?, self.duration_lower_bound_s?);
        (bound > 0.0).then(|| duration / bound)
    }
}

/// More about a run: candidates that the judge rejected, and why there is no plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remark {
    /// The family.
    pub family: String,
    /// The size.
    pub size: String,
    /// The guidance.
    pub guidance: String,
    /// The trial.
    pub trial: u64,
    /// Candidates that the judge rejected.
    pub rejected: u64,
    /// The likely cause, when there is no plan.
    pub cause: Option<String>,
}
