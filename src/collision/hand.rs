//! What the hand alone decides: where it cannot be, however the rest of the arm stands.

use crate::geometry::Pose;
use crate::workcell::ArmId;

use super::atom::{Atom, PlacedAtom};
use super::scene::{Exemption, Held};
use super::world::{CollisionWorld, Owner};

impl CollisionWorld {
    /// Whether the mount link of `arm` with its tool, and what it holds, are clear of the obstacles
    /// when the TCP stands at `tcp` (world). `false` means that no configuration with the TCP there
    /// is free; `true` says nothing of the links before the mount link.
    pub fn hand_free(&self, arm: ArmId, tcp: &Pose, held: Option<&Held>, exemption: Exemption) -> bool {
        let model = &self.workcell.arms[arm.0];
        let mount = tcp * model.tool.tcp.inverse();
        let clear = |atom: &Atom, at: &PlacedAtom, exempt: &dyn Fn(Owner) -> bool| {
            self.obstacles.iter().all(|other| {
                exempt(other.owner)
                    || atom.separation(at, &other.atom, &other.at, self.clearance) >= self.clearance
            })
        };
        let hand = self.arms[arm.0].atoms.iter().filter(|atom| {
            // A mount link that never moves is not checked against what never moves either.
            atom.link == model.model.mount && atom.levers.iter().any(Option::is_some)
        });
        for atom in hand {
            let allowed = |owner| match owner {
                Owner::Obstacle(id) => self.workcell.allowed_arm_obstacle.contains(&(arm, atom.group, id)),
                Owner::Resting(_) => true,
            };
            if !clear(&atom.atom, &atom.atom.placed(&mount), &allowed) {
                return false;
            }
        }
        held.is_none_or(|held| {
            let body = tcp * held.object_in_tcp;
            let allowed = |owner| match owner {
                Owner::Obstacle(id) => exemption.held_with == Some(id),
                Owner::Resting(_) => true,
            };
            self.objects[held.object.0].iter().all(|atom| clear(atom, &atom.placed(&body), &allowed))
        })
    }
}
