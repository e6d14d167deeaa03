//! From family, size and seed to a problem document.

use rand::Rng as _;
use serde_json::{Map, Value, json};

use super::layout::{Layout, PEDESTAL_HEIGHT, TABLE_TOP};
use super::sampling::{CUBE, Place, places, transfers};
use super::{Family, RobotKind, ScenarioError};
use crate::run::{Rng, Seed};

/// Edge (m) of a pedestal's footprint.
const PEDESTAL: f64 = 0.26;

/// Thickness (m) of a table's top.
const TABLE_THICKNESS: f64 = 0.05;

/// Generates the problem of `family` with `arms` arms, `objects` cubes and the places that `seed`
/// draws: the same arguments give the same document. Its planner seed is `seed`, too.
///
/// # Errors
/// When the family does not take these numbers, or the cubes do not fit.
pub fn generate(family: Family, arms: usize, objects: usize, seed: u64) -> Result<Value, ScenarioError> {
    generate_with(family, arms, objects, seed, &[RobotKind::Iiwa14])
}

/// [`generate`] with robots of the kinds given, dealt out to the arms in turn. Poses are drawn for
/// cells of iiwa14 arms.
///
/// # Errors
/// As [`generate`], and when no kind is given.
pub fn generate_with(
    family: Family,
    arms: usize,
    objects: usize,
    seed: u64,
    robots: &[RobotKind],
) -> Result<Value, ScenarioError> {
    if robots.is_empty() {
        return Err(ScenarioError::NoRobots);
    }
    let layout = if family == Family::Ring { Layout::ring(arms)? } else { Layout::grid(arms)? };
    check_sizes(family, arms, objects)?;
    let mut rng = Seed(seed).stream(&format!("scenario/{}/{arms}x{objects}", family.name()));
    let (starts, goals) =
        arrange(family, &layout, objects, &mut rng).ok_or(ScenarioError::NoRoom(objects))?;
    let ids: Vec<String> = (1..=objects).map(|number| format!("cube_{number}")).collect();
    let cubes: Vec<Value> = ids
        .iter()
        .map(|id| {
            json!({
                "id": id,
                "shape": { "type": "box", "size": xyz(CUBE, CUBE, CUBE) },
                "mass": 0.2,
                "symmetry": "none",
                "grasps": [ { "generator": "box_faces" }, { "generator": "box_edges" } ],
                "approach": 0.08,
                "retreat": 0.08,
            })
        })
        .collect();
    let placements = |list: &[Place]| -> Map<String, Value> {
        ids.iter().cloned().zip(list.iter().map(|place| json!({ "pose": cube_pose(place) }))).collect()
    };
    Ok(json!({
        "schema": "quadrille.problem/1",
        "name": format!("{} {arms}x{objects}{}, seed {seed}", family.name(), kinds_for_people(robots)),
        "workcell": workcell(&layout, robots),
        "objects": cubes,
        "initial": placements(&starts),
        "goal": placements(&goals),
        "options": { "time_budget_s": 30.0, "seed": seed },
    }))
}

fn check_sizes(family: Family, arms: usize, objects: usize) -> Result<(), ScenarioError> {
    let wrong = |takes| Err(ScenarioError::Objects { family: family.name(), takes, given: objects });
    match family {
        Family::Switch | Family::SideToSide | Family::Random if arms < 2 => {
            Err(ScenarioError::TooFewArms { family: family.name() })
        }
        Family::Switch if objects < 2 => wrong("at least 2"),
        Family::SideToSide | Family::Random | Family::Ring if objects < 1 => wrong("at least 1"),
        Family::InPlaceSwap if objects != 2 => wrong("exactly 2"),
        Family::Derangement if objects < 2 => wrong("at least 2"),
        _ => Ok(()),
    }
}

/// Start and goal of every cube; `None` when they do not fit.
fn arrange(
    family: Family,
    layout: &Layout,
    objects: usize,
    rng: &mut Rng,
) -> Option<(Vec<Place>, Vec<Place>)> {
    let tables = layout.tables.len();
    let starts_on: Vec<usize> = match family {
        // The first half, the larger one for an odd number, starts on the first table.
        Family::Switch => (0..objects).map(|index| usize::from(2 * index >= objects)).collect(),
        Family::SideToSide => vec![0; objects],
        Family::Random => (0..objects).map(|_| usize::from(!rng.random::<bool>())).collect(),
        // One and two arms swap on one table, more of them across the cell.
        Family::InPlaceSwap if layout.depth < 3 => vec![0; objects],
        Family::InPlaceSwap => vec![0, 1],
        Family::Derangement => (0..objects).map(|index| index % tables).collect(),
        Family::Ring => (0..objects).map(|_| rng.random_range(0..tables)).collect(),
    };
    match family {
        Family::Switch | Family::SideToSide | Family::Random | Family::Ring => {
            let mut other = |start: &usize| match family {
                Family::Ring => (start + rng.random_range(1..tables)) % tables,
                _ => 1 - start,
            };
            let ends_on: Vec<usize> = starts_on.iter().map(&mut other).collect();
            transfers(layout, &starts_on, &ends_on, rng)
        }
        Family::InPlaceSwap | Family::Derangement => {
            // One place more on each table, so that a buffer is free.
            let on = [starts_on, (0..tables).collect()].concat();
            let mut starts = places(layout, &on, rng)?;
            starts.truncate(objects);
            let cycle = cyclic_permutation(objects, rng);
            let goals = cycle.iter().map(|target| starts[*target]).collect();
            Some((starts, goals))
        }
    }
}

/// A random permutation that is one cycle (Sattolo's algorithm).
fn cyclic_permutation(length: usize, rng: &mut Rng) -> Vec<usize> {
    let mut out: Vec<usize> = (0..length).collect();
    for last in (1..length).rev() {
        out.swap(last, rng.random_range(0..last));
    }
    out
}

fn xyz(x: f64, y: f64, z: f64) -> Value {
    json!({ "x": tidy(x), "y": tidy(y), "z": tidy(z) })
}

/// A length without the last digits that sums of decimals leave.
fn tidy(value: f64) -> f64 {
    let rounded = (value * 1.0e9).round() / 1.0e9;
    // No negative zero.
    rounded + 0.0
}

fn about_z(yaw: f64) -> Value {
    let (sin, cos) = (yaw / 2.0).sin_cos();
    json!({ "x": 0.0, "y": 0.0, "z": sin, "w": cos })
}

fn cube_pose(place: &Place) -> Value {
    let [x, y] = place.xy;
    json!({ "position": xyz(x, y, TABLE_TOP + CUBE / 2.0), "orientation": about_z(place.yaw) })
}

/// The gripper of DESIGN section 11: a round body and two fingers around a 6 cm cube.
fn tool() -> Value {
    let cylinder = json!({
        "shape": { "type": "cylinder", "radius": 0.04, "length": 0.10 },
        "pose": { "position": xyz(0.0, 0.0, 0.05) },
    });
    // 16 mm wide, 12 mm thick, inner faces at y = +-31 mm, from 100 to 138 mm.
    let finger = |side: f64| {
        json!({
            "shape": { "type": "box", "size": xyz(0.016, 0.012, 0.038) },
            "pose": { "position": xyz(0.0, side * 0.037, 0.119) },
        })
    };
    json!({
        "mount_link": "flange",
        "tcp": { "position": xyz(0.0, 0.0, 0.15) },
        "collision": [ cylinder, finger(1.0), finger(-1.0) ],
        "max_opening": 0.10,
    })
}

/// The kinds as part of a name: nothing for a cell of the usual kind.
fn kinds_for_people(robots: &[RobotKind]) -> String {
    if robots.iter().all(|robot| *robot == RobotKind::Iiwa14) {
        return String::new();
    }
    let names: Vec<&str> = robots.iter().map(|robot| robot.name()).collect();
    format!(" of {}", names.join(", "))
}

fn workcell(layout: &Layout, robots: &[RobotKind]) -> Value {
    let mut arms = Vec::new();
    let mut obstacles = Vec::new();
    let mut surfaces = Vec::new();
    let mut contacts = Vec::new();
    for table in &layout.tables {
        let ([x, y], [depth, width]) = (table.middle, table.size);
        let at = |z: f64| {
            let mut pose = json!({ "position": xyz(x, y, z) });
            if table.yaw != 0.0 {
                pose["orientation"] = about_z(table.yaw);
            }
            pose
        };
        obstacles.push(json!({
            "id": table.id,
            "shape": { "type": "box", "size": xyz(depth, width, TABLE_THICKNESS) },
            "pose": at(TABLE_TOP - TABLE_THICKNESS / 2.0),
        }));
        surfaces.push(json!({
            "id": format!("{}_top", table.id),
            "on": table.id,
            "pose": at(TABLE_TOP),
            "size": { "x": tidy(depth), "y": tidy(width) },
        }));
    }
    let mut models = Map::new();
    for ((index, place), robot) in layout.arms.iter().enumerate().zip(robots.iter().cycle()) {
        let [x, y] = place.xy;
        let id = format!("arm_{}", index + 1);
        let pedestal = format!("pedestal_{}", index + 1);
        obstacles.push(json!({
            "id": pedestal,
            "shape": { "type": "box", "size": xyz(PEDESTAL, PEDESTAL, PEDESTAL_HEIGHT) },
            "pose": { "position": xyz(x, y, PEDESTAL_HEIGHT / 2.0) },
        }));
        contacts.extend(robot.on_the_pedestal().iter().map(|link| json!([pedestal, format!("{id}/{link}")])));
        models.insert(robot.name().to_owned(), json!({ "urdf": format!("library:{}", robot.name()) }));
        // In a grid arms lean along the tables, in a ring along the circle.
        let turned = if layout.is_ring() { 0.0 } else { place.yaw.to_degrees() };
        let home: Map<String, Value> = robot
            .home_deg(turned)
            .iter()
            .enumerate()
            .map(|(joint, degrees)| (format!("joint_{}", joint + 1), json!(tidy(degrees.to_radians()))))
            .collect();
        arms.push(json!({
            "id": id,
            "robot": robot.name(),
            "base": { "position": xyz(x, y, PEDESTAL_HEIGHT), "orientation": about_z(place.yaw) },
            "tool": tool(),
            "home": home,
        }));
    }
    json!({
        "robots": models,
        "arms": arms,
        "obstacles": obstacles,
        "surfaces": surfaces,
        "allowed_contacts": contacts,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{LibraryOnly, ReadLimits, ReadProblem, read_problem_value};

    fn read(value: &Value) -> ReadProblem {
        match read_problem_value(value, &LibraryOnly, &ReadLimits::default()) {
            Ok(read) => read,
            Err(faults) => {
                let lines: Vec<String> = faults.iter().map(ToString::to_string).collect();
                panic!("{}\n{}", value["name"], lines.join("\n"))
            }
        }
    }

    const SIZES: [(Family, usize, usize); 21] = [
        (Family::Switch, 2, 2),
        (Family::Switch, 4, 4),
        (Family::Switch, 6, 4),
        (Family::Switch, 9, 4),
        (Family::SideToSide, 2, 2),
        (Family::SideToSide, 4, 4),
        (Family::SideToSide, 6, 4),
        (Family::SideToSide, 9, 4),
        (Family::Random, 9, 4),
        (Family::Random, 9, 20),
        (Family::Random, 12, 12),
        (Family::Random, 16, 50),
        (Family::Random, 5, 3),
        (Family::InPlaceSwap, 1, 2),
        (Family::InPlaceSwap, 2, 2),
        (Family::InPlaceSwap, 3, 2),
        (Family::Derangement, 1, 4),
        (Family::Derangement, 2, 6),
        (Family::Ring, 3, 2),
        (Family::Ring, 12, 8),
        (Family::Ring, 16, 20),
    ];

    #[test]
    fn every_family_and_size_is_a_valid_problem_without_warnings() {
        for (family, arms, objects) in SIZES {
            for seed in 0..3 {
                let value = generate(family, arms, objects, seed).unwrap();
                let read = read(&value);
                assert_eq!(read.warnings, [], "{}", value["name"]);
                assert_eq!(read.problem.workcell.arms.len(), arms);
                assert_eq!(read.problem.objects.len(), objects);
                assert!(read.problem.objects.iter().all(|o| o.grasps.len() == 48 && o.class == 0));
                assert_eq!(read.problem.options.seed, seed);
            }
        }
    }

    #[test]
    fn cells_of_every_kind_of_arm_are_valid() {
        use RobotKind::{Iiwa14, PandaType, UrType};
        let mixes: [&[RobotKind]; 4] =
            [&[UrType], &[PandaType], &[Iiwa14, UrType], &[UrType, PandaType, Iiwa14]];
        for robots in mixes {
            for (family, arms) in
                (3..=16).map(|n| (Family::Ring, n)).chain((2..=16).map(|n| (Family::Random, n)))
            {
                let value = generate_with(family, arms, 2, 5, robots).unwrap();
                assert_eq!(read(&value).problem.workcell.arms.len(), arms);
            }
        }
    }

    #[test]
    fn seeds_decide() {
        let make = |seed| generate(Family::Switch, 2, 2, seed).unwrap();
        assert_eq!(make(3), make(3));
        assert_ne!(make(3)["initial"], make(4)["initial"]);
        assert_eq!(make(3)["workcell"], make(4)["workcell"]);
    }

    #[test]
    fn families_do_what_they_say() {
        let x = |value: &Value, when: &str, cube: usize| {
            value[when][format!("cube_{cube}")]["pose"]["position"]["x"].as_f64().unwrap()
        };
        let switch = generate(Family::Switch, 4, 4, 0).unwrap();
        for cube in 1..=4 {
            assert_eq!(x(&switch, "initial", cube) < 0.0, cube <= 2);
            assert_eq!(x(&switch, "goal", cube) < 0.0, cube > 2);
        }
        let side = generate(Family::SideToSide, 4, 4, 0).unwrap();
        assert!((1..=4).all(|cube| x(&side, "initial", cube) < 0.0 && x(&side, "goal", cube) > 0.0));
        let random = generate(Family::Random, 4, 10, 0).unwrap();
        assert!((1..=10).all(|cube| (x(&random, "initial", cube) < 0.0) != (x(&random, "goal", cube) < 0.0)));
        let swap = generate(Family::InPlaceSwap, 3, 2, 0).unwrap();
        assert_eq!(swap["initial"]["cube_1"], swap["goal"]["cube_2"]);
        assert_eq!(swap["initial"]["cube_2"], swap["goal"]["cube_1"]);
        assert!(x(&swap, "initial", 1) < 0.0 && x(&swap, "initial", 2) > 0.0);
    }

    #[test]
    fn in_a_ring_every_object_changes_tables() {
        let value = generate(Family::Ring, 12, 8, 1).unwrap();
        let table = |when: &str, cube: usize| {
            let at = &value[when][format!("cube_{cube}")]["pose"]["position"];
            let [x, y] = ["x", "y"].map(|axis| at[axis].as_f64().unwrap());
            // Tables lie 30 degrees apart, and are about 11 wide as seen from the middle.
            let turn = y.atan2(x).to_degrees() / 30.0;
            assert!((turn - turn.round()).abs() < 0.25);
            turn.round().rem_euclid(12.0) as usize
        };
        assert!((1..=8).all(|cube| table("initial", cube) != table("goal", cube)));
        let starts: std::collections::BTreeSet<usize> = (1..=8).map(|cube| table("initial", cube)).collect();
        assert!(starts.len() > 2);
    }

    #[test]
    fn a_derangement_is_one_cycle() {
        for seed in 0..20 {
            let cycle = cyclic_permutation(6, &mut Seed(seed).stream("test"));
            let mut at = 0;
            for step in 0..6 {
                assert!(step == 0 || at != 0);
                at = cycle[at];
            }
            assert_eq!(at, 0);
        }
    }

    #[test]
    fn wrong_sizes_are_refused() {
        assert!(matches!(generate(Family::Switch, 1, 2, 0), Err(ScenarioError::TooFewArms { .. })));
        assert!(matches!(generate(Family::InPlaceSwap, 1, 3, 0), Err(ScenarioError::Objects { .. })));
        assert!(matches!(generate(Family::Ring, 2, 3, 0), Err(ScenarioError::NoRing(2))));
        assert!(matches!(generate(Family::Random, 17, 3, 0), Err(ScenarioError::Arms(17))));
        assert_eq!(generate(Family::SideToSide, 2, 200, 0), Err(ScenarioError::NoRoom(200)));
    }
}
