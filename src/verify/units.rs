//! Boxes around all that an arm sweeps, and around what stands still: pairs of bodies whose boxes are
//! far enough apart need no look of their own.

use super::gap::Frame;
use super::scene::{Owner, Pair, Scene};
use crate::geometry::Vec3;

/// A box along the world's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bounds {
    low: Vec3,
    high: Vec3,
}

impl Bounds {
    /// A box that holds nothing.
    pub(super) fn empty() -> Self {
        Self { low: Vec3::repeat(f64::INFINITY), high: Vec3::repeat(f64::NEG_INFINITY) }
    }

    /// Grows to hold a ball.
    pub(super) fn add_ball(&mut self, centre: &Vec3, radius: f64) {
        self.low = self.low.inf(&centre.add_scalar(-radius));
        self.high = self.high.sup(&centre.add_scalar(radius));
    }

    /// The distance (m) of `point` from the box; negative infinity where it is not outside, so that
    /// nothing is ever claimed of what may overlap.
    pub(super) fn distance_to(&self, point: &Vec3) -> f64 {
        outside((self.low - point).sup(&(point - self.high)))
    }

    /// The distance (m) of two boxes; negative infinity where they meet.
    pub(super) fn distance(&self, other: &Self) -> f64 {
        outside((self.low - other.high).sup(&(other.low - self.high)))
    }
}

/// The length of what is positive of `gaps`, if anything is.
fn outside(gaps: Vec3) -> f64 {
    if gaps.max() > 0.0 { gaps.sup(&Vec3::zeros()).norm() } else { f64::NEG_INFINITY }
}

/// Which bodies belong together: those of one arm; an obstacle or an object is a unit of its own.
#[derive(Debug)]
pub(super) struct Units {
    /// By body.
    unit: Vec<usize>,
    /// By unit, the bodies.
    members: Vec<Vec<usize>>,
    /// By body, the box around an obstacle.
    still: Vec<Option<Bounds>>,
}

impl Units {
    /// The units of the bodies of `scene`.
    pub(super) fn new(scene: &Scene<'_>) -> Self {
        let arms = scene.bodies.iter().filter_map(|body| match body.owner {
            Owner::Arm { arm, .. } => Some(arm + 1),
            _ => None,
        });
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); arms.max().unwrap_or(0)];
        let mut unit = Vec::with_capacity(scene.bodies.len());
        let mut still = Vec::with_capacity(scene.bodies.len());
        for (index, body) in scene.bodies.iter().enumerate() {
            let own = match body.owner {
                Owner::Arm { arm, .. } => arm,
                _ => {
                    members.push(Vec::new());
                    members.len() - 1
                }
            };
            members[own].push(index);
            unit.push(own);
            still.push(match body.owner {
                Owner::Obstacle(obstacle) => {
                    let frame = Frame::of(scene.obstacle_pose(obstacle));
                    let mut bounds = Bounds::empty();
                    for part in &body.parts {
                        let reach = |axis: Vec3| part.reach(&frame, &axis);
                        let (x, y, z) = (Vec3::x(), Vec3::y(), Vec3::z());
                        bounds.high = bounds.high.sup(&Vec3::new(reach(x), reach(y), reach(z)));
                        bounds.low = bounds.low.inf(&-Vec3::new(reach(-x), reach(-y), reach(-z)));
                    }
                    Some(bounds)
                }
                _ => None,
            });
        }
        Self { unit, members, still }
    }

    /// Number of units.
    pub(super) fn len(&self) -> usize {
        self.members.len()
    }

    /// The units of a pair's bodies.
    pub(super) fn of(&self, pair: &Pair) -> (usize, usize) {
        (self.unit[pair.a], self.unit[pair.b])
    }

    /// The bodies of a unit.
    pub(super) fn members(&self, unit: usize) -> &[usize] {
        &self.members[unit]
    }

    /// The box around a body that is an obstacle.
    pub(super) fn still(&self, body: usize) -> Option<&Bounds> {
        self.still[body].as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Seed;
    use rand::Rng as _;

    #[test]
    fn boxes_are_never_farther_apart_than_what_they_hold() {
        let mut rng = Seed(3).stream("bounds");
        for _ in 0..2000 {
            let mut ball = || {
                let mut x = || rng.random_range(-1.0..1.0_f64);
                (Vec3::new(x(), x(), x()), 0.3 * x().abs())
            };
            let (first, second) = ([ball(), ball()], [ball(), ball()]);
            let around = |balls: &[(Vec3, f64)]| {
                let mut bounds = Bounds::empty();
                balls.iter().for_each(|(centre, radius)| bounds.add_ball(centre, *radius));
                bounds
            };
            let (one, two) = (around(&first), around(&second));
            for (c, r) in first {
                for (d, s) in second {
                    let apart = (c - d).norm() - r - s;
                    assert!(one.distance(&two) <= apart.max(0.0) + 1e-12);
                    assert!(two.distance_to(&c) - r <= apart + 1e-12);
                }
            }
        }
        let mut unit = Bounds::empty();
        unit.add_ball(&Vec3::zeros(), 1.0);
        assert_eq!(unit.distance_to(&Vec3::new(3.0, 0.5, 1.0)), 2.0);
        assert_eq!(unit.distance_to(&Vec3::new(0.5, 0.5, 1.0)), f64::NEG_INFINITY);
        let mut far = Bounds::empty();
        far.add_ball(&Vec3::new(5.0, 6.0, 0.0), 1.0);
        assert_eq!(unit.distance(&far), 5.0);
        assert_eq!(unit.distance(&unit), f64::NEG_INFINITY);
    }
}
