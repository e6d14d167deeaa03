//! The life of jobs: states, reasons, queue, cancellation, faults of the planner.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use quadrille::jobs::{
    EmbeddedStore, EventBody, JobRequest, JobState, Jobs, JobsConfig, NoObserver, Parts, Planner,
    ProblemReader, QueueRefusal, Retention, Submission,
};
use quadrille::plan::Plan;
use quadrille::problem::Problem;
use quadrille::run::Seed;
use quadrille::wire::{LibraryOnly, ReadLimits, read_problem};
use rand::Rng;
use serde_json::{Value, json};

use crate::script::{self, problem};
use crate::server::{Server, problem_document};

#[tokio::test]
async fn every_ending_has_its_state_and_reason() {
    let server = Server::start(2, 16).await;
    for (name, state, reason, has_plan) in [
        ("improve 3", "SUCCEEDED", "TIME_LIMIT", true),
        ("first", "SUCCEEDED", "FIRST_SOLUTION", true),
        ("optimal", "SUCCEEDED", "OPTIMAL", true),
        ("infeasible", "FAILED", "INFEASIBLE", false),
        ("nothing", "FAILED", "NO_SOLUTION_FOUND", false),
        ("panic", "FAILED", "INTERNAL", true),
    ] {
        let job = server.create(name).await;
        let events = server.events(&job, 0).await;
        let durable: Vec<&Value> = events.iter().filter(|event| event["type"] != "progress").collect();
        let kinds: Vec<&str> = durable.iter().filter_map(|event| event["type"].as_str()).collect();
        assert_eq!(&kinds[..2], ["queued", "started"]);
        assert_eq!(kinds.iter().filter(|kind| **kind == "terminal").count(), 1);
        let seqs: Vec<u64> = durable.iter().filter_map(|event| event["seq"].as_u64()).collect();
        assert_eq!(seqs, (1..=durable.len() as u64).collect::<Vec<_>>());

        let terminal = events.last().unwrap();
        assert_eq!((&terminal["state"], &terminal["termination_reason"]), (&json!(state), &json!(reason)));
        assert_eq!(terminal["metrics"].is_object(), has_plan);
        let record = server.json(&job).await;
        assert_eq!((&record["state"], &record["termination_reason"]), (&json!(state), &json!(reason)));
        assert_eq!(record["best"], terminal["metrics"]);
        assert!(record["finished_at"].is_string() && record["queue_position"].is_null());
        let best = server.get(&format!("{job}/solutions/best")).await;
        assert_eq!(best.status(), if has_plan { 200 } else { 404 }, "{name}");
        if has_plan {
            let best: Value = best.json().await.unwrap();
            assert_eq!(best["metrics"], record["best"]);
        } else {
            assert!(!terminal["diagnosis"].as_str().unwrap().is_empty());
        }
    }
}

#[tokio::test]
async fn incumbents_carry_their_plans_and_are_kept_by_revision() {
    let server = Server::start(1, 8).await;
    let job = server.create("improve 4").await;
    let events = server.events(&job, 0).await;
    let incumbents: Vec<&Value> = events.iter().filter(|event| event["type"] == "incumbent").collect();
    assert_eq!(incumbents.len(), 4);
    for (index, incumbent) in incumbents.iter().enumerate() {
        let kept = server.json(&format!("{job}/solutions/{}", index + 1)).await;
        assert_eq!(incumbent["revision"], index + 1);
        assert_eq!(incumbent["plan"], kept);
        assert_eq!(incumbent["plan"]["metrics"], incumbent["metrics"]);
    }
    assert_eq!(server.json(&format!("{job}/solutions/best")).await["revision"], 4);
    let none = problem_document(server.get(&format!("{job}/solutions/5")).await).await;
    assert_eq!(none["code"], "no_solution");
}

#[tokio::test]
async fn large_plans_are_referred_to() {
    let server = Server::with(|config| config.inline_plan_bytes = 10).await;
    let job = server.create("improve 1").await;
    let events = server.events(&job, 0).await;
    let incumbent = events.iter().find(|event| event["type"] == "incumbent").unwrap();
    assert!(incumbent.get("plan").is_none());
    assert_eq!(server.json(incumbent["href"].as_str().unwrap()).await["revision"], 1);
}

#[tokio::test]
async fn a_panicking_planner_harms_no_other_job() {
    let server = Server::start(1, 8).await;
    for _ in 0..3 {
        let job = server.create("panic").await;
        server.until(&job, "terminal").await;
    }
    let job = server.create("improve 1").await;
    assert_eq!(server.events(&job, 0).await.last().unwrap()["state"], "SUCCEEDED");
}

#[tokio::test]
async fn a_full_queue_refuses_and_says_when_to_come_back() {
    let server = Server::start(1, 1).await;
    let running = server.create("wait").await;
    server.until(&running, "started").await;
    let waiting = server.create("wait").await;
    let record = server.json(&waiting).await;
    assert_eq!((&record["state"], &record["queue_position"]), (&json!("QUEUED"), &json!(1)));
    for path in ["/v1/jobs", "/v1/plan"] {
        let reply = server.post(path, problem("wait").to_string()).await;
        assert_eq!(reply.status(), 429);
        let seconds: u64 = reply.headers()["retry-after"].to_str().unwrap().parse().unwrap();
        assert!(seconds >= 1);
        let document = problem_document(reply).await;
        assert_eq!((&document["code"], &document["retryable"]), (&json!("queue_full"), &json!(true)));
    }
    // One that waits can be cancelled, and makes room.
    let cancelled: Value = server.post(&format!("{waiting}/cancel"), "").await.json().await.unwrap();
    assert_eq!((&cancelled["state"], &cancelled["started_at"]), (&json!("CANCELLED"), &Value::Null));
    server.create("wait").await;
}

#[tokio::test]
async fn cancelling_frees_the_worker_and_keeps_the_best_plan() {
    let server = Server::start(1, 8).await;
    let first = server.create("wait").await;
    server.until(&first, "incumbent").await;
    let second = server.create("improve 1").await;
    let reply = server.post(&format!("{first}/cancel"), "").await;
    assert_eq!(reply.status(), 200);
    // Its budget of many seconds is not up: the second job ends because the worker is free.
    server.until(&second, "terminal").await;
    server.until(&first, "terminal").await;
    let record = server.json(&first).await;
    assert_eq!(
        (&record["state"], &record["termination_reason"]),
        (&json!("CANCELLED"), &json!("CLIENT_CANCEL"))
    );
    assert!(record["best"].is_object());
    assert_eq!(server.json(&format!("{first}/solutions/best")).await["revision"], 1);
    // Once more changes nothing.
    let again: Value = server.post(&format!("{first}/cancel"), "").await.json().await.unwrap();
    assert_eq!(again, record);
}

#[tokio::test]
async fn jobs_are_listed_newest_first_in_pages() {
    let server = Server::start(1, 16).await;
    let mut created = Vec::new();
    for _ in 0..5 {
        created.push(server.create("improve 1").await);
    }
    let mut listed = Vec::new();
    let mut next = Some("/v1/jobs?limit=2".to_owned());
    while let Some(path) = next {
        let page = server.json(&path).await;
        let jobs = page["jobs"].as_array().unwrap();
        assert!(jobs.len() <= 2);
        listed.extend(jobs.iter().map(|job| job["links"]["self"].as_str().unwrap().to_owned()));
        next = page["next"].as_str().map(str::to_owned);
    }
    created.reverse();
    assert_eq!(listed, created);
}

#[tokio::test]
async fn a_client_that_leaves_cancels_only_if_it_said_so() {
    let server = Server::start(2, 8).await;
    for (query, state) in [("?cancel_on_disconnect=true", "CANCELLED"), ("", "RUNNING")] {
        let reply = server.post(&format!("/v1/plan{query}"), problem("wait").to_string()).await;
        let job = reply.headers()["location"].to_str().unwrap().to_owned();
        server.until(&job, "incumbent").await;
        drop(reply);
        if state == "CANCELLED" {
            server.until(&job, "terminal").await;
        } else {
            // Long enough for the connection's end to be noticed.
            tokio::time::sleep(Duration::from_millis(300)).await;
        }
        assert_eq!(server.json(&job).await["state"], state);
    }
}

struct Unread;

impl ProblemReader for Unread {
    fn read(&self, _request: &JobRequest) -> Result<(Problem, Option<Plan>), String> {
        Err("nothing is read twice here".to_owned())
    }
}

fn parts(planner: Arc<dyn Planner>) -> Parts {
    let store = Arc::new(EmbeddedStore::in_memory(Retention::default()).unwrap());
    Parts { store, planner, reader: Arc::new(Unread), observer: Arc::new(NoObserver) }
}

fn submission(problem: Problem) -> Submission {
    Submission { request: JobRequest::default(), problem, warm_start: None, spent: Duration::ZERO }
}

/// Jobs of all kinds on three threads, some cancelled at any moment: each gets exactly one terminal
/// event, the last one, and numbers without gaps; and every promise of a place is given back.
#[test]
fn jobs_under_random_cancellation_end_once() {
    let config = JobsConfig { workers: 3, queue_limit: 100, ..JobsConfig::default() };
    let jobs = Jobs::start(config, parts(Arc::new(script::plan))).unwrap();
    let mut rng = Seed(7).stream("cancellation");
    let read: BTreeMap<&str, _> = ["improve 5", "wait", "nothing", "panic", "infeasible"]
        .into_iter()
        .map(|name| {
            let text = problem(name).to_string();
            (name, read_problem(text.as_bytes(), &LibraryOnly, &ReadLimits::default()).unwrap().problem)
        })
        .collect();
    let names: Vec<&str> = read.keys().copied().collect();
    let mut ids = Vec::new();
    for _ in 0..60 {
        let name = names[rng.random_range(0..names.len())];
        let id = jobs.submit(jobs.reserve("me").unwrap(), submission(read[name].clone())).unwrap().id;
        ids.push((id, jobs.subscribe(id, 0).unwrap()));
        if name == "wait" || rng.random_bool(0.3) {
            std::thread::sleep(Duration::from_micros(rng.random_range(0..3000)));
            jobs.cancel(id).unwrap();
        }
    }
    for (id, subscription) in ids {
        let seen: Vec<_> = futures::executor::block_on(subscription.collect());
        let durable: Vec<_> = seen.iter().filter(|delivery| delivery.event.body.is_durable()).collect();
        let seqs: Vec<u64> = durable.iter().map(|delivery| delivery.event.seq).collect();
        assert_eq!(seqs, (1..=seqs.len() as u64).collect::<Vec<_>>());
        let terminal = |body: &EventBody| matches!(body, EventBody::Terminal(_));
        assert_eq!(seen.iter().filter(|delivery| terminal(&delivery.event.body)).count(), 1);
        assert!(terminal(&seen.last().unwrap().event.body));
        let (record, place) = jobs.record(id).unwrap();
        assert!(record.state.is_terminal() && place.is_none());
        assert_ne!(record.state, JobState::Queued);
    }
    // All 103 places are free again, and no more than that.
    let tickets: Vec<_> = (0..103).map(|_| jobs.reserve("me").unwrap()).collect();
    assert!(matches!(jobs.reserve("me"), Err(QueueRefusal::Full { limit: 100, .. })));
    drop(tickets);
    assert!(jobs.stop(Duration::from_secs(20)));
    assert!(matches!(jobs.reserve("me"), Err(QueueRefusal::Stopping)));
}
