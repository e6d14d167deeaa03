//! The command line as a user meets it: output, faults, exit codes.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use quadrille::geometry::{Pose, pose_from_parts};
use quadrille::problem::Problem;
use quadrille::wire::{LibraryOnly, ReadLimits, read_problem};
use quadrille::workcell::Arm;
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
        document["workcell"]["robots"]["iiwa14"] = robot("robots/../robots/iiwa14.urdf");
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

fn scenario(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(format!("{name}.json"));
    path.to_str().unwrap().to_owned()
}

fn modes(name: &str, flags: &[&str]) -> String {
    let output = quadrille(&[&["modes", &scenario(name)], flags].concat());
    assert_eq!(output.status.code(), Some(0), "{name}: {}", err(&output));
    out(&output)
}

/// Small cells, of one kind of arm and of all kinds.
const CELLS: [&str; 4] = ["switch/2x2", "switch_mixed/3x2", "random/4x4", "in_place_swap/3x2"];

fn pose(value: &Value) -> Pose {
    let number = |part: &str, axis: &str| value[part][axis].as_f64().unwrap();
    let at = ["x", "y", "z"].map(|axis| number("position", axis));
    pose_from_parts(at, ["x", "y", "z", "w"].map(|axis| number("orientation", axis)))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

fn is_near(a: &Pose, b: &Pose) -> bool {
    let off = a.inverse() * b;
    off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-3
}

/// A mode graph as a JSON document, with the problem that it belongs to.
struct Modes {
    problem: Problem,
    graph: Value,
}

impl Modes {
    fn of(name: &str) -> Self {
        let text = fs::read(scenario(name)).unwrap();
        let problem = read_problem(&text, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
        Self { problem, graph: serde_json::from_str(&modes(name, &["--json"])).unwrap() }
    }

    fn list(&self, name: &str) -> &[Value] {
        self.graph[name].as_array().unwrap()
    }

    /// The arm that a node stands for, if it does.
    fn arm(&self, node: &Value) -> Option<&Arm> {
        let place = &self.list("nodes")[node.as_u64().unwrap() as usize]["place"];
        (place["kind"] == "arm").then(|| self.named(&place["arm"]))
    }

    fn named(&self, id: &Value) -> &Arm {
        self.problem.workcell.arms.iter().find(|arm| arm.id == id.as_str().unwrap()).unwrap()
    }

    /// A region's or slot's own surface, and a pose on it that is exactly prescribed.
    fn ground(&self, node: &Value) -> (Value, Option<Pose>) {
        let place = &self.list("nodes")[node.as_u64().unwrap() as usize]["place"];
        match place["kind"].as_str() {
            Some("slot") => (place["slot"]["surface"].clone(), Some(pose(&place["slot"]["pose"]))),
            _ => (place["surface"].clone(), None),
        }
    }

    /// Whether an object with its middle here lies on the surface.
    fn lies_on(&self, surface: &Value, at: &Pose) -> bool {
        let surface =
            self.problem.workcell.surfaces.iter().find(|s| s.id == surface.as_str().unwrap()).unwrap();
        let at = (surface.pose.inverse() * at).translation.vector;
        let [x, y] = surface.half_extents;
        // Cubes of 6 cm.
        at.x.abs() <= x && at.y.abs() <= y && (at.z - 0.03).abs() < 2e-3
    }

    /// Where the tool of an arm in these joints has an object that it holds so.
    fn in_hand(arm: &Arm, q: &Value, object_in_tcp: &Value) -> Pose {
        let q = numbers(q);
        assert_eq!(q.len(), arm.model.dof());
        arm.tcp_pose(&q) * pose(object_in_tcp)
    }
}

#[test]
fn mode_graphs_say_who_reaches_what_and_why() {
    for name in CELLS {
        let modes = Modes::of(name);
        assert_eq!(modes.graph["complete"], true, "{name}");
        let (nodes, edges) = (modes.list("nodes"), modes.list("edges"));
        let leads = |from: usize, to: usize| edges.iter().any(|e| e["from"] == from && e["to"] == to);
        let mut regions = 0;
        for (index, node) in nodes.iter().enumerate() {
            let (place, why) = (&node["place"], node["why"].as_str().unwrap());
            assert!(node["capacity"].as_u64() >= Some(1) && !why.is_empty(), "{name}: {node}");
            if place["kind"] != "region" {
                continue;
            }
            regions += 1;
            let count = |part: &str| place[part].as_array().unwrap().len() as u64;
            assert_eq!(node["capacity"], count("spots") + count("merged"), "{name}: {node}");
            assert!(why.contains(&format!("{} spot", count("spots"))), "{why}");
            // A count that ended for want of room is the whole of it; any other is a least one.
            let ended = place["more_may_fit"] == false;
            assert_eq!(why.starts_with("at least "), !ended, "{why}");
            assert_eq!(why.ends_with("no room for more was found"), ended, "{why}");
            let enough = node["capacity"].as_u64().unwrap() >= modes.problem.objects.len() as u64;
            assert_eq!(why.contains("which is enough for"), !ended && enough, "{why}");
            for spot in place["spots"].as_array().unwrap() {
                assert!(modes.lies_on(&place["surface"], &pose(spot)), "{name}: {spot}");
            }
            // Those that reach it are those that can bring and fetch.
            let arms = place["arms"].as_array().unwrap();
            assert!(!arms.is_empty(), "{name}: {node}");
            for (arm, other) in nodes.iter().enumerate().filter(|(_, other)| other["place"]["kind"] == "arm")
            {
                let reaches = arms.contains(&other["place"]["arm"]);
                assert_eq!((leads(index, arm), leads(arm, index)), (reaches, reaches), "{name}: {node}");
            }
            assert!(arms.iter().all(|arm| !modes.named(arm).id.is_empty()));
        }
        assert!(regions >= 2, "{name}");
    }
}

#[test]
fn every_edge_of_a_mode_graph_has_a_case_that_can_be_computed_again() {
    for name in CELLS {
        let modes = Modes::of(name);
        let (mut handoffs, mut rests) = (0, 0);
        for edge in modes.list("edges") {
            let witness = &edge["witness"];
            let object = |q: &str, hold: &str, arm: &Arm| Modes::in_hand(arm, &witness[q], &witness[hold]);
            let (arm, node) = match (modes.arm(&edge["from"]), modes.arm(&edge["to"])) {
                (Some(giver), Some(receiver)) => {
                    assert_ne!(giver.id, receiver.id);
                    let (given, taken) = (
                        object("giver_q", "object_in_tcp", giver),
                        object("receiver_q", "to_object_in_tcp", receiver),
                    );
                    assert!(is_near(&given, &taken), "{name}: {edge}");
                    handoffs += 1;
                    continue;
                }
                (Some(arm), None) => (arm, &edge["to"]),
                (None, Some(arm)) => (arm, &edge["from"]),
                (None, None) => panic!("{edge}"),
            };
            let at = pose(&witness["object_pose"]);
            assert!(is_near(&object("q", "object_in_tcp", arm), &at), "{name}: {edge}");
            let (surface, exactly) = modes.ground(node);
            assert_eq!(witness["surface"], surface, "{name}: {edge}");
            assert!(modes.lies_on(&surface, &at), "{name}: {edge}");
            assert!(exactly.is_none_or(|pose| is_near(&pose, &at)), "{name}: {edge}");
            rests += 1;
        }
        assert!(handoffs >= 2 && rests >= 8, "{name}: {handoffs} {rests}");
    }
}

#[test]
fn mode_graphs_for_people_tell_the_same() {
    for name in CELLS {
        let known = Modes::of(name);
        let (text, dot) = (modes(name, &[]), modes(name, &["--dot"]));
        let (nodes, edges) = (known.list("nodes"), known.list("edges"));
        let balance = |open: char, close: char| dot.matches(open).count() == dot.matches(close).count();
        assert!(balance('{', '}') && balance('[', ']'), "{dot}");
        assert!(dot.starts_with("digraph ") && dot.ends_with("}\n"), "{dot}");
        assert!(dot.lines().all(|line| line.matches('"').count().is_multiple_of(2)), "{dot}");
        for (index, node) in nodes.iter().enumerate() {
            let (name, why) = (node["name"].as_str().unwrap(), node["why"].as_str().unwrap());
            let said = format!("capacity {} ({why})", node["capacity"]);
            let line = text.lines().find(|line| line.starts_with(&format!("  {index}: {name},"))).unwrap();
            let drawn = dot.lines().find(|line| line.starts_with(&format!("  n{index} ["))).unwrap();
            assert!(line.contains(&said), "{said} in {line}");
            assert!(
                drawn.contains(&format!("label=\"{name}\\n")) && drawn.contains(&said),
                "{said} in {drawn}"
            );
            if let Some(arms) = node["place"]["arms"].as_array() {
                let arms: Vec<&str> = arms.iter().map(|arm| arm.as_str().unwrap()).collect();
                let reached = format!("reached by {}", arms.join(", "));
                assert!(line.contains(&reached) && drawn.contains(&reached), "{reached}");
            }
        }
        // An edge that leads back, too, is told once, and each with its case.
        let back = |edge: &Value| {
            edges
                .iter()
                .any(|e| [&e["from"], &e["to"], &e["class"]] == [&edge["to"], &edge["from"], &edge["class"]])
        };
        let told = |edge: &&Value| edge["from"].as_u64() < edge["to"].as_u64() || !back(edge);
        let count = edges.iter().filter(told).count();
        for edge in edges.iter().filter(told) {
            let (from, to) = (&edge["from"], &edge["to"]);
            let ends = format!("  n{from} -> n{to} [label=\"class {},", edge["class"]);
            let drawn: Vec<&str> = dot.lines().filter(|line| line.starts_with(&ends)).collect();
            assert_eq!(drawn.len(), 1, "{ends}");
            assert!(
                drawn[0].contains(" m\\nby grasp ") && drawn[0].contains("edgetooltip=\"by grasp "),
                "{drawn:?}"
            );
        }
        assert_eq!(
            dot.lines().filter(|line| line.contains(" -> ") && !line.contains("dashed")).count(),
            count
        );
        let lines: Vec<&str> = text.lines().skip_while(|line| *line != "edges").skip(1).collect();
        let lines: Vec<&&str> = lines.iter().take_while(|line| line.starts_with("  ")).collect();
        assert_eq!(lines.len(), count, "{text}");
        assert!(lines.iter().all(|line| line.contains(", by grasp ") && !line.contains("without")), "{text}");
    }
}

#[test]
fn mode_graphs_are_the_same_bytes_for_the_same_seed() {
    for name in CELLS {
        for flags in [&["--json"][..], &["--dot"], &[]] {
            let flags = [flags, &["--seed", "5"]].concat();
            assert_eq!(modes(name, &flags), modes(name, &flags), "{name} {flags:?}");
        }
    }
    let bound: Value = serde_json::from_str(&modes("switch/2x2", &["--optimistic", "--json"])).unwrap();
    assert_eq!(bound["kind"], "optimistic");
    assert!(bound["edges"].as_array().unwrap().iter().all(|edge| edge["witness"].is_null()));
    assert!(!modes("switch/2x2", &["--optimistic"]).contains("witness"));
}
