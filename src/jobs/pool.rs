//! The job layer's face: takes requests in, tells what happens, starts and stops the threads.

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::plan::Plan;
use crate::problem::Problem;

use super::live::Live;
use super::queue::{Queue, Ready};
use super::{
    Event, EventBody, JobId, JobRecord, JobRequest, JobStore, Lease, NewJob, Observer, Occurrence, Planner,
    ProblemReader, QueueRefusal, RetryCause, Retrying, StoreError, Subscription, Terminal, TerminationReason,
    Timestamp,
};

/// How often [`Jobs::stop`] looks whether the threads have ended.
const STOP_POLL: Duration = Duration::from_millis(5);
/// How many events are looked at at once.
const BATCH: usize = 64;

/// Settings of the pool and its queue.
#[derive(Debug, Clone, Copy)]
pub struct JobsConfig {
    /// Planner threads; at least 1.
    pub workers: usize,
    /// Most jobs that wait for a thread.
    pub queue_limit: usize,
    /// Most jobs of one client that wait or run.
    pub client_limit: usize,
    /// How much earlier than it came a job counts as having come, for each step of priority.
    pub aging: Duration,
    /// How long a lease holds without a sign of life.
    pub lease: Duration,
    /// How many attempts may be lost with their processes before the job fails.
    pub attempts: u32,
}

impl Default for JobsConfig {
    /// One planner thread less than there are processors, but at least one.
    fn default() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            workers: processors.saturating_sub(1).max(1),
            queue_limit: 64,
            client_limit: usize::MAX,
            aging: Duration::from_secs(30),
            lease: Duration::from_secs(15),
            attempts: 3,
        }
    }
}

/// A job to be run.
#[derive(Debug)]
pub struct Submission {
    /// What the client asked for.
    pub request: JobRequest,
    /// The problem in it, read.
    pub problem: Problem,
    /// The plan to begin from in it, read and judged.
    pub warm_start: Option<Plan>,
    /// What the client's wait has used of the time budget already: the time of validation.
    pub spent: Duration,
}

/// What a call for cancellation found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cancelled {
    /// The job waited, and has ended.
    Waiting,
    /// The job runs, and has been told to stop.
    Running,
    /// The job had ended before.
    Ended,
}

/// How busy the pool is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load {
    /// Planner threads.
    pub workers: usize,
    /// Jobs that run.
    pub running: usize,
    /// Jobs that wait.
    pub waiting: usize,
}

/// What the job layer works with.
#[derive(Clone)]
pub struct Parts {
    /// Where jobs are kept.
    pub store: Arc<dyn JobStore>,
    /// What runs them.
    pub planner: Arc<dyn Planner>,
    /// What reads them again after a restart.
    pub reader: Arc<dyn ProblemReader>,
    /// Who counts.
    pub observer: Arc<dyn Observer>,
}

/// The job layer: takes problems in, runs them on planner threads, and tells what happens.
///
/// Cheap to share behind an `Arc`. Dropping it stops the threads.
pub struct Jobs {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

pub(super) struct Shared {
    pub config: JobsConfig,
    pub parts: Parts,
    queue: Mutex<Queue>,
    /// A job has come, or the end.
    pub changed: Condvar,
    /// As `changed`, for the keeper.
    pub kept: Condvar,
    live: Mutex<BTreeMap<JobId, Arc<Live>>>,
}

/// A promise of a place in the queue; given back when dropped.
pub struct Ticket {
    shared: Arc<Shared>,
    client: String,
}

impl Drop for Ticket {
    fn drop(&mut self) {
        self.shared.queue().release(&self.client);
    }
}

impl Jobs {
    /// Takes up what an earlier process has left, and starts the planner threads.
    ///
    /// # Errors
    /// When the system gives no thread, or the store fails.
    pub fn start(config: JobsConfig, parts: Parts) -> std::io::Result<Self> {
        let config = JobsConfig { workers: config.workers.max(1), ..config };
        let shared = Arc::new(Shared {
            config,
            parts,
            queue: Mutex::default(),
            changed: Condvar::new(),
            kept: Condvar::new(),
            live: Mutex::default(),
        });
        shared.take_up().map_err(std::io::Error::other)?;
        let jobs = Self { shared: Arc::clone(&shared), threads: Mutex::default() };
        for number in 0..config.workers {
            // Searches recurse over steps and objects; the default of 2 MiB is meagre.
            jobs.spawn(format!("planner-{number}"), 16 << 20, Shared::work)?;
        }
        jobs.spawn("job-keeper".to_owned(), 2 << 20, Shared::keep)?;
        Ok(jobs)
    }

    fn spawn(&self, name: String, stack: usize, work: fn(&Shared)) -> std::io::Result<()> {
        let shared = Arc::clone(&self.shared);
        let builder = std::thread::Builder::new().name(name).stack_size(stack);
        let thread = builder.spawn(move || work(&shared))?;
        self.threads.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
        Ok(())
    }

    /// Reserves a place for a job of `client`, before the work of validating a problem is begun.
    ///
    /// # Errors
    /// When there is none.
    pub fn reserve(&self, client: &str) -> Result<Ticket, QueueRefusal> {
        self.shared.queue().reserve(client, &self.shared.config)?;
        Ok(Ticket { shared: Arc::clone(&self.shared), client: client.to_owned() })
    }

    /// Accepts a job on a reserved place. When this returns, the job and its `queued` event are in
    /// the store.
    ///
    /// # Errors
    /// When the store fails, or another job has the idempotency key.
    pub fn submit(&self, ticket: Ticket, submission: Submission) -> Result<JobRecord, StoreError> {
        let shared = &self.shared;
        let Submission { request, problem, warm_start, spent } = submission;
        let job = JobId::fresh();
        shared.live().insert(job, Arc::default());
        // The queue stays locked until the job is in it, so that nobody finds the job in the store
        // and not in the queue.
        let mut queue = shared.queue();
        let position = queue.waiting() + 1;
        let new = NewJob { id: job, created_at: Timestamp::now(), position, request };
        let kept = shared.parts.store.create(new);
        match &kept {
            Ok(record) => {
                queue.push(record, Some(Box::new(Ready { problem, warm_start, spent })), shared.config.aging);
            }
            Err(_) => {
                shared.live().remove(&job);
            }
        }
        drop(queue);
        drop(ticket);
        if kept.is_ok() {
            shared.parts.observer.observe(Occurrence::Accepted);
        }
        shared.changed.notify_one();
        shared.kept.notify_one();
        kept
    }

    /// The job as it is now, and its place in the queue while it waits (1 is next).
    ///
    /// # Errors
    /// When there is no such job.
    pub fn record(&self, job: JobId) -> Result<(JobRecord, Option<usize>), StoreError> {
        let place = self.queue_position(job);
        Ok((self.shared.parts.store.record(job)?, place))
    }

    /// The job's place in the queue while it waits; 1 is next.
    pub fn queue_position(&self, job: JobId) -> Option<usize> {
        self.shared.queue().position(job)
    }

    /// The store, for what is only read, and for deleting.
    pub fn store(&self) -> &dyn JobStore {
        &*self.shared.parts.store
    }

    /// Follows a job's events, from the one after number `after` on; there may not be that many yet.
    ///
    /// # Errors
    /// When there is no such job.
    pub fn subscribe(&self, job: JobId, after: u64) -> Result<Subscription, StoreError> {
        // A job that is not in `live` has ended: all its events are in the store.
        let live = self.shared.live().get(&job).cloned().unwrap_or_default();
        let newest = self.shared.parts.store.record(job)?.last_seq;
        Ok(Subscription::new(job, Arc::clone(&self.shared.parts.store), live, after, newest))
    }

    /// Up to `limit` `incumbent` events of a job whose revisions are `from` or above, in order.
    ///
    /// # Errors
    /// When there is no such job.
    pub fn incumbents(&self, job: JobId, from: u64, limit: usize) -> Result<Vec<Arc<Event>>, StoreError> {
        let store = &self.shared.parts.store;
        // Before the first incumbent stand two events at least: the revision is a bound on the number.
        let mut after = from.max(1).max(store.record(job)?.trimmed);
        let mut found = Vec::new();
        while found.len() < limit {
            let events = store.events_after(job, after, BATCH)?;
            let Some(last) = events.last() else { break };
            after = last.seq;
            found.extend(events.into_iter().filter(
                |event| matches!(&event.body, EventBody::Incumbent(incumbent) if incumbent.revision >= from),
            ));
        }
        found.truncate(limit);
        Ok(found)
    }

    /// Cancels a job. One that waits ends at once; one that runs ends, with its best plan kept, as
    /// soon as the planner looks at its token.
    ///
    /// # Errors
    /// When there is no such job.
    pub fn cancel(&self, job: JobId) -> Result<Cancelled, StoreError> {
        let shared = &self.shared;
        let mut queue = shared.queue();
        if let Some(running) = queue.running.get_mut(&job) {
            running.cancelled = true;
            running.control.cancel.cancel();
            return Ok(Cancelled::Running);
        }
        let waited = queue.remove(job).is_some();
        drop(queue);
        if !waited {
            return shared.parts.store.record(job).map(|_| Cancelled::Ended);
        }
        let diagnosis = "cancelled before it started".to_owned();
        shared.end(job, None, TerminationReason::ClientCancel, Some(diagnosis));
        Ok(Cancelled::Waiting)
    }

    /// How busy the pool is.
    pub fn load(&self) -> Load {
        let queue = self.shared.queue();
        Load { workers: self.shared.config.workers, running: queue.running.len(), waiting: queue.waiting() }
    }

    /// Takes in nothing more and stops the running jobs where they are, without a terminal event:
    /// they have not ended, the process does. What has run goes back to the queue, for the next
    /// process. Waits up to `patience` for the threads, and returns whether all have ended; the
    /// jobs of those that have not are taken from them.
    pub fn stop(&self, patience: Duration) -> bool {
        let mut queue = self.shared.queue();
        queue.stopping = true;
        queue.running.values().for_each(|running| running.control.cancel.cancel());
        drop(queue);
        self.shared.changed.notify_all();
        self.shared.kept.notify_all();
        let mut threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        let began = Instant::now();
        while !threads.is_empty() && began.elapsed() < patience {
            std::thread::sleep(STOP_POLL);
            threads.retain(|thread| !thread.is_finished());
        }
        threads.retain(|thread| !thread.is_finished());
        let late = std::mem::take(&mut self.shared.queue().running);
        for (job, running) in late {
            self.shared.give_back(job, running.since);
        }
        threads.is_empty()
    }
}

impl Drop for Jobs {
    fn drop(&mut self) {
        self.stop(Duration::ZERO);
    }
}

impl Shared {
    pub fn queue(&self) -> MutexGuard<'_, Queue> {
        // No planner code runs under this lock, and nothing below panics halfway through a change.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn live(&self) -> MutexGuard<'_, BTreeMap<JobId, Arc<Live>>> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts what waits in the store, and what was lost with another process, into the queue.
    fn take_up(&self) -> Result<(), StoreError> {
        self.retry_lost()?;
        let mut queue = self.queue();
        for record in self.parts.store.waiting()? {
            self.live().insert(record.id, Arc::default());
            queue.push(&record, None, self.config.aging);
        }
        Ok(())
    }

    /// Starts the next attempt at jobs whose holders are gone, or ends those that were lost too
    /// often. Gives the records of the former.
    pub fn retry_lost(&self) -> Result<Vec<JobRecord>, StoreError> {
        let mut back = Vec::new();
        for (record, alive) in self.parts.store.abandoned(Timestamp::now())? {
            let job = record.id;
            if record.lost + 1 >= self.config.attempts {
                let diagnosis = format!(
                    "{} attempts were lost with the processes that ran them; the job may be what ends them",
                    record.lost + 1
                );
                self.end(job, None, TerminationReason::WorkerLost, Some(diagnosis));
                continue;
            }
            let spent = record.started_at.map_or(Duration::ZERO, |started| alive.since(started));
            let retrying = Retrying { attempt: record.attempt + 1, cause: RetryCause::WorkerLost, spent };
            if self.publish(job, None, EventBody::Retrying(retrying)).is_some() {
                tracing::warn!(%job, attempt = retrying.attempt, "the job's worker was lost; it is tried again");
                self.parts.observer.observe(Occurrence::Retried(RetryCause::WorkerLost));
                back.push(self.parts.store.record(job)?);
            }
        }
        Ok(back)
    }

    /// Gives a running job back because the process ends.
    pub fn give_back(&self, job: JobId, since: Timestamp) {
        let Ok(record) = self.parts.store.record(job) else { return };
        let spent = Timestamp::now().since(since);
        let retrying = Retrying { attempt: record.attempt + 1, cause: RetryCause::Shutdown, spent };
        if record.admits(&EventBody::Retrying(retrying))
            && self.publish(job, None, EventBody::Retrying(retrying)).is_some()
        {
            tracing::info!(%job, attempt = retrying.attempt, "the job goes on at the next start");
            self.parts.observer.observe(Occurrence::Retried(RetryCause::Shutdown));
        }
    }

    /// Ends a job, wakes its readers for the last time and lets go of them.
    pub fn end(
        &self,
        job: JobId,
        lease: Option<Lease>,
        reason: TerminationReason,
        diagnosis: Option<String>,
    ) {
        let record = self.parts.store.record(job).ok();
        let created = record.as_ref().map(|record| record.created_at);
        let metrics = record.and_then(|record| record.best).map(|best| best.metrics);
        let ended = self.publish(job, lease, EventBody::Terminal(Terminal { reason, metrics, diagnosis }));
        self.live().remove(&job);
        if let Some(event) = ended {
            let after = created.map_or(Duration::ZERO, |created| event.at.since(created));
            self.parts.observer.observe(Occurrence::Ended { reason, after });
            tracing::info!(%job, reason = reason.as_str(), "job ended");
        }
    }

    /// Appends a durable event and wakes the job's readers. `None` when the store refuses.
    pub fn publish(&self, job: JobId, lease: Option<Lease>, body: EventBody) -> Option<Arc<Event>> {
        match self.parts.store.append(job, lease, Timestamp::now(), body) {
            Ok(event) => {
                let live = self.live().get(&job).cloned();
                if let Some(live) = live {
                    live.wake();
                }
                Some(event)
            }
            Err(error) => {
                tracing::error!(%job, %error, "the store refused an event");
                if matches!(error, StoreError::Broken(_)) {
                    self.parts.observer.observe(Occurrence::StoreFailed);
                }
                None
            }
        }
    }
}
