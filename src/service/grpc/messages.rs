//! The job layer's types as gRPC messages.

use super::super::workcells::Registered;
use super::proto;
use crate::jobs::{Delivery, Event, EventBody, JobRecord, JobState, TerminationReason, Timestamp};
use crate::plan::{Metrics, StepsProof};
use crate::wire;

/// A job and its place in the queue.
pub(super) fn job(record: &JobRecord, queue_position: Option<usize>) -> proto::Job {
    let text = |at: Option<Timestamp>| at.map(|at| at.to_string()).unwrap_or_default();
    let position = if record.state == JobState::Queued { queue_position } else { None };
    proto::Job {
        id: record.id.to_string(),
        state: state(record.state).into(),
        termination_reason: record
            .termination_reason
            .map_or(proto::TerminationReason::Unspecified, reason)
            .into(),
        attempt: record.attempt,
        created_at: record.created_at.to_string(),
        queued_at: text(record.queued_at),
        started_at: text(record.started_at),
        finished_at: text(record.finished_at),
        queue_position: position.map(|place| place as u64),
        best: record.best.as_ref().map(|best| metrics(&best.metrics)),
        labels: record.labels.clone().into_iter().collect(),
        priority: record.priority,
        queue_ttl_s: record.queue_ttl.map(|ttl| ttl.as_secs_f64()),
        diagnosis: record.diagnosis.clone().unwrap_or_default(),
        last_seq: record.last_seq,
    }
}

/// An event on its way. Plans larger than `inline_limit` bytes are left out.
pub(super) fn event(delivery: &Delivery, inline_limit: usize) -> proto::Event {
    use proto::event::Body;
    let event = &*delivery.event;
    let body = match &event.body {
        EventBody::Queued { position } => Body::Queued(proto::Queued { position: *position as u64 }),
        EventBody::Started => Body::Started(proto::Started {}),
        EventBody::Progress(progress) => Body::Progress(proto::Progress {
            elapsed_s: progress.elapsed_s,
            phase: progress.phase.to_owned(),
            iterations: progress.iterations,
            steps_lower_bound: progress.steps_lower_bound.map(|bound| bound as u64),
        }),
        EventBody::Incumbent(incumbent) => Body::Incumbent(proto::Incumbent {
            revision: incumbent.revision,
            metrics: Some(metrics(&incumbent.metrics)),
            plan_json: if incumbent.document.len() <= inline_limit {
                incumbent.document.to_string()
            } else {
                String::new()
            },
            skipped: delivery.skipped,
        }),
        EventBody::Retrying(retrying) => {
            Body::Retrying(proto::Retrying { cause: retrying.cause.as_str().to_owned() })
        }
        EventBody::Snapshot(snapshot) => Body::Snapshot(proto::Snapshot {
            state: state(snapshot.state).into(),
            metrics: snapshot.metrics.as_ref().map(metrics),
        }),
        EventBody::Terminal(terminal) => Body::Terminal(proto::Terminal {
            state: state(terminal.reason.state()).into(),
            termination_reason: reason(terminal.reason).into(),
            metrics: terminal.metrics.as_ref().map(metrics),
            diagnosis: terminal.diagnosis.clone().unwrap_or_default(),
        }),
    };
    proto::Event {
        seq: event.seq,
        job_id: event.job.to_string(),
        attempt: event.attempt,
        at: event.at.to_string(),
        body: Some(body),
    }
}

/// A plan's figures.
pub(super) fn metrics(metrics: &Metrics) -> proto::Metrics {
    proto::Metrics {
        duration_s: metrics.duration_s,
        duration_synchronous_s: metrics.duration_synchronous_s,
        arc_length: metrics.arc_length,
        actions: metrics.actions as u64,
        steps: metrics.steps as u64,
        mode_graph_optimum: metrics.mode_graph_optimum.map(|steps| steps as u64),
        steps_lower_bound: metrics.steps_lower_bound as u64,
        steps_proof: match metrics.steps_proof {
            StepsProof::None => proto::StepsProof::None,
            StepsProof::Bounds => proto::StepsProof::Bounds,
            StepsProof::Ilp => proto::StepsProof::Ilp,
        }
        .into(),
        found_after_s: metrics.found_after_s,
    }
}

/// A plan of a job without the plan; `None` for events of other kinds.
pub(super) fn incumbent(event: &Event) -> Option<proto::IncumbentSummary> {
    let EventBody::Incumbent(incumbent) = &event.body else { return None };
    Some(proto::IncumbentSummary {
        revision: incumbent.revision,
        seq: event.seq,
        attempt: event.attempt,
        at: event.at.to_string(),
        metrics: Some(metrics(&incumbent.metrics)),
    })
}

/// A registered workcell without its document.
pub(super) fn workcell(registered: &Registered) -> proto::Workcell {
    proto::Workcell {
        id: registered.id.clone(),
        digest: registered.digest.clone(),
        registered_at: registered.at.to_string(),
        ..proto::Workcell::default()
    }
}

/// A fault or warning.
pub(super) fn fault(fault: &wire::Fault) -> proto::Fault {
    proto::Fault {
        pointer: fault.pointer.clone(),
        code: fault.code.to_string(),
        message: fault.message.clone(),
    }
}

/// The state that a client asks for; `None` for one that this version does not know.
pub(super) fn known_state(wanted: i32) -> Option<JobState> {
    JobState::ALL.into_iter().find(|known| i32::from(state(*known)) == wanted)
}

fn state(state: JobState) -> proto::JobState {
    match state {
        JobState::Queued => proto::JobState::Queued,
        JobState::Running => proto::JobState::Running,
        JobState::Succeeded => proto::JobState::Succeeded,
        JobState::Failed => proto::JobState::Failed,
        JobState::Cancelled => proto::JobState::Cancelled,
        JobState::Expired => proto::JobState::Expired,
    }
}

fn reason(reason: TerminationReason) -> proto::TerminationReason {
    use TerminationReason as R;
    match reason {
        R::TimeLimit => proto::TerminationReason::TimeLimit,
        R::Optimal => proto::TerminationReason::Optimal,
        R::TargetReached => proto::TerminationReason::TargetReached,
        R::FirstSolution => proto::TerminationReason::FirstSolution,
        R::NoImprovement => proto::TerminationReason::NoImprovement,
        R::Infeasible => proto::TerminationReason::Infeasible,
        R::NoSolutionFound => proto::TerminationReason::NoSolutionFound,
        R::Internal => proto::TerminationReason::Internal,
        R::WorkerLost => proto::TerminationReason::WorkerLost,
        R::ClientCancel => proto::TerminationReason::ClientCancel,
        R::QueueTimeout => proto::TerminationReason::QueueTimeout,
    }
}
