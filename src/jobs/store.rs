//! Where jobs and their durable events are kept.

use std::sync::Arc;

use super::{Event, EventBody, Incumbent, JobId, JobRecord, JobState, Timestamp};

/// A job to be kept.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Its id.
    pub id: JobId,
    /// When it was accepted.
    pub created_at: Timestamp,
}

/// Which plan of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Revision {
    /// The newest.
    Best,
    /// The one with this number.
    Number(u64),
}

/// Why the store did not do as asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// There is no such job, or it is kept no longer.
    #[error("there is no job {0}")]
    UnknownJob(JobId),
    /// The event may not follow on what has happened to the job.
    #[error("job {job} is {}: no `{event}` event may follow", .state.as_str())]
    OutOfTurn {
        /// The job.
        job: JobId,
        /// Its state.
        state: JobState,
        /// The refused event's type.
        event: &'static str,
    },
}

/// A store of jobs. Events are numbered by the store, from 1 without gaps, and an event that
/// `append` has returned is kept: whoever sees an event may rely on it. Reading never consumes.
pub trait JobStore: Send + Sync {
    /// Keeps a new job, with no events yet.
    ///
    /// # Errors
    /// When the store fails.
    fn create(&self, job: NewJob) -> Result<(), StoreError>;

    /// Appends a durable event, numbers it and brings the job's record up to date, all or nothing.
    ///
    /// # Errors
    /// [`StoreError::OutOfTurn`] when [`JobRecord::admits`] refuses the event.
    fn append(&self, job: JobId, at: Timestamp, body: EventBody) -> Result<Arc<Event>, StoreError>;

    /// The job as it is now.
    ///
    /// # Errors
    /// When there is no such job.
    fn record(&self, job: JobId) -> Result<JobRecord, StoreError>;

    /// Up to `limit` jobs, newest first; only those older than `before` when that is given.
    ///
    /// # Errors
    /// When the store fails.
    fn list(&self, before: Option<JobId>, limit: usize) -> Result<Vec<JobRecord>, StoreError>;

    /// Up to `limit` events whose numbers are above `after`, in order.
    ///
    /// # Errors
    /// When there is no such job.
    fn events_after(&self, job: JobId, after: u64, limit: usize) -> Result<Vec<Arc<Event>>, StoreError>;

    /// A plan of the job; `None` when it has none of that number.
    ///
    /// # Errors
    /// When there is no such job.
    fn solution(&self, job: JobId, revision: Revision) -> Result<Option<Incumbent>, StoreError>;
}
