//! Single turns that bring something to where it should be (after Paden and Kahan).

use smallvec::SmallVec;

use crate::geometry::Vec3;

/// Zero, one or two angles (rad).
pub(super) type Angles = SmallVec<[f64; 2]>;

/// Below this size an equation says nothing about its angle.
const NOTHING: f64 = 1e-11;
/// How far (relative) a cosine may exceed 1 by rounding.
const ROUNDING: f64 = 1e-11;

/// The angles by which `vector` must turn about `axis` for its component along `direction` to
/// become `component`. Where any will do, `hold`.
pub(super) fn turns_to_component(
    axis: &Vec3,
    vector: &Vec3,
    direction: &Vec3,
    component: f64,
    hold: f64,
) -> Angles {
    let along = direction.dot(axis) * vector.dot(axis);
    let even = direction.dot(vector) - along;
    let odd = direction.dot(&axis.cross(vector));
    let size = even.hypot(odd);
    let wanted = component - along;
    let mut angles = Angles::new();
    if size < NOTHING {
        if wanted.abs() < 1e-9 {
            angles.push(hold);
        }
        return angles;
    }
    let cosine = wanted / size;
    // Also refuses NaN.
    if cosine.abs() <= 1.0 + ROUNDING {
        let half = cosine.clamp(-1.0, 1.0).acos();
        let phase = odd.atan2(even);
        angles.push(phase + half);
        if half > 0.0 && half < std::f64::consts::PI {
            angles.push(phase - half);
        }
    }
    angles
}

/// The angle by which `from` must turn about `axis` to point, seen along the axis, as `to` does;
/// `None` where one of them is along the axis.
pub(super) fn turn_onto(axis: &Vec3, from: &Vec3, to: &Vec3) -> Option<f64> {
    let sine = axis.dot(&from.cross(to));
    let cosine = from.dot(to) - from.dot(axis) * to.dot(axis);
    (sine.hypot(cosine) > NOTHING).then(|| sine.atan2(cosine))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Unit};
    use proptest::prelude::*;

    use super::*;

    fn turned(axis: &Vec3, vector: &Vec3, angle: f64) -> Vec3 {
        Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle) * vector
    }

    proptest! {
        #[test]
        fn turns_do_what_they_say(
            axis in prop::array::uniform3(-1.0..1.0_f64), vector in prop::array::uniform3(-1.0..1.0_f64),
            direction in prop::array::uniform3(-1.0..1.0_f64), angle in -3.1..3.1_f64,
        ) {
            let [axis, vector, direction] = [axis, vector, direction].map(Vec3::from);
            prop_assume!(axis.norm() > 0.1);
            let axis = axis.normalize();
            let goal = turned(&axis, &vector, angle);
            let angles = turns_to_component(&axis, &vector, &direction, goal.dot(&direction), 0.0);
            prop_assert!(!angles.is_empty());
            for found in angles {
                let again = turned(&axis, &vector, found);
                prop_assert!((again.dot(&direction) - goal.dot(&direction)).abs() < 1e-9);
            }
            prop_assume!(axis.cross(&vector).norm() > 1e-3);
            let found = turn_onto(&axis, &vector, &goal).unwrap();
            prop_assert!((turned(&axis, &vector, found) - goal).norm() < 1e-9);
        }
    }

    #[test]
    fn undetermined_and_impossible() {
        let (x, z) = (Vec3::x(), Vec3::z());
        assert_eq!(turns_to_component(&z, &z, &x, 0.0, 0.7).as_slice(), [0.7]);
        assert!(turns_to_component(&z, &z, &x, 0.5, 0.7).is_empty());
        assert!(turns_to_component(&z, &x, &x, 1.5, 0.7).is_empty());
        assert_eq!(turn_onto(&z, &z, &x), None);
    }
}
