//! The arctangent of a quotient, without the last digit's guarantee and several times as fast as the
//! system's: what closed forms spend most of their time on.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Below this quotient the series is used as it is, above it from pi/4 on.
const MIDDLE: f64 = 0.66;

/// What pi/4 lacks in double precision.
const MORE_BITS: f64 = 3.061_616_997_868_383e-17;

/// The angle (rad) in [-pi, pi] of the vector (x, y), within 1e-15; 0 for the zero vector, NaN for NaN.
///
/// The quotient is brought into [-0.21, 0.66], then Cephes' rational approximation.
#[inline(always)]
pub(super) fn atan2(y: f64, x: f64) -> f64 {
    let (up, across) = (y.abs(), x.abs());
    let steep = up > across;
    let (short, long) = if steep { (across, up) } else { (up, across) };
    let far = short > MIDDLE * long;
    let (numerator, denominator) = if far { (short - long, short + long) } else { (short, long) };
    let quotient = numerator / denominator;
    let t = if denominator > 0.0 { quotient } else { numerator + denominator };
    let z = t * t;
    let p = (((-0.875_060_860_003_190_4 * z - 16.157_537_187_333_65) * z - 75.008_557_923_147_05) * z
        - 122.886_668_449_013_62)
        * z
        - 64.850_219_049_420_25;
    let q = ((((z + 24.858_464_901_423_062) * z + 165.027_009_831_698_85) * z + 432.881_060_491_290_27) * z
        + 485.390_399_635_913_7)
        * z
        + 194.550_657_148_261_4;
    let near = z * p / q * t + t;
    let angle = if far { near + MORE_BITS + FRAC_PI_4 } else { near };
    let angle = if steep { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

/// The angles (rad) of several vectors by [`atan2`], which goes faster side by side: it branches nowhere.
#[inline]
pub(super) fn atan2_each<const N: usize>(y: [f64; N], x: [f64; N]) -> [f64; N] {
    std::array::from_fn(|i| atan2(y[i], x[i]))
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;

    #[test]
    fn agrees_with_the_system() {
        let mut rng = crate::run::Seed(8).stream("arctangents");
        let mut worst = 0.0_f64;
        for case in 0..200_000 {
            let angle: f64 = rng.random_range(-PI..PI);
            let size = 10.0_f64.powf(rng.random_range(-12.0..3.0));
            let (mut y, mut x) = (size * angle.sin(), size * angle.cos());
            match case % 100 {
                0 => y = 0.0,
                1 => x = 0.0,
                2 => y *= 1e-14,
                3 => x *= 1e-14,
                _ => {}
            }
            worst = worst.max((atan2(y, x) - y.atan2(x)).abs());
        }
        assert!(worst < 1e-15, "{worst}");
        assert_eq!(atan2(0.0, 0.0), 0.0);
        assert_eq!(atan2(0.0, -1.0), PI);
        assert!(atan2(f64::NAN, 1.0).is_nan() && atan2(1.0, f64::NAN).is_nan());
    }
}
