//! The kernels' benchmark: each on random work that is drawn from one seed, next to parry where parry
//! can do the same.

// Lanes are counted: the same index goes through several arrays at once.
#![allow(clippy::needless_range_loop)]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::sync::Arc;

use parry3d_f64::bounding_volume::{Aabb, BoundingVolume as _};
use parry3d_f64::math::{Pose as ParryPose, Rotation, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::{Capsule, Cuboid, Shape as _};
use rand::Rng as _;

use super::table::{Table, best};
use crate::collision::{CollisionWorld, Exemption, Scene, StraightMotion, Taking};
use crate::geometry::lanes::{
    Float8, InstructionSet, Kernel, Segment8, V3, segment_box_outside, segment_box_squared,
    segment_segment_squared,
};
use crate::geometry::{PlacedShape, Pose, Shape, Vec3, pose_from_parts};
use crate::kinematics::{ArmModel, Config, Frames8, JointLimits, MovingFrames, NoMeshes, library};
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::scenario;
use crate::wire::{Folder, ReadLimits, read_problem};
use crate::workcell::{ArmId, Obstacle};

/// Blocks of eight in the batches of the narrow phase.
const BLOCKS: usize = 32;

/// Measures everything.
pub(super) fn measure() -> Table {
    let set = InstructionSet::best();
    let mut table = Table { instructions: set.name(), lines: Vec::new() };
    let mut rng = Seed(1).stream("bench/kernels");
    narrow(set, &mut table, &mut rng);
    if let Some(model) = model("iiwa14") {
        forward(set, &model, &mut table, &mut rng);
    }
    if let Some(problem) = shipped("in_place_swap/1x2") {
        one_arm(problem, &mut table, &mut rng);
    }
    if let Some(problem) = shipped("switch/9x4") {
        many_arms(&problem, &mut table, &mut rng);
    }
    inverse(&mut table, &mut rng);
    table
}

fn shipped(name: &str) -> Option<Problem> {
    let entry = scenario::find(name)?;
    let read = read_problem(entry.text.as_bytes(), &Folder::new("."), &ReadLimits::default());
    Some(read.ok()?.problem)
}

fn model(name: &str) -> Option<ArmModel> {
    let urdf = library(name)?.urdf;
    Some(ArmModel::from_urdf(name, urdf, "flange", &BTreeMap::new(), &NoMeshes).ok()?.0)
}

fn random_config(limits: &[JointLimits], rng: &mut Rng) -> Config {
    limits.iter().map(|l| rng.random_range(l.lower.max(-3.1)..l.upper.min(3.1))).collect()
}

/// Segments of eight cases: start and direction, by component.
type Segments = Vec<[[f32; 8]; 6]>;

/// Length (m) of the segments' axes and radius of the capsules around them.
const LENGTH: f32 = 0.4;
const RADIUS: f32 = 0.1;

struct Pairs<'a>(&'a Segments, &'a Segments);
struct InBox<'a>(&'a Segments, [f32; 3]);

#[inline(always)]
fn segment<F: Float8>(numbers: &[[f32; 8]; 6]) -> Segment8<F> {
    let vector = |at: usize| -> V3<F> {
        [F::load(&numbers[at]), F::load(&numbers[at + 1]), F::load(&numbers[at + 2])]
    };
    Segment8::with_length(vector(0), vector(3), LENGTH)
}

impl Kernel for Pairs<'_> {
    type Output = u32;
    #[inline(always)]
    fn run<F: Float8>(self) -> u32 {
        let limit = F::splat(4.0 * RADIUS * RADIUS);
        let mut hits = 0;
        for (p, q) in self.0.iter().zip(self.1) {
            hits += F::bits(segment_segment_squared::<F>(&segment(p), &segment(q)).less(limit)).count_ones();
        }
        hits
    }
}

impl Kernel for InBox<'_> {
    type Output = u32;
    #[inline(always)]
    fn run<F: Float8>(self) -> u32 {
        let limit = F::splat(RADIUS * RADIUS);
        let half = [F::splat(self.1[0]), F::splat(self.1[1]), F::splat(self.1[2])];
        let mut hits = 0;
        for p in self.0 {
            let segment = segment::<F>(p);
            if F::bits(segment_box_outside(&segment, &half).less(limit)) != 0 {
                hits += F::bits(segment_box_squared(&segment, &half).less(limit)).count_ones();
            }
        }
        hits
    }
}

fn random_segments(rng: &mut Rng) -> Segments {
    (0..BLOCKS)
        .map(|_| {
            let mut block = [[0.0; 8]; 6];
            for lane in 0..8 {
                let mut r = || rng.random_range(-1.0..1.0_f32);
                let (start, along) = ([r(), r(), r()], Vec3::new(r().into(), r().into(), r().into()));
                let along = along.normalize() * f64::from(LENGTH);
                for k in 0..3 {
                    block[k][lane] = start[k];
                    block[k + 3][lane] = along[k] as f32;
                }
            }
            block
        })
        .collect()
}

fn capsules(segments: &Segments) -> Vec<Capsule> {
    let number = |block: &[[f32; 8]; 6], k: usize, lane: usize| f64::from(block[k][lane]);
    let mut all = Vec::new();
    for block in segments {
        for lane in 0..8 {
            let start = Vector::new(number(block, 0, lane), number(block, 1, lane), number(block, 2, lane));
            let along = Vector::new(number(block, 3, lane), number(block, 4, lane), number(block, 5, lane));
            all.push(Capsule::new(start, start + along, f64::from(RADIUS)));
        }
    }
    all
}

/// Capsules against capsules and boxes.
fn narrow(set: InstructionSet, table: &mut Table, rng: &mut Rng) {
    let (p, q) = (random_segments(rng), random_segments(rng));
    let (a, b) = (capsules(&p), capsules(&q));
    let still = ParryPose::IDENTITY;
    let count = 8 * BLOCKS;
    let ours = best(count, || {
        black_box(set.run(Pairs(black_box(&p), black_box(&q))));
    });
    let theirs = best(count, || {
        for (a, b) in a.iter().zip(&b) {
            black_box(query::intersection_test(&still, black_box(a), &still, black_box(b)).is_ok());
        }
    });
    table.compare("capsule against capsule", ours, "parry", theirs);
    let half = [0.3, 0.2, 0.4];
    let cuboid = Cuboid::new(Vector::new(half[0].into(), half[1].into(), half[2].into()));
    let ours = best(count, || {
        black_box(set.run(InBox(black_box(&p), black_box(half))));
    });
    let theirs = best(count, || {
        for a in &a {
            black_box(query::intersection_test(&still, black_box(a), &still, black_box(&cuboid)).is_ok());
        }
    });
    table.compare("capsule against box", ours, "parry", theirs);
}

struct Forward<'a>(&'a MovingFrames, &'a [[[f32; 8]; 7]]);

impl Kernel for Forward<'_> {
    type Output = f32;
    #[inline(always)]
    fn run<F: Float8>(self) -> f32 {
        let mut frames = Frames8::<F>::new();
        let mut sum = F::splat(0.0);
        for q in self.1 {
            self.0.place(q, &mut frames);
            if let Some(last) = frames.last() {
                sum = sum + last.origin[0];
            }
        }
        sum.store()[0]
    }
}

fn forward(set: InstructionSet, model: &ArmModel, table: &mut Table, rng: &mut Rng) {
    let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
    let frames = MovingFrames::new(model, &Pose::identity());
    let q = random_config(&limits, rng);
    let batches: Vec<[[f32; 8]; 7]> =
        (0..BLOCKS).map(|_| [0; 7].map(|_| [0; 8].map(|_| rng.random_range(-2.0..2.0_f32)))).collect();
    let ours = best(8 * BLOCKS, || {
        black_box(set.run(Forward(black_box(&frames), black_box(&batches))));
    });
    let mut poses = Vec::new();
    let theirs = best(1, || model.link_poses(black_box(&q), &mut poses));
    table.compare("iiwa14, all frames", ours, "in f64", theirs);
}

/// One arm among ten boxes.
fn one_arm(mut problem: Problem, table: &mut Table, rng: &mut Rng) {
    let mut workcell = problem.workcell.as_ref().clone();
    // Seven links, base and a tool of one capsule.
    if let Some(arm) = workcell.arms.first_mut() {
        let shape = Shape::Capsule { radius: 0.04, half_length: 0.05 };
        arm.tool.shapes =
            vec![PlacedShape { shape, pose: pose_from_parts([0.0, 0.0, 0.05], [0.0, 0.0, 0.0, 1.0]) }];
    }
    let Some(base) = workcell.arms.first().map(|arm| arm.base) else { return };
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

    let configs: Vec<Config> = (0..256).map(|_| random_config(&limits, rng)).collect();
    let slices: Vec<&[f64]> = configs.iter().map(|q| &q[..]).collect();
    let ours = best(slices.len(), || {
        black_box(world.configs_free(ArmId(0), black_box(&slices), None, &scene, none));
    });
    let baseline = Baseline::new(&arm, &obstacles);
    let mut poses = Vec::new();
    let theirs = best(configs.len(), || {
        for q in &configs {
            black_box(baseline.is_free(&arm, q, &mut poses));
        }
    });
    table.compare("iiwa14 (9 capsules) and itself, 10 boxes: random", ours, "parry, boxes first", theirs);

    let mut edges = Vec::new();
    while edges.len() < 32 {
        let from = random_config(&limits, rng);
        let to: Config = from.iter().map(|x| x + rng.random_range(-0.3..0.3)).collect();
        if world.static_free(ArmId(0), &StraightMotion::new(&from, &to), None, &resting, none) {
            edges.push((from, to));
        }
    }
    let along: Vec<Config> = edges
        .iter()
        .flat_map(|(a, b)| {
            (0..8).map(move |n| {
                a.iter().zip(b).map(|(x, y)| x + (y - x) * (f64::from(n) + 0.5) / 8.0).collect()
            })
        })
        .collect();
    let slices: Vec<&[f64]> = along.iter().map(|q| &q[..]).collect();
    let ours = best(slices.len(), || {
        black_box(world.configs_free(ArmId(0), black_box(&slices), None, &scene, none));
    });
    let theirs = best(along.len(), || {
        for q in &along {
            black_box(baseline.is_free(&arm, q, &mut poses));
        }
    });
    table.compare("the same along valid edges", ours, "parry, boxes first", theirs);
    let motions: Vec<StraightMotion> = edges.iter().map(|(a, b)| StraightMotion::new(a, b)).collect();
    let whole = best(motions.len(), || {
        for motion in &motions {
            black_box(world.static_free(ArmId(0), black_box(motion), None, &resting, none));
        }
    });
    table.add("such an edge certified continuously", whole);
}

/// Links as capsules against boxes, bounding boxes first, all by parry.
struct Baseline {
    capsules: Vec<(usize, Pose, Capsule)>,
    boxes: Vec<(ParryPose, Cuboid, Aabb)>,
}

fn parry_pose(pose: &Pose) -> ParryPose {
    let (t, r) = (pose.translation.vector, pose.rotation.coords);
    ParryPose::from_parts(Vector::new(t.x, t.y, t.z), Rotation::from_xyzw(r.x, r.y, r.z, r.w))
}

impl Baseline {
    fn new(arm: &crate::workcell::Arm, obstacles: &[Obstacle]) -> Self {
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

    fn is_free(&self, arm: &crate::workcell::Arm, q: &[f64], poses: &mut Vec<Pose>) -> bool {
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

/// Two and nine arms against each other.
fn many_arms(problem: &Problem, table: &mut Table, rng: &mut Rng) {
    let world = CollisionWorld::new(problem);
    let arms = &problem.workcell.arms;
    let none = Exemption::default();
    let mut edge = |arm: &crate::workcell::Arm| {
        let near =
            |rng: &mut Rng| -> Config { arm.home.iter().map(|x| x + rng.random_range(-0.4..0.4)).collect() };
        let from = near(rng);
        let to: Config = from.iter().map(|x| x + rng.random_range(-0.2..0.2)).collect();
        StraightMotion::new(&from, &to)
    };
    let mut edges: Vec<Vec<StraightMotion>> = Vec::new();
    while edges.len() < 16 {
        let motions: Vec<StraightMotion> = arms.iter().map(&mut edge).collect();
        if world.conflict_among(&takings(&motions, none), (0.0, 1.0)).is_none() {
            edges.push(motions);
        }
    }
    let pairs = best(edges.len() * 8, || {
        for motions in &edges {
            let (a, b) = ((ArmId(0), &motions[0] as _, None, none), (ArmId(1), &motions[1] as _, None, none));
            black_box(world.motions_apart(a, b, (0.0, 1.0)));
        }
    });
    table.add("two arms 1.1 m apart, per eighth of an edge", pairs);
    let takings: Vec<Vec<Taking<'_>>> = edges.iter().map(|motions| takings(motions, none)).collect();
    let all = best(edges.len() * 8, || {
        for arms in &takings {
            black_box(world.conflict_among(arms, (0.0, 1.0)));
        }
    });
    table.add("nine arms (36 pairs), per eighth of an edge", all);
}

fn takings(motions: &[StraightMotion], none: Exemption) -> Vec<Taking<'_>> {
    motions.iter().enumerate().map(|(arm, motion)| (ArmId(arm), motion as _, None, none)).collect()
}

/// Inverse kinematics in closed form.
fn inverse(table: &mut Table, rng: &mut Rng) {
    for (name, most, work) in [
        ("iiwa14", 5, "inverse kinematics, iiwa14: five solutions"),
        ("ur_type", 8, "inverse kinematics, UR type: all solutions"),
    ] {
        let Some(model) = model(name) else { continue };
        let limits: Vec<JointLimits> = model.joints.iter().map(|joint| joint.limits).collect();
        let targets: Vec<Pose> = (0..64).map(|_| model.mount_pose(&random_config(&limits, rng))).collect();
        let mut found = Vec::new();
        let time = best(targets.len(), || {
            for target in &targets {
                model.inverse(&limits, black_box(target), most, rng, &mut found);
                black_box(&found);
            }
        });
        table.add(work, time);
    }
}
