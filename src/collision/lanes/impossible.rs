//! Pairs of one arm's atoms that can never touch, proved once: over all values of the joints that
//! move them against each other the motion bound of a box of values is smaller than the distance
//! in its middle, or else the box is cut.

use smallvec::SmallVec;

use super::arm::{LaneAtom, Row, UNMOVED};
use super::core::separation;
use super::place::motion_bound;
use crate::geometry::lanes::{Float8, Kernel};
use crate::kinematics::{Frames8, JointLimits, MovingFrames};

/// Boxes that are cut before a proof is given up.
const GREATEST_CUTS: usize = 80;

/// Values beyond this (rad) repeat those within, for a joint without limits that turns.
const HALF_TURN: f64 = std::f64::consts::PI;

/// The question whether two atoms are always at least `margin` (m) apart.
pub(super) struct NeverTouch<'a> {
    pub(super) frames: &'a MovingFrames,
    pub(super) pair: (&'a LaneAtom, &'a LaneAtom),
    /// How joints move them against each other.
    pub(super) levers: &'a Row,
    pub(super) limits: &'a [JointLimits],
    /// By joint, whether a whole turn of it brings back all that it moves.
    pub(super) turns: &'a [bool],
    pub(super) margin: f32,
}

/// A box of joint values: middles and half widths.
#[derive(Clone)]
struct Values {
    middle: Row,
    half: Row,
}

impl NeverTouch<'_> {
    /// All values; `None` where there is no end to them.
    fn all(&self, levers: &Row) -> Option<Values> {
        let mut all = Values { middle: Row::new(), half: Row::new() };
        for (joint, limit) in self.limits.iter().enumerate() {
            let (mut low, mut high) = (limit.lower, limit.upper);
            let within_a_turn = high - low <= 2.0 * HALF_TURN;
            if self.turns[joint] && !within_a_turn {
                (low, high) = (-HALF_TURN, HALF_TURN);
            }
            let moves = levers[joint] != UNMOVED;
            if moves && !(high - low).is_finite() {
                return None;
            }
            let finite = |x: f64| if x.is_finite() { x as f32 } else { 0.0 };
            all.middle.push(finite((low + high) / 2.0));
            all.half.push(if moves { ((high - low) / 2.0) as f32 * (1.0 + 1e-6) } else { 0.0 });
        }
        Some(all)
    }
}

impl Kernel for NeverTouch<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<F: Float8>(self) -> bool {
        let (a, b) = self.pair;
        let levers = self.levers;
        let Some(all) = self.all(levers) else { return false };
        let mut frames = Frames8::<F>::new();
        let mut open = vec![all];
        let mut cuts = 0;
        while let Some(values) = open.pop() {
            cuts += 1;
            if cuts > GREATEST_CUTS {
                return false;
            }
            // Across the joint that moves the pair most.
            let swing = |joint: &usize| values.half[*joint] * levers[*joint].max(0.0);
            let Some(widest) = (0..levers.len()).max_by(|x, y| swing(x).total_cmp(&swing(y))) else {
                return false;
            };
            let part = values.half[widest] / 8.0;
            let first = values.middle[widest] - 7.0 * part;
            let mut q: SmallVec<[[f32; 8]; 8]> = values.middle.iter().map(|x| [*x; 8]).collect();
            for (lane, x) in q[widest].iter_mut().enumerate() {
                *x = first + 2.0 * part * lane as f32;
            }
            let mut half = values.half.clone();
            half[widest] = part * (1.0 + 1e-5);
            let deviations: SmallVec<[[f32; 8]; 8]> = half.iter().map(|x| [*x; 8]).collect();
            self.frames.place(&q, &mut frames);
            let placed = (&a.core, a.frame.map(|frame| &frames[frame]));
            let apart = separation(placed, (&b.core, b.frame.map(|frame| &frames[frame])));
            let bound = motion_bound::<F>(levers, &deviations) + F::splat(self.margin);
            if F::bits(apart.less(F::splat(self.margin))) != 0 {
                return false;
            }
            let failing = F::bits(apart.less(bound));
            for lane in (0..8).filter(|lane| failing >> lane & 1 == 1) {
                let mut middle = values.middle.clone();
                middle[widest] = q[widest][lane];
                open.push(Values { middle, half: half.clone() });
            }
        }
        true
    }
}
