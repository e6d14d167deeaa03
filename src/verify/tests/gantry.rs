//! A cell of two gantries, each three sliding joints and a hand, for which valid plans can be
//! written in closed form: the joint values are the tool's position in the world.

use std::sync::Arc;

use nalgebra::{Translation3, Unit, UnitQuaternion};

use crate::geometry::{PlacedShape, Pose, Shape, Vec3};
use crate::kinematics::{ArmModel, Joint, JointLimits, Link, LinkMotion};
use crate::plan::{Action, ActionKind, ArmTrajectory, Metrics, Plan, StepsProof, TrajectoryPoint};
use crate::problem::{GoalPlacement, InitialPlacement, Options, Problem};
use crate::workcell::{
    Arm, ArmId, Grasp, ObjectId, ObjectModel, Obstacle, ObstacleId, Surface, SurfaceId, Symmetry, Tool,
    Workcell,
};

pub const LEFT: ArmId = ArmId(0);
pub const RIGHT: ArmId = ArmId(1);
pub const RED: ObjectId = ObjectId(0);
pub const BLUE: ObjectId = ObjectId(1);
pub const TABLE_A: SurfaceId = SurfaceId(0);
pub const TABLE_B: SurfaceId = SurfaceId(1);

/// A box by its full extents, at `position`.
pub fn block(size: [f64; 3], position: [f64; 3]) -> PlacedShape {
    let half_extents = Vec3::from(size) * 0.5;
    PlacedShape { shape: Shape::Box { half_extents }, pose: at(position) }
}

/// A pose without turn.
pub fn at(position: [f64; 3]) -> Pose {
    Pose::from_parts(Translation3::new(position[0], position[1], position[2]), UnitQuaternion::identity())
}

/// The turn that lays the tool's z along x (`sign` 1) or against it (-1).
pub fn lying(sign: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vec3::y_axis(), sign * std::f64::consts::FRAC_PI_2)
}

/// The red cube's frame in the tool of a gantry: its centre 30 mm before the tool.
pub fn grip(sign: f64) -> Pose {
    let tool = Pose::from_parts(Translation3::identity(), lying(sign));
    tool.inverse() * at([0.03 * sign, 0.0, 0.0])
}

/// Three sliding joints along x, y, z; a beam above on the first.
pub fn gantry_model(sign: f64) -> ArmModel {
    let mut links = vec![Link {
        name: "base".into(),
        parent: None,
        origin: Pose::identity(),
        motion: LinkMotion::Held,
        group: 0,
        shapes: vec![block([0.1, 0.1, 0.1], [-sign, 0.0, 3.0])],
    }];
    for (index, axis) in [Vec3::x(), Vec3::y(), Vec3::z()].into_iter().enumerate() {
        let axis = Unit::new_normalize(axis);
        links.push(Link {
            name: ["beam", "trolley", "rod"][index].into(),
            parent: Some(index),
            origin: Pose::identity(),
            motion: LinkMotion::Prismatic { axis, joint: index, multiplier: 1.0, offset: 0.0 },
            group: index + 1,
            shapes: if index == 0 {
                vec![block([0.1, 1.0, 0.1], [-0.1 * sign, 0.0, 1.5])]
            } else {
                Vec::new()
            },
        });
    }
    let limits = JointLimits { lower: -2.0, upper: 2.0, velocity: 2.0, acceleration: 20.0 };
    let joints = (0..3).map(|index| Joint {
        name: ["x", "y", "z"][index].into(),
        link: index + 1,
        limits,
        limit_fault: None,
    });
    ArmModel::new("gantry".into(), links, joints.collect(), 3)
}

/// A gantry whose hand lies along x.
pub fn gantry(id: &str, sign: f64, home: [f64; 3]) -> Arm {
    let model = gantry_model(sign);
    let limits = model.joints.iter().map(|joint| joint.limits).collect();
    // From 100 mm behind the tool's centre point to 10 mm before it: into what is held.
    let hand = block([0.11, 0.04, 0.04], [-0.045 * sign, 0.0, 0.0]);
    Arm {
        id: id.into(),
        model: Arc::new(model),
        base: Pose::identity(),
        tool: Tool {
            tcp: Pose::from_parts(Translation3::identity(), lying(sign)),
            shapes: vec![hand],
            max_opening: 0.1,
            grasp_time: 0.0,
        },
        limits,
        home: home.into_iter().collect(),
        exempt_groups: vec![(0, 1), (1, 2), (2, 3)],
        exempt_bodies: Vec::new(),
        hand_groups: vec![3],
    }
}

fn cube(id: &str) -> ObjectModel {
    let grasp = |id: &str, sign| Grasp { id: id.into(), object_in_tcp: grip(sign), opening: 0.06 };
    ObjectModel {
        id: id.into(),
        shapes: vec![block([0.06; 3], [0.0; 3])],
        mass: 0.1,
        symmetry: Symmetry::None,
        symmetry_rotations: vec![UnitQuaternion::identity()],
        grasps: vec![grasp("from_left", 1.0), grasp("from_right", -1.0)],
        approach: 0.08,
        retreat: 0.08,
        class: 0,
    }
}

/// An obstacle of one box.
pub fn obstacle(id: &str, size: [f64; 3], position: [f64; 3]) -> Obstacle {
    Obstacle { id: id.into(), shapes: vec![block(size, [0.0; 3])], pose: at(position) }
}

/// Two gantries over two tables; the red cube shall go from the left one to the right one, and
/// the blue one may stay.
pub fn problem() -> Problem {
    let surface = |id: &str, carrier, x| Surface {
        id: id.into(),
        carrier: Some(ObstacleId(carrier)),
        pose: at([x, 0.0, 0.5]),
        half_extents: [0.3, 0.3],
        capacity: None,
    };
    let workcell = Workcell {
        arms: vec![gantry("left", 1.0, [-0.3, 0.0, 0.9]), gantry("right", -1.0, [1.5, 0.0, 0.9])],
        obstacles: vec![
            obstacle("table_a", [0.6, 0.6, 0.5], [0.0, 0.0, 0.25]),
            obstacle("table_b", [0.6, 0.6, 0.5], [1.2, 0.0, 0.25]),
        ],
        surfaces: vec![surface("a", 0, 0.0), surface("b", 1, 1.2)],
        allowed_arm_obstacle: Vec::new(),
        allowed_arm_arm: Vec::new(),
    };
    let resting = |position, surface| InitialPlacement::Resting { pose: at(position), surface };
    Problem {
        name: String::new(),
        digest: "sha256:gantries".into(),
        workcell_digest: "sha256:gantries".into(),
        initial_joints: workcell.arms.iter().map(|arm| arm.home.clone()).collect(),
        workcell: Arc::new(workcell),
        objects: vec![cube("red"), cube("blue")],
        initial: vec![resting([0.0, 0.0, 0.53], TABLE_A), resting([0.0, 0.2, 0.53], TABLE_A)],
        goal: vec![
            GoalPlacement::Pose { pose: at([1.2, 0.0, 0.53]), surface: TABLE_B },
            GoalPlacement::Anywhere,
        ],
        allowed_object_contacts: Vec::new(),
        options: Options { return_home: true, ..Options::default() },
    }
}

/// Takes back the hands so that they stay 5 mm clear of what they hold.
pub fn shorten_hands(problem: &mut Problem) {
    for (arm, sign) in Arc::make_mut(&mut problem.workcell).arms.iter_mut().zip([1.0, -1.0]) {
        arm.tool.shapes = vec![block([0.095, 0.04, 0.04], [-0.0525 * sign, 0.0, 0.0])];
    }
}

/// A gantry's ways: from rest to rest through these points.
pub type Ways = Vec<(f64, [f64; 3])>;

/// The left gantry picks at 2 s, hands over at 5 s and goes home.
pub fn left_ways() -> Ways {
    vec![
        (0.0, [-0.3, 0.0, 0.9]),
        (1.0, [-0.13, 0.0, 0.53]),
        (1.5, [-0.03, 0.0, 0.53]),
        (2.0, [-0.03, 0.0, 0.53]),
        (2.5, [-0.03, 0.0, 0.63]),
        (3.5, [0.57, 0.0, 0.8]),
        (5.0, [0.57, 0.0, 0.8]),
        (5.5, [0.47, 0.0, 0.8]),
        (6.5, [-0.3, 0.0, 0.9]),
        (9.5, [-0.3, 0.0, 0.9]),
    ]
}

/// The right gantry receives at 5 s and places at 8 s.
pub fn right_ways() -> Ways {
    vec![
        (0.0, [1.5, 0.0, 0.9]),
        (3.0, [1.5, 0.0, 0.9]),
        (4.0, [0.73, 0.0, 0.8]),
        (4.5, [0.63, 0.0, 0.8]),
        (6.0, [0.63, 0.0, 0.8]),
        (7.0, [1.23, 0.0, 0.63]),
        (7.5, [1.23, 0.0, 0.53]),
        (8.0, [1.23, 0.0, 0.53]),
        (8.5, [1.33, 0.0, 0.53]),
        (9.5, [1.5, 0.0, 0.9]),
    ]
}

/// The three actions along these ways.
pub fn actions() -> Vec<Action> {
    let action = |step, t, kind| Action { step, t, object: RED, kind };
    vec![
        action(1, 2.0, ActionKind::Pick { arm: LEFT, object_in_tcp: grip(1.0), surface: TABLE_A }),
        action(
            2,
            5.0,
            ActionKind::Handoff {
                arm: LEFT,
                to_arm: RIGHT,
                object_in_tcp: grip(1.0),
                to_object_in_tcp: grip(-1.0),
            },
        ),
        action(
            3,
            8.0,
            ActionKind::Place {
                arm: RIGHT,
                object_in_tcp: grip(-1.0),
                object_pose: at([1.2, 0.0, 0.53]),
                surface: TABLE_B,
            },
        ),
    ]
}

/// Cubics from rest to rest.
pub fn trajectory(ways: &Ways) -> ArmTrajectory {
    let point =
        |&(t, q): &(f64, [f64; 3])| TrajectoryPoint { t, q: q.to_vec(), qd: vec![0.0; 3], qdd: vec![0.0; 3] };
    ArmTrajectory { points: ways.iter().map(point).collect() }
}

/// A plan with these ways and actions whose stated figures are right.
pub fn plan(ways: [Ways; 2], actions: Vec<Action>) -> Plan {
    let mut plan = Plan {
        problem_digest: "sha256:gantries".into(),
        revision: 1,
        metrics: Metrics {
            duration_s: 0.0,
            duration_synchronous_s: 0.0,
            arc_length: 0.0,
            actions: 0,
            steps: 0,
            mode_graph_optimum: None,
            steps_lower_bound: 0,
            steps_proof: StepsProof::None,
            found_after_s: 0.0,
        },
        arms: ways.iter().map(trajectory).collect(),
        actions,
        verification: None,
    };
    restate(&mut plan);
    plan
}

/// The whole dance.
pub fn dance() -> Plan {
    plan([left_ways(), right_ways()], actions())
}

/// States figures and accelerations anew, by chords and differences.
pub fn restate(plan: &mut Plan) {
    let mut longest = 0.0_f64;
    for arm in &mut plan.arms {
        let mut length = 0.0;
        for index in 0..arm.points.len() - 1 {
            let (from, to) = (arm.points[index].clone(), &arm.points[index + 1]);
            let h = to.t - from.t;
            let place = |s: f64| -> Vec<f64> {
                let u = s / h;
                (0..from.q.len())
                    .map(|j| {
                        from.q[j] * (1.0 + 2.0 * u) * (1.0 - u).powi(2)
                            + to.q[j] * u * u * (3.0 - 2.0 * u)
                            + h * u * (1.0 - u) * (from.qd[j] * (1.0 - u) - to.qd[j] * u)
                    })
                    .collect()
            };
            let chords = 2000;
            let mut last = place(0.0);
            for i in 1..=chords {
                let next = place(h * f64::from(i) / f64::from(chords));
                length += last.iter().zip(&next).map(|(a, b)| (b - a).powi(2)).sum::<f64>().sqrt();
                last = next;
            }
            let bend =
                |j: usize| 6.0 * (to.q[j] - from.q[j]) / (h * h) - (4.0 * from.qd[j] + 2.0 * to.qd[j]) / h;
            arm.points[index].qdd = (0..from.q.len()).map(bend).collect();
        }
        longest = longest.max(length);
    }
    let last = |arm: &ArmTrajectory| arm.points.last().map_or(0.0, |point| point.t);
    plan.metrics.duration_s = plan.arms.iter().map(last).fold(0.0, f64::max);
    plan.metrics.duration_synchronous_s = plan.metrics.duration_s;
    plan.metrics.arc_length = longest;
    plan.metrics.actions = plan.actions.len();
    let mut steps: Vec<usize> = plan.actions.iter().map(|action| action.step).collect();
    steps.sort_unstable();
    steps.dedup();
    plan.metrics.steps = steps.len();
}
