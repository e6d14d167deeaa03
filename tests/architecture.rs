//! The invariants of ARCHITECTURE.md that say what is absent, checked on the source text.

use std::fs;
use std::path::{Path, PathBuf};

/// All Rust files below `folder` of `src/`, or the one file of that name.
fn sources(room: &str) -> Vec<(PathBuf, String)> {
    fn collect(folder: &Path, found: &mut Vec<(PathBuf, String)>) {
        let mut entries: Vec<PathBuf> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        for path in entries {
            if path.is_dir() {
                collect(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(room);
    let mut found = Vec::new();
    if folder.is_dir() {
        collect(&folder, &mut found);
    }
    found
}

/// The code of a file without comments and without its tests.
fn code(text: &str) -> String {
    let shipped = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let lines = shipped.lines().map(|line| line.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

/// Whether `text` names `word` as a word of its own.
fn names(text: &str, word: &str) -> bool {
    let part = |character: char| character.is_alphanumeric() || character == '_';
    text.match_indices(word).any(|(start, found)| {
        let before = text[..start].chars().next_back();
        let after = text[start + found.len()..].chars().next();
        !before.is_some_and(part) && !after.is_some_and(part)
    })
}

/// Whether a file of room `room` reaches into `other`, as `crate::other`, as `{other, ...}` below
/// `crate`, or as `super::other` from the room's own root.
fn imports(text: &str, other: &str) -> bool {
    let direct = names(text, &format!("crate::{other}"));
    let grouped = text.split("use crate::{").skip(1).any(|rest| {
        let group = rest.split(';').next().unwrap_or_default();
        names(group, other)
    });
    direct || grouped
}

fn is_test(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    name == "tests.rs" || path.components().any(|part| part.as_os_str() == "tests")
}

/// The rooms from left to right; each may know those to its left.
const FLOW: [&str; 20] = [
    "run",
    "geometry",
    "kinematics",
    "workcell",
    "problem",
    "collision",
    "mode_graph",
    "guidance",
    "transition",
    "motion",
    "search",
    "trajectory",
    "plan",
    "verify",
    "planner",
    "wire",
    "scenario",
    "jobs",
    "service",
    "cli",
];

/// Pairs (room, what it must not know).
fn forbidden_rooms() -> Vec<(&'static str, &'static str)> {
    let mut pairs = Vec::new();
    let outside = ["wire", "scenario", "jobs", "service", "cli"];
    let core = FLOW.iter().filter(|room| !outside.contains(room));
    pairs.extend(core.flat_map(|room| outside.iter().map(move |outer| (*room, *outer))));
    for planning in
        ["collision", "mode_graph", "guidance", "transition", "motion", "search", "trajectory", "planner"]
    {
        // The judge shares no planning code.
        pairs.push(("verify", planning));
        // What describes the world knows nothing of planning.
        for world in ["geometry", "kinematics", "workcell", "problem", "run"] {
            pairs.push((world, planning));
        }
        if planning != "trajectory" {
            pairs.push(("plan", planning));
        }
        if planning != "planner" {
            pairs.extend([("wire", planning), ("scenario", planning)]);
        }
    }
    // Guidance works on the graph alone.
    for geometric in ["geometry", "kinematics", "collision", "motion", "transition", "trajectory", "search"] {
        pairs.push(("guidance", geometric));
    }
    pairs.extend([("jobs", "service"), ("jobs", "cli"), ("service", "cli"), ("wire", "planner")]);
    pairs.extend([("wire", "jobs"), ("wire", "service"), ("scenario", "jobs"), ("scenario", "service")]);
    pairs
}

#[test]
fn the_rooms_are_those_of_the_map() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().and_then(|name| name.to_str()).unwrap().to_owned();
        let known = FLOW.contains(&name.as_str()) || ["lib", "main"].contains(&name.as_str());
        assert!(known, "src/{name} is in no list of invariants");
    }
}

#[test]
fn dependencies_run_one_way() {
    let mut broken = Vec::new();
    for (room, other) in forbidden_rooms() {
        for (path, text) in sources(room) {
            if !is_test(&path) && imports(&code(&text), other) {
                broken.push(format!("{} must not know `{other}`", path.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_core_knows_no_runtime_and_no_protocol() {
    for room in FLOW.iter().filter(|room| !["service", "cli"].contains(room)) {
        for (path, text) in sources(room) {
            let code = code(&text);
            for library in ["tokio", "axum", "tonic", "hyper", "tower", "prost", "reqwest"] {
                assert!(!names(&code, library), "{} names {library}", path.display());
            }
            if *room != "jobs" {
                assert!(!names(&code, "futures"), "{} names futures", path.display());
            }
        }
    }
}

#[test]
fn only_the_rim_looks_at_a_clock() {
    for room in FLOW.iter().filter(|room| !["run", "jobs", "service", "cli"].contains(room)) {
        for (path, text) in sources(room) {
            let code = code(&text);
            for clock in ["Instant", "SystemTime"] {
                assert!(is_test(&path) || !names(&code, clock), "{} names {clock}", path.display());
            }
        }
    }
}

#[test]
fn unsafe_code_is_where_the_map_says() {
    // The callback by which HiGHS is told to stop.
    let allowed = ["guidance"];
    for room in FLOW {
        for (path, text) in sources(room) {
            let uses = names(&code(&text), "unsafe");
            assert!(!uses || allowed.contains(&room), "{} is unsafe", path.display());
        }
    }
}

#[test]
fn files_stay_readable() {
    for room in FLOW {
        for (path, text) in sources(room) {
            let lines = text.lines().count();
            assert!(lines <= 800, "{} has {lines} lines", path.display());
            let says = is_test(&path) || text.starts_with("//!");
            assert!(says, "{} does not say what it is for", path.display());
        }
    }
}

/// The checks above would miss nothing obvious.
#[test]
fn the_reader_of_imports_sees_what_it_should() {
    assert!(imports("use crate::motion::Roadmap;", "motion"));
    assert!(imports("use crate::{\n    plan::Plan,\n    motion,\n};", "motion"));
    assert!(imports("let x = crate::motion::f();", "motion"));
    assert!(!imports("use crate::motion_limits::f;", "motion"));
    assert!(!imports("use super::motion_limits;", "motion"));
    assert!(names(&code("use tokio::spawn; // fine"), "tokio"));
    assert!(!names(&code("//! no tokio here\nlet tokio_like = 1;"), "tokio"));
}
