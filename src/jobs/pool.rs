//! The queue and the planner threads.

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::plan::Plan;
use crate::planner::{Outcome, PlannerEvent, Termination};
use crate::problem::Problem;
use crate::run::{CancelToken, Control, Deadline};

use super::live::Live;
use super::{
    Event, EventBody, Incumbent, JobId, JobRecord, JobStore, NewJob, Planner, Progress, StoreError,
    Subscription, Terminal, TerminationReason, Timestamp,
};

/// Least time between two signs of life of one job.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(1);
/// How often [`Jobs::stop`] looks whether the threads have ended.
const STOP_POLL: Duration = Duration::from_millis(5);

/// Sizes of the pool.
#[derive(Debug, Clone, Copy)]
pub struct JobsConfig {
    /// Planner threads; at least 1.
    pub workers: usize,
    /// Most jobs that wait for a thread.
    pub queue_limit: usize,
}

/// A job to be run.
#[derive(Debug)]
pub struct Submission {
    /// What to plan.
    pub problem: Problem,
    /// What the client's wait has used of the time budget already: the time of validation.
    pub spent: Duration,
}

/// The queue does not take a job now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum QueueRefusal {
    /// As many jobs wait as may.
    #[error("{limit} jobs are waiting already; try again in {retry_after_s} s")]
    Full {
        /// How many may wait.
        limit: usize,
        /// When a place may be free (s).
        retry_after_s: u64,
    },
    /// The service is about to end.
    #[error("the service is shutting down")]
    Stopping,
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

/// The job layer: takes problems in, runs them on planner threads, and tells what happens.
///
/// Cheap to share behind an `Arc`. Dropping it stops the threads.
pub struct Jobs {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

struct Shared {
    config: JobsConfig,
    store: Arc<dyn JobStore>,
    planner: Arc<dyn Planner>,
    queue: Mutex<Queue>,
    changed: Condvar,
    live: Mutex<BTreeMap<JobId, Arc<Live>>>,
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<Waiting>,
    running: BTreeMap<JobId, Control>,
    /// Places promised to jobs that are being validated.
    reserved: usize,
    stopping: bool,
}

struct Waiting {
    job: JobId,
    submission: Submission,
}

/// A promise of a place in the queue; given back when dropped.
pub struct Ticket {
    shared: Arc<Shared>,
}

impl Drop for Ticket {
    fn drop(&mut self) {
        self.shared.queue().reserved -= 1;
    }
}

impl Jobs {
    /// Starts the planner threads.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(
        config: JobsConfig,
        store: Arc<dyn JobStore>,
        planner: Arc<dyn Planner>,
    ) -> std::io::Result<Self> {
        let config = JobsConfig { workers: config.workers.max(1), ..config };
        let shared = Arc::new(Shared {
            config,
            store,
            planner,
            queue: Mutex::default(),
            changed: Condvar::new(),
            live: Mutex::default(),
        });
        let jobs = Self { shared: Arc::clone(&shared), threads: Mutex::default() };
        for number in 0..config.workers {
            let shared = Arc::clone(&shared);
            let thread = std::thread::Builder::new()
                .name(format!("planner-{number}"))
                // Searches recurse over steps and objects; the default of 2 MiB is meagre.
                .stack_size(16 << 20)
                .spawn(move || shared.work())?;
            jobs.threads.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
        }
        Ok(jobs)
    }

    /// Reserves a place, before the work of validating a problem is begun.
    ///
    /// # Errors
    /// When there is none.
    pub fn reserve(&self) -> Result<Ticket, QueueRefusal> {
        let config = self.shared.config;
        let mut queue = self.shared.queue();
        if queue.stopping {
            return Err(QueueRefusal::Stopping);
        }
        let taken = queue.running.len() + queue.waiting.len() + queue.reserved;
        if taken >= config.workers + config.queue_limit {
            return Err(QueueRefusal::Full {
                limit: config.queue_limit,
                retry_after_s: queue.retry_after_s(),
            });
        }
        queue.reserved += 1;
        Ok(Ticket { shared: Arc::clone(&self.shared) })
    }

    /// Accepts a job on a reserved place. When this returns, the job and its `queued` event are in
    /// the store.
    ///
    /// # Errors
    /// When the store fails.
    pub fn submit(&self, ticket: Ticket, submission: Submission) -> Result<JobRecord, StoreError> {
        let shared = &self.shared;
        let job = JobId::fresh();
        shared.live().insert(job, Arc::default());
        // The queue stays locked until the job is in it, so that `queued` precedes `started`.
        let mut queue = shared.queue();
        let position = queue.waiting.len() + 1;
        let kept = shared
            .store
            .create(NewJob { id: job, created_at: Timestamp::now() })
            .and_then(|()| shared.store.append(job, Timestamp::now(), EventBody::Queued { position }))
            .and_then(|_| shared.store.record(job));
        if kept.is_ok() {
            queue.waiting.push_back(Waiting { job, submission });
        } else {
            shared.live().remove(&job);
        }
        drop(queue);
        drop(ticket);
        shared.changed.notify_one();
        kept
    }

    /// The job as it is now, and its place in the queue while it waits (1 is next).
    ///
    /// # Errors
    /// When there is no such job.
    pub fn record(&self, job: JobId) -> Result<(JobRecord, Option<usize>), StoreError> {
        let place = self.queue_position(job);
        Ok((self.shared.store.record(job)?, place))
    }

    /// The job's place in the queue while it waits; 1 is next.
    pub fn queue_position(&self, job: JobId) -> Option<usize> {
        let place = self.shared.queue().waiting.iter().position(|waiting| waiting.job == job);
        place.map(|index| index + 1)
    }

    /// The store, for what is only read.
    pub fn store(&self) -> &dyn JobStore {
        &*self.shared.store
    }

    /// Follows a job's events, from the one after number `after` on.
    ///
    /// # Errors
    /// When there is no such job.
    pub fn subscribe(&self, job: JobId, after: u64) -> Result<Subscription, StoreError> {
        // A job that is not in `live` has ended: all its events are in the store.
        let live = self.shared.live().get(&job).cloned().unwrap_or_default();
        let replay_until = self.shared.store.record(job)?.last_seq;
        Ok(Subscription::new(job, Arc::clone(&self.shared.store), live, after, replay_until))
    }

    /// Cancels a job. One that waits ends at once; one that runs ends, with its best plan kept, as
    /// soon as the planner looks at its token.
    ///
    /// # Errors
    /// When there is no such job.
    pub fn cancel(&self, job: JobId) -> Result<Cancelled, StoreError> {
        let shared = &self.shared;
        let mut queue = shared.queue();
        if let Some(control) = queue.running.get(&job) {
            control.cancel.cancel();
            return Ok(Cancelled::Running);
        }
        let Some(index) = queue.waiting.iter().position(|waiting| waiting.job == job) else {
            drop(queue);
            return shared.store.record(job).map(|_| Cancelled::Ended);
        };
        queue.waiting.remove(index);
        drop(queue);
        shared.end(job, TerminationReason::ClientCancel, Some("cancelled before it started".to_owned()));
        Ok(Cancelled::Waiting)
    }

    /// How busy the pool is.
    pub fn load(&self) -> Load {
        let queue = self.shared.queue();
        Load {
            workers: self.shared.config.workers,
            running: queue.running.len(),
            waiting: queue.waiting.len(),
        }
    }

    /// Takes in nothing more and stops the running jobs where they are, without a terminal event:
    /// they have not ended, the process does. Waits up to `patience` for the threads, and returns
    /// whether all have ended.
    pub fn stop(&self, patience: Duration) -> bool {
        let mut queue = self.shared.queue();
        queue.stopping = true;
        queue.running.values().for_each(|control| control.cancel.cancel());
        drop(queue);
        self.shared.changed.notify_all();
        let mut threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        let began = Instant::now();
        loop {
            threads.retain(|thread| !thread.is_finished());
            if threads.is_empty() || began.elapsed() >= patience {
                return threads.is_empty();
            }
            std::thread::sleep(STOP_POLL);
        }
    }
}

impl Drop for Jobs {
    fn drop(&mut self) {
        self.stop(Duration::ZERO);
    }
}

impl Queue {
    /// When a running job's budget ends, at the latest.
    fn retry_after_s(&self) -> u64 {
        let soonest = self.running.values().filter_map(|control| control.deadline.remaining()).min();
        soonest.map_or(1, |left| left.as_secs() + 1).clamp(1, 60)
    }
}

impl Shared {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        // No planner code runs under this lock, and nothing below panics halfway through a change.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn live(&self) -> MutexGuard<'_, BTreeMap<JobId, Arc<Live>>> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self) {
        while let Some((waiting, control)) = self.next() {
            let ended = self.run(&waiting, &control);
            // The thread is free before anyone reads that the job has ended.
            self.queue().running.remove(&waiting.job);
            if let Some((reason, diagnosis)) = ended {
                self.end(waiting.job, reason, diagnosis);
            }
        }
    }

    /// Waits for a job; `None` when the service stops.
    fn next(&self) -> Option<(Waiting, Control)> {
        let mut queue = self.queue();
        loop {
            if queue.stopping {
                return None;
            }
            if let Some(waiting) = queue.waiting.pop_front() {
                let budget = waiting.submission.problem.options.time_budget_s;
                // A budget beyond what a Duration holds never ends.
                let budget = Duration::try_from_secs_f64(budget).unwrap_or(Duration::MAX);
                let deadline = Deadline::resumed(waiting.submission.spent, budget);
                let control = Control { deadline, cancel: CancelToken::new() };
                queue.running.insert(waiting.job, control.clone());
                return Some((waiting, control));
            }
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Plans. Returns why the job has ended; `None` when it has not, but the service stops.
    fn run(&self, waiting: &Waiting, control: &Control) -> Option<(TerminationReason, Option<String>)> {
        let job = waiting.job;
        self.publish(job, EventBody::Started)?;
        let problem = &waiting.submission.problem;
        let mut reporter = Reporter { shared: self, job, problem, last_progress: None, published: 0 };
        let planned = catch_unwind(AssertUnwindSafe(|| {
            self.planner.plan(problem, control, &mut |event| reporter.report(event))
        }));
        match planned {
            Ok(outcome) => {
                if let Some(best) = outcome.best.as_ref().filter(|best| best.revision > reporter.published) {
                    reporter.publish_plan(best);
                }
                if self.queue().stopping && outcome.termination == Termination::Cancelled {
                    return None;
                }
                Some(ending(&outcome, reporter.published > 0))
            }
            Err(panic) => {
                let message = panic
                    .downcast_ref::<&str>()
                    .map(|text| (*text).to_owned())
                    .or_else(|| panic.downcast_ref::<String>().cloned())
                    .unwrap_or_default();
                tracing::error!(%job, cause = message, "the planner panicked");
                let diagnosis = "the planner failed on this problem; this is a fault of the service";
                Some((TerminationReason::Internal, Some(diagnosis.to_owned())))
            }
        }
    }

    /// Ends a job, wakes its readers for the last time and lets go of them.
    fn end(&self, job: JobId, reason: TerminationReason, diagnosis: Option<String>) {
        let metrics = self.store.record(job).ok().and_then(|record| record.best).map(|best| best.metrics);
        self.publish(job, EventBody::Terminal(Terminal { reason, metrics, diagnosis }));
        self.live().remove(&job);
        tracing::info!(%job, reason = reason.as_str(), "job ended");
    }

    /// Appends a durable event and wakes the job's readers. `None` when the store refuses.
    fn publish(&self, job: JobId, body: EventBody) -> Option<Arc<Event>> {
        match self.store.append(job, Timestamp::now(), body) {
            Ok(event) => {
                let live = self.live().get(&job).cloned();
                if let Some(live) = live {
                    live.wake();
                }
                Some(event)
            }
            Err(error) => {
                tracing::error!(%job, %error, "the store refused an event");
                None
            }
        }
    }
}

/// The reason on the wire for how the planner ended, and the diagnosis when there is no plan.
fn ending(outcome: &Outcome, has_plan: bool) -> (TerminationReason, Option<String>) {
    use TerminationReason as R;
    let reason = match (outcome.termination, has_plan) {
        (Termination::Cancelled, _) => R::ClientCancel,
        (Termination::Optimal, true) => R::Optimal,
        (Termination::TargetReached, true) => R::TargetReached,
        (Termination::FirstSolution, true) => R::FirstSolution,
        (Termination::NoImprovement, true) => R::NoImprovement,
        (Termination::TimeLimit | Termination::NoSolutionFound | Termination::Infeasible, true) => {
            R::TimeLimit
        }
        (Termination::Infeasible, false) => R::Infeasible,
        (_, false) => R::NoSolutionFound,
    };
    (reason, if has_plan { None } else { outcome.diagnosis.clone() })
}

/// Turns what the planner reports into events of its job.
struct Reporter<'a> {
    shared: &'a Shared,
    job: JobId,
    problem: &'a Problem,
    last_progress: Option<Instant>,
    /// Revision of the newest published plan.
    published: u64,
}

impl Reporter<'_> {
    fn report(&mut self, event: PlannerEvent<'_>) {
        match event {
            PlannerEvent::Incumbent(plan) => self.publish_plan(plan),
            PlannerEvent::Progress { elapsed_s, phase, iterations, steps_lower_bound } => {
                let now = Instant::now();
                if self.last_progress.is_some_and(|last| now - last < PROGRESS_INTERVAL) {
                    return;
                }
                self.last_progress = Some(now);
                self.publish_progress(Progress { elapsed_s, phase, iterations, steps_lower_bound });
            }
        }
    }

    fn publish_progress(&self, progress: Progress) {
        let Ok(record) = self.shared.store.record(self.job) else { return };
        let Some(live) = self.shared.live().get(&self.job).cloned() else { return };
        live.set_progress(Arc::new(Event {
            seq: record.last_seq,
            job: self.job,
            attempt: record.attempt,
            at: Timestamp::now(),
            body: EventBody::Progress(progress),
        }));
    }

    fn publish_plan(&mut self, plan: &Plan) {
        let document = crate::wire::plan::to_json(self.problem, plan);
        let incumbent =
            Incumbent { revision: plan.revision, metrics: plan.metrics.clone(), document: document.into() };
        if self.shared.publish(self.job, EventBody::Incumbent(incumbent)).is_some() {
            self.published = plan.revision;
        }
    }
}
