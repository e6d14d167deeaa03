//! `/v1/jobs`: jobs that outlive the request that made them.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::super::body::read_json;
use super::super::documents::{JobDocument, job_path};
use super::super::intake::accept;
use super::super::negotiation::StreamFormat;
use super::super::stream::CancelOnDrop;
use super::super::{ApiError, App};
use super::plan::event_reply;
use crate::jobs::{JobId, Revision};

/// Jobs on one page, unless the client asks for fewer.
const PAGE: usize = 100;
/// Most jobs on one page.
const LARGEST_PAGE: usize = 1000;

/// `POST /v1/jobs`: accepts the problem in the body; 202 and where the job is.
pub(super) async fn create(
    State(app): State<Arc<App>>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let document = read_json(&headers, body, app.config.read_limits.max_bytes).await?;
    let record = accept(&app, document).await?;
    let (record, place) = app.jobs.record(record.id)?;
    let mut response = super::json(&JobDocument::new(&record, place));
    *response.status_mut() = StatusCode::ACCEPTED;
    if let Ok(location) = HeaderValue::from_str(&job_path(&record)) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

#[derive(Serialize)]
struct Page {
    jobs: Vec<JobDocument>,
    /// Where the next page is.
    next: Option<String>,
}

/// `GET /v1/jobs`: jobs, newest first; `?limit=` and `?before=` for pages.
pub(super) async fn list(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, ApiError> {
    let [limit, before] = super::query(&uri, ["limit", "before"])?;
    let limit = super::whole("limit", limit.as_deref())?;
    let limit = limit.and_then(|limit| usize::try_from(limit).ok()).unwrap_or(PAGE).clamp(1, LARGEST_PAGE);
    let before = before.map(|text| text.parse()).transpose().map_err(|error: crate::jobs::BadJobId| {
        ApiError::BadParameter { name: "before", message: error.to_string() }
    })?;
    let records = app.jobs.store().list(before, limit + 1)?;
    let next = (records.len() > limit)
        .then(|| records.get(limit - 1).map(|last| format!("/v1/jobs?limit={limit}&before={}", last.id)))
        .flatten();
    let jobs = records
        .iter()
        .take(limit)
        .map(|record| JobDocument::new(record, app.jobs.queue_position(record.id)))
        .collect();
    Ok(super::json(&Page { jobs, next }))
}

/// `GET /v1/jobs/{id}`: a job as it is now.
pub(super) async fn get(State(app): State<Arc<App>>, Path(id): Path<String>) -> Result<Response, ApiError> {
    let (record, place) = app.jobs.record(id.parse()?)?;
    Ok(super::json(&JobDocument::new(&record, place)))
}

/// `GET /v1/jobs/{id}/events`: its events after number `?after=` or `Last-Event-ID`, whichever is
/// greater, until the terminal one; 204 when that one is among those already seen.
pub(super) async fn events(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job: JobId = id.parse()?;
    let format = StreamFormat::negotiate(&headers)?;
    let [after] = super::query(&uri, ["after"])?;
    let after = super::whole("after", after.as_deref())?.unwrap_or(0);
    let resumed = match headers.get("last-event-id") {
        Some(value) => super::whole("Last-Event-ID", Some(value.to_str().unwrap_or("?")))?.unwrap_or(0),
        None => 0,
    };
    let after = after.max(resumed);
    let subscription = app.jobs.subscribe(job, after)?;
    let (record, _) = app.jobs.record(job)?;
    if record.state.is_terminal() && after >= record.last_seq {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let guard = CancelOnDrop::new(Arc::clone(&app), job, false);
    Ok(event_reply(app, &record, subscription, format, guard))
}

/// `GET /v1/jobs/{id}/solutions/{revision}`: a plan, by number or `best`.
pub(super) async fn solution(
    State(app): State<Arc<App>>,
    Path((id, revision)): Path<(String, String)>,
) -> Result<Response, ApiError> {
    let revision = match revision.as_str() {
        "best" => Revision::Best,
        number => Revision::Number(number.parse().map_err(|_| ApiError::NoSolution)?),
    };
    let incumbent = app.jobs.store().solution(id.parse()?, revision)?.ok_or(ApiError::NoSolution)?;
    Ok(super::json_text(incumbent.document.to_string()))
}

/// `POST /v1/jobs/{id}/cancel`: ends the job; its best plan is kept. A job that has ended stays as
/// it is.
pub(super) async fn cancel(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
) -> Result<Response, ApiError> {
    let job: JobId = id.parse()?;
    app.jobs.cancel(job)?;
    let (record, place) = app.jobs.record(job)?;
    Ok(super::json(&JobDocument::new(&record, place)))
}
