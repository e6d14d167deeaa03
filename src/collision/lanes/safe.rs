//! Values of one joint at which a pair of one arm's atoms cannot touch, where that joint alone decides
//! how they lie to each other.
//!
//! Links that come near each other within the limits would have to be looked at again and again. But a
//! capsule that turns about its own axis stays where it is, so that of the joints between two links of
//! an arm often but one is left; then it is enough to compare that joint's value.

use smallvec::SmallVec;

use super::arm::{LaneAtom, Row, UNMOVED};
use super::core::{LaneCapsule, LaneCore, separation};
use super::limb::{Ball, Enclosure};
use super::place::PlacedArm;
use crate::geometry::Vec3;
use crate::geometry::lanes::{Bits8, Float8, Kernel};
use crate::kinematics::{Frames8, JointLimits, MovingFrames};

/// Into how many pieces a joint's range is cut.
const PIECES: usize = 128;

/// A capsule's axis this near (m) to a joint's axis counts as lying on it.
const ON_AXIS: f32 = 1e-6;

/// A range of a joint's values.
#[derive(Debug, Clone)]
pub(super) struct SafeRange {
    joint: usize,
    middle: f32,
    half: f32,
}

impl SafeRange {
    /// Lanes in which the joint stays within.
    #[inline(always)]
    pub(super) fn holds<F: Float8>(&self, at: &PlacedArm<F>) -> Bits8 {
        let mut away = (F::load(&at.samples.values[self.joint]) - F::splat(self.middle)).abs();
        if !at.still {
            away = away + at.deviation(self.joint);
        }
        F::bits(away.less(F::splat(self.half)))
    }
}

/// The question at which values of a joint some pairs are at least `margin` (m) apart.
pub(super) struct SafeValues<'a> {
    pub(super) frames: &'a MovingFrames,
    /// Each with how far the joint moves one against the other (m per rad); no other joint does.
    pub(super) pairs: &'a [(&'a LaneAtom, &'a LaneAtom, f32)],
    pub(super) joint: usize,
    pub(super) limits: &'a [JointLimits],
    pub(super) margin: f32,
}

impl Kernel for SafeValues<'_> {
    /// The longest range without a gap.
    type Output = Option<SafeRange>;

    #[inline(always)]
    fn run<F: Float8>(self) -> Option<SafeRange> {
        let limit = self.limits.get(self.joint)?;
        let turn = std::f64::consts::PI;
        let low = if limit.lower.is_finite() { limit.lower } else { -turn } as f32;
        let high = if limit.upper.is_finite() { limit.upper } else { turn } as f32;
        let piece = (high - low) / PIECES as f32;
        let mut frames = Frames8::<F>::new();
        let mut q: SmallVec<[[f32; 8]; 8]> = SmallVec::from_elem([0.0; 8], self.limits.len());
        let (mut start, mut longest) = (0, (0, 0));
        for first in (0..PIECES).step_by(8) {
            for (lane, x) in q[self.joint].iter_mut().enumerate() {
                *x = low + ((first + lane) as f32 + 0.5) * piece;
            }
            self.frames.place(&q, &mut frames);
            let mut near: Bits8 = 0;
            for (a, b, lever) in self.pairs {
                let placed = (&a.core, a.frame.map(|frame| &frames[frame]));
                let apart = separation(placed, (&b.core, b.frame.map(|frame| &frames[frame])));
                let need = self.margin + lever * piece * (0.5 + 1e-4);
                // What is no number is not apart.
                near |= !F::bits(F::splat(need).less(apart));
            }
            for lane in 0..8 {
                if near >> lane & 1 == 1 {
                    start = first + lane + 1;
                } else if first + lane + 1 - start > longest.1 - longest.0 {
                    longest = (start, first + lane + 1);
                }
            }
        }
        let (from, to) = (longest.0 as f32, longest.1 as f32);
        let half = (to - from) / 2.0 * piece * (1.0 - 1e-4);
        (half > 0.0).then(|| SafeRange { joint: self.joint, middle: low + (from + to) / 2.0 * piece, half })
    }
}

/// Strikes from `levers` the joints that turn one of two bodies about the axis of its own capsule:
/// these do not change how far apart the two cores are. Bodies for which `counts` is false are left
/// out of it.
pub(super) fn strike_own_turns(
    frames: &MovingFrames,
    (a, b): (&LaneAtom, &LaneAtom),
    several: &[bool],
    counts: impl Fn(&LaneAtom) -> bool,
    levers: &mut Row,
) {
    // The way from one to the other: up from each to where both ways meet.
    let (mut from_a, mut from_b) = (a.frame, b.frame);
    let (mut first_of_a, mut first_of_b) = (None, None);
    while from_a != from_b {
        let (way, last) =
            if from_a > from_b { (&mut from_a, &mut first_of_a) } else { (&mut from_b, &mut first_of_b) };
        let Some(frame) = *way else { return };
        *last = Some(frame);
        *way = frames.parent(frame);
    }
    let mut strike = |frame: usize, atom: &LaneAtom, point: [f32; 3], direction: [f32; 3]| {
        let (joint, _) = frames.drive(frame);
        if !frames.slides(frame) && !several[joint] && counts(atom) && lies_on(&atom.core, point, direction) {
            levers[joint] = UNMOVED;
        }
    };
    for (atom, own_way, other_way) in [(a, first_of_a, first_of_b), (b, first_of_b, first_of_a)] {
        // The joint next to a body is that of its own frame where the way goes up from it, else the
        // first one on the way down to the other body.
        match (own_way.and(atom.frame), other_way) {
            (Some(own), _) => strike(own, atom, [0.0; 3], [0.0, 0.0, 1.0]),
            (None, Some(next)) => {
                let (point, direction) = frames.axis(next);
                strike(next, atom, point, direction);
            }
            (None, None) => {}
        }
    }
}

/// The atom with a capsule about its joint's axis that holds its core, where that is a box that turns.
pub(super) fn rounded(atom: &LaneAtom, frames: &MovingFrames) -> Option<LaneAtom> {
    let LaneCore::Box { centre, axes, half } = &atom.core else { return None };
    if frames.slides(atom.frame?) {
        return None;
    }
    let double = |v: &[f32; 3]| Vec3::new(v[0].into(), v[1].into(), v[2].into());
    let corner = |number: usize| {
        (0..3).fold(double(centre), |at, k| {
            let sign = if number >> k & 1 == 0 { 1.0 } else { -1.0 };
            at + double(&axes[k]) * (sign * f64::from(half[k]))
        })
    };
    let corners: Vec<Ball> = (0..8).map(|number| (corner(number), 0.0)).collect();
    let around = Enclosure::along(&corners, &Vec3::zeros(), &Vec3::z());
    let core = LaneCore::Capsule(LaneCapsule::new(&around.a, &around.b, around.radius * (1.0 + 1e-6)));
    Some(LaneAtom { core, ..atom.clone() })
}

/// Whether a core is a capsule whose axis lies on the line through `point` along `direction`.
fn lies_on(core: &LaneCore, point: [f32; 3], direction: [f32; 3]) -> bool {
    let LaneCore::Capsule(capsule) = core else { return false };
    let aside = |end: [f32; 3]| {
        let v = [0, 1, 2].map(|k| end[k] - point[k]);
        let height = (0..3).map(|k| v[k] * direction[k]).sum::<f32>();
        (0..3).map(|k| (v[k] - height * direction[k]).powi(2)).sum::<f32>().sqrt()
    };
    let end = [0, 1, 2].map(|k| capsule.start[k] + capsule.along[k]);
    aside(capsule.start) < ON_AXIS && aside(end) < ON_AXIS
}
