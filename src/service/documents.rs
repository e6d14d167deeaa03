//! Jobs and events as JSON (FORMAT "Events" and "Job").

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;

use crate::jobs::{Delivery, Event, EventBody, JobRecord, JobState, TerminationReason};
use crate::wire::plan::MetricsDocument;

/// A job.
#[derive(Debug, Serialize)]
pub struct JobDocument {
    id: String,
    state: &'static str,
    termination_reason: Option<&'static str>,
    labels: BTreeMap<String, String>,
    priority: i32,
    queue_ttl_s: Option<f64>,
    attempt: u32,
    created_at: String,
    queued_at: Option<String>,
    started_at: Option<String>,
    finished_at: Option<String>,
    queue_position: Option<usize>,
    best: Option<MetricsDocument>,
    diagnosis: Option<String>,
    last_seq: u64,
    links: Links,
}

#[derive(Debug, Serialize)]
struct Links {
    #[serde(rename = "self")]
    this: String,
    events: String,
    incumbents: String,
    best: String,
    cancel: String,
}

impl JobDocument {
    /// The document of a job and its place in the queue.
    pub fn new(record: &JobRecord, queue_position: Option<usize>) -> Self {
        let path = job_path(record);
        Self {
            id: record.id.to_string(),
            state: record.state.as_str(),
            termination_reason: record.termination_reason.map(TerminationReason::as_str),
            labels: record.labels.clone(),
            priority: record.priority,
            queue_ttl_s: record.queue_ttl.map(|ttl| ttl.as_secs_f64()),
            attempt: record.attempt,
            created_at: record.created_at.to_string(),
            queued_at: record.queued_at.map(|at| at.to_string()),
            started_at: record.started_at.map(|at| at.to_string()),
            finished_at: record.finished_at.map(|at| at.to_string()),
            queue_position: if record.state == JobState::Queued { queue_position } else { None },
            best: record.best.as_ref().map(|best| MetricsDocument::from(&best.metrics)),
            diagnosis: record.diagnosis.clone(),
            last_seq: record.last_seq,
            links: Links {
                events: format!("{path}/events"),
                incumbents: format!("{path}/incumbents"),
                best: format!("{path}/solutions/best"),
                cancel: format!("{path}/cancel"),
                this: path,
            },
        }
    }
}

/// Where a job is found.
pub fn job_path(record: &JobRecord) -> String {
    format!("/v1/jobs/{}", record.id)
}

#[derive(Serialize)]
struct EventDocument<'a> {
    seq: u64,
    job_id: String,
    attempt: u32,
    at: String,
    #[serde(flatten)]
    body: BodyDocument<'a>,
}

#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum BodyDocument<'a> {
    Queued {
        position: usize,
    },
    Started,
    Progress {
        elapsed_s: f64,
        phase: &'a str,
        iterations: u64,
        steps_lower_bound: Option<usize>,
    },
    Incumbent {
        revision: u64,
        metrics: MetricsDocument,
        skipped: u64,
        #[serde(skip_serializing_if = "Option::is_none")]
        href: Option<String>,
    },
    Retrying {
        cause: &'static str,
    },
    Snapshot {
        state: &'static str,
        metrics: Option<MetricsDocument>,
    },
    Terminal {
        state: &'static str,
        termination_reason: &'static str,
        metrics: Option<MetricsDocument>,
        #[serde(skip_serializing_if = "Option::is_none")]
        diagnosis: Option<&'a str>,
    },
}

/// An event as one line of JSON, without the line's end.
#[derive(Debug)]
pub struct EventLine {
    /// All but the plan and what comes after it.
    pub head: String,
    /// The plan, a JSON text that all readers share.
    pub plan: Option<Arc<str>>,
    /// The rest.
    pub tail: &'static str,
}

/// An event as a line. Plans larger than `inline_limit` bytes are referred to by `href`.
pub fn event_line(delivery: &Delivery, inline_limit: usize) -> EventLine {
    let event = &*delivery.event;
    let mut inline = None;
    let body = match &event.body {
        EventBody::Queued { position } => BodyDocument::Queued { position: *position },
        EventBody::Started => BodyDocument::Started,
        EventBody::Progress(progress) => BodyDocument::Progress {
            elapsed_s: progress.elapsed_s,
            phase: progress.phase,
            iterations: progress.iterations,
            steps_lower_bound: progress.steps_lower_bound,
        },
        EventBody::Incumbent(incumbent) => {
            let fits = incumbent.document.len() <= inline_limit;
            inline = fits.then(|| Arc::clone(&incumbent.document));
            let href = format!("/v1/jobs/{}/solutions/{}", event.job, incumbent.revision);
            BodyDocument::Incumbent {
                revision: incumbent.revision,
                metrics: MetricsDocument::from(&incumbent.metrics),
                skipped: delivery.skipped,
                href: if fits { None } else { Some(href) },
            }
        }
        EventBody::Retrying(retrying) => BodyDocument::Retrying { cause: retrying.cause.as_str() },
        EventBody::Snapshot(snapshot) => BodyDocument::Snapshot {
            state: snapshot.state.as_str(),
            metrics: snapshot.metrics.as_ref().map(MetricsDocument::from),
        },
        EventBody::Terminal(terminal) => BodyDocument::Terminal {
            state: terminal.reason.state().as_str(),
            termination_reason: terminal.reason.as_str(),
            metrics: terminal.metrics.as_ref().map(MetricsDocument::from),
            diagnosis: terminal.diagnosis.as_deref(),
        },
    };
    let document = EventDocument {
        seq: event.seq,
        job_id: event.job.to_string(),
        attempt: event.attempt,
        at: event.at.to_string(),
        body,
    };
    let mut head = serde_json::to_string(&document).unwrap_or_default();
    // The plan is a JSON text already: it goes in as it is, before the closing brace.
    if inline.is_some() && head.pop().is_some() {
        head.push_str(",\"plan\":");
        return EventLine { head, plan: inline, tail: "}" };
    }
    EventLine { head, plan: None, tail: "" }
}

/// A plan of a job without the plan itself.
#[derive(Debug, Serialize)]
pub struct IncumbentDocument {
    revision: u64,
    seq: u64,
    attempt: u32,
    at: String,
    metrics: MetricsDocument,
    href: String,
}

impl IncumbentDocument {
    /// The document of an `incumbent` event; `None` for events of other kinds.
    pub fn new(event: &Event) -> Option<Self> {
        let EventBody::Incumbent(incumbent) = &event.body else { return None };
        Some(Self {
            revision: incumbent.revision,
            seq: event.seq,
            attempt: event.attempt,
            at: event.at.to_string(),
            metrics: MetricsDocument::from(&incumbent.metrics),
            href: format!("/v1/jobs/{}/solutions/{}", event.job, incumbent.revision),
        })
    }
}
