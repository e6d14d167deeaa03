//! From a problem to a judged plan with the real planner: by the command line and through the service.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use serde_json::{Value, json};

fn quadrille(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_quadrille")).args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn scenario(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(format!("{name}.json"));
    path.to_str().unwrap().to_owned()
}

/// The file that ships, to be solved once within a generous budget.
fn first_solution(name: &str) -> Value {
    let mut problem: Value = serde_json::from_str(&fs::read_to_string(scenario(name)).unwrap()).unwrap();
    problem["options"]["time_budget_s"] = json!(120.0);
    problem["options"]["stop"] = json!({ "first_solution": true });
    problem
}

#[test]
fn the_command_line_plans_and_the_judge_agrees() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (problem, plan) = (scenario("switch/2x2"), file("plan.json"));
    let planned = quadrille(&["plan", &problem, "--budget", "2m", "--first-solution", "--out", &plan]);
    let lines = String::from_utf8(planned.stderr).unwrap();
    assert_eq!(planned.status.code(), Some(0), "{lines}");
    let line = lines.lines().find(|line| line.starts_with("found_after_s=")).unwrap();
    assert!(line.contains(" steps=6/6") && line.contains(" duration_s="), "{line}");

    let judged = quadrille(&["verify", &problem, &plan, "--json"]);
    let verdict: Value = serde_json::from_slice(&judged.stdout).unwrap();
    assert_eq!((judged.status.code(), &verdict["valid"]), (Some(0), &json!(true)), "{verdict}");

    // The same plan does not solve the problem whose goals are the other way round.
    let mut other: Value = serde_json::from_str(&fs::read_to_string(&problem).unwrap()).unwrap();
    other["goal"] = other["initial"].clone();
    fs::write(file("other.json"), other.to_string()).unwrap();
    let judged = quadrille(&["verify", &file("other.json"), &plan]);
    assert_eq!(judged.status.code(), Some(1));
    assert!(String::from_utf8(judged.stdout).unwrap().starts_with("invalid"));
}

#[test]
fn swaps_in_place_take_the_steps_of_the_mode_graph() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (fewest, plan) = (file("fewest.json"), file("plan.json"));
    for (name, steps) in [("in_place_swap/1x2", 6), ("in_place_swap/2x2", 6), ("in_place_swap/3x2", 8)] {
        // Within the budget that ships, at an end as soon as no plan can have fewer steps.
        let mut problem: Value = serde_json::from_str(&fs::read_to_string(scenario(name)).unwrap()).unwrap();
        problem["options"]["objective"] = json!("steps");
        fs::write(&fewest, problem.to_string()).unwrap();
        let planned = quadrille(&["plan", &fewest, "--out", &plan]);
        let lines = String::from_utf8(planned.stderr).unwrap();
        assert_eq!(planned.status.code(), Some(0), "{name}: {lines}");
        let written: Value = serde_json::from_str(&fs::read_to_string(&plan).unwrap()).unwrap();
        for figure in ["steps", "mode_graph_optimum", "steps_lower_bound"] {
            assert_eq!(written["metrics"][figure], json!(steps), "{name}: {figure}");
        }
        let judged = quadrille(&["verify", &scenario(name), &plan]);
        assert_eq!(judged.status.code(), Some(0), "{name}");
    }
}

/// In these two the order in which the arms trade decides whether the second cube can still be
/// gripped: what stands beside it is foreseen, and the steps stay six.
#[test]
fn the_order_is_chosen_so_that_grasps_stay_free() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for seed in ["13", "14"] {
        let (problem, plan) = (file("problem.json"), file("plan.json"));
        let sizes = ["--family", "switch", "--arms", "2", "--objects", "2"];
        let generate = [&["scenario", "generate"][..], &sizes, &["--seed", seed, "--out", &problem]].concat();
        assert_eq!(quadrille(&generate).status.code(), Some(0));
        let planned = quadrille(&["plan", &problem, "--budget", "2m", "--first-solution", "--out", &plan]);
        let lines = String::from_utf8(planned.stderr).unwrap();
        assert!(lines.contains(" steps=6/6 "), "seed {seed}: {lines}");
        assert_eq!(quadrille(&["verify", &problem, &plan]).status.code(), Some(0));
    }
}

#[test]
fn arms_of_all_kinds_work_together() {
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.json").to_str().unwrap().to_owned();
    for name in ["switch_ur_type/2x2", "switch_mixed/3x2"] {
        let problem = scenario(name);
        let planned = quadrille(&["plan", &problem, "--budget", "2m", "--first-solution", "--out", &plan]);
        let lines = String::from_utf8(planned.stderr).unwrap();
        assert_eq!(planned.status.code(), Some(0), "{name}: {lines}");
        assert_eq!(quadrille(&["verify", &problem, &plan]).status.code(), Some(0), "{name}");
    }
}

/// The plan that was printed, without the one figure that is a time of day.
fn timeless(planned: Output) -> String {
    assert_eq!(planned.status.code(), Some(0), "{}", String::from_utf8_lossy(&planned.stderr));
    let text = String::from_utf8(planned.stdout).unwrap();
    let (before, after) = text.split_once("\"found_after_s\":").unwrap();
    let rest = after.trim_start_matches(|c: char| c.is_ascii_digit() || "+-.e".contains(c));
    format!("{before}{rest}")
}

#[test]
fn a_rerun_by_iterations_is_the_same_bytes() {
    let arguments = ["plan", &scenario("switch/2x2"), "--budget", "5m", "--max-iterations", "25"];
    assert_eq!(timeless(quadrille(&arguments)), timeless(quadrille(&arguments)));
}

#[test]
#[cfg(unix)]
fn processes_share_a_folder_of_compiled_workcells() {
    use std::os::unix::fs::MetadataExt as _;

    let folder = tempfile::tempdir().unwrap();
    let cells = folder.path().join("cells");
    let problem = scenario("switch/2x2");
    let alone = ["plan", &problem, "--budget", "5m", "--max-iterations", "10"];
    let sharing = [&alone[..], &["--cache-dir", cells.to_str().unwrap()]].concat();
    let expected = timeless(quadrille(&alone));
    // Two that write at the same time, one that reads, one that finds what was cut short.
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_quadrille"));
        command.args(&sharing).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command.spawn().unwrap()
    };
    for process in [start(), start()] {
        assert_eq!(timeless(process.wait_with_output().unwrap()), expected);
    }
    let files = || fs::read_dir(&cells).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>();
    let [file] = &files()[..] else { panic!("{:?}", files()) };
    assert_eq!(file.extension().unwrap(), "workcell");
    let whole = fs::read(file).unwrap();
    // What is read stays; what cannot be read is made anew, and put in its place as another file.
    let inode = || fs::metadata(file).unwrap().ino();
    let before = inode();
    assert_eq!(timeless(quadrille(&sharing)), expected);
    assert_eq!(inode(), before, "it was not read");
    fs::write(file, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(timeless(quadrille(&sharing)), expected);
    assert_ne!(inode(), before, "it was not written anew");
    assert_eq!(fs::metadata(file).unwrap().len(), whole.len() as u64, "it was not written anew");
}

#[test]
fn goals_that_are_met_already_take_a_plan_that_stands_still() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let mut problem: Value =
        serde_json::from_str(&fs::read_to_string(scenario("switch/2x2")).unwrap()).unwrap();
    problem["goal"] = problem["initial"].clone();
    fs::write(file("problem.json"), problem.to_string()).unwrap();
    let planned = quadrille(&["plan", &file("problem.json"), "--budget", "1m", "--out", &file("plan.json")]);
    assert_eq!(planned.status.code(), Some(0), "{}", String::from_utf8_lossy(&planned.stderr));
    let judged = quadrille(&["verify", &file("problem.json"), &file("plan.json")]);
    assert_eq!(judged.status.code(), Some(0), "{}", String::from_utf8_lossy(&judged.stdout));
}

#[test]
fn the_evaluation_writes_what_it_measured() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("results").to_str().unwrap().to_owned();
    let paper = |more: &[&str]| {
        let arguments =
            ["bench", "paper", "--trials", "1", "--families", "switch,in_place_swap", "--sizes", "2x2"];
        quadrille(&[&arguments[..], &["--budget", "1s", "--guidance", "smart", "--out", &out], more].concat())
    };
    let measured = paper(&[]);
    let lines = String::from_utf8(measured.stderr).unwrap();
    assert_eq!(measured.status.code(), Some(0), "{lines}");
    for case in ["switch/2x2 smart: ", "in_place_swap/2x2 smart: "] {
        assert!(lines.lines().any(|line| line.starts_with(case) && line.contains("/1 solved")), "{lines}");
    }
    let read = |name: &str| fs::read_to_string(Path::new(&out).join(name)).unwrap();
    let results: Value = serde_json::from_str(&read("results.json")).unwrap();
    assert_eq!(results["runs"].as_array().unwrap().len(), 2);
    assert_eq!(results["setup"]["budget_s"], 1.0);
    assert_eq!(read("results.csv").lines().count(), 3);
    assert!(read("report.html").contains("</html>"));
    // Going on with complete results adds nothing; with other arguments they do not fit.
    assert_eq!(paper(&["--resume"]).status.code(), Some(0));
    assert_eq!(serde_json::from_str::<Value>(&read("results.json")).unwrap()["runs"], results["runs"]);
    let other = paper(&["--resume", "--threads", "2"]);
    assert_eq!(other.status.code(), Some(2));
    let compared = quadrille(&["bench", "compare", &out, &format!("{out}/results.json")]);
    let table = String::from_utf8(compared.stdout).unwrap();
    assert_eq!(compared.status.code(), Some(0));
    assert!(table.contains("switch/2x2 smart") && table.contains("0 better in B, 0 worse"), "{table}");
    let missing = quadrille(&["bench", "compare", &out, "no-such-folder"]);
    assert_eq!(missing.status.code(), Some(2));
}

/// The service as a process of its own, with one planner thread; killed when dropped.
struct Service {
    process: Child,
    url: String,
}

impl Drop for Service {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Service {
    fn start() -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_quadrille"))
            .args(["serve", "--listen", "127.0.0.1:0", "--workers", "1"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = format!("http://{}", line.trim().strip_prefix("listening on ").unwrap());
        Self { process, url }
    }
}

async fn post(url: String, body: &Value) -> reqwest::Response {
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    client.post(url).header("content-type", "application/json").body(body.to_string()).send().await.unwrap()
}

#[tokio::test]
async fn the_service_streams_plans_that_the_judge_accepts() {
    let service = Service::start();
    let problem = first_solution("switch/2x2");
    let reply = post(format!("{}/v1/plan", service.url), &problem).await;
    assert_eq!(reply.status(), 200);
    let text = reply.text().await.unwrap();
    let events: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let terminal = events.last().unwrap();
    assert_eq!(terminal["termination_reason"], "FIRST_SOLUTION", "{terminal}");
    let incumbent = events.iter().find(|event| event["type"] == "incumbent").unwrap();
    assert_eq!(incumbent["plan"]["verification"]["valid"], true);
    assert_eq!(terminal["metrics"], incumbent["metrics"]);
    let body = json!({ "problem": problem, "plan": incumbent["plan"] });
    let verdict: Value = post(format!("{}/v1/verify", service.url), &body).await.json().await.unwrap();
    assert_eq!(verdict["valid"], true, "{verdict}");
}

#[tokio::test]
async fn a_cancelled_planner_makes_room_for_the_next_job() {
    let service = Service::start();
    let mut long: Value = serde_json::from_str(&fs::read_to_string(scenario("switch/2x2")).unwrap()).unwrap();
    long["options"]["time_budget_s"] = json!(3600.0);
    let jobs = format!("{}/v1/jobs", service.url);
    let first: Value = post(jobs.clone(), &long).await.json().await.unwrap();
    let second: Value = post(jobs.clone(), &long).await.json().await.unwrap();
    let id = |job: &Value| job["id"].as_str().unwrap().to_owned();
    assert_eq!(second["queue_position"], 1);
    post(format!("{jobs}/{}/cancel", id(&first)), &json!(null)).await;
    let client = reqwest::Client::builder().no_proxy().build().unwrap();
    let mut events = client.get(format!("{jobs}/{}/events", id(&second))).send().await.unwrap();
    let mut text = String::new();
    while !text.contains("\"type\":\"started\"") {
        text.push_str(std::str::from_utf8(&events.chunk().await.unwrap().unwrap()).unwrap());
    }
    post(format!("{jobs}/{}/cancel", id(&second)), &json!(null)).await;
    let record: Value =
        client.get(format!("{jobs}/{}", id(&first))).send().await.unwrap().json().await.unwrap();
    assert_eq!(record["state"], "CANCELLED");
}
