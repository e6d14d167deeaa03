//! An arm put in its place at eight instants, and the room for that.

use std::cell::Cell;

use smallvec::SmallVec;

use super::arm::{Row, UNMOVED};
use super::core::LaneCapsule;
use super::mover::{LaneMover, Samples};
use crate::geometry::lanes::{Float8, Segment8, V3};
use crate::kinematics::Frame8;

/// Frames, or limbs, that have room without asking for memory.
const NEAR: usize = 8;

/// Atoms whose motion is remembered within a batch.
const REMEMBERED: usize = 24;

/// An arm at eight instants. Made once and used for one batch after the other, since to clear so much
/// costs as much as to check some pairs.
pub(super) struct PlacedArm<F> {
    frames: [Frame8<F>; NEAR],
    limbs: [PlacedLimb<F>; NEAR],
    /// Used instead where there are more.
    many_frames: Vec<Frame8<F>>,
    many_limbs: Vec<PlacedLimb<F>>,
    counts: (usize, usize),
    /// By joint how far it strays (rad or m).
    pub(super) deviations: SmallVec<[F; 8]>,
    /// Whether nothing strays.
    pub(super) still: bool,
    /// The box around all limbs, each grown by its own need.
    pub(super) low: V3<F>,
    pub(super) high: V3<F>,
    /// How far atoms move at most (m), where somebody has asked, and which those are.
    motions: [Cell<F>; REMEMBERED],
    asked: Cell<u32>,
}

/// A limb at eight instants.
#[derive(Clone, Copy)]
pub(super) struct PlacedLimb<F> {
    start: V3<F>,
    along: V3<F>,
    square: f32,
    inverse: f32,
    /// Its radius and the most that it moves in the interval (m).
    pub(super) need: F,
    /// The box around it, grown by that.
    pub(super) low: V3<F>,
    pub(super) high: V3<F>,
}

impl<F: Float8> PlacedLimb<F> {
    /// Its axis.
    #[inline(always)]
    pub(super) fn axis(&self) -> Segment8<F> {
        Segment8 {
            start: self.start,
            along: self.along,
            square: F::splat(self.square),
            inverse: F::splat(self.inverse),
        }
    }

    /// The box around its boxes in all lanes, grown by `margin` (m): low and high.
    #[inline(always)]
    pub(super) fn hull(&self, margin: f32) -> ([f32; 3], [f32; 3]) {
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for k in 0..3 {
            low[k] = self.low[k].least() - margin;
            high[k] = self.high[k].greatest() + margin;
        }
        (low, high)
    }

    #[inline(always)]
    fn put(&mut self, capsule: &LaneCapsule, frame: Option<&Frame8<F>>, need: F) {
        let axis = capsule.place(frame);
        (self.start, self.along, self.need) = (axis.start, axis.along, need);
        (self.square, self.inverse) = (capsule.square, capsule.inverse);
        for k in 0..3 {
            let a = axis.start[k];
            let b = a + axis.along[k];
            self.low[k] = a.min(b) - need;
            self.high[k] = a.max(b) + need;
        }
    }
}

impl<F: Float8> PlacedArm<F> {
    /// Room for `mover`, to be filled by [`Self::place`].
    #[inline(always)]
    pub(super) fn room_for(mover: &LaneMover<'_>) -> Self {
        let zero = F::splat(0.0);
        let none = [zero; 3];
        let limb = PlacedLimb {
            start: none,
            along: none,
            square: 0.0,
            inverse: 0.0,
            need: zero,
            low: none,
            high: none,
        };
        let frame = Frame8::zero();
        let mut room = Self {
            frames: [frame; NEAR],
            limbs: [limb; NEAR],
            many_frames: Vec::new(),
            many_limbs: Vec::new(),
            counts: (0, 0),
            deviations: SmallVec::new(),
            still: false,
            low: none,
            high: none,
            motions: std::array::from_fn(|_| Cell::new(zero)),
            asked: Cell::new(0),
        };
        room.fit(mover);
        room
    }

    /// Makes it room for another mover.
    #[inline(always)]
    pub(super) fn fit(&mut self, mover: &LaneMover<'_>) {
        self.counts = (mover.arm.frames.len(), mover.limb_count());
        if self.counts.0 > NEAR {
            self.many_frames.resize(self.counts.0, self.frames[0]);
        }
        if self.counts.1 > NEAR {
            self.many_limbs.resize(self.counts.1, self.limbs[0]);
        }
    }

    /// The frames, in the order of the arm's.
    #[inline(always)]
    pub(super) fn frames(&self) -> &[Frame8<F>] {
        if self.counts.0 <= NEAR { &self.frames[..self.counts.0] } else { &self.many_frames }
    }

    /// The limbs, the held object last.
    #[inline(always)]
    pub(super) fn limbs(&self) -> &[PlacedLimb<F>] {
        if self.counts.1 <= NEAR { &self.limbs[..self.counts.1] } else { &self.many_limbs }
    }

    /// How far the atom with this number moves at most (m), if that was asked before.
    #[inline(always)]
    pub(super) fn motion_of(&self, atom: u16) -> Option<F> {
        let known = self.asked.get() >> u32::from(atom).min(31) & 1 == 1;
        if known { self.motions.get(usize::from(atom)).map(Cell::get) } else { None }
    }

    /// Keeps that.
    #[inline(always)]
    pub(super) fn remember_motion(&self, atom: u16, motion: F) {
        if let Some(cell) = self.motions.get(usize::from(atom)) {
            cell.set(motion);
            self.asked.set(self.asked.get() | 1 << atom);
        }
    }

    /// Places frames and, with `with_limbs`, the limbs. `still` says that nothing strays.
    #[inline(always)]
    pub(super) fn place(&mut self, mover: &LaneMover<'_>, samples: &Samples, with_limbs: bool, still: bool) {
        let frames =
            if self.counts.0 <= NEAR { &mut self.frames[..self.counts.0] } else { &mut self.many_frames[..] };
        mover.arm.frames.place(&samples.values, frames);
        self.still = still;
        self.asked.set(0);
        self.deviations.clear();
        for deviation in &samples.deviations {
            self.deviations.push(F::load(deviation));
        }
        if !with_limbs {
            return;
        }
        let limbs =
            if self.counts.1 <= NEAR { &mut self.limbs[..self.counts.1] } else { &mut self.many_limbs[..] };
        let held = mover.held.as_ref().map(|held| &held.limb);
        let (mut low, mut high) = ([F::splat(f32::INFINITY); 3], [F::splat(f32::NEG_INFINITY); 3]);
        for (limb, placed) in mover.arm.limbs.iter().chain(held).zip(limbs) {
            let mut need = F::splat(limb.capsule.radius);
            if limb.frame.is_some() && !still {
                need = need + motion_bound(&limb.levers, &self.deviations);
            }
            placed.put(&limb.capsule, limb.frame.map(|frame| &frames[frame]), need);
            for k in 0..3 {
                low[k] = low[k].min(placed.low[k]);
                high[k] = high[k].max(placed.high[k]);
            }
        }
        (self.low, self.high) = (low, high);
    }
}

/// The most (m) that a body with these lever arms moves while the joints stray.
#[inline(always)]
pub(super) fn motion_bound<F: Float8>(levers: &Row, deviations: &[F]) -> F {
    let mut sum = F::splat(0.0);
    for (lever, deviation) in levers.iter().zip(deviations) {
        if *lever != UNMOVED {
            sum = F::splat(*lever).mul_add(*deviation, sum);
        }
    }
    sum
}
