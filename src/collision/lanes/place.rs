//! An arm put in its place at eight instants, and the room for that.

use std::cell::RefCell;

use smallvec::SmallVec;

use super::arm::{Row, UNMOVED};
use super::core::LaneCapsule;
use super::mover::{LaneMover, Samples};
use crate::geometry::lanes::{Float8, Segment8, V3};
use crate::kinematics::{Frame8, Frames8};

/// Limbs of one arm or several; those of most arms need no memory of their own.
pub(super) type Limbs<F> = SmallVec<[PlacedLimb<F>; 8]>;

/// An arm at eight instants. Made once and used for one batch after the other; nothing in it is
/// cleared that is written before it is read.
pub(super) struct PlacedArm<F> {
    /// Where its joints are.
    pub(super) samples: Samples,
    frames: Frames8<F>,
    /// Whether nothing strays.
    pub(super) still: bool,
    /// The box around all limbs, each grown by its own need.
    pub(super) low: V3<F>,
    pub(super) high: V3<F>,
    /// How far atoms move at most (m), where somebody has asked.
    motions: RefCell<SmallVec<[(u16, F); 8]>>,
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
    fn new(capsule: &LaneCapsule, frame: Option<&Frame8<F>>, need: F) -> Self {
        let axis = capsule.place(frame);
        let (mut low, mut high) = (axis.start, axis.start);
        for k in 0..3 {
            let a = axis.start[k];
            let b = a + axis.along[k];
            low[k] = a.min(b) - need;
            high[k] = a.max(b) + need;
        }
        let (square, inverse) = (capsule.square, capsule.inverse);
        Self { start: axis.start, along: axis.along, square, inverse, need, low, high }
    }
}

impl<F: Float8> PlacedArm<F> {
    /// An arm to be placed by [`Self::place`].
    #[inline(always)]
    pub(super) fn new() -> Self {
        let none = [F::splat(0.0); 3];
        Self {
            samples: Samples::default(),
            frames: Frames8::new(),
            still: false,
            low: none,
            high: none,
            motions: RefCell::new(SmallVec::new()),
        }
    }

    /// The frames, in the order of the arm's.
    #[inline(always)]
    pub(super) fn frames(&self) -> &[Frame8<F>] {
        &self.frames
    }

    /// How far a joint strays (rad or m).
    #[inline(always)]
    pub(super) fn deviation(&self, joint: usize) -> F {
        F::load(&self.samples.deviations[joint])
    }

    /// How far the atom with this number moves at most (m), if that was asked before.
    #[inline(always)]
    pub(super) fn motion_of(&self, atom: u16) -> Option<F> {
        for (known, motion) in self.motions.borrow().iter() {
            if *known == atom {
                return Some(*motion);
            }
        }
        None
    }

    /// Keeps that.
    #[inline(always)]
    pub(super) fn remember_motion(&self, atom: u16, motion: F) {
        self.motions.borrow_mut().push((atom, motion));
    }

    /// Places the frames as [`Self::samples`] say. `still` says that nothing strays.
    #[inline(always)]
    pub(super) fn place(&mut self, mover: &LaneMover<'_>, still: bool) {
        mover.arm.frames.place(&self.samples.values, &mut self.frames);
        self.still = still;
        self.motions.get_mut().clear();
    }

    /// Adds the limbs to `limbs`, the held object last, and lays the box around them.
    #[inline(always)]
    pub(super) fn place_limbs(&mut self, mover: &LaneMover<'_>, limbs: &mut Limbs<F>) {
        let held = mover.held.as_ref().map(|held| &held.limb);
        let (mut low, mut high) = ([F::splat(f32::INFINITY); 3], [F::splat(f32::NEG_INFINITY); 3]);
        for limb in mover.arm.limbs.iter().chain(held) {
            let mut need = F::splat(limb.capsule.radius);
            if limb.frame.is_some() && !self.still {
                need = need + motion_bound(&limb.levers, &self.samples.deviations);
            }
            let frame = limb.frame.map(|frame| &self.frames[frame]);
            let placed = PlacedLimb::new(&limb.capsule, frame, need);
            for k in 0..3 {
                low[k] = low[k].min(placed.low[k]);
                high[k] = high[k].max(placed.high[k]);
            }
            limbs.push(placed);
        }
        (self.low, self.high) = (low, high);
    }
}

/// The most (m) that a body with these lever arms moves while the joints stray.
#[inline(always)]
pub(super) fn motion_bound<F: Float8>(levers: &Row, deviations: &[[f32; 8]]) -> F {
    let mut sum = F::splat(0.0);
    for (lever, deviation) in levers.iter().zip(deviations) {
        if *lever != UNMOVED {
            sum = F::splat(*lever).mul_add(F::load(deviation), sum);
        }
    }
    sum
}
