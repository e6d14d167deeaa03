//! The gRPC face: the same operations as HTTP, over the same job layer.

mod messages;
mod planning;

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use tonic::Status;
use tonic::server::NamedService;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use self::planning::PlanningService;
use self::proto::planning_server::PlanningServer;
use super::App;
use super::body::read;
use super::negotiation::expect_grpc;

/// What `api/quadrille/v1/planning.proto` defines, messages, server and client.
#[allow(missing_docs, clippy::all, clippy::pedantic)]
pub mod proto {
    tonic::include_proto!("quadrille.v1");

    /// The compiled interface, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/planning.descriptors"));
}

/// Room in a message for what stands around a document.
const ENVELOPE: usize = 64 << 10;

/// The gRPC routes: planning, health, reflection.
pub(super) fn router(app: Arc<App>) -> Router {
    // Messages are bounded where they are received.
    let planning = PlanningServer::new(PlanningService::new(Arc::clone(&app)))
        .max_decoding_message_size(usize::MAX)
        .max_encoding_message_size(usize::MAX);
    let receiving = middleware::from_fn_with_state(Arc::clone(&app), receive);
    let health = HealthReporter::new();
    let health_server = tonic_health::pb::health_server::HealthServer::new(
        tonic_health::server::HealthService::from_health_reporter(health.clone()),
    );
    tokio::spawn(report_health(health, app));
    let mut routes = Routes::builder();
    routes.add_service(planning).add_service(health_server);
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(proto::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    match (reflection().build_v1(), reflection().build_v1alpha()) {
        (Ok(v1), Ok(v1alpha)) => {
            routes.add_service(v1).add_service(v1alpha);
        }
        (Err(error), _) | (_, Err(error)) => tracing::error!(%error, "no reflection service"),
    }
    // What no service answers falls through to the HTTP routes' own 404.
    routes.routes().into_axum_router().reset_fallback().layer(receiving)
}

/// Receives the message of a call to the planning service as HTTP receives a body: bounded in size and
/// time, and in memory together with all others. What is no gRPC gets HTTP's own refusal, 415.
async fn receive(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let ours = request.uri().path().split('/').nth(1) == Some(PlanningServer::<PlanningService>::NAME);
    if !ours {
        return next.run(request).await;
    }
    if let Err(error) = expect_grpc(request.headers()) {
        return error.into_response();
    }
    // A problem and a plan, each within the bound.
    let largest = app.config.read_limits.max_bytes.saturating_mul(2).saturating_add(ENVELOPE);
    let (mut parts, body) = request.into_parts();
    match read(&app.bodies, &parts.headers, body, largest).await {
        Ok((bytes, held)) => {
            parts.extensions.insert(held);
            next.run(Request::from_parts(parts, Body::from(bytes.freeze()))).await
        }
        Err(error) => Status::from(error).into_http(),
    }
}

/// Says SERVING while the service takes work.
async fn report_health(health: HealthReporter, app: Arc<App>) {
    health.set_serving::<PlanningServer<PlanningService>>().await;
    app.shutdown.cancelled().await;
    health.set_not_serving::<PlanningServer<PlanningService>>().await;
    // The service as a whole, which says SERVING from its beginning.
    health.set_service_status("", ServingStatus::NotServing).await;
}
