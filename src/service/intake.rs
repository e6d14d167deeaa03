//! From a document to an accepted job, for HTTP and gRPC alike.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;

use super::{ApiError, App};
use crate::jobs::{JobRecord, Submission};
use crate::wire::{LibraryOnly, ReadProblem, read_problem};

/// Validates a problem on a blocking thread; only so many at once.
///
/// # Errors
/// All faults of the document.
pub async fn validate(app: &Arc<App>, document: Bytes) -> Result<ReadProblem, ApiError> {
    let limits = app.config.read_limits.clone();
    blocking(app, move || read_problem(&document, &LibraryOnly, &limits).map_err(ApiError::of_problem)).await
}

/// Runs `work` on a blocking thread; only so many at once.
///
/// # Errors
/// Those of `work`, and [`ApiError::Internal`] when it panics.
pub async fn blocking<T: Send + 'static>(
    app: &Arc<App>,
    work: impl FnOnce() -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let permit = Arc::clone(&app.validations).acquire_owned().await.map_err(|_| ApiError::Unavailable)?;
    tokio::task::spawn_blocking(move || {
        // Held by the work itself: a client that leaves does not make room for more.
        let _permit = permit;
        work()
    })
    .await
    .map_err(|error| {
        tracing::error!(%error, "a request's work panicked");
        ApiError::Internal
    })?
}

/// Reserves a place in the queue, validates the problem and submits it. A client that leaves before
/// that has happened leaves no job behind.
///
/// # Errors
/// When the queue is full or the document has faults.
pub async fn accept(app: &Arc<App>, document: Bytes) -> Result<JobRecord, ApiError> {
    let arrived = Instant::now();
    let ticket = app.jobs.reserve()?;
    let read = validate(app, document).await?;
    let submission = Submission { problem: read.problem, spent: arrived.elapsed() };
    let record = app.jobs.submit(ticket, submission)?;
    tracing::info!(job = %record.id, spent_s = arrived.elapsed().as_secs_f64(), "job accepted");
    Ok(record)
}
