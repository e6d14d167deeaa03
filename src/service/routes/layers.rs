//! What surrounds every route: request ids, log spans, who is asking, counting, caught panics.

use std::any::Any;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::HeaderName;
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer};
use tower_http::trace::{DefaultOnRequest, DefaultOnResponse, TraceLayer};
use tracing::Level;

use super::super::client::Client;
use super::super::error::{CODE_METADATA, Refused};
use super::super::{ApiError, App};

const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longest request id that is taken from a client (bytes).
const LONGEST_REQUEST_ID: usize = 128;

/// The routes with everything around them.
pub(super) fn around(routes: Router, app: Arc<App>) -> Router {
    let panicked = Arc::clone(&app);
    routes
        .layer(CatchPanicLayer::custom(move |panic: Box<dyn Any + Send>| {
            panicked.figures.panicked();
            let message = panic.downcast_ref::<&str>().copied().unwrap_or_default();
            tracing::error!(cause = message, "a handler panicked");
            ApiError::Internal.into_response()
        }))
        .layer(middleware::from_fn_with_state(app, account))
        .layer(PropagateRequestIdLayer::x_request_id())
        .layer(
            TraceLayer::new_for_http()
                .make_span_with(request_span)
                .on_request(DefaultOnRequest::new().level(Level::DEBUG))
                .on_response(DefaultOnResponse::new().level(Level::INFO)),
        )
        .layer(SetRequestIdLayer::x_request_id(MakeRequestUuid))
        .layer(middleware::from_fn(drop_bad_request_id))
}

/// Finds out who is asking, and counts what is refused.
async fn account(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let client = Client::of(request.headers(), request.extensions(), app.config.client_header.as_ref());
    request.extensions_mut().insert(client);
    let response = next.run(request).await;
    let text = |name| response.headers().get(name)?.to_str().ok();
    let grpc = text("grpc-status").and_then(|code| code.parse().ok());
    if let Some(Refused(code)) = response.extensions().get() {
        app.figures.refused(code);
    } else if let Some(code) = text(CODE_METADATA) {
        app.figures.refused(code);
    } else if let Some(code) = grpc.filter(|code: &i32| *code != 0) {
        app.figures.refused(&format!("grpc_{:?}", tonic::Code::from_i32(code)).to_lowercase());
    }
    response
}

/// A client's own request id goes into logs and back out: only plain ones do.
async fn drop_bad_request_id(mut request: Request, next: Next) -> Response {
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || b"-_.:/+=".contains(byte);
    let good = request
        .headers()
        .get(&REQUEST_ID)
        .is_none_or(|id| (1..=LONGEST_REQUEST_ID).contains(&id.len()) && id.as_bytes().iter().all(plain));
    if !good {
        request.headers_mut().remove(&REQUEST_ID);
    }
    next.run(request).await
}

fn request_span(request: &axum::http::Request<Body>) -> tracing::Span {
    let id = request.extensions().get::<RequestId>().and_then(|id| id.header_value().to_str().ok());
    tracing::info_span!("request", method = %request.method(), path = request.uri().path(), id)
}
