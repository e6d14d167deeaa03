//! `POST /v1/plan`: a job and its events in one exchange.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::Response;

use super::super::body::read_json;
use super::super::client::{Client, StreamPermit};
use super::super::documents::job_path;
use super::super::intake::{Source, accept};
use super::super::negotiation::StreamFormat;
use super::super::stream::{CancelOnDrop, event_body};
use super::super::{ApiError, App};
use crate::jobs::{JobRecord, Subscription};

/// Creates a job from the problem in the body and streams its events. The job goes on when the
/// client that made it leaves, unless `?cancel_on_disconnect=true`.
pub(super) async fn plan(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let format = StreamFormat::negotiate(&headers)?;
    let [cancel] = super::query(&uri, ["cancel_on_disconnect"])?;
    let cancel = match cancel.as_deref() {
        None | Some("false") => false,
        Some("true") => true,
        Some(_) => {
            let message = "give true or false".to_owned();
            return Err(ApiError::BadParameter { name: "cancel_on_disconnect", message });
        }
    };
    let document = read_json(&app.bodies, &headers, body, app.config.read_limits.max_bytes).await?;
    let key = super::jobs::idempotency_key(&headers)?;
    let permit = app.open_stream(&client)?;
    let (record, guard) = accept(&app, Source::Document(document), &client, key, cancel).await?;
    let subscription = app.jobs.subscribe(record.id, 0)?;
    Ok(event_reply(app, &record, subscription, format, guard, permit))
}

/// The reply that streams a job's events.
pub(super) fn event_reply(
    app: Arc<App>,
    record: &JobRecord,
    subscription: Subscription,
    format: StreamFormat,
    guard: CancelOnDrop,
    permit: StreamPermit,
) -> Response {
    let mut response = Response::new(event_body(app, subscription, format, guard, permit));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(header::VARY, HeaderValue::from_static("accept"));
    // Some proxies hold replies back until they are whole; this tells them not to.
    headers.insert("x-accel-buffering", HeaderValue::from_static("no"));
    if let Ok(location) = HeaderValue::from_str(&job_path(record)) {
        headers.insert(header::LOCATION, location);
    }
    response
}
