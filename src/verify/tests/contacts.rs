//! Contacts: what is exempt, what is not, and what happens between breakpoints.

use std::sync::Arc;

use proptest::prelude::*;

use super::gantry::*;
use crate::geometry::{ExactShape, Pose};
use crate::plan::{ArmTrajectory, Plan};
use crate::problem::{ContactPartner, Problem};
use crate::verify::{Rule, Verdict, verify, verify_unless};
use crate::workcell::{ArmBody, Obstacle, ObstacleId, Workcell};

fn cell(problem: &mut Problem) -> &mut Workcell {
    Arc::make_mut(&mut problem.workcell)
}

/// The verdict on the dance with one more obstacle.
fn with_obstacle(obstacle: Obstacle) -> Verdict {
    let mut problem = problem();
    cell(&mut problem).obstacles.push(obstacle);
    verify(&problem, &dance())
}

fn collides(verdict: &Verdict, a: &str, b: &str) {
    let named = |bodies: &[String]| bodies.contains(&a.to_owned()) && bodies.contains(&b.to_owned());
    let found = verdict.violations.iter().any(|v| v.rule == Rule::Collision && named(&v.bodies));
    assert!(found, "{verdict}");
    assert!(verdict.violations.iter().all(|v| v.rule == Rule::Collision), "{verdict}");
}

#[test]
fn a_thin_wall_between_breakpoints_is_found() {
    let wall = with_obstacle(obstacle("wall", [0.004, 0.2, 0.02], [0.27, 0.0, 0.72]));
    collides(&wall, "wall", "red");
    let first = wall.first.expect("a violation");
    // The cube's front passes x = 0.27 half way between 2.5 and 3.5 s.
    assert!(first.t.is_some_and(|t| (2.9..3.05).contains(&t)), "{first:?}");
}

#[test]
fn what_is_held_collides_with_walls_and_things() {
    collides(&with_obstacle(obstacle("post", [0.02, 0.02, 0.1], [0.0, 0.025, 0.68])), "post", "red");
    let mut problem = problem();
    problem.initial[1] =
        crate::problem::InitialPlacement::Resting { pose: at([1.2, 0.04, 0.53]), surface: TABLE_B };
    collides(&verify(&problem, &dance()), "red", "blue");
}

#[test]
fn a_hand_may_touch_what_it_takes_and_nothing_else() {
    let mut problem = problem();
    problem.initial[1] =
        crate::problem::InitialPlacement::Resting { pose: at([-0.12, 0.045, 0.53]), surface: TABLE_A };
    collides(&verify(&problem, &dance()), "left/@tool", "blue");
}

#[test]
fn exemptions_end_with_the_way() {
    // Back into the cube's place after the retreat, the hand where the cube stands.
    let mut right = right_ways();
    right.truncate(9);
    right.extend([(9.0, [1.25, 0.0, 0.53]), (9.5, [1.25, 0.0, 0.53])]);
    let mut problem = problem();
    problem.options.return_home = false;
    let verdict = verify(&problem, &plan([left_ways(), right], actions()));
    assert!(verdict.valid, "{verdict}");
    let mut right = right_ways();
    right.truncate(9);
    right.extend([(9.0, [1.23, 0.0, 0.53]), (9.5, [1.23, 0.0, 0.53])]);
    collides(&verify(&problem, &plan([left_ways(), right], actions())), "right/@tool", "red");
}

#[test]
fn bodies_of_one_arm_and_of_two() {
    // Up into its own beam.
    let mut left = left_ways();
    left[8] = (8.0, [-0.3, 0.0, 1.46]);
    let verdict = verify(&problem(), &plan([left, right_ways()], actions()));
    collides(&verdict, "left/beam", "left/@tool");
    // Allowed for good: of the tool, not of the link that carries it.
    let beam = ArmBody::Link(problem().workcell.arms[0].model.link_index("beam").expect("a beam"));
    let mut allowed = problem();
    cell(&mut allowed).arms[0].exempt_bodies.push((beam, ArmBody::Tool));
    let mut left = left_ways();
    left[8] = (8.0, [-0.3, 0.0, 1.46]);
    let up = plan([left, right_ways()], actions());
    assert!(verify(&allowed, &up).valid);
    // The link that carries the tool is another body of the same group.
    bare_rod(&mut allowed);
    collides(&verify(&allowed, &up), "left/beam", "left/rod");
    // Beam against beam, when the left one stays too long.
    let mut left = left_ways();
    left[8] = (9.0, [1.6, 0.0, 0.9]);
    left[9] = (9.5, [1.6, 0.0, 0.9]);
    let mut problem = problem();
    problem.options.return_home = false;
    let verdict = verify(&problem, &plan([left, right_ways()], actions()));
    collides(&verdict, "left/beam", "right/beam");
}

#[test]
fn allowed_contacts_are_allowed() {
    let wall = || obstacle("wall", [0.004, 0.2, 0.02], [-0.2, 0.0, 0.53]);
    collides(&with_obstacle(wall()), "wall", "left/@tool");
    let mut problem = problem();
    cell(&mut problem).obstacles.push(wall());
    cell(&mut problem).allowed_arm_obstacle.push((LEFT, ArmBody::Tool, ObstacleId(2)));
    assert!(verify(&problem, &dance()).valid);
    bare_rod(&mut problem);
    collides(&verify(&problem, &dance()), "wall", "left/rod");
}

#[test]
fn an_object_may_touch_the_bodies_named_and_no_others() {
    let mut problem = problem();
    // In the way of the hand, not of what it takes.
    problem.initial[1] =
        crate::problem::InitialPlacement::Resting { pose: at([-0.12, 0.045, 0.53]), surface: TABLE_A };
    collides(&verify(&problem, &dance()), "left/@tool", "blue");
    let blue = crate::workcell::ObjectId(1);
    problem.allowed_object_contacts.push((blue, ContactPartner::Arm(LEFT, ArmBody::Tool)));
    let verdict = verify(&problem, &dance());
    assert!(verdict.valid, "{verdict}");
    bare_rod(&mut problem);
    collides(&verify(&problem, &dance()), "left/rod", "blue");
}

/// Gives the left arm's last link, which carries the tool, the tool's shape.
fn bare_rod(problem: &mut Problem) {
    let arm = &mut cell(problem).arms[0];
    let model = Arc::make_mut(&mut arm.model);
    model.links[model.mount].shapes.clone_from(&arm.tool.shapes);
}

#[test]
fn a_carrier_is_exempt_during_the_way_only() {
    // A step on the table beside the place, as high as the carried cube passes by.
    let mut problem = problem();
    let step = block([0.02, 0.6, 0.06], [0.1, 0.0, 0.28]);
    cell(&mut problem).obstacles[0].shapes.push(step);
    // During the retreat the cube stays away from it; carried on in x it would hit.
    let mut left = left_ways();
    left[5] = (3.5, [0.57, 0.0, 0.8]);
    assert!(verify(&problem, &plan([left.clone(), right_ways()], actions())).valid);
    left[4] = (2.4, [-0.03, 0.0, 0.61]);
    left.insert(5, (2.9, [0.2, 0.0, 0.555]));
    collides(&verify(&problem, &plan([left, right_ways()], actions())), "table_a", "red");
}

#[test]
fn depth_and_undecided_band() {
    // The hand passes its table 10 mm above; a plate on the way takes that and more.
    let plate = |over: f64| with_obstacle(obstacle("plate", [0.05, 0.2, 0.02], [-0.2, 0.0, 0.5 + over]));
    assert!(plate(0.0019).valid);
    let undecided = plate(0.00197);
    assert_eq!(undecided.first.map(|v| v.rule), Some(Rule::CollisionUndecided));
    let deep = plate(0.007);
    collides(&deep, "plate", "left/@tool");
    let worst = deep.worst.expect("a violation");
    assert!((worst.amount - 0.007).abs() < 1e-4, "{worst:?}");
}

#[test]
fn what_is_too_fast_for_the_clock_is_judged_all_the_same() {
    // So late, times are 1.5e-11 s apart, in which the hand goes 2 mm, 10 mm above its table.
    for height in [0.525, 0.53, 0.532] {
        let there = |t: f64, x: f64| (t, [x, 0.0, height]);
        let left = vec![(0.0, [-0.3, 0.0, 0.9]), there(1e5 - 0.001, -5e4), there(1e5, 5e4)];
        let right = vec![(0.0, [1.5, 0.0, 0.9]), (1e5, [1.5, 0.0, 0.9])];
        let verdict = verify(&problem(), &plan([left, right], Vec::new()));
        assert!(verdict.violations.iter().any(|v| v.rule == Rule::VelocityLimit), "{verdict}");
        assert!(verdict.min_clearance.is_some(), "{verdict}");
    }
}

#[test]
fn threads_make_no_difference_to_a_verdict() {
    let plates = [0.5, 0.0019, 0.00197, 0.007, 0.05]
        .map(|over| obstacle("plate", [0.05, 0.2, 0.02], [-0.2, 0.0, 0.5 + over]));
    let wall = obstacle("wall", [0.004, 0.2, 0.02], [0.27, 0.0, 0.72]);
    for obstacle in plates.into_iter().chain([wall]) {
        let mut problem = problem();
        cell(&mut problem).obstacles.push(obstacle);
        let (plan, alone) = (dance(), format!("{:?}", verify(&problem, &dance())));
        for threads in [0, 1, 2, 3, 40] {
            let together = verify_unless(&problem, &plan, threads, &|| false);
            assert_eq!(together.map(|verdict| format!("{verdict:?}")).as_ref(), Some(&alone), "{threads}");
        }
    }
}

/// Arbitrary smooth ways of both gantries within 4 s, without objects.
fn swing() -> impl Strategy<Value = Plan> {
    let point = || ([-0.5..0.5_f64, -0.3..0.3, 0.6..1.0], [-0.4..0.4_f64, -0.4..0.4, -0.4..0.4]);
    let arm = || proptest::collection::vec(point(), 3..6);
    (arm(), arm()).prop_map(|(left, right)| {
        let mut plan = plan([left_ways(), right_ways()], Vec::new());
        for (index, points) in [left, right].into_iter().enumerate() {
            let last = points.len() - 1;
            let mut trajectory = trajectory(
                &points.iter().enumerate().map(|(i, (q, _))| (4.0 * i as f64 / last as f64, *q)).collect(),
            );
            for (i, (_, qd)) in points.iter().enumerate().filter(|(i, _)| *i > 0 && *i < last) {
                trajectory.points[i].qd = qd.to_vec();
            }
            plan.arms[index] = trajectory;
        }
        restate(&mut plan);
        plan
    })
}

/// The place of a gantry's hand along a trajectory, by the textbook form of the Hermite curve.
fn hand_at(trajectory: &ArmTrajectory, t: f64) -> Pose {
    let after = trajectory.points.iter().position(|point| point.t > t).unwrap_or(trajectory.points.len() - 1);
    let (from, to) = (&trajectory.points[after - 1], &trajectory.points[after]);
    let h = to.t - from.t;
    let u = (t - from.t) / h;
    let mut q = [0.0; 3];
    for (j, value) in q.iter_mut().enumerate() {
        *value = from.q[j] * (2.0 * u.powi(3) - 3.0 * u * u + 1.0)
            + from.qd[j] * h * (u.powi(3) - 2.0 * u * u + u)
            + to.q[j] * (3.0 * u * u - 2.0 * u.powi(3))
            + to.qd[j] * h * (u.powi(3) - u * u);
    }
    at(q)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]

    #[test]
    fn agrees_with_dense_sampling(plan in swing()) {
        let mut problem = problem();
        problem.objects.clear();
        problem.initial.clear();
        problem.goal.clear();
        problem.options.return_home = false;
        for (index, arm) in plan.arms.iter().enumerate() {
            problem.initial_joints[index] = arm.points[0].q.iter().copied().collect();
        }
        let cell = cell(&mut problem);
        cell.obstacles.clear();
        for arm in &mut cell.arms {
            // The hands alone.
            arm.exempt_groups = vec![(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
            let model = Arc::make_mut(&mut arm.model);
            model.links.iter_mut().for_each(|link| link.shapes.clear());
            arm.limits.iter_mut().for_each(|limits| (limits.velocity, limits.acceleration) = (50.0, 1000.0));
            arm.limits.iter_mut().for_each(|limits| (limits.lower, limits.upper) = (-50.0, 50.0));
        }
        let hands: Vec<ExactShape> = cell.arms.iter().map(|arm| ExactShape::new(&arm.tool.shapes[0])).collect();
        let mut least = f64::INFINITY;
        for i in 0..4000 {
            let t = 4.0 * (f64::from(i) + 0.5) / 4000.0;
            let (left, right) = (hand_at(&plan.arms[0], t), hand_at(&plan.arms[1], t));
            least = least.min(hands[0].signed_distance(&left, &hands[1], &right, 1.0));
        }
        let verdict = verify(&problem, &plan);
        // Between samples the distance changes by less than 2 mm at these speeds.
        if least > 0.0003 {
            prop_assert!(verdict.valid, "{least} {verdict}");
            let clearance = verdict.min_clearance.expect("a clearance").distance_m;
            prop_assert!((clearance - least).abs() < 0.003 || least >= 1.0, "{least} {clearance}");
        }
        if least < -0.002 {
            prop_assert!(!verdict.valid, "{least}");
            prop_assert_eq!(verdict.first.expect("a violation").rule, Rule::Collision);
        }
    }
}
