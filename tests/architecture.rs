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

/// Whether code reaches into the room `other`, as `crate::other` or as `{other, ...}` below `crate`.
fn imports(text: &str, other: &str) -> bool {
    let direct = names(text, &format!("crate::{other}"));
    let grouped = text.split("use crate::{").skip(1).any(|rest| {
        let group = rest.split(';').next().unwrap_or_default();
        names(group, other)
    });
    direct || grouped
}

/// Whether a file is compiled for tests only: it, or a folder around it, is declared so or lies in `tests`.
fn is_test(path: &Path) -> bool {
    path.ancestors().take_while(|part| !part.ends_with("src")).any(|part| {
        let name = part.file_stem().and_then(|name| name.to_str()).unwrap_or_default();
        let parent = part.parent().map(|folder| folder.join("mod.rs"));
        let declared = parent.and_then(|file| fs::read_to_string(file).ok()).unwrap_or_default();
        name == "tests" || declared.contains(&format!("#[cfg(test)]\nmod {name};"))
    })
}

/// The rooms from left to right; each may know those to its left, less what [`FORBIDDEN`] takes away.
const FLOW: [&str; 21] = [
    "run",
    "geometry",
    "kinematics",
    "workcell",
    "problem",
    "collision",
    "mode_graph",
    "guidance",
    "transition",
    "trajectory",
    "plan",
    "motion",
    "search",
    "verify",
    "planner",
    "scenario",
    "wire",
    "bench",
    "jobs",
    "service",
    "cli",
];

/// The rooms around the core.
const OUTSIDE: [&str; 6] = ["scenario", "wire", "bench", "jobs", "service", "cli"];

/// What a room must not know although it lies to the left.
const FORBIDDEN: [(&str, &[&str]); 12] = [
    // What can be grounded, the mode graph learns through its trait `Reach`.
    ("mode_graph", &["collision"]),
    // Guidance works on the graph alone.
    ("guidance", &["geometry", "kinematics", "workcell", "problem", "collision"]),
    // What is grounded does not depend on who asks for it.
    ("transition", &["guidance"]),
    // Curves are numbers over time.
    ("trajectory", &["geometry", "workcell", "problem", "collision", "mode_graph", "guidance", "transition"]),
    ("plan", &["collision", "mode_graph", "guidance", "transition"]),
    // A step is moved without knowing what it is good for.
    ("motion", &["mode_graph", "guidance"]),
    // The judge shares no planning code.
    (
        "verify",
        &["collision", "mode_graph", "guidance", "transition", "trajectory", "motion", "search", "planner"],
    ),
    (
        "scenario",
        &["collision", "mode_graph", "guidance", "transition", "trajectory", "motion", "search", "planner"],
    ),
    (
        "wire",
        &["collision", "mode_graph", "guidance", "transition", "trajectory", "motion", "search", "planner"],
    ),
    // The planner is measured as any user calls it.
    ("bench", &["collision", "mode_graph", "guidance", "transition", "motion", "search"]),
    // What is served is not measured by what serves it.
    ("jobs", &["bench"]),
    ("service", &["bench"]),
];

/// Pairs (room, what it must not know).
fn forbidden_pairs() -> Vec<(&'static str, &'static str)> {
    let mut pairs = Vec::new();
    for (place, room) in FLOW.iter().enumerate() {
        pairs.extend(FLOW[place + 1..].iter().map(|other| (*room, *other)));
    }
    pairs.extend(FORBIDDEN.iter().flat_map(|(room, others)| others.iter().map(|other| (*room, *other))));
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
    let pairs = forbidden_pairs();
    for room in FLOW {
        for (path, text) in sources(room).iter().filter(|(path, _)| !is_test(path)) {
            let code = code(text);
            for (_, other) in pairs.iter().filter(|(from, other)| *from == room && imports(&code, other)) {
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

/// What is decided must not hang on the order in which a hash table is walked.
#[test]
fn the_core_keeps_its_collections_in_order() {
    // A table of states with a fixed hash, which is looked up and never walked.
    let allowed = Path::new("guidance").join("exhaustive.rs");
    for room in FLOW.iter().filter(|room| !OUTSIDE.contains(room)) {
        for (path, text) in sources(room) {
            let code = code(&text);
            for unordered in ["HashMap", "HashSet"] {
                let fine = is_test(&path) || path.ends_with(&allowed) || !names(&code, unordered);
                assert!(fine, "{} uses {unordered}", path.display());
            }
        }
    }
}

#[test]
fn unsafe_code_is_where_the_map_says() {
    // The callback by which HiGHS is told to stop, and the intrinsics of the lanes.
    let allowed = ["guidance/interruptible.rs", "geometry/lanes/avx2.rs"];
    for room in FLOW {
        for (path, text) in sources(room) {
            // A word of content security policies.
            let uses = names(&code(&text).replace("unsafe-inline", ""), "unsafe");
            let fine = allowed.iter().any(|file| path.ends_with(Path::new(file)));
            assert!(!uses || fine, "{} is unsafe", path.display());
        }
    }
}

/// The judge, and those who describe the world, work in double precision: a fault of the hot path's
/// arithmetic cannot hide itself there.
#[test]
fn only_the_hot_path_knows_lanes() {
    for room in FLOW.iter().filter(|room| !["geometry", "kinematics", "collision", "cli"].contains(room)) {
        for (path, text) in sources(room) {
            let code = code(&text);
            for word in ["geometry::lanes", "Float8", "InstructionSet", "MovingFrames"] {
                assert!(is_test(&path) || !names(&code, word), "{} names {word}", path.display());
            }
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
    let found = |room: &str| sources(room).into_iter().map(|(path, text)| (is_test(&path), code(&text)));
    assert!(found("search").any(|(test, text)| !test && imports(&text, "motion")));
    assert!(found("transition").any(|(test, text)| !test && imports(&text, "mode_graph")));
    assert!(found("verify").any(|(test, text)| test && imports(&text, "wire")));
    assert!(found("guidance").any(|(test, _)| test) && found("guidance").any(|(test, _)| !test));
    assert!(!names(&code("//! no tokio here\nlet tokio_like = 1;"), "tokio"));
}
