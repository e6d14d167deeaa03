//! `/openapi.json` and `/docs`: the interface for programs and for people. Nothing is loaded from
//! elsewhere.

use axum::http::{HeaderName, HeaderValue, header};
use axum::response::Response;

use super::super::openapi;

/// The page; its script reads `/openapi.json`.
const PAGE: &str = include_str!("docs.html");

/// `GET /openapi.json`.
pub(super) async fn openapi() -> Response {
    super::json(&openapi::document())
}

/// `GET /docs`.
pub(super) async fn page() -> Response {
    let mut response = Response::new(PAGE.into());
    let policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; \
                  base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
    for (name, value) in [
        (header::CONTENT_TYPE, "text/html; charset=utf-8"),
        (HeaderName::from_static("content-security-policy"), policy),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}
