//! The command line as a user meets it: output, faults, exit codes.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

fn quadrille(arguments: &[&str]) -> Output {
    command(arguments).output().unwrap()
}

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_quadrille"));
    command.args(arguments).stdin(Stdio::null());
    for variable in ["QUADRILLE_LISTEN", "QUADRILLE_WORKERS", "QUADRILLE_QUEUE_LIMIT", "QUADRILLE_LOG_FORMAT"]
    {
        command.env_remove(variable);
    }
    command
}

fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn err(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn generate(folder: &Path, file: &str, seed: &str) -> String {
    let path = folder.join(file).to_str().unwrap().to_owned();
    let output = quadrille(&[
        "scenario",
        "generate",
        "--family",
        "switch",
        "--arms",
        "2",
        "--objects",
        "2",
        "--seed",
        seed,
        "--out",
        &path,
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", err(&output));
    path
}

/// A change to the generated problem, written to a file of its own.
fn changed(problem: &str, file: &str, change: impl FnOnce(&mut Value)) -> String {
    let mut document: Value = serde_json::from_str(&fs::read_to_string(problem).unwrap()).unwrap();
    change(&mut document);
    let path = Path::new(problem).with_file_name(file);
    fs::write(&path, document.to_string()).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn scenarios_are_the_same_for_the_same_seed_and_differ_for_another() {
    let folder = tempfile::tempdir().unwrap();
    let read = |file: &str, seed: &str| fs::read(generate(folder.path(), file, seed)).unwrap();
    assert_eq!(read("a", "7"), read("b", "7"));
    assert_ne!(read("a", "7"), read("c", "8"));
    let to_stdout = quadrille(&[
        "scenario",
        "generate",
        "--family",
        "switch",
        "--arms",
        "2",
        "--objects",
        "2",
        "--seed",
        "7",
    ]);
    assert_eq!(to_stdout.stdout, read("a", "7"));
    let shipped = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/switch/2x2.json")).unwrap();
    assert_eq!(read("d", "0"), shipped, "the file that ships is seed 0");
    let list = quadrille(&["scenario", "list"]);
    assert!(out(&list).lines().any(|name| name == "in_place_swap/1x2"));
    let refused = quadrille(&["scenario", "generate", "--family", "waltz", "--arms", "2", "--objects", "2"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(err(&refused).contains("waltz"));
}

#[test]
fn faults_are_printed_with_pointer_code_and_message() {
    let folder = tempfile::tempdir().unwrap();
    let problem = generate(folder.path(), "problem.json", "1");
    let bad = changed(&problem, "bad.json", |document| {
        document["colour"] = "red".into();
        document["workcell"]["arms"][0]["robot"] = "iiwa99".into();
    });
    for output in [quadrille(&["plan", &bad]), quadrille(&["verify", &bad, &bad])] {
        assert_eq!(output.status.code(), Some(2));
        assert!(output.stdout.is_empty());
        let text = err(&output);
        assert!(text.lines().any(|line| line.trim().starts_with("/colour: unknown_field: ")), "{text}");
        assert!(text.contains("/workcell/arms/0/robot: unknown_robot: "), "{text}");
    }
    for arguments in
        [&["plan", "no-such-file.json"][..], &["plan"], &["dance"], &["plan", &problem, "--budget", "0"]]
    {
        let output = quadrille(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty());
    }
}

#[test]
fn files_beside_the_problem_are_read_and_others_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let problem = generate(folder.path(), "problem.json", "1");
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/robots");
    fs::create_dir(folder.path().join("robots")).unwrap();
    for file in ["iiwa14.urdf", "iiwa14.srdf"] {
        fs::copy(robots.join(file), folder.path().join("robots").join(file)).unwrap();
    }
    let robot = |urdf: &str| serde_json::json!({ "urdf": urdf, "srdf": "robots/iiwa14.srdf" });
    let beside = changed(&problem, "beside.json", |document| {
        document["workcell"]["robots"]["iiwa14"] = robot("robots/iiwa14.urdf");
    });
    let outside = changed(&problem, "outside.json", |document| {
        document["workcell"]["robots"]["iiwa14"] = robot("../../etc/passwd");
    });
    // An unusable plan gets us past the reading of the problem, and no further.
    let plan = folder.path().join("plan.json");
    fs::write(&plan, "{}").unwrap();
    let text = err(&quadrille(&["verify", &beside, plan.to_str().unwrap()]));
    assert!(text.contains("plan.json") && !text.contains("iiwa14"), "{text}");
    let text = err(&quadrille(&["verify", &outside, plan.to_str().unwrap()]));
    assert!(text.contains("unresolved_uri"), "{text}");
}

#[test]
fn plans_that_cannot_be_read_are_unusable() {
    let folder = tempfile::tempdir().unwrap();
    let problem = generate(folder.path(), "problem.json", "1");
    for text in ["", "{", "[]", r#"{"schema": "quadrille.plan/1"}"#, r#"{"schema": "quadrille.plan/9"}"#] {
        let plan = folder.path().join("plan.json");
        fs::write(&plan, text).unwrap();
        let output = quadrille(&["verify", &problem, plan.to_str().unwrap(), "--json"]);
        assert_eq!(output.status.code(), Some(2), "{text}");
    }
}

/// A service on a free port; killed when dropped.
struct Service(Child);

impl Drop for Service {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
#[cfg(unix)]
fn the_service_says_where_it_listens_and_ends_on_sigterm() {
    let mut serve = command(&["serve", "--listen", "127.0.0.1:0", "--log-format", "json"]);
    let mut service = Service(serve.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let mut line = String::new();
    BufReader::new(service.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().strip_prefix("listening on ").unwrap().to_owned();
    assert_eq!(quadrille(&["health", "--address", &address]).status.code(), Some(0));
    let killed = Command::new("kill").args(["-TERM", &service.0.id().to_string()]).status().unwrap();
    assert!(killed.success());
    assert!(service.0.wait().unwrap().success());
    assert_eq!(quadrille(&["health", "--address", &address]).status.code(), Some(1));
    let log = std::io::read_to_string(service.0.stderr.take().unwrap()).unwrap();
    let entries: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(entries.iter().any(|entry| entry["fields"]["message"] == "stopped"), "{log}");
}

/// What keeps the service from starting is said before it says that it listens.
#[test]
fn a_service_that_cannot_start_says_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::write(path("file"), "").unwrap();
    fs::create_dir(path("junk")).unwrap();
    fs::write(path("junk/quadrille.redb"), "no database").unwrap();
    fs::write(path("settings.toml"), "colour = 1").unwrap();
    let mut held = command(&["serve", "--listen", "127.0.0.1:0", "--data-dir", &path("held")]);
    let mut held = Service(held.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let mut line = String::new();
    BufReader::new(held.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let taken = line.trim().strip_prefix("listening on ").unwrap().to_owned();
    for (flags, told) in [
        (["--data-dir", &path("file")], &*path("file")),
        (["--data-dir", &path("junk")], "quadrille.redb"),
        (["--data-dir", &path("held")], "another process"),
        (["--listen", &taken], &*taken),
        (["--listen", "localhost"], "127.0.0.1:8080"),
        (["--config", &path("settings.toml")], "colour"),
        (["--config", &path("nowhere.toml")], "nowhere.toml"),
        (["--max-body-bytes", "0"], "max-body-bytes"),
        (["--keep-alive", "soon"], "10s"),
    ] {
        let mut arguments = vec!["serve"];
        if flags[0] != "--listen" {
            arguments.extend(["--listen", "127.0.0.1:0"]);
        }
        arguments.extend(flags);
        let output = quadrille(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(err(&output).contains(told), "{told} in {}", err(&output));
        assert_eq!(out(&output), "", "{arguments:?}");
    }
    assert_eq!(quadrille(&["verify", "-", "-"]).status.code(), Some(2));
}
