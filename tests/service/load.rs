//! Many streams and a full queue: what is refused is refused properly, and the rest goes on.

use std::time::{Duration, Instant};

use futures::StreamExt;
use serde_json::{Value, json};

use crate::process::{Process, soak};
use crate::script::problem;

fn client() -> reqwest::Client {
    reqwest::Client::builder().no_proxy().pool_max_idle_per_host(64).build().unwrap()
}

/// Iterations of a running job, from its next signs of life over `span`: how many a second.
async fn iterations_per_second(client: &reqwest::Client, url: &str, job: &str, span: Duration) -> f64 {
    let reply = client.get(format!("{url}{job}/events")).send().await.unwrap();
    let (mut stream, mut text, mut seen) = (reply.bytes_stream(), Vec::new(), Vec::new());
    let began = Instant::now();
    while began.elapsed() < span {
        let Some(Ok(chunk)) = stream.next().await else { break };
        text.extend_from_slice(&chunk);
        while let Some(end) = text.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = text.drain(..=end).collect();
            let event: Value = serde_json::from_slice(&line).unwrap();
            if event["type"] == "progress" {
                seen.push((event["elapsed_s"].as_f64().unwrap(), event["iterations"].as_f64().unwrap()));
            }
        }
    }
    match (seen.first(), seen.last()) {
        (Some(first), Some(last)) if last.0 > first.0 => (last.1 - first.1) / (last.0 - first.0),
        _ => 0.0,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_service_refuses_and_goes_on() {
    let (streams, submissions, pause) =
        if soak() { (500, 12_000, Duration::from_millis(5)) } else { (50, 100, Duration::from_millis(2)) };
    let limits =
        ["--workers", "1", "--queue-limit", "4", "--client-jobs", "1000", "--client-streams", "1000"];
    let process = Process::product(&limits);
    let client = client();
    let url = process.url("");
    let mut long = problem("long");
    long["options"] = json!({"time_budget_s": 600.0, "threads": 1});
    let post = || client.post(format!("{url}/v1/jobs")).body(long.to_string()).send();
    let first = post().await.unwrap();
    let running = first.headers()["location"].to_str().unwrap().to_owned();
    while post().await.unwrap().status() == 202 {}
    let span = if soak() { Duration::from_secs(20) } else { Duration::from_secs(2) };
    let before = iterations_per_second(&client, &url, &running, span).await;

    let open = (0..streams).map(|_| client.get(format!("{url}{running}/events")).send());
    let held = futures::future::join_all(open).await;
    assert!(held.iter().all(|reply| reply.as_ref().is_ok_and(|reply| reply.status() == 200)));
    let readers: Vec<_> = held
        .into_iter()
        .map(|reply| tokio::spawn(async move { reply.unwrap().bytes_stream().for_each(|_| async {}).await }))
        .collect();
    let memory = process.memory();
    let meanwhile = {
        let (client, url, running) = (client.clone(), url.clone(), running.clone());
        tokio::spawn(async move { iterations_per_second(&client, &url, &running, span * 2).await })
    };
    let (mut slowest, mut refused, mut ticks) = (Duration::ZERO, 0, tokio::time::interval(pause));
    for number in 0..submissions {
        ticks.tick().await;
        let reply = post().await.unwrap();
        assert_eq!(reply.status(), 429);
        let seconds: u64 = reply.headers()["retry-after"].to_str().unwrap().parse().unwrap();
        assert!((1..=60).contains(&seconds));
        refused += 1;
        if number % 50 == 0 {
            let asked = Instant::now();
            assert_eq!(client.get(format!("{url}/livez")).send().await.unwrap().status(), 200);
            slowest = slowest.max(asked.elapsed());
        }
    }
    let under_load = meanwhile.await.unwrap();
    let grown = process.memory().saturating_sub(memory);
    println!(
        "{streams} streams, {refused} refused; /livez at most {:.1} ms; memory {:.1} MB and {:.1} MB more in the end; \
         iterations {before:.0}/s alone, {under_load:.0}/s under load",
        slowest.as_secs_f64() * 1e3,
        memory as f64 / 1e6,
        grown as f64 / 1e6,
    );
    assert!(grown < 256 << 20, "memory grows: {grown}");
    readers.iter().for_each(tokio::task::JoinHandle::abort);
}
