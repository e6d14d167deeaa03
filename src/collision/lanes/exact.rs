//! Exact distances of single pairs at single instants, for what lanes leave open.

use super::broad::Target;
use crate::collision::atom::Atom;
use crate::collision::certify::{BodyIndex, JointMotion};
use crate::collision::world::{CollisionWorld, Mover, WorldAtom};
use crate::geometry::Pose;

/// Links of the movers at the last instant that was asked about.
pub(super) struct Exact<'a> {
    world: &'a CollisionWorld,
    movers: [Option<Moving<'a>>; 2],
    resting: &'a [WorldAtom],
    links: [(f64, Vec<Pose>); 2],
}

/// A mover and its motion.
type Moving<'a> = (&'a Mover<'a>, &'a dyn JointMotion);

impl<'a> Exact<'a> {
    pub(super) fn new(
        world: &'a CollisionWorld,
        first: Moving<'a>,
        second: Option<Moving<'a>>,
        resting: &'a [WorldAtom],
    ) -> Self {
        let links = [(f64::NAN, Vec::new()), (f64::NAN, Vec::new())];
        Self { world, movers: [Some(first), second], resting, links }
    }

    /// The distance (m) of a pair at `s`, negative where it overlaps; or a lower bound of at least `need`.
    pub(super) fn distance(&mut self, a: BodyIndex, target: Target, s: f64, need: f64) -> f64 {
        let Some((first, body)) = self.body(0, a, s) else { return 0.0 };
        match target {
            Target::World(index) => {
                let index = usize::from(index);
                let obstacles = &self.world.obstacles;
                let fixed = obstacles.get(index).or_else(|| self.resting.get(index - obstacles.len()));
                fixed.map_or(0.0, |fixed| first.distance(&body, &fixed.atom, &fixed.at.body, need))
            }
            Target::Itself(b) => {
                self.body(0, b, s).map_or(0.0, |(second, at)| first.distance(&body, second, &at, need))
            }
            Target::Other(b) => {
                self.body(1, b, s).map_or(0.0, |(second, at)| first.distance(&body, second, &at, need))
            }
        }
    }

    /// An atom and where its body stands at `s`.
    fn body(&mut self, mover: usize, index: BodyIndex, s: f64) -> Option<(&'a Atom, Pose)> {
        let (arm, motion) = self.movers[mover]?;
        let model = &self.world.workcell.arms[arm.arm.0].model;
        let (last, links) = &mut self.links[mover];
        if *last != s {
            model.link_poses(&motion.at(s), links);
            *last = s;
        }
        let own = &arm.bodies.atoms;
        Some(match (own.get(usize::from(index)), &arm.held) {
            (Some(atom), _) => (&atom.atom, arm.base * links[atom.link]),
            (None, Some(held)) => (
                held.atoms.get(usize::from(index) - own.len())?,
                arm.base * links[model.mount] * held.in_mount,
            ),
            (None, None) => return None,
        })
    }
}
