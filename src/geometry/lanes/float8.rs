//! What kernels may do with eight numbers, and three-vectors of them.

use std::ops::{Add, Mul, Neg, Sub};

/// A set of lanes, lane 0 in the lowest bit.
pub type Bits8 = u8;

/// Eight f32 that are worked on together.
///
/// Comparisons answer with a bit per lane; a NaN compares as false.
pub trait Float8:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// What a comparison gives, for [`Float8::select`].
    type Mask: Copy;

    /// The same number in every lane.
    fn splat(value: f32) -> Self;
    /// One number for each lane.
    fn load(values: &[f32; 8]) -> Self;
    /// The numbers of all lanes.
    fn store(self) -> [f32; 8];
    /// `self * factor + term`, rounded once or twice.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    /// `term - self * factor`, rounded once or twice.
    fn neg_mul_add(self, factor: Self, term: Self) -> Self;
    /// The quotient.
    fn div(self, divisor: Self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// The lesser one; `other` where either is NaN.
    fn min(self, other: Self) -> Self;
    /// The greater one; `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// The absolute value.
    fn abs(self) -> Self;
    /// The nearest whole number.
    fn round(self) -> Self;
    /// Where `self < other`.
    fn less(self, other: Self) -> Self::Mask;
    /// Where both masks hold.
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// The mask as bits.
    fn bits(mask: Self::Mask) -> Bits8;
    /// `yes` where the mask holds, `no` elsewhere.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Sine and cosine from those of the angle less `quarters` (whole numbers) right angles.
    fn turn_quarters(quarters: Self, sine: Self, cosine: Self) -> (Self, Self);

    /// The least of the eight.
    fn least(self) -> f32;
    /// The greatest of the eight.
    fn greatest(self) -> f32;

    /// The number moved into `[low, high]`.
    #[inline(always)]
    fn clamp(self, low: Self, high: Self) -> Self {
        self.max(low).min(high)
    }
}

/// A vector in each lane.
pub type V3<F> = [F; 3];

/// The same vector in every lane.
#[inline(always)]
pub fn splat3<F: Float8>(v: &[f32; 3]) -> V3<F> {
    [F::splat(v[0]), F::splat(v[1]), F::splat(v[2])]
}

/// `a + b`.
#[inline(always)]
pub fn add3<F: Float8>(a: &V3<F>, b: &V3<F>) -> V3<F> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline(always)]
pub fn sub3<F: Float8>(a: &V3<F>, b: &V3<F>) -> V3<F> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + b * s`.
#[inline(always)]
pub fn scale3<F: Float8>(a: &V3<F>, b: &V3<F>, s: F) -> V3<F> {
    [b[0].mul_add(s, a[0]), b[1].mul_add(s, a[1]), b[2].mul_add(s, a[2])]
}

/// The dot product.
#[inline(always)]
pub fn dot3<F: Float8>(a: &V3<F>, b: &V3<F>) -> F {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// The squared length.
#[inline(always)]
pub fn square3<F: Float8>(a: &V3<F>) -> F {
    dot3(a, a)
}

/// `start + x v0 + y v1 + z v2`, for a fixed `v` and columns `x y z`; leaves out what is zero.
#[inline(always)]
pub fn column_sum<F: Float8>(start: &V3<F>, columns: &[V3<F>; 3], v: &[f32; 3]) -> V3<F> {
    let mut sum = *start;
    for k in 0..3 {
        if v[k] != 0.0 {
            sum = scale3(&sum, &columns[k], F::splat(v[k]));
        }
    }
    sum
}
