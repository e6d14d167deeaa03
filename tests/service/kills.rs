//! `kill -9` at random moments under load: nothing that was accepted or published is lost.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures::StreamExt;
use quadrille::run::Seed;
use rand::Rng;
use serde_json::Value;

use crate::figures::Figures;
use crate::process::{PATIENCE, Process, soak};
use crate::script::problem;

/// What clients have been told so far.
#[derive(Default)]
struct Told {
    /// Jobs that were accepted.
    jobs: Vec<String>,
    /// Durable events by job and number.
    events: BTreeMap<(String, u64), Value>,
    /// Events that disagreed with one seen before.
    conflicts: Vec<String>,
}

impl Told {
    fn note(&mut self, job: &str, event: Value) {
        if event["type"] == "progress" {
            return;
        }
        let number = event["seq"].as_u64().unwrap();
        // Conflation belongs to a delivery, not to the event.
        let mut event = event;
        event.as_object_mut().unwrap().remove("skipped");
        match self.events.get(&(job.to_owned(), number)) {
            Some(before) if *before != event => self.conflicts.push(format!("{before}\n{event}")),
            _ => {
                self.events.insert((job.to_owned(), number), event);
            }
        }
    }
}

/// Submits jobs, and follows each from the start, until the service is `gone`.
async fn use_service(url: String, told: Arc<Mutex<Told>>, gone: Arc<AtomicBool>, name: String) {
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let body = problem(&name).to_string();
    while !gone.load(Ordering::Relaxed) {
        let request = client.post(format!("{url}/v1/jobs")).header("content-type", "application/json");
        let reply = match request.body(body.clone()).send().await {
            Ok(reply) if reply.status() == 202 => reply,
            _ => {
                tokio::time::sleep(Duration::from_millis(5)).await;
                continue;
            }
        };
        let job = reply.headers()["location"].to_str().unwrap().to_owned();
        told.lock().unwrap().jobs.push(job.clone());
        follow(&client, &url, &job, &told).await;
    }
}

async fn follow(client: &reqwest::Client, url: &str, job: &str, told: &Mutex<Told>) {
    let Ok(reply) = client.get(format!("{url}{job}/events")).send().await else { return };
    let (mut stream, mut text) = (reply.bytes_stream(), Vec::new());
    while let Some(Ok(chunk)) = stream.next().await {
        text.extend_from_slice(&chunk);
        while let Some(end) = text.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = text.drain(..=end).collect();
            told.lock().unwrap().note(job, serde_json::from_slice(&line).unwrap());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_that_was_told_is_lost() {
    let kills = if soak() { 200 } else { 20 };
    let folder = tempfile::tempdir().unwrap();
    let told = Arc::new(Mutex::new(Told::default()));
    let mut rng = Seed(11).stream("kills");
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let began = Instant::now();
    for _ in 0..kills {
        let mut process = Process::start(folder.path());
        let before = told.lock().unwrap().events.len();
        let gone = Arc::new(AtomicBool::new(false));
        let users: Vec<_> = ["steps 8 3", "steps 3 10", "improve 2", "nothing"]
            .map(|name| use_service(process.url(""), Arc::clone(&told), Arc::clone(&gone), name.to_owned()))
            .map(tokio::spawn)
            .into();
        // One that takes up old jobs again.
        let old: Vec<String> = told.lock().unwrap().jobs.iter().rev().take(3).cloned().collect();
        for job in &old {
            let (client, told) = (client.clone(), Arc::clone(&told));
            let (url, job) = (process.url(""), job.clone());
            tokio::spawn(async move { follow(&client, &url, &job, &told).await });
        }
        // At a random moment, and after something was told, however busy the machine is; now and then
        // at once.
        let at_once = rng.random_bool(0.1);
        let started = Instant::now();
        while !at_once && told.lock().unwrap().events.len() == before {
            assert!(!process.has_ended(), "the service has ended by itself: {}", process.last_words());
            assert!(started.elapsed() < PATIENCE, "the service tells nothing");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        tokio::time::sleep(Duration::from_millis(rng.random_range(0..200))).await;
        gone.store(true, Ordering::Relaxed);
        process.kill();
        for user in users {
            tokio::time::timeout(PATIENCE, user).await.expect("streams of a killed service end").unwrap();
        }
    }
    let process = Process::start(folder.path());
    let jobs = told.lock().unwrap().jobs.clone();
    let (mut lost_workers, mut incumbents) = (0, 0);
    for job in &jobs {
        let events = tokio::time::timeout(PATIENCE, process.durable(&client, job)).await;
        let events = events.unwrap_or_else(|_| panic!("{job} does not end"));
        let seqs: Vec<u64> = events.iter().filter_map(|event| event["seq"].as_u64()).collect();
        assert_eq!(seqs, (1..=seqs.len() as u64).collect::<Vec<_>>(), "{job}");
        let ends: Vec<&Value> = events.iter().filter(|event| event["type"] == "terminal").collect();
        assert!(ends.len() == 1 && events.last() == Some(ends[0]), "{job}: {} ends", ends.len());
        lost_workers += usize::from(ends[0]["termination_reason"] == "WORKER_LOST");
        let plans: Vec<(u64, f64)> = events
            .iter()
            .filter(|event| event["type"] == "incumbent")
            .map(|event| {
                (event["revision"].as_u64().unwrap(), event["metrics"]["duration_s"].as_f64().unwrap())
            })
            .collect();
        assert!(
            plans.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 > pair[1].1),
            "{job}: {plans:?}"
        );
        incumbents += plans.len();
        let mut told = told.lock().unwrap();
        let last = seqs.len() as u64;
        let lost = told.events.keys().find(|(of, seq)| of == job && *seq > last);
        assert!(lost.is_none(), "{lost:?} is not there, {last} are");
        events.into_iter().for_each(|event| told.note(job, event));
    }
    let told = told.lock().unwrap();
    assert!(told.conflicts.is_empty(), "{}", told.conflicts.join("\n"));
    // Every event that anyone has ever seen is among those that are there.
    for (job, seq) in told.events.keys() {
        assert!(jobs.contains(job), "{job} {seq}");
    }
    let figures = Figures::of("kills");
    figures.note("`kill -9` under load", format!("{kills} in {:.0} s", began.elapsed().as_secs_f64()));
    figures.note("jobs accepted, each with one end", format!("{}, none lost", jobs.len()));
    figures.note("events seen, all still there under their numbers", told.events.len().to_string());
    figures.note("plans kept, each better than the one before", incumbents.to_string());
    figures.note("jobs given up after three lost processes", lost_workers.to_string());
    assert!(!jobs.is_empty() && incumbents > 0);
}
