//! What a request for a job carries, and what becomes of it: keys, labels, priorities, waiting times, plans to
//! begin from; and the lists of jobs.

use std::collections::BTreeSet;

use quadrille::service::{self, ServiceConfig};
use serde_json::{Value, json};

use crate::figures::Figures;
use crate::script::problem;
use crate::server::{Server, problem_document};

fn keyed(server: &Server, key: &str, body: &Value) -> reqwest::RequestBuilder {
    server.client.post(server.url("/v1/jobs")).header("idempotency-key", key).body(body.to_string())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hundred_requests_under_one_key_are_one_job() {
    // The queue has room for three: the copies take none.
    let server = Server::start(1, 2).await;
    let body = problem("wait");
    let replies = futures::future::join_all((0..100).map(|_| keyed(&server, "order-1", &body).send())).await;
    let locations: BTreeSet<String> = replies
        .into_iter()
        .map(|reply| {
            let reply = reply.unwrap();
            assert_eq!(reply.status(), 202);
            reply.headers()["location"].to_str().unwrap().to_owned()
        })
        .collect();
    assert_eq!(locations.len(), 1);
    assert_eq!(server.json("/v1/jobs").await["jobs"].as_array().unwrap().len(), 1);
    // Written otherwise it is the same request; another one is refused.
    let spaced = serde_json::to_string_pretty(&body).unwrap();
    let reply = server.client.post(server.url("/v1/jobs")).header("idempotency-key", "order-1").body(spaced);
    assert_eq!(reply.send().await.unwrap().status(), 202);
    for other in [problem("improve 1"), json!({"problem": body, "priority": 1})] {
        let document = server.refused(keyed(&server, "order-1", &other), 422).await;
        assert_eq!(document["code"], "idempotency_mismatch");
    }
    for bad in [" ", "a b", "ü", &"x".repeat(256)] {
        let request = server.client.post(server.url("/v1/jobs")).header("idempotency-key", bad.as_bytes());
        assert_eq!(server.refused(request.body("{}"), 400).await["code"], "bad_parameter", "{bad}");
    }
    Figures::of("requests")
        .note("100 requests at once under one key", "1 job, 100 replies with its Location");
    // A stream under the key is that of the same job.
    let request = server.client.post(server.url("/v1/plan")).header("idempotency-key", "order-1");
    let reply = request.body(body.to_string()).send().await.unwrap();
    assert!(locations.contains(reply.headers()["location"].to_str().unwrap()));
}

#[tokio::test]
async fn jobs_are_labelled_chosen_and_forgotten() {
    let server = Server::start(1, 16).await;
    let make = async |name: &str, line: &str| {
        let body = json!({"problem": problem(name), "labels": {"line": line, "shift": "late, or so"}});
        let reply = server.post("/v1/jobs", body.to_string()).await;
        assert_eq!(reply.status(), 202);
        reply.headers()["location"].to_str().unwrap().to_owned()
    };
    let (seven, eight) = (make("improve 1", "7").await, make("nothing", "8").await);
    let running = make("wait", "7").await;
    for job in [&seven, &eight] {
        server.until(job, "terminal").await;
    }
    server.until(&running, "incumbent").await;
    let listed = async |query: &str| -> Vec<String> {
        let page = server.json(&format!("/v1/jobs?{query}")).await;
        let jobs = page["jobs"].as_array().unwrap().clone();
        jobs.iter().map(|job| job["links"]["self"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(listed("label=line:7").await, [&*running, &*seven]);
    assert_eq!(listed("label=line:7&state=SUCCEEDED,FAILED").await, [&*seven]);
    assert_eq!(listed("state=RUNNING&state=FAILED").await, [&*running, &*eight]);
    assert_eq!(listed("label=shift:late%2C+or%20so&label=line:8").await, [&*eight]);
    assert!(listed("label=nowhere").await.is_empty());
    // Pages keep the choice.
    let first = server.json("/v1/jobs?limit=1&label=line:7").await;
    let next = first["next"].as_str().unwrap();
    let second = server.json(next).await;
    assert_eq!((&second["jobs"][0]["links"]["self"], &second["next"]), (&json!(seven), &Value::Null));
    let bad = server.client.get(server.url("/v1/jobs?state=ASLEEP"));
    assert_eq!(server.refused(bad, 400).await["code"], "bad_parameter");

    let delete = |job: &str| server.client.delete(server.url(job));
    assert_eq!(server.refused(delete(&running), 409).await["code"], "job_not_ended");
    assert_eq!(delete(&seven).send().await.unwrap().status(), 204);
    assert_eq!(server.refused(delete(&seven), 404).await["code"], "not_found");
    assert_eq!(server.get(&format!("{seven}/events")).await.status(), 404);
    assert_eq!(listed("").await, [&*running, &*eight]);
}

#[tokio::test]
async fn urgent_jobs_go_first_and_late_ones_not_at_all() {
    let server = Server::start(1, 8).await;
    let blocking = server.create("wait").await;
    server.until(&blocking, "started").await;
    let make = async |fields: Value| {
        let mut body = fields;
        body["problem"] = problem("improve 1");
        let reply = server.post("/v1/jobs", body.to_string()).await;
        reply.headers()["location"].to_str().unwrap().to_owned()
    };
    let low = make(json!({"priority": -5})).await;
    let usual = make(json!({})).await;
    let high = make(json!({"priority": 10})).await;
    let late = make(json!({"queue_ttl_s": 0.05, "priority": -10})).await;
    let mut places = Vec::new();
    for job in [&high, &usual, &low] {
        places.push(server.json(job).await["queue_position"].as_u64().unwrap());
    }
    assert_eq!(places, [1, 2, 3]);
    let events = server.durable(&late).await;
    let end = events.last().unwrap();
    assert_eq!((&end["state"], &end["termination_reason"]), (&json!("EXPIRED"), &json!("QUEUE_TIMEOUT")));
    assert_eq!(events.len(), 2);
    server.post(&format!("{blocking}/cancel"), "").await;
    let mut started = Vec::new();
    for job in [&high, &usual, &low] {
        server.until(job, "terminal").await;
        started.push(server.json(job).await["started_at"].as_str().unwrap().to_owned());
    }
    assert!(started.is_sorted(), "{started:?}");
}

#[tokio::test]
async fn incumbents_are_listed_from_a_revision_on() {
    let server = Server::start(1, 8).await;
    let job = server.create("improve 5").await;
    server.until(&job, "terminal").await;
    let revisions = async |query: &str| -> Vec<u64> {
        let found = server.json(&format!("{job}/incumbents{query}")).await;
        found["incumbents"].as_array().unwrap().iter().filter_map(|one| one["revision"].as_u64()).collect()
    };
    assert_eq!(revisions("").await, [1, 2, 3, 4, 5]);
    assert_eq!(revisions("?from=4").await, [4, 5]);
    assert_eq!(revisions("?from=2&limit=2").await, [2, 3]);
    assert!(revisions("?from=6").await.is_empty());
    let found = server.json(&format!("{job}/incumbents?from=5")).await;
    assert_eq!(server.json(found["incumbents"][0]["href"].as_str().unwrap()).await["revision"], 5);
}

/// With the real planner: a plan that it has found is where the next job begins.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_begins_from_a_plan_that_the_judge_accepts() {
    let server = Server::planning(|_| {}).await;
    let mut whole = problem("switch");
    whole["options"] = json!({"time_budget_s": 60.0, "stop": {"first_solution": true}});
    let reply = server.post("/v1/plan", whole.to_string()).await;
    let job = reply.headers()["location"].to_str().unwrap().to_owned();
    let events = crate::server::lines(&reply.text().await.unwrap());
    assert_eq!(events.last().unwrap()["termination_reason"], "FIRST_SOLUTION");
    let plan = server.json(&format!("{job}/solutions/best")).await;

    let again = json!({"problem": whole, "warm_start": plan});
    let reply = server.post("/v1/jobs", again.to_string()).await;
    let warm = reply.headers()["location"].to_str().unwrap().to_owned();
    let events = server.durable(&warm).await;
    let kinds: Vec<&str> = events.iter().filter_map(|event| event["type"].as_str()).collect();
    assert_eq!(kinds, ["queued", "started", "incumbent", "terminal"], "it is a first solution itself");
    let (mut first, mut given) = (events[2]["plan"].clone(), plan.clone());
    assert_eq!(first["revision"], 1);
    for plan in [&mut first, &mut given] {
        plan.as_object_mut().unwrap().remove("revision");
        plan.as_object_mut().unwrap().remove("verification");
        // What it says of all plans is not believed, and it is there at once.
        for claim in ["mode_graph_optimum", "steps_lower_bound", "steps_proof", "found_after_s"] {
            plan["metrics"].as_object_mut().unwrap().remove(claim);
        }
    }
    assert_eq!(events[2]["plan"]["metrics"]["steps_lower_bound"], 0);
    assert_eq!(first, given);

    // Without that stop the search goes on from it: every further plan is better.
    let mut further = again.clone();
    further["problem"]["options"] = json!({"time_budget_s": 600.0, "max_iterations": 60, "seed": 3});
    let reply = server.post("/v1/jobs", further.to_string()).await;
    let job = reply.headers()["location"].to_str().unwrap().to_owned();
    let events = server.durable(&job).await;
    let durations: Vec<f64> = events
        .iter()
        .filter(|event| event["type"] == "incumbent")
        .map(|event| event["metrics"]["duration_s"].as_f64().unwrap())
        .collect();
    assert_eq!(durations[0], plan["metrics"]["duration_s"].as_f64().unwrap());
    assert!(durations.len() > 1, "sixty iterations make it better");
    assert!(durations.windows(2).all(|pair| pair[1] < pair[0]), "{durations:?}");

    let mut broken = plan.clone();
    let points = broken["arms"][0]["points"].as_array_mut().unwrap();
    let middle = points.len() / 2;
    points[middle]["q"][1] = json!(points[middle]["q"][1].as_f64().unwrap() + 0.2);
    for (bad, pointer) in [(broken, "/warm_start"), (json!({"schema": 1}), "/warm_start")] {
        let body = json!({"problem": whole, "warm_start": bad}).to_string();
        let reply = server.post("/v1/jobs", body).await;
        assert_eq!(reply.status(), 422);
        let document = problem_document(reply).await;
        assert_eq!(document["code"], "invalid_plan", "{document}");
        assert!(document["errors"][0]["pointer"].as_str().unwrap().starts_with(pointer));
    }
}

#[tokio::test]
async fn limits_are_told_and_kept() {
    let server = Server::with(|config| {
        config.jobs.workers = 1;
        config.jobs.queue_limit = 8;
        config.jobs.client_limit = 2;
        config.client_streams = 1;
        config.read_limits.max_arms = 1;
        config.read_limits.max_json_depth = 20;
        config.client_header = Some("x-client".parse().unwrap());
    })
    .await;
    let limits = server.json("/v1/limits").await;
    assert_eq!((&limits["arms"], &limits["jobs_per_client"]), (&json!(1), &json!(2)));
    assert_eq!(limits["triangles_per_document"], json!(2_000_000));
    let told = service::limits_document(&ServiceConfig::default());
    assert_eq!(told.as_object().unwrap().len(), limits.as_object().unwrap().len());
    let reply = server.post("/v1/jobs", problem("wait").to_string()).await;
    assert_eq!(problem_document(reply).await["errors"][0]["code"], "too_large");
    let deep = format!("{{\"problem\": {}1{}}}", "[".repeat(20), "]".repeat(20));
    let reply = server.post("/v1/validate", deep).await;
    assert_eq!(problem_document(reply).await["code"], "invalid_json");
}

#[tokio::test]
async fn no_client_takes_it_all() {
    let server = Server::with(|config| {
        config.jobs.workers = 1;
        config.jobs.queue_limit = 8;
        config.jobs.client_limit = 2;
        config.streams = 3;
        config.client_streams = 2;
        config.client_header = Some("x-client".parse().unwrap());
    })
    .await;
    let post = |client: &str| {
        let request = server.client.post(server.url("/v1/jobs")).header("x-client", client);
        request.body(problem("wait").to_string())
    };
    let mut jobs = Vec::new();
    for _ in 0..2 {
        let reply = post("greedy").send().await.unwrap();
        jobs.push(reply.headers()["location"].to_str().unwrap().to_owned());
    }
    let refused = post("greedy").send().await.unwrap();
    assert!(refused.headers().contains_key("retry-after"));
    assert_eq!(problem_document(refused).await["code"], "too_many_jobs");
    assert_eq!(post("modest").send().await.unwrap().status(), 202);

    let watch = |client: &str| {
        server.client.get(server.url(&format!("{}/events", jobs[0]))).header("x-client", client).send()
    };
    let held =
        [watch("greedy").await.unwrap(), watch("greedy").await.unwrap(), watch("modest").await.unwrap()];
    assert!(held.iter().all(|reply| reply.status() == 200));
    for client in ["greedy", "modest", "third"] {
        let reply = watch(client).await.unwrap();
        assert_eq!(reply.status(), 429, "{client}");
        assert_eq!(problem_document(reply).await["code"], "too_many_streams");
    }
    drop(held);
    // Their ends are noticed in a moment.
    while watch("third").await.unwrap().status() != 200 {
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
}

#[tokio::test]
async fn no_address_takes_all_connections() {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpStream;
    let server = Server::with(|config| {
        config.connections = 3;
        config.client_connections = 2;
    })
    .await;
    let mut held = Vec::new();
    for _ in 0..2 {
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(b"GET /livez HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
        assert_eq!(stream.read_u8().await.unwrap(), b'H');
        held.push(stream);
    }
    let mut third = TcpStream::connect(server.address).await.unwrap();
    let mut text = String::new();
    third.read_to_string(&mut text).await.unwrap();
    assert!(text.starts_with("HTTP/1.1 429 ") && text.contains("\r\nretry-after: "), "{text}");
    let document: Value = serde_json::from_str(text.split_once("\r\n\r\n").unwrap().1).unwrap();
    assert_eq!(document["code"], "too_many_connections");
    drop(held);
    // Their ends are noticed in a moment.
    let mut tries = 0;
    while server.client.get(server.url("/livez")).send().await.is_err() {
        tries += 1;
        assert!(tries < 1000, "there is room again");
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    let figures = server.get("/metrics").await.text().await.unwrap();
    assert!(figures.contains("quadrille_rejects_total{code=\"too_many_connections\"}"), "{figures}");
}
