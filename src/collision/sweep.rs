//! Where two arms may come near each other at all, each of them put in its places once for all others.

use super::certify::JointMotion;
use super::lanes::{BATCH, LaneSweep, Near, Sweep};
use super::scene::{Exemption, Held};
use super::world::CollisionWorld;
use crate::workcell::ArmId;

/// Eights of pieces into which a span is cut.
const BATCHES: usize = 2;

/// What an arm and what it holds sweep over a span of time, in pieces.
#[derive(Debug, Clone)]
pub struct Swept {
    span: (f64, f64),
    lanes: LaneSweep,
}

impl CollisionWorld {
    /// What `motion` sweeps over `span` (s).
    pub fn sweep(
        &self,
        arm: ArmId,
        motion: &dyn JointMotion,
        held: Option<&Held>,
        span: (f64, f64),
    ) -> Swept {
        let mover = self.mover(arm, motion, held, Exemption::default());
        let pieces: [[(f64, f64); BATCH]; BATCHES] =
            std::array::from_fn(|batch| std::array::from_fn(|lane| piece(span, batch * BATCH + lane)));
        Swept { span, lanes: self.set.run(Sweep { mover: &mover, pieces: &pieces }) }
    }

    /// The spans of time, in order, outside which two arms over one span are certified apart, whatever may touch.
    pub fn encounters(&self, first: &Swept, second: &Swept) -> Vec<(f64, f64)> {
        if first.span != second.span {
            return vec![(first.span.0.min(second.span.0), first.span.1.max(second.span.1))];
        }
        let near = self.set.run(Near { world: self, first: &first.lanes, second: &second.lanes });
        let mut found: Vec<(f64, f64)> = Vec::new();
        for number in (0..BATCHES * BATCH).filter(|n| near[n / BATCH] >> (n % BATCH) & 1 == 1) {
            let (from, to) = piece(first.span, number);
            match found.last_mut() {
                Some(last) if last.1 == from => last.1 = to,
                _ => found.push((from, to)),
            }
        }
        found
    }
}

/// The piece of `span` with this number.
fn piece(span: (f64, f64), number: usize) -> (f64, f64) {
    let edge = |n: usize| span.0 + (span.1 - span.0) * n as f64 / (BATCHES * BATCH) as f64;
    (edge(number), edge(number + 1))
}
