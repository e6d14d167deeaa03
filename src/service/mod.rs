//! The service: HTTP/JSON and gRPC on one port, over the job layer.
//!
//! Handlers are thin: they read, ask [`crate::jobs`], and write. Every refusal is an [`ApiError`].

mod body;
mod client;
mod config;
mod documents;
mod error;
mod figures;
mod grpc;
mod intake;
mod mode_graph;
mod negotiation;
mod openapi;
mod routes;
mod stream;
mod workcells;

pub use config::ServiceConfig;
pub use error::{ApiError, PROBLEM_JSON, PROBLEM_METADATA};
pub use grpc::proto;
pub use mode_graph::document as mode_graph_document;
pub use openapi::{document as openapi_document, standalone as json_schemas};
pub use routes::limits_document;
pub use workcells::{
    ArchiveError, ArchiveLimits, Bundle, BundleError, Files, RegistryError, unpack_tar_gz, unpack_zip,
};

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use axum::serve::ListenerExt;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use self::body::BodyRoom;
use self::client::{Client, StreamPermit, Streams};
use self::figures::Figures;
use self::intake::{KeyLocks, Reader};
use self::workcells::Workcells;
use crate::jobs::{EmbeddedStore, JobState, Jobs, ListQuery, Parts, Planner};

/// How often figures are tidied.
const TIDY: Duration = Duration::from_secs(5);
/// How often the end of the last reader is looked for at a shutdown.
const CLOSING_POLL: Duration = Duration::from_millis(2);

/// What all handlers share.
pub(crate) struct App {
    config: ServiceConfig,
    jobs: Jobs,
    workcells: Arc<Workcells>,
    /// Mode graphs of workcells, by digest and extents.
    mode_graphs: Mutex<BTreeMap<String, Arc<str>>>,
    keys: KeyLocks,
    streams: Arc<Streams>,
    figures: Arc<Figures>,
    validations: Arc<Semaphore>,
    bodies: BodyRoom,
    shutdown: CancellationToken,
    /// Set once the service is up, and never reset: `/readyz` fails again only at shutdown.
    ready: AtomicBool,
}

impl App {
    fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Acquire) && !self.shutdown.is_cancelled()
    }

    fn open_stream(&self, client: &Client) -> Result<StreamPermit, ApiError> {
        self.streams.open(client, self.config.streams, self.config.client_streams)
    }

    /// Digests of the workcells that jobs refer to which have not ended.
    fn used_workcells(&self) -> Result<BTreeSet<String>, ApiError> {
        let states = vec![JobState::Queued, JobState::Running];
        let open =
            self.jobs.store().list(&ListQuery { limit: usize::MAX, states, ..ListQuery::default() })?;
        let digests = open.iter().filter_map(|record| self.jobs.store().request(record.id).ok()?.workcell);
        Ok(digests.collect())
    }
}

/// Serves on `listener` until `shutdown` is raised; then ends the streams, gives running jobs back to
/// the queue, and waits for all that up to `config.drain`.
///
/// # Errors
/// When the store or the threads cannot be started, or the listener fails.
pub async fn serve(
    listener: TcpListener,
    config: ServiceConfig,
    planner: Arc<dyn Planner>,
    shutdown: CancellationToken,
) -> std::io::Result<()> {
    let app = start(config, planner, shutdown.clone()).await?;
    let drain = app.config.drain;
    let router = routes::router(Arc::clone(&app));
    // Events are small and must not wait for company.
    let listener = listener.tap_io(|stream| {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
    });
    app.ready.store(true, Ordering::Release);
    tokio::spawn(tidy(Arc::clone(&app)));
    let stopping = tokio::spawn(stop_jobs(Arc::clone(&app)));
    let serving = axum::serve(listener, router.into_make_service_with_connect_info::<SocketAddr>())
        .with_graceful_shutdown(shutdown.clone().cancelled_owned())
        .into_future();
    tokio::select! {
        result = serving => result?,
        () = async { shutdown.cancelled().await; tokio::time::sleep(drain).await } => {
            tracing::warn!("connections are still open at the end of the drain time");
        }
    }
    shutdown.cancel();
    if !stopping.await.unwrap_or(false) {
        tracing::warn!("planner threads are still busy at the end of the drain time");
    }
    // Who serves after us in this process may open the store only when nobody has it any more.
    let began = Instant::now();
    while Arc::strong_count(&app) > 1 && began.elapsed() < drain {
        tokio::time::sleep(CLOSING_POLL).await;
    }
    Ok(())
}

/// Opens the store and starts the job layer.
async fn start(
    config: ServiceConfig,
    planner: Arc<dyn Planner>,
    shutdown: CancellationToken,
) -> std::io::Result<Arc<App>> {
    let figures = Arc::new(Figures::new().map_err(std::io::Error::other)?);
    let store = match &config.data_dir {
        Some(folder) => EmbeddedStore::open(folder, config.retention),
        None => EmbeddedStore::in_memory(config.retention),
    };
    let store = store.map_err(std::io::Error::other)?;
    let workcells = Workcells::open(store.database(), config.workcells).map_err(std::io::Error::other)?;
    let workcells = Arc::new(workcells);
    let reader = Reader { workcells: Arc::clone(&workcells), limits: config.read_limits.clone() };
    let parts = Parts {
        store: Arc::new(store),
        planner,
        reader: Arc::new(reader),
        observer: Arc::<Figures>::clone(&figures),
    };
    Ok(Arc::new(App {
        jobs: Jobs::start(config.jobs, parts)?,
        workcells,
        mode_graphs: Mutex::default(),
        keys: KeyLocks::default(),
        streams: Arc::default(),
        figures,
        bodies: BodyRoom::new(config.bodies_bytes),
        validations: Arc::new(Semaphore::new(config.validations.max(1))),
        shutdown,
        ready: AtomicBool::new(false),
        config,
    }))
}

/// Waits for the shutdown and stops the job layer; whether all threads have ended in time.
async fn stop_jobs(app: Arc<App>) -> bool {
    app.shutdown.cancelled().await;
    let began = Instant::now();
    let drain = app.config.drain;
    let stopped = tokio::task::spawn_blocking(move || app.jobs.stop(drain)).await.unwrap_or(false);
    tracing::info!(took_s = began.elapsed().as_secs_f64(), "planner threads have stopped");
    stopped
}

async fn tidy(app: Arc<App>) {
    while !app.shutdown.is_cancelled() {
        app.figures.tidy();
        tokio::select! {
            () = app.shutdown.cancelled() => {}
            () = tokio::time::sleep(TIDY) => {}
        }
    }
}
