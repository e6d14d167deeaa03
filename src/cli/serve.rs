//! `quadrille serve`: runs the service until it is told to stop.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use super::{Answer, CliError, budget};
use crate::jobs::SmartPlanner;
use crate::service::{self, ServiceConfig};

/// Arguments of `serve`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Address and port for HTTP and gRPC; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:8080", env = "QUADRILLE_LISTEN")]
    listen: SocketAddr,
    /// Planner threads [default: one less than there are processors, at least 1]
    #[arg(long, env = "QUADRILLE_WORKERS", value_parser = clap::value_parser!(u64).range(1..=1024))]
    workers: Option<u64>,
    /// Most jobs that wait for a planner thread
    #[arg(long, default_value_t = 64, env = "QUADRILLE_QUEUE_LIMIT")]
    queue_limit: usize,
    /// How long a shutdown waits for what is under way
    #[arg(long, default_value = "10s", env = "QUADRILLE_DRAIN", value_parser = budget::parse)]
    drain: Duration,
}

pub(super) fn run(arguments: &Arguments) -> Result<Answer, CliError> {
    let mut config = ServiceConfig { drain: arguments.drain, ..ServiceConfig::default() };
    config.jobs.queue_limit = arguments.queue_limit;
    if let Some(workers) = arguments.workers.and_then(|workers| usize::try_from(workers).ok()) {
        config.jobs.workers = workers;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CliError::Service("no runtime".to_owned(), error))?;
    runtime.block_on(serve(arguments.listen, config))
}

async fn serve(listen: SocketAddr, config: ServiceConfig) -> Result<Answer, CliError> {
    let named = |error| CliError::Service(listen.to_string(), error);
    let listener = TcpListener::bind(listen).await.map_err(named)?;
    let address = listener.local_addr().map_err(named)?;
    tracing::info!(
        %address,
        workers = config.jobs.workers,
        queue_limit = config.jobs.queue_limit,
        max_body_bytes = config.read_limits.max_bytes,
        max_time_budget_s = config.read_limits.max_time_budget_s,
        drain_s = config.drain.as_secs_f64(),
        "listening"
    );
    // For whoever started us with port 0.
    println!("listening on {address}");
    let shutdown = CancellationToken::new();
    tokio::spawn(raise_on_signal(shutdown.clone()));
    service::serve(listener, config, Arc::new(SmartPlanner::default()), shutdown).await.map_err(named)?;
    tracing::info!("stopped");
    Ok(Answer::Yes)
}

/// Raises `shutdown` at SIGTERM or ctrl-c.
async fn raise_on_signal(shutdown: CancellationToken) {
    let interrupt = tokio::signal::ctrl_c();
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(error) => {
                tracing::error!(%error, "SIGTERM will not be heard");
                std::future::pending::<()>().await;
            }
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! {
        result = interrupt => {
            if let Err(error) = result {
                tracing::error!(%error, "ctrl-c will not be heard");
                std::future::pending::<()>().await;
            }
        }
        () = terminate => {}
    }
    tracing::info!("shutting down");
    shutdown.cancel();
}
