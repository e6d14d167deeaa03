//! Three revolute axes through one point, each perpendicular to the next: a rotation as a product
//! of turns about them (Davenport's chained rotations, brought into z-y-z form).

use nalgebra::{Matrix3, Rotation3, Unit};

use super::arctangent::{atan2, atan2_each};
use crate::geometry::Vec3;

/// Below this sine of the middle angle the outer two angles are not told apart (the rotation is
/// then met to this accuracy).
const SINGULAR_SINE: f64 = 1e-11;

/// The decomposition for three given axes.
#[derive(Debug, Clone)]
pub(super) struct AxisTriple {
    /// Columns: second x first axis, second axis, first axis.
    pub frame: Matrix3<f64>,
    /// Turn by `shift` about the second axis, times the frame.
    pub end: Matrix3<f64>,
    /// The angle (rad) from the first axis to the third, about the second.
    pub shift: f64,
}

/// The middle angle's sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Positive,
    Negative,
}

impl Side {
    pub const BOTH: [Self; 2] = [Self::Positive, Self::Negative];
}

impl AxisTriple {
    /// For the unit axes `first`, `second`, `third`; `None` unless the second is perpendicular to
    /// the other two (1e-9).
    pub fn new(first: &Vec3, second: &Vec3, third: &Vec3) -> Option<Self> {
        if first.dot(second).abs() > 1e-9 || second.dot(third).abs() > 1e-9 {
            return None;
        }
        let side = second.cross(first);
        let frame = Matrix3::from_columns(&[side, *second, *first]);
        let shift = third.dot(&side).atan2(third.dot(first));
        let end = Rotation3::from_axis_angle(&Unit::new_normalize(*second), shift).matrix() * frame;
        Some(Self { frame, end, shift })
    }

    /// The three angles (rad) whose turns about the axes make the rotation R, from
    /// `m` = frame^T R end: with the middle angle (shift included) positive, then negative. Where
    /// the outer two angles are not determined, the first is `hold`.
    #[inline]
    pub fn angles(&self, m: &Matrix3<f64>, hold: f64) -> [[f64; 3]; 2] {
        let sine = (m[(0, 2)] * m[(0, 2)] + m[(1, 2)] * m[(1, 2)]).sqrt();
        if sine < SINGULAR_SINE {
            let (s, c) = hold.sin_cos();
            let middle = atan2(c * m[(0, 2)] + s * m[(1, 2)], m[(2, 2)]);
            let (y, x) = third(m, c, s);
            return [[hold, middle - self.shift, atan2(y, x)]; 2];
        }
        let (c, s) = (m[(0, 2)] / sine, m[(1, 2)] / sine);
        let (y, x) = third(m, c, s);
        let [first, middle, third, _] = atan2_each([s, sine, y, 0.0], [c, m[(2, 2)], x, 1.0]);
        [[first, middle - self.shift, third], [opposite(first), -middle - self.shift, opposite(third)]]
    }
}

/// Sine and cosine of the third angle, from what the first (cosine `c`, sine `s`) leaves over: exact
/// near the singularity, too.
#[inline]
fn third(m: &Matrix3<f64>, c: f64, s: f64) -> (f64, f64) {
    (c * m[(1, 0)] - s * m[(0, 0)], c * m[(1, 1)] - s * m[(0, 1)])
}

/// Half a turn on, kept within a turn about 0.
#[inline]
fn opposite(angle: f64) -> f64 {
    if angle > 0.0 { angle - std::f64::consts::PI } else { angle + std::f64::consts::PI }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn turn(axis: &Vec3, angle: f64) -> Matrix3<f64> {
        *Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle).matrix()
    }

    proptest! {
        #[test]
        fn both_sides_make_the_rotation(
            tilt in -3.0..3.0_f64, q in prop::array::uniform3(-3.1..3.1_f64), straight in any::<bool>(),
        ) {
            let base = Rotation3::from_euler_angles(0.3, -0.7, 1.1);
            let first = base * Vec3::z();
            let second = base * Vec3::y();
            let third = base * Rotation3::from_axis_angle(&Vec3::y_axis(), tilt) * Vec3::z();
            let triple = AxisTriple::new(&first, &second, &third).unwrap();
            let middle = if straight { -triple.shift } else { q[1] };
            let rotation = turn(&first, q[0]) * turn(&second, middle) * turn(&third, q[2]);
            let m = triple.frame.transpose() * rotation * triple.end;
            for a in triple.angles(&m, 0.4) {
                let again = turn(&first, a[0]) * turn(&second, a[1]) * turn(&third, a[2]);
                prop_assert!((again - rotation).norm() < 1e-10);
            }
        }
    }

    #[test]
    fn axes_must_be_perpendicular() {
        assert!(AxisTriple::new(&Vec3::z(), &Vec3::z(), &Vec3::x()).is_none());
    }
}
