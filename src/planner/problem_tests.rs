//! Problems of every kind, each planned by the planner whole and judged.

use std::time::Duration;

use nalgebra::UnitQuaternion;
use serde_json::{Value, json};

use super::{Outcome, PlannerEvent, Termination, plan};
use crate::geometry::Pose;
use crate::plan::{ActionKind, Plan};
use crate::problem::{GoalPlacement, GuidanceKind, InitialPlacement, Problem};
use crate::run::{CancelToken, Control, Deadline};
use crate::scenario::{Family, RobotKind, find, generate, generate_with};
use crate::verify::verify;
use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};
use crate::workcell::ArmId;

/// Generous: what is asked for here is there in a fraction of a second.
const BUDGET: Duration = Duration::from_secs(30);

fn read(document: &Value) -> Problem {
    match read_problem_value(document, &LibraryOnly, &ReadLimits::default()) {
        Ok(read) => read.problem,
        Err(faults) => panic!("{faults:?}"),
    }
}

/// A scenario that ships.
fn shipped(name: &str) -> Value {
    serde_json::from_str(find(name).unwrap().text).unwrap()
}

/// The first plan of at most `steps` steps that is found within `budget`; all until then are judged.
fn search(problem: &Problem, steps: usize, budget: Duration) -> (Option<Plan>, Outcome) {
    let cancel = CancelToken::new();
    let control = Control::new(Deadline::after(budget), cancel.clone());
    let mut plans: Vec<Plan> = Vec::new();
    let mut observe = |event: PlannerEvent<'_>| {
        if let PlannerEvent::Incumbent(found) = event {
            plans.push(found.clone());
            if found.metrics.steps <= steps {
                cancel.cancel();
            }
        }
    };
    let outcome = plan(problem, &control, &mut observe);
    for found in &plans {
        let verdict = verify(problem, found);
        assert!(verdict.valid, "{}: {:?}", problem.name, verdict.first);
    }
    (plans.into_iter().find(|found| found.metrics.steps <= steps), outcome)
}

/// A plan of exactly `steps` steps.
fn solve(problem: &Problem, steps: usize) -> Plan {
    let (found, outcome) = search(problem, steps, BUDGET);
    let found = found.unwrap_or_else(|| panic!("{}: {}", problem.name, told(&outcome)));
    assert_eq!(found.metrics.steps, steps, "{}", problem.name);
    found
}

/// Any plan.
fn solve_somehow(problem: &Problem) -> Plan {
    let (found, outcome) = search(problem, usize::MAX, BUDGET);
    found.unwrap_or_else(|| panic!("{}: {}", problem.name, told(&outcome)))
}

fn told(outcome: &Outcome) -> String {
    format!("{:?}, {:?}", outcome.termination, outcome.diagnosis)
}

/// Letters for the actions in their order, each with its object: `p0 h0 l0` picks, hands over and puts down.
fn doings(plan: &Plan) -> String {
    let letter = |kind: &ActionKind| match kind {
        ActionKind::Pick { .. } => 'p',
        ActionKind::Handoff { .. } => 'h',
        ActionKind::Place { .. } => 'l',
    };
    let words = plan.actions.iter().map(|action| format!("{}{}", letter(&action.kind), action.object.0));
    words.collect::<Vec<_>>().join(" ")
}

#[test]
fn one_arm_moves_three_to_nine_objects_round_in_a_cycle() {
    for objects in 3..=9 {
        let problem = read(&generate(Family::Derangement, 1, objects, 2).unwrap());
        // One of them is put aside; all are taken and put down once more.
        let found = solve(&problem, 2 * objects + 2);
        assert_eq!(found.actions.len(), 2 * objects + 2);
    }
}

#[test]
fn two_arms_move_three_to_nine_objects_round_in_a_cycle() {
    for objects in 3..=9 {
        let problem = read(&generate(Family::Derangement, 2, objects, 1).unwrap());
        let found = solve_somehow(&problem);
        assert!(found.metrics.steps >= found.metrics.steps_lower_bound && found.metrics.steps > objects);
        for object in 0..objects {
            assert!(found.actions.iter().any(|action| action.object.0 == object), "{objects}: {object}");
        }
    }
}

#[test]
fn what_has_no_goal_leaves_the_goal_of_another() {
    let mut document = shipped("in_place_swap/1x2");
    document["goal"].as_object_mut().unwrap().remove("cube_2");
    let problem = read(&document);
    assert!(matches!(problem.goal[1], GoalPlacement::Anywhere));
    assert_eq!(doings(&solve(&problem, 4)), "p1 l1 p0 l0");
}

#[test]
fn a_surface_is_a_goal() {
    let mut document = shipped("side_to_side/2x2");
    let everything_there = json!({ "surface": "table_b_top" });
    document["goal"] = json!({ "cube_1": everything_there, "cube_2": everything_there });
    let problem = read(&document);
    let found = solve(&problem, 5);
    let last = |object: usize| found.actions.iter().rev().find(|action| action.object.0 == object).unwrap();
    for object in 0..2 {
        let on = match &last(object).kind {
            ActionKind::Place { surface, .. } => problem.workcell.surfaces[surface.0].id.as_str(),
            other => panic!("{other:?}"),
        };
        assert_eq!(on, "table_b_top");
    }
    // What is there already may stay.
    document["goal"]["cube_1"] = json!({ "surface": "table_a_top" });
    let found = solve(&read(&document), 3);
    assert_eq!(doings(&found), "p1 h1 l1");
}

/// The arm starts with cube 1 in its hand, in this hold.
fn held(mut document: Value, [x, y, z]: [f64; 3], [a, b, c, w]: [f64; 4]) -> Problem {
    document["initial"]["cube_1"] = json!({
        "held_by": "arm_1",
        "object_in_tcp": {
            "position": { "x": x, "y": y, "z": z }, "orientation": { "x": a, "y": b, "z": c, "w": w },
        },
    });
    document["goal"].as_object_mut().unwrap().remove("cube_2");
    read(&document)
}

/// Whether the object's start is one of its grasps.
fn is_listed(problem: &Problem) -> bool {
    let InitialPlacement::Held { arm, object_in_tcp } = &problem.initial[0] else { panic!("it rests") };
    assert_eq!(*arm, ArmId(0));
    let same = |grasp: &Pose| {
        let off = grasp.inverse() * object_in_tcp;
        off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6
    };
    problem.objects[0].grasps.iter().any(|grasp| same(&grasp.object_in_tcp))
}

#[test]
fn an_object_may_start_in_a_hand() {
    // From above, and turned in the hand and off its middle as no list of grasps has it.
    let (sin, cos) = 10.0_f64.to_radians().sin_cos();
    let holds = [([0.0; 3], [1.0, 0.0, 0.0, 0.0], true), ([0.004, 0.0, 0.002], [cos, sin, 0.0, 0.0], false)];
    for (at, turn, listed) in holds {
        let mut document = shipped("in_place_swap/1x2");
        document["goal"]["cube_1"] = document["initial"]["cube_1"].clone();
        let problem = held(document, at, turn);
        assert_eq!(is_listed(&problem), listed);
        assert_eq!(doings(&solve(&problem, 1)), "l0");
    }
    // Over an edge, to be handed on.
    let (sin, cos) = 67.5_f64.to_radians().sin_cos();
    for (at, listed) in [([0.0; 3], true), ([0.0, 0.003, 0.002], false)] {
        let problem = held(shipped("switch/2x2"), at, [-sin, 0.0, cos, 0.0]);
        assert_eq!(is_listed(&problem), listed);
        assert_eq!(doings(&solve(&problem, 2)), "h0 l0");
    }
}

#[test]
fn arms_go_home_when_asked_to() {
    let ends = |return_home: bool| {
        let mut problem = read(&shipped("switch/2x2"));
        problem.options.return_home = return_home;
        let found = solve(&problem, 6);
        let arms = problem.workcell.arms.iter().zip(&found.arms);
        let off = arms.map(|(arm, trajectory)| {
            let last = &trajectory.points.last().unwrap().q;
            last.iter().zip(&arm.home).map(|(q, home)| (q - home).abs()).fold(0.0, f64::max)
        });
        off.collect::<Vec<f64>>()
    };
    assert!(ends(true).iter().all(|off| *off < 1e-9));
    assert!(ends(false).iter().any(|off| *off > 0.1), "nobody asked");
}

/// Arms of the kind that cannot be at 0 in all joints, without a home; and one whose home is blocked.
#[test]
fn arms_need_no_home_that_they_could_be_at() {
    let mut document = generate_with(Family::Switch, 2, 2, 0, &[RobotKind::PandaType]).unwrap();
    let mut starts = json!({});
    for arm in document["workcell"]["arms"].as_array_mut().unwrap() {
        let home = arm.as_object_mut().unwrap().remove("home").unwrap();
        starts[arm["id"].as_str().unwrap()] = home;
    }
    document["initial_joints"] = starts;
    solve_somehow(&read(&document));
    let mut document = shipped("switch/2x2");
    let arm = &read(&document).workcell.arms[0];
    let hand = arm.tcp_position(&arm.home);
    document["workcell"]["obstacles"].as_array_mut().unwrap().push(json!({
        "id": "ball", "shape": { "type": "sphere", "radius": 0.05 },
        "pose": { "position": { "x": hand.x, "y": hand.y, "z": hand.z } },
    }));
    document["initial_joints"] = json!({ "arm_1": { "joint_1": 1.5 } });
    let problem = read(&document);
    assert_eq!(problem.workcell.arms[0].home, problem.initial_joints[0]);
    solve_somehow(&problem);
}

/// One cylinder, gripped from above only, whose goal is turned so; `away` says whether that is elsewhere.
fn cylinder(symmetry: &str, turn: UnitQuaternion<f64>, away: bool) -> Problem {
    let mut document = shipped("in_place_swap/1x2");
    document["objects"] = json!([{
        "id": "cube_1", "shape": { "type": "cylinder", "radius": 0.03, "length": 0.06 }, "mass": 0.2,
        "symmetry": symmetry, "grasps": [{ "generator": "top" }],
    }]);
    let start = document["initial"]["cube_1"].clone();
    let mut goal = if away { document["goal"]["cube_1"].clone() } else { start.clone() };
    goal["pose"]["orientation"] = json!({ "x": turn.i, "y": turn.j, "z": turn.k, "w": turn.w });
    document["initial"] = json!({ "cube_1": start });
    document["goal"] = json!({ "cube_1": goal });
    read(&document)
}

#[test]
fn a_cylinder_may_end_turned_about_its_axis_and_upside_down() {
    let about_z = UnitQuaternion::from_euler_angles(0.0, 0.0, 1.2);
    let over = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.4);
    for turn in [about_z, over] {
        let turned = solve(&cylinder("cylinder_z", turn, false), 0);
        assert!(turned.actions.is_empty(), "it is there already");
        assert_eq!(doings(&solve(&cylinder("cylinder_z", turn, true), 2)), "p0 l0");
    }
    // Without symmetry the one is work, and the other cannot be done from above.
    assert_eq!(doings(&solve(&cylinder("none", about_z, false), 2)), "p0 l0");
    let (found, outcome) = search(&cylinder("none", over, true), usize::MAX, Duration::from_secs(1));
    assert!(found.is_none() && outcome.diagnosis.is_some(), "{:?}", outcome.termination);
}

/// Each arm wants to take the cube that the other one is to give it, with its hand full.
#[test]
fn greedy_finds_nothing_on_the_switch() {
    std::thread::scope(|scope| {
        for seed in 0..3 {
            scope.spawn(move || {
                let mut problem = read(&generate(Family::Switch, 2, 2, seed).unwrap());
                problem.options.guidance = GuidanceKind::Greedy;
                let (found, outcome) = search(&problem, usize::MAX, Duration::from_secs(2));
                assert!(found.is_none() && outcome.best.is_none(), "seed {seed}");
                assert_eq!(outcome.termination, Termination::NoSolutionFound);
                assert!(outcome.diagnosis.is_some_and(|why| !why.is_empty()));
            });
        }
    });
}

#[test]
fn smart_needs_at_most_half_the_steps_of_sequential() {
    let mut problem = read(&shipped("side_to_side/9x4"));
    problem.options.guidance = GuidanceKind::Sequential;
    let sequential = solve_somehow(&problem).metrics.steps;
    problem.options.guidance = GuidanceKind::Smart;
    let (smart, outcome) = search(&problem, sequential / 2, BUDGET);
    assert!(smart.is_some(), "{sequential} steps one after the other; {}", told(&outcome));
    // Every object is taken, handed over and put down at least.
    assert!(sequential >= 3 * problem.objects.len(), "{sequential}");
}

/// What the judge takes for its goal needs no plan.
#[test]
fn who_is_nearly_at_the_goal_is_there() {
    let mut document = shipped("side_to_side/2x2");
    document["goal"] = document["initial"].clone();
    for goal in document["goal"].as_object_mut().unwrap().values_mut() {
        let x = &mut goal["pose"]["position"]["x"];
        *x = json!(x.as_f64().unwrap() + 0.0009);
    }
    let plan = solve(&read(&document), 0);
    assert!(plan.actions.is_empty());
}
