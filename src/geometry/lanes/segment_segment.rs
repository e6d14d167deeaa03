//! Distance between segments: the cores of two capsules.

use super::float8::{Float8, V3, dot3, scale3, square3, sub3};

/// Squared lengths (m^2) below this are a point's.
const TINY: f32 = 1e-18;

/// A segment in each lane.
#[derive(Clone, Copy)]
pub struct Segment8<F> {
    /// Where it starts (m).
    pub start: V3<F>,
    /// From there to its end (m).
    pub along: V3<F>,
    /// Its squared length (m^2).
    pub square: F,
    /// One over that, or something large for a point.
    pub inverse: F,
}

impl<F: Float8> Segment8<F> {
    /// The segment from `start` to `start + along`.
    #[inline(always)]
    pub fn new(start: V3<F>, along: V3<F>) -> Self {
        let square = square3(&along);
        let inverse = F::splat(1.0).div(square.max(F::splat(TINY)));
        Self { start, along, square, inverse }
    }

    /// The same where the length (m) is known, all lanes alike.
    #[inline(always)]
    pub fn with_length(start: V3<F>, along: V3<F>, length: f32) -> Self {
        let (square, inverse) = lengths(length);
        Self { start, along, square: F::splat(square), inverse: F::splat(inverse) }
    }
}

/// The squared length (m^2) of a segment of this length (m), and one over that.
pub fn lengths(length: f32) -> (f32, f32) {
    let square = length * length;
    (square, 1.0 / square.max(TINY))
}

/// Squared distance (m^2) between two segments, either of which may be a point.
///
/// Ericson, Real-Time Collision Detection, section 5.1.9, without branches: the free minimiser
/// clamped, then each parameter once more for the other one, which only ever comes nearer.
#[inline(always)]
pub fn segment_segment_squared<F: Float8>(p: &Segment8<F>, q: &Segment8<F>) -> F {
    let (zero, one) = (F::splat(0.0), F::splat(1.0));
    let r = sub3(&p.start, &q.start);
    let b = dot3(&p.along, &q.along);
    let c = dot3(&p.along, &r);
    let f = dot3(&q.along, &r);
    let denominator = b.neg_mul_add(b, p.square * q.square).max(F::splat(TINY));
    let s = c.neg_mul_add(q.square, b * f).div(denominator).clamp(zero, one);
    let t = (b.mul_add(s, f) * q.inverse).clamp(zero, one);
    let s = (b.mul_add(t, -c) * p.inverse).clamp(zero, one);
    let gap = scale3(&scale3(&r, &p.along, s), &q.along, -t);
    square3(&gap)
}
