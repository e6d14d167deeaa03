//! What arms hold, made ready for checks: queries ask about the same few objects in the same hands again and again.

use std::sync::{Arc, Mutex, PoisonError};

use super::arm_bodies::Levers;
use super::atom::Atom;
use super::lanes::LaneHeld;
use super::scene::Held;
use crate::geometry::Pose;
use crate::workcell::{ArmId, ObjectId};

/// How many are remembered; of more the oldest are forgotten.
const MOST: usize = 32;

/// The atoms of a held object, on the mount link.
pub(super) struct HeldAtoms {
    pub(super) object: ObjectId,
    pub(super) in_mount: Pose,
    pub(super) atoms: Arc<[Atom]>,
    pub(super) levers: Levers,
}

/// The same, and in lanes.
pub(super) type InHand = (Arc<HeldAtoms>, Arc<LaneHeld>);

/// Objects in hands that were asked about last. What is remembered is what would be made anew.
#[derive(Default)]
pub(super) struct HeldMemo(Mutex<Recent>);

#[derive(Default)]
struct Recent {
    known: Vec<((ArmId, Held), InHand)>,
    /// Which is the oldest, once there are [`MOST`].
    oldest: usize,
}

impl HeldMemo {
    /// What `arm` holds, by `make` where nobody asked for it lately.
    pub(super) fn get(&self, arm: ArmId, held: &Held, make: impl FnOnce() -> InHand) -> InHand {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = (arm, *held);
        let known = |recent: &Recent| {
            recent.known.iter().find(|(known, _)| *known == asked).map(|(_, in_hand)| in_hand.clone())
        };
        if let Some(in_hand) = known(&lock()) {
            return in_hand;
        }
        // Others are not kept waiting.
        let made = make();
        let mut recent = lock();
        if recent.known.len() < MOST {
            recent.known.push((asked, made.clone()));
        } else {
            let at = recent.oldest;
            recent.known[at] = (asked, made.clone());
            recent.oldest = (at + 1) % MOST;
        }
        made
    }
}

impl std::fmt::Debug for HeldMemo {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("HeldMemo").finish_non_exhaustive()
    }
}
