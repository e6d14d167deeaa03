//! Joint values: fitting angles into limits, distances between configurations.

use std::f64::consts::{PI, TAU};

use crate::kinematics::JointLimits;

/// How far (rad) a value may be beyond a limit by rounding and still count as on it.
const LIMIT_SLACK: f64 = 1e-10;

/// The angle `angle` + a multiple of 2 pi that lies within `limits`, the one nearest to `near`.
#[inline]
pub(in crate::kinematics) fn fit(angle: f64, limits: &JointLimits, near: f64) -> Option<f64> {
    let mut value = angle;
    if (near - angle).abs() > PI {
        value += TAU * ((near - angle) / TAU).round();
    }
    if value < limits.lower - LIMIT_SLACK {
        value += TAU * ((limits.lower - LIMIT_SLACK - value) / TAU).ceil();
    } else if value > limits.upper + LIMIT_SLACK {
        value -= TAU * ((value - limits.upper - LIMIT_SLACK) / TAU).ceil();
    }
    let inside = value >= limits.lower - LIMIT_SLACK && value <= limits.upper + LIMIT_SLACK;
    // Not `clamp`, which panics on crossed limits.
    inside.then(|| value.max(limits.lower).min(limits.upper))
}

/// Fits every joint of `q` by [`fit`]; whether all can be. Where not, `q` is left half fitted.
pub(super) fn fit_all(q: &mut [f64], limits: &[JointLimits], near: &[f64]) -> bool {
    q.iter_mut().zip(limits).zip(near).all(|((value, limit), near)| match fit(*value, limit, *near) {
        Some(fitted) => {
            *value = fitted;
            true
        }
        None => false,
    })
}

/// The value within `limits` that is nearest to 0.
pub(super) fn neutral(limits: &JointLimits) -> f64 {
    0.0_f64.max(limits.lower).min(limits.upper)
}

/// The shorter way (rad, not negative) between two angles.
#[inline]
pub(super) fn turn_between(a: f64, b: f64) -> f64 {
    let difference = (a - b).abs();
    if difference <= PI {
        return difference;
    }
    let turn = difference.rem_euclid(TAU);
    turn.min(TAU - turn)
}

/// The weighted square distance of two configurations.
pub(super) fn weighted_square(a: &[f64], b: &[f64], weights: &[f64]) -> f64 {
    a.iter().zip(b).zip(weights).map(|((x, y), w)| w * (x - y) * (x - y)).sum()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn fits_the_nearest_turn(angle in -20.0..20.0_f64, near in -6.0..6.0_f64,
                                 lower in -7.0..0.0_f64, width in 0.0..14.0_f64) {
            let limits = JointLimits { lower, upper: lower + width, velocity: 1.0, acceleration: 1.0 };
            let near = near.max(lower).min(lower + width);
            let brute = (-8..=8)
                .map(|k| angle + TAU * f64::from(k))
                .filter(|v| *v >= limits.lower && *v <= limits.upper)
                .min_by(|a, b| (a - near).abs().total_cmp(&(b - near).abs()));
            match (fit(angle, &limits, near), brute) {
                (Some(found), Some(best)) => {
                    prop_assert!(((found - near).abs() - (best - near).abs()).abs() < 1e-9)
                }
                (found, best) => prop_assert_eq!(found.is_some(), best.is_some()),
            }
        }
    }

    #[test]
    fn continuous_joints_take_the_nearest_turn() {
        let free =
            JointLimits { lower: f64::NEG_INFINITY, upper: f64::INFINITY, velocity: 1.0, acceleration: 1.0 };
        assert!((fit(0.5, &free, 100.0).unwrap() - (0.5 + 16.0 * TAU)).abs() < 1e-12);
    }
}
