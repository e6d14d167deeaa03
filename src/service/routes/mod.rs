//! The HTTP routes.

mod checks;
mod health;
mod jobs;
mod plan;
mod scenarios;

use std::any::Any;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderValue, Request, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde::Serialize;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer};
use tower_http::trace::{DefaultOnRequest, DefaultOnResponse, TraceLayer};
use tracing::Level;

use super::{ApiError, App, grpc};

/// All routes, gRPC included.
pub(super) fn router(app: Arc<App>) -> Router {
    let http = Router::new()
        .route("/v1/plan", post(plan::plan))
        .route("/v1/jobs", post(jobs::create).get(jobs::list))
        .route("/v1/jobs/{id}", get(jobs::get))
        .route("/v1/jobs/{id}/events", get(jobs::events))
        .route("/v1/jobs/{id}/solutions/{revision}", get(jobs::solution))
        .route("/v1/jobs/{id}/cancel", post(jobs::cancel))
        .route("/v1/validate", post(checks::validate))
        .route("/v1/verify", post(checks::verify))
        .route("/v1/scenarios", get(scenarios::list))
        .route("/v1/scenarios/{*name}", get(scenarios::get))
        .route("/livez", get(health::live))
        .route("/readyz", get(health::ready))
        .method_not_allowed_fallback(async || ApiError::MethodNotAllowed)
        .with_state(Arc::clone(&app));
    http.merge(grpc::router(app))
        .fallback(async |uri: Uri| {
            let shown: String = uri.path().chars().take(100).collect();
            ApiError::NotFound { what: format!("resource {shown}") }
        })
        // Bodies are bounded where they are read (`body::read_json`, gRPC's message limit).
        .layer(DefaultBodyLimit::disable())
        .layer(CatchPanicLayer::custom(answer_panic))
        .layer(PropagateRequestIdLayer::x_request_id())
        .layer(
            TraceLayer::new_for_http()
                .make_span_with(request_span)
                .on_request(DefaultOnRequest::new().level(Level::DEBUG))
                .on_response(DefaultOnResponse::new().level(Level::INFO)),
        )
        .layer(SetRequestIdLayer::x_request_id(MakeRequestUuid))
}

fn answer_panic(panic: Box<dyn Any + Send>) -> Response {
    let message = panic.downcast_ref::<&str>().copied().unwrap_or_default();
    tracing::error!(cause = message, "a handler panicked");
    ApiError::Internal.into_response()
}

fn request_span(request: &Request<Body>) -> tracing::Span {
    let id = request.extensions().get::<RequestId>().and_then(|id| id.header_value().to_str().ok());
    tracing::info_span!("request", method = %request.method(), path = request.uri().path(), id)
}

/// A JSON reply that may change from one request to the next.
fn json<T: Serialize>(document: &T) -> Response {
    match serde_json::to_string(document) {
        Ok(text) => json_text(text),
        Err(error) => {
            tracing::error!(%error, "a reply could not be written");
            ApiError::Internal.into_response()
        }
    }
}

/// A JSON reply that is text already.
fn json_text(text: impl Into<Body>) -> Response {
    let mut response = Response::new(text.into());
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

/// The query's parameters; unknown ones, and ones given twice, are refused.
fn query<const N: usize>(uri: &Uri, known: [&'static str; N]) -> Result<[Option<String>; N], ApiError> {
    let mut found = [const { None }; N];
    for pair in uri.query().unwrap_or_default().split('&').filter(|pair| !pair.is_empty()) {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        let place = known.iter().position(|known| *known == name).and_then(|index| found.get_mut(index));
        let bad = |message: String| ApiError::BadParameter { name: "query", message };
        match place {
            Some(place) if place.is_none() => *place = Some(value.to_owned()),
            Some(_) => return Err(bad(format!("`{name}` stands twice"))),
            None => {
                let shown: String = name.chars().take(50).collect();
                return Err(bad(format!("`{shown}` is not known here; known are: {}", known.join(", "))));
            }
        }
    }
    Ok(found)
}

/// A query parameter as a whole number.
fn whole(name: &'static str, text: Option<&str>) -> Result<Option<u64>, ApiError> {
    text.map(|text| {
        text.parse().map_err(|_| ApiError::BadParameter { name, message: "give a whole number".to_owned() })
    })
    .transpose()
}
