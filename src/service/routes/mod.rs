//! The HTTP routes.

mod about;
mod checks;
mod docs;
mod health;
mod jobs;
mod layers;
mod plan;
mod scenarios;
mod table;
mod workcells;

pub use self::about::limits_document;
pub(super) use self::about::version_document;
pub(super) use self::checks::{Judged, verdict};
pub(super) use self::jobs::{label_filter, page_size};
pub(super) use self::table::{Operation, table};
pub(super) use self::workcells::{found, mode_graph, register, unregister};

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{DefaultBodyLimit, FromRequestParts};
use axum::http::request::Parts;
use axum::http::{HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{ApiError, App, grpc};

/// All routes, gRPC included.
pub(super) fn router(app: Arc<App>) -> Router {
    let mut http = Router::new();
    for route in table() {
        http = http.route(route.path, route.methods);
    }
    let http =
        http.method_not_allowed_fallback(async || ApiError::MethodNotAllowed).with_state(Arc::clone(&app));
    let routes = http
        .merge(grpc::router(Arc::clone(&app)))
        .fallback(async |uri: Uri| {
            let shown: String = uri.path().chars().take(100).collect();
            ApiError::NotFound { what: format!("resource {shown}") }
        })
        // Bodies are bounded where they are read (`body`, gRPC's message limit).
        .layer(DefaultBodyLimit::disable());
    layers::around(routes, app)
}

/// What the path holds, refused as everything else is when it is no UTF-8.
struct Path<T>(T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for Path<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let path = axum::extract::Path::from_request_parts(parts, state).await;
        let bad = |why: PathRejection| ApiError::BadParameter { name: "path", message: why.body_text() };
        path.map(|axum::extract::Path(segments)| Self(segments)).map_err(bad)
    }
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

/// The text that `%XX` stands for in a query.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'+' => b' ',
            b'%' => {
                let digits = [rest.next()?, rest.next()?].map(|digit| char::from(digit).to_digit(16));
                u8::try_from(digits[0]? * 16 + digits[1]?).ok()?
            }
            plain => plain,
        });
    }
    String::from_utf8(bytes).ok().filter(|text| !text.contains('\0'))
}

/// The query's parameters by name, in the order given; unknown ones are refused.
fn query_lists<const N: usize>(uri: &Uri, known: [&'static str; N]) -> Result<[Vec<String>; N], ApiError> {
    let mut found = [const { Vec::new() }; N];
    for pair in uri.query().unwrap_or_default().split('&').filter(|pair| !pair.is_empty()) {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        let bad = |message: String| ApiError::BadParameter { name: "query", message };
        let place = known.iter().position(|known| *known == name).and_then(|index| found.get_mut(index));
        let shown = || name.chars().take(50).collect::<String>();
        match (place, decoded(value)) {
            (Some(place), Some(value)) => place.push(value),
            (Some(_), None) => return Err(bad(format!("`{}` is not well encoded", shown()))),
            (None, _) => {
                return Err(bad(format!("`{}` is not known here; known are: {}", shown(), known.join(", "))));
            }
        }
    }
    Ok(found)
}

/// The query's parameters; unknown ones, and ones given twice, are refused.
fn query<const N: usize>(uri: &Uri, known: [&'static str; N]) -> Result<[Option<String>; N], ApiError> {
    let lists = query_lists(uri, known)?;
    if let Some(index) = lists.iter().position(|values| values.len() > 1) {
        let name = known.get(index).copied().unwrap_or_default();
        return Err(ApiError::BadParameter { name: "query", message: format!("`{name}` stands twice") });
    }
    Ok(lists.map(|mut values| values.pop()))
}

/// A query parameter as a whole number.
fn whole(name: &'static str, text: Option<&str>) -> Result<Option<u64>, ApiError> {
    text.map(|text| {
        text.parse().map_err(|_| ApiError::BadParameter { name, message: "give a whole number".to_owned() })
    })
    .transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn queries_are_decoded_and_checked() {
        let uri = |text: &str| format!("/x?{text}").parse::<Uri>().unwrap();
        let lists = query_lists(&uri("a=1&b=x%2Cy&a=+2"), ["a", "b"]).unwrap();
        assert_eq!(lists, [vec!["1".to_owned(), " 2".to_owned()], vec!["x,y".to_owned()]]);
        for bad in ["c=1", "a=%", "a=%zz", "a=%ff", "a=%00"] {
            assert!(query_lists(&uri(bad), ["a", "b"]).is_err(), "{bad}");
        }
        assert!(query(&uri("a=1&a=2"), ["a"]).is_err());
        assert_eq!(query(&uri("a=1"), ["a", "b"]).unwrap(), [Some("1".to_owned()), None]);
    }
}
