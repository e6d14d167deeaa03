//! Jobs that survive the end of the process, however it comes.

use std::time::{Duration, Instant};

use futures::StreamExt;
use quadrille::service::ServiceConfig;
use serde_json::{Value, json};

use crate::figures::Figures;
use crate::process::Process;
use crate::script::problem;
use crate::server::Server;

fn kinds(events: &[Value]) -> Vec<&str> {
    events.iter().filter_map(|event| event["type"].as_str()).collect()
}

#[tokio::test]
async fn a_restart_takes_up_what_was_left() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::keeping(folder.path()).await;
    let ended = server.create("improve 2").await;
    let before = server.durable(&ended).await;
    let plan = server.json(&format!("{ended}/solutions/1")).await;
    let running = server.create("wait").await;
    server.until(&running, "incumbent").await;
    let waiting = server.create("improve 3").await;
    let record = server.json(&waiting).await;
    server.stop().await;

    let server = Server::keeping(folder.path()).await;
    assert_eq!(server.durable(&ended).await, before);
    assert_eq!(server.json(&format!("{ended}/solutions/1")).await, plan);
    assert_eq!(server.get(&format!("{ended}/events?after=5")).await.status(), 204);
    // What ran goes on, in its next attempt, from its best plan; what waits keeps its place.
    server.until(&running, "retrying").await;
    assert_eq!(server.json(&waiting).await["created_at"], record["created_at"]);
    let again = server.json(&running).await;
    assert_eq!((&again["attempt"], &again["best"]["steps"]), (&json!(2), &json!(6)));
    server.post(&format!("{running}/cancel"), "").await;
    let events = server.durable(&running).await;
    let told = kinds(&events);
    assert_eq!(told[..4], ["queued", "started", "incumbent", "retrying"]);
    assert_eq!(told.last(), Some(&"terminal"));
    assert_eq!(told.iter().filter(|kind| **kind == "incumbent").count(), 1, "none that is no better");
    assert_eq!((&events[3]["cause"], &events[3]["attempt"]), (&json!("shutdown"), &json!(2)));
    let seqs: Vec<u64> = events.iter().filter_map(|event| event["seq"].as_u64()).collect();
    assert_eq!(seqs, (1..=seqs.len() as u64).collect::<Vec<_>>());
    assert_eq!(server.durable(&waiting).await.last().unwrap()["state"], "SUCCEEDED");
}

#[tokio::test]
async fn the_unspent_budget_is_what_the_next_attempt_gets() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::keeping(folder.path()).await;
    let mut short = problem("wait");
    short["options"] = json!({"time_budget_s": 0.5});
    let reply = server.post("/v1/jobs", short.to_string()).await;
    let job = reply.headers()["location"].to_str().unwrap().to_owned();
    server.until(&job, "incumbent").await;
    server.stop().await;
    // At least a second of it, with the clock of the job going on.
    let server = Server::keeping(folder.path()).await;
    let events = server.events(&job, 0).await;
    assert_eq!(events.last().unwrap()["termination_reason"], "TIME_LIMIT");
    let elapsed: Vec<f64> = events.iter().filter_map(|event| event["elapsed_s"].as_f64()).collect();
    assert!(elapsed.iter().all(|elapsed| *elapsed < 30.0), "{elapsed:?}");
}

#[tokio::test]
async fn an_idempotency_key_survives_the_process() {
    let folder = tempfile::tempdir().unwrap();
    let post = async |server: &Server| {
        let request = server.client.post(server.url("/v1/jobs")).header("idempotency-key", "k");
        let reply = request.body(problem("improve 1").to_string()).send().await.unwrap();
        reply.headers()["location"].to_str().unwrap().to_owned()
    };
    let server = Server::keeping(folder.path()).await;
    let first = post(&server).await;
    server.until(&first, "terminal").await;
    server.stop().await;
    assert_eq!(post(&Server::keeping(folder.path()).await).await, first);
}

/// A job that ends the process each time it runs is given up after three attempts, and the others
/// are done.
#[tokio::test]
async fn a_poisonous_job_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut process = Process::start(folder.path());
    let mut jobs = Vec::new();
    for name in ["steps 2 200", "abort", "improve 3", "improve 3"] {
        let body = json!({"problem": problem(name), "priority": if name == "abort" { 10 } else { 0 }});
        // The poison may work before the reply is there: the key makes it safe to ask again.
        let reply = loop {
            let request =
                client.post(process.url("/v1/jobs")).header("idempotency-key", jobs.len().to_string());
            if let Ok(reply) = request.body(body.to_string()).send().await {
                break reply;
            }
            process.wait();
            process = Process::start(folder.path());
        };
        jobs.push(reply.headers()["location"].to_str().unwrap().to_owned());
    }
    let poison = jobs[1].clone();
    let mut starts = 0;
    loop {
        starts += 1;
        assert!(starts < 12, "the process must come to rest");
        let ended = client.get(process.url(&format!("{poison}/events"))).send().await;
        let text = match ended {
            Ok(reply) => reply.text().await,
            Err(error) => Err(error),
        };
        if text.is_ok_and(|text| text.contains("\"terminal\"")) {
            break;
        }
        process.wait();
        process = Process::start(folder.path());
    }
    let events = process.durable(&client, &poison).await;
    assert_eq!(kinds(&events).iter().filter(|kind| **kind == "started").count(), 3, "{:?}", kinds(&events));
    assert_eq!(kinds(&events).iter().filter(|kind| **kind == "retrying").count(), 2);
    let end = events.last().unwrap();
    assert_eq!((&end["state"], &end["termination_reason"]), (&json!("FAILED"), &json!("WORKER_LOST")));
    for job in jobs.iter().filter(|job| **job != poison) {
        let events = process.durable(&client, job).await;
        let end = events.last().unwrap();
        let lost = end["termination_reason"] == "WORKER_LOST";
        // One that ran beside the poison each time shares its fate.
        assert!(end["state"] == "SUCCEEDED" || lost, "{end}");
    }
    assert!(!process.has_ended());
    let others = format!("after 3 attempts; {} others were done", jobs.len() - 1);
    Figures::of("durability").note("a job that ends the process each time has ended", others);
}

#[tokio::test]
async fn sigterm_gives_jobs_back_and_ends_streams() {
    let folder = tempfile::tempdir().unwrap();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut process = Process::start(folder.path());
    let mut jobs = Vec::new();
    for _ in 0..4 {
        let reply =
            client.post(process.url("/v1/jobs")).body(problem("wait").to_string()).send().await.unwrap();
        jobs.push(reply.headers()["location"].to_str().unwrap().to_owned());
    }
    let streams = (0..100).map(|number| {
        let request = client.get(process.url(&format!("{}/events", jobs[number % 4])));
        request.header("accept", "text/event-stream").send()
    });
    let mut streams: Vec<_> = futures::future::join_all(streams)
        .await
        .into_iter()
        .map(|reply| Box::pin(reply.unwrap().bytes_stream()))
        .collect();
    for stream in &mut streams {
        stream.next().await.unwrap().unwrap();
    }
    let told = Instant::now();
    process.terminate();
    for stream in streams {
        let text: Vec<u8> = stream.map(|chunk| chunk.expect("a clean end").to_vec()).concat().await;
        let text = String::from_utf8(text).unwrap();
        assert!(text.ends_with("retry: 2000\n\n"), "{text}");
        assert!(!text.contains("terminal"));
    }
    let ended = told.elapsed();
    assert!(process.wait().success());
    let (gone, limit) = (told.elapsed(), ServiceConfig::default().drain);
    let mut figures = Figures::of("durability");
    let took = |span: Duration| format!("{:.0} ms", span.as_secs_f64() * 1e3);
    figures.note("SIGTERM with 100 streams: they have ended cleanly", took(ended));
    let mark = format!("{} s to drain", limit.as_secs_f64());
    figures.mark("SIGTERM with running jobs: the process has ended", took(gone), &mark, gone < limit);

    let process = Process::start(folder.path());
    let mut resumed = 0;
    for job in &jobs {
        // Every job goes on: those that ran in their next attempt, those that waited in their first.
        loop {
            let record: Value = client.get(process.url(job)).send().await.unwrap().json().await.unwrap();
            match record["state"].as_str().unwrap() {
                "RUNNING" => break,
                "QUEUED" => tokio::time::sleep(Duration::from_millis(5)).await,
                other => panic!("{job} is {other}"),
            }
        }
        client.post(process.url(&format!("{job}/cancel"))).send().await.unwrap();
        let events = process.durable(&client, job).await;
        assert_eq!(kinds(&events).iter().filter(|kind| **kind == "terminal").count(), 1);
        let given_back: Vec<&Value> = events.iter().filter(|event| event["type"] == "retrying").collect();
        assert!(given_back.iter().all(|event| event["cause"] == "shutdown"), "{given_back:?}");
        resumed += given_back.len();
    }
    let all = format!("all {}, {resumed} of them from where they were", jobs.len());
    figures.note("jobs that went on at the next start", all);
    assert!(resumed > 0, "some ran");
    figures.finish();
}

/// A disk that takes no more ends the process, not the jobs: what was accepted is there at the next start.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_loses_nothing_that_was_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let settings = ["--data-dir", folder.path().to_str().unwrap(), "--workers", "1", "--queue-limit", "1000"];
    let mut process = Process::product_on_a_small_disk(&settings, 3 << 10);
    let mut body = problem("long");
    body["options"] = json!({"time_budget_s": 3600.0});
    // Some hundred kilobytes each.
    let robot = quadrille::kinematics::library("iiwa14").unwrap();
    let padded = format!("{}<!-- {} -->", robot.urdf, "x".repeat(300_000));
    body["workcell"]["robots"]["iiwa14"] = json!({"urdf_xml": padded, "srdf_xml": robot.srdf});
    let mut accepted = Vec::new();
    let refused = loop {
        let reply = client.post(process.url("/v1/jobs")).body(body.to_string()).send().await.unwrap();
        match reply.status().as_u16() {
            202 => accepted.push(reply.headers()["location"].to_str().unwrap().to_owned()),
            status => break (status, crate::server::problem_document(reply).await),
        }
        assert!(accepted.len() < 100, "the disk never fills up");
    };
    assert_eq!((refused.0, &refused.1["code"]), (503, &json!("storage_failed")));
    assert!(!accepted.is_empty());
    assert_eq!(process.wait().code(), Some(2), "whoever minds it starts it again");

    let process = Process::product(&settings);
    let listed: Value = client.get(process.url("/v1/jobs")).send().await.unwrap().json().await.unwrap();
    let mut there: Vec<&str> =
        listed["jobs"].as_array().unwrap().iter().map(|job| job["links"]["self"].as_str().unwrap()).collect();
    there.reverse();
    assert_eq!(there, accepted);
}

#[tokio::test]
async fn what_is_trimmed_is_summed_up() {
    let server = Server::with(|config| config.retention.job_events = 5).await;
    let job = server.create("improve 40").await;
    server.until(&job, "terminal").await;
    let events = server.events(&job, 0).await;
    let snapshot = &events[0];
    assert_eq!((&snapshot["type"], &snapshot["state"]), (&json!("snapshot"), &json!("SUCCEEDED")));
    assert_eq!(snapshot["metrics"], server.json(&job).await["best"]);
    let seqs: Vec<u64> = events.iter().filter_map(|event| event["seq"].as_u64()).collect();
    assert_eq!(seqs, (seqs[0]..=43).collect::<Vec<_>>());
    assert!(seqs.len() < 10);
    // One that comes back with the number of the snapshot sees no snapshot.
    let rest = server.events(&job, seqs[0]).await;
    assert_eq!(rest, events[1..]);
    let from = server.json(&format!("{job}/incumbents")).await;
    assert_eq!(from["incumbents"][0]["seq"], events[1]["seq"]);
    assert_eq!(server.get(&format!("{job}/solutions/1")).await.status(), 404);
    assert_eq!(server.json(&format!("{job}/solutions/best")).await["revision"], 40);
}
