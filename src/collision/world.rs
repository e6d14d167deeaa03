//! The compiled workcell and its queries.

use crate::geometry::lanes::InstructionSet;
use crate::geometry::{Pose, Vec3};
use crate::problem::Problem;
use crate::workcell::{ArmId, ObjectId, ObstacleId, Workcell};
use std::sync::Arc;

use super::arm_bodies::ArmBodies;
use super::atom::{Atom, PlacedAtom};
use super::certify::{JointMotion, Stations, StraightMotion};
use super::held::{HeldAtoms, HeldMemo};
use super::lanes::{
    Answers, Apart, Configurations, Ensemble, LaneArm, LaneHeld, LaneMover, LaneStatic, Motions, PairsApart,
    StaticBlock, cut_in_eight, eighths,
};
use super::scene::{Exemption, Held, Scene};

/// A static atom in the world.
#[derive(Debug, Clone)]
pub(super) struct WorldAtom {
    pub(super) atom: Atom,
    pub(super) at: PlacedAtom,
    pub(super) owner: Owner,
}

/// Whose static atom it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Owner {
    Obstacle(ObstacleId),
    Resting(ObjectId),
}

/// An arm taking part in a query: its motion, what it holds, what it may touch.
pub(super) struct Mover<'a> {
    pub(super) arm: ArmId,
    pub(super) base: Pose,
    pub(super) bodies: &'a ArmBodies,
    pub(super) motion: &'a dyn JointMotion,
    pub(super) held: Option<Arc<HeldAtoms>>,
    pub(super) exemption: Exemption,
    pub(super) lanes: LaneMover<'a>,
}

/// The workcell and the objects, compiled for collision checks. Immutable, shared by threads.
#[derive(Debug, Clone)]
pub struct CollisionWorld {
    pub(super) workcell: Arc<Workcell>,
    pub(super) arms: Vec<ArmBodies>,
    pub(super) obstacles: Vec<WorldAtom>,
    /// Atoms of each object in its frame.
    pub(super) objects: Vec<Arc<[Atom]>>,
    /// What arms were said to hold.
    held: Arc<HeldMemo>,
    /// Clearance (m) that is certified.
    pub(super) clearance: f64,
    /// What single precision may err by (m).
    pub(super) inflation: f32,
    /// Clearance and inflation (m).
    pub(super) margin: f32,
    pub(super) lane_arms: Vec<LaneArm>,
    pub(super) lane_obstacles: Vec<LaneStatic>,
    /// What the lanes are counted from, in the world.
    origin: Vec3,
    pub(super) set: InstructionSet,
}

/// What single precision errs by at most near the origin (m); tests compare with double precision.
const INFLATION: f64 = 1.0e-5;

/// And this much more by metre of distance from it.
const INFLATION_PER_METRE: f64 = 3.0e-6;

impl CollisionWorld {
    /// Compiles the workcell and the objects of `problem`.
    pub fn new(problem: &Problem) -> Self {
        Self::with_instructions(problem, InstructionSet::best())
    }

    /// The same on a chosen instruction set.
    pub fn with_instructions(problem: &Problem, set: InstructionSet) -> Self {
        let workcell = problem.workcell.clone();
        let arms = arm_bodies(&workcell);
        let mut obstacles = Vec::new();
        for (index, obstacle) in workcell.obstacles.iter().enumerate() {
            for placed in &obstacle.shapes {
                let atom = Atom::new(placed);
                let at = atom.placed(&obstacle.pose);
                obstacles.push(WorldAtom { atom, at, owner: Owner::Obstacle(ObstacleId(index)) });
            }
        }
        let objects = object_atoms(problem);
        let clearance = problem.options.clearance_m;
        let origin = arms.iter().map(|arm| arm.reach_centre).sum::<Vec3>() / arms.len().max(1) as f64;
        let extent = |arm: &ArmBodies| {
            let reach = if arm.reach_radius.is_finite() { arm.reach_radius } else { 0.0 };
            (arm.reach_centre - origin).norm() + reach
        };
        let extent = arms.iter().map(extent).fold(0.0, f64::max);
        let inflation = (INFLATION + INFLATION_PER_METRE * extent) as f32;
        let to_lanes = Pose::translation(-origin.x, -origin.y, -origin.z);
        let lane_obstacles: Vec<LaneStatic> = obstacles
            .iter()
            .map(|obstacle: &WorldAtom| LaneStatic::new(&obstacle.atom, &(to_lanes * obstacle.at.body)))
            .collect();
        let mut lane_arms: Vec<LaneArm> = Vec::new();
        for (index, (arm, bodies)) in workcell.arms.iter().zip(&arms).enumerate() {
            let known = twin(&workcell, index).map(|twin| &lane_arms[twin]);
            let around = (obstacles.as_slice(), lane_obstacles.as_slice());
            let surroundings = (&origin, around, clearance + f64::from(inflation));
            lane_arms.push(LaneArm::new(arm, bodies, surroundings, set, known));
        }
        let margin = clearance as f32 + inflation;
        Self {
            workcell,
            arms,
            obstacles,
            objects,
            held: Arc::default(),
            clearance,
            inflation,
            margin,
            lane_arms,
            lane_obstacles,
            origin,
            set,
        }
    }

    /// This world with the objects of another problem that has an equal workcell and clearance.
    pub fn with_objects_of(&self, problem: &Problem) -> Self {
        let (workcell, objects) = (problem.workcell.clone(), object_atoms(problem));
        Self { workcell, objects, held: Arc::default(), ..self.clone() }
    }

    /// The clearance (m) that every check certifies.
    pub fn clearance(&self) -> f64 {
        self.clearance
    }

    /// Whether the arm is free at each of `configs`: against itself, obstacles, resting objects,
    /// its held object included. Stops at nothing; one answer per configuration.
    pub fn configs_free(
        &self,
        arm: ArmId,
        configs: &[&[f64]],
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
    ) -> Vec<bool> {
        let around = self.resting_atoms(scene);
        let nowhere = StraightMotion::rest(&[]);
        let mover = self.mover(arm, &nowhere, held, exemption);
        let kernel = Configurations { world: self, mover: &mover, around: &around, configs };
        self.set.run(kernel).into_vec()
    }

    /// An instant of `span` at which two movers are not certified apart.
    fn contact(&self, first: &Mover<'_>, second: &Mover<'_>, still: bool, span: (f64, f64)) -> Option<f64> {
        let (pieces, count) = eighths(span, still);
        self.set.run(Apart { world: self, first, second, pieces: &pieces[..count] })
    }

    /// Whether the arm is free at `q`; see [`Self::configs_free`].
    pub fn config_free(
        &self,
        arm: ArmId,
        q: &[f64],
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
    ) -> bool {
        self.static_free(arm, &StraightMotion::rest(q), held, &self.resting_atoms(scene), exemption)
    }

    /// Whether each straight joint edge is certified free for the arm, all else at rest.
    pub fn edges_free(
        &self,
        arm: ArmId,
        edges: &[(&[f64], &[f64])],
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
    ) -> Vec<bool> {
        let straight: Vec<StraightMotion> =
            edges.iter().map(|(from, to)| StraightMotion::new(from, to)).collect();
        let motions: Vec<&dyn JointMotion> = straight.iter().map(|motion| motion as _).collect();
        let around = self.resting_atoms(scene);
        self.each_free(arm, &motions, held, &around, exemption).into_vec()
    }

    fn each_free(
        &self,
        arm: ArmId,
        motions: &[&dyn JointMotion],
        held: Option<&Held>,
        around: &Resting,
        exemption: Exemption,
    ) -> Answers {
        let nowhere = StraightMotion::rest(&[]);
        let mover = self.mover(arm, &nowhere, held, exemption);
        self.set.run(Motions { world: self, mover: &mover, around, motions })
    }

    /// Whether the straight joint edge is certified free for the arm; see [`Self::edges_free`].
    pub fn edge_free(
        &self,
        arm: ArmId,
        from: &[f64],
        to: &[f64],
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
    ) -> bool {
        self.static_free(arm, &StraightMotion::new(from, to), held, &self.resting_atoms(scene), exemption)
    }

    /// Whether the arm's motion over its whole domain is certified free of itself, obstacles and
    /// resting objects.
    pub fn motion_free(
        &self,
        arm: ArmId,
        motion: &dyn JointMotion,
        held: Option<&Held>,
        scene: &Scene,
        exemption: Exemption,
    ) -> bool {
        self.static_free(arm, motion, held, &self.resting_atoms(scene), exemption)
    }

    /// Whether two arms at rest are clear of each other, held objects included.
    pub fn arms_apart(
        &self,
        first: (ArmId, &[f64], Option<&Held>, Exemption),
        second: (ArmId, &[f64], Option<&Held>, Exemption),
    ) -> bool {
        let a = StraightMotion::rest(first.1);
        let b = StraightMotion::rest(second.1);
        self.motions_apart((first.0, &a, first.2, first.3), (second.0, &b, second.2, second.3), (0.0, 1.0))
    }

    /// Whether two arms' motions over the common interval `span` are certified apart, held
    /// objects included.
    pub fn motions_apart(
        &self,
        first: (ArmId, &dyn JointMotion, Option<&Held>, Exemption),
        second: (ArmId, &dyn JointMotion, Option<&Held>, Exemption),
        span: (f64, f64),
    ) -> bool {
        self.first_conflict(first, second, span).is_none()
    }

    /// The same over several spans in order, in all of which the same may touch; they are looked at together.
    pub fn motions_apart_in(&self, first: Taking<'_>, second: Taking<'_>, spans: &[(f64, f64)]) -> bool {
        if !self.may_meet((first.0, first.2), (second.0, second.2)) {
            return true;
        }
        let a = self.mover(first.0, first.1, first.2, first.3);
        let b = self.mover(second.0, second.1, second.2, second.3);
        spans.chunks(8).all(|spans| {
            let pieces = cut_in_eight(spans);
            self.set.run(Apart { world: self, first: &a, second: &b, pieces: &pieces }).is_none()
        })
    }

    /// At which of `pairs` of their configurations two arms, with what they hold, are clear of each other.
    pub fn each_apart(
        &self,
        first: (ArmId, Option<&Held>, Exemption),
        second: (ArmId, Option<&Held>, Exemption),
        pairs: &[(&[f64], &[f64])],
    ) -> Vec<bool> {
        if !self.may_meet((first.0, first.1), (second.0, second.1)) {
            return vec![true; pairs.len()];
        }
        let (ours, theirs): (Vec<&[f64]>, Vec<&[f64]>) = pairs.iter().copied().unzip();
        let (ours, theirs) = (Stations(&ours), Stations(&theirs));
        let a = self.mover(first.0, &ours, first.1, first.2);
        let b = self.mover(second.0, &theirs, second.1, second.2);
        let (first, second) = ((&a, &ours), (&b, &theirs));
        self.set.run(PairsApart { world: self, first, second, count: pairs.len() }).into_vec()
    }

    /// A time around which two arms' motions fail to be certified apart in `span`, if there is one.
    pub fn first_conflict(
        &self,
        first: (ArmId, &dyn JointMotion, Option<&Held>, Exemption),
        second: (ArmId, &dyn JointMotion, Option<&Held>, Exemption),
        span: (f64, f64),
    ) -> Option<f64> {
        if !self.may_meet((first.0, first.2), (second.0, second.2)) {
            return None;
        }
        let a = self.mover(first.0, first.1, first.2, first.3);
        let b = self.mover(second.0, second.1, second.2, second.3);
        let still = first.1.stands_still() && second.1.stands_still();
        self.contact(&a, &b, still, span)
    }

    /// Whether two arms, with what they hold, can come near each other at all.
    pub fn may_meet(&self, first: (ArmId, Option<&Held>), second: (ArmId, Option<&Held>)) -> bool {
        let ball = |(arm, held): (ArmId, Option<&Held>)| {
            let bodies = &self.arms[arm.0];
            (bodies.reach_centre, bodies.reach_with(held.map_or(0.0, |held| self.held_radius(arm, held))))
        };
        let ((centre, reach), (other_centre, other_reach)) = (ball(first), ball(second));
        (centre - other_centre).norm() <= reach + other_reach + self.clearance
    }

    /// Radius (m) around the origin of the mount link that holds the object in the hand.
    fn held_radius(&self, arm: ArmId, held: &Held) -> f64 {
        let in_mount = self.workcell.arms[arm.0].tool.tcp * held.object_in_tcp;
        let atoms = &self.objects[held.object.0];
        in_mount.translation.vector.norm() + atoms.iter().map(Atom::reach).fold(0.0, f64::max)
    }

    /// The first pair of `arms` (by their place in the list) whose motions over `span` are not
    /// certified apart; `None` when all are. What stands around them is not looked at, nor are two
    /// arms that both stand still.
    pub fn conflict_among(&self, arms: &[Taking<'_>], span: (f64, f64)) -> Option<(usize, usize)> {
        let movers: Vec<Mover<'_>> = arms.iter().map(|arm| self.mover(arm.0, arm.1, arm.2, arm.3)).collect();
        let still: Vec<bool> = arms.iter().map(|arm| arm.1.stands_still()).collect();
        let (pieces, _) = eighths(span, false);
        let looks = self.set.run(Ensemble { world: self, movers: &movers, still: &still, pieces: &pieces });
        let open = |pair: &(usize, usize)| {
            let (a, b) = (&movers[pair.0], &movers[pair.1]);
            self.contact(a, b, false, span).is_some()
        };
        if let Some(look) = looks.iter().find(|look| look.blocked) {
            return Some(look.pair);
        }
        looks.iter().map(|look| look.pair).find(open)
    }

    /// Prepares resting objects for many queries.
    pub fn resting_atoms(&self, scene: &Scene) -> Resting {
        let mut atoms = Vec::new();
        let mut lanes = Vec::new();
        let to_lanes = Pose::translation(-self.origin.x, -self.origin.y, -self.origin.z);
        for (object, pose) in &scene.resting {
            for atom in self.objects.get(object.0).into_iter().flat_map(|atoms| atoms.iter()) {
                atoms.push(WorldAtom {
                    atom: atom.clone(),
                    at: atom.placed(pose),
                    owner: Owner::Resting(*object),
                });
                lanes.push(LaneStatic::new(atom, &(to_lanes * pose)));
            }
        }
        let blocks = StaticBlock::all(&lanes);
        Resting { objects: scene.resting.clone(), atoms, lanes, blocks }
    }

    /// Whether the arm's motion is free, against resting objects prepared by
    /// [`Self::resting_atoms`].
    pub fn static_free(
        &self,
        arm: ArmId,
        motion: &dyn JointMotion,
        held: Option<&Held>,
        resting: &Resting,
        exemption: Exemption,
    ) -> bool {
        self.each_free(arm, &[motion], held, resting, exemption).as_slice() == [true]
    }

    /// Whether an object at rest at `pose` is clear of the other resting objects and of every
    /// obstacle but `carrier`.
    pub fn placement_free(
        &self,
        object: ObjectId,
        pose: &Pose,
        carrier: Option<ObstacleId>,
        scene: &Scene,
    ) -> bool {
        let Some(atoms) = self.objects.get(object.0) else { return false };
        let placed: Vec<PlacedAtom> = atoms.iter().map(|atom| atom.placed(pose)).collect();
        let clear_of = |other: &Atom, other_at: &PlacedAtom| {
            let apart = |(atom, at): (&Atom, &PlacedAtom)| {
                atom.separation(at, other, other_at, self.clearance) >= self.clearance
            };
            atoms.iter().zip(&placed).all(apart)
        };
        let mut obstacles =
            self.obstacles.iter().filter(|other| carrier.is_none_or(|id| other.owner != Owner::Obstacle(id)));
        let mut others = scene.resting.iter().filter(|(other, _)| *other != object);
        obstacles.all(|other| clear_of(&other.atom, &other.at))
            && others.all(|(other, pose)| {
                let atoms = self.objects.get(other.0).into_iter().flat_map(|atoms| atoms.iter());
                atoms.into_iter().all(|atom| clear_of(atom, &atom.placed(pose)))
            })
    }

    /// Whether the hands of two arms (their mount links' rigid groups with the tools) are clear of
    /// each other when the second's TCP stands at `second_tcp` in the first's TCP frame.
    pub fn hands_apart(&self, first: ArmId, second: ArmId, second_tcp: &Pose) -> bool {
        let place = |arm: ArmId, tcp: &Pose| -> Vec<(&Atom, PlacedAtom)> {
            let model = &self.workcell.arms[arm.0];
            let mount = tcp * model.tool.tcp.inverse();
            let atoms = self.arms[arm.0].atoms.iter().filter(|atom| atom.link == model.model.mount);
            atoms.map(|atom| (&atom.atom, atom.atom.placed(&mount))).collect()
        };
        let (ours, theirs) = (place(first, &Pose::identity()), place(second, second_tcp));
        ours.iter().all(|(a, at)| {
            theirs.iter().all(|(b, b_at)| a.separation(at, b, b_at, self.clearance) >= self.clearance)
        })
    }

    pub(super) fn mover<'a>(
        &'a self,
        arm: ArmId,
        motion: &'a dyn JointMotion,
        held: Option<&Held>,
        exemption: Exemption,
    ) -> Mover<'a> {
        let (bodies, model, lane_arm) =
            (&self.arms[arm.0], &self.workcell.arms[arm.0], &self.lane_arms[arm.0]);
        let make = |held: &Held| {
            let in_mount = model.tool.tcp * held.object_in_tcp;
            let atoms = self.objects[held.object.0].clone();
            let levers = bodies.held_levers(self.held_radius(arm, held));
            let held = HeldAtoms { object: held.object, in_mount, atoms, levers };
            let lanes = LaneHeld::new(lane_arm, &held);
            (Arc::new(held), Arc::new(lanes))
        };
        let in_hand = held.map(|held| self.held.get(arm, held, || make(held)));
        let (held, lane_held) = in_hand.unzip();
        let lanes = LaneMover { arm: lane_arm, held: lane_held };
        Mover { arm, base: model.base, bodies, motion, held, exemption, lanes }
    }
}

/// The first arm that differs from arm `index` in nothing but its place, if it comes before.
fn twin(workcell: &Workcell, index: usize) -> Option<usize> {
    let arm = &workcell.arms[index];
    workcell.arms[..index].iter().position(|other| {
        Arc::ptr_eq(&other.model, &arm.model)
            && other.tool == arm.tool
            && other.limits == arm.limits
            && other.exempt_groups == arm.exempt_groups
            && other.exempt_bodies == arm.exempt_bodies
            && other.hand_groups == arm.hand_groups
    })
}

/// The bodies of every arm; arms that differ in nothing but their place are compiled once.
fn arm_bodies(workcell: &Workcell) -> Vec<ArmBodies> {
    let mut bodies: Vec<ArmBodies> = Vec::new();
    for (index, arm) in workcell.arms.iter().enumerate() {
        bodies.push(match twin(workcell, index) {
            Some(known) => bodies[known].moved_to(arm),
            None => ArmBodies::new(arm),
        });
    }
    bodies
}

/// The atoms of each object in its frame.
fn object_atoms(problem: &Problem) -> Vec<Arc<[Atom]>> {
    problem.objects.iter().map(|object| object.shapes.iter().map(Atom::new).collect()).collect()
}

/// An arm in a query: which, its motion, what it holds, what it may touch.
pub type Taking<'a> = (ArmId, &'a dyn JointMotion, Option<&'a Held>, Exemption);

/// Resting objects prepared for many queries.
#[derive(Debug, Clone)]
pub struct Resting {
    objects: Vec<(ObjectId, Pose)>,
    pub(super) atoms: Vec<WorldAtom>,
    pub(super) lanes: Vec<LaneStatic>,
    pub(super) blocks: Vec<StaticBlock>,
}

impl Resting {
    /// The objects and where they are (world).
    pub fn objects(&self) -> &[(ObjectId, Pose)] {
        &self.objects
    }
}
