//! A job's events as the body of a reply.

use std::convert::Infallible;
use std::sync::Arc;

use axum::body::Body;
use bytes::Bytes;
use futures::StreamExt;

use super::App;
use super::client::StreamPermit;
use super::documents::{EventLine, event_line};
use super::negotiation::StreamFormat;
use crate::jobs::{Delivery, JobId, Subscription};

/// What SSE clients are told to wait before they come back after a shutdown.
const RETRY: &[u8] = b"retry: 2000\n\n";

/// Cancels its job when it is dropped before the job's events have ended, wherever it is by then.
pub struct CancelOnDrop {
    app: Arc<App>,
    job: JobId,
    armed: bool,
}

impl CancelOnDrop {
    /// Watches over `job`; does nothing unless `armed`.
    pub fn new(app: Arc<App>, job: JobId, armed: bool) -> Self {
        Self { app, job, armed }
    }

    /// Lets the job go on.
    pub fn disarm(&mut self) {
        self.armed = false;
    }
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        if self.armed {
            // A job that is gone or has ended needs no cancelling.
            let _ = self.app.jobs.cancel(self.job);
        }
    }
}

/// The body that streams what `subscription` gives. It ends after the terminal event, or when the
/// service shuts down.
pub fn event_body(
    app: Arc<App>,
    mut subscription: Subscription,
    format: StreamFormat,
    mut guard: CancelOnDrop,
    permit: StreamPermit,
) -> Body {
    let stream = async_stream::stream! {
        let _permit = permit;
        let mut keep_alive = tokio::time::interval(app.config.keep_alive);
        keep_alive.reset();
        loop {
            tokio::select! {
                biased;
                delivery = subscription.next() => {
                    let Some(delivery) = delivery else { break };
                    keep_alive.reset();
                    for piece in written(&delivery, format, app.config.inline_plan_bytes) {
                        yield Ok::<Bytes, Infallible>(piece);
                    }
                }
                () = app.shutdown.cancelled() => {
                    if format == StreamFormat::Sse {
                        yield Ok(Bytes::from_static(RETRY));
                    }
                    break;
                }
                _ = keep_alive.tick(), if format == StreamFormat::Sse => {
                    yield Ok(Bytes::from_static(b": alive\n\n"));
                }
            }
        }
        guard.disarm();
    };
    Body::from_stream(stream)
}

/// A plan's text as bytes that all readers share.
struct PlanText(Arc<str>);

impl AsRef<[u8]> for PlanText {
    fn as_ref(&self) -> &[u8] {
        self.0.as_bytes()
    }
}

/// An event as it is sent, piece after piece: a plan is not copied for each reader.
fn written(delivery: &Delivery, format: StreamFormat, inline_limit: usize) -> Vec<Bytes> {
    let EventLine { mut head, plan, tail } = event_line(delivery, inline_limit);
    let end = match format {
        StreamFormat::Ndjson => "\n",
        StreamFormat::Sse => {
            let event = &delivery.event;
            let kind = event.body.kind();
            let id = if event.body.is_resumable() { format!("id: {}\n", event.seq) } else { String::new() };
            head.insert_str(0, &format!("{id}event: {kind}\ndata: "));
            "\n\n"
        }
    };
    match plan {
        Some(plan) => {
            vec![Bytes::from(head), Bytes::from_owner(PlanText(plan)), Bytes::from([tail, end].concat())]
        }
        None => {
            head.push_str(tail);
            head.push_str(end);
            vec![Bytes::from(head)]
        }
    }
}
