//! Clients that share no code with the service: Python's standard library, grpcio through reflection,
//! schemathesis. The latter two are installed by pip into a virtual environment below `target/`.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use serde_json::{Value, json};

use crate::figures::Figures;
use crate::process::soak;
use crate::script::problem;
use crate::server::Server;

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn told(output: &Output) -> String {
    format!("{}\n{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// Runs a command while the service goes on in this process.
async fn run(mut command: Command) -> Output {
    tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

/// The Python of a virtual environment that has what `tests/foreign/requirements.txt` lists; `None` when
/// pip reaches no registry.
fn python() -> Option<&'static Path> {
    static PYTHON: OnceLock<Option<PathBuf>> = OnceLock::new();
    let python = PYTHON.get_or_init(install).as_deref();
    assert!(python.is_some() || !soak(), "the long form needs the foreign clients");
    python
}

fn install() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("foreign-clients");
    let python = folder.join("bin/python");
    let wanted = std::fs::read_to_string(here("tests/foreign/requirements.txt")).unwrap();
    let mark = folder.join("installed.txt");
    if std::fs::read_to_string(&mark).is_ok_and(|installed| installed == wanted) {
        return Some(python);
    }
    let made = Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder).output();
    let made = made.expect("python3 is needed for the tests of foreign clients");
    if !made.status.success() {
        // Debian keeps venv in a package of its own.
        eprintln!("SKIPPED foreign clients: python3 -m venv failed: {}", told(&made));
        return None;
    }
    let mut pip = Command::new(&python);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"]);
    let installed = pip.arg(here("tests/foreign/requirements.txt")).output().unwrap();
    if !installed.status.success() {
        eprintln!("SKIPPED foreign clients: pip cannot install them: {}", told(&installed));
        return None;
    }
    std::fs::write(mark, wanted).unwrap();
    Some(python)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_python_example_posts_streams_and_saves() {
    let server = Server::start(1, 8).await;
    let folder = tempfile::tempdir().unwrap();
    let (asked, saved) = (folder.path().join("problem.json"), folder.path().join("plan.json"));
    std::fs::write(&asked, problem("improve 3").to_string()).unwrap();
    let mut command = Command::new("python3");
    command.arg(here("api/examples/plan.py")).arg(server.url("")).args([&asked, &saved]);
    let output = run(command).await;
    assert!(output.status.success(), "{}", told(&output));
    let printed = String::from_utf8(output.stdout).unwrap();
    assert_eq!(printed.lines().filter(|line| line.starts_with("plan ")).count(), 3);
    assert!(printed.ends_with("SUCCEEDED TIME_LIMIT\n"), "{printed}");
    let plan: Value = serde_json::from_slice(&std::fs::read(&saved).unwrap()).unwrap();
    assert_eq!(plan["revision"], 3);
    // It says so when there is no plan.
    std::fs::write(&asked, problem("nothing").to_string()).unwrap();
    let mut command = Command::new("python3");
    command.arg(here("api/examples/plan.py")).arg(server.url("")).args([&asked, &saved]);
    assert!(!run(command).await.status.success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_grpc_client_of_another_make_runs_a_whole_job() {
    let Some(python) = python() else { return };
    let server = Server::start(1, 8).await;
    let folder = tempfile::tempdir().unwrap();
    let asked = folder.path().join("problem.json");
    std::fs::write(&asked, problem("improve 3").to_string()).unwrap();
    let mut command = Command::new(python);
    command.arg(here("tests/foreign/grpc_client.py")).arg(server.address.to_string()).arg(&asked);
    let output = run(command).await;
    assert!(output.status.success(), "{}", told(&output));
    Figures::of("clients").note("grpcio, through reflection alone", "a whole job and every other operation");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn schemathesis_finds_no_fault() {
    let Some(python) = python() else { return };
    let server = Server::with(|config| {
        config.jobs.workers = 2;
        config.jobs.queue_limit = 1000;
        config.jobs.client_limit = 1000;
    })
    .await;
    // Something to be found by.
    let job = server.create("improve 2").await;
    server.until(&job, "terminal").await;
    let cell = server.client.put(server.url("/v1/workcells/cell")).json(&problem("x")["workcell"]);
    assert_eq!(cell.send().await.unwrap().status(), 201);
    let settings = tempfile::tempdir().unwrap();
    std::fs::write(settings.path().join("schemathesis.toml"), "").unwrap();
    let mut command = Command::new(python);
    command
        .current_dir(settings.path())
        .args(["-m", "schemathesis.cli", "run", &server.url("/openapi.json")])
        .args(["--checks", "not_a_server_error,status_code_conformance,content_type_conformance"])
        .args(["--checks", "response_schema_conformance"])
        .args(["--max-examples", if soak() { "50" } else { "2" }, "--seed", "1", "--no-color"])
        .args(["--request-timeout", "30", "--phases", "examples,fuzzing"])
        // How quickly it finds what to send is no matter of the service.
        .args(["--suppress-health-check", "filter_too_much,too_slow"]);
    let output = run(command).await;
    assert!(output.status.success(), "{}", told(&output));
    assert_eq!(server.json("/livez").await, json!({"status": "ok"}));
    let report = String::from_utf8_lossy(&output.stdout);
    let line = |word: &str| report.lines().rev().find(|line| line.contains(word)).map(str::trim);
    let cases = line("generated").unwrap_or("no count of cases").to_owned();
    Figures::of("clients").note("schemathesis: no 5xx, no reply outside the schema", cases);
}
