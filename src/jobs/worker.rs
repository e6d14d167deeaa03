//! What a planner thread does.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use crate::plan::{Metrics, Plan};
use crate::planner::{Outcome, PlannerEvent, Termination};
use crate::problem::{Objective, Problem};
use crate::run::{Control, Deadline, Part};

use super::pool::Shared;
use super::queue::{Ready, Running, Waiting};
use super::{
    Event, EventBody, Incumbent, JobId, JobRecord, Lease, Occurrence, Progress, Revision, TerminationReason,
    Timestamp,
};

/// Least time between two signs of life of one job.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(1);
/// What an attempt after the first gets of the time budget at least.
const LEAST_BUDGET: Duration = Duration::from_secs(1);

/// How an attempt came to its end.
enum Ending {
    /// The job has ended.
    Ended(TerminationReason, Option<String>),
    /// The process ends; the job does not.
    GivenBack,
    /// The store does not let us go on.
    Lost,
}

impl Shared {
    /// Runs jobs until the service stops.
    pub(super) fn work(&self) {
        while let Some(waiting) = self.next() {
            let job = waiting.job;
            let _span = tracing::info_span!("job", %job).entered();
            let (since, began) = (Timestamp::now(), Instant::now());
            let (lease, ending) = self.attempt(waiting);
            // The thread is free before anyone reads that the job has ended. Who has taken the job
            // from us has removed it already.
            let run = self.queue().running.remove(&job);
            let ours = run.is_some();
            let spent = run.map(|run| run.control.spent).unwrap_or_default();
            self.parts.observer.observe(Occurrence::Planned {
                busy: began.elapsed(),
                guidance: spent.time(Part::Guidance),
                programs: spent.time(Part::IntegerProgram),
                programs_solved: spent.times(Part::IntegerProgram),
            });
            match ending {
                Ending::Ended(reason, diagnosis) => self.end(job, lease, reason, diagnosis),
                Ending::GivenBack if ours => self.give_back(job, since),
                Ending::GivenBack | Ending::Lost => {}
            }
        }
    }

    /// Waits for a job; `None` when the service stops.
    fn next(&self) -> Option<Waiting> {
        let mut queue = self.queue();
        loop {
            if queue.stopping {
                return None;
            }
            let now = Timestamp::now();
            match queue.pop() {
                Some(late) if late.expires_at.is_some_and(|at| at <= now) => {
                    drop(queue);
                    let diagnosis = "it waited longer than `queue_ttl_s` allows".to_owned();
                    self.end(late.job, None, TerminationReason::QueueTimeout, Some(diagnosis));
                    queue = self.queue();
                }
                Some(waiting) => {
                    // Its budget begins when the problem is at hand.
                    let control = Control::unbounded();
                    let client = waiting.client.clone();
                    let running = Running { control, client, since: now, lease: None, cancelled: false };
                    queue.running.insert(waiting.job, running);
                    return Some(waiting);
                }
                None => queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner),
            }
        }
    }

    /// One attempt at a job.
    fn attempt(&self, waiting: Waiting) -> (Option<Lease>, Ending) {
        let job = waiting.job;
        let now = Timestamp::now();
        let lease = match self.parts.store.lease(job, now, now.plus(self.config.lease)) {
            Ok(lease) => lease,
            Err(error) => {
                tracing::error!(%error, "the job cannot be taken");
                return (None, Ending::Lost);
            }
        };
        if let Some(running) = self.queue().running.get_mut(&job) {
            running.lease = Some(lease);
        }
        let Some(started) = self.publish(job, Some(lease), EventBody::Started) else {
            return (Some(lease), Ending::Lost);
        };
        let record = match self.parts.store.record(job) {
            Ok(record) => record,
            Err(_) => return (Some(lease), Ending::Lost),
        };
        if record.attempt == 1 {
            self.parts.observer.observe(Occurrence::Started { waited: started.at.since(record.created_at) });
        }
        // Reading and planning run whatever the request holds: what panics ends this job alone.
        let ending = catch_unwind(AssertUnwindSafe(|| self.run(&record, lease, waiting.ready)));
        let ending = ending.unwrap_or_else(|panic| {
            tracing::error!(cause = cause(&*panic), "the planner panicked");
            self.parts.observer.observe(Occurrence::Panicked);
            let diagnosis = "the planner failed on this problem; this is a fault of the service";
            Ending::Ended(TerminationReason::Internal, Some(diagnosis.to_owned()))
        });
        (Some(lease), ending)
    }

    /// Plans.
    fn run(&self, record: &JobRecord, lease: Lease, ready: Option<Box<Ready>>) -> Ending {
        let job = record.id;
        let ready = match ready {
            Some(ready) => *ready,
            None => match self.read_again(job) {
                Ok(ready) => ready,
                Err(why) => {
                    tracing::error!(why, "the problem cannot be read again");
                    let diagnosis = format!("the problem cannot be read again: {why}");
                    return Ending::Ended(TerminationReason::Internal, Some(diagnosis));
                }
            },
        };
        let problem = &ready.problem;
        let Some(control) = self.control(record, &ready) else { return Ending::Lost };
        let mut reporter = Reporter {
            shared: self,
            record,
            lease,
            problem,
            last_progress: None,
            best: record.best.as_ref().map(|best| (best.revision, best.metrics.clone())),
            lost: false,
        };
        let known = match self.known_plan(record, problem) {
            Some(plan) => Some(plan),
            None => {
                ready.warm_start.as_ref().inspect(|plan| reporter.publish_plan(plan));
                ready.warm_start
            }
        };
        if let Some(reason) = reporter.met() {
            return Ending::Ended(reason, None);
        }
        let mut observe = |event: PlannerEvent<'_>| reporter.report(event);
        let outcome = match &known {
            Some(known) => self.parts.planner.improve(problem, known, &control, &mut observe),
            None => self.parts.planner.plan(problem, &control, &mut observe),
        };
        if let Some(best) = &outcome.best {
            reporter.publish_plan(best);
        }
        if reporter.lost {
            return Ending::Lost;
        }
        let queue = self.queue();
        let cancelled = queue.running.get(&job).is_some_and(|running| running.cancelled);
        if queue.stopping && !cancelled && outcome.termination == Termination::Cancelled {
            return Ending::GivenBack;
        }
        drop(queue);
        let (reason, diagnosis) = ending(&outcome, reporter.best.is_some());
        Ending::Ended(reason, diagnosis)
    }

    /// The problem of a job that an earlier process accepted.
    fn read_again(&self, job: JobId) -> Result<Ready, String> {
        let request = self.parts.store.request(job).map_err(|error| error.to_string())?;
        let (problem, warm_start) = self.parts.reader.read(&request)?;
        Ok(Ready { problem, warm_start, spent: Duration::ZERO })
    }

    /// The best plan of earlier attempts.
    fn known_plan(&self, record: &JobRecord, problem: &Problem) -> Option<Plan> {
        record.best.as_ref()?;
        let best = self.parts.store.solution(record.id, Revision::Best).ok()??;
        crate::wire::plan::read_plan(best.document.as_bytes(), problem).ok()
    }

    /// Starts the clock; `None` when the job has been taken from this thread meanwhile.
    fn control(&self, record: &JobRecord, ready: &Ready) -> Option<Control> {
        // A budget beyond what a Duration holds never ends.
        let budget = ready.problem.options.time_budget_s;
        let budget = Duration::try_from_secs_f64(budget).unwrap_or(Duration::MAX);
        let spent = record.spent + ready.spent;
        let least = if record.attempt > 1 { spent.saturating_add(LEAST_BUDGET) } else { Duration::ZERO };
        let mut queue = self.queue();
        let running = queue.running.get_mut(&record.id)?;
        running.control.deadline = Deadline::resumed(spent, budget.max(least));
        Some(running.control.clone())
    }
}

fn cause(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or_default()
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
    record: &'a JobRecord,
    lease: Lease,
    problem: &'a Problem,
    last_progress: Option<Instant>,
    /// Revision and figures of the best plan of all attempts.
    best: Option<(u64, Metrics)>,
    /// The store does not take our events any more.
    lost: bool,
}

impl Reporter<'_> {
    fn report(&mut self, event: PlannerEvent<'_>) {
        match event {
            PlannerEvent::Incumbent(plan) => self.publish_plan(plan),
            PlannerEvent::Judged { .. } => {}
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
        let job = self.record.id;
        let Ok(record) = self.shared.parts.store.record(job) else { return };
        let Some(live) = self.shared.live().get(&job).cloned() else { return };
        live.set_progress(Arc::new(Event {
            seq: record.last_seq,
            job,
            attempt: record.attempt,
            at: Timestamp::now(),
            body: EventBody::Progress(progress),
        }));
    }

    /// Publishes a plan when it is better than all before, under the next revision of the job.
    fn publish_plan(&mut self, plan: &Plan) {
        let known = self.best.as_ref();
        let objective = self.problem.options.objective;
        if self.lost || known.is_some_and(|(_, best)| plan.metrics.cost(objective) >= best.cost(objective)) {
            return;
        }
        let revision = known.map_or(1, |(revision, _)| revision + 1);
        let document = if plan.revision == revision {
            crate::wire::plan::to_json(self.problem, plan)
        } else {
            crate::wire::plan::to_json(self.problem, &Plan { revision, ..plan.clone() })
        };
        let metrics = plan.metrics.clone();
        let incumbent = Incumbent { revision, metrics: metrics.clone(), document: document.into() };
        let body = EventBody::Incumbent(incumbent);
        match self.shared.publish(self.record.id, Some(self.lease), body) {
            Some(event) => {
                let first_after = (revision == 1).then(|| event.at.since(self.record.created_at));
                self.shared.parts.observer.observe(Occurrence::Incumbent { first_after });
                self.best = Some((revision, metrics));
            }
            None => self.lost = true,
        }
    }

    /// Why there is nothing left to do, when the best plan meets what the problem stops at.
    fn met(&self) -> Option<TerminationReason> {
        let (_, best) = self.best.as_ref()?;
        let options = &self.problem.options;
        if options.stop.first_solution {
            Some(TerminationReason::FirstSolution)
        } else if options.stop.target_duration_s.is_some_and(|target| best.duration_s <= target) {
            Some(TerminationReason::TargetReached)
        } else if options.objective == Objective::Steps && best.steps <= best.steps_lower_bound {
            Some(TerminationReason::Optimal)
        } else {
            None
        }
    }
}
