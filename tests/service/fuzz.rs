//! Everything that reads what comes from outside, fed with good input that was damaged at random: no panic, no
//! blow-up of memory. Seeded, so that a failure repeats; the short form runs ten seconds per target, and
//! `QUADRILLE_FUZZ_SECONDS` says otherwise.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use quadrille::geometry::Vec3;
use quadrille::run::{Rng, Seed};
use quadrille::service::{ArchiveLimits, unpack_tar_gz, unpack_zip};
use quadrille::wire::{self, LibraryOnly, ReadLimits, read_job, read_problem_value};
use rand::Rng as _;
use serde_json::{Value, json};

use crate::figures::Figures;
use crate::process::soak;
use crate::script::problem;

/// Longest input (bytes).
const LONGEST: usize = 256 << 10;
/// What the process may hold in the end (bytes), when it does nothing else.
const MOST_MEMORY: u64 = 256 << 20;

/// What input of each kind likes to hold.
const WORDS: [&str; 28] = [
    "null",
    "true",
    "-1",
    "0",
    "1e999",
    "1e-320",
    "NaN",
    "\"\"",
    "[]",
    "{}",
    "<",
    ">",
    "/>",
    "\"",
    "\\u0000",
    "&amp;",
    "&a;",
    "<!DOCTYPE a [",
    "0 0 0",
    "-0.0",
    "18446744073709551616",
    "../",
    "/etc/passwd",
    "f 1 2 99999999999",
    "endfacet",
    "solid",
    "PK\u{1}\u{2}",
    "\u{fffd}",
];

fn mutated(seed: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..1 << rng.random_range(0..5_u32) {
        let at = rng.random_range(0..=bytes.len());
        let end = (at + (1 << rng.random_range(0..10_u32))).min(bytes.len());
        match rng.random_range(0..8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << rng.random_range(0..8_u32),
            1 if at < bytes.len() => bytes[at] = rng.random(),
            2 => drop(bytes.drain(at..end)),
            3 => {
                let copy = bytes[at..end].to_vec();
                let place = rng.random_range(0..=bytes.len());
                bytes.splice(place..place, copy);
            }
            4 => bytes.truncate(at.max(1)),
            5 => drop(bytes.splice(at..end, std::iter::empty())),
            _ => drop(bytes.splice(at..at, WORDS[rng.random_range(0..WORDS.len())].bytes())),
        }
    }
    bytes.truncate(LONGEST);
    bytes
}

/// A JSON value with one value somewhere replaced: it stays JSON, and goes further in.
fn mutated_json(seed: &Value, rng: &mut Rng) -> Value {
    fn places(value: &Value, at: String, found: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                map.iter().for_each(|(key, inner)| places(inner, format!("{at}/{key}"), found))
            }
            Value::Array(list) => {
                list.iter().enumerate().for_each(|(i, inner)| places(inner, format!("{at}/{i}"), found))
            }
            _ => {}
        }
        found.push(at);
    }
    let mut changed = seed.clone();
    for _ in 0..rng.random_range(1..4) {
        let mut found = Vec::new();
        places(&changed, String::new(), &mut found);
        let donor = changed.pointer(&found[rng.random_range(0..found.len())]).cloned().unwrap_or_default();
        let place = found[rng.random_range(0..found.len())].clone();
        let new = match rng.random_range(0..7) {
            0 => donor,
            1 => json!(rng.random_range(-1e3..1e3)),
            2 => json!(10_f64.powi(rng.random_range(-300..300))),
            3 => Value::Null,
            4 => json!(WORDS[rng.random_range(0..WORDS.len())]),
            5 => json!(0),
            _ => json!({}),
        };
        if let Some(value) = changed.pointer_mut(&place) {
            *value = new;
        }
    }
    changed
}

/// Feeds `target` with damaged `seeds` for as long as is asked.
fn fuzz(name: &str, seeds: &[Vec<u8>], target: impl Fn(&[u8])) {
    let usual = if soak() { 600.0 } else { 10.0 };
    let asked = std::env::var("QUADRILLE_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let span = Duration::from_secs_f64(asked.unwrap_or(usual));
    let mut rng = Seed(5).stream(name);
    let (began, mut runs) = (Instant::now(), 0_u64);
    while began.elapsed() < span {
        let seed = &seeds[rng.random_range(0..seeds.len())];
        let json = serde_json::from_slice::<Value>(seed).ok().filter(|_| rng.random_bool(0.6));
        let input = match json {
            Some(document) => mutated_json(&document, &mut rng).to_string().into_bytes(),
            None => mutated(seed, &mut rng),
        };
        if catch_unwind(AssertUnwindSafe(|| target(&input))).is_err() {
            let path = std::env::temp_dir().join(format!("quadrille-fuzz-{name}-{runs}"));
            std::fs::write(&path, &input).unwrap();
            panic!("{name} panics after {runs} inputs; the input is in {}", path.display());
        }
        runs += 1;
    }
    // On a thread of its own: what else the process does is not counted.
    let used = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let used = used.split(' ').next().and_then(|word| word.parse::<f64>().ok()).unwrap_or(0.0) / 1e9;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("0 kB");
    let peak = peak.trim().trim_end_matches(" kB").trim().parse::<u64>().unwrap_or(0) * 1024;
    let mut figures = Figures::of("fuzzing");
    let figure = format!(
        "{runs} in {:.0} s ({used:.0} s on a processor), no panic, {:.0} MB",
        began.elapsed().as_secs_f64(),
        peak as f64 / 1e6
    );
    let mark = format!("no panic, {:.0} MB", MOST_MEMORY as f64 / 1e6);
    figures.mark(&format!("damaged inputs, {name}"), figure, &mark, runs > 0 && peak < MOST_MEMORY);
    figures.finish();
    assert!(runs > 0);
}

fn limits() -> ReadLimits {
    ReadLimits { max_bytes: LONGEST * 2, ..ReadLimits::default() }
}

fn read(document: &Value) {
    let _ = read_problem_value(document, &LibraryOnly, &limits());
}

#[test]
fn problems() {
    let seeds = ["switch/2x2", "random/2x2"]
        .iter()
        .filter_map(|name| quadrille::scenario::find(name))
        .map(|entry| entry.text.as_bytes().to_vec())
        .chain([json!({"problem": problem("x"), "labels": {"a": "b"}, "priority": 1})
            .to_string()
            .into_bytes()]);
    fuzz("problem", &seeds.collect::<Vec<_>>(), |bytes| {
        if let Ok(document) = wire::parse_json(bytes)
            && let Ok(job) = read_job(&document)
        {
            read(job.problem);
        }
    });
}

fn with_robot(field: &str, bytes: &[u8]) -> Value {
    let mut document = problem("x");
    let text = String::from_utf8_lossy(bytes);
    let robot = quadrille::kinematics::library("iiwa14").unwrap();
    document["workcell"]["robots"]["iiwa14"] = json!({"urdf_xml": robot.urdf, "srdf_xml": robot.srdf});
    document["workcell"]["robots"]["iiwa14"][field] = json!(text);
    document
}

#[test]
fn urdfs() {
    let robots = ["iiwa14", "panda_type"].map(|name| quadrille::kinematics::library(name).unwrap());
    let urdfs = robots.iter().map(|robot| robot.urdf.as_bytes().to_vec()).collect::<Vec<_>>();
    fuzz("urdf", &urdfs, |bytes| read(&with_robot("urdf_xml", bytes)));
}

#[test]
fn srdfs() {
    let robots = ["iiwa14", "panda_type"].map(|name| quadrille::kinematics::library(name).unwrap());
    let srdfs = robots.iter().map(|robot| robot.srdf.as_bytes().to_vec()).collect::<Vec<_>>();
    fuzz("srdf", &srdfs, |bytes| read(&with_robot("srdf_xml", bytes)));
}

/// The points of a mesh, whatever comes of it.
fn mesh(name: &str, bytes: &[u8]) {
    drop(quadrille::kinematics::read_mesh(name, bytes, &Vec3::repeat(1.0)).map(|content| content.pieces()));
}

#[test]
fn stls() {
    let mut binary = vec![0_u8; 80];
    binary.extend(2_u32.to_le_bytes());
    binary.extend((0..100_u8).map(|byte| byte.wrapping_mul(37)));
    let ascii = b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0.5\nendloop\nendfacet\nendsolid x\n";
    fuzz("stl", &[binary, ascii.to_vec()], |bytes| mesh("a.stl", bytes));
}

#[test]
fn objs() {
    let obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 0\nf 1 2 3\nf 1//1 2//1 4//1\nf 1/1 3/1 4/1\nf -1 -2 -3 -4\n";
    fuzz("obj", &[obj.to_vec()], |bytes| mesh("a.obj", bytes));
}

const ARCHIVE: ArchiveLimits =
    ArchiveLimits { entries: 100, unpacked_bytes: 8 << 20, file_bytes: 4 << 20, ratio: 100 };

#[test]
fn tars() {
    use std::io::Write;
    let mut builder =
        tar::Builder::new(flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast()));
    let mut header = tar::Header::new_gnu();
    for (path, content) in [("workcell.json", &b"{}"[..]), ("meshes/a.stl", &[7_u8; 3000])] {
        header.set_size(content.len() as u64);
        builder.append_data(&mut header, path, content).unwrap();
    }
    let packed = builder.into_inner().unwrap().finish().unwrap();
    let mut plain = Vec::new();
    std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut plain).unwrap();
    // Damaged before it is packed, so that what is inside gets its share.
    fuzz("tar", &[plain, packed], |bytes| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        let _ = unpack_tar_gz(&encoder.finish().unwrap(), ARCHIVE);
        let _ = unpack_tar_gz(bytes, ARCHIVE);
    });
}

#[test]
fn zips() {
    let zip = include_bytes!("../foreign/bundle.zip");
    assert_eq!(unpack_zip(zip, ARCHIVE).unwrap().len(), 2, "what another program has packed");
    fuzz("zip", &[zip.to_vec()], |bytes| drop(unpack_zip(bytes, ARCHIVE)));
}

#[test]
fn plans_for_the_judge() {
    let read = read_problem_value(&problem("improve 1"), &LibraryOnly, &limits()).unwrap().problem;
    let pose = json!({"position": {"x": 0.0, "y": 0.0, "z": 0.1}});
    let arms: Vec<Value> = read
        .workcell
        .arms
        .iter()
        .zip(&read.initial_joints)
        .map(|(arm, joints)| {
            let names: Vec<&str> = arm.model.joints.iter().map(|joint| joint.name.as_str()).collect();
            let q: Vec<f64> = joints.iter().copied().collect();
            let still = vec![0.0; q.len()];
            let points: Vec<Value> = (0..4)
                .map(|index| json!({"t": f64::from(index), "q": q, "qd": still, "qdd": still}))
                .collect();
            json!({"id": arm.id, "joint_names": names, "points": points})
        })
        .collect();
    let (arm, object, surface) =
        (&read.workcell.arms[0].id, &read.objects[0].id, &read.workcell.surfaces[0].id);
    let plan = json!({
        "schema": "quadrille.plan/1", "problem_digest": read.digest, "revision": 1, "schedule": "synchronous",
        "metrics": {"duration_s": 3.0, "arc_length": 1.0, "actions": 2, "steps": 2},
        "arms": arms,
        "actions": [
            {"id": 0, "step": 1, "t": 1.0, "kind": "pick", "object": object, "arm": arm, "object_in_tcp": pose, "surface": surface},
            {"id": 1, "step": 2, "t": 2.0, "kind": "place", "object": object, "arm": arm, "object_in_tcp": pose,
             "object_pose": pose, "surface": surface},
        ],
    });
    fuzz("plan", &[plan.to_string().into_bytes()], |bytes| {
        if let Ok(plan) = wire::plan::read_plan(bytes, &read) {
            let _ = quadrille::verify::verify(&read, &plan);
        }
    });
}
