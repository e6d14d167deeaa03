//! The same certification in double precision with exact shapes, one instant at a time: what the
//! lanes are tested against.

use crate::geometry::{Pose, Vec3};
use crate::kinematics::{Config, Link, LinkMotion};

use super::UNDECIDED_MOTION;
use super::arm_bodies::Levers;
use super::atom::{Atom, PlacedAtom};
use super::certify::BodyIndex;
use super::scene::Scene;
use super::world::{CollisionWorld, Mover, Owner, Taking, WorldAtom};

#[derive(Clone, Copy)]
struct Pair {
    a: BodyIndex,
    b: BodyIndex,
    /// What `b` counts: atoms of the same mover, of the other mover, or static ones.
    with: With,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum With {
    Itself,
    World,
    Other,
}

/// A mover's bodies placed at one parameter.
struct Placement {
    links: Vec<Pose>,
    atoms: Vec<PlacedAtom>,
    deviation: Config,
}

impl Placement {
    fn new() -> Self {
        Self { links: Vec::new(), atoms: Vec::new(), deviation: Config::new() }
    }
}

impl Mover<'_> {
    fn body_count(&self) -> usize {
        self.bodies.atoms.len() + self.held.as_ref().map_or(0, |held| held.atoms.len())
    }

    fn atom(&self, body: BodyIndex) -> &Atom {
        let index = usize::from(body);
        match (self.bodies.atoms.get(index), &self.held) {
            (Some(atom), _) => &atom.atom,
            (None, Some(held)) => &held.atoms[index - self.bodies.atoms.len()],
            (None, None) => unreachable!("body indices come from body_count"),
        }
    }

    fn levers(&self, body: BodyIndex) -> &Levers {
        match (self.bodies.atoms.get(usize::from(body)), &self.held) {
            (Some(atom), _) => &atom.levers,
            (None, Some(held)) => &held.levers,
            (None, None) => unreachable!("body indices come from body_count"),
        }
    }

    fn place(&self, world: &CollisionWorld, s: f64, out: &mut Placement) {
        let model = &world.workcell.arms[self.arm.0].model;
        model.link_poses(&self.motion.at(s), &mut out.links);
        for pose in &mut out.links {
            *pose = self.base * *pose;
        }
        self.bodies.place(&out.links, &mut out.atoms);
        if let Some(held) = &self.held {
            let body = out.links[model.mount] * held.in_mount;
            for atom in held.atoms.iter() {
                let mut placed = PlacedAtom::nowhere();
                atom.place(&body, &mut placed);
                out.atoms.push(placed);
            }
        }
    }

    /// The most (m) that a body moves in the world while the joints deviate by `deviation`.
    fn motion_bound(&self, body: BodyIndex, deviation: &[f64]) -> f64 {
        self.levers(body).iter().zip(deviation).map(|(lever, d)| lever.map_or(0.0, |l| l * d)).sum()
    }

    /// The most that two bodies of this arm move against each other: joints that move both as one do
    /// not count, joints that drive several links may stand between them all the same.
    fn relative_bound(&self, world: &CollisionWorld, a: BodyIndex, b: BodyIndex, deviation: &[f64]) -> f64 {
        let links = &world.workcell.arms[self.arm.0].model.links;
        let drives_several = |driving: usize| {
            let driven = |link: &&Link| match &link.motion {
                LinkMotion::Held => false,
                LinkMotion::Revolute { joint, .. } | LinkMotion::Prismatic { joint, .. } => *joint == driving,
            };
            links.iter().filter(driven).count() > 1
        };
        let mut sum = 0.0;
        let levers = self.levers(a).iter().zip(self.levers(b));
        for (joint, ((la, lb), d)) in levers.zip(deviation).enumerate() {
            sum += match (la, lb) {
                (Some(x), Some(y)) if drives_several(joint) => (x + y) * d,
                (Some(_), Some(_)) | (None, None) => 0.0,
                (Some(l), None) | (None, Some(l)) => l * d,
            };
        }
        sum
    }
}

/// Whether one arm's motion is free of itself and of static atoms.
pub(super) fn static_free(world: &CollisionWorld, mover: &Mover<'_>, resting: &[WorldAtom]) -> bool {
    let statics: Vec<&WorldAtom> = world
        .obstacles
        .iter()
        .chain(resting)
        .filter(|atom| !CollisionWorld::out_of_reach(mover, atom, world.clearance))
        .filter(|atom| match (atom.owner, &mover.held) {
            (Owner::Resting(object), Some(held)) => object != held.object,
            _ => true,
        })
        .collect();
    let mut pairs = Vec::with_capacity(256);
    let bodies = mover.body_count() as BodyIndex;
    for a in 0..bodies {
        let moves = mover.levers(a).iter().any(Option::is_some);
        for (b, atom) in statics.iter().enumerate() {
            // What never moves cannot come into contact: it was checked when the problem was read,
            // except against objects that were moved since.
            let fixed = !moves && matches!(atom.owner, Owner::Obstacle(_));
            if !fixed && !mover.may_touch_world(a, atom.owner, world) {
                pairs.push(Pair { a, b: b as BodyIndex, with: With::World });
            }
        }
        if mover.is_held(a) {
            for (b, atom) in mover.bodies.atoms.iter().enumerate() {
                if !atom.is_hand {
                    pairs.push(Pair { a, b: b as BodyIndex, with: With::Itself });
                }
            }
        }
    }
    for &(a, b) in &mover.bodies.self_pairs {
        pairs.push(Pair { a: a as BodyIndex, b: b as BodyIndex, with: With::Itself });
    }
    let mut check = Check { world, mover, other: None, statics: &statics, pairs };
    let (from, to) = mover.motion.span();
    check.run((from, to)).is_none()
}

/// The parameter near which two arms first fail to be certified apart.
pub(super) fn arm_pair_conflict(
    world: &CollisionWorld,
    mover: &Mover<'_>,
    other: &Mover<'_>,
    span: (f64, f64),
) -> Option<f64> {
    let mut pairs = Vec::with_capacity(256);
    for a in 0..mover.body_count() as BodyIndex {
        for b in 0..other.body_count() as BodyIndex {
            if !mover.may_touch_arm(a, other, b, world) {
                pairs.push(Pair { a, b, with: With::Other });
            }
        }
    }
    let mut check = Check { world, mover, other: Some(other), statics: &[], pairs };
    check.run(span)
}

/// One certification: the pairs still open are a stack of ranges.
struct Check<'a> {
    world: &'a CollisionWorld,
    mover: &'a Mover<'a>,
    other: Option<&'a Mover<'a>>,
    statics: &'a [&'a WorldAtom],
    pairs: Vec<Pair>,
}

impl Check<'_> {
    fn run(&mut self, span: (f64, f64)) -> Option<f64> {
        let mut placements = (Placement::new(), Placement::new());
        let open = (0, self.pairs.len());
        self.halve(span, open, &mut placements)
    }

    /// Certifies the pairs `open` over `span`; the middle of an interval that fails otherwise.
    fn halve(
        &mut self,
        span: (f64, f64),
        open: (usize, usize),
        at: &mut (Placement, Placement),
    ) -> Option<f64> {
        if open.0 == open.1 {
            return None;
        }
        let middle = (span.0 + span.1) / 2.0;
        self.mover.place(self.world, middle, &mut at.0);
        at.0.deviation = self.mover.motion.deviation(span.0, span.1);
        if let Some(other) = self.other {
            other.place(self.world, middle, &mut at.1);
            at.1.deviation = other.motion.deviation(span.0, span.1);
        }
        let clearance = self.world.clearance;
        let start = self.pairs.len();
        for index in open.0..open.1 {
            let pair = self.pairs[index];
            let (separation, bound) = self.look(pair, at);
            if separation < clearance + bound {
                if separation < clearance || bound < UNDECIDED_MOTION {
                    return Some(middle);
                }
                self.pairs.push(pair);
            }
        }
        let left = (start, self.pairs.len());
        let found = self.halve((span.0, middle), left, at).or_else(|| self.halve((middle, span.1), left, at));
        self.pairs.truncate(start);
        found
    }

    /// The pair's separation now and the most that it can change in the interval.
    fn look(&self, pair: Pair, at: &(Placement, Placement)) -> (f64, f64) {
        let mover = self.mover;
        let atom = mover.atom(pair.a);
        let placed = &at.0.atoms[usize::from(pair.a)];
        let clearance = self.world.clearance;
        match (pair.with, self.other) {
            (With::World, _) => {
                let bound = mover.motion_bound(pair.a, &at.0.deviation);
                let fixed = self.statics[usize::from(pair.b)];
                (atom.separation(placed, &fixed.atom, &fixed.at, clearance + bound), bound)
            }
            (With::Other, Some(other)) => {
                let bound =
                    mover.motion_bound(pair.a, &at.0.deviation) + other.motion_bound(pair.b, &at.1.deviation);
                let theirs = &at.1.atoms[usize::from(pair.b)];
                (atom.separation(placed, other.atom(pair.b), theirs, clearance + bound), bound)
            }
            _ => {
                let bound = mover.relative_bound(self.world, pair.a, pair.b, &at.0.deviation);
                let second = &at.0.atoms[usize::from(pair.b)];
                (atom.separation(placed, mover.atom(pair.b), second, clearance + bound), bound)
            }
        }
    }
}

impl CollisionWorld {
    /// Where atoms of obstacles are too far for anything that the arm moves.
    pub(super) fn out_of_reach(mover: &Mover<'_>, atom: &WorldAtom, clearance: f64) -> bool {
        let reach = mover.bodies.reach_with(mover.held.as_ref().map_or(0.0, |held| {
            held.in_mount.translation.vector.norm() + held.atoms.iter().map(Atom::reach).fold(0.0, f64::max)
        }));
        let centre: &Vec3 = &mover.bodies.reach_centre;
        (atom.at.centre - centre).norm() > reach + atom.atom.radius + clearance
    }
}

/// Whether one arm's motion is free of itself and of all that stands still.
pub(super) fn is_free(world: &CollisionWorld, taking: &Taking<'_>, scene: &Scene) -> bool {
    let mover = world.mover(taking.0, taking.1, taking.2, taking.3);
    static_free(world, &mover, &world.resting_atoms(scene).atoms)
}

/// Whether two arms' motions over [0, 1] are apart.
pub(super) fn are_apart(world: &CollisionWorld, first: &Taking<'_>, second: &Taking<'_>) -> bool {
    let a = world.mover(first.0, first.1, first.2, first.3);
    let b = world.mover(second.0, second.1, second.2, second.3);
    arm_pair_conflict(world, &a, &b, (0.0, 1.0)).is_none()
}
