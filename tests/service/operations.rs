//! What an operator sees: figures, request ids.

use serde_json::{Value, json};

use crate::process::Process;
use crate::script::problem;
use crate::server::Server;

/// The value of a line of `/metrics`.
fn find(text: &str, name: &str) -> Option<f64> {
    text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '))?.parse().ok()
}

fn value(text: &str, name: &str) -> f64 {
    find(text, name).unwrap_or_else(|| panic!("no {name} in\n{text}"))
}

#[tokio::test]
async fn figures_tell_what_happens() {
    let server = Server::start(1, 1).await;
    for name in ["improve 3", "panic", "nothing"] {
        let job = server.create(name).await;
        server.until(&job, "terminal").await;
    }
    let running = server.create("wait").await;
    server.until(&running, "incumbent").await;
    server.create("wait").await;
    assert_eq!(server.post("/v1/jobs", problem("wait").to_string()).await.status(), 429);
    assert_eq!(server.post("/v1/jobs", "{").await.status(), 429);
    assert_eq!(server.post("/v1/validate", "{").await.status(), 400);
    let watched = server.get(&format!("{running}/events")).await;
    let expected = [
        ("quadrille_queue_depth", 1.0),
        ("quadrille_jobs_running", 1.0),
        ("quadrille_jobs_accepted_total", 5.0),
        ("quadrille_incumbents_total", 5.0),
        ("quadrille_first_plan_seconds_count", 3.0),
        ("quadrille_job_duration_seconds_count", 3.0),
        ("quadrille_planner_busy_seconds_count", 3.0),
        ("quadrille_guidance_seconds_count", 3.0),
        ("quadrille_solver_seconds_count", 3.0),
        ("quadrille_panics_total", 1.0),
        ("quadrille_streams_open", 1.0),
        ("quadrille_jobs_ended_total{state=\"SUCCEEDED\",reason=\"TIME_LIMIT\"}", 1.0),
        ("quadrille_jobs_ended_total{state=\"FAILED\",reason=\"INTERNAL\"}", 1.0),
        ("quadrille_rejects_total{code=\"queue_full\"}", 2.0),
        ("quadrille_rejects_total{code=\"invalid_json\"}", 1.0),
    ];
    // Some are counted a moment after the event that tells of it.
    let mut text = String::new();
    for _ in 0..100 {
        let reply = server.get("/metrics").await;
        assert!(reply.headers()["content-type"].to_str().unwrap().starts_with("text/plain"));
        text = reply.text().await.unwrap();
        if expected.iter().all(|(name, expected)| find(&text, name) == Some(*expected)) {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    drop(watched);
    for (name, expected) in expected {
        assert_eq!(value(&text, name), expected, "{name}");
    }
}

#[tokio::test]
async fn only_plain_request_ids_are_taken_over() {
    let server = Server::start(1, 1).await;
    for (given, kept) in [("line-7.42", true), ("", false), ("a b", false), (&*"x".repeat(129), false)] {
        let reply =
            server.client.get(server.url("/livez")).header("x-request-id", given).send().await.unwrap();
        let id = reply.headers()["x-request-id"].to_str().unwrap();
        assert_eq!(id == given, kept, "{given}: {id}");
        assert!(!id.is_empty());
    }
}

/// By the log a request leads to its job, and a job to its end.
#[tokio::test]
async fn log_lines_carry_the_ids_of_requests_and_jobs() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log");
    let mut process = Process::logged(&["--workers", "1"], &log);
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut body = problem("x");
    body["options"] = json!({"time_budget_s": 60.0, "stop": {"first_solution": true}});
    let request = client.post(process.url("/v1/plan")).header("x-request-id", "line-7");
    let reply = request.body(body.to_string()).send().await.unwrap();
    assert_eq!(reply.headers()["x-request-id"], "line-7");
    let job = reply.headers()["location"].to_str().unwrap().rsplit('/').next().unwrap().to_owned();
    reply.text().await.unwrap();
    process.terminate();
    assert!(process.wait().success());
    let text = std::fs::read_to_string(log).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let said = |message: &str| {
        let line = lines.iter().find(|line| line["fields"]["message"] == message);
        line.unwrap_or_else(|| panic!("`{message}` in {text}"))
    };
    let accepted = said("job accepted");
    assert_eq!((&accepted["span"]["id"], &accepted["fields"]["job"]), (&json!("line-7"), &json!(job)));
    assert_eq!(said("job ended")["fields"]["job"], json!(job));
    // The settings that hold stand in the first line.
    let limits: Value = serde_json::from_str(lines[0]["fields"]["limits"].as_str().unwrap()).unwrap();
    assert_eq!((&lines[0]["fields"]["message"], &limits["workers"]), (&json!("listening"), &json!(1)));
}
