//! The planning service's calls.

use std::pin::Pin;
use std::sync::Arc;

use bytes::Bytes;
use futures::{Stream, StreamExt};
use serde_json::json;
use tonic::{Extensions, Request, Response, Status};

use super::super::body::Held;
use super::super::client::{Client, StreamPermit};
use super::super::intake::{Source, accept, aside, blocking, checked_key, validate};
use super::super::negotiation::BundleFormat;
use super::super::routes::{self, Judged};
use super::super::stream::CancelOnDrop;
use super::super::{ApiError, App};
use super::messages;
use super::proto::planning_server::Planning;
use super::proto::put_workcell_request::Content;
use super::proto::{self, Event, Job};
use crate::jobs::{BadJobId, JobId, JobRecord, ListQuery, Revision, Subscription};

/// The planning service.
pub(super) struct PlanningService {
    app: Arc<App>,
}

type EventStream = Pin<Box<dyn Stream<Item = Result<Event, Status>> + Send>>;

impl PlanningService {
    pub(super) fn new(app: Arc<App>) -> Self {
        Self { app }
    }

    fn job(&self, id: JobId) -> Result<Job, ApiError> {
        let (record, place) = self.app.jobs.record(id)?;
        Ok(messages::job(&record, place))
    }

    /// The stream of what `subscription` gives; it ends after the terminal event, or with
    /// UNAVAILABLE when the service shuts down.
    fn events(
        &self,
        mut subscription: Subscription,
        mut guard: CancelOnDrop,
        permit: StreamPermit,
    ) -> EventStream {
        let app = Arc::clone(&self.app);
        Box::pin(async_stream::stream! {
            let _permit = permit;
            loop {
                tokio::select! {
                    biased;
                    delivery = subscription.next() => {
                        let Some(delivery) = delivery else { break };
                        yield Ok(messages::event(&delivery, app.config.inline_plan_bytes));
                    }
                    () = app.shutdown.cancelled() => {
                        yield Err(ApiError::Unavailable.into());
                        break;
                    }
                }
            }
            guard.disarm();
        })
    }
}

fn job_id(text: &str) -> Result<JobId, ApiError> {
    text.parse().map_err(|error: BadJobId| error.into())
}

/// How many entries a client that asks for `limit` gets; 0 is for no wish.
fn page_size(limit: u32) -> usize {
    routes::page_size((limit > 0).then_some(u64::from(limit)))
}

/// Splits a request for a job into what the intake takes.
fn source(
    held: &Held,
    problem: String,
    options: Option<proto::JobOptions>,
) -> Result<(Source, Option<String>), ApiError> {
    let options = options.unwrap_or_default();
    let key = Some(options.idempotency_key).filter(|key| !key.is_empty());
    let key = key.map(|key| checked_key(&key)).transpose()?;
    let mut around = serde_json::Map::new();
    around.insert("labels".to_owned(), json!(options.labels));
    around.insert("priority".to_owned(), json!(options.priority));
    // What is not finite becomes null, which would be no wish at all.
    match options.queue_ttl_s {
        Some(seconds) if !seconds.is_finite() => {
            let message = "give a finite number of seconds".to_owned();
            return Err(ApiError::BadParameter { name: "queue_ttl_s", message });
        }
        seconds => around.insert("queue_ttl_s".to_owned(), json!(seconds)),
    };
    let warm_start = Some(options.warm_start_json).filter(|text| !text.is_empty());
    let warm_start = warm_start.map(|text| held.bytes(text));
    Ok((Source::Parts { problem: held.bytes(problem), around, warm_start }, key))
}

impl PlanningService {
    async fn accept(
        &self,
        extensions: &Extensions,
        problem: String,
        options: Option<proto::JobOptions>,
        cancel: bool,
    ) -> Result<(JobRecord, CancelOnDrop), ApiError> {
        let (source, key) = source(&Held::known(extensions), problem, options)?;
        accept(&self.app, source, &Client::known(extensions), key, cancel).await
    }
}

fn refused(error: impl Into<ApiError>) -> Status {
    error.into().into()
}

#[tonic::async_trait]
impl Planning for PlanningService {
    type PlanStream = EventStream;
    type WatchJobStream = EventStream;

    async fn plan(&self, request: Request<proto::PlanRequest>) -> Result<Response<EventStream>, Status> {
        let (_, extensions, request) = request.into_parts();
        let permit = self.app.open_stream(&Client::known(&extensions))?;
        let cancel = request.cancel_on_disconnect;
        let (record, guard) = self.accept(&extensions, request.problem_json, request.options, cancel).await?;
        let subscription = self.app.jobs.subscribe(record.id, 0).map_err(refused)?;
        Ok(Response::new(self.events(subscription, guard, permit)))
    }

    async fn create_job(&self, request: Request<proto::CreateJobRequest>) -> Result<Response<Job>, Status> {
        let (_, extensions, request) = request.into_parts();
        let (record, _) = self.accept(&extensions, request.problem_json, request.options, false).await?;
        Ok(Response::new(self.job(record.id)?))
    }

    async fn get_job(&self, request: Request<proto::GetJobRequest>) -> Result<Response<Job>, Status> {
        Ok(Response::new(self.job(job_id(&request.into_inner().job_id)?)?))
    }

    async fn list_jobs(
        &self,
        request: Request<proto::ListJobsRequest>,
    ) -> Result<Response<proto::ListJobsResponse>, Status> {
        let request = request.into_inner();
        let before = if request.before.is_empty() { None } else { Some(job_id(&request.before)?) };
        let state = |wanted: &i32| {
            let message = "give states that this version knows".to_owned();
            messages::known_state(*wanted).ok_or(ApiError::BadParameter { name: "states", message })
        };
        let query = ListQuery {
            before,
            limit: page_size(request.limit),
            states: request.states.iter().map(state).collect::<Result<_, _>>()?,
            labels: request.labels.iter().map(|text| routes::label_filter(text)).collect(),
        };
        let limit = query.limit;
        // One more shows whether there is a next page.
        let query = ListQuery { limit: limit + 1, ..query };
        let records = aside(&self.app, move |app| Ok(app.jobs.store().list(&query)?)).await?;
        let more = records.len() > limit;
        let next =
            records.get(limit - 1).filter(|_| more).map(|last| last.id.to_string()).unwrap_or_default();
        let jobs = records
            .iter()
            .take(limit)
            .map(|record| messages::job(record, self.app.jobs.queue_position(record.id)))
            .collect();
        Ok(Response::new(proto::ListJobsResponse { jobs, next }))
    }

    async fn watch_job(
        &self,
        request: Request<proto::WatchJobRequest>,
    ) -> Result<Response<EventStream>, Status> {
        let client = Client::known(request.extensions());
        let request = request.into_inner();
        let job = job_id(&request.job_id)?;
        let subscription = self.app.jobs.subscribe(job, request.after).map_err(refused)?;
        let (record, _) = self.app.jobs.record(job).map_err(refused)?;
        if record.state.is_terminal() && request.after >= record.last_seq {
            return Ok(Response::new(Box::pin(futures::stream::empty())));
        }
        let permit = self.app.open_stream(&client)?;
        let guard = CancelOnDrop::new(Arc::clone(&self.app), job, false);
        Ok(Response::new(self.events(subscription, guard, permit)))
    }

    async fn get_solution(
        &self,
        request: Request<proto::GetSolutionRequest>,
    ) -> Result<Response<proto::Solution>, Status> {
        let request = request.into_inner();
        let revision = match request.revision {
            0 => Revision::Best,
            number => Revision::Number(number),
        };
        let job = job_id(&request.job_id)?;
        let found = aside(&self.app, move |app| Ok(app.jobs.store().solution(job, revision)?)).await?;
        let incumbent = found.ok_or(ApiError::NoSolution)?;
        Ok(Response::new(proto::Solution {
            job_id: job.to_string(),
            revision: incumbent.revision,
            metrics: Some(messages::metrics(&incumbent.metrics)),
            plan_json: incumbent.document.to_string(),
        }))
    }

    async fn list_incumbents(
        &self,
        request: Request<proto::ListIncumbentsRequest>,
    ) -> Result<Response<proto::ListIncumbentsResponse>, Status> {
        let request = request.into_inner();
        let (job, limit) = (job_id(&request.job_id)?, page_size(request.limit));
        let found = aside(&self.app, move |app| Ok(app.jobs.incumbents(job, request.from, limit)?)).await?;
        let incumbents = found.iter().filter_map(|event| messages::incumbent(event)).collect();
        Ok(Response::new(proto::ListIncumbentsResponse { incumbents }))
    }

    async fn cancel_job(&self, request: Request<proto::CancelJobRequest>) -> Result<Response<Job>, Status> {
        let job = job_id(&request.into_inner().job_id)?;
        aside(&self.app, move |app| Ok(app.jobs.cancel(job)?)).await?;
        Ok(Response::new(self.job(job)?))
    }

    async fn delete_job(
        &self,
        request: Request<proto::DeleteJobRequest>,
    ) -> Result<Response<proto::DeleteJobResponse>, Status> {
        let job = job_id(&request.into_inner().job_id)?;
        aside(&self.app, move |app| Ok(app.jobs.store().delete(job)?)).await?;
        Ok(Response::new(proto::DeleteJobResponse {}))
    }

    async fn validate(
        &self,
        request: Request<proto::ValidateRequest>,
    ) -> Result<Response<proto::ValidateResponse>, Status> {
        let held = Held::known(request.extensions());
        let document = held.bytes(request.into_inner().problem_json);
        let read = validate(&self.app, Source::Document(document)).await?.read;
        Ok(Response::new(proto::ValidateResponse {
            arms: read.problem.workcell.arms.len() as u64,
            objects: read.problem.objects.len() as u64,
            name: read.problem.name,
            problem_digest: read.problem.digest,
            warnings: read.warnings.iter().map(messages::fault).collect(),
        }))
    }

    async fn verify(
        &self,
        request: Request<proto::VerifyRequest>,
    ) -> Result<Response<proto::VerifyResponse>, Status> {
        let held = Held::known(request.extensions());
        let request = request.into_inner();
        let (problem, plan) = (held.bytes(request.problem_json), held.bytes(request.plan_json));
        let judged = Judged::Apart { problem, plan };
        let verdict = routes::verdict(&self.app, judged).await?;
        let verdict_json = serde_json::to_string(&verdict).map_err(|_| ApiError::Internal)?;
        Ok(Response::new(proto::VerifyResponse { valid: verdict.valid, verdict_json }))
    }

    async fn put_workcell(
        &self,
        request: Request<proto::PutWorkcellRequest>,
    ) -> Result<Response<proto::Workcell>, Status> {
        let held = Held::known(request.extensions());
        let request = request.into_inner();
        let (format, bytes) = match request.content {
            Some(Content::WorkcellJson(text)) => (BundleFormat::Json, held.bytes(text)),
            Some(Content::Zip(bytes)) => (BundleFormat::Zip, held.bytes(bytes)),
            Some(Content::TarGz(bytes)) => (BundleFormat::TarGz, held.bytes(bytes)),
            None => (BundleFormat::Json, Bytes::new()),
        };
        let registration = routes::register(&self.app, request.id, format, bytes).await?;
        let warnings = registration.warnings.iter().map(messages::fault).collect();
        Ok(Response::new(proto::Workcell { warnings, ..messages::workcell(&registration.registered) }))
    }

    async fn get_workcell(
        &self,
        request: Request<proto::GetWorkcellRequest>,
    ) -> Result<Response<proto::Workcell>, Status> {
        let (app, id) = (Arc::clone(&self.app), request.into_inner().id);
        let (registered, bundle) = blocking(&self.app, move || routes::found(&app, &id)).await?;
        Ok(Response::new(proto::Workcell {
            workcell_json: bundle.document.to_string(),
            files: bundle.files.keys().cloned().collect(),
            ..messages::workcell(&registered)
        }))
    }

    async fn list_workcells(
        &self,
        _request: Request<proto::ListWorkcellsRequest>,
    ) -> Result<Response<proto::ListWorkcellsResponse>, Status> {
        let registered = aside(&self.app, |app| Ok(app.workcells.list()?)).await?;
        let workcells = registered.iter().map(messages::workcell).collect();
        Ok(Response::new(proto::ListWorkcellsResponse { workcells }))
    }

    async fn delete_workcell(
        &self,
        request: Request<proto::DeleteWorkcellRequest>,
    ) -> Result<Response<proto::DeleteWorkcellResponse>, Status> {
        let id = request.into_inner().id;
        aside(&self.app, move |app| routes::unregister(app, &id)).await?;
        Ok(Response::new(proto::DeleteWorkcellResponse {}))
    }

    async fn get_modes(
        &self,
        request: Request<proto::GetModesRequest>,
    ) -> Result<Response<proto::Modes>, Status> {
        let request = request.into_inner();
        let size = Some(request.size.as_str()).filter(|size| !size.is_empty());
        let graph = routes::mode_graph(&self.app, &request.workcell_id, size).await?;
        Ok(Response::new(proto::Modes { mode_graph_json: graph.to_string() }))
    }

    async fn get_limits(
        &self,
        _request: Request<proto::GetLimitsRequest>,
    ) -> Result<Response<proto::Limits>, Status> {
        let limits_json = routes::limits_document(&self.app.config).to_string();
        Ok(Response::new(proto::Limits { limits_json }))
    }

    async fn get_version(
        &self,
        _request: Request<proto::GetVersionRequest>,
    ) -> Result<Response<proto::Version>, Status> {
        let document = routes::version_document();
        let text = |name: &str| document[name].as_str().unwrap_or_default().to_owned();
        Ok(Response::new(proto::Version {
            name: text("name"),
            version: text("version"),
            api: text("api"),
            problem_schema: text("problem_schema"),
            plan_schema: text("plan_schema"),
        }))
    }

    async fn list_scenarios(
        &self,
        _request: Request<proto::ListScenariosRequest>,
    ) -> Result<Response<proto::ListScenariosResponse>, Status> {
        let names = crate::scenario::catalog().iter().map(|entry| entry.name.to_owned()).collect();
        Ok(Response::new(proto::ListScenariosResponse { names }))
    }

    async fn get_scenario(
        &self,
        request: Request<proto::GetScenarioRequest>,
    ) -> Result<Response<proto::Scenario>, Status> {
        let name = request.into_inner().name;
        let entry = crate::scenario::find(&name)
            .ok_or_else(|| ApiError::NotFound { what: "scenario of that name".to_owned() })?;
        Ok(Response::new(proto::Scenario { name, problem_json: entry.text.to_owned() }))
    }
}
