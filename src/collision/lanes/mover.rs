//! An arm that takes part in a query, placed at eight instants.

use smallvec::SmallVec;

use super::arm::{LaneArm, LaneAtom, Limb, Row, UNMOVED, row};
use super::core::{LaneCapsule, LaneCore};
use crate::collision::world::HeldAtoms;
use crate::geometry::Vec3;
use crate::geometry::lanes::{Float8, Segment8, V3};
use crate::kinematics::{Frame8, Frames8};

/// Joint values and how far they stray, at eight instants.
#[derive(Debug, Clone, Default)]
pub struct Samples {
    /// By joint the values in the middle of each interval (rad or m).
    pub values: SmallVec<[[f32; 8]; 8]>,
    /// By joint how far it is from there at most within the interval (rad or m).
    pub deviations: SmallVec<[[f32; 8]; 8]>,
}

impl Samples {
    /// Makes room for `joints` joints; what was there is lost.
    pub fn resize(&mut self, joints: usize) {
        self.values.resize(joints, [0.0; 8]);
        self.deviations.resize(joints, [0.0; 8]);
    }

    /// Sets one joint in one lane (below 8).
    pub fn set(&mut self, joint: usize, lane: usize, value: f32, deviation: f32) {
        self.values[joint][lane] = value;
        self.deviations[joint][lane] = deviation;
    }
}

/// An arm in a query.
pub(in crate::collision) struct LaneMover<'a> {
    pub(in crate::collision) arm: &'a LaneArm,
    pub(in crate::collision) held: Option<LaneHeld>,
}

/// A held object.
pub(in crate::collision) struct LaneHeld {
    pub(super) limb: Limb,
    pub(super) atoms: SmallVec<[LaneAtom; 1]>,
}

/// An arm at eight instants.
pub(super) struct PlacedArm<F> {
    pub(super) frames: Frames8<F>,
    pub(super) deviations: SmallVec<[F; 8]>,
    /// Its limbs, the held object last.
    pub(super) limbs: SmallVec<[PlacedLimb<F>; 8]>,
    /// The box around all limbs that move, or of which something may be asked, each grown by its
    /// own need.
    pub(super) low: V3<F>,
    pub(super) high: V3<F>,
}

/// A limb at eight instants.
#[derive(Clone, Copy)]
pub(super) struct PlacedLimb<F> {
    pub(super) axis: Segment8<F>,
    /// Its radius and the most that it moves in the interval (m).
    pub(super) need: F,
}

impl<'a> LaneMover<'a> {
    pub(super) fn limb(&self, index: usize) -> Option<&Limb> {
        self.arm.limbs.get(index).or(self.held.as_ref().map(|held| &held.limb))
    }

    /// One of the arm's atoms or, counted after them, of the held object's.
    pub(super) fn atom(&self, index: u16) -> &LaneAtom {
        let (index, own) = (usize::from(index), &self.arm.atoms);
        match &self.held {
            Some(held) if index >= own.len() => &held.atoms[index - own.len()],
            _ => &own[index],
        }
    }

    /// Places frames and limbs.
    #[inline(always)]
    pub(super) fn place<F: Float8>(&self, samples: &Samples, with_limbs: bool, out: &mut PlacedArm<F>) {
        self.arm.frames.place(&samples.values, &mut out.frames);
        out.deviations.clear();
        for deviation in &samples.deviations {
            out.deviations.push(F::load(deviation));
        }
        if !with_limbs {
            return;
        }
        let held = self.held.as_ref().map(|held| &held.limb);
        let count = self.arm.limbs.len() + usize::from(held.is_some());
        let zero = F::splat(0.0);
        if out.limbs.len() != count {
            out.limbs.clear();
            let axis = Segment8 { start: [zero; 3], along: [zero; 3], square: zero, inverse: zero };
            out.limbs.resize(count, PlacedLimb { axis, need: zero });
        }
        let (mut low, mut high) = ([F::splat(f32::INFINITY); 3], [F::splat(f32::NEG_INFINITY); 3]);
        for (limb, placed) in self.arm.limbs.iter().chain(held).zip(&mut out.limbs) {
            // In place, since a limb is too large to be handed around.
            placed.axis = limb.capsule.place(limb.frame.map(|frame| &out.frames[frame]));
            let mut need = F::splat(limb.capsule.radius);
            if limb.frame.is_some() {
                need = need + motion_bound(&limb.levers, &out.deviations);
            }
            placed.need = need;
            for k in 0..3 {
                let a = placed.axis.start[k];
                let b = a + placed.axis.along[k];
                low[k] = low[k].min(a.min(b) - need);
                high[k] = high[k].max(a.max(b) + need);
            }
        }
        (out.low, out.high) = (low, high);
    }
}

impl LaneHeld {
    /// The held object's lanes on `arm`.
    pub(in crate::collision) fn new(arm: &LaneArm, held: &HeldAtoms<'_>) -> Self {
        let (frame, mount) = &arm.mount;
        let body = mount * held.in_mount;
        let levers = row(&held.levers);
        let atoms: SmallVec<[LaneAtom; 1]> = held
            .atoms
            .iter()
            .map(|atom| LaneAtom {
                core: LaneCore::new(atom, &body),
                frame: *frame,
                levers: levers.clone(),
                exact: atom.core_is_exact,
            })
            .collect();
        // A ball around all atoms' balls.
        let centres = held.atoms.iter().map(|atom| atom.centre);
        let middle = centres.sum::<Vec3>() / held.atoms.len().max(1) as f64;
        let radius =
            held.atoms.iter().map(|atom| (atom.centre - middle).norm() + atom.radius).fold(0.0, f64::max);
        let centre = body.rotation * middle + body.translation.vector;
        let capsule = LaneCapsule::new(&centre, &centre, radius);
        let first = arm.atoms.len() as u16;
        let indices = (first..first + held.atoms.len() as u16).collect();
        Self { limb: Limb { capsule, frame: *frame, levers, reach: 0.0, atoms: indices }, atoms }
    }
}

impl<F: Float8> PlacedArm<F> {
    /// Room for `mover`, to be filled by [`LaneMover::place`].
    #[inline(always)]
    pub(super) fn room_for(mover: Option<&LaneMover<'_>>) -> Self {
        let zero = F::splat(0.0);
        let (frames, limbs) = mover.map_or((0, 0), |mover| {
            (mover.arm.frames.len(), mover.arm.limbs.len() + usize::from(mover.held.is_some()))
        });
        let frame = Frame8 { axes: [[zero; 3]; 3], origin: [zero; 3] };
        let axis = Segment8 { start: [zero; 3], along: [zero; 3], square: zero, inverse: zero };
        let limb = PlacedLimb { axis, need: zero };
        // As arrays from the start: to lengthen a list of such large elements one by one is slow.
        Self {
            frames: SmallVec::from_buf_and_len([frame; 8], frames.min(8)),
            deviations: SmallVec::new(),
            limbs: SmallVec::from_buf_and_len([limb; 8], limbs.min(8)),
            low: [zero; 3],
            high: [zero; 3],
        }
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
