//! What is there to read: health, scenarios, checks.

use serde_json::{Value, json};

use crate::script::problem;
use crate::server::{Server, problem_document};

#[tokio::test]
async fn the_service_says_that_it_lives_and_is_ready() {
    let server = Server::start(3, 8).await;
    assert_eq!(server.json("/livez").await["status"], "ok");
    let ready = server.json("/readyz").await;
    assert_eq!((&ready["status"], &ready["workers"]), (&json!("ok"), &json!(3)));
}

#[tokio::test]
async fn every_scenario_can_be_posted_back() {
    let server = Server::start(1, 8).await;
    let listing = server.json("/v1/scenarios").await;
    let scenarios = listing["scenarios"].as_array().unwrap();
    assert!(scenarios.iter().any(|entry| entry["name"] == "switch/2x2"));
    for entry in scenarios {
        let document = server.get(entry["href"].as_str().unwrap()).await.text().await.unwrap();
        let reply = server.post("/v1/validate", document).await;
        assert_eq!(reply.status(), 200, "{entry}");
        let answer: Value = reply.json().await.unwrap();
        assert_eq!((&answer["arms"], &answer["objects"]), (&entry["arms"], &entry["objects"]));
        assert!(answer["problem_digest"].as_str().unwrap().starts_with("sha256:"));
    }
}

#[tokio::test]
async fn plans_are_judged() {
    let server = Server::start(1, 8).await;
    let job = server.create("improve 1").await;
    server.until(&job, "terminal").await;
    let plan = server.json(&format!("{job}/solutions/best")).await;
    // The scripted plan moves nothing: it can be read, and is wrong.
    let body = json!({ "problem": problem("improve 1"), "plan": plan });
    let reply = server.post("/v1/verify", body.to_string()).await;
    assert_eq!(reply.status(), 200);
    let verdict: Value = reply.json().await.unwrap();
    assert_eq!(verdict["valid"], false);
    assert!(verdict["violations"].as_array().unwrap().iter().any(|violation| violation["rule"] == "goal"));

    for (body, code, pointer) in [
        (json!({ "problem": problem("x") }), "invalid_problem", ""),
        (json!({ "problem": problem("x"), "plan": {}, "more": 1 }), "invalid_problem", "/more"),
        (json!({ "problem": problem("x"), "plan": [] }), "invalid_plan", "/plan"),
        (json!([]), "invalid_problem", ""),
    ] {
        let document = problem_document(server.post("/v1/verify", body.to_string()).await).await;
        assert_eq!(
            (&document["code"], document["errors"][0]["pointer"].as_str()),
            (&json!(code), Some(pointer))
        );
    }
}

#[tokio::test]
async fn requests_carry_an_id() {
    let server = Server::start(1, 8).await;
    let given = server.client.get(server.url("/livez")).header("x-request-id", "mine").send().await.unwrap();
    assert_eq!(given.headers()["x-request-id"], "mine");
    assert!(server.get("/livez").await.headers().contains_key("x-request-id"));
}
