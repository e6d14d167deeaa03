//! Where two arms may come together in the air.

use nalgebra::{Quaternion, UnitQuaternion};
use rand::Rng as _;

use crate::geometry::{Pose, Vec3};
use crate::kinematics::Reach;
use crate::run::Rng;
use crate::workcell::Arm;

/// Share of the arms' reach within which meetings are looked for: beyond it they would be at full stretch. Of arms that
/// hardly reach each other half of what is left.
const STRETCH: f64 = 0.9;

/// Greatest reach (m) that counts, be it of an arm on an endless track.
const GREATEST_RADIUS: f64 = 50.0;

/// Places that are looked at for one that both arms may reach.
const MOST_PLACES: usize = 64;

/// A ball in an arm's base frame that its TCP never leaves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    /// Its centre (m).
    centre: Vec3,
    /// Its radius (m).
    radius: f64,
}

impl Ball {
    pub(super) fn of(arm: &Arm) -> Self {
        let Reach { centre, radius } = arm.model.reach_within(&arm.limits);
        let tool = arm.tool.tcp.translation.vector.norm();
        Self { centre, radius: (radius + tool).min(GREATEST_RADIUS) }
    }
}

/// Where two arms' TCPs may come together, in the giver's base frame: in both of two balls.
pub(super) struct MeetingPlace {
    balls: [Ball; 2],
    /// Its z axis points from the giver's centre to the receiver's.
    along: UnitQuaternion<f64>,
    /// Range of z from the giver's centre (m), and the greatest distance (m) from the axis.
    range: (f64, f64),
    aside: f64,
}

impl MeetingPlace {
    /// Of a giver and a receiver, each in its base frame, of which the receiver's is at `bases` in the giver's.
    pub(super) fn new(giver: Ball, receiver: Ball, bases: &Pose) -> Self {
        let centre = (bases * nalgebra::Point3::from(receiver.centre)).coords;
        let between = centre - giver.centre;
        let apart = between.norm();
        let stretched = apart / (giver.radius + receiver.radius);
        let stretch = STRETCH.max((1.0 + stretched) / 2.0).min(1.0);
        let a = Ball { radius: stretch * giver.radius, ..giver };
        let b = Ball { centre, radius: stretch * receiver.radius };
        let along = UnitQuaternion::rotation_between(&Vec3::z(), &between)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vec3::x_axis(), std::f64::consts::PI));
        let range = ((-a.radius).max(apart - b.radius), a.radius.min(apart + b.radius));
        // Where the spheres cross, if it is between the centres.
        let square = a.radius * a.radius;
        let crossing = (apart * apart + square - b.radius * b.radius) / (2.0 * apart);
        let is_between = (0.0..=apart).contains(&crossing);
        let aside = match is_between {
            true => (square - crossing * crossing).max(0.0).sqrt(),
            false => a.radius.min(b.radius),
        };
        Self { balls: [a, b], along, range, aside }
    }

    /// A random frame of the giver's TCP, place (rejection sampling from a box about it) and turn uniformly distributed;
    /// `None` where there is none.
    pub(super) fn draw(&self, rng: &mut Rng) -> Option<Pose> {
        let place = self.place(rng)?;
        Some(Pose::from_parts(place.into(), random_rotation(rng)))
    }

    /// How much the hands point away from where their arms come from, when the giver's TCP is at `tcp` and the receiver's at
    /// `hands` in it: the sum of two cosines. Where it is great, wrists and elbows need not bend far.
    pub(super) fn ease(&self, tcp: &Pose, hands: &Pose) -> f64 {
        let outwards = |(ball, tcp): (&Ball, Pose)| {
            let from = tcp.translation.vector - ball.centre;
            (tcp.rotation * Vec3::z()).dot(&from) / from.norm().max(f64::EPSILON)
        };
        self.balls.iter().zip([*tcp, tcp * hands]).map(outwards).sum()
    }

    fn place(&self, rng: &mut Rng) -> Option<Vec3> {
        let (low, high) = self.range;
        if low >= high || self.aside <= 0.0 {
            return None;
        }
        for _ in 0..MOST_PLACES {
            let mut within = |half: f64| half * rng.random_range(-1.0..1.0);
            let (x, y) = (within(self.aside), within(self.aside));
            let offset = Vec3::new(x, y, rng.random_range(low..high));
            let place = self.balls[0].centre + self.along * offset;
            let is_in = |ball: &Ball| (place - ball.centre).norm_squared() <= ball.radius * ball.radius;
            if self.balls.iter().all(is_in) {
                return Some(place);
            }
        }
        None
    }
}

/// A uniformly distributed rotation (Shoemake 1992).
fn random_rotation(rng: &mut Rng) -> UnitQuaternion<f64> {
    use std::f64::consts::TAU;
    let (u, v, w): (f64, f64, f64) = (rng.random(), rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    UnitQuaternion::from_quaternion(Quaternion::new(b * w.cos(), a * v.sin(), a * v.cos(), b * w.sin()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(z: f64, radius: f64) -> Ball {
        Ball { centre: Vec3::new(0.1, 0.2, z), radius }
    }

    #[test]
    fn places_are_within_reach_of_both() {
        let mut rng = crate::run::Seed(4).stream("places");
        for (apart, sizes) in
            [(1.1, [1.0, 1.0]), (1.9, [1.0, 1.0]), (0.0, [1.0, 0.8]), (0.3, [1.0, 0.5]), (2.3, [1.6, 0.9])]
        {
            for turn in [0.0, 0.7, std::f64::consts::PI] {
                let turn = UnitQuaternion::from_axis_angle(&Vec3::x_axis(), turn);
                let bases = Pose::from_parts((turn * Vec3::new(0.0, 0.0, apart)).into(), turn);
                let (giver, receiver) = (ball(0.3, sizes[0]), ball(0.3, sizes[1]));
                let place = MeetingPlace::new(giver, receiver, &bases);
                let other = (bases * nalgebra::Point3::from(receiver.centre)).coords;
                let mut found = 0;
                for _ in 0..200 {
                    let Some(tcp) = place.draw(&mut rng) else { continue };
                    let at = tcp.translation.vector;
                    assert!(
                        (at - giver.centre).norm() <= giver.radius && (at - other).norm() <= receiver.radius
                    );
                    found += 1;
                }
                let meets = (other - giver.centre).norm() < giver.radius + receiver.radius;
                assert!(if meets { found > 190 } else { found == 0 }, "{apart} {sizes:?}: {found}");
            }
        }
    }

    #[test]
    fn it_is_easy_where_both_hands_point_away_from_their_arms() {
        let bases = Pose::translation(1.0, 0.0, 0.0);
        let place = MeetingPlace::new(
            Ball { centre: Vec3::zeros(), radius: 1.0 },
            Ball { centre: Vec3::zeros(), radius: 1.0 },
            &bases,
        );
        // The giver's hand points along +x, and the receiver's faces it.
        let towards = UnitQuaternion::from_axis_angle(&Vec3::y_axis(), std::f64::consts::FRAC_PI_2);
        let facing = UnitQuaternion::from_axis_angle(&Vec3::y_axis(), std::f64::consts::PI);
        let tcp = Pose::from_parts(Vec3::new(0.5, 0.0, 0.0).into(), towards);
        let hands = Pose::from_parts(Vec3::zeros().into(), facing);
        assert!((place.ease(&tcp, &hands) - 2.0).abs() < 1e-12);
        let back = Pose::from_parts(tcp.translation, towards * facing);
        assert!((place.ease(&back, &hands) + 2.0).abs() < 1e-12);
        // Both pointing the same way: one easy, one hard.
        assert!(place.ease(&tcp, &Pose::identity()).abs() < 1e-12);
    }
}
