//! Many streams and a full queue: what is refused is refused properly, and the rest goes on.
//!
//! What the load costs a running job is measured on one job with one seed, which makes the same plans in the same iterations
//! each time: how long, and how much processor time of the planner's threads, the very same iterations take under load and
//! without it, in turns. The load comes from a process of its own with the lowest priority, so that the figures tell of the service
//! and not of its clients.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use futures::StreamExt;
use serde_json::{Value, json};
use tokio::sync::mpsc::error::TryRecvError;
use tokio_util::sync::CancellationToken;

use crate::figures::Figures;
use crate::process::{Process, soak};
use crate::script::problem;

/// Asks the child process for a load: its description, JSON.
const LOAD: &str = "QUADRILLE_TEST_LOAD";

fn client() -> reqwest::Client {
    reqwest::Client::builder().no_proxy().pool_max_idle_per_host(64).build().unwrap()
}

/// How a job is getting on.
#[derive(Clone, Copy)]
struct Point {
    iterations: f64,
    /// On the job's own clock.
    elapsed_s: f64,
    /// Processor time of the planner's threads, and how long they waited for a processor.
    planner_s: f64,
    waited_s: f64,
    /// Processor time of all other threads.
    others_s: f64,
    memory: f64,
}

/// Follows a job's signs of life until `enough`; all durable events, without their plans, go into `plans`.
async fn follow(
    process: &Process,
    client: &reqwest::Client,
    job: &str,
    plans: &mut Vec<(u64, f64)>,
    mut enough: impl FnMut(&[Point]) -> bool,
) -> Vec<Point> {
    let reply = client.get(process.url(&format!("{job}/events"))).send().await.unwrap();
    let (mut stream, mut text, mut seen) = (reply.bytes_stream(), Vec::new(), Vec::new());
    while let Some(Ok(chunk)) = stream.next().await {
        text.extend_from_slice(&chunk);
        while let Some(end) = text.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = text.drain(..=end).collect();
            let event: Value = serde_json::from_slice(&line).unwrap();
            match event["type"].as_str() {
                Some("progress") => {
                    let (planner_s, waited_s, others_s) = process.times();
                    seen.push(Point {
                        iterations: event["iterations"].as_f64().unwrap(),
                        elapsed_s: event["elapsed_s"].as_f64().unwrap(),
                        planner_s,
                        waited_s,
                        others_s,
                        memory: process.memory() as f64,
                    });
                    if enough(&seen) {
                        return seen;
                    }
                }
                Some("incumbent") => plans.push((
                    event["revision"].as_u64().unwrap(),
                    event["metrics"]["duration_s"].as_f64().unwrap(),
                )),
                Some("terminal") => panic!("the job has ended: {event}"),
                _ => {}
            }
        }
    }
    panic!("the stream has ended");
}

/// Where a job was at `iterations`, between the signs of life before and after, or by the pace of the
/// last two where it did not come as far.
fn at(points: &[Point], iterations: f64) -> Point {
    let reached = points.iter().position(|point| point.iterations >= iterations);
    let after = reached.unwrap_or(points.len() - 1);
    let (a, b) = (points[after.saturating_sub(1)], points[after]);
    let part = if b.iterations > a.iterations {
        (iterations - a.iterations) / (b.iterations - a.iterations)
    } else {
        1.0
    };
    let between = |of: fn(&Point) -> f64| of(&a) + part * (of(&b) - of(&a));
    Point {
        iterations,
        elapsed_s: between(|point| point.elapsed_s),
        planner_s: between(|point| point.planner_s),
        waited_s: between(|point| point.waited_s),
        others_s: between(|point| point.others_s),
        memory: between(|point| point.memory),
    }
}

/// How long the answers of `/livez` took, sorted; asked for every 100 ms until `done`.
async fn livez(client: reqwest::Client, url: String, done: CancellationToken) -> Vec<Duration> {
    let mut took = Vec::new();
    while !done.is_cancelled() {
        let asked = Instant::now();
        assert_eq!(client.get(&url).send().await.unwrap().status(), 200);
        took.push(asked.elapsed());
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    took.sort();
    took
}

/// A service with one long job that runs and as many that wait as may.
async fn full_service(client: &reqwest::Client) -> (Process, String, String) {
    let limits =
        ["--workers", "1", "--queue-limit", "4", "--client-jobs", "1000", "--client-streams", "1000"];
    let process = Process::product(&limits);
    let mut long = problem("long");
    long["options"] = json!({"time_budget_s": 900.0, "threads": 1, "seed": 7});
    let long = long.to_string();
    let post = || client.post(process.url("/v1/jobs")).body(long.clone()).send();
    let first = post().await.unwrap();
    let running = first.headers()["location"].to_str().unwrap().to_owned();
    while post().await.unwrap().status() == 202 {}
    (process, running, long)
}

/// What came of a load.
struct Loaded {
    points: Vec<Point>,
    plans: Vec<(u64, f64)>,
    /// The first and the last iteration during which all streams were open and submissions came.
    span: (f64, f64),
    livez: Vec<Duration>,
    told: Value,
}

/// Runs the job while `streams` readers follow it and `submissions` are refused.
async fn under_load(client: &reqwest::Client, streams: usize, submissions: u32, pause: Duration) -> Loaded {
    let (process, job, body) = full_service(client).await;
    let asked = json!({
        "url": process.url(""), "job": job, "streams": streams, "submissions": submissions,
        "pause_s": pause.as_secs_f64(), "body": body,
    });
    let mut command = Command::new("nice");
    command.args(["-n", "19"]).arg(std::env::current_exe().unwrap());
    command.args(["--exact", "load::comes_when_it_is_asked_for", "--nocapture"]);
    let mut load = command.env(LOAD, asked.to_string()).stdout(Stdio::piped()).spawn().unwrap();
    let output = std::io::BufReader::new(load.stdout.take().unwrap());
    let (send, mut lines) = tokio::sync::mpsc::unbounded_channel();
    std::thread::spawn(move || {
        use std::io::BufRead;
        for line in output.lines().map_while(Result::ok) {
            let found =
                line.split_once("LOAD ").and_then(|(_, text)| serde_json::from_str::<Value>(text).ok());
            if found.is_some_and(|found| send.send(found).is_err()) {
                return;
            }
        }
    });
    let done = CancellationToken::new();
    let asking = tokio::spawn(livez(client.clone(), process.url("/livez"), done.clone()));
    let (mut ready, mut told, mut plans) = (false, None::<Value>, Vec::new());
    let mut span = (0.0, 0.0);
    let points = follow(&process, client, &job, &mut plans, |seen| {
        loop {
            match lines.try_recv() {
                Ok(line) if line["ready"] == true => ready = true,
                Ok(line) => told = Some(line),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    assert!(told.is_some(), "the load has broken off");
                    break;
                }
            }
        }
        let newest = seen.last().map_or(0.0, |point| point.iterations);
        if span.0 == 0.0 && ready {
            span.0 = newest;
        }
        // A load may come and go between two signs of life, or before the first that tells of an iteration: the span then
        // ends with the next.
        if told.is_none() || span.1 <= span.0 {
            span.1 = newest;
        }
        told.is_some() && span.1 > span.0
    })
    .await;
    done.cancel();
    let livez = asking.await.unwrap();
    assert!(load.wait().unwrap().success());
    Loaded { points, plans, span, livez, told: told.unwrap() }
}

/// No test: what the child process does.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn comes_when_it_is_asked_for() {
    let Ok(asked) = std::env::var(LOAD) else { return };
    let asked: Value = serde_json::from_str(&asked).unwrap();
    let text = |name: &str| asked[name].as_str().unwrap().to_owned();
    let (url, job, body) = (text("url"), text("job"), text("body"));
    let (streams, count) = (asked["streams"].as_u64().unwrap(), asked["submissions"].as_u64().unwrap());
    let client = client();
    // Every reader first gets all that has happened; the load begins when all are up to date.
    let (up_to_date, mut caught_up) = tokio::sync::mpsc::unbounded_channel();
    for _ in 0..streams {
        let (request, up_to_date) = (client.get(format!("{url}{job}/events")), up_to_date.clone());
        tokio::spawn(async move {
            let reply = request.send().await.unwrap();
            assert_eq!(reply.status(), 200);
            let (mut stream, mut waiting) = (reply.bytes_stream(), true);
            while let Some(Ok(chunk)) = stream.next().await {
                let progress = chunk.windows(16).any(|text| text == b"\"type\":\"progress");
                if progress && std::mem::replace(&mut waiting, false) {
                    up_to_date.send(()).unwrap();
                }
            }
        });
    }
    for _ in 0..streams {
        caught_up.recv().await.unwrap();
    }
    println!("LOAD {}", json!({"ready": true}));
    let mut ticks = tokio::time::interval(Duration::from_secs_f64(asked["pause_s"].as_f64().unwrap()));
    let mut posts = tokio::task::JoinSet::new();
    let began = Instant::now();
    for _ in 0..count {
        ticks.tick().await;
        posts.spawn(client.post(format!("{url}/v1/jobs")).body(body.clone()).send());
    }
    let sent = began.elapsed().as_secs_f64();
    let (mut refused, mut otherwise) = (0_u64, Vec::new());
    while let Some(reply) = posts.join_next().await {
        let reply = reply.unwrap().unwrap();
        let again =
            reply.headers().get("retry-after").and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
        match (reply.status().as_u16(), again) {
            (429, Some(1..=60)) => refused += 1,
            other => otherwise.push(format!("{other:?}")),
        }
    }
    println!("LOAD {}", json!({"refused": refused, "otherwise": otherwise, "rate": count as f64 / sent}));
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_service_refuses_and_goes_on() {
    let (rounds, streams, submissions, pause) = if soak() {
        (3, 500, 12_000, Duration::from_millis(5))
    } else {
        (1, 50, 100, Duration::from_millis(2))
    };
    let client = client();
    let mut figures = Figures::of("load");
    let (mut time, mut processor, mut waited, mut others) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut refused, mut slowest, mut rates, mut grown) =
        (0, Vec::<Duration>::new(), Vec::new(), Vec::new());
    for _ in 0..rounds {
        let loaded = under_load(&client, streams, submissions, pause).await;
        assert_eq!(
            loaded.told["otherwise"],
            json!([]),
            "every submission is refused with 429 and Retry-After"
        );
        refused += loaded.told["refused"].as_u64().unwrap();
        rates.push(loaded.told["rate"].as_f64().unwrap());
        slowest.extend(&loaded.livez);

        // The same job again, with nobody else there.
        let (first, last) = loaded.span;
        let (process, job, _) = full_service(&client).await;
        let mut plans = Vec::new();
        let quiet = follow(&process, &client, &job, &mut plans, |seen| {
            seen.last().is_some_and(|point| point.iterations >= last)
        })
        .await;
        let common = plans.len().min(loaded.plans.len());
        assert!(common > 0 && plans[..common] == loaded.plans[..common], "it is the same job");
        let [quiet, loaded] = [&quiet, &loaded.points].map(|points| {
            let (from, to) = (at(points, first), at(points, last));
            Point {
                iterations: to.iterations - from.iterations,
                elapsed_s: to.elapsed_s - from.elapsed_s,
                planner_s: to.planner_s - from.planner_s,
                waited_s: to.waited_s - from.waited_s,
                others_s: to.others_s - from.others_s,
                memory: to.memory - from.memory,
            }
        });
        println!(
            "{} iterations: {:.2} s ({:.2} s on a processor, {:.2} s waiting for one) under load, {:.2} s ({:.2}, {:.2}) without",
            loaded.iterations,
            loaded.elapsed_s,
            loaded.planner_s,
            loaded.waited_s,
            quiet.elapsed_s,
            quiet.planner_s,
            quiet.waited_s,
        );
        time.push(1.0 - quiet.elapsed_s / loaded.elapsed_s);
        processor.push(1.0 - quiet.planner_s / loaded.planner_s);
        others.push(loaded.others_s / loaded.elapsed_s);
        waited.push((loaded.waited_s / loaded.elapsed_s, quiet.waited_s / quiet.elapsed_s));
        grown.push((loaded.memory - quiet.memory).max(0.0));
    }
    slowest.sort();
    let ms = |part: f64| {
        let index = ((slowest.len() as f64 * part) as usize).min(slowest.len() - 1);
        slowest[index].as_secs_f64() * 1e3
    };
    let (rate, grown) = (median(rates), grown.into_iter().fold(0.0, f64::max));
    let percent = |values: &[f64]| {
        values.iter().map(|value| format!("{:.1}", 100.0 * value)).collect::<Vec<_>>().join(", ")
    };
    figures.note("streams", streams.to_string());
    figures.note("submissions refused with 429 and Retry-After", format!("all {refused}"));
    figures.mark("submissions", format!("{rate:.0}/s"), "200/s within 5 %", rate > 190.0);
    // The short form runs beside other tests, which delay an answer now and then.
    let (mark, judged) =
        if soak() { ("all within 100 ms", ms(1.0)) } else { ("99 of 100 within 100 ms", ms(0.99)) };
    figures.mark(
        "/livez",
        format!("99 of 100 within {:.1} ms, all within {:.1}", ms(0.99), ms(1.0)),
        mark,
        judged < 100.0,
    );
    figures.mark(
        "memory beyond what the job itself grows by",
        format!("{:.1} MB", grown / 1e6),
        "64 MB",
        grown < f64::from(64 << 20),
    );
    figures.mark(
        "more planner processor time for the same iterations",
        format!("{} % (median {:.1} %)", percent(&processor), 100.0 * median(processor.clone())),
        "10 %",
        median(processor.clone()) < 0.1,
    );
    // Without the load the planner must have had a processor whenever it wanted one, or others have blurred the comparison.
    let undisturbed = waited.iter().all(|(_, quiet)| *quiet < 0.05);
    let lost = format!("{} % (median {:.1} %)", percent(&time), 100.0 * median(time.clone()));
    if undisturbed {
        figures.mark("iterations lost in the same time", lost, "10 %", median(time.clone()) < 0.1);
    } else {
        figures
            .note("iterations lost in the same time, not judged: the machine is busy with other work", lost);
    }
    let waits: Vec<String> =
        waited.iter().map(|(l, q)| format!("{:.0}/{:.0}", 100.0 * l, 100.0 * q)).collect();
    figures.note("planner ready but without a processor, loaded/quiet", format!("{} %", waits.join(", ")));
    figures.note("of a processor, all else in the service under load", format!("{} %", percent(&others)));
    figures.finish();
    assert!(grown < f64::from(256 << 20), "memory grows: {grown}");
}
