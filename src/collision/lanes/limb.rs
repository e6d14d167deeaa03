//! Limbs: capsules that enclose all that hangs on one joint's axis, the coarse form of an arm.
//!
//! A capsule along a joint's axis stands still against the links before and after the joint, so it may
//! hold atoms of both, and the joint itself does not move it.

use crate::geometry::Vec3;

/// A point with a ball of this radius (m) around it.
pub(super) type Ball = (Vec3, f64);

/// A capsule in double precision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Enclosure {
    pub(super) a: Vec3,
    pub(super) b: Vec3,
    pub(super) radius: f64,
}

impl Enclosure {
    /// A capsule around `balls` whose axis goes through `point` along the unit vector `direction`.
    pub(super) fn along(balls: &[Ball], point: &Vec3, direction: &Vec3) -> Self {
        let height = |centre: &Vec3| (centre - point).dot(direction);
        let aside = |centre: &Vec3| (centre - point - direction * height(centre)).norm();
        let radius = balls.iter().map(|(centre, r)| aside(centre) + r).fold(0.0, f64::max);
        // The caps hold what lies within the radius of the axis' ends.
        let (mut start, mut end) = (f64::INFINITY, f64::NEG_INFINITY);
        for (centre, r) in balls {
            let cap = ((radius - r).powi(2) - aside(centre).powi(2)).max(0.0).sqrt();
            start = start.min(height(centre) + cap);
            end = end.max(height(centre) - cap);
        }
        if start > end {
            // Either end alone holds everything on its side; the middle holds both.
            (start, end) = ((start + end) / 2.0, (start + end) / 2.0);
        }
        // Rounding must leave nothing outside.
        Self { a: point + direction * start, b: point + direction * end, radius: radius + 1e-9 }
    }

    /// The least of the capsules around `balls` along one of `directions`, each through the middle
    /// of what it has to hold.
    pub(super) fn least(balls: &[Ball], directions: &[Vec3]) -> Option<Self> {
        let middle = |direction: &Vec3| {
            let ends = balls.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |ends, (centre, r)| {
                let height = centre.dot(direction);
                (ends.0.min(height - r), ends.1.max(height + r))
            });
            (ends.0 + ends.1) / 2.0
        };
        directions
            .iter()
            .map(|direction| {
                let other = direction.cross(&if direction.x.abs() < 0.7 { Vec3::x() } else { Vec3::y() });
                let other = other.normalize();
                let third = direction.cross(&other);
                let point = other * middle(&other) + third * middle(&third);
                Self::along(balls, &point, direction)
            })
            .min_by(|x, y| x.size().total_cmp(&y.size()))
    }

    /// Its volume (m^3) over pi.
    pub(super) fn size(&self) -> f64 {
        self.radius.powi(2) * ((self.b - self.a).norm() + 4.0 / 3.0 * self.radius)
    }

    /// The greatest distance (m) of its points from `point`.
    pub(super) fn reach(&self, point: &Vec3) -> f64 {
        (self.a - point).norm().max((self.b - point).norm()) + self.radius
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;

    #[test]
    fn everything_is_inside() {
        let mut rng = crate::run::Seed(9).stream("limbs");
        for _ in 0..500 {
            let mut r = || rng.random_range(-1.0..1.0_f64);
            let balls: Vec<Ball> =
                (0..6).map(|_| (Vec3::new(r(), r(), 0.3 * r()), 0.1 + 0.05 * r())).collect();
            let axis = Vec3::new(r(), r(), r()).normalize();
            let point = Vec3::new(r(), r(), r());
            let found = [
                Enclosure::along(&balls, &point, &axis),
                Enclosure::least(&balls, &[Vec3::x(), axis]).unwrap(),
            ];
            for capsule in found {
                let along = capsule.b - capsule.a;
                for (centre, radius) in &balls {
                    let t =
                        ((centre - capsule.a).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
                    let apart = (centre - capsule.a - along * t).norm();
                    assert!(apart + radius <= capsule.radius + 1e-8, "{apart} {radius} {capsule:?}");
                }
            }
        }
    }
}
