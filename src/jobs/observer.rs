//! Telling whoever counts what happens.

use std::time::Duration;

use super::{RetryCause, TerminationReason};

/// Something worth counting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Occurrence {
    /// A job was accepted.
    Accepted,
    /// A planner thread took a job.
    Started {
        /// How long it had waited.
        waited: Duration,
    },
    /// A better plan was published.
    Incumbent {
        /// Time since the job was accepted, when it is the job's first plan.
        first_after: Option<Duration>,
    },
    /// A planner thread is through with an attempt.
    Planned {
        /// How long it was at it.
        busy: Duration,
        /// How much of that went into solving for the guidance, over all threads of the job.
        guidance: Duration,
        /// How much of that into the solver of integer programs.
        programs: Duration,
        /// How often that one was called.
        programs_solved: u64,
    },
    /// A job ended.
    Ended {
        /// Why.
        reason: TerminationReason,
        /// Time since it was accepted.
        after: Duration,
    },
    /// An attempt is over without an end.
    Retried(RetryCause),
    /// The planner panicked.
    Panicked,
    /// The store failed.
    StoreFailed,
}

/// Is told of every [`Occurrence`], by any thread.
pub trait Observer: Send + Sync {
    /// Something has happened. Must be quick.
    fn observe(&self, occurrence: Occurrence);
}

/// Counts nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoObserver;

impl Observer for NoObserver {
    fn observe(&self, _occurrence: Occurrence) {}
}
