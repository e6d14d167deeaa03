//! Where jobs and their durable events are kept.
//!
//! The trait is shaped so that one process with a file ([`super::EmbeddedStore`]) and many processes
//! over a replicated log can both stand behind it: work is taken by [`JobStore::lease`], a lease that
//! is not renewed lapses, whoever finds it lapsed ([`JobStore::abandoned`]) starts the next attempt,
//! and the attempt's number fences off the writer that came too late.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use super::{Event, EventBody, Incumbent, JobId, JobRecord, JobState, Timestamp};

/// What a client asked for, kept so that any later process can run it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobRequest {
    /// The problem as it came, JSON.
    pub problem: Arc<[u8]>,
    /// Digest of the registered workcell that it refers to.
    pub workcell: Option<String>,
    /// A plan to begin from, JSON; the judge has accepted it.
    pub warm_start: Option<Arc<str>>,
    /// What the client has written on the job.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is; higher goes first.
    pub priority: i32,
    /// How long it may wait before it starts.
    pub queue_ttl: Option<Duration>,
    /// Who sent it, as far as the service tells clients apart.
    pub client: String,
    /// By what the client knows the request again.
    pub idempotency: Option<Idempotency>,
}

/// By what a client knows a request again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Idempotency {
    /// The client's key.
    pub key: String,
    /// Digest of the request, by which another one under the same key is told.
    pub digest: String,
}

/// A job to be kept.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// Its id.
    pub id: JobId,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// Its place in the queue; 1 is next.
    pub position: usize,
    /// What is asked for.
    pub request: JobRequest,
}

/// Which plan of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Revision {
    /// The newest.
    Best,
    /// The one with this number.
    Number(u64),
}

/// The right to run a job, until it lapses or the next attempt begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: JobId,
    /// The attempt: what is appended in its name is refused once a later attempt has begun.
    pub attempt: u32,
}

/// Which jobs.
#[derive(Debug, Clone, Default)]
pub struct ListQuery {
    /// Only those older than this one.
    pub before: Option<JobId>,
    /// At most this many.
    pub limit: usize,
    /// Only those in one of these states; all when empty.
    pub states: Vec<JobState>,
    /// Only those that have all these labels, with this value where one is given.
    pub labels: Vec<(String, Option<String>)>,
}

impl ListQuery {
    /// Whether a job is among what is asked for.
    pub fn matches(&self, record: &JobRecord) -> bool {
        let labelled = |(key, value): &(String, Option<String>)| {
            record.labels.get(key).is_some_and(|found| value.as_ref().is_none_or(|value| value == found))
        };
        self.before.is_none_or(|before| record.id < before)
            && (self.states.is_empty() || self.states.contains(&record.state))
            && self.labels.iter().all(labelled)
    }
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
    /// A later attempt at the job has begun.
    #[error("job {job}: attempt {attempt} is over")]
    Fenced {
        /// The job.
        job: JobId,
        /// The attempt that is over.
        attempt: u32,
    },
    /// Someone else runs the job.
    #[error("job {0} is leased to someone else")]
    Leased(JobId),
    /// The job has not ended.
    #[error("job {0} has not ended")]
    NotEnded(JobId),
    /// The idempotency key belongs to a job already.
    #[error("the idempotency key belongs to job {job}")]
    KeyTaken {
        /// The job.
        job: JobId,
        /// Digest of its request.
        digest: String,
    },
    /// What keeps the data does not work.
    #[error("the store failed: {0}")]
    Broken(String),
}

/// A store of jobs. Events are numbered by the store, from 1 without gaps, and an event that
/// `append` has returned is kept: whoever sees an event may rely on it. Reading never consumes.
pub trait JobStore: Send + Sync {
    /// Why nothing can be written any more, when that is so: then the process must end, and the next one
    /// goes on from what was kept.
    fn failure(&self) -> Option<String> {
        None
    }

    /// Keeps a new job and its `queued` event, all or nothing.
    ///
    /// # Errors
    /// [`StoreError::KeyTaken`] when another job has its idempotency key.
    fn create(&self, job: NewJob) -> Result<JobRecord, StoreError>;

    /// The job to which an idempotency key belongs, and the digest of its request.
    ///
    /// # Errors
    /// When the store fails.
    fn keyed(&self, key: &str) -> Result<Option<(JobId, String)>, StoreError>;

    /// Takes the right to run a waiting job until `until`.
    ///
    /// # Errors
    /// [`StoreError::Leased`] when someone else has it, [`StoreError::OutOfTurn`] when the job does
    /// not wait.
    fn lease(&self, job: JobId, now: Timestamp, until: Timestamp) -> Result<Lease, StoreError>;

    /// Keeps the right to run a job until `until`. `now` is remembered as a sign of life.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] when a later attempt has begun.
    fn renew(&self, lease: Lease, now: Timestamp, until: Timestamp) -> Result<(), StoreError>;

    /// Running jobs whose holders are gone, with the last sign of life of each.
    ///
    /// # Errors
    /// When the store fails.
    fn abandoned(&self, now: Timestamp) -> Result<Vec<(JobRecord, Timestamp)>, StoreError>;

    /// Jobs that wait, oldest first.
    ///
    /// # Errors
    /// When the store fails.
    fn waiting(&self) -> Result<Vec<JobRecord>, StoreError>;

    /// Appends a durable event, numbers it and brings the job's record up to date, all or nothing.
    /// With a lease it is appended in the name of that attempt.
    ///
    /// # Errors
    /// [`StoreError::Fenced`] when a later attempt has begun, [`StoreError::OutOfTurn`] when
    /// [`JobRecord::admits`] refuses the event.
    fn append(
        &self,
        job: JobId,
        lease: Option<Lease>,
        at: Timestamp,
        body: EventBody,
    ) -> Result<Arc<Event>, StoreError>;

    /// The job as it is now.
    ///
    /// # Errors
    /// When there is no such job.
    fn record(&self, job: JobId) -> Result<JobRecord, StoreError>;

    /// What the job's client asked for; kept until the job ends.
    ///
    /// # Errors
    /// When there is no such job, or it has ended.
    fn request(&self, job: JobId) -> Result<JobRequest, StoreError>;

    /// The jobs that `query` asks for, newest first.
    ///
    /// # Errors
    /// When the store fails.
    fn list(&self, query: &ListQuery) -> Result<Vec<JobRecord>, StoreError>;

    /// Up to `limit` events whose numbers are above `after`, in order: at least one if there is any,
    /// and fewer than `limit` where their plans are large. They begin later when those
    /// that would come first are kept no longer ([`JobRecord::trimmed`]).
    ///
    /// # Errors
    /// When there is no such job.
    fn events_after(&self, job: JobId, after: u64, limit: usize) -> Result<Vec<Arc<Event>>, StoreError>;

    /// A plan of the job; `None` when it has none of that number, or keeps it no longer.
    ///
    /// # Errors
    /// When there is no such job.
    fn solution(&self, job: JobId, revision: Revision) -> Result<Option<Incumbent>, StoreError>;

    /// Forgets a job that has ended.
    ///
    /// # Errors
    /// [`StoreError::NotEnded`] when it has not.
    fn delete(&self, job: JobId) -> Result<(), StoreError>;

    /// Forgets ended jobs that are older or more than the store is to keep.
    ///
    /// # Errors
    /// When the store fails.
    fn sweep(&self, now: Timestamp) -> Result<(), StoreError>;
}
