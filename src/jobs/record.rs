//! What a job is at one moment: the fold of its durable events.

use std::collections::BTreeMap;
use std::time::Duration;

use crate::plan::Metrics;

use super::{Event, EventBody, JobId, JobState, NewJob, RetryCause, TerminationReason, Timestamp};

/// A job at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecord {
    /// Its id.
    pub id: JobId,
    /// Its state.
    pub state: JobState,
    /// Why it ended, once it has.
    pub termination_reason: Option<TerminationReason>,
    /// What its client has written on it.
    pub labels: BTreeMap<String, String>,
    /// How urgent it is; higher goes first.
    pub priority: i32,
    /// Who sent it, as far as the service tells clients apart.
    pub client: String,
    /// How long it may wait before it starts.
    pub queue_ttl: Option<Duration>,
    /// Which attempt it is at, from 1: the token that fences off whoever held an earlier one.
    pub attempt: u32,
    /// How many attempts were lost with the process that ran them.
    pub lost: u32,
    /// What earlier attempts have used of the time budget.
    pub spent: Duration,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// When it entered the queue.
    pub queued_at: Option<Timestamp>,
    /// When a planner thread took it last.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Its best plan so far.
    pub best: Option<Best>,
    /// The likely cause, when it ended without a plan.
    pub diagnosis: Option<String>,
    /// Number of its last durable event; 0 before the first.
    pub last_seq: u64,
    /// Events up to this number are kept no longer.
    pub trimmed: u64,
}

/// The best plan of a job so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Its revision.
    pub revision: u64,
    /// Its figures.
    pub metrics: Metrics,
}

impl JobRecord {
    /// A job to which nothing has happened yet.
    pub fn new(job: &NewJob) -> Self {
        Self {
            id: job.id,
            state: JobState::Queued,
            termination_reason: None,
            labels: job.request.labels.clone(),
            priority: job.request.priority,
            client: job.request.client.clone(),
            queue_ttl: job.request.queue_ttl,
            attempt: 1,
            lost: 0,
            spent: Duration::ZERO,
            created_at: job.created_at,
            queued_at: None,
            started_at: None,
            finished_at: None,
            best: None,
            diagnosis: None,
            last_seq: 0,
            trimmed: 0,
        }
    }

    /// When it ends if it has not started by then.
    pub fn expires_at(&self) -> Option<Timestamp> {
        // Once it has started, it is not thrown out of the queue any more.
        let waits = self.state == JobState::Queued && self.started_at.is_none();
        self.queue_ttl.filter(|_| waits).map(|ttl| self.created_at.plus(ttl))
    }

    /// Whether an event of this kind may follow on what has happened so far.
    pub fn admits(&self, body: &EventBody) -> bool {
        match body {
            EventBody::Queued { .. } => self.state == JobState::Queued && self.queued_at.is_none(),
            EventBody::Started => self.state == JobState::Queued && self.queued_at.is_some(),
            EventBody::Progress(_) | EventBody::Snapshot(_) => false,
            EventBody::Incumbent(incumbent) => {
                let last = self.best.as_ref().map_or(0, |best| best.revision);
                self.state == JobState::Running && incumbent.revision > last
            }
            EventBody::Retrying(retrying) => {
                self.state == JobState::Running && retrying.attempt == self.attempt + 1
            }
            EventBody::Terminal(terminal) => {
                let timely = terminal.reason != TerminationReason::QueueTimeout
                    || (self.state == JobState::Queued && self.started_at.is_none());
                !self.state.is_terminal() && timely
            }
        }
    }

    /// Takes in the next durable event.
    pub fn apply(&mut self, event: &Event) {
        self.last_seq = event.seq;
        self.attempt = event.attempt;
        match &event.body {
            EventBody::Queued { .. } => self.queued_at = Some(event.at),
            EventBody::Started => {
                self.state = JobState::Running;
                self.started_at = Some(event.at);
            }
            EventBody::Progress(_) | EventBody::Snapshot(_) => {}
            EventBody::Incumbent(incumbent) => {
                self.best = Some(Best { revision: incumbent.revision, metrics: incumbent.metrics.clone() });
            }
            EventBody::Retrying(retrying) => {
                self.state = JobState::Queued;
                self.attempt = retrying.attempt;
                self.spent += retrying.spent;
                self.lost += u32::from(retrying.cause == RetryCause::WorkerLost);
            }
            EventBody::Terminal(terminal) => {
                self.state = terminal.reason.state();
                self.termination_reason = Some(terminal.reason);
                self.finished_at = Some(event.at);
                self.diagnosis.clone_from(&terminal.diagnosis);
            }
        }
    }
}
