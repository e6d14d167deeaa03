//! Single turns that bring something to where it should be (after Paden and Kahan).

use nalgebra::Matrix3;
use smallvec::SmallVec;

use super::arctangent::{atan2, atan2_each};
use crate::geometry::Vec3;

/// A turn by its cosine and sine, which most uses ask for rather than the angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turn {
    cosine: f64,
    sine: f64,
}

/// Zero, one or two turns.
pub(super) type Turns = SmallVec<[Turn; 2]>;

/// Below this size an equation says nothing about its angle.
const NOTHING: f64 = 1e-11;
/// How far (relative) a cosine may exceed 1 by rounding.
const ROUNDING: f64 = 1e-11;

impl Turn {
    /// By `angle` (rad).
    pub fn by(angle: f64) -> Self {
        let (sine, cosine) = angle.sin_cos();
        Self { cosine, sine }
    }

    /// Its angle (rad) in [-pi, pi].
    pub fn angle(self) -> f64 {
        atan2(self.sine, self.cosine)
    }

    /// The angles (rad) of several turns.
    pub fn angles<const N: usize>(turns: [Self; N]) -> [f64; N] {
        atan2_each(turns.map(|turn| turn.sine), turns.map(|turn| turn.cosine))
    }

    /// The same the other way round.
    pub fn back(self) -> Self {
        Self { sine: -self.sine, ..self }
    }

    /// Its matrix about the unit vector `axis`.
    pub fn about(self, axis: &Vec3) -> Matrix3<f64> {
        let (c, d) = (self.cosine, 1.0 - self.cosine);
        let s = axis * self.sine;
        let [x, y, z] = [axis.x, axis.y, axis.z];
        Matrix3::new(
            c + d * x * x,
            d * x * y - s.z,
            d * x * z + s.y,
            d * x * y + s.z,
            c + d * y * y,
            d * y * z - s.x,
            d * x * z - s.y,
            d * y * z + s.x,
            c + d * z * z,
        )
    }

    /// `vector` turned about the unit vector `axis`.
    pub fn apply(self, axis: &Vec3, vector: &Vec3) -> Vec3 {
        let along = axis.dot(vector) * (1.0 - self.cosine);
        vector * self.cosine + axis.cross(vector) * self.sine + axis * along
    }
}

/// The component along a direction that a vector has when it is turned about an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Component {
    /// What it has whatever the turn.
    along: f64,
    /// What the turn adds to that at most, and one over it; both 0 where turns change nothing.
    size: f64,
    per_size: f64,
    /// Cosine and sine of the turn that adds most.
    x: f64,
    y: f64,
}

impl Component {
    /// Of `vector` turned about the unit vector `axis`, along `direction`.
    pub fn new(axis: &Vec3, vector: &Vec3, direction: &Vec3) -> Self {
        let along = direction.dot(axis) * vector.dot(axis);
        let even = direction.dot(vector) - along;
        let odd = direction.dot(&axis.cross(vector));
        let size = (even * even + odd * odd).sqrt();
        if size < NOTHING {
            return Self { along, size: 0.0, per_size: 0.0, x: 0.0, y: 0.0 };
        }
        let per_size = 1.0 / size;
        Self { along, size, per_size, x: even * per_size, y: odd * per_size }
    }

    /// The turns after which it is `component`. Where any will do, the one by `hold` (rad).
    pub fn turns(&self, component: f64, hold: f64) -> Turns {
        let wanted = component - self.along;
        let mut turns = Turns::new();
        if self.size == 0.0 {
            if wanted.abs() < 1e-9 {
                turns.push(Turn::by(hold));
            }
            return turns;
        }
        let cosine = wanted * self.per_size;
        // Also refuses NaN.
        if cosine.abs() <= 1.0 + ROUNDING {
            // Either way from where the component is greatest.
            let (x, y) = (self.x, self.y);
            let c = cosine.clamp(-1.0, 1.0);
            let s = (1.0 - c * c).sqrt();
            turns.push(Turn { cosine: x * c - y * s, sine: y * c + x * s });
            if s > 0.0 {
                turns.push(Turn { cosine: x * c + y * s, sine: y * c - x * s });
            }
        }
        turns
    }
}

/// The turns of `vector` about `axis` after which its component along `direction` is `component`.
/// Where any will do, the one by `hold` (rad).
pub(super) fn turns_to_component(
    axis: &Vec3,
    vector: &Vec3,
    direction: &Vec3,
    component: f64,
    hold: f64,
) -> Turns {
    Component::new(axis, vector, direction).turns(component, hold)
}

/// The turn of `from` about `axis` to point, seen along the axis, as `to` does; `None` where one of
/// them is along the axis.
pub(super) fn turn_onto(axis: &Vec3, from: &Vec3, to: &Vec3) -> Option<Turn> {
    let sine = axis.dot(&from.cross(to));
    let cosine = from.dot(to) - from.dot(axis) * to.dot(axis);
    let size = (sine * sine + cosine * cosine).sqrt();
    (size > NOTHING).then(|| Turn { cosine: cosine / size, sine: sine / size })
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
                let again = turned(&axis, &vector, found.angle());
                prop_assert!((found.apply(&axis, &vector) - again).norm() < 1e-12);
                prop_assert!((found.about(&axis) * vector - again).norm() < 1e-12);
                prop_assert!((found.back().apply(&axis, &again) - vector).norm() < 1e-12);
                prop_assert!((again.dot(&direction) - goal.dot(&direction)).abs() < 1e-9);
            }
            prop_assume!(axis.cross(&vector).norm() > 1e-3);
            let found = turn_onto(&axis, &vector, &goal).unwrap();
            prop_assert!((found.apply(&axis, &vector) - goal).norm() < 1e-9);
        }
    }

    #[test]
    fn undetermined_and_impossible() {
        let (x, z) = (Vec3::x(), Vec3::z());
        assert_eq!(turns_to_component(&z, &z, &x, 0.0, 0.7).as_slice(), [Turn::by(0.7)]);
        assert!(turns_to_component(&z, &z, &x, 0.5, 0.7).is_empty());
        assert!(turns_to_component(&z, &x, &x, 1.5, 0.7).is_empty());
        assert_eq!(turn_onto(&z, &z, &x), None);
    }
}
