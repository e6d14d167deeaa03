//! How far joints can move a body from where it is now, by the lever arms that it has now.
//!
//! Let the joints turn one after the other from the tip to the base. While a joint turns, those before
//! it still stand as in the middle of the interval, so its axis is where it is now; those after it
//! have carried a point of the body at most as far as they can. So its lever arm is at most the
//! distance that the point has now, and that.

use super::core::{Carried, LaneCore};
use super::place::PlacedArm;
use crate::geometry::lanes::{Float8, V3, add3, column_sum, splat3, square3, sub3};
use crate::kinematics::{Frame8, MovingFrames};

/// Sums are rounded up by this much, relative.
const ROUND_UP: f32 = 1.0 + 1e-5;

/// A body that is carried towards the base, joint by joint.
struct Carriage<F> {
    /// Two points and a radius that hold it.
    ends: [V3<F>; 2],
    radius: F,
    /// What the joints so far can move it (m).
    moved: F,
}

impl<F: Float8> Carriage<F> {
    #[inline(always)]
    fn new((core, at): Carried<'_, F>) -> Self {
        let (start, along, radius) = match core {
            LaneCore::Capsule(capsule) => {
                let axis = capsule.place(at);
                (axis.start, axis.along, capsule.radius)
            }
            LaneCore::Box { centre, half, .. } => {
                let size = half[0] * half[0] + half[1] * half[1] + half[2] * half[2];
                let centre = match at {
                    Some(frame) => column_sum(&frame.origin, &frame.axes, centre),
                    None => splat3(centre),
                };
                (centre, splat3(&[0.0; 3]), size.sqrt() * ROUND_UP)
            }
        };
        Self { ends: [start, add3(&start, &along)], radius: F::splat(radius), moved: F::splat(0.0) }
    }

    /// Over the joint of one frame.
    #[inline(always)]
    fn over(&mut self, frames: &MovingFrames, index: usize, at: &PlacedArm<F>) {
        let (joint, factor) = frames.drive(index);
        let (stray, frame) = (at.deviation(joint) * F::splat(factor), &at.frames()[index]);
        if frames.slides(index) {
            self.moved = self.moved + stray;
            return;
        }
        let square = aside(&self.ends[0], frame).max(aside(&self.ends[1], frame));
        self.moved = stray.mul_add(square.sqrt() + self.radius + self.moved, self.moved);
    }
}

/// The squared distance (m^2) of a point from a frame's z axis.
#[inline(always)]
fn aside<F: Float8>(point: &V3<F>, frame: &Frame8<F>) -> F {
    let (v, z) = (sub3(point, &frame.origin), &frame.axes[2]);
    square3(&[
        v[1].mul_add(z[2], -(v[2] * z[1])),
        v[2].mul_add(z[0], -(v[0] * z[2])),
        v[0].mul_add(z[1], -(v[1] * z[0])),
    ])
}

/// The most (m) that a body on frame `on` moves against the frame of the placement.
#[inline(always)]
pub(super) fn motion<F: Float8>(
    frames: &MovingFrames,
    at: &PlacedArm<F>,
    body: Carried<'_, F>,
    on: Option<usize>,
) -> F {
    let mut carriage = Carriage::new(body);
    let mut next = on;
    while let Some(index) = next {
        carriage.over(frames, index, at);
        next = frames.parent(index);
    }
    carriage.moved * F::splat(ROUND_UP)
}

/// The most (m) that two bodies of one arm move against each other.
#[inline(always)]
pub(super) fn relative_motion<F: Float8>(
    frames: &MovingFrames,
    at: &PlacedArm<F>,
    (a, on_a): (Carried<'_, F>, Option<usize>),
    (b, on_b): (Carried<'_, F>, Option<usize>),
) -> F {
    let (mut first, mut second) = (Carriage::new(a), Carriage::new(b));
    let (mut x, mut y) = (on_a, on_b);
    // A frame stands on one with a lesser number, so the greater one is never an ancestor of the other.
    while x != y {
        if x > y {
            let Some(index) = x else { break };
            first.over(frames, index, at);
            x = frames.parent(index);
        } else {
            let Some(index) = y else { break };
            second.over(frames, index, at);
            y = frames.parent(index);
        }
    }
    (first.moved + second.moved) * F::splat(ROUND_UP)
}
