//! What the hand alone decides: where it cannot be, however the rest of the arm stands.

use crate::geometry::Pose;
use crate::workcell::ArmId;

use super::world::{CollisionWorld, Owner};

impl CollisionWorld {
    /// Whether the mount link of `arm` with its tool is clear of the obstacles when the TCP stands at `tcp` (world). `false`
    /// means that no configuration with the TCP there is free; `true` says nothing of the links before the mount
    /// link.
    pub fn hand_free(&self, arm: ArmId, tcp: &Pose) -> bool {
        let model = &self.workcell.arms[arm.0];
        let mount = tcp * model.tool.tcp.inverse();
        let hand = self.arms[arm.0].atoms.iter().filter(|atom| {
            // A mount link that never moves is not checked against what never moves either.
            atom.link == model.model.mount && atom.levers.iter().any(Option::is_some)
        });
        hand.map(|atom| (atom, atom.atom.placed(&mount))).all(|(atom, at)| {
            self.obstacles.iter().all(|other| {
                atom.atom.separation(&at, &other.atom, &other.at, self.clearance) >= self.clearance
                    || match other.owner {
                        Owner::Obstacle(id) => self.workcell.arm_may_touch(arm, atom.body, id),
                        Owner::Resting(_) => true,
                    }
            })
        })
    }
}
