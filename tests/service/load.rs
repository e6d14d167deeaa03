//! Many streams and a full queue: what is refused is refused properly, and the rest goes on.

use std::time::{Duration, Instant};

use futures::StreamExt;
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;

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

/// The slowest of the answers of `/livez`, asked for every 100 ms until `done`.
async fn slowest_livez(client: reqwest::Client, url: String, done: CancellationToken) -> Duration {
    let mut slowest = Duration::ZERO;
    while !done.is_cancelled() {
        let asked = Instant::now();
        assert_eq!(client.get(format!("{url}/livez")).send().await.unwrap().status(), 200);
        slowest = slowest.max(asked.elapsed());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    slowest
}

/// Posts `body` `count` times, every `pause` without waiting for the replies, and checks that each is
/// refused as it should be; how many a second there were.
async fn submit(client: &reqwest::Client, url: &str, body: &str, count: u32, pause: Duration) -> f64 {
    let (mut posts, mut ticks) = (tokio::task::JoinSet::new(), tokio::time::interval(pause));
    let began = Instant::now();
    for _ in 0..count {
        ticks.tick().await;
        posts.spawn(client.post(format!("{url}/v1/jobs")).body(body.to_owned()).send());
    }
    while let Some(reply) = posts.join_next().await {
        let reply = reply.unwrap().unwrap();
        assert_eq!(reply.status(), 429);
        let seconds: u64 = reply.headers()["retry-after"].to_str().unwrap().parse().unwrap();
        assert!((1..=60).contains(&seconds));
    }
    f64::from(count) / began.elapsed().as_secs_f64()
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
    long["options"] = json!({"time_budget_s": 3600.0, "threads": 1});
    let long = long.to_string();
    let post = || client.post(format!("{url}/v1/jobs")).body(long.clone()).send();
    let first = post().await.unwrap();
    let running = first.headers()["location"].to_str().unwrap().to_owned();
    while post().await.unwrap().status() == 202 {}
    let span = if soak() { Duration::from_secs(50) } else { Duration::from_secs(2) };
    let before = iterations_per_second(&client, &url, &running, span).await;

    // Every reader first gets all that has happened; the load begins when all are up to date.
    let (told, mut caught_up) = tokio::sync::mpsc::unbounded_channel();
    let readers: Vec<_> = (0..streams)
        .map(|_| {
            let request = client.get(format!("{url}{running}/events"));
            let told = told.clone();
            tokio::spawn(async move {
                let reply = request.send().await.unwrap();
                assert_eq!(reply.status(), 200);
                let (mut stream, mut up_to_date) = (reply.bytes_stream(), false);
                while let Some(Ok(chunk)) = stream.next().await {
                    let progress = chunk.windows(16).any(|text| text == b"\"type\":\"progress");
                    if progress && !std::mem::replace(&mut up_to_date, true) {
                        told.send(()).unwrap();
                    }
                }
            })
        })
        .collect();
    for _ in 0..streams {
        caught_up.recv().await.unwrap();
    }
    let memory = process.memory();
    let meanwhile = {
        let (client, url, running) = (client.clone(), url.clone(), running.clone());
        tokio::spawn(async move { iterations_per_second(&client, &url, &running, span).await })
    };
    let done = CancellationToken::new();
    let livez = tokio::spawn(slowest_livez(client.clone(), url.clone(), done.clone()));
    let rate = submit(&client, &url, &long, submissions, pause).await;
    let under_load = meanwhile.await.unwrap();
    done.cancel();
    let slowest = livez.await.unwrap();
    let grown = process.memory().saturating_sub(memory);
    // Whatever else the machine does slows the job down as well: once more without the load.
    readers.iter().for_each(tokio::task::JoinHandle::abort);
    let after = iterations_per_second(&client, &url, &running, span).await;
    let alone = (before + after) / 2.0;
    let lost = 1.0 - under_load / alone;
    println!(
        "{streams} streams, {submissions} refused at {rate:.0} a second; /livez at most {:.1} ms; memory {:.1} MB and \
         {:.1} MB more in the end; iterations {before:.0}/s before, {under_load:.0}/s under load, {after:.0}/s \
         after: {:.1} % lost",
        slowest.as_secs_f64() * 1e3,
        memory as f64 / 1e6,
        grown as f64 / 1e6,
        lost * 100.0,
    );
    if soak() {
        assert!(rate > 190.0, "only {rate} a second");
        assert!(slowest < Duration::from_millis(100), "/livez took {slowest:?}");
        assert!(lost < 0.1, "{lost} of the iterations are lost");
        assert!(grown < 64 << 20, "memory grows: {grown}");
    }
    assert!(grown < 256 << 20, "memory grows: {grown}");
}
