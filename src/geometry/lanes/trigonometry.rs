//! Sine and cosine of eight angles.

use super::float8::Float8;

/// Sine and cosine (angles in rad, up to some thousand); each within 2e-7 of the true value plus
/// what rounding the angle to f32 has cost.
///
/// Cody and Waite's reduction by right angles in three parts, then the polynomials of the Cephes
/// library on [-pi/4, pi/4].
#[inline(always)]
pub fn sin_cos<F: Float8>(angle: F) -> (F, F) {
    let quarters = (angle * F::splat(std::f32::consts::FRAC_2_PI)).round();
    let mut x = quarters.neg_mul_add(F::splat(1.570_312_5), angle);
    x = quarters.neg_mul_add(F::splat(4.837_513e-4), x);
    x = quarters.neg_mul_add(F::splat(7.549_79e-8), x);
    let square = x * x;
    let mut sine = F::splat(-1.951_529_6e-4).mul_add(square, F::splat(8.332_161e-3));
    sine = sine.mul_add(square, F::splat(-1.666_665_5e-1));
    sine = (sine * square).mul_add(x, x);
    let mut cosine = F::splat(2.443_315_7e-5).mul_add(square, F::splat(-1.388_731_6e-3));
    cosine = cosine.mul_add(square, F::splat(4.166_664_6e-2));
    cosine = (cosine * square).mul_add(square, F::splat(-0.5).mul_add(square, F::splat(1.0)));
    F::turn_quarters(quarters, sine, cosine)
}
