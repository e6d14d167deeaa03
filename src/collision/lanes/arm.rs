//! An arm compiled for lanes: frames, atoms, limbs, and which of them are checked against which.

use nalgebra::UnitQuaternion;
use smallvec::SmallVec;

use super::core::{LaneCapsule, LaneCore, LaneStatic, StaticBlock};
use super::impossible::NeverTouch;
use super::limb::{Ball, Enclosure};
use super::safe::{SafeRange, SafeValues, rounded, strike_own_turns};
use crate::collision::arm_bodies::{ArmBodies, Levers, link_reach};
use crate::collision::atom::{Atom, Core};
use crate::collision::world::WorldAtom;
use crate::geometry::lanes::{Bits8, InstructionSet};
use crate::geometry::{PlacedShape, Pose, Shape, Vec3};
use crate::kinematics::{LinkMotion, MovingFrames};
use crate::workcell::Arm;

/// A lever arm by joint (m per rad, or 1 for a slide); [`UNMOVED`] where the joint moves nothing.
pub(super) type Row = SmallVec<[f32; 8]>;

/// In a [`Row`]: the joint does not move the body.
pub(super) const UNMOVED: f32 = -1.0;

/// Lever arms are rounded up by this much, relative.
const ROUND_UP: f32 = 1.0 + 1e-6;

/// Unbounded lever arms (of slides without limits) count as this long (m).
const GREATEST_LEVER: f32 = 1e6;

/// A limb of two frames is preferred to two limbs up to this ratio of their sizes.
const MERGE: f64 = 1.4;

/// An atom in lanes.
#[derive(Debug, Clone)]
pub(super) struct LaneAtom {
    pub(super) core: LaneCore,
    pub(super) frame: Option<usize>,
    pub(super) levers: Row,
    /// Whether the core is the shape itself.
    pub(super) exact: bool,
    /// A box around the shape, where the core is a capsule that is not the shape itself.
    pub(super) beside: Option<LaneCore>,
    /// A capsule that holds the core.
    pub(super) hull: LaneCapsule,
}

impl LaneAtom {
    pub(super) fn new(atom: &Atom, body: &Pose, frame: Option<usize>, levers: &Levers) -> Self {
        let core = LaneCore::new(atom, body);
        let hull = core.hull();
        let beside = LaneCore::beside(atom, body);
        Self { core, frame, levers: row(levers), exact: atom.core_is_exact, beside, hull }
    }
}

/// A capsule around some atoms.
#[derive(Debug, Clone)]
pub(super) struct Limb {
    pub(super) capsule: LaneCapsule,
    pub(super) frame: Option<usize>,
    /// How joints move the capsule, not what is in it.
    pub(super) levers: Row,
    /// The same with 0 for joints that do not move it: nothing to decide where it is looked at most.
    pub(super) swings: Row,
    /// Radius (m) of the ball around the first joint's origin that it never leaves, where it moves.
    pub(super) reach: f64,
    pub(super) atoms: Vec<u16>,
}

/// Pairs of atoms of two limbs (or of one).
#[derive(Debug, Clone)]
pub(super) struct SelfGroup {
    /// The limbs, where they can be apart, and how joints move them against each other.
    pub(super) limbs: Option<(usize, usize, Row)>,
    /// Where one joint alone decides about all pairs, values of it at which none can touch.
    pub(super) safe: Option<SafeRange>,
    pub(super) pairs: Vec<SelfPair>,
}

/// Two atoms that are checked against each other.
#[derive(Debug, Clone)]
pub(super) struct SelfPair {
    pub(super) a: u16,
    pub(super) b: u16,
    /// How joints move them against each other.
    pub(super) levers: Row,
}

/// Who of an arm may meet eight obstacles.
#[derive(Debug, Clone)]
pub(super) struct NearBlock {
    pub(super) boxes: StaticBlock,
    /// By limb, which of the eight it can get to.
    pub(super) limbs: Vec<Bits8>,
}

/// The compiled arm.
#[derive(Debug, Clone)]
pub(in crate::collision) struct LaneArm {
    pub(super) frames: MovingFrames,
    pub(super) atoms: Vec<LaneAtom>,
    pub(super) limbs: Vec<Limb>,
    pub(super) self_groups: Vec<SelfGroup>,
    /// The obstacles, those first that a limb can get to.
    pub(super) near: Vec<NearBlock>,
    /// The frame of the mount link, and its pose in it.
    pub(super) mount: (Option<usize>, Pose),
    /// By joint, whether it drives several frames.
    pub(super) several: Vec<bool>,
}

/// A [`Row`] of `levers`.
pub(super) fn row(levers: &Levers) -> Row {
    levers.iter().map(|lever| lever.map_or(UNMOVED, |l| (l as f32 * ROUND_UP).min(GREATEST_LEVER))).collect()
}

/// `levers` with 0 for joints that move nothing.
pub(super) fn swings(levers: &Row) -> Row {
    levers.iter().map(|lever| lever.max(0.0)).collect()
}

/// The lever by which a joint moves two bodies of one arm against each other: one that moves both as
/// one does not count, one that drives `several` frames may stand between them all the same.
#[inline(always)]
pub(super) fn relative_lever(x: f32, y: f32, several: bool) -> f32 {
    match (x != UNMOVED, y != UNMOVED) {
        (true, false) => x,
        (false, true) => y,
        (true, true) if several => x + y,
        _ => UNMOVED,
    }
}

/// How joints move two bodies of one arm against each other; `several` tells by joint whether it
/// drives several frames.
pub(super) fn relative(a: &Row, b: &Row, several: &[bool]) -> Row {
    a.iter().zip(b).zip(several).map(|((&x, &y), &several)| relative_lever(x, y, several)).collect()
}

impl LaneArm {
    /// Compiles `arm` among `obstacles`; the placement's frame is the world's moved to `origin`.
    /// What is farther than `clearance` (m) from all that a limb can reach it will never be asked
    /// about. What a `twin`, which differs in its place alone, knows already is taken over.
    pub(in crate::collision) fn new(
        arm: &Arm,
        bodies: &ArmBodies,
        (origin, obstacles, clearance): (&Vec3, (&[WorldAtom], &[LaneStatic]), f64),
        set: InstructionSet,
        twin: Option<&Self>,
    ) -> Self {
        let mut base = arm.base;
        base.translation.vector -= origin;
        let frames = MovingFrames::new(&arm.model, &base);
        let atoms: Vec<LaneAtom> = bodies
            .atoms
            .iter()
            .map(|atom| {
                let (frame, body) = frames.rider(atom.link);
                LaneAtom::new(&atom.atom, body, frame, &atom.levers)
            })
            .collect();
        let laid = Builder::new(arm, bodies, &frames, twin).limbs();
        let mut near: Vec<(usize, Vec<bool>)> = obstacles
            .0
            .iter()
            .map(|obstacle| {
                laid.iter().map(|(_, extent)| extent.may_meet(obstacle, origin, clearance)).collect()
            })
            .enumerate()
            .collect();
        near.sort_by_key(|(_, limbs)| !limbs.contains(&true));
        let near = near.chunks(8).map(|chunk| NearBlock::new(chunk, obstacles.1, laid.len())).collect();
        let limbs: Vec<Limb> = laid.into_iter().map(|(limb, _)| limb).collect();
        let several: Vec<bool> = (0..arm.model.dof())
            .map(|joint| (0..frames.len()).filter(|&frame| frames.drive(frame).0 == joint).count() > 1)
            .collect();
        let self_groups = match twin {
            Some(twin) => twin.self_groups.clone(),
            None => {
                let clearance = clearance as f32;
                Selves {
                    arm,
                    frames: &frames,
                    atoms: &atoms,
                    limbs: &limbs,
                    several: &several,
                    clearance,
                    set,
                }
                .groups(&bodies.self_pairs)
            }
        };
        let (mount, pose) = frames.rider(arm.model.mount);
        let mount = (mount, *pose);
        Self { frames, atoms, limbs, self_groups, near, mount, several }
    }
}

impl NearBlock {
    /// For up to eight obstacles, each with whether it can be met by limb.
    fn new(near: &[(usize, Vec<bool>)], obstacles: &[LaneStatic], limbs: usize) -> Self {
        let indices: Vec<usize> = near.iter().map(|(index, _)| *index).collect();
        let mask = |limb: usize| {
            let bits = near.iter().enumerate().filter(|(_, (_, limbs))| limbs[limb]);
            bits.fold(0, |mask, (slot, _)| mask | 1 << slot)
        };
        Self { boxes: StaticBlock::new(&indices, obstacles), limbs: (0..limbs).map(mask).collect() }
    }
}

/// Whether a whole turn of the joint brings back all that it moves.
fn turns(arm: &Arm, joint: usize) -> bool {
    arm.model.links.iter().all(|link| match &link.motion {
        LinkMotion::Held => true,
        LinkMotion::Revolute { joint: driving, multiplier, .. } => {
            *driving != joint || multiplier.fract() == 0.0
        }
        LinkMotion::Prismatic { joint: driving, .. } => *driving != joint,
    })
}

/// Where a limb can be, in the frame of the placement.
enum Extent {
    /// It stands still.
    Still(Enclosure),
    /// Within a ball.
    Ball(Vec3, f64),
}

impl Extent {
    fn may_meet(&self, obstacle: &WorldAtom, origin: &Vec3, clearance: f64) -> bool {
        match self {
            Self::Ball(centre, radius) => {
                (obstacle.at.centre - origin - centre).norm() <= radius + obstacle.atom.radius + clearance
            }
            Self::Still(capsule) => {
                let axis = capsule.b - capsule.a;
                let rotation = UnitQuaternion::rotation_between(&Vec3::z(), &axis).unwrap_or_else(|| {
                    UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI)
                });
                let shape = Shape::Capsule { radius: capsule.radius, half_length: axis.norm() / 2.0 };
                let middle = (capsule.a + capsule.b) / 2.0 + origin;
                let atom = Atom::new(&PlacedShape { shape, pose: Pose::from_parts(middle.into(), rotation) });
                let at = atom.placed(&Pose::identity());
                atom.separation(&at, &obstacle.atom, &obstacle.at, clearance) < clearance
            }
        }
    }
}

/// Sorts out which of an arm's atoms are checked against each other.
struct Selves<'a> {
    arm: &'a Arm,
    frames: &'a MovingFrames,
    atoms: &'a [LaneAtom],
    limbs: &'a [Limb],
    several: &'a [bool],
    clearance: f32,
    set: InstructionSet,
}

impl Selves<'_> {
    /// Those of `pairs` that can touch, by the limbs in which they lie and, where there is one, the
    /// only joint that decides.
    fn groups(&self, pairs: &[(usize, usize)]) -> Vec<SelfGroup> {
        let turns: Vec<bool> = (0..self.arm.model.dof()).map(|joint| turns(self.arm, joint)).collect();
        let limb_of = |atom: usize| self.limbs.iter().position(|limb| limb.atoms.contains(&(atom as u16)));
        let round: Vec<Option<LaneAtom>> = self.atoms.iter().map(|atom| rounded(atom, self.frames)).collect();
        let mut groups = std::collections::BTreeMap::<_, (Vec<SelfPair>, Vec<Turning<'_>>)>::new();
        for &(first, second) in pairs {
            let pair = (&self.atoms[first], &self.atoms[second]);
            // What nothing moves against each other was looked at when the problem was read.
            let mut levers = relative(&pair.0.levers, &pair.1.levers, self.several);
            if levers.iter().all(|lever| *lever == UNMOVED) {
                continue;
            }
            let cores = Turning::new(self, pair, &levers);
            let (limits, margin) = (self.arm.limits.as_slice(), self.clearance);
            let (frames, of_cores) = (self.frames, &cores.levers);
            if self.set.run(NeverTouch { frames, pair, levers: of_cores, limits, turns: &turns, margin }) {
                continue;
            }
            strike_own_turns(self.frames, pair, self.several, |atom| atom.exact, &mut levers);
            // Boxes that turn about the axis of a joint may be rounded to find that it does not matter.
            let rough = [first, second].map(|atom| round[atom].as_ref().unwrap_or(&self.atoms[atom]));
            let rough = Turning::new(self, rough.into(), &levers);
            let (joint, turning) = match (cores.only_joint(self), rough.only_joint(self)) {
                (None, Some(joint)) => (Some((joint, true)), rough),
                (joint, _) => (joint.map(|joint| (joint, false)), cores),
            };
            let group = groups.entry((limb_of(first), limb_of(second), joint)).or_default();
            group.0.push(SelfPair { a: first as u16, b: second as u16, levers });
            group.1.push(turning);
        }
        groups
            .into_iter()
            .map(|((first, second, joint), (pairs, turning))| {
                // Neighbours always touch; to look at them as a whole is a waste.
                let limbs = match (first, second) {
                    (Some(x), Some(y)) if x.abs_diff(y) > 1 && pairs.len() > 1 => {
                        Some((x, y, relative(&self.limbs[x].levers, &self.limbs[y].levers, self.several)))
                    }
                    _ => None,
                };
                let safe = joint.and_then(|(joint, _)| self.safe(joint, &turning));
                SelfGroup { limbs, safe, pairs }
            })
            .collect()
    }

    /// Values of `joint`, which alone decides about `pairs`, at which none of them can touch.
    fn safe(&self, joint: usize, pairs: &[Turning<'_>]) -> Option<SafeRange> {
        let pairs: Vec<_> = pairs.iter().map(|t| (t.pair.0, t.pair.1, t.levers[joint])).collect();
        let limits = &self.arm.limits;
        self.set.run(SafeValues { frames: self.frames, pairs: &pairs, joint, limits, margin: self.clearance })
    }
}

/// Two atoms, and how joints move their cores against each other, turns of a capsule about itself
/// left out.
struct Turning<'a> {
    pair: (&'a LaneAtom, &'a LaneAtom),
    levers: Row,
}

impl<'a> Turning<'a> {
    fn new(selves: &Selves<'_>, pair: (&'a LaneAtom, &'a LaneAtom), levers: &Row) -> Self {
        let mut levers = levers.clone();
        strike_own_turns(selves.frames, pair, selves.several, |_| true, &mut levers);
        Self { pair, levers }
    }

    /// The joint that alone moves them, where there is but one, which drives one frame alone.
    fn only_joint(&self, selves: &Selves<'_>) -> Option<usize> {
        let mut moving = (0..self.levers.len()).filter(|&joint| self.levers[joint] != UNMOVED);
        let only = moving.next()?;
        (moving.next().is_none() && !selves.several[only]).then_some(only)
    }
}

/// Lays limbs around an arm's atoms.
struct Builder<'a> {
    arm: &'a Arm,
    bodies: &'a ArmBodies,
    frames: &'a MovingFrames,
    twin: Option<&'a LaneArm>,
    /// Frames in the placement at zero.
    at_zero: Vec<Pose>,
    /// Links in the placement at zero.
    links: Vec<Pose>,
    /// Atoms by frame, those that stand still first.
    members: Vec<Vec<u16>>,
}

/// One way to enclose some atoms: a capsule in the coordinates of `frame` that moves with `rigid`.
#[derive(Clone)]
struct Draft {
    capsule: Enclosure,
    frame: Option<usize>,
    rigid: Option<usize>,
    atoms: Vec<u16>,
}

impl<'a> Builder<'a> {
    fn new(arm: &'a Arm, bodies: &'a ArmBodies, frames: &'a MovingFrames, twin: Option<&'a LaneArm>) -> Self {
        let model = &arm.model;
        let mut links = Vec::new();
        model.link_poses(&vec![0.0; model.dof()], &mut links);
        let mut base = Pose::identity();
        // The base in the placement, from the root link, which nothing moves.
        if let (None, pose) = frames.rider(0) {
            base = pose * links[0].inverse();
        }
        for pose in &mut links {
            *pose = base * *pose;
        }
        let mut at_zero = vec![Pose::identity(); frames.len()];
        for (link, pose) in links.iter().enumerate() {
            if let (Some(frame), local) = frames.rider(link) {
                at_zero[frame] = pose * local.inverse();
            }
        }
        let mut members = vec![Vec::new(); frames.len() + 1];
        for (index, atom) in bodies.atoms.iter().enumerate() {
            let (frame, _) = frames.rider(atom.link);
            members[frame.map_or(0, |frame| frame + 1)].push(index as u16);
        }
        Self { arm, bodies, frames, twin, at_zero, links, members }
    }

    /// The limbs of least size, and where each can be.
    fn limbs(&self) -> Vec<(Limb, Extent)> {
        // Along the frames: the last limb holds one frame or two.
        let count = self.members.len();
        let mut best: Vec<(f64, Vec<Draft>)> = vec![(0.0, Vec::new())];
        for slot in 0..count {
            let (cost, drafts) = &best[slot];
            let alone = self.alone(slot);
            let size = alone.as_ref().map_or(0.0, |draft| draft.capsule.size());
            let mut least = (cost + size, drafts.iter().cloned().chain(alone).collect::<Vec<_>>());
            let follows = slot > 0 && self.frames.parent(slot - 1).map_or(0, |parent| parent + 1) + 1 == slot;
            if follows
                && !self.members[slot].is_empty()
                && !self.members[slot - 1].is_empty()
                && let Some(draft) = self.about_axis(slot, true)
            {
                let (cost, drafts) = &best[slot - 1];
                let both = cost + draft.capsule.size() / MERGE;
                if both < least.0 {
                    least = (both, drafts.iter().cloned().chain([draft]).collect());
                }
            }
            best.push(least);
        }
        let drafts = best.pop().map(|(_, drafts)| drafts).unwrap_or_default();
        drafts.into_iter().map(|draft| self.finish(draft)).collect()
    }

    /// Points of the atoms in `slot` in the coordinates of `frame` (of the placement for `None`).
    fn balls(&self, slot: usize, frame: Option<usize>) -> Vec<Ball> {
        let mut balls = Vec::new();
        for &index in &self.members[slot] {
            let atom = &self.bodies.atoms[usize::from(index)];
            let link = self.links[atom.link];
            let pose = frame.map_or(link, |frame| self.at_zero[frame].inverse() * link);
            let at = |v: &Vec3| pose.rotation * v + pose.translation.vector;
            match &atom.atom.core {
                Core::Capsule { a, b, radius } => balls.extend([(at(a), *radius), (at(b), *radius)]),
                Core::Box { pose: local, half } => {
                    for corner in 0..8 {
                        let sign = |bit: usize| if corner >> bit & 1 == 0 { 1.0 } else { -1.0 };
                        let v = Vec3::new(half.x * sign(0), half.y * sign(1), half.z * sign(2));
                        balls.push((at(&(local.rotation * v + local.translation.vector)), 0.0));
                    }
                }
            }
        }
        balls
    }

    /// A limb around one slot's atoms.
    fn alone(&self, slot: usize) -> Option<Draft> {
        let frame = slot.checked_sub(1);
        let balls = self.balls(slot, frame);
        if balls.is_empty() {
            return None;
        }
        let mut directions = vec![Vec3::x(), Vec3::y(), Vec3::z()];
        for pair in balls.chunks_exact(2) {
            directions.extend((pair[1].0 - pair[0].0).try_normalize(1e-6));
        }
        let capsule = Enclosure::least(&balls, &directions)?;
        let free = Draft { capsule, frame, rigid: frame, atoms: self.members[slot].clone() };
        // About its own axis it moves less.
        let turning = frame.and_then(|_| self.about_axis(slot, false));
        Some(turning.filter(|t| t.capsule.size() < 1.1 * free.capsule.size()).unwrap_or(free))
    }

    /// A limb about the axis of the slot's joint, around its atoms and, with `both`, those of the
    /// slot before. `None` for a slide.
    fn about_axis(&self, slot: usize, both: bool) -> Option<Draft> {
        let frame = slot.checked_sub(1)?;
        if self.frames.slides(frame) {
            return None;
        }
        let mut balls = self.balls(slot, Some(frame));
        let mut atoms = self.members[slot].clone();
        if both {
            balls.extend(self.balls(slot - 1, Some(frame)));
            atoms.extend(&self.members[slot - 1]);
        }
        let capsule = Enclosure::along(&balls, &Vec3::zeros(), &Vec3::z());
        Some(Draft { capsule, frame: Some(frame), rigid: self.frames.parent(frame), atoms })
    }

    fn finish(&self, draft: Draft) -> (Limb, Extent) {
        let Draft { mut capsule, mut frame, rigid, atoms } = draft;
        let model = &self.arm.model;
        let in_placement = |v: &Vec3| match frame {
            Some(frame) => self.at_zero[frame].rotation * v + self.at_zero[frame].translation.vector,
            None => *v,
        };
        let placed = Enclosure { a: in_placement(&capsule.a), b: in_placement(&capsule.b), ..capsule };
        let carrier = rigid
            .and_then(|rigid| (0..model.links.len()).find(|&link| self.frames.rider(link).0 == Some(rigid)));
        let known = self.twin.and_then(|twin| twin.limbs.iter().find(|limb| limb.atoms == atoms));
        let (levers, reach, extent) = match carrier {
            None => {
                (capsule, frame) = (placed, None);
                (model.joints.iter().map(|_| UNMOVED).collect(), 0.0, Extent::Still(placed))
            }
            Some(link) => {
                let first = model.joints.first().map_or(0, |joint| joint.link);
                let centre = self.links[first].translation.vector;
                let (levers, radius) = match known {
                    Some(limb) => (limb.levers.clone(), limb.reach),
                    None => self.motion(link, placed.reach(&self.links[link].translation.vector), &centre),
                };
                (levers, radius, Extent::Ball(centre, radius))
            }
        };
        let capsule = LaneCapsule::new(&capsule.a, &capsule.b, capsule.radius);
        let swings = swings(&levers);
        (Limb { capsule, frame, levers, swings, reach, atoms }, extent)
    }

    /// How joints move what is within `reach` (m) of the origin of `link`, and how far it gets from
    /// `centre`.
    fn motion(&self, link: usize, reach: f64, centre: &Vec3) -> (Row, f64) {
        let model = &self.arm.model;
        let levers: Levers = (0..model.dof())
            .map(|joint| model.lever(&self.arm.limits, joint, link).map(|lever| lever.at(reach)))
            .collect();
        (row(&levers), link_reach(self.arm, link, reach, &self.links, centre))
    }
}
