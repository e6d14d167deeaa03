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
    radius: f32,
    /// Its radius and the most that it moves in the interval (m).
    pub(super) need: F,
}

/// A [`PlacedLimb`] that is kept.
#[derive(Debug, Clone)]
pub(super) struct StoredLimb {
    start: [[f32; 8]; 3],
    along: [[f32; 8]; 3],
    square: f32,
    inverse: f32,
    radius: f32,
    need: [f32; 8],
}

impl StoredLimb {
    /// The limb to be compared.
    #[inline(always)]
    pub(super) fn load<F: Float8>(&self) -> PlacedLimb<F> {
        let Self { square, inverse, radius, .. } = *self;
        let row = |rows: &[[f32; 8]; 3]| [F::load(&rows[0]), F::load(&rows[1]), F::load(&rows[2])];
        let (start, along, need) = (row(&self.start), row(&self.along), F::load(&self.need));
        PlacedLimb { start, along, square, inverse, radius, need }
    }
}

impl<F: Float8> PlacedLimb<F> {
    /// The limb to be kept.
    #[inline(always)]
    pub(super) fn store(&self) -> StoredLimb {
        let Self { square, inverse, radius, .. } = *self;
        let row = |v: &V3<F>| [v[0].store(), v[1].store(), v[2].store()];
        let (start, along, need) = (row(&self.start), row(&self.along), self.need.store());
        StoredLimb { start, along, square, inverse, radius, need }
    }

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

    /// The box around it, grown by its need: low and high. Few ask, so it is not kept.
    #[inline(always)]
    pub(super) fn bounds(&self) -> (V3<F>, V3<F>) {
        let (mut low, mut high) = (self.start, self.start);
        for k in 0..3 {
            (low[k], high[k]) = self.extent(k);
        }
        (low, high)
    }

    /// The same along one of the placement's axes.
    #[inline(always)]
    pub(super) fn extent(&self, k: usize) -> (F, F) {
        let (a, b) = (self.start[k], self.start[k] + self.along[k]);
        (a.min(b) - self.need, a.max(b) + self.need)
    }

    #[inline(always)]
    fn new(capsule: &LaneCapsule, frame: Option<&Frame8<F>>, need: F) -> Self {
        let axis = capsule.place(frame);
        let (square, inverse) = (capsule.square, capsule.inverse);
        Self { start: axis.start, along: axis.along, square, inverse, radius: capsule.radius, need }
    }

    /// The most that it moves in the interval (m).
    #[inline(always)]
    pub(super) fn moves(&self) -> F {
        self.need - F::splat(self.radius)
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
                need = need + bound_of(&limb.swings, &self.samples.deviations);
            }
            let frame = limb.frame.map(|frame| &self.frames[frame]);
            let placed = PlacedLimb::new(&limb.capsule, frame, need);
            for k in 0..3 {
                let (least, greatest) = placed.extent(k);
                low[k] = low[k].min(least);
                high[k] = high[k].max(greatest);
            }
            limbs.push(placed);
        }
        (self.low, self.high) = (low, high);
    }
}

/// The most (m) that a body moves while the joints stray (by something finite), with a lever arm of 0 for those that do
/// not move it.
#[inline(always)]
fn bound_of<F: Float8>(levers: &Row, deviations: &[[f32; 8]]) -> F {
    let mut sum = F::splat(0.0);
    for (lever, deviation) in levers.iter().zip(deviations) {
        sum = F::splat(*lever).mul_add(F::load(deviation), sum);
    }
    sum
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
