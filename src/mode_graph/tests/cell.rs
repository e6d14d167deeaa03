//! Cells made by hand, and a reach that is known.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::geometry::{PlacedShape, Pose, Shape, Vec3, pose_from_parts};
use crate::kinematics::{ArmModel, Config, JointLimits, NoMeshes, library};
use crate::mode_graph::{HandoffWitness, Hold, Reach, RestAction, RestContact};
use crate::problem::{GoalPlacement, InitialPlacement, Options, Problem};
use crate::workcell::{
    Arm, ArmId, GraspGenerator, ObjectId, ObjectModel, Surface, SurfaceId, Symmetry, Tool, Workcell,
};

pub(super) fn at(x: f64, y: f64, yaw: f64) -> Pose {
    pose_from_parts([x, y, 0.03], [0.0, 0.0, (0.5 * yaw).sin(), (0.5 * yaw).cos()])
}

/// A cell of iiwa arms on the floor, tables on the floor and 6 cm cubes.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// Arm bases.
    pub(super) arms: Vec<[f64; 2]>,
    /// Centres and half extents of the tables.
    pub(super) tables: Vec<([f64; 2], [f64; 2])>,
    /// For each cube: table, start, goal table, goal (table frame).
    pub(super) cubes: Vec<Cube>,
}

/// Where a cube starts and must end.
#[derive(Debug, Clone)]
pub(super) struct Cube {
    pub(super) start: (usize, Pose),
    pub(super) goal: GoalPlacement,
    pub(super) class: usize,
    pub(super) symmetry: Symmetry,
}

impl Cube {
    pub(super) fn new(start: (usize, Pose), goal: (usize, Pose)) -> Self {
        let goal = GoalPlacement::Pose { pose: goal.1, surface: SurfaceId(goal.0) };
        Self { start, goal, class: 0, symmetry: Symmetry::None }
    }
}

pub(super) fn iiwa() -> ArmModel {
    let robot = library("iiwa14").unwrap();
    ArmModel::from_urdf("iiwa14", robot.urdf, "flange", &BTreeMap::new(), &NoMeshes).unwrap().0
}

impl Cell {
    pub(super) fn problem(&self) -> Problem {
        let model = Arc::new(iiwa());
        let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
        let finger = |y: f64| PlacedShape {
            shape: Shape::Box { half_extents: Vec3::new(0.008, 0.006, 0.019) },
            pose: pose_from_parts([0.0, y, 0.119], [0.0, 0.0, 0.0, 1.0]),
        };
        let arm = |(index, base): (usize, &[f64; 2])| Arm {
            id: format!("arm{index}"),
            model: model.clone(),
            base: pose_from_parts([base[0], base[1], -0.25], [0.0, 0.0, 0.0, 1.0]),
            tool: Tool {
                tcp: pose_from_parts([0.0, 0.0, 0.15], [0.0, 0.0, 0.0, 1.0]),
                shapes: vec![finger(0.037), finger(-0.037)],
                max_opening: 0.1,
                grasp_time: 0.0,
            },
            limits: limits.clone(),
            home: Config::from_elem(0.0, 7),
            exempt_groups: Vec::new(),
            exempt_bodies: Vec::new(),
            hand_groups: Vec::new(),
        };
        let surface = |(index, (centre, half)): (usize, &([f64; 2], [f64; 2]))| Surface {
            id: format!("table{index}"),
            carrier: None,
            pose: pose_from_parts([centre[0], centre[1], 0.0], [0.0, 0.0, 0.0, 1.0]),
            half_extents: *half,
            capacity: None,
        };
        let workcell = Workcell {
            arms: self.arms.iter().enumerate().map(arm).collect(),
            obstacles: Vec::new(),
            surfaces: self.tables.iter().enumerate().map(surface).collect(),
            allowed_arm_obstacle: Vec::new(),
            allowed_arm_arm: Vec::new(),
        };
        let shapes = vec![PlacedShape {
            shape: Shape::Box { half_extents: Vec3::repeat(0.03) },
            pose: Pose::identity(),
        }];
        let mut grasps = GraspGenerator::BoxFaces { depth: None }.expand(&shapes, 0.1).unwrap();
        grasps.extend(GraspGenerator::BoxEdges { depth: None }.expand(&shapes, 0.1).unwrap());
        let object = |(index, cube): (usize, &Cube)| ObjectModel {
            id: format!("cube{index}"),
            shapes: shapes.clone(),
            mass: 0.1,
            symmetry: cube.symmetry,
            symmetry_rotations: crate::workcell::symmetry_rotations(cube.symmetry, &shapes).unwrap(),
            grasps: grasps.clone(),
            approach: 0.08,
            retreat: 0.08,
            class: cube.class,
        };
        let initial =
            |cube: &Cube| InitialPlacement::Resting { pose: cube.start.1, surface: SurfaceId(cube.start.0) };
        Problem {
            name: String::new(),
            digest: String::new(),
            workcell_digest: String::new(),
            initial_joints: workcell.arms.iter().map(|arm| arm.home.clone()).collect(),
            workcell: Arc::new(workcell),
            objects: self.cubes.iter().enumerate().map(object).collect(),
            initial: self.cubes.iter().map(initial).collect(),
            goal: self.cubes.iter().map(|cube| cube.goal.clone()).collect(),
            allowed_object_contacts: Vec::new(),
            options: Options::default(),
        }
    }

    /// Two arms in a row, each with a table of its own beside it.
    pub(super) fn pair(cubes: Vec<Cube>) -> Self {
        let half = [0.2, 0.2];
        Self {
            arms: vec![[0.0, 0.0], [1.1, 0.0]],
            tables: vec![([-0.56, 0.0], half), ([1.66, 0.0], half)],
            cubes,
        }
    }
}

/// An arm reaches what is at most `reach` (m, seen from above) from its base, in grasps whose
/// approach points down as much as `steepest` (cosine); two arms meet when their bases are at most
/// `meet` apart, in grasps whose approaches are at least a right angle apart in the object.
pub(super) struct PlainReach<'a> {
    pub(super) problem: &'a Problem,
    pub(super) reach: f64,
    pub(super) steepest: f64,
    pub(super) meet: f64,
    /// Objects closer than this (m) are in the way of hands that come from their side.
    pub(super) elbow_room: f64,
    /// Questions asked so far.
    pub(super) asked: usize,
}

impl<'a> PlainReach<'a> {
    pub(super) fn new(problem: &'a Problem) -> Self {
        Self { problem, reach: 0.85, steepest: 0.7, meet: 1.6, elbow_room: 0.0, asked: 0 }
    }
}

impl Reach for PlainReach<'_> {
    fn possible_holds(
        &mut self,
        _: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        _: SurfaceId,
    ) -> Vec<Hold> {
        self.asked += 1;
        let base = self.problem.workcell.arms[arm.0].base.translation.vector;
        let place = pose.translation.vector;
        if (base.x - place.x).hypot(base.y - place.y) > self.reach {
            return Vec::new();
        }
        let grasps = self.problem.objects[object.0].grasps.iter().enumerate();
        grasps
            .map(|(number, grasp)| Hold { grasp: Some(number), object_in_tcp: grasp.object_in_tcp })
            .filter(|hold| -((pose * hold.object_in_tcp.inverse()).rotation * Vec3::z()).z >= self.steepest)
            .collect()
    }

    fn has_hold(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
        hold: &Hold,
    ) -> bool {
        self.possible_holds(action, arm, object, pose, surface).iter().any(|known| known.grasp == hold.grasp)
    }

    fn contact(&mut self, contact: &RestContact) -> Option<(Hold, Config)> {
        let RestContact { action, arm, object, pose, surface } = contact;
        let holds = self.possible_holds(*action, *arm, *object, pose, *surface);
        holds.first().map(|hold| (*hold, Config::from_elem(0.0, 7)))
    }

    fn is_clear(&mut self, contact: &RestContact, hold: &Hold, _: ObjectId, pose: &Pose) -> bool {
        self.asked += 1;
        // The hand comes from where the approach points away from.
        let towards = contact.pose * hold.object_in_tcp.inverse() * Vec3::z();
        let there = pose.translation.vector - contact.pose.translation.vector;
        there.norm() > self.elbow_room || towards.xy().dot(&there.xy()) > -1e-6
    }

    fn handoff(
        &mut self,
        giver: ArmId,
        receiver: ArmId,
        _: ObjectId,
        giver_holds: &[Hold],
        receiver_holds: &[Hold],
    ) -> Option<HandoffWitness> {
        self.asked += 1;
        let base = |arm: ArmId| self.problem.workcell.arms[arm.0].base.translation.vector;
        if (base(giver) - base(receiver)).norm() > self.meet {
            return None;
        }
        let approach = |hold: &Hold| hold.object_in_tcp.rotation.inverse() * Vec3::z();
        let pairs = giver_holds.iter().flat_map(|g| receiver_holds.iter().map(move |r| (g, r)));
        pairs
            .filter(|(g, r)| approach(g).dot(&approach(r)) < 1e-6)
            .map(|(g, r)| HandoffWitness {
                giver_q: Config::from_elem(0.0, 7),
                receiver_q: Config::from_elem(0.0, 7),
                giver_hold: *g,
                receiver_hold: *r,
            })
            .next()
    }
}
