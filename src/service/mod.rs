//! The service: HTTP/JSON and gRPC on one port, over the job layer.
//!
//! Handlers are thin: they read, ask [`crate::jobs`], and write. Every refusal is an [`ApiError`].

mod body;
mod client;
mod config;
mod documents;
mod door;
mod error;
mod figures;
mod grpc;
mod intake;
mod mode_graph;
mod mode_graphs;
mod negotiation;
mod openapi;
mod routes;
mod stream;
mod workcells;

pub use config::ServiceConfig;
pub use door::files_allowed;
pub use error::{ApiError, PROBLEM_JSON, PROBLEM_METADATA};
pub use grpc::proto;
pub use mode_graph::document as mode_graph_document;
pub use openapi::{document as openapi_document, standalone as json_schemas};
pub use routes::limits_document;
pub use workcells::{
    ArchiveError, ArchiveLimits, Bundle, BundleError, Files, RegistryError, unpack_tar_gz, unpack_zip,
};

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::serve::ListenerExt;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use self::body::BodyRoom;
use self::client::{Client, StreamPermit, Streams};
use self::door::Door;
use self::figures::Figures;
use self::intake::{KeyLocks, Reader};
use self::mode_graphs::ModeGraphs;
use self::workcells::Workcells;
use crate::jobs::{EmbeddedStore, JobState, Jobs, ListQuery, Parts, Planner, StoreError};

/// How often figures are tidied, and the store is looked after.
const TIDY: Duration = Duration::from_secs(1);
/// How often the end of the last reader is looked for at a shutdown.
const CLOSING_POLL: Duration = Duration::from_millis(2);
/// How much of the drain time is kept for the end of the process itself: one part in so many, but no more
/// than [`LONGEST_END`].
const END_PART: u32 = 10;
/// Most of the drain time that is kept.
const LONGEST_END: Duration = Duration::from_millis(500);

/// How long a shutdown waits for others, so that the process has ended within `drain`.
fn patience(drain: Duration) -> Duration {
    drain.saturating_sub((drain / END_PART).min(LONGEST_END))
}

/// What all handlers share.
pub(crate) struct App {
    config: ServiceConfig,
    jobs: Jobs,
    workcells: Arc<Workcells>,
    mode_graphs: ModeGraphs,
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
    /// Fails unless the service takes work.
    fn check_ready(&self) -> Result<(), ApiError> {
        if !self.ready.load(Ordering::Acquire) || self.shutdown.is_cancelled() {
            return Err(ApiError::Unavailable);
        }
        self.jobs.store().failure().map_or(Ok(()), |_| Err(ApiError::StorageFailed))
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

/// Why the service could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The data directory cannot be used.
    #[error("the data directory {}: {why}", folder.display())]
    DataDirectory {
        /// Which one.
        folder: PathBuf,
        /// What is wrong with it.
        why: StoreError,
    },
    /// What an earlier process has left cannot be taken up, or the system gives no threads.
    #[error("the jobs: {0}")]
    Jobs(std::io::Error),
    /// Our own fault.
    #[error("{0}")]
    Internal(String),
}

/// A service that has its data and its planner threads, and waits for a listener.
pub struct Service {
    app: Arc<App>,
}

/// Serves on `listener` until `shutdown` is raised: [`Service::start`] and [`Service::serve`] in one.
///
/// # Errors
/// When the store or the threads cannot be started, or the listener fails.
pub async fn serve(
    listener: TcpListener,
    config: ServiceConfig,
    planner: Arc<dyn Planner>,
    shutdown: CancellationToken,
) -> std::io::Result<()> {
    let service = Service::start(config, planner, shutdown).map_err(std::io::Error::other)?;
    service.serve(listener).await
}

impl Service {
    /// Opens the store, takes up what an earlier process has left, and starts the planner threads.
    ///
    /// # Errors
    /// When one of them does not work.
    pub fn start(
        config: ServiceConfig,
        planner: Arc<dyn Planner>,
        shutdown: CancellationToken,
    ) -> Result<Self, StartError> {
        let internal = |error: &dyn std::fmt::Display| StartError::Internal(error.to_string());
        let figures = Arc::new(Figures::new().map_err(|error| internal(&error))?);
        let store = match &config.data_dir {
            Some(folder) => EmbeddedStore::open(folder, config.retention)
                .map_err(|why| StartError::DataDirectory { folder: folder.clone(), why })?,
            None => EmbeddedStore::in_memory(config.retention).map_err(|error| internal(&error))?,
        };
        let workcells = Workcells::open(store.database(), config.workcells, config.workcells_bytes);
        let workcells = Arc::new(workcells.map_err(|error| internal(&error))?);
        let reader = Reader { workcells: Arc::clone(&workcells), limits: config.read_limits.clone() };
        let parts = Parts {
            store: Arc::new(store),
            planner,
            reader: Arc::new(reader),
            observer: Arc::<Figures>::clone(&figures),
        };
        let app = App {
            jobs: Jobs::start(config.jobs, parts).map_err(StartError::Jobs)?,
            workcells,
            mode_graphs: ModeGraphs::default(),
            keys: KeyLocks::default(),
            streams: Arc::default(),
            figures,
            bodies: BodyRoom::new(config.bodies_bytes),
            validations: Arc::new(Semaphore::new(config.validations.max(1))),
            shutdown,
            ready: AtomicBool::new(false),
            config,
        };
        Ok(Self { app: Arc::new(app) })
    }

    /// Serves on `listener` until the shutdown is raised; then ends the streams, gives running jobs back
    /// to the queue, and waits for all that a little less than `config.drain`.
    ///
    /// # Errors
    /// When the listener fails, or the store does not take any more what is written: what was accepted
    /// until then goes on with the next start.
    pub async fn serve(self, listener: TcpListener) -> std::io::Result<()> {
        let app = self.app;
        let (patience, shutdown) = (patience(app.config.drain), app.shutdown.clone());
        let router = routes::router(Arc::clone(&app));
        let config = &app.config;
        // Behind a proxy that names the clients all connections are its own.
        let own = if config.client_header.is_some() { usize::MAX } else { config.client_connections };
        let figures = Arc::clone(&app.figures);
        let door = Door::new(listener, config.connections, own, figures, shutdown.clone());
        app.ready.store(true, Ordering::Release);
        tokio::spawn(tidy(Arc::clone(&app)));
        let stopping = tokio::spawn(stop_jobs(Arc::clone(&app)));
        let serving =
            axum::serve(door.tap_io(|_| {}), router.into_make_service_with_connect_info::<SocketAddr>())
                .with_graceful_shutdown(shutdown.clone().cancelled_owned())
                .into_future();
        tokio::select! {
            result = serving => result?,
            () = async { shutdown.cancelled().await; tokio::time::sleep(patience).await } => {
                tracing::warn!("connections are still open at the end of the drain time");
            }
        }
        let failure = app.jobs.store().failure();
        shutdown.cancel();
        let (stopped, told) = stopping.await.unwrap_or((false, Instant::now()));
        if !stopped {
            tracing::warn!("planner threads are still busy at the end of the drain time");
        }
        // Who serves after us in this process may open the store only when nobody has it any more.
        while Arc::strong_count(&app) > 1 && told.elapsed() < patience {
            tokio::time::sleep(CLOSING_POLL).await;
        }
        failure.map_or(Ok(()), |why| Err(std::io::Error::other(format!("the store failed: {why}"))))
    }
}

/// Waits for the shutdown and stops the job layer; whether all threads have ended in time, and when the
/// shutdown was raised.
async fn stop_jobs(app: Arc<App>) -> (bool, Instant) {
    app.shutdown.cancelled().await;
    let told = Instant::now();
    let patience = patience(app.config.drain);
    let stopped = tokio::task::spawn_blocking(move || app.jobs.stop(patience)).await.unwrap_or(false);
    tracing::info!(took_s = told.elapsed().as_secs_f64(), "planner threads have stopped");
    (stopped, told)
}

async fn tidy(app: Arc<App>) {
    while !app.shutdown.is_cancelled() {
        app.figures.tidy();
        if let Some(why) = app.jobs.store().failure() {
            tracing::error!(why, "the store takes nothing any more; shutting down");
            app.shutdown.cancel();
        }
        tokio::select! {
            () = app.shutdown.cancelled() => {}
            () = tokio::time::sleep(TIDY) => {}
        }
    }
}
