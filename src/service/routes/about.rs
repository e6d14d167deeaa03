//! `/v1/limits`, `/v1/version` and `/metrics`: what the service is, takes, and does.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderValue, Uri, header};
use axum::response::Response;
use serde_json::{Value, json};

use super::super::{ApiError, App, ServiceConfig};
use crate::wire::{MAX_LABEL_VALUE, MAX_LABELS, MAX_PRIORITY};

/// What the service takes at most.
pub fn limits_document(config: &ServiceConfig) -> Value {
    // In parts: one macro does not take so many members.
    let parts = [document_limits(config), job_limits(config), service_limits(config)];
    parts
        .iter()
        .filter_map(Value::as_object)
        .flatten()
        .map(|(name, most)| (name.clone(), most.clone()))
        .collect()
}

/// Of what is sent.
fn document_limits(config: &ServiceConfig) -> Value {
    let read = &config.read_limits;
    json!({
        "body_bytes": read.max_bytes,
        "json_depth": read.max_json_depth,
        "robots": read.max_robots,
        "links_per_robot": read.max_links,
        "link_shapes_per_robot": read.max_link_shapes,
        "arms": read.max_arms,
        "obstacles": read.max_obstacles,
        "surfaces": read.max_surfaces,
        "objects": read.max_objects,
        "grasps_per_object": read.max_grasps,
        "convex_points": read.max_points,
        "triangles_per_mesh": read.max_triangles,
        "triangles_per_document": read.max_triangles_together(),
        "urdf_bytes": read.max_urdf_bytes,
        "mesh_bytes": read.max_mesh_bytes,
        "threads": read.max_threads,
        "time_budget_default_s": read.default_time_budget_s,
        "time_budget_max_s": read.max_time_budget_s,
        "labels": MAX_LABELS,
        "label_bytes": MAX_LABEL_VALUE,
        "priority_min": -MAX_PRIORITY,
        "priority_max": MAX_PRIORITY,
        "bundle_entries": config.archive.entries,
        "bundle_unpacked_bytes": config.archive.unpacked_bytes,
        "bundle_file_bytes": config.archive.file_bytes,
        "bundle_ratio": config.archive.ratio,
    })
}

/// Of jobs, and of what is kept of them.
fn job_limits(config: &ServiceConfig) -> Value {
    json!({
        "priority_aging_s": config.jobs.aging.as_secs_f64(),
        "workers": config.jobs.workers,
        "queue": config.jobs.queue_limit,
        "jobs_per_client": config.jobs.client_limit.min(1 << 53),
        "attempts": config.jobs.attempts,
        "inline_plan_bytes": config.inline_plan_bytes,
        "retained_jobs": config.retention.jobs,
        "retained_plan_bytes": config.retention.plan_bytes,
        "retained_s": config.retention.age.as_secs_f64(),
        "events_per_job": config.retention.job_events,
        "plan_bytes_per_job": config.retention.job_plan_bytes,
    })
}

/// Of all clients together, or of one.
fn service_limits(config: &ServiceConfig) -> Value {
    json!({
        "bodies_bytes": config.bodies_bytes,
        "connections": config.connections,
        "connections_per_address": config.client_connections,
        "streams": config.streams,
        "streams_per_client": config.client_streams,
        "workcells": config.workcells,
        "workcells_bytes": config.workcells_bytes,
    })
}

/// Name and version of the service, and the schemas that it speaks.
pub fn version_document() -> Value {
    json!({
        "name": env!("CARGO_PKG_NAME"),
        "version": env!("CARGO_PKG_VERSION"),
        "api": "v1",
        "problem_schema": "quadrille.problem/1",
        "plan_schema": crate::wire::plan::SCHEMA,
    })
}

/// `GET /v1/limits`.
pub(super) async fn limits(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    Ok(super::json(&limits_document(&app.config)))
}

/// `GET /v1/version`.
pub(super) async fn version(uri: Uri) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    Ok(super::json(&version_document()))
}

/// `GET /metrics`: Prometheus' text format.
pub(super) async fn metrics(State(app): State<Arc<App>>) -> Response {
    let mut response = Response::new(app.figures.render(app.jobs.load(), app.streams.count()).into());
    let kind = HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8");
    response.headers_mut().insert(header::CONTENT_TYPE, kind);
    response
}
