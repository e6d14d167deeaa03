//! One plan that breaks no rule, and for every rule one that breaks it and is found out by it.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::UnitQuaternion;

use super::gantry::*;
use crate::geometry::{Pose, Vec3};
use crate::plan::{Action, ActionKind, Plan};
use crate::problem::{GoalPlacement, Problem};
use crate::verify::{Rule, Verdict, verify, verify_unless};
use crate::workcell::{Surface, Symmetry, Workcell, symmetry_rotations};

/// The verdict on the dance after `change`.
fn judged(change: impl FnOnce(&mut Problem, &mut Plan)) -> Verdict {
    let (mut problem, mut plan) = (problem(), dance());
    change(&mut problem, &mut plan);
    verify(&problem, &plan)
}

/// The dance after `change` breaks `rule` first.
fn breaks(rule: Rule, change: impl FnOnce(&mut Problem, &mut Plan)) -> Verdict {
    let verdict = judged(change);
    assert!(!verdict.valid, "{verdict}");
    let first = verdict.first.as_ref().expect("a violation");
    assert_eq!(first.rule, rule, "{verdict}");
    verdict
}

/// The dance after `change` breaks `rule` and no other.
fn breaks_only(rule: Rule, change: impl FnOnce(&mut Problem, &mut Plan)) -> Verdict {
    let verdict = breaks(rule, change);
    assert!(verdict.violations.iter().all(|violation| violation.rule == rule), "{verdict}");
    verdict
}

fn cell(problem: &mut Problem) -> &mut Workcell {
    Arc::make_mut(&mut problem.workcell)
}

/// Other ways for both, the figures stated anew.
fn rewind(plan: &mut Plan, left: Ways, right: Ways) {
    plan.arms = vec![trajectory(&left), trajectory(&right)];
    restate(plan);
}

fn with(mut ways: Ways, index: usize, way: (f64, [f64; 3])) -> Ways {
    ways[index] = way;
    ways
}

fn place_mut(plan: &mut Plan) -> (&mut Pose, &mut Pose) {
    match &mut plan.actions[2].kind {
        ActionKind::Place { object_in_tcp, object_pose, .. } => (object_in_tcp, object_pose),
        _ => unreachable!(),
    }
}

#[test]
fn the_dance_is_valid() {
    let verdict = judged(|_, _| {});
    assert!(verdict.valid, "{verdict}");
    assert_eq!(verdict.violation_count, 0);
    let metrics = verdict.metrics.expect("figures");
    assert_eq!((metrics.actions, metrics.steps), (3, 3));
    assert!((metrics.duration_s - 9.5).abs() < 1e-12);
    // The hand passes 10 mm above the table.
    let clearance = verdict.min_clearance.expect("a clearance");
    assert!((clearance.distance_m - 0.01).abs() < 1e-6, "{clearance:?}");
    assert!(
        clearance.bodies.contains(&"left/@tool".to_owned())
            || clearance.bodies.contains(&"right/@tool".to_owned())
    );
}

#[test]
fn another_problem() {
    breaks_only(Rule::ProblemDigest, |_, plan| plan.problem_digest = "sha256:other".into());
}

#[test]
fn too_much_to_read() {
    breaks_only(Rule::TooLarge, |_, plan| {
        let action = plan.actions[0].clone();
        plan.actions = vec![action; 2_001];
    });
    breaks_only(Rule::TooLarge, |_, plan| {
        let point = plan.arms[0].points[0].clone();
        plan.arms[0].points = vec![point; 200_001];
    });
    breaks_only(Rule::TooLarge, |_, plan| {
        for arm in &mut plan.arms {
            arm.points.last_mut().expect("a point").t = 1e9;
        }
    });
}

#[test]
fn what_does_not_fit_the_cell() {
    breaks_only(Rule::Shape, |_, plan| drop(plan.arms.pop()));
    breaks_only(Rule::Shape, |_, plan| plan.arms[1].points.truncate(1));
    breaks_only(Rule::Shape, |_, plan| plan.arms[0].points.clear());
    breaks_only(Rule::Shape, |_, plan| plan.arms[0].points[3].q.push(0.0));
    breaks_only(Rule::Shape, |_, plan| plan.arms[0].points[3].qd.clear());
    breaks_only(Rule::Shape, |_, plan| plan.arms[0].points[9].qdd.clear());
    breaks_only(Rule::Shape, |_, plan| plan.actions[0].object.0 = 2);
    breaks_only(Rule::Shape, |_, plan| {
        if let ActionKind::Pick { arm, .. } = &mut plan.actions[0].kind {
            arm.0 = usize::MAX;
        }
    });
    breaks_only(Rule::Shape, |_, plan| {
        if let ActionKind::Pick { surface, .. } = &mut plan.actions[0].kind {
            surface.0 = 2;
        }
    });
    breaks_only(Rule::Shape, |_, plan| {
        if let ActionKind::Handoff { to_arm, .. } = &mut plan.actions[1].kind {
            *to_arm = LEFT;
        }
    });
}

#[test]
fn numbers_beyond_sense() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        breaks_only(Rule::BadNumber, |_, plan| plan.arms[0].points[2].q[1] = bad);
        breaks_only(Rule::BadNumber, |_, plan| plan.arms[1].points[2].qd[0] = bad);
        breaks_only(Rule::BadNumber, |_, plan| plan.arms[1].points[2].qdd[0] = bad);
        breaks_only(Rule::BadNumber, |_, plan| place_mut(plan).0.translation.vector.x = bad);
    }
    breaks_only(Rule::BadNumber, |_, plan| plan.arms[0].points[2].t = f64::NAN);
    breaks_only(Rule::BadNumber, |_, plan| plan.actions[1].t = f64::NAN);
    breaks_only(Rule::BadNumber, |_, plan| {
        let double = nalgebra::Quaternion::new(2.0, 0.0, 0.0, 0.0);
        place_mut(plan).1.rotation = UnitQuaternion::new_unchecked(double);
    });
}

#[test]
fn times_of_points() {
    breaks_only(Rule::PointTimes, |_, plan| plan.arms[0].points[0].t = 0.1);
    breaks_only(Rule::PointTimes, |_, plan| plan.arms[0].points[0].t = -1.0);
    breaks_only(Rule::PointTimes, |_, plan| plan.arms[0].points[3].t = 1.5005);
    breaks_only(Rule::PointTimes, |_, plan| plan.arms[0].points[3].t = 1.2);
    breaks_only(Rule::Duration, |_, plan| drop(plan.arms[0].points.pop()));
}

#[test]
fn start_end_and_home() {
    breaks_only(Rule::Start, |problem, _| problem.initial_joints[0][1] = 1e-5);
    breaks_only(Rule::ReturnHome, |problem, _| cell(problem).arms[0].home[1] = 1e-5);
    assert!(
        judged(|problem, _| {
            problem.options.return_home = false;
            cell(problem).arms[0].home[1] = 1e-5;
        })
        .valid
    );
    breaks_only(Rule::RestAtEnds, |_, plan| {
        plan.arms[0].points[0].qd[1] = 0.01;
        restate(plan);
    });
    breaks_only(Rule::RestAtEnds, |_, plan| {
        plan.arms[1].points[9].qd[1] = 0.01;
        restate(plan);
    });
}

#[test]
fn limits_at_the_extrema_of_the_curve() {
    // 0.77 m in 1 s from rest to rest: 1.5 * 0.77 m/s in the middle, 6 * 0.77 m/s^2 at the ends.
    breaks_only(Rule::VelocityLimit, |problem, _| cell(problem).arms[0].limits[0].velocity = 1.154);
    assert!(judged(|problem, _| cell(problem).arms[0].limits[0].velocity = 1.155).valid);
    assert!(judged(|problem, _| cell(problem).arms[0].limits[0].velocity = 1.155 / 1.00009).valid);
    breaks_only(Rule::AccelerationLimit, |problem, _| cell(problem).arms[0].limits[0].acceleration = 4.6);
    assert!(judged(|problem, _| cell(problem).arms[0].limits[0].acceleration = 4.62 / 1.0009).valid);
    // An overshoot between two points: from 0 at 0.2 m/s back to 0 within 3 s.
    let overshoot = |problem: &mut Problem, plan: &mut Plan, upper: f64| {
        cell(problem).arms[0].limits[1].upper = upper;
        plan.arms[0].points[9].q[1] = 0.0;
        plan.arms[0].points[8].qd[1] = 0.2;
        restate(plan);
    };
    // v h 4/27 is the top of v s (1 - s/h)^2; on the way in it swings as far to the other side.
    let top = 0.2 * 3.0 * 4.0 / 27.0;
    let verdict = breaks_only(Rule::PositionLimit, |problem, plan| overshoot(problem, plan, top - 1e-4));
    let worst = verdict.worst.expect("a violation");
    assert!((worst.amount - 1e-4).abs() < 1e-9, "{worst:?}");
    assert!(judged(|problem, plan| overshoot(problem, plan, top - 0.9e-6)).valid);
    breaks_only(Rule::AccelerationValue, |_, plan| plan.arms[1].points[2].qdd[0] += 0.1);
}

#[test]
fn order_of_actions_and_steps() {
    breaks_only(Rule::ActionTime, |_, plan| plan.actions.swap(0, 1));
    breaks_only(Rule::ActionTime, |_, plan| plan.actions[2].t = 10.0);
    breaks_only(Rule::ActionTime, |_, plan| plan.actions[0].t = -0.1);
    breaks_only(Rule::StepNumber, |_, plan| plan.actions.iter_mut().for_each(|action| action.step += 1));
    breaks_only(Rule::StepNumber, |_, plan| plan.actions[2].step = 4);
    breaks(Rule::StepNumber, |_, plan| {
        plan.actions[2].step = 1;
        restate(plan);
    });
    breaks(Rule::StepTime, |_, plan| {
        plan.actions[1].step = 1;
        plan.actions[2].step = 2;
        restate(plan);
    });
}

#[test]
fn two_at_a_time() {
    let second = |plan: &Plan, arm, object| {
        let kind = ActionKind::Pick { arm, object_in_tcp: grip(1.0), surface: TABLE_A };
        Action { object, kind, ..plan.actions[0].clone() }
    };
    breaks(Rule::ArmTwiceInStep, |_, plan| {
        plan.actions.insert(1, second(plan, LEFT, BLUE));
        restate(plan);
    });
    breaks(Rule::ObjectTwiceInStep, |_, plan| {
        plan.actions.insert(1, second(plan, RIGHT, RED));
        restate(plan);
    });
    // The same hand again before it is empty.
    breaks(Rule::HandFull, |_, plan| {
        plan.actions.insert(1, Action { step: 2, t: 4.0, ..second(plan, LEFT, BLUE) });
        plan.actions[2].step = 3;
        plan.actions[3].step = 4;
        restate(plan);
    });
}

#[test]
fn rest_at_actions() {
    breaks(Rule::RestAtAction, |_, plan| plan.actions[0].t = 2.01);
    breaks_only(Rule::Dwell, |problem, _| cell(problem).arms[0].tool.grasp_time = 0.1);
    assert!(
        judged(|problem, plan| {
            cell(problem).arms[0].tool.grasp_time = 0.3;
            // Acts 0.3 s earlier and moves on as before.
            plan.actions[0].t = 1.7;
            plan.actions[1].t = 4.7;
        })
        .valid
    );
}

#[test]
fn who_has_what() {
    breaks(Rule::PickState, |problem, plan| {
        shorten_hands(problem);
        if let ActionKind::Pick { surface, .. } = &mut plan.actions[0].kind {
            *surface = TABLE_B;
        }
    });
    breaks(Rule::HandEmpty, |_, plan| {
        if let ActionKind::Place { arm, .. } = &mut plan.actions[2].kind {
            *arm = LEFT;
        }
    });
    breaks(Rule::HandEmpty, |_, plan| plan.actions[2].object = BLUE);
}

#[test]
fn stated_poses_are_the_real_ones() {
    let small = Vec3::new(0.0, 0.0, 0.0009);
    let turned = |degrees: f64| UnitQuaternion::from_axis_angle(&Vec3::z_axis(), degrees.to_radians());
    let pick = |plan: &mut Plan, change: &dyn Fn(&mut Pose)| {
        if let ActionKind::Pick { object_in_tcp, .. } = &mut plan.actions[0].kind {
            change(object_in_tcp);
        }
    };
    assert!(judged(|_, plan| pick(plan, &|pose| pose.translation.vector += small)).valid);
    breaks_only(Rule::GraspPose, |_, plan| pick(plan, &|pose| pose.translation.vector += small * 1.2));
    assert!(judged(|_, plan| pick(plan, &|pose| pose.rotation *= turned(0.45))).valid);
    breaks_only(Rule::GraspPose, |_, plan| pick(plan, &|pose| pose.rotation *= turned(0.55)));
    breaks_only(Rule::GraspPose, |_, plan| place_mut(plan).0.translation.vector += small * 1.2);
    breaks_only(Rule::GraspPose, |_, plan| {
        if let ActionKind::Handoff { to_object_in_tcp, .. } = &mut plan.actions[1].kind {
            to_object_in_tcp.translation.vector += small * 1.2;
        }
    });
    assert!(judged(|_, plan| place_mut(plan).1.translation.vector += small).valid);
    breaks_only(Rule::PlacePose, |_, plan| place_mut(plan).1.translation.vector += small * 1.2);
    breaks_only(Rule::UnknownGrasp, |problem, _| drop(problem.objects[0].grasps.remove(0)));
    breaks_only(Rule::UnknownGrasp, |problem, _| {
        problem.objects[0].grasps[1].object_in_tcp.rotation *= turned(90.0);
    });
    breaks_only(Rule::UnknownGrasp, |problem, _| problem.objects[0].grasps[0].opening = 0.11);
}

#[test]
fn released_things_rest() {
    let lower = |plan: &mut Plan, down: f64| {
        let mut right = right_ways();
        for index in [6, 7, 8] {
            right[index].1[2] -= down;
        }
        rewind(plan, left_ways(), right);
        place_mut(plan).1.translation.vector.z -= down;
    };
    assert!(
        judged(|problem, plan| {
            lower(plan, -0.0015);
            problem.goal[0] = GoalPlacement::Surface(TABLE_B);
        })
        .valid
    );
    for down in [-0.0025, 0.0025] {
        breaks_only(Rule::Resting, |problem, plan| {
            lower(plan, down);
            problem.goal[0] = GoalPlacement::Surface(TABLE_B);
        });
    }
    breaks_only(Rule::Resting, |problem, _| cell(problem).surfaces[1].half_extents[1] = 0.027);
    // On two surfaces at once; beside the second it is on one.
    let second = |problem: &mut Problem, y: f64| {
        let surface = problem.workcell.surfaces[1].clone();
        let pose = at([1.2, y, 0.5]);
        cell(problem).surfaces.push(Surface { id: "c".into(), pose, ..surface });
    };
    breaks_only(Rule::Resting, |problem, _| second(problem, 0.1));
    assert!(judged(|problem, _| second(problem, 0.5)).valid);
}

#[test]
fn capacities_bind() {
    breaks_only(Rule::Capacity, |problem, _| cell(problem).surfaces[1].capacity = Some(0));
    assert!(judged(|problem, _| cell(problem).surfaces[1].capacity = Some(1)).valid);
}

#[test]
fn ways_are_straight() {
    // 10 mm sideways over the last 80 mm.
    breaks_only(Rule::Approach, |_, plan| {
        rewind(plan, with(left_ways(), 1, (1.0, [-0.13, 0.0125, 0.53])), right_ways());
    });
    assert!(
        judged(|_, plan| {
            rewind(plan, with(left_ways(), 1, (1.0, [-0.13, 0.004, 0.53])), right_ways());
        })
        .valid
    );
    // From above, though the tool lies.
    breaks_only(Rule::Approach, |problem, plan| {
        shorten_hands(problem);
        rewind(plan, with(left_ways(), 1, (1.0, [-0.03, 0.0, 0.7])), right_ways());
    });
    breaks_only(Rule::Retreat, |_, plan| {
        rewind(plan, with(left_ways(), 4, (2.5, [-0.03, 0.03, 0.63])), right_ways());
    });
    breaks_only(Rule::Approach, |_, plan| {
        rewind(plan, left_ways(), with(right_ways(), 5, (7.0, [1.26, 0.0, 0.63])));
    });
    breaks_only(Rule::Retreat, |_, plan| {
        rewind(plan, left_ways(), with(right_ways(), 8, (8.5, [1.33, 0.04, 0.53])));
    });
    // Far enough is as much as the object asks for.
    breaks_only(Rule::Retreat, |problem, _| problem.objects[0].retreat = 0.14);
    breaks_only(Rule::Approach, |problem, _| problem.objects[0].approach = 0.14);
}

#[test]
fn handoffs_are_one_at_a_time() {
    breaks_only(Rule::GiverMoves, |_, plan| {
        rewind(plan, with(left_ways(), 5, (4.3, [0.57, 0.0, 0.8])), right_ways());
    });
    breaks_only(Rule::ReceiverMoves, |_, plan| {
        rewind(plan, left_ways(), with(right_ways(), 4, (5.2, [0.63, 0.0, 0.8])));
    });
    breaks_only(Rule::Retreat, |_, plan| {
        rewind(plan, with(left_ways(), 7, (5.5, [0.47, 0.0, 0.85])), right_ways());
    });
}

#[test]
fn goals_are_met() {
    let set = |problem: &mut Problem, pose: Pose| {
        problem.goal[0] = GoalPlacement::Pose { pose, surface: TABLE_B };
    };
    breaks_only(Rule::Goal, |problem, _| set(problem, at([1.2, 0.0011, 0.53])));
    assert!(judged(|problem, _| set(problem, at([1.2, 0.0009, 0.53]))).valid);
    breaks_only(Rule::Goal, |problem, _| problem.goal[1] = GoalPlacement::Surface(TABLE_B));
    assert!(judged(|problem, _| problem.goal[1] = GoalPlacement::Surface(TABLE_A)).valid);
    let quarter = UnitQuaternion::from_axis_angle(&Vec3::z_axis(), std::f64::consts::FRAC_PI_2);
    let over = UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI);
    let slanted = UnitQuaternion::from_scaled_axis(Vec3::new(0.1, 0.2, 0.3));
    let turned = |rotation| Pose::from_parts(at([1.2, 0.0, 0.53]).translation, rotation);
    for (symmetry, rotation, met) in [
        (Symmetry::None, quarter, false),
        (Symmetry::Box, quarter, true),
        (Symmetry::Box, slanted, false),
        (Symmetry::CylinderZ, quarter, true),
        (Symmetry::CylinderZ, over * quarter, true),
        (Symmetry::CylinderZ, slanted, false),
        (Symmetry::Sphere, slanted, true),
    ] {
        let verdict = judged(|problem, _| {
            set(problem, turned(rotation));
            problem.objects[0].symmetry = symmetry;
            if symmetry == Symmetry::Box {
                let rotations = symmetry_rotations(symmetry, &problem.objects[0].shapes).unwrap();
                problem.objects[0].symmetry_rotations = rotations;
            }
        });
        assert_eq!(verdict.valid, met, "{symmetry:?} {verdict}");
        assert!(met || verdict.violations.iter().all(|violation| violation.rule == Rule::Goal));
    }
    // Still in a hand.
    breaks(Rule::Goal, |problem, plan| {
        problem.goal[0] = GoalPlacement::Anywhere;
        plan.actions.pop();
        let right = with(right_ways(), 5, (7.0, [1.5, 0.0, 0.9]));
        rewind(plan, left_ways(), [&right[..6], &[(9.5, [1.5, 0.0, 0.9])]].concat());
    });
}

#[test]
fn figures_are_right() {
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.arc_length *= 1.0 + 1e-5);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.arc_length = f64::NAN);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.duration_s += 1e-3);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.duration_synchronous_s += 1e-3);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.actions = 4);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.steps = 2);
    breaks_only(Rule::Metrics, |_, plan| plan.metrics.steps_lower_bound = 4);
}

#[test]
fn tells_in_words_and_json() {
    let verdict = breaks_only(Rule::Goal, |problem, _| problem.goal[1] = GoalPlacement::Surface(TABLE_B));
    let text = verdict.to_string();
    assert!(text.starts_with("invalid: 1 violation\nfirst: goal at t=9.500 s (blue): "), "{text}");
    let json = serde_json::to_value(&verdict).expect("a document");
    assert_eq!(json["valid"], false);
    assert_eq!(json["first"]["rule"], "goal");
    assert_eq!(json["first"]["bodies"][0], "blue");
    let verification = verdict.verification();
    assert!(!verification.valid && verification.bodies.is_some());
}

#[test]
fn it_can_be_stopped() {
    let (problem, plan) = (problem(), dance());
    let asked = AtomicUsize::new(0);
    let answer = |threads: usize, stops: bool| {
        asked.store(0, Ordering::Relaxed);
        verify_unless(&problem, &plan, threads, &|| {
            asked.fetch_add(1, Ordering::Relaxed);
            stops
        })
    };
    assert!(answer(1, true).is_none());
    assert_eq!(asked.load(Ordering::Relaxed), 1);
    assert!(answer(3, true).is_none());
    for threads in [1, 3] {
        assert!(answer(threads, false).is_some_and(|verdict| verdict.valid));
        assert!(asked.load(Ordering::Relaxed) > 0);
    }
}
