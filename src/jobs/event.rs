//! What happens to a job, as its readers see it (FORMAT "Events").

use std::sync::Arc;
use std::time::Duration;

use crate::plan::Metrics;

use super::{JobId, JobState, TerminationReason, Timestamp};

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
    /// An attempt is over without an end: the job waits for the next one.
    Retrying(Retrying),
    /// Stands in for older events that are kept no longer: made for a reader, never stored. Its
    /// number is that of the last event that is gone.
    Snapshot(Snapshot),
    /// The end; the last event of every job.
    Terminal(Terminal),
}

impl EventBody {
    /// Whether the event is kept and numbered.
    pub fn is_durable(&self) -> bool {
        !matches!(self, EventBody::Progress(_) | EventBody::Snapshot(_))
    }

    /// Whether a reader that has seen the event may resume from its number.
    pub fn is_resumable(&self) -> bool {
        !matches!(self, EventBody::Progress(_))
    }

    /// The name of its type on the wire.
    pub fn kind(&self) -> &'static str {
        match self {
            EventBody::Queued { .. } => "queued",
            EventBody::Started => "started",
            EventBody::Progress(_) => "progress",
            EventBody::Incumbent(_) => "incumbent",
            EventBody::Retrying(_) => "retrying",
            EventBody::Snapshot(_) => "snapshot",
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

/// Why an attempt is over without an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RetryCause {
    /// The process that ran it is gone.
    WorkerLost,
    /// The process that ran it was told to end, and gave the job back.
    Shutdown,
}

impl RetryCause {
    /// The name on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            RetryCause::WorkerLost => "worker_lost",
            RetryCause::Shutdown => "shutdown",
        }
    }
}

/// An attempt is over without an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retrying {
    /// The attempt that comes next. Whoever held an earlier one is fenced off.
    pub attempt: u32,
    /// Why.
    pub cause: RetryCause,
    /// What the attempt that is over used of the time budget.
    pub spent: Duration,
}

/// What a reader must know of events that are gone.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// The job's state.
    pub state: JobState,
    /// Figures of its best plan.
    pub metrics: Option<Metrics>,
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
