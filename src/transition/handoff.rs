//! Grounded handoffs: two arms, one object, one pose in the air, found jointly.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{CollisionWorld, Exemption, Held, Scene, StraightMotion};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::workcell::{Arm, ArmId, ObjectId};

use super::line::Line;

/// Pairs of holds that are looked at for one query.
const GREATEST_PAIRS: usize = 400;

/// Which handoff is asked for.
#[derive(Debug, Clone)]
pub struct HandoffQuery<'a> {
    /// Who gives.
    pub giver: ArmId,
    /// Who receives.
    pub receiver: ArmId,
    /// What.
    pub object: ObjectId,
    /// How the giver may hold it: grasp number and the object's frame in the TCP frame.
    pub giver_holds: &'a [(usize, Pose)],
    /// How the receiver may hold it.
    pub receiver_holds: &'a [(usize, Pose)],
    /// Configurations between which the giver will move here and away, to prefer handoffs that
    /// are near.
    pub giver_near: &'a [Config],
    /// The same for the receiver.
    pub receiver_near: &'a [Config],
}

/// A handoff with all that it needs.
#[derive(Debug, Clone)]
pub struct HandoffContact {
    /// The object's frame in the giver's TCP frame.
    pub giver_hold: Pose,
    /// The object's frame in the receiver's TCP frame.
    pub receiver_hold: Pose,
    /// The giver's contact configuration.
    pub giver_q: Config,
    /// The receiver's contact configuration.
    pub receiver_q: Config,
    /// The giver's line after the release, from the contact outwards.
    pub giver_retreat: Line,
    /// The receiver's line before the grasp, from the contact outwards.
    pub receiver_approach: Line,
    /// Sum of least travel times (s) to the configurations named near in the query.
    pub cost: f64,
}

/// Samples handoffs with `tries` random object poses, and returns up to `most` of them, the
/// cheapest first. With several more hits than `most` it stops early.
pub fn sample_handoffs(
    problem: &Problem,
    world: &CollisionWorld,
    query: &HandoffQuery<'_>,
    tries: usize,
    most: usize,
    rng: &mut Rng,
) -> Vec<HandoffContact> {
    let arms = &problem.workcell.arms;
    let sampler = Sampler {
        world,
        query,
        giver: &arms[query.giver.0],
        receiver: &arms[query.receiver.0],
        approach: problem.objects[query.object.0].approach,
        retreat: problem.objects[query.object.0].retreat,
    };
    let pairs = sampler.compatible_holds(rng);
    let (centre, spread) = sampler.meeting_place();
    let mut found: Vec<HandoffContact> = Vec::new();
    let mut hits = 0;
    let mut giver_solutions = Vec::new();
    let mut receiver_solutions = Vec::new();
    for _ in 0..tries {
        if hits >= 4 * most {
            break;
        }
        let Some(&(giver_hold, receiver_hold)) = pairs.choose(rng) else { break };
        let place = Vec3::from_fn(|i, _| centre[i] + spread[i] * rng.random_range(-1.0..1.0));
        let pose = Pose::from_parts(place.into(), random_rotation(rng));
        let mount =
            |arm: &Arm, hold: &Pose| arm.base.inverse() * pose * hold.inverse() * arm.tool.tcp.inverse();
        let target = mount(sampler.giver, &giver_hold);
        sampler.giver.model.inverse(&sampler.giver.limits, &target, 2, rng, &mut giver_solutions);
        if giver_solutions.is_empty() {
            continue;
        }
        let target = mount(sampler.receiver, &receiver_hold);
        sampler.receiver.model.inverse(&sampler.receiver.limits, &target, 2, rng, &mut receiver_solutions);
        let pairs = giver_solutions.iter().flat_map(|g| receiver_solutions.iter().map(move |r| (g, r)));
        for (giver_q, receiver_q) in pairs {
            let cost = sampler.cost(giver_q, receiver_q);
            if found.len() >= most && found.last().is_some_and(|worst| worst.cost <= cost) {
                continue;
            }
            if let Some(contact) = sampler.ground((&giver_hold, giver_q), (&receiver_hold, receiver_q), cost)
            {
                hits += 1;
                let at = found.partition_point(|other| other.cost <= cost);
                found.insert(at, contact);
                found.truncate(most);
                break;
            }
        }
    }
    found
}

struct Sampler<'a> {
    world: &'a CollisionWorld,
    query: &'a HandoffQuery<'a>,
    giver: &'a Arm,
    receiver: &'a Arm,
    approach: f64,
    retreat: f64,
}

impl Sampler<'_> {
    /// Pairs of holds in which the two hands do not touch each other: this depends on nothing
    /// else. Of very many pairs a random selection.
    fn compatible_holds(&self, rng: &mut Rng) -> Vec<(Pose, Pose)> {
        let (giving, taking) = (self.query.giver_holds, self.query.receiver_holds);
        let apart = |giver: &Pose, receiver: &Pose| {
            self.world.hands_apart(self.query.giver, self.query.receiver, &(giver * receiver.inverse()))
        };
        let mut pairs = Vec::new();
        if giving.len() * taking.len() <= GREATEST_PAIRS {
            for (_, giver) in giving {
                pairs.extend(taking.iter().filter(|(_, r)| apart(giver, r)).map(|(_, r)| (*giver, *r)));
            }
        } else {
            for _ in 0..GREATEST_PAIRS {
                if let (Some((_, giver)), Some((_, receiver))) = (giving.choose(rng), taking.choose(rng))
                    && apart(giver, receiver)
                {
                    pairs.push((*giver, *receiver));
                }
            }
        }
        pairs
    }

    fn cost(&self, giver_q: &[f64], receiver_q: &[f64]) -> f64 {
        let sum =
            |arm: &Arm, near: &[Config], q: &[f64]| near.iter().map(|n| travel_time(arm, n, q)).sum::<f64>();
        sum(self.giver, self.query.giver_near, giver_q)
            + sum(self.receiver, self.query.receiver_near, receiver_q)
    }

    /// Completes one candidate with its lines, if it is free of collision.
    fn ground(
        &self,
        (giver_hold, giver_q): (&Pose, &Config),
        (receiver_hold, receiver_q): (&Pose, &Config),
        cost: f64,
    ) -> Option<HandoffContact> {
        let (world, query) = (self.world, self.query);
        let empty = Scene::default();
        let none = Exemption::default();
        let touching = Exemption { hand_with: Some(query.object), held_with: None };
        let giving = Held { object: query.object, object_in_tcp: *giver_hold };
        let taking = Held { object: query.object, object_in_tcp: *receiver_hold };
        let free = world.config_free(query.giver, giver_q, Some(&giving), &empty, none)
            && world.config_free(query.receiver, receiver_q, Some(&taking), &empty, none)
            && world.arms_apart(
                (query.giver, giver_q, Some(&giving), none),
                (query.receiver, receiver_q, None, touching),
            )
            && world.arms_apart(
                (query.giver, giver_q, None, touching),
                (query.receiver, receiver_q, Some(&taking), none),
            );
        if !free {
            return None;
        }
        let backwards = |arm: &Arm, q: &[f64]| -(arm.tcp_pose(q).rotation * Vec3::z());
        let giver_retreat = Line::follow(self.giver, giver_q, &backwards(self.giver, giver_q), self.retreat)?;
        let receiver_approach =
            Line::follow(self.receiver, receiver_q, &backwards(self.receiver, receiver_q), self.approach)?;
        let giver_rests = StraightMotion::rest(giver_q);
        let receiver_rests = StraightMotion::rest(receiver_q);
        let approaches = receiver_approach.waypoints.windows(2).all(|pair| {
            let motion = StraightMotion::new(&pair[0], &pair[1]);
            world.edge_free(query.receiver, &pair[0], &pair[1], None, &empty, none)
                && world.motions_apart(
                    (query.giver, &giver_rests, Some(&giving), none),
                    (query.receiver, &motion, None, touching),
                    (0.0, 1.0),
                )
        });
        let retreats = approaches
            && giver_retreat.waypoints.windows(2).all(|pair| {
                let motion = StraightMotion::new(&pair[0], &pair[1]);
                world.edge_free(query.giver, &pair[0], &pair[1], None, &empty, none)
                    && world.motions_apart(
                        (query.giver, &motion, None, touching),
                        (query.receiver, &receiver_rests, Some(&taking), none),
                        (0.0, 1.0),
                    )
            });
        retreats.then(|| HandoffContact {
            giver_hold: *giver_hold,
            receiver_hold: *receiver_hold,
            giver_q: giver_q.clone(),
            receiver_q: receiver_q.clone(),
            giver_retreat,
            receiver_approach,
            cost,
        })
    }

    /// Centre and half extents (m) of the box from which handover positions are drawn: what both
    /// arms may reach.
    fn meeting_place(&self) -> (Vec3, Vec3) {
        let ball = |arm: &Arm| {
            let (centre, radius) = arm.model.greatest_reach();
            let tool = arm.tool.tcp.translation.vector.norm();
            (arm.base.rotation * centre + arm.base.translation.vector, radius + tool)
        };
        let ((a, ra), (b, rb)) = (ball(self.giver), ball(self.receiver));
        let low = (a - Vec3::repeat(ra)).sup(&(b - Vec3::repeat(rb)));
        let high = (a + Vec3::repeat(ra)).inf(&(b + Vec3::repeat(rb)));
        // The outer parts of the box are at full stretch or out of reach.
        ((low + high) / 2.0, ((high - low) * 0.4).map(|x| x.max(0.0)))
    }
}

/// Least time (s) from `from` to `to` at the joints' greatest speeds.
pub fn travel_time(arm: &Arm, from: &[f64], to: &[f64]) -> f64 {
    from.iter()
        .zip(to)
        .zip(&arm.limits)
        .map(|((a, b), limit)| (a - b).abs() / limit.velocity)
        .fold(0.0, f64::max)
}

/// A uniformly distributed rotation (Shoemake 1992).
fn random_rotation(rng: &mut Rng) -> nalgebra::UnitQuaternion<f64> {
    use std::f64::consts::TAU;
    let (u, v, w): (f64, f64, f64) = (rng.random(), rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
        b * w.cos(),
        a * v.sin(),
        a * v.cos(),
        b * w.sin(),
    ))
}
