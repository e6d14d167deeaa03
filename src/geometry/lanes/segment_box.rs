//! Distance between a segment and an axis-aligned box around the origin.

// Lanes are counted: the same index goes through several arrays at once.
#![allow(clippy::needless_range_loop)]

use super::float8::{Float8, V3};
use super::segment_segment::Segment8;

/// A squared lower bound (m^2) on the distance, from the segment's own box: cheap, for culling.
#[inline(always)]
pub fn segment_box_outside<F: Float8>(segment: &Segment8<F>, half: &V3<F>) -> F {
    let zero = F::splat(0.0);
    let mut sum = zero;
    for i in 0..3 {
        let (a, b) = (segment.start[i], segment.start[i] + segment.along[i]);
        let gap = a.min(b).max(-a.max(b)) - half[i];
        let gap = gap.max(zero);
        sum = gap.mul_add(gap, sum);
    }
    sum
}

/// Squared distance (m^2) between the segment and the box with half extents `half`; 0 where they
/// meet.
///
/// The derivative of the squared distance along the segment is monotone and linear between the
/// places where the segment crosses a face's plane. The last such place where it is negative and
/// the first where it is positive bracket the minimum.
#[inline(always)]
pub fn segment_box_squared<F: Float8>(segment: &Segment8<F>, half: &V3<F>) -> F {
    let (zero, one) = (F::splat(0.0), F::splat(1.0));
    let (p, d) = (&segment.start, &segment.along);
    let mut low = (zero, slope(p, d, half, zero));
    let mut high = (one, slope(p, d, half, one));
    for i in 0..3 {
        let steep = F::splat(1e-12).less(d[i].abs());
        let inverse = one.div(F::select(steep, d[i], F::splat(1e-12)));
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        for face in [half[i], -half[i]] {
            let t = (face - p[i]) * inverse;
            // On the face's plane the segment is not outside along this axis.
            let out_j = excess(d[j].mul_add(t, p[j]), half[j]);
            let out_k = excess(d[k].mul_add(t, p[k]), half[k]);
            let here = d[j].mul_add(out_j, d[k] * out_k);
            let inside = F::both(low.0.less(t), t.less(high.0));
            // Flat stretches count as falling, so that what is between the brackets is not kinked.
            let falls = F::both(inside, here.less(F::splat(1e-30)));
            let rises = F::both(inside, zero.less(here));
            low = (F::select(falls, t, low.0), F::select(falls, here, low.1));
            high = (F::select(rises, t, high.0), F::select(rises, here, high.1));
        }
    }
    // Where the derivative never changes its sign, the minimum is at an end.
    let span = (high.1 - low.1).max(F::splat(1e-30));
    let inner = (high.0 - low.0).mul_add((-low.1).div(span).clamp(zero, one), low.0);
    let falling = high.1.less(zero);
    let rising = zero.less(low.1);
    let t = F::select(rising, zero, F::select(falling, one, inner));
    let mut sum = zero;
    for i in 0..3 {
        let out = excess(d[i].mul_add(t, p[i]), half[i]);
        sum = out.mul_add(out, sum);
    }
    sum
}

/// How far `x` lies outside of `[-half, half]`, with its sign.
#[inline(always)]
fn excess<F: Float8>(x: F, half: F) -> F {
    x - x.clamp(-half, half)
}

/// Half of the derivative of the squared distance at `t`.
#[inline(always)]
fn slope<F: Float8>(p: &V3<F>, d: &V3<F>, half: &V3<F>, t: F) -> F {
    let mut sum = F::splat(0.0);
    for i in 0..3 {
        sum = d[i].mul_add(excess(d[i].mul_add(t, p[i]), half[i]), sum);
    }
    sum
}
