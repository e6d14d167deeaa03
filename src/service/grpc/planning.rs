//! The planning service's calls.

use std::pin::Pin;
use std::sync::Arc;

use bytes::Bytes;
use futures::{Stream, StreamExt};
use tonic::{Request, Response, Status};

use super::super::intake::accept;
use super::super::stream::CancelOnDrop;
use super::super::{ApiError, App};
use super::messages;
use super::proto::planning_server::Planning;
use super::proto::{
    CancelJobRequest, CreateJobRequest, Event, GetJobRequest, GetScenarioRequest, GetSolutionRequest, Job,
    ListJobsRequest, ListJobsResponse, ListScenariosRequest, ListScenariosResponse, PlanRequest, Scenario,
    Solution, WatchJobRequest,
};
use crate::jobs::{BadJobId, JobId, Revision, Subscription};

/// Jobs in one reply, unless the client says otherwise.
const PAGE: u32 = 100;
/// Most jobs in one reply.
const LARGEST_PAGE: u32 = 1000;

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
    fn events(&self, mut subscription: Subscription, mut guard: CancelOnDrop) -> EventStream {
        let app = Arc::clone(&self.app);
        Box::pin(async_stream::stream! {
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

#[tonic::async_trait]
impl Planning for PlanningService {
    type PlanStream = EventStream;
    type WatchJobStream = EventStream;

    async fn plan(&self, request: Request<PlanRequest>) -> Result<Response<EventStream>, Status> {
        let request = request.into_inner();
        let record = accept(&self.app, Bytes::from(request.problem_json)).await?;
        let guard = CancelOnDrop::new(Arc::clone(&self.app), record.id, request.cancel_on_disconnect);
        let subscription = self.app.jobs.subscribe(record.id, 0).map_err(ApiError::from)?;
        Ok(Response::new(self.events(subscription, guard)))
    }

    async fn create_job(&self, request: Request<CreateJobRequest>) -> Result<Response<Job>, Status> {
        let record = accept(&self.app, Bytes::from(request.into_inner().problem_json)).await?;
        Ok(Response::new(self.job(record.id)?))
    }

    async fn get_job(&self, request: Request<GetJobRequest>) -> Result<Response<Job>, Status> {
        Ok(Response::new(self.job(job_id(&request.into_inner().job_id)?)?))
    }

    async fn list_jobs(
        &self,
        request: Request<ListJobsRequest>,
    ) -> Result<Response<ListJobsResponse>, Status> {
        let request = request.into_inner();
        let limit = if request.limit == 0 { PAGE } else { request.limit.min(LARGEST_PAGE) };
        let before = if request.before.is_empty() { None } else { Some(job_id(&request.before)?) };
        let records = self.app.jobs.store().list(before, limit as usize).map_err(ApiError::from)?;
        let jobs = records
            .iter()
            .map(|record| messages::job(record, self.app.jobs.queue_position(record.id)))
            .collect();
        Ok(Response::new(ListJobsResponse { jobs }))
    }

    async fn watch_job(&self, request: Request<WatchJobRequest>) -> Result<Response<EventStream>, Status> {
        let request = request.into_inner();
        let job = job_id(&request.job_id)?;
        let subscription = self.app.jobs.subscribe(job, request.after).map_err(ApiError::from)?;
        let (record, _) = self.app.jobs.record(job).map_err(ApiError::from)?;
        if record.state.is_terminal() && request.after >= record.last_seq {
            return Ok(Response::new(Box::pin(futures::stream::empty())));
        }
        let guard = CancelOnDrop::new(Arc::clone(&self.app), job, false);
        Ok(Response::new(self.events(subscription, guard)))
    }

    async fn get_solution(&self, request: Request<GetSolutionRequest>) -> Result<Response<Solution>, Status> {
        let request = request.into_inner();
        let revision = match request.revision {
            0 => Revision::Best,
            number => Revision::Number(number),
        };
        let job = job_id(&request.job_id)?;
        let incumbent = self
            .app
            .jobs
            .store()
            .solution(job, revision)
            .map_err(ApiError::from)?
            .ok_or(ApiError::NoSolution)?;
        Ok(Response::new(Solution {
            job_id: job.to_string(),
            revision: incumbent.revision,
            metrics: Some(messages::metrics(&incumbent.metrics)),
            plan_json: incumbent.document.to_string(),
        }))
    }

    async fn cancel_job(&self, request: Request<CancelJobRequest>) -> Result<Response<Job>, Status> {
        let job = job_id(&request.into_inner().job_id)?;
        self.app.jobs.cancel(job).map_err(ApiError::from)?;
        Ok(Response::new(self.job(job)?))
    }

    async fn list_scenarios(
        &self,
        _request: Request<ListScenariosRequest>,
    ) -> Result<Response<ListScenariosResponse>, Status> {
        let names = crate::scenario::catalog().iter().map(|entry| entry.name.to_owned()).collect();
        Ok(Response::new(ListScenariosResponse { names }))
    }

    async fn get_scenario(&self, request: Request<GetScenarioRequest>) -> Result<Response<Scenario>, Status> {
        let name = request.into_inner().name;
        let entry = crate::scenario::find(&name)
            .ok_or_else(|| ApiError::NotFound { what: "scenario of that name".to_owned() })?;
        Ok(Response::new(Scenario { name, problem_json: entry.text.to_owned() }))
    }
}
