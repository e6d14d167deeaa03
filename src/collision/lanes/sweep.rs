//! An arm's limbs over a span of time, put in their places once and compared with those of many others.

use smallvec::SmallVec;

use super::place::{Limbs, PlacedArm, StoredLimb};
use super::{broad, cubics};
use crate::collision::world::{CollisionWorld, Mover};
use crate::geometry::lanes::{Bits8, Float8, Kernel, V3};

/// Pieces that are placed at a time.
pub(in crate::collision) const BATCH: usize = 8;

/// What the limbs of an arm, with what it holds, sweep in each piece of a span.
#[derive(Debug, Clone)]
pub(in crate::collision) struct LaneSweep {
    /// By eight pieces.
    batches: SmallVec<[Batch; 2]>,
}

/// The same in eight pieces.
#[derive(Debug, Clone)]
struct Batch {
    limbs: SmallVec<[StoredLimb; 5]>,
    /// The box around all limbs.
    low: [[f32; BATCH]; 3],
    high: [[f32; BATCH]; 3],
}

/// To be run by [`crate::geometry::lanes::InstructionSet::run`].
pub(in crate::collision) struct Sweep<'a> {
    pub(in crate::collision) mover: &'a Mover<'a>,
    /// The pieces, by eights.
    pub(in crate::collision) pieces: &'a [[(f64, f64); BATCH]],
}

impl Kernel for Sweep<'_> {
    type Output = LaneSweep;

    #[inline(always)]
    fn run<F: Float8>(self) -> LaneSweep {
        let mover = self.mover;
        let (mut at, mut limbs) = (PlacedArm::<F>::new(), Limbs::new());
        let mut batches = SmallVec::new();
        for pieces in self.pieces {
            cubics::sample::<F>(mover.motion, pieces, &mut at.samples);
            at.place(&mover.lanes, false);
            limbs.clear();
            at.place_limbs(&mover.lanes, &mut limbs);
            let mut stored = SmallVec::new();
            for limb in &limbs {
                stored.push(limb.store());
            }
            let (low, high) = (at.low.map(|x| x.store()), at.high.map(|x| x.store()));
            batches.push(Batch { limbs: stored, low, high });
        }
        LaneSweep { batches }
    }
}

/// In which pieces limbs of two arms are near each other, by eights; the sweeps have the same pieces. To be run by
/// [`crate::geometry::lanes::InstructionSet::run`].
pub(in crate::collision) struct Near<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) first: &'a LaneSweep,
    pub(in crate::collision) second: &'a LaneSweep,
}

impl Kernel for Near<'_> {
    type Output = SmallVec<[Bits8; 2]>;

    #[inline(always)]
    fn run<F: Float8>(self) -> Self::Output {
        let (mut ours, mut theirs) = (Limbs::<F>::new(), Limbs::new());
        let mut near = SmallVec::new();
        for (first, second) in self.first.batches.iter().zip(&self.second.batches) {
            let bounds: [V3<F>; 2] = [load(&first.low), load(&first.high)];
            let others: [V3<F>; 2] = [load(&second.low), load(&second.high)];
            let (bounds, others) = ((&bounds[0], &bounds[1]), (&others[0], &others[1]));
            let among = broad::boxes_meet(self.world, bounds, others, Bits8::MAX);
            if among == 0 {
                near.push(0);
                continue;
            }
            ours.clear();
            theirs.clear();
            for limb in &first.limbs {
                ours.push(limb.load());
            }
            for limb in &second.limbs {
                theirs.push(limb.load());
            }
            let limbs = broad::limbs_near(self.world, ((&ours, &theirs), bounds, others), among);
            near.push(limbs.iter().fold(0, |all, (.., lanes)| all | lanes));
        }
        near
    }
}

#[inline(always)]
fn load<F: Float8>(rows: &[[f32; BATCH]; 3]) -> V3<F> {
    [F::load(&rows[0]), F::load(&rows[1]), F::load(&rows[2])]
}
