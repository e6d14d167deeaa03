//! A service on a free port, and small ways to talk to it.

use std::net::SocketAddr;
use std::sync::Arc;

use futures::StreamExt;
use quadrille::jobs::{Planner, SmartPlanner};
use quadrille::service::{self, ServiceConfig};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::script;

/// A running service; shuts down when dropped.
pub struct Server {
    pub address: SocketAddr,
    pub shutdown: CancellationToken,
    pub task: tokio::task::JoinHandle<std::io::Result<()>>,
    pub client: reqwest::Client,
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shutdown.cancel();
    }
}

impl Server {
    pub async fn start(workers: usize, queue_limit: usize) -> Self {
        Self::with(|config| {
            config.jobs.workers = workers;
            config.jobs.queue_limit = queue_limit;
        })
        .await
    }

    pub async fn keeping(folder: &std::path::Path) -> Self {
        Self::with(|config| {
            config.data_dir = Some(folder.to_owned());
            config.jobs.workers = 1;
        })
        .await
    }

    /// Shuts down and waits for the end.
    pub async fn stop(mut self) {
        self.shutdown.cancel();
        (&mut self.task).await.unwrap().unwrap();
    }

    pub async fn with(configure: impl FnOnce(&mut ServiceConfig)) -> Self {
        Self::running(Arc::new(script::plan), configure).await
    }

    /// With the planner of the product.
    pub async fn planning(configure: impl FnOnce(&mut ServiceConfig)) -> Self {
        Self::running(Arc::new(SmartPlanner::default()), configure).await
    }

    async fn running(planner: Arc<dyn Planner>, configure: impl FnOnce(&mut ServiceConfig)) -> Self {
        let mut config = ServiceConfig::default();
        configure(&mut config);
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let shutdown = CancellationToken::new();
        let task = tokio::spawn(service::serve(listener, config, planner, shutdown.clone()));
        let client = reqwest::Client::builder().no_proxy().build().unwrap();
        Self { address, shutdown, task, client }
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub async fn get(&self, path: &str) -> reqwest::Response {
        self.client.get(self.url(path)).send().await.unwrap()
    }

    pub async fn json(&self, path: &str) -> Value {
        let reply = self.get(path).await;
        assert_eq!(reply.status(), 200, "{path}");
        reply.json().await.unwrap()
    }

    pub async fn post(&self, path: &str, body: impl Into<reqwest::Body>) -> reqwest::Response {
        let request = self.client.post(self.url(path)).header("content-type", "application/json");
        request.body(body).send().await.unwrap()
    }

    /// Creates a job from the scripted problem `name`; its path.
    pub async fn create(&self, name: &str) -> String {
        let reply = self.post("/v1/jobs", script::problem(name).to_string()).await;
        assert_eq!(reply.status(), 202);
        let location = reply.headers()["location"].to_str().unwrap().to_owned();
        let job: Value = reply.json().await.unwrap();
        assert_eq!(location, format!("/v1/jobs/{}", job["id"].as_str().unwrap()));
        location
    }

    /// The problem document of a refused request.
    pub async fn refused(&self, request: reqwest::RequestBuilder, status: u16) -> Value {
        let reply = request.send().await.unwrap();
        assert_eq!(reply.status(), status);
        problem_document(reply).await
    }

    /// Durable events of a job from the first one kept on, once it has ended.
    pub async fn durable(&self, job: &str) -> Vec<Value> {
        self.events(job, 0).await.into_iter().filter(|event| event["type"] != "progress").collect()
    }

    /// All events of a job from number `after` on, as NDJSON.
    pub async fn events(&self, job: &str, after: u64) -> Vec<Value> {
        let reply = self.get(&format!("{job}/events?after={after}")).await;
        assert_eq!(reply.status(), 200);
        assert_eq!(reply.headers()["content-type"], "application/x-ndjson");
        lines(&reply.text().await.unwrap())
    }

    /// Waits until the job is in `state`, following its events.
    pub async fn until(&self, job: &str, kind: &str) {
        let reply = self.get(&format!("{job}/events")).await;
        let mut stream = reply.bytes_stream();
        let mut text = String::new();
        while let Some(chunk) = stream.next().await {
            text.push_str(std::str::from_utf8(&chunk.unwrap()).unwrap());
            if text.contains(&format!("\"type\":\"{kind}\"")) {
                return;
            }
        }
        panic!("{job} never got to {kind}");
    }
}

pub fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Asserts that a reply is a problem document; gives it.
pub async fn problem_document(reply: reqwest::Response) -> Value {
    let status = reply.status().as_u16();
    assert_eq!(reply.headers()["content-type"], "application/problem+json");
    let document: Value = reply.json().await.unwrap();
    assert_eq!(document["status"], status);
    for member in ["type", "title", "detail", "code"] {
        assert!(!document[member].as_str().unwrap().is_empty(), "{document}");
    }
    assert!(document["retryable"].is_boolean());
    for fault in document["errors"].as_array().unwrap() {
        assert!(fault["pointer"].is_string() && fault["code"].is_string(), "{fault}");
        assert!(!fault["message"].as_str().unwrap().is_empty(), "{fault}");
    }
    document
}
