//! What happens to a job, as its readers see it (FORMAT "Events").

use std::sync::Arc;

use crate::plan::Metrics;

use super::{JobId, TerminationReason, Timestamp};

/// One event of one job.
#[derive(Debug, Clone)]
pub struct Event {
    /// Its number within the job, from 1 without gaps. An ephemeral event carries the number of the
    /// last durable one before it.
    pub seq: u64,
    /// The job.
    pub job: JobId,
    /// Which attempt at the job it belongs to, from 1.
    pub attempt: u32,
    /// When it happened.
    pub at: Timestamp,
    /// What happened.
    pub body: EventBody,
}

/// What happened.
#[derive(Debug, Clone)]
pub enum EventBody {
    /// The job entered the queue.
    Queued {
        /// Its place in it; 1 is next.
        position: usize,
    },
    /// A planner thread took it.
    Started,
    /// A sign of life: ephemeral, may be dropped.
    Progress(Progress),
    /// A better plan, accepted by the judge.
    Incumbent(Incumbent),
    /// The end; the last event of every job.
    Terminal(Terminal),
}

impl EventBody {
    /// Whether the event is kept and numbered.
    pub fn is_durable(&self) -> bool {
        !matches!(self, EventBody::Progress(_))
    }

    /// The name of its type on the wire.
    pub fn kind(&self) -> &'static str {
        match self {
            EventBody::Queued { .. } => "queued",
            EventBody::Started => "started",
            EventBody::Progress(_) => "progress",
            EventBody::Incumbent(_) => "incumbent",
            EventBody::Terminal(_) => "terminal",
        }
    }
}

/// How far a run is.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Seconds since the run started, validation included.
    pub elapsed_s: f64,
    /// What it is doing.
    pub phase: &'static str,
    /// Iterations of Algorithm 1.
    pub iterations: u64,
    /// Lower bound on the steps of any synchronised plan, once known.
    pub steps_lower_bound: Option<usize>,
}

/// A better plan.
#[derive(Debug, Clone)]
pub struct Incumbent {
    /// Counts the incumbents of the job, from 1.
    pub revision: u64,
    /// Its figures.
    pub metrics: Metrics,
    /// The plan as its JSON document, written once and shared by all readers.
    pub document: Arc<str>,
}

/// The end of a job.
#[derive(Debug, Clone)]
pub struct Terminal {
    /// Why it ended; the state follows from it.
    pub reason: TerminationReason,
    /// Figures of the best plan.
    pub metrics: Option<Metrics>,
    /// The likely cause, when there is no plan.
    pub diagnosis: Option<String>,
}
