//! `quadrille serve`: runs the service until it is told to stop.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use super::settings::Settings;
use super::{Answer, CliError};
use crate::jobs::SmartPlanner;
use crate::service::{self, Service, ServiceConfig};

/// Arguments of `serve`. Settings come from the file, then the environment, then flags.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Settings file, TOML; its keys are the long flags with underscores
    #[arg(long, env = "QUADRILLE_CONFIG")]
    config: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
}

pub(super) fn run(arguments: Arguments) -> Result<Answer, CliError> {
    let settings = match &arguments.config {
        Some(path) => arguments.settings.over_file(path).map_err(CliError::Settings)?,
        None => arguments.settings,
    };
    let config = settings.config().map_err(CliError::Settings)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CliError::Service("no runtime".to_owned(), error))?;
    let planner = SmartPlanner::new(settings.cache());
    let answer = runtime.block_on(serve(settings.address(), config, planner));
    // What a stuck planner thread holds is not waited for: the process ends with it.
    runtime.shutdown_background();
    answer
}

async fn serve(listen: SocketAddr, config: ServiceConfig, planner: SmartPlanner) -> Result<Answer, CliError> {
    let named = |error| CliError::Service(format!("cannot listen on {listen}"), error);
    let listener = TcpListener::bind(listen).await.map_err(named)?;
    let address = listener.local_addr().map_err(named)?;
    let shutdown = CancellationToken::new();
    let service = Service::start(config.clone(), Arc::new(planner), shutdown.clone())?;
    let data_dir =
        config.data_dir.as_ref().map_or("none, all is in memory".into(), |path| path.to_string_lossy());
    tracing::info!(
        %address,
        %data_dir,
        drain_s = config.drain.as_secs_f64(),
        keep_alive_s = config.keep_alive.as_secs_f64(),
        limits = %service::limits_document(&config),
        "listening"
    );
    // For whoever started us with port 0.
    println!("listening on {address}");
    tokio::spawn(raise_on_signal(shutdown));
    service.serve(listener).await.map_err(|error| CliError::Service(address.to_string(), error))?;
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
