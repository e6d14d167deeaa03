//! What a job is at one moment: the fold of its durable events.

use crate::plan::Metrics;

use super::{Event, EventBody, JobId, JobState, TerminationReason, Timestamp};

/// A job at one moment.
#[derive(Debug, Clone)]
pub struct JobRecord {
    /// Its id.
    pub id: JobId,
    /// Its state.
    pub state: JobState,
    /// Why it ended, once it has.
    pub termination_reason: Option<TerminationReason>,
    /// Which attempt it is at, from 1.
    pub attempt: u32,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// When it entered the queue.
    pub queued_at: Option<Timestamp>,
    /// When a planner thread took it.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Its best plan so far.
    pub best: Option<Best>,
    /// The likely cause, when it ended without a plan.
    pub diagnosis: Option<String>,
    /// Number of its last durable event; 0 before the first.
    pub last_seq: u64,
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
    pub fn new(id: JobId, created_at: Timestamp) -> Self {
        Self {
            id,
            state: JobState::Queued,
            termination_reason: None,
            attempt: 1,
            created_at,
            queued_at: None,
            started_at: None,
            finished_at: None,
            best: None,
            diagnosis: None,
            last_seq: 0,
        }
    }

    /// Whether an event of this kind may follow on what has happened so far.
    pub fn admits(&self, body: &EventBody) -> bool {
        match body {
            EventBody::Queued { .. } => self.state == JobState::Queued && self.queued_at.is_none(),
            EventBody::Started => self.state == JobState::Queued && self.queued_at.is_some(),
            EventBody::Progress(_) => false,
            EventBody::Incumbent(incumbent) => {
                let last = self.best.as_ref().map_or(0, |best| best.revision);
                self.state == JobState::Running && incumbent.revision > last
            }
            EventBody::Terminal(_) => !self.state.is_terminal(),
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
            EventBody::Progress(_) => {}
            EventBody::Incumbent(incumbent) => {
                self.best = Some(Best { revision: incumbent.revision, metrics: incumbent.metrics.clone() });
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
