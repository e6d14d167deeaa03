//! All arms at once: each placed once for eight pieces of an edge, then every pair.

use smallvec::SmallVec;

use super::broad::{self, Candidates};
use super::cubics;
use super::exact::Exact;
use super::narrow::{Scenery, look};
use super::place::{Limbs, PlacedArm};
use crate::collision::world::{CollisionWorld, Mover};
use crate::geometry::lanes::{Bits8, Float8, Kernel, V3};

/// Where the limbs of an arm begin among those kept, and the corners of its box.
type Coarse<F> = (usize, V3<F>, V3<F>);

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
        // Of each arm only what the coarse look needs is kept; the few that need a closer one are
        // placed again.
        let Some(most) = self.movers.iter().map(|mover| mover.lanes.limb_count()).max() else { return found };
        let mut limbs: Limbs<F> = SmallVec::with_capacity(self.movers.len() * most);
        let mut arms: SmallVec<[Coarse<F>; 16]> = SmallVec::new();
        let mut candidates = Candidates::new();
        let mut at = PlacedArm::<F>::new();
        for mover in self.movers {
            cubics::sample::<F>(mover.motion, &pieces, &mut at.samples);
            at.place(&mover.lanes, false);
            let first = limbs.len();
            at.place_limbs(&mover.lanes, &mut limbs);
            arms.push((first, at.low, at.high));
        }
        let limbs_of = |arm: usize| {
            let to = arms.get(arm + 1).map_or(limbs.len(), |next| next.0);
            &limbs[arms[arm].0..to]
        };
        let (mut one, mut two) = (Closer::<F>::new(), Closer::new());
        for (i, first) in self.movers.iter().enumerate() {
            for (j, second) in self.movers.iter().enumerate().skip(i + 1) {
                if self.still[i] && self.still[j] {
                    continue;
                }
                let (bounds, others) = ((&arms[i].1, &arms[i].2), (&arms[j].1, &arms[j].2));
                let among = broad::boxes_meet(world, bounds, others, active);
                if among == 0 {
                    continue;
                }
                let near = broad::limbs_near(world, ((limbs_of(i), limbs_of(j)), bounds, others), among);
                if near.is_empty() {
                    continue;
                }
                candidates.clear();
                broad::between_arms(world, (first, second), &near, &mut candidates);
                if candidates.is_empty() {
                    continue;
                }
                let scenery = Scenery { world, first, second: Some(second), resting: &[] };
                let mut exact = Exact::new(world, (first, first.motion), Some((second, second.motion)), &[]);
                let at = (one.place(i, first, &pieces), Some(two.place(j, second, &pieces)));
                let mut open = 0;
                for candidate in &candidates {
                    let seen = look(&scenery, candidate, at, &middles, &mut exact);
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

/// An arm that was placed for a closer look: room that is used for one after the other.
struct Closer<F> {
    /// Which of the movers it is.
    number: Option<usize>,
    at: PlacedArm<F>,
}

impl<F: Float8> Closer<F> {
    #[inline(always)]
    fn new() -> Self {
        Self { number: None, at: PlacedArm::new() }
    }

    /// The mover with this number in its place.
    #[inline(always)]
    fn place(&mut self, number: usize, mover: &Mover<'_>, pieces: &[(f64, f64); 8]) -> &PlacedArm<F> {
        if self.number != Some(number) {
            self.number = Some(number);
            cubics::sample::<F>(mover.motion, pieces, &mut self.at.samples);
            self.at.place(&mover.lanes, false);
        }
        &self.at
    }
}
