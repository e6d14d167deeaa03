//! Arms among boxes, and against each other.

use std::hint::black_box;
use std::sync::Arc;

use parry3d_f64::bounding_volume::{Aabb, BoundingVolume as _};
use parry3d_f64::math::{Pose as ParryPose, Rotation, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::{Capsule, Cuboid, Shape as _};
use rand::Rng as _;

use super::{random_config, shipped};
use crate::collision::{CollisionWorld, Exemption, Resting, Scene, StraightMotion, Taking};
use crate::geometry::{PlacedShape, Pose, Shape, Vec3, pose_from_parts};
use crate::kinematics::Config;
use crate::run::Rng;
use crate::workcell::{Arm, ArmId, Obstacle};

/// Random configurations, and as many along valid edges.
const CONFIGURATIONS: usize = 256;

/// One iiwa14 of nine capsules among ten boxes.
#[derive(Debug)]
pub struct OneArm {
    world: CollisionWorld,
    arm: Arm,
    resting: Resting,
    random: Vec<Config>,
    targets: Vec<Pose>,
    along: Vec<Config>,
    edges: Vec<StraightMotion>,
    baseline: Baseline,
}

impl OneArm {
    /// How many configurations a call works on.
    pub const CONFIGURATIONS: usize = CONFIGURATIONS;
    /// And how many edges, of up to 0.3 rad in each joint.
    pub const EDGES: usize = CONFIGURATIONS / 8;
    /// And how many poses of the TCP.
    pub const TARGETS: usize = 32;

    /// Draws boxes, configurations and valid edges; `None` without the scenario.
    pub fn new(rng: &mut Rng) -> Option<Self> {
        let mut problem = shipped("in_place_swap/1x2")?;
        let mut workcell = problem.workcell.as_ref().clone();
        // Seven links, base and a tool of one capsule.
        if let Some(arm) = workcell.arms.first_mut() {
            let shape = Shape::Capsule { radius: 0.04, half_length: 0.05 };
            arm.tool.shapes =
                vec![PlacedShape { shape, pose: pose_from_parts([0.0, 0.0, 0.05], [0.0, 0.0, 0.0, 1.0]) }];
        }
        let base = workcell.arms.first()?.base;
        workcell.obstacles = (0..10)
            .map(|n| {
                let angle = rng.random_range(0.0..std::f64::consts::TAU);
                let (out, up) = (rng.random_range(0.5..0.9), rng.random_range(0.0..1.2));
                let centre = base.translation.vector + Vec3::new(out * angle.cos(), out * angle.sin(), up);
                let half_extents = Vec3::from_fn(|_, _| rng.random_range(0.03..0.15));
                let turn = rng.random_range(-0.5..0.5_f64);
                Obstacle {
                    id: format!("box_{n}"),
                    shapes: vec![PlacedShape { shape: Shape::Box { half_extents }, pose: Pose::identity() }],
                    pose: pose_from_parts(centre.into(), [0.0, 0.0, turn.sin(), turn.cos()]),
                }
            })
            .collect();
        let (arm, limits) = (workcell.arms[0].clone(), workcell.arms[0].limits.clone());
        let obstacles = workcell.obstacles.clone();
        problem.workcell = Arc::new(workcell);
        let world = CollisionWorld::new(&problem);
        let (scene, none) = (Scene::default(), Exemption::default());
        let resting = world.resting_atoms(&scene);

        let random: Vec<Config> = (0..CONFIGURATIONS).map(|_| random_config(&limits, rng)).collect();
        let baseline = Baseline::new(&arm, &obstacles);
        let (mut along, mut edges) = (Vec::new(), Vec::new());
        while edges.len() < Self::EDGES {
            let from = random_config(&limits, rng);
            let to: Config = from.iter().map(|x| x + rng.random_range(-0.3..0.3)).collect();
            let motion = StraightMotion::new(&from, &to);
            if world.static_free(ArmId(0), &motion, None, &resting, none) {
                along.extend((0..8).map(|n| {
                    let part = (f64::from(n) + 0.5) / 8.0;
                    from.iter().zip(&to).map(|(x, y)| x + (y - x) * part).collect::<Config>()
                }));
                edges.push(motion);
            }
        }
        let targets = random.iter().take(Self::TARGETS).map(|q| arm.tcp_pose(q)).collect();
        Some(Self { world, arm, resting, random, targets, along, edges, baseline })
    }

    fn free(&self, configs: &[Config]) -> usize {
        let slices: Vec<&[f64]> = black_box(configs).iter().map(|q| &q[..]).collect();
        let free = self.world.configs_free(ArmId(0), &slices, None, &Scene::default(), Exemption::default());
        free.into_iter().filter(|free| *free).count()
    }

    fn free_by_parry(&self, configs: &[Config]) -> usize {
        let mut poses = Vec::new();
        configs.iter().filter(|q| self.baseline.is_free(&self.arm, q, &mut poses)).count()
    }

    /// Random configurations, kinematics, self-collision and all.
    pub fn random(&self) -> usize {
        self.free(&self.random)
    }

    /// The same by parry, bounding boxes first, without self-collision.
    pub fn random_by_parry(&self) -> usize {
        self.free_by_parry(&self.random)
    }

    /// Configurations along valid edges.
    pub fn along(&self) -> usize {
        self.free(&self.along)
    }

    /// The same by parry.
    pub fn along_by_parry(&self) -> usize {
        self.free_by_parry(&self.along)
    }

    /// Poses of the TCP in one batch: up to five configurations each, within limits and free; how many there are.
    pub fn inverse(&self, rng: &mut Rng) -> usize {
        let (targets, scene, none) = (black_box(&self.targets), Scene::default(), Exemption::default());
        let found = self.world.inverse_free(ArmId(0), (targets, 5), None, &scene, none, rng);
        found.iter().map(Vec::len).sum()
    }

    /// The valid edges, certified continuously.
    pub fn certified(&self) -> usize {
        let none = Exemption::default();
        let free = |motion: &&StraightMotion| {
            self.world.static_free(ArmId(0), black_box(*motion), None, &self.resting, none)
        };
        self.edges.iter().filter(free).count()
    }
}

/// Links as capsules against boxes, bounding boxes first, all by parry.
#[derive(Debug)]
struct Baseline {
    capsules: Vec<(usize, Pose, Capsule)>,
    boxes: Vec<(ParryPose, Cuboid, Aabb)>,
}

fn parry_pose(pose: &Pose) -> ParryPose {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    ParryPose::from_parts(Vector::new(t.x, t.y, t.z), Rotation::from_xyzw(r.x, r.y, r.z, r.w))
}

impl Baseline {
    fn new(arm: &Arm, obstacles: &[Obstacle]) -> Self {
        let mut capsules = Vec::new();
        for (index, link) in arm.model.links.iter().enumerate() {
            let tool = if index == arm.model.mount { arm.tool.shapes.as_slice() } else { &[] };
            for placed in link.shapes.iter().chain(tool) {
                if let Shape::Capsule { radius, half_length } = &placed.shape {
                    let end = Vector::new(0.0, 0.0, *half_length);
                    capsules.push((index, placed.pose, Capsule::new(-end, end, *radius)));
                }
            }
        }
        let mut boxes = Vec::new();
        for obstacle in obstacles {
            for placed in &obstacle.shapes {
                if let Shape::Box { half_extents: h } = &placed.shape {
                    let (pose, cuboid) =
                        (parry_pose(&(obstacle.pose * placed.pose)), Cuboid::new(Vector::new(h.x, h.y, h.z)));
                    boxes.push((pose, cuboid, cuboid.compute_aabb(&pose)));
                }
            }
        }
        Self { capsules, boxes }
    }

    fn is_free(&self, arm: &Arm, q: &[f64], poses: &mut Vec<Pose>) -> bool {
        arm.model.link_poses(q, poses);
        self.capsules.iter().all(|(link, local, capsule)| {
            let pose = parry_pose(&(arm.base * poses[*link] * local));
            let bounds = capsule.compute_aabb(&pose);
            self.boxes.iter().all(|(at, cuboid, box_bounds)| {
                !bounds.intersects(box_bounds)
                    || query::intersection_test(&pose, capsule, at, cuboid).is_ok_and(|hit| !hit.intersecting)
            })
        })
    }
}

/// Nine iiwa14 with tools in their scenario, along composite edges near home.
#[derive(Debug)]
pub struct ManyArms {
    world: CollisionWorld,
    edges: Vec<Vec<StraightMotion>>,
}

impl ManyArms {
    /// How many composite edges a call works on.
    pub const EDGES: usize = 16;

    /// Draws edges that are free; `None` without the scenario.
    pub fn new(rng: &mut Rng) -> Option<Self> {
        let problem = shipped("switch/9x4")?;
        let world = CollisionWorld::new(&problem);
        let mut edges: Vec<Vec<StraightMotion>> = Vec::new();
        while edges.len() < Self::EDGES {
            let mut edge = |arm: &Arm| {
                let from: Config = arm.home.iter().map(|x| x + rng.random_range(-0.4..0.4)).collect();
                let to: Config = from.iter().map(|x| x + rng.random_range(-0.2..0.2)).collect();
                StraightMotion::new(&from, &to)
            };
            let motions: Vec<StraightMotion> = problem.workcell.arms.iter().map(&mut edge).collect();
            if world.conflict_among(&takings(&motions), (0.0, 1.0)).is_none() {
                edges.push(motions);
            }
        }
        Some(Self { world, edges })
    }

    /// The first two arms, which stand side by side.
    pub fn pair(&self) -> usize {
        let none = Exemption::default();
        let apart = |motions: &&Vec<StraightMotion>| {
            let (a, b) = (&motions[0], &motions[1]);
            let (a, b) = ((ArmId(0), a as _, None, none), (ArmId(1), b as _, None, none));
            self.world.motions_apart(a, b, (0.0, 1.0))
        };
        self.edges.iter().filter(apart).count()
    }

    /// All arms, each against each.
    pub fn all(&self) -> usize {
        let apart = |motions: &&Vec<StraightMotion>| {
            self.world.conflict_among(&takings(black_box(motions)), (0.0, 1.0)).is_none()
        };
        self.edges.iter().filter(apart).count()
    }
}

fn takings(motions: &[StraightMotion]) -> Vec<Taking<'_>> {
    let none = Exemption::default();
    motions.iter().enumerate().map(|(arm, motion)| (ArmId(arm), motion as _, None, none)).collect()
}
