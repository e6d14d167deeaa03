//! The service: HTTP/JSON and gRPC on one port, over the job layer.
//!
//! Handlers are thin: they read, ask [`crate::jobs`], and write. Every refusal is an [`ApiError`].

mod body;
mod documents;
mod error;
mod grpc;
mod intake;
mod negotiation;
mod routes;
mod stream;

pub use error::{ApiError, PROBLEM_JSON, PROBLEM_METADATA};
pub use grpc::proto;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::serve::ListenerExt;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use crate::jobs::{Jobs, JobsConfig, MemoryStore, Planner, Retention};
use crate::wire::ReadLimits;

/// Settings of the service.
#[derive(Debug, Clone)]
pub struct ServiceConfig {
    /// The pool of planner threads and its queue.
    pub jobs: JobsConfig,
    /// What is remembered of ended jobs.
    pub retention: Retention,
    /// Bounds on problems; its `max_bytes` bounds every body.
    pub read_limits: ReadLimits,
    /// Largest plan (bytes) that events carry inline.
    pub inline_plan_bytes: usize,
    /// Most problems that are validated at once.
    pub validations: usize,
    /// How long a shutdown waits for replies and planner threads to end.
    pub drain: Duration,
}

impl Default for ServiceConfig {
    /// One planner thread less than there are processors, but at least one.
    fn default() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            jobs: JobsConfig { workers: processors.saturating_sub(1).max(1), queue_limit: 64 },
            retention: Retention::default(),
            read_limits: ReadLimits::default(),
            inline_plan_bytes: 1 << 20,
            validations: processors,
            drain: Duration::from_secs(10),
        }
    }
}

/// What all handlers share.
pub(crate) struct App {
    config: ServiceConfig,
    jobs: Jobs,
    validations: Arc<Semaphore>,
    shutdown: CancellationToken,
    /// Set once the service is up, and never reset: `/readyz` fails again only at shutdown.
    ready: AtomicBool,
}

impl App {
    fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Acquire) && !self.shutdown.is_cancelled()
    }
}

/// Serves on `listener` until `shutdown` is raised; then ends the streams, waits for the rest up to
/// `config.drain`, and stops the planner threads.
///
/// # Errors
/// When the threads cannot be started or the listener fails.
pub async fn serve(
    listener: TcpListener,
    config: ServiceConfig,
    planner: Arc<dyn Planner>,
    shutdown: CancellationToken,
) -> std::io::Result<()> {
    let store = Arc::new(MemoryStore::new(config.retention));
    let drain = config.drain;
    let app = Arc::new(App {
        jobs: Jobs::start(config.jobs, store, planner)?,
        validations: Arc::new(Semaphore::new(config.validations.max(1))),
        shutdown: shutdown.clone(),
        ready: AtomicBool::new(false),
        config,
    });
    let router = routes::router(Arc::clone(&app));
    // Events are small and must not wait for company.
    let listener = listener.tap_io(|stream| {
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!(%error, "no TCP_NODELAY");
        }
    });
    app.ready.store(true, Ordering::Release);
    let serving = axum::serve(listener, router)
        .with_graceful_shutdown(shutdown.clone().cancelled_owned())
        .into_future();
    tokio::select! {
        result = serving => result?,
        () = async { shutdown.cancelled().await; tokio::time::sleep(drain).await } => {
            tracing::warn!("connections are still open at the end of the drain time");
        }
    }
    let stopped = tokio::task::spawn_blocking(move || app.jobs.stop(drain)).await.unwrap_or(false);
    if !stopped {
        tracing::warn!("planner threads are still busy at the end of the drain time");
    }
    Ok(())
}
