//! All arms at once: each placed once for eight pieces of an edge, then every pair.

use super::broad::{self, Candidates};
use super::exact::Exact;
use super::mover::{PlacedArm, Samples};
use super::narrow::{Scenery, look};
use crate::collision::world::{CollisionWorld, Mover};
use crate::geometry::lanes::{Bits8, Float8, Kernel};

/// How a pair of an ensemble stands after the first look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::collision) struct PairLook {
    /// The movers, by their place in the list.
    pub(in crate::collision) pair: (usize, usize),
    /// Whether they are in contact somewhere.
    pub(in crate::collision) blocked: bool,
}

/// A first look at all pairs of some movers, to be run by
/// [`crate::geometry::lanes::InstructionSet::run`].
pub(in crate::collision) struct Ensemble<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) movers: &'a [Mover<'a>],
    /// By mover, whether it stands still; two of these are not looked at.
    pub(in crate::collision) still: &'a [bool],
    /// Pieces, in order; at most eight.
    pub(in crate::collision) pieces: &'a [(f64, f64)],
}

impl Kernel for Ensemble<'_> {
    /// The pairs that are not certified; nothing after the first contact.
    type Output = Vec<PairLook>;

    #[inline(always)]
    fn run<F: Float8>(self) -> Self::Output {
        let world = self.world;
        let mut found = Vec::new();
        let Some(first) = self.pieces.first() else { return found };
        let mut pieces = [*first; 8];
        let mut active: Bits8 = 0;
        for (lane, piece) in self.pieces.iter().take(8).enumerate() {
            pieces[lane] = *piece;
            active |= 1 << lane;
        }
        let middles = pieces.map(|(from, to)| (from + to) / 2.0);
        let mut samples = Samples::default();
        let mut placed: Vec<PlacedArm<F>> = Vec::with_capacity(self.movers.len());
        for mover in self.movers {
            mover.motion.sample(&pieces, &mut samples);
            placed.push(PlacedArm::room_for(Some(&mover.lanes)));
            if let Some(at) = placed.last_mut() {
                mover.lanes.place(&samples, true, at);
            }
        }
        let mut candidates = Candidates::new();
        for (i, first) in self.movers.iter().enumerate() {
            for (j, second) in self.movers.iter().enumerate().skip(i + 1) {
                if self.still[i] && self.still[j] {
                    continue;
                }
                candidates.clear();
                broad::between_arms(
                    world,
                    (first, second),
                    (&placed[i], &placed[j]),
                    active,
                    &mut candidates,
                );
                if candidates.is_empty() {
                    continue;
                }
                let scenery = Scenery { world, first, second: Some(second), resting: &[] };
                let mut exact = Exact::new(world, first, Some(second), &[]);
                let mut open = 0;
                for candidate in &candidates {
                    let seen = look(&scenery, candidate, (&placed[i], &placed[j]), &middles, &mut exact);
                    if seen.blocked != 0 {
                        found.push(PairLook { pair: (i, j), blocked: true });
                        return found;
                    }
                    open |= seen.open;
                }
                if open != 0 {
                    found.push(PairLook { pair: (i, j), blocked: false });
                }
            }
        }
        found
    }
}
