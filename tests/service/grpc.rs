//! The same over gRPC, on the same port.

use std::time::Duration;

use futures::StreamExt;
use quadrille::service::PROBLEM_METADATA;
use quadrille::service::proto::event::Body;
use quadrille::service::proto::planning_client::PlanningClient;
use quadrille::service::proto::put_workcell_request::Content;
use quadrille::service::proto::{
    CancelJobRequest, CreateJobRequest, GetJobRequest, GetScenarioRequest, GetSolutionRequest, JobState,
    ListJobsRequest, ListScenariosRequest, PlanRequest, PutWorkcellRequest, TerminationReason,
    ValidateRequest, VerifyRequest, WatchJobRequest,
};
use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tonic::Code;
use tonic::transport::Channel;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

use crate::script::problem;
use crate::server::Server;

async fn channel(server: &Server) -> Channel {
    Channel::from_shared(server.url("")).unwrap().connect().await.unwrap()
}

async fn client(server: &Server) -> PlanningClient<Channel> {
    PlanningClient::new(channel(server).await)
}

fn plan(problem_json: impl Into<String>) -> PlanRequest {
    PlanRequest { problem_json: problem_json.into(), ..PlanRequest::default() }
}

#[tokio::test]
async fn plan_streams_typed_events_that_agree_with_http() {
    let server = Server::start(1, 8).await;
    let mut client = client(&server).await;
    let stream = client.plan(plan(problem("improve 2").to_string())).await.unwrap().into_inner();
    let events: Vec<_> = stream.map(|event| event.unwrap()).collect().await;
    assert_eq!(events.iter().map(|event| event.seq).collect::<Vec<_>>(), [1, 2, 3, 4, 5]);
    let job = events[0].job_id.clone();
    let over_http = server.events(&format!("/v1/jobs/{job}"), 0).await;
    for (event, http) in events.iter().zip(&over_http) {
        assert_eq!(
            (Value::from(event.seq), Value::from(event.at.clone())),
            (http["seq"].clone(), http["at"].clone())
        );
    }
    let Some(Body::Incumbent(incumbent)) = &events[3].body else { panic!("{:?}", events[3]) };
    assert_eq!(incumbent.revision, 2);
    let metrics = incumbent.metrics.as_ref().unwrap();
    assert_eq!((metrics.steps, metrics.mode_graph_optimum), (6, Some(6)));
    assert_eq!(Value::from(metrics.duration_s), over_http[3]["metrics"]["duration_s"]);
    assert_eq!(serde_json::from_str::<Value>(&incumbent.plan_json).unwrap(), over_http[3]["plan"]);
    let Some(Body::Terminal(terminal)) = &events[4].body else { panic!("{:?}", events[4]) };
    assert_eq!(
        (terminal.state(), terminal.termination_reason()),
        (JobState::Succeeded, TerminationReason::TimeLimit)
    );
}

#[tokio::test]
async fn jobs_are_made_watched_and_cancelled() {
    let server = Server::start(1, 8).await;
    let mut client = client(&server).await;
    let request = CreateJobRequest { problem_json: problem("wait").to_string(), options: None };
    let job_id = client.create_job(request).await.unwrap().into_inner().id;
    let watch = WatchJobRequest { job_id: job_id.clone(), after: 2 };
    let mut events = client.watch_job(watch).await.unwrap().into_inner();
    let first = events.next().await.unwrap().unwrap();
    assert!(matches!(first.body, Some(Body::Incumbent(_))) && first.seq == 3);
    let running = client.get_job(GetJobRequest { job_id: job_id.clone() }).await.unwrap().into_inner();
    assert_eq!((running.state(), running.best.is_some()), (JobState::Running, true));
    client.cancel_job(CancelJobRequest { job_id: job_id.clone() }).await.unwrap();
    let last = events
        .map(|event| event.unwrap())
        .filter(|event| futures::future::ready(!matches!(event.body, Some(Body::Progress(_)))));
    let last: Vec<_> = last.collect().await;
    assert!(matches!(&last[..], [end] if matches!(end.body, Some(Body::Terminal(_)))));
    let solution = GetSolutionRequest { job_id: job_id.clone(), revision: 0 };
    assert_eq!(client.get_solution(solution).await.unwrap().into_inner().revision, 1);
    let listed = client.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs;
    assert_eq!(listed.len(), 1);
    assert_eq!((&listed[0].id, listed[0].state()), (&job_id, JobState::Cancelled));
    // Pages, the newest first.
    let request = CreateJobRequest { problem_json: problem("nothing").to_string(), options: None };
    let second = client.create_job(request).await.unwrap().into_inner().id;
    let (mut seen, mut before) = (Vec::new(), String::new());
    loop {
        let page = ListJobsRequest { limit: 1, before: before.clone(), ..ListJobsRequest::default() };
        let page = client.list_jobs(page).await.unwrap().into_inner();
        seen.extend(page.jobs.into_iter().map(|job| job.id));
        before = page.next;
        if before.is_empty() {
            break;
        }
    }
    assert_eq!(seen, [second, job_id.clone()]);
    // Who has everything gets an empty stream.
    let rest = client.watch_job(WatchJobRequest { job_id, after: 4 }).await.unwrap().into_inner();
    assert_eq!(rest.count().await, 0);
}

#[tokio::test]
async fn refusals_carry_the_problem_document() {
    let server = Server::start(1, 0).await;
    let mut client = client(&server).await;
    let mut unknown = problem("nothing");
    unknown["workcell"]["arms"][0]["robot"] = "iiwa99".into();
    for (body, code) in [
        (String::new(), "invalid_json"),
        ("[".repeat(200_000), "invalid_json"),
        (unknown.to_string(), "invalid_problem"),
    ] {
        let status = client.plan(plan(body)).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument);
        let document = status.metadata().get_bin(PROBLEM_METADATA).unwrap().to_bytes().unwrap();
        let document: Value = serde_json::from_slice(&document).unwrap();
        assert_eq!(document["code"], code);
        assert!(!document["errors"].as_array().unwrap().is_empty());
    }
    // More faults than metadata holds: as many as fit.
    let mut many = problem("nothing");
    for number in 0..100 {
        many[format!("unknown_{number}_{}", "x".repeat(200))] = 1.into();
    }
    let status = client.plan(plan(many.to_string())).await.unwrap_err();
    let told = refusal(&status)["errors"].as_array().unwrap().len();
    assert!((1..100).contains(&told), "{told}");
    let stranger = GetJobRequest { job_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned() };
    assert_eq!(client.get_job(stranger).await.unwrap_err().code(), Code::NotFound);
    let mut running = client.plan(plan(problem("wait").to_string())).await.unwrap().into_inner();
    running.next().await.unwrap().unwrap();
    let status = client.plan(plan(problem("wait").to_string())).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    let huge = client.plan(plan(" ".repeat(50_000_000))).await.unwrap_err();
    assert_eq!((huge.code(), refusal(&huge)["code"].as_str()), (Code::ResourceExhausted, Some("too_large")));
}

/// The problem document of a refused call; its code stands in the metadata too.
fn refusal(status: &tonic::Status) -> Value {
    let document = status.metadata().get_bin(PROBLEM_METADATA).unwrap().to_bytes().unwrap();
    let document: Value = serde_json::from_slice(&document).unwrap();
    assert_eq!(status.metadata().get("quadrille-code").unwrap().to_str().unwrap(), document["code"]);
    document
}

/// Asks again and again for what must come to pass.
async fn until<T>(ask: impl AsyncFn() -> Option<T>) -> T {
    loop {
        if let Some(answer) = ask().await {
            return answer;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// Calls and HTTP requests share the memory for bodies.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_are_counted_as_bodies_are() {
    let server = Server::with(|config| config.bodies_bytes = 1 << 20).await;
    let mut client = client(&server).await;
    let validate = |kib: usize| {
        let problem_json = format!("{}{}", problem("x"), " ".repeat(kib << 10));
        ValidateRequest { problem_json }
    };
    client.validate(validate(300)).await.unwrap();
    // More than all the room there is.
    let status = client.validate(validate(1500)).await.unwrap_err();
    assert_eq!(refusal(&status)["code"], "too_many_bodies");
    let figures = server.get("/metrics").await.text().await.unwrap();
    assert!(figures.contains("quadrille_rejects_total{code=\"too_many_bodies\"}"), "{figures}");
    // What has come of a body over HTTP that is still being sent takes room from the calls, until it breaks off.
    let head = "POST /v1/validate HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked";
    let sent = format!("{head}\r\n\r\n{:x}\r\n{}\r\n", 900 << 10, " ".repeat(900 << 10));
    let half = until(async || {
        let mut half = TcpStream::connect(server.address).await.unwrap();
        half.write_all(sent.as_bytes()).await.ok()?;
        let refused = client.clone().validate(validate(300)).await.err()?;
        assert_eq!(refusal(&refused)["code"], "too_many_bodies");
        // An answer would mean that it found no room itself, for what came before.
        half.try_read(&mut [0; 16]).is_err().then_some(half)
    })
    .await;
    until(async || client.clone().validate(validate(10)).await.ok()).await;
    drop(half);
    until(async || client.clone().validate(validate(300)).await.ok()).await;
}

/// A message may hold two documents; each is bounded as a body is.
#[tokio::test]
async fn documents_in_messages_are_bounded_one_by_one() {
    let server = Server::with(|config| config.read_limits.max_bytes = 100_000).await;
    let mut client = client(&server).await;
    let large = || " ".repeat(100_001);
    let (text, small) = (problem("x").to_string(), "{}".to_owned());
    for (problem_json, plan_json) in [(large(), small), (text, large())] {
        let status = client.verify(VerifyRequest { problem_json, plan_json }).await.unwrap_err();
        assert_eq!(refusal(&status)["code"], "too_large");
    }
    let archive = large().into_bytes();
    for content in [Content::WorkcellJson(large()), Content::Zip(archive.clone()), Content::TarGz(archive)] {
        let request = PutWorkcellRequest { id: "cell".to_owned(), content: Some(content) };
        let status = client.put_workcell(request).await.unwrap_err();
        assert_eq!(refusal(&status)["code"], "too_large");
    }
}

/// Calls whose type browsers would let any page send.
#[tokio::test]
async fn what_is_no_grpc_calls_nothing() {
    let server = Server::start(1, 8).await;
    let put = server.client.put(server.url("/v1/workcells/cell")).json(&problem("x")["workcell"]);
    assert_eq!(put.send().await.unwrap().status(), 201);
    // A message that deletes the workcell: its frame, and the id as field 1.
    let message = b"\0\0\0\0\x06\x0a\x04cell".to_vec();
    let call = |media: &str| {
        let url = server.url("/quadrille.v1.Planning/DeleteWorkcell");
        server.client.post(url).header("content-type", media).body(message.clone())
    };
    for media in ["text/plain", "application/x-www-form-urlencoded", ""] {
        let document = server.refused(call(media), 415).await;
        assert_eq!(document["code"], "unsupported_media_type", "{media}");
    }
    assert_eq!(server.get("/v1/workcells/cell").await.status(), 200);
    assert_eq!(call("application/grpc").send().await.unwrap().status(), 200);
    assert_eq!(server.get("/v1/workcells/cell").await.status(), 404);
}

#[tokio::test]
async fn health_tells_of_a_shutdown() {
    let server = Server::start(1, 8).await;
    let mut health = HealthClient::new(channel(&server).await);
    let mut watches = Vec::new();
    for service in ["", "quadrille.v1.Planning"] {
        let request = HealthCheckRequest { service: service.to_owned() };
        let mut watch = health.watch(request).await.unwrap().into_inner();
        assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::Serving, "{service}");
        watches.push((service, watch));
    }
    server.shutdown.cancel();
    for (service, mut watch) in watches {
        assert_eq!(watch.next().await.unwrap().unwrap().status(), ServingStatus::NotServing, "{service}");
    }
}

#[tokio::test]
async fn scenarios_health_and_reflection_answer() {
    let server = Server::start(1, 8).await;
    let mut client = client(&server).await;
    let names = client.list_scenarios(ListScenariosRequest {}).await.unwrap().into_inner().names;
    assert!(names.contains(&"switch/2x2".to_owned()));
    let scenario = client.get_scenario(GetScenarioRequest { name: "switch/2x2".to_owned() }).await.unwrap();
    assert_eq!(
        scenario.into_inner().problem_json,
        server.get("/v1/scenarios/switch/2x2").await.text().await.unwrap()
    );

    let mut health = HealthClient::new(channel(&server).await);
    let service = "quadrille.v1.Planning".to_owned();
    let answer = health.check(HealthCheckRequest { service }).await.unwrap().into_inner();
    assert_eq!(answer.status(), ServingStatus::Serving);

    let mut reflection = ServerReflectionClient::new(channel(&server).await);
    let message_request = Some(MessageRequest::ListServices(String::new()));
    let request = ServerReflectionRequest { host: String::new(), message_request };
    let mut answers =
        reflection.server_reflection_info(futures::stream::iter([request])).await.unwrap().into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) =
        answers.next().await.unwrap().unwrap().message_response
    else {
        panic!("no list of services");
    };
    let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
    for name in ["quadrille.v1.Planning", "grpc.health.v1.Health"] {
        assert!(names.contains(&name), "{names:?}");
    }
}
