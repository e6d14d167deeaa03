//! Whether the process lives, and whether it takes work.

use std::sync::Arc;

use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde_json::json;

use super::super::App;

/// `GET /livez`: the process answers.
pub(super) async fn live() -> Response {
    super::json(&json!({ "status": "ok" }))
}

/// `GET /readyz`: the service is up. Latched: from the first success on, only a shutdown unsets it.
pub(super) async fn ready(State(app): State<Arc<App>>) -> Response {
    if let Err(error) = app.check_ready() {
        return error.into_response();
    }
    let load = app.jobs.load();
    super::json(&json!({
        "status": "ok", "workers": load.workers, "running": load.running, "waiting": load.waiting,
    }))
}
