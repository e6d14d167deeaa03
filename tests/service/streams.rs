//! Streams of events: formats, resuming, signs of life, shutdown.

use std::time::{Duration, Instant};

use futures::StreamExt;
use quadrille::service::ServiceConfig;
use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

use crate::figures::Figures;
use crate::process::soak;
use crate::script::problem;
use crate::server::{Server, lines, problem_document};

/// One server-sent event.
#[derive(Debug, Default)]
struct Sent {
    id: Option<u64>,
    event: String,
    data: Value,
}

/// Reads SSE until the stream ends or `enough` says so.
async fn read_sse(reply: reqwest::Response, enough: impl Fn(&[Sent]) -> bool) -> Vec<Sent> {
    assert_eq!(reply.status(), 200);
    assert_eq!(reply.headers()["content-type"], "text/event-stream");
    let mut chunks = reply.bytes_stream();
    let (mut text, mut sent) = (Vec::new(), Vec::new());
    while !enough(&sent) {
        let Some(chunk) = chunks.next().await else { break };
        text.extend_from_slice(&chunk.unwrap());
        while let Some(end) = text.windows(2).position(|pair| pair == b"\n\n") {
            let block: Vec<u8> = text.drain(..end + 2).collect();
            let mut one = Sent::default();
            for line in String::from_utf8(block).unwrap().lines() {
                match line.split_once(": ") {
                    Some(("id", id)) => one.id = Some(id.parse().unwrap()),
                    Some(("event", event)) => one.event = event.to_owned(),
                    Some(("data", data)) => one.data = serde_json::from_str(data).unwrap(),
                    _ => {}
                }
            }
            if !one.event.is_empty() {
                sent.push(one);
            }
        }
    }
    sent
}

#[tokio::test]
async fn plan_streams_lines_by_default_and_server_sent_events_on_request() {
    let server = Server::start(1, 8).await;
    let reply = server.post("/v1/plan", problem("improve 3").to_string()).await;
    assert_eq!(reply.status(), 200);
    assert_eq!(reply.headers()["content-type"], "application/x-ndjson");
    let job = reply.headers()["location"].to_str().unwrap().to_owned();
    let streamed = lines(&reply.text().await.unwrap());
    assert_eq!(streamed.last().unwrap()["type"], "terminal");
    assert_eq!(streamed, server.events(&job, 0).await, "replay gives the same events");

    let request = server.client.post(server.url("/v1/plan")).header("accept", "text/event-stream");
    let reply = request.body(problem("improve 3").to_string()).send().await.unwrap();
    let sent = read_sse(reply, |_| false).await;
    let kinds: Vec<&str> = sent.iter().map(|one| one.event.as_str()).collect();
    assert_eq!(kinds, ["queued", "started", "incumbent", "incumbent", "incumbent", "terminal"]);
    for (index, one) in sent.iter().enumerate() {
        assert_eq!(one.id, Some(index as u64 + 1));
        assert_eq!((&one.data["seq"], &one.data["type"]), (&one.id.into(), &one.event.clone().into()));
    }
}

#[tokio::test]
async fn readers_resume_where_they_left_off() {
    let server = Server::start(1, 8).await;
    let job = server.create("improve 12").await;
    let all = server.events(&job, 0).await;
    assert_eq!(all.len(), 15);
    // One that reconnects after every third event sees each exactly once.
    let (mut seen, mut last) = (Vec::new(), 0);
    while seen.len() < all.len() {
        let mut request =
            server.client.get(server.url(&format!("{job}/events"))).header("accept", "text/event-stream");
        if last > 0 {
            request = request.header("last-event-id", last.to_string());
        }
        let sent = read_sse(request.send().await.unwrap(), |sent| sent.len() >= 3).await;
        for one in sent.into_iter().take(3) {
            last = one.id.unwrap();
            seen.push(one.data);
        }
    }
    assert_eq!(seen, all);
    assert_eq!(server.events(&job, 13).await, all[13..]);
    // Whichever of the two is further on counts.
    let both = server.client.get(server.url(&format!("{job}/events?after=14"))).header("last-event-id", "3");
    assert_eq!(lines(&both.send().await.unwrap().text().await.unwrap()), all[14..]);
    // Who has everything is told so.
    for after in [15, 16, u64::MAX] {
        assert_eq!(server.get(&format!("{job}/events?after={after}")).await.status(), 204);
    }
    for bad in ["after=-1", "after=x", "before=1"] {
        let document = problem_document(server.get(&format!("{job}/events?{bad}")).await).await;
        assert_eq!(document["code"], "bad_parameter");
    }
}

/// A stream from a number beyond the last event on gives nothing, and ends with the job.
#[tokio::test]
async fn a_reader_from_the_future_sees_the_end() {
    let server = Server::start(1, 8).await;
    let job = server.create("wait").await;
    server.until(&job, "incumbent").await;
    let (events, _) = tokio::join!(server.events(&job, 1000), async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        server.post(&format!("{job}/cancel"), "").await
    });
    assert_eq!(events, Vec::<Value>::new());
    // One that is ahead by a little gets what comes after.
    let job = server.create("steps 3 100").await;
    let events: Vec<Value> = server.events(&job, 3).await;
    let durable: Vec<u64> = events
        .iter()
        .filter(|event| event["type"] != "progress")
        .filter_map(|event| event["seq"].as_u64())
        .collect();
    assert_eq!(durable, [4, 5, 6]);
}

#[tokio::test]
async fn two_readers_of_a_running_job_see_the_same() {
    let server = Server::start(1, 8).await;
    let job = server.create("wait").await;
    let durable = async || {
        let events = server.events(&job, 0).await;
        events.into_iter().filter(|event| event["type"] != "progress").collect::<Vec<_>>()
    };
    let (first, second) = tokio::join!(durable(), async {
        server.until(&job, "progress").await;
        server.post(&format!("{job}/cancel"), "").await;
        durable().await
    });
    assert_eq!(first, second);
    assert_eq!(first.len(), 4);
}

/// One reader stays, the other leaves after every third event and comes back for the rest.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_keeps_coming_back_misses_nothing() {
    let (plans, pause) = if soak() { (200, 40) } else { (20, 20) };
    let server = Server::start(1, 8).await;
    let job = server.create(&format!("steps {plans} {pause}")).await;
    let stays = server.durable(&job);
    let returns = async {
        let (mut seen, mut last, mut visits) = (Vec::new(), 0, 0);
        while seen.last().is_none_or(|event: &Value| event["type"] != "terminal") {
            let request =
                server.client.get(server.url(&format!("{job}/events"))).header("accept", "text/event-stream");
            let request = if last > 0 { request.header("last-event-id", last.to_string()) } else { request };
            let durable = |sent: &[Sent]| sent.iter().filter(|one| one.id.is_some()).count();
            let reply = request.send().await.unwrap();
            let sent = read_sse(reply, |sent| durable(sent) >= 3).await;
            for one in sent.into_iter().filter(|one| one.id.is_some()).take(3) {
                last = one.id.unwrap();
                seen.push(one.data);
            }
            visits += 1;
        }
        (seen, visits)
    };
    let (stayed, (returned, visits)) = tokio::join!(stays, returns);
    let numbers: Vec<u64> = stayed.iter().filter_map(|event| event["seq"].as_u64()).collect();
    assert_eq!(numbers, (1..=plans + 3).collect::<Vec<_>>());
    assert_eq!(returned, stayed);
    let seen = format!("both, all {}, the second in {visits} visits", stayed.len());
    Figures::of("streams").note("two readers saw every durable event once, in order", seen);
}

#[tokio::test]
async fn signs_of_life_are_not_numbered() {
    let server = Server::start(1, 8).await;
    let job = server.create("wait").await;
    let request =
        server.client.get(server.url(&format!("{job}/events"))).header("accept", "text/event-stream");
    let progress = |sent: &[Sent]| sent.iter().any(|one| one.event == "progress");
    let sent = read_sse(request.send().await.unwrap(), progress).await;
    let one = sent.last().unwrap();
    assert_eq!((one.id, one.event.as_str()), (None, "progress"));
    assert_eq!(one.data["seq"], 3, "the number of the last durable event");
    assert_eq!(one.data["phase"], "improve");
    server.post(&format!("{job}/cancel"), "").await;
    let rest = server.events(&job, 3).await;
    let durable: Vec<&Value> = rest.iter().filter(|event| event["type"] != "progress").collect();
    assert!(matches!(&durable[..], [end] if end["type"] == "terminal" && end["seq"] == 4), "{rest:?}");
}

/// A stream over which nothing happens shows that it is alive; lines have no way to say so.
#[tokio::test]
async fn silent_streams_show_that_they_are_alive() {
    assert_eq!(ServiceConfig::default().keep_alive, Duration::from_secs(15));
    let server = Server::with(|config| {
        config.jobs.workers = 1;
        config.keep_alive = Duration::from_millis(20);
    })
    .await;
    let running = server.create("wait").await;
    server.until(&running, "incumbent").await;
    let waiting = server.create("improve 1").await;
    for (accept, alive) in [("text/event-stream", true), ("application/x-ndjson", false)] {
        let request = server.client.get(server.url(&format!("{waiting}/events"))).header("accept", accept);
        let mut stream = request.send().await.unwrap().bytes_stream();
        let mut text = String::new();
        let wait = Duration::from_millis(if alive { 60_000 } else { 200 });
        let all = tokio::time::timeout(wait, async {
            while text.matches(": alive\n\n").count() < 3 {
                text.push_str(std::str::from_utf8(&stream.next().await.unwrap().unwrap()).unwrap());
            }
        });
        assert_eq!(all.await.is_ok(), alive, "{accept}: {text}");
    }
}

#[tokio::test]
async fn a_shutdown_ends_streams_cleanly_and_refuses_work() {
    let mut server = Server::start(1, 8).await;
    let job = server.create("wait").await;
    server.until(&job, "incumbent").await;
    let request =
        server.client.get(server.url(&format!("{job}/events"))).header("accept", "text/event-stream");
    let reply = request.send().await.unwrap();
    server.shutdown.cancel();
    let text = reply.text().await.expect("the stream ends as it should");
    assert!(text.ends_with("retry: 2000\n\n"), "{text}");
    assert!(!text.contains("event: terminal"), "the job has not ended, the process does");
    (&mut server.task).await.unwrap().unwrap();
    assert!(server.client.get(server.url("/livez")).send().await.is_err());
}

/// Half a request keeps no shutdown past its time; half of a first head is not waited for at all.
#[tokio::test]
async fn half_a_request_does_not_hold_a_shutdown_up() {
    let whole = "GET /livez HTTP/1.1\r\nhost: x\r\n\r\n";
    let head = "GET /livez HTT";
    let body = "POST /v1/validate HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: 9\r\n\r\n{";
    let second = format!("{whole}{head}");
    let drain = Duration::from_secs(5);
    for (half, limit) in [("", drain / 2), (head, drain / 2), (body, drain), (second.as_str(), drain)] {
        let mut server = Server::with(|config| config.drain = drain).await;
        let mut stream = TcpStream::connect(server.address).await.unwrap();
        stream.write_all(half.as_bytes()).await.unwrap();
        // Long enough for it to be read.
        tokio::time::sleep(Duration::from_millis(100)).await;
        let told = Instant::now();
        server.shutdown.cancel();
        (&mut server.task).await.unwrap().unwrap();
        let took = told.elapsed();
        assert!(took < limit, "{half}: {took:?}");
    }
}
