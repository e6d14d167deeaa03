//! Records and events as they lie in the file: JSON, so that later versions can add fields.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::jobs::{
    Best, Event, EventBody, Idempotency, Incumbent, JobId, JobRecord, JobRequest, JobState, RetryCause,
    Retrying, StoreError, Terminal, TerminationReason, Timestamp,
};
use crate::wire::plan::MetricsDocument;

/// A record, and what the store itself needs to know of a job.
#[derive(Debug, Clone)]
pub(super) struct Kept {
    pub record: JobRecord,
    /// Bytes of the plans that are kept.
    pub plan_bytes: u64,
    /// Its idempotency key.
    pub key: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct StoredRecord {
    state: String,
    reason: Option<String>,
    labels: BTreeMap<String, String>,
    priority: i32,
    client: String,
    queue_ttl_ms: Option<u64>,
    attempt: u32,
    lost: u32,
    spent_ms: u64,
    created_at: u64,
    queued_at: Option<u64>,
    started_at: Option<u64>,
    finished_at: Option<u64>,
    best: Option<(u64, MetricsDocument)>,
    diagnosis: Option<String>,
    last_seq: u64,
    trimmed: u64,
    plan_bytes: u64,
    key: Option<String>,
}

fn millis(span: Duration) -> u64 {
    u64::try_from(span.as_millis()).unwrap_or(u64::MAX)
}

fn broken(error: impl std::fmt::Display) -> StoreError {
    StoreError::Broken(format!("an entry cannot be read: {error}"))
}

pub(super) fn encode_record(kept: &Kept) -> Vec<u8> {
    let record = &kept.record;
    let stored = StoredRecord {
        state: record.state.as_str().to_owned(),
        reason: record.termination_reason.map(|reason| reason.as_str().to_owned()),
        labels: record.labels.clone(),
        priority: record.priority,
        client: record.client.clone(),
        queue_ttl_ms: record.queue_ttl.map(millis),
        attempt: record.attempt,
        lost: record.lost,
        spent_ms: millis(record.spent),
        created_at: record.created_at.unix_millis(),
        queued_at: record.queued_at.map(Timestamp::unix_millis),
        started_at: record.started_at.map(Timestamp::unix_millis),
        finished_at: record.finished_at.map(Timestamp::unix_millis),
        best: record.best.as_ref().map(|best| (best.revision, MetricsDocument::from(&best.metrics))),
        diagnosis: record.diagnosis.clone(),
        last_seq: record.last_seq,
        trimmed: record.trimmed,
        plan_bytes: kept.plan_bytes,
        key: kept.key.clone(),
    };
    // Plain structs with text keys always serialise.
    serde_json::to_vec(&stored).unwrap_or_default()
}

pub(super) fn decode_record(id: JobId, bytes: &[u8]) -> Result<Kept, StoreError> {
    let stored: StoredRecord = serde_json::from_slice(bytes).map_err(broken)?;
    let at = Timestamp::from_unix_millis;
    let reason = stored.reason.map(|name| TerminationReason::of_name(&name).ok_or("a reason")).transpose();
    Ok(Kept {
        record: JobRecord {
            id,
            state: JobState::of_name(&stored.state).ok_or("a state").map_err(broken)?,
            termination_reason: reason.map_err(broken)?,
            labels: stored.labels,
            priority: stored.priority,
            client: stored.client,
            queue_ttl: stored.queue_ttl_ms.map(Duration::from_millis),
            attempt: stored.attempt,
            lost: stored.lost,
            spent: Duration::from_millis(stored.spent_ms),
            created_at: at(stored.created_at),
            queued_at: stored.queued_at.map(at),
            started_at: stored.started_at.map(at),
            finished_at: stored.finished_at.map(at),
            best: stored.best.map(|(revision, metrics)| Best { revision, metrics: metrics.into() }),
            diagnosis: stored.diagnosis,
            last_seq: stored.last_seq,
            trimmed: stored.trimmed,
        },
        plan_bytes: stored.plan_bytes,
        key: stored.key,
    })
}

#[derive(Serialize, Deserialize)]
struct StoredEvent {
    attempt: u32,
    at: u64,
    body: StoredBody,
}

#[derive(Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum StoredBody {
    Queued { position: usize },
    Started,
    Incumbent { revision: u64, metrics: MetricsDocument },
    Retrying { attempt: u32, shutdown: bool, spent_ms: u64 },
    Terminal { reason: String, metrics: Option<MetricsDocument>, diagnosis: Option<String> },
}

/// An event without the plan that it may carry.
pub(super) fn encode_event(event: &Event) -> Vec<u8> {
    let body = match &event.body {
        EventBody::Queued { position } => StoredBody::Queued { position: *position },
        EventBody::Incumbent(incumbent) => {
            StoredBody::Incumbent { revision: incumbent.revision, metrics: (&incumbent.metrics).into() }
        }
        EventBody::Retrying(retrying) => StoredBody::Retrying {
            attempt: retrying.attempt,
            shutdown: retrying.cause == RetryCause::Shutdown,
            spent_ms: millis(retrying.spent),
        },
        EventBody::Terminal(terminal) => StoredBody::Terminal {
            reason: terminal.reason.as_str().to_owned(),
            metrics: terminal.metrics.as_ref().map(MetricsDocument::from),
            diagnosis: terminal.diagnosis.clone(),
        },
        // The last two are never stored: `JobRecord::admits` refuses them.
        EventBody::Started | EventBody::Progress(_) | EventBody::Snapshot(_) => StoredBody::Started,
    };
    let stored = StoredEvent { attempt: event.attempt, at: event.at.unix_millis(), body };
    serde_json::to_vec(&stored).unwrap_or_default()
}

/// The event; `plan` gives the plan of a revision.
pub(super) fn decode_event(
    job: JobId,
    seq: u64,
    bytes: &[u8],
    plan: impl FnOnce(u64) -> Result<Arc<str>, StoreError>,
) -> Result<Event, StoreError> {
    let stored: StoredEvent = serde_json::from_slice(bytes).map_err(broken)?;
    let body = match stored.body {
        StoredBody::Queued { position } => EventBody::Queued { position },
        StoredBody::Started => EventBody::Started,
        StoredBody::Incumbent { revision, metrics } => {
            EventBody::Incumbent(Incumbent { revision, metrics: metrics.into(), document: plan(revision)? })
        }
        StoredBody::Retrying { attempt, shutdown, spent_ms } => EventBody::Retrying(Retrying {
            attempt,
            cause: if shutdown { RetryCause::Shutdown } else { RetryCause::WorkerLost },
            spent: Duration::from_millis(spent_ms),
        }),
        StoredBody::Terminal { reason, metrics, diagnosis } => EventBody::Terminal(Terminal {
            reason: TerminationReason::of_name(&reason).ok_or("a reason").map_err(broken)?,
            metrics: metrics.map(Into::into),
            diagnosis,
        }),
    };
    Ok(Event { seq, job, attempt: stored.attempt, at: Timestamp::from_unix_millis(stored.at), body })
}

/// What of a request lies beside the problem's text.
#[derive(Serialize, Deserialize)]
struct StoredRequest {
    workcell: Option<String>,
    warm_start: Option<String>,
    idempotency: Option<(String, String)>,
}

pub(super) fn encode_request(request: &JobRequest) -> Vec<u8> {
    let stored = StoredRequest {
        workcell: request.workcell.clone(),
        warm_start: request.warm_start.as_deref().map(str::to_owned),
        idempotency: request.idempotency.as_ref().map(|own| (own.key.clone(), own.digest.clone())),
    };
    serde_json::to_vec(&stored).unwrap_or_default()
}

/// The request of a job, from its two parts and its record.
pub(super) fn decode_request(
    bytes: &[u8],
    problem: &[u8],
    record: &JobRecord,
) -> Result<JobRequest, StoreError> {
    let stored: StoredRequest = serde_json::from_slice(bytes).map_err(broken)?;
    Ok(JobRequest {
        problem: problem.into(),
        workcell: stored.workcell,
        warm_start: stored.warm_start.map(Into::into),
        labels: record.labels.clone(),
        priority: record.priority,
        queue_ttl: record.queue_ttl,
        client: record.client.clone(),
        idempotency: stored.idempotency.map(|(key, digest)| Idempotency { key, digest }),
    })
}
