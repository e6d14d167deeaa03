//! `/v1/workcells`: workcells that are sent once and referred to from then on.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use serde_json::{Value, json};

use super::super::body::{read_bundle, read_json};
use super::super::intake::{aside, blocking};
use super::super::negotiation::{BundleFormat, expect_bundle};
use super::super::workcells::{ArchiveError, Bundle, Files, Outcome, Registered, unpack_tar_gz, unpack_zip};
use super::super::{ApiError, App, mode_graph as graphs};
use super::Path;
use crate::geometry::Vec3;
use crate::wire::{self, Fault, read_workcell_value};
use crate::workcell::Workcell;

/// Extents (m) of the box that the mode graph is made for unless the client says otherwise.
const PROBE: &str = "0.06,0.06,0.06";

fn links(id: &str) -> Value {
    json!({ "self": format!("/v1/workcells/{id}"), "modes": format!("/v1/workcells/{id}/modes") })
}

fn entry(registered: &Registered) -> Value {
    json!({
        "id": registered.id, "digest": registered.digest, "registered_at": registered.at.to_string(),
        "links": links(&registered.id),
    })
}

/// `GET /v1/workcells`: what is registered, by id.
pub(super) async fn list(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let found = aside(&app, |app| Ok(app.workcells.list()?)).await?;
    let cells: Vec<Value> = found.iter().map(entry).collect();
    Ok(super::json(&json!({ "workcells": cells })))
}

/// The workcell of that id or digest.
///
/// # Errors
/// When there is none.
pub fn found(app: &App, reference: &str) -> Result<(Registered, Bundle), ApiError> {
    let missing = || ApiError::NotFound { what: "workcell of that id or digest".to_owned() };
    app.workcells.get(reference)?.ok_or_else(missing)
}

/// `GET /v1/workcells/{id}`: the workcell, by id or digest.
pub(super) async fn get(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    // Reading and digesting its files may take a while.
    let shared = Arc::clone(&app);
    let document = blocking(&app, move || {
        let (registered, bundle) = found(&shared, &id)?;
        let files: Vec<Value> = bundle
            .listing()
            .map(|(path, bytes, digest)| json!({ "path": path, "bytes": bytes, "digest": digest }))
            .collect();
        let mut document = entry(&registered);
        document["files"] = json!(files);
        document["workcell"] = bundle.document;
        Ok(document)
    });
    Ok(super::json(&document.await?))
}

/// `DELETE /v1/workcells/{id}`: the id leads nowhere from now on; jobs that were made with it go on.
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    aside(&app, move |app| unregister(app, &id)).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

/// Makes an id lead nowhere.
///
/// # Errors
/// When it led nowhere before.
pub fn unregister(app: &App, id: &str) -> Result<(), ApiError> {
    let gone = app.workcells.delete(id)?;
    if gone { Ok(()) } else { Err(ApiError::NotFound { what: "workcell of that id".to_owned() }) }
}

/// `PUT /v1/workcells/{id}`: registers the workcell in the body, JSON or a bundle.
pub(super) async fn put(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, ApiError> {
    let [] = super::query(&uri, [])?;
    let limit = app.config.read_limits.max_bytes;
    let format = expect_bundle(&headers)?;
    let bytes = match format {
        BundleFormat::Json => read_json(&app.bodies, &headers, body, limit).await?,
        BundleFormat::Zip | BundleFormat::TarGz => read_bundle(&app.bodies, &headers, body, limit).await?,
    };
    let registration = register(&app, id.clone(), format, bytes).await?;
    let mut document = entry(&registration.registered);
    document["arms"] = json!(registration.workcell.arms.len());
    document["obstacles"] = json!(registration.workcell.obstacles.len());
    document["surfaces"] = json!(registration.workcell.surfaces.len());
    document["warnings"] = json!(registration.warnings);
    let mut response = super::json(&document);
    if registration.outcome == Outcome::Created {
        *response.status_mut() = StatusCode::CREATED;
        if let Ok(location) = HeaderValue::from_str(&format!("/v1/workcells/{id}")) {
            response.headers_mut().insert(header::LOCATION, location);
        }
    }
    Ok(response)
}

/// What came of a registration.
pub struct Registration {
    /// What it did.
    pub outcome: Outcome,
    /// The entry.
    pub registered: Registered,
    /// The workcell.
    pub workcell: Arc<Workcell>,
    /// What its author should know.
    pub warnings: Vec<Fault>,
}

/// Registers a workcell.
///
/// # Errors
/// When the id is no good, the bundle or the workcell has faults, or there is no room.
pub async fn register(
    app: &Arc<App>,
    id: String,
    format: BundleFormat,
    bytes: Bytes,
) -> Result<Registration, ApiError> {
    if !wire::is_id(&id) || id.chars().all(|c| c == '.') {
        let message = "ids match [A-Za-z0-9_.-]{1,64}, and are more than dots".to_owned();
        return Err(ApiError::BadParameter { name: "id", message });
    }
    let limit = app.config.read_limits.max_bytes;
    if bytes.len() > limit {
        return Err(ApiError::TooLarge { limit });
    }
    let shared = Arc::clone(app);
    blocking(app, move || {
        let limits = &shared.config.read_limits;
        let (document, files) = match format {
            BundleFormat::Json => (bytes.as_ref().into(), Files::new()),
            BundleFormat::Zip => split(unpack_zip(&bytes, shared.config.archive))?,
            BundleFormat::TarGz => split(unpack_tar_gz(&bytes, shared.config.archive))?,
        };
        if document.len() > limits.max_bytes {
            return Err(ApiError::TooLarge { limit: limits.max_bytes });
        }
        let refuse = |faults: Vec<Fault>| ApiError::of_problem(faults);
        let document = wire::parse_json_bounded(&document, limits.max_json_depth);
        let document = document.map_err(|fault| refuse(vec![fault]))?;
        let bundle = Bundle { document, files };
        let read = read_workcell_value(&bundle.document, &bundle, limits).map_err(refuse)?;
        let used = shared.used_workcells()?;
        let (outcome, registered) = shared.workcells.put(&id, &read.digest, &bundle, &used)?;
        tracing::info!(workcell = id, digest = read.digest, ?outcome, "workcell registered");
        Ok(Registration { outcome, registered, workcell: read.workcell, warnings: read.warnings })
    })
    .await
}

fn split(files: Result<Files, ArchiveError>) -> Result<(Arc<[u8]>, Files), ApiError> {
    let files = files.map_err(|error| ApiError::BadBundle(error.to_string()))?;
    Bundle::split(files).map_err(|error| ApiError::BadBundle(error.to_string()))
}

/// `GET /v1/workcells/{id}/modes`: its mode graph, for a box of `?size=x,y,z`.
pub(super) async fn modes(
    State(app): State<Arc<App>>,
    Path(id): Path<String>,
    uri: Uri,
) -> Result<Response, ApiError> {
    let [size] = super::query(&uri, ["size"])?;
    let graph = mode_graph(&app, &id, size.as_deref()).await?;
    Ok(super::json_text(graph.to_string()))
}

/// The mode graph of a workcell as JSON, for a box of extents `size`, "x,y,z" in metres.
///
/// # Errors
/// When there is no such workcell, no room in it for such a box, or too many wait for graphs already.
pub async fn mode_graph(app: &Arc<App>, id: &str, size: Option<&str>) -> Result<Arc<str>, ApiError> {
    let extents = extents(size.unwrap_or(PROBE))?;
    let id = id.to_owned();
    let (registered, bundle) = aside(app, move |app| found(app, &id)).await?;
    let key = format!("{} {extents:?}", registered.digest);
    if let Some(graph) = app.mode_graphs.get(&key) {
        return Ok(graph);
    }
    let turn = app.mode_graphs.turn().await?;
    aside(app, move |app| {
        // Held by the work itself: a client that leaves does not make room for more.
        let _turn = turn;
        // Who had the turn before may have made the same.
        if let Some(graph) = app.mode_graphs.get(&key) {
            return Ok(graph);
        }
        let config = &app.config;
        let graph = graphs::of_workcell(&bundle, extents, config.mode_graph_budget, &config.read_limits)?;
        let text: Arc<str> = graph.to_string().into();
        if graph["complete"] == json!(true) {
            app.mode_graphs.keep(key, Arc::clone(&text));
        }
        Ok(text)
    })
    .await
}

fn extents(text: &str) -> Result<Vec3, ApiError> {
    let parts: Vec<Option<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match parts[..] {
        [Some(x), Some(y), Some(z)] if [x, y, z].iter().all(|side| (0.001..=10.0).contains(side)) => {
            Ok(Vec3::new(x, y, z))
        }
        _ => {
            let message = "give three extents in metres, such as 0.06,0.06,0.06".to_owned();
            Err(ApiError::BadParameter { name: "size", message })
        }
    }
}
