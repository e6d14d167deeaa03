//! Every route with its handlers and what the OpenAPI document says of them: the router and the
//! document are both made from this table, so that neither knows of a route that the other lacks.

use std::sync::Arc;

use axum::handler::Handler;
use axum::routing::MethodRouter;

use super::super::App;
use super::{about, checks, docs, health, jobs, plan, scenarios, workcells};

/// Where a parameter stands, its name, whether it must be there, its type and what it means.
pub(in crate::service) struct Parameter {
    pub place: &'static str,
    pub name: &'static str,
    pub required: bool,
    /// Its JSON Schema, as text.
    pub schema: &'static str,
    pub about: &'static str,
}

/// A reply: status, what it means, and its media types with the names of their schemas.
pub(in crate::service) struct Reply {
    pub status: u16,
    pub about: &'static str,
    pub content: &'static [(&'static str, &'static str)],
    /// Whether `Location` leads to what was made or asked for.
    pub location: bool,
}

/// What the document says of one method of one route.
pub(in crate::service) struct Operation {
    pub method: &'static str,
    pub id: &'static str,
    pub summary: &'static str,
    pub parameters: Vec<Parameter>,
    /// Media types of the body with the names of their schemas; empty when there is no body.
    pub body: &'static [(&'static str, &'static str)],
    pub replies: Vec<Reply>,
    /// Statuses of refusals, each with a problem document.
    pub refusals: &'static [u16],
}

/// A route.
pub(in crate::service) struct Route {
    pub path: &'static str,
    pub methods: MethodRouter<Arc<App>>,
    pub operations: Vec<Operation>,
}

const JSON: &str = "application/json";
const STREAM: &[(&str, &str)] = &[("application/x-ndjson", "Event"), ("text/event-stream", "EventStream")];
const JOB_BODY: &[(&str, &str)] = &[(JSON, "JobRequest")];
/// What any request with a body may be refused with.
const BODY_REFUSALS: &[u16] = &[400, 408, 413, 415, 422, 429, 500, 503];
const SUBMIT_REFUSALS: &[u16] = &[400, 406, 408, 413, 415, 422, 429, 500, 503];
const WORKCELL_REFUSALS: &[u16] = &[400, 404, 405, 408, 409, 413, 415, 422, 429, 500, 503];

fn operation(
    id: &'static str,
    summary: &'static str,
    parameters: Vec<Parameter>,
    replies: Vec<Reply>,
    refusals: &'static [u16],
) -> Operation {
    Operation { method: "", id, summary, parameters, body: &[], replies, refusals }
}

impl Operation {
    fn takes(mut self, body: &'static [(&'static str, &'static str)]) -> Self {
        self.body = body;
        self
    }
}

fn reply(status: u16, about: &'static str, content: &'static [(&'static str, &'static str)]) -> Reply {
    Reply { status, about, content, location: false }
}

/// A reply with a `Location`.
fn located(status: u16, about: &'static str, content: &'static [(&'static str, &'static str)]) -> Reply {
    Reply { location: true, ..reply(status, about, content) }
}

fn path(name: &'static str, schema: &'static str, about: &'static str) -> Parameter {
    Parameter { place: "path", name, required: true, schema, about }
}

fn query(name: &'static str, schema: &'static str, about: &'static str) -> Parameter {
    Parameter { place: "query", name, required: false, schema, about }
}

fn header(name: &'static str, schema: &'static str, about: &'static str) -> Parameter {
    Parameter { place: "header", name, required: false, schema, about }
}

fn job_id() -> Parameter {
    path("id", r#"{"type": "string", "format": "uuid"}"#, "The job's id.")
}

fn workcell_id() -> Parameter {
    path(
        "id",
        r#"{"type": "string", "minLength": 1, "maxLength": 128}"#,
        "The workcell's id, or its digest where one is read.",
    )
}

fn idempotency() -> Parameter {
    let schema = r#"{"type": "string", "minLength": 1, "maxLength": 255, "pattern": "^[!-~]+$"}"#;
    header(
        "Idempotency-Key",
        schema,
        "The same request under the same key makes one job, however often it is sent.",
    )
}

fn limit() -> Parameter {
    query("limit", r#"{"type": "integer", "minimum": 0}"#, "Most entries; 100 by default, 1000 at most.")
}

impl Route {
    fn at(path: &'static str) -> Self {
        Self { path, methods: MethodRouter::new(), operations: Vec::new() }
    }

    fn with(mut self, method: &'static str, operation: Operation, methods: MethodRouter<Arc<App>>) -> Self {
        self.methods = methods;
        self.operations.push(Operation { method, ..operation });
        self
    }

    fn get<T: 'static>(self, handler: impl Handler<T, Arc<App>>, operation: Operation) -> Self {
        let methods = self.methods.clone().get(handler);
        self.with("get", operation, methods)
    }

    fn post<T: 'static>(self, handler: impl Handler<T, Arc<App>>, operation: Operation) -> Self {
        let methods = self.methods.clone().post(handler);
        self.with("post", operation, methods)
    }

    fn put<T: 'static>(self, handler: impl Handler<T, Arc<App>>, operation: Operation) -> Self {
        let methods = self.methods.clone().put(handler);
        self.with("put", operation, methods)
    }

    fn delete<T: 'static>(self, handler: impl Handler<T, Arc<App>>, operation: Operation) -> Self {
        let methods = self.methods.clone().delete(handler);
        self.with("delete", operation, methods)
    }
}

/// All routes but gRPC's.
pub(in crate::service) fn table() -> Vec<Route> {
    let mut routes = job_routes();
    routes.extend(workcell_routes());
    routes.extend(other_routes());
    routes
}

fn job_routes() -> Vec<Route> {
    let job = &[(JSON, "Job")];
    vec![
        Route::at("/v1/plan").post(
            plan::plan,
            operation(
                "plan",
                "Makes a job and streams its events. The job goes on when the client leaves.",
                vec![
                    query("cancel_on_disconnect", r#"{"type": "boolean", "default": false}"#, "Ends the job when the client leaves that made it."),
                    idempotency(),
                ],
                vec![located(200, "The job's events up to the terminal one; `Location` is the job.", STREAM)],
                SUBMIT_REFUSALS,
            )
            .takes(JOB_BODY),
        ),
        Route::at("/v1/jobs")
            .post(
                jobs::create,
                operation(
                    "createJob",
                    "Makes a job. Once it is accepted, it survives the process.",
                    vec![idempotency()],
                    vec![located(202, "The job; `Location` is its path.", job)],
                    &[400, 408, 413, 415, 422, 429, 500, 503],
                )
                .takes(JOB_BODY),
            )
            .get(
                jobs::list,
                operation(
                    "listJobs",
                    "Jobs, newest first.",
                    vec![
                        limit(),
                        query("before", r#"{"type": "string", "format": "uuid"}"#, "Only jobs older than this one."),
                        query(
                            "state",
                            r##"{"type": "array", "items": {"$ref": "#/components/schemas/JobState"}}"##,
                            "Only jobs in one of these states; several times, or with commas.",
                        ),
                        query(
                            "label",
                            r#"{"type": "array", "items": {"type": "string"}}"#,
                            "Only jobs with this label, `key` or `key:value`; several times for several labels.",
                        ),
                    ],
                    vec![reply(200, "A page; `next` is where the next one is.", &[(JSON, "JobPage")])],
                    &[400, 500, 503],
                ),
            ),
        Route::at("/v1/jobs/{id}")
            .get(jobs::get, operation("getJob", "A job as it is now.", vec![job_id()], vec![reply(200, "The job.", job)], &[400, 404, 500, 503]))
            .delete(
                jobs::delete,
                operation("deleteJob", "Forgets a job that has ended.", vec![job_id()], vec![reply(204, "It is gone.", &[])], &[400, 404, 409, 500, 503]),
            ),
        Route::at("/v1/jobs/{id}/events").get(
            jobs::events,
            operation(
                "watchJob",
                "A job's events, from any number on, live and after the end.",
                vec![
                    job_id(),
                    query("after", r#"{"type": "integer", "minimum": 0}"#, "Only events with greater numbers."),
                    header("Last-Event-ID", r#"{"type": "integer", "minimum": 0}"#, "As `after`; the greater of the two counts."),
                ],
                vec![
                    located(200, "The events up to the terminal one; `Location` is the job.", STREAM),
                    reply(204, "You have them all.", &[]),
                ],
                &[400, 404, 406, 429, 500, 503],
            ),
        ),
        Route::at("/v1/jobs/{id}/incumbents").get(
            jobs::incumbents,
            operation(
                "listIncumbents",
                "A job's plans from a revision on, without the plans themselves.",
                vec![job_id(), query("from", r#"{"type": "integer", "minimum": 0}"#, "From this revision on."), limit()],
                vec![reply(200, "The plans that are kept.", &[(JSON, "Incumbents")])],
                &[400, 404, 500, 503],
            ),
        ),
        Route::at("/v1/jobs/{id}/solutions/{revision}").get(
            jobs::solution,
            operation(
                "getSolution",
                "A plan of a job.",
                vec![job_id(), path("revision", r#"{"type": "string", "pattern": "^(best|[0-9]{1,19})$"}"#, "`best`, or a revision.")],
                vec![reply(200, "The plan.", &[(JSON, "Plan")])],
                &[400, 404, 500, 503],
            ),
        ),
        Route::at("/v1/jobs/{id}/cancel").post(
            jobs::cancel,
            operation(
                "cancelJob",
                "Ends a job; its best plan is kept. A job that has ended stays as it is.",
                vec![job_id()],
                vec![reply(200, "The job.", job)],
                &[400, 404, 500, 503],
            ),
        ),
    ]
}

fn workcell_routes() -> Vec<Route> {
    let cell = &[(JSON, "WorkcellEntry")];
    vec![
        Route::at("/v1/workcells").get(
            workcells::list,
            operation("listWorkcells", "Registered workcells.", vec![], vec![reply(200, "All of them, by id.", &[(JSON, "WorkcellList")])], &[400, 500, 503]),
        ),
        Route::at("/v1/workcells/{id}")
            .put(
                workcells::put,
                operation(
                    "putWorkcell",
                    "Registers a workcell: JSON, or an archive of `workcell.json` with what it refers to. A problem's \
                     `workcell` may then be its id or digest.",
                    vec![path("id", r#"{"type": "string", "pattern": "^[A-Za-z0-9_.-]{1,64}$"}"#, "The id.")],
                    vec![reply(200, "The id led elsewhere before, or nothing has changed.", cell), located(201, "The id is new; `Location` is its path.", cell)],
                    WORKCELL_REFUSALS,
                )
                .takes(&[(JSON, "Workcell"), ("application/zip", "Archive"), ("application/gzip", "Archive")]),
            )
            .get(
                workcells::get,
                operation("getWorkcell", "A registered workcell.", vec![workcell_id()], vec![reply(200, "The workcell.", &[(JSON, "RegisteredWorkcell")])], &[400, 404, 500, 503]),
            )
            .delete(
                workcells::delete,
                operation(
                    "deleteWorkcell",
                    "The id leads nowhere from now on; jobs that were made with it go on.",
                    vec![workcell_id()],
                    vec![reply(204, "It is gone.", &[])],
                    &[400, 404, 500, 503],
                ),
            ),
        Route::at("/v1/workcells/{id}/modes").get(
            workcells::modes,
            operation(
                "getModes",
                "The mode graph of a registered workcell: who reaches what, who hands over to whom.",
                vec![workcell_id(), query("size", r#"{"type": "string"}"#, "Extents in metres of the box that it is made for; 0.06,0.06,0.06 by default.")],
                vec![reply(200, "The graph.", &[(JSON, "ModeGraph")])],
                &[400, 404, 422, 429, 500, 503],
            ),
        ),
    ]
}

fn other_routes() -> Vec<Route> {
    let page =
        |id, summary, content| operation(id, summary, vec![], vec![reply(200, "As asked.", content)], &[]);
    let strict =
        |id, summary, content| operation(id, summary, vec![], vec![reply(200, "As asked.", content)], &[400]);
    vec![
        Route::at("/v1/validate").post(
            checks::validate,
            operation(
                "validate",
                "Reads a problem, or a request for a job, without planning.",
                vec![],
                vec![reply(200, "It can be used.", &[(JSON, "Validated")])],
                BODY_REFUSALS,
            )
            .takes(JOB_BODY),
        ),
        Route::at("/v1/verify").post(
            checks::verify,
            operation(
                "verify",
                "What the judge says of a plan.",
                vec![],
                vec![reply(200, "The verdict, valid or not.", &[(JSON, "Verdict")])],
                BODY_REFUSALS,
            )
            .takes(&[(JSON, "VerifyRequest")]),
        ),
        Route::at("/v1/scenarios")
            .get(scenarios::list, strict("listScenarios", "Problems that ship.", &[(JSON, "ScenarioList")])),
        Route::at("/v1/scenarios/{*name}").get(
            scenarios::get,
            operation(
                "getScenario",
                "One of them, ready to be POSTed back.",
                vec![path("name", r#"{"type": "string"}"#, "Such as switch/2x2; the slash stands as it is.")],
                vec![reply(200, "The problem.", &[(JSON, "Problem")])],
                &[400, 404],
            ),
        ),
        Route::at("/v1/limits")
            .get(about::limits, strict("getLimits", "What the service takes at most.", &[(JSON, "Limits")])),
        Route::at("/v1/version")
            .get(about::version, strict("getVersion", "Name, version and schemas.", &[(JSON, "Version")])),
        Route::at("/livez")
            .get(health::live, page("live", "Whether the process answers.", &[(JSON, "Status")])),
        Route::at("/readyz").get(
            health::ready,
            operation(
                "ready",
                "Whether the service takes work.",
                vec![],
                vec![reply(200, "It does.", &[(JSON, "Status")])],
                &[503],
            ),
        ),
        Route::at("/metrics")
            .get(about::metrics, page("metrics", "Figures for Prometheus.", &[("text/plain", "Text")])),
        Route::at("/openapi.json").get(docs::openapi, page("openapi", "This document.", &[(JSON, "Any")])),
        Route::at("/docs")
            .get(docs::page, page("docs", "This document as a page for people.", &[("text/html", "Text")])),
    ]
}
