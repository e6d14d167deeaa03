//! `/v1/scenarios`: problems that ship with the service.

use axum::http::Uri;
use axum::response::Response;
use serde::Serialize;

use super::super::ApiError;
use super::Path;
use crate::scenario;

#[derive(Serialize)]
struct Listing {
    scenarios: Vec<Entry>,
}

#[derive(Serialize)]
struct Entry {
    name: &'static str,
    family: &'static str,
    arms: usize,
    objects: usize,
    href: String,
}

/// `GET /v1/scenarios`: their names.
pub(super) async fn list(uri: Uri) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let scenarios = scenario::catalog()
        .iter()
        .map(|entry| Entry {
            name: entry.name,
            family: entry.family,
            arms: entry.arms,
            objects: entry.objects,
            href: format!("/v1/scenarios/{}", entry.name),
        })
        .collect();
    Ok(super::json(&Listing { scenarios }))
}

/// `GET /v1/scenarios/{family}/{size}`: one of them, ready to be POSTed back.
pub(super) async fn get(Path(name): Path<String>, uri: Uri) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let entry = scenario::find(&name)
        .ok_or_else(|| ApiError::NotFound { what: "scenario of that name".to_owned() })?;
    Ok(super::json_text(entry.text))
}
