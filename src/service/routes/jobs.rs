//! `/v1/jobs`: jobs that outlive the request that made them.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::super::body::read_json;
use super::super::client::Client;
use super::super::documents::{IncumbentDocument, JobDocument, job_path};
use super::super::intake::{Source, accept, aside, checked_key};
use super::super::negotiation::StreamFormat;
use super::super::stream::CancelOnDrop;
use super::super::{ApiError, App};
use super::Path;
use super::plan::event_reply;
use crate::jobs::{BadJobId, JobId, JobState, ListQuery, Revision};

/// Jobs on one page, unless the client asks for fewer.
const PAGE: usize = 100;
/// Most jobs on one page.
const LARGEST_PAGE: usize = 1000;

/// `POST /v1/jobs`: accepts the problem in the body; 202 and where the job is.
pub(super) async fn create(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let key = idempotency_key(&headers)?;
    let document = read_json(&app.bodies, &headers, body, app.config.read_limits.max_bytes).await?;
    let (record, _) = accept(&app, Source::Document(document), &client, key, false).await?;
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

/// The request's idempotency key.
pub(super) fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, ApiError> {
    headers.get("idempotency-key").map(|value| checked_key(value.to_str().unwrap_or_default())).transpose()
}

/// A filter by label: `key`, or `key:value`.
pub fn label_filter(text: &str) -> (String, Option<String>) {
    match text.split_once(':') {
        Some((key, value)) => (key.to_owned(), Some(value.to_owned())),
        None => (text.to_owned(), None),
    }
}

/// A state by its name.
///
/// # Errors
/// When there is none of that name.
pub fn state_filter(name: &str) -> Result<JobState, ApiError> {
    let names = JobState::ALL.map(JobState::as_str).join(", ");
    let bad = ApiError::BadParameter { name: "state", message: format!("give some of {names}") };
    JobState::of_name(name).ok_or(bad)
}

/// How many jobs stand on a page for which a client asks for `limit`.
pub fn page_size(limit: Option<u64>) -> usize {
    limit.and_then(|limit| usize::try_from(limit).ok()).unwrap_or(PAGE).clamp(1, LARGEST_PAGE)
}

/// `GET /v1/jobs`: jobs, newest first; `?limit=` and `?before=` for pages, `?state=` (several, or with
/// commas) and `?label=key:value` (several: all) to choose.
pub(super) async fn list(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, ApiError> {
    let [limits, befores, states, labels] = super::query_lists(&uri, ["limit", "before", "state", "label"])?;
    let limit = page_size(super::whole("limit", limits.last().map(String::as_str))?);
    let before =
        befores.last().map(|text| text.parse()).transpose().map_err(|error: BadJobId| {
            ApiError::BadParameter { name: "before", message: error.to_string() }
        })?;
    let query = ListQuery {
        before,
        limit: limit + 1,
        states: states.iter().flat_map(|list| list.split(',')).map(state_filter).collect::<Result<_, _>>()?,
        labels: labels.iter().map(|text| label_filter(text)).collect(),
    };
    let records = aside(&app, move |app| Ok(app.jobs.store().list(&query)?)).await?;
    let next = (records.len() > limit).then(|| {
        // The same question again, from the last one on.
        let same = uri.query().unwrap_or_default().split('&');
        let same = same.filter(|pair| !pair.is_empty() && !pair.starts_with("before="));
        let last = records.get(limit - 1).map(|last| format!("before={}", last.id));
        let pairs: Vec<String> = same.map(str::to_owned).chain(last).collect();
        format!("/v1/jobs?{}", pairs.join("&"))
    });
    let jobs = records
        .iter()
        .take(limit)
        .map(|record| JobDocument::new(record, app.jobs.queue_position(record.id)))
        .collect();
    Ok(super::json(&Page { jobs, next }))
}

/// `DELETE /v1/jobs/{id}`: forgets a job that has ended; 409 for one that has not.
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let job: JobId = id.parse()?;
    aside(&app, move |app| Ok(app.jobs.store().delete(job)?)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

#[derive(Serialize)]
struct Incumbents {
    incumbents: Vec<IncumbentDocument>,
}

/// `GET /v1/jobs/{id}/incumbents`: its plans without the plans themselves, from revision `?from=` on.
pub(super) async fn incumbents(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [from, limit] = super::query(&uri, ["from", "limit"])?;
    let from = super::whole("from", from.as_deref())?.unwrap_or(1);
    let limit = page_size(super::whole("limit", limit.as_deref())?);
    let job: JobId = id.parse()?;
    let found = aside(&app, move |app| Ok(app.jobs.incumbents(job, from, limit)?)).await?;
    let incumbents = found.iter().filter_map(|event| IncumbentDocument::new(event)).collect();
    Ok(super::json(&Incumbents { incumbents }))
}

/// `GET /v1/jobs/{id}`: a job as it is now.
pub(super) async fn get(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let (record, place) = app.jobs.record(id.parse()?)?;
    Ok(super::json(&JobDocument::new(&record, place)))
}

/// `GET /v1/jobs/{id}/events`: its events after number `?after=` or `Last-Event-ID`, whichever is
/// greater, until the terminal one; 204 when that one is among those already seen.
pub(super) async fn events(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
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
    let permit = app.open_stream(&client)?;
    let guard = CancelOnDrop::new(Arc::clone(&app), job, false);
    Ok(event_reply(app, &record, subscription, format, guard, permit))
}

/// `GET /v1/jobs/{id}/solutions/{revision}`: a plan, by number or `best`.
pub(super) async fn solution(
    State(app): State<Arc<App>>,
    Path((id, revision)): Path<(String, String)>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let revision = match revision.as_str() {
        "best" => Revision::Best,
        number => Revision::Number(number.parse().map_err(|_| ApiError::NoSolution)?),
    };
    let job: JobId = id.parse()?;
    let found = aside(&app, move |app| Ok(app.jobs.store().solution(job, revision)?)).await?;
    let incumbent = found.ok_or(ApiError::NoSolution)?;
    Ok(super::json_text(incumbent.document.to_string()))
}

/// `POST /v1/jobs/{id}/cancel`: ends the job; its best plan is kept. A job that has ended stays as
/// it is.
pub(super) async fn cancel(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let job: JobId = id.parse()?;
    let cancelled = aside(&app, move |app| {
        app.jobs.cancel(job)?;
        Ok(app.jobs.record(job)?)
    });
    let (record, place) = cancelled.await?;
    Ok(super::json(&JobDocument::new(&record, place)))
}
