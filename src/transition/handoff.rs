//! Grounded handoffs: two arms, one object, one pose in the air, found jointly.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{
    CollisionWorld, Exemption, Held, JointMotion as _, PathMotion, Scene, StraightMotion,
};
use crate::geometry::{Pose, Vec3};
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::workcell::{Arm, ArmId, ObjectId};

use super::hands::Hands;
use super::line::Line;

/// Random pairs of holds that are looked at before all pairs are.
const DRAWS_OF_HOLDS: usize = 40;

/// Candidates to choose from for each handoff that is wanted, where one may be nearer than another.
const HANDFUL: usize = 6;

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

/// Samples handoffs with up to `tries` random object poses, and returns up to `most` of them, the
/// cheapest first. Of each handful that inverse kinematics allows the cheapest are grounded first,
/// until there are `most`; where nothing is said of nearness, each as it comes.
pub(super) fn sample_handoffs(
    problem: &Problem,
    world: &CollisionWorld,
    hands: &mut Hands<'_>,
    query: &HandoffQuery<'_>,
    tries: usize,
    most: usize,
    rng: &mut Rng,
) -> Vec<HandoffContact> {
    let arms = &problem.workcell.arms;
    let mut sampler = Sampler {
        world,
        query,
        fits: vec![None; query.giver_holds.len() * query.receiver_holds.len()],
        giving: (0..query.giver_holds.len()).collect(),
        taking: (0..query.receiver_holds.len()).collect(),
        giver: &arms[query.giver.0],
        receiver: &arms[query.receiver.0],
        approach: problem.objects[query.object.0].approach,
        retreat: problem.objects[query.object.0].retreat,
        meeting_place: meeting_place(&arms[query.giver.0], &arms[query.receiver.0]),
    };
    let all_are_equal = query.giver_near.is_empty() && query.receiver_near.is_empty();
    let handful_size = if all_are_equal { 1 } else { HANDFUL * most };
    let mut found: Vec<HandoffContact> = Vec::new();
    let mut left = tries;
    while left > 0 && found.len() < most {
        let mut handful = Vec::new();
        while left > 0 && handful.len() < handful_size {
            left -= 1;
            match sampler.draw(hands, rng) {
                Draw::Hit(candidate) => handful.push(*candidate),
                Draw::Miss => {}
                Draw::NoHolds => left = 0,
            }
        }
        handful.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        for candidate in handful {
            if found.len() >= most {
                break;
            }
            found.extend(sampler.ground(&candidate));
        }
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    found
}

/// Two arms at a handoff that inverse kinematics allows, not checked for anything else.
struct Candidate {
    giver_hold: Pose,
    receiver_hold: Pose,
    giver_q: Config,
    receiver_q: Config,
    cost: f64,
}

/// One draw of holds and a place.
enum Draw {
    Hit(Box<Candidate>),
    Miss,
    /// There is no pair of holds in which the hands fit.
    NoHolds,
}

struct Sampler<'a> {
    world: &'a CollisionWorld,
    query: &'a HandoffQuery<'a>,
    /// By pair of holds, the receiver's counted within the giver's: whether both hands fit, where that
    /// was asked.
    fits: Vec<Option<bool>>,
    /// The numbers of the giver's holds, and of the receiver's.
    giving: Vec<usize>,
    taking: Vec<usize>,
    giver: &'a Arm,
    receiver: &'a Arm,
    approach: f64,
    retreat: f64,
    /// Centre and half extents (m) of the box from which handover positions are drawn.
    meeting_place: (Vec3, Vec3),
}

impl Sampler<'_> {
    /// Two holds in which the hands do not touch each other; `None` when there are none.
    fn draw_holds(&mut self, hands: &mut Hands<'_>, rng: &mut Rng) -> Option<(Pose, Pose)> {
        let holds = |(g, r): (usize, usize)| (self.query.giver_holds[g].1, self.query.receiver_holds[r].1);
        let fits = &mut self.fits;
        let mut fit = |g: usize, r: usize| {
            *fits[g * self.taking.len() + r].get_or_insert_with(|| {
                let (giving, taking) = holds((g, r));
                hands.fit((self.query.giver, &giving), (self.query.receiver, &taking))
            })
        };
        for _ in 0..DRAWS_OF_HOLDS {
            let (&g, &r) = (self.giving.choose(rng)?, self.taking.choose(rng)?);
            if fit(g, r) {
                return Some(holds((g, r)));
            }
        }
        let all = self.giving.iter().flat_map(|&g| self.taking.iter().map(move |&r| (g, r)));
        let fitting: Vec<(usize, usize)> = all.filter(|&(g, r)| fit(g, r)).collect();
        fitting.choose(rng).map(|&pair| holds(pair))
    }

    fn draw(&mut self, hands: &mut Hands<'_>, rng: &mut Rng) -> Draw {
        let Some((giver_hold, receiver_hold)) = self.draw_holds(hands, rng) else { return Draw::NoHolds };
        let (centre, spread) = self.meeting_place;
        let place = Vec3::from_fn(|i, _| centre[i] + spread[i] * rng.random_range(-1.0..1.0));
        let pose = Pose::from_parts(place.into(), random_rotation(rng));
        let mut solve = |arm: &Arm, hold: &Pose| {
            let target = arm.base.inverse() * pose * hold.inverse() * arm.tool.tcp.inverse();
            let mut solutions = Vec::new();
            arm.inverse(&target, 2, rng, &mut solutions);
            solutions
        };
        let giving = solve(self.giver, &giver_hold);
        if giving.is_empty() {
            return Draw::Miss;
        }
        let taking = solve(self.receiver, &receiver_hold);
        let this = &*self;
        let pairs = giving.iter().flat_map(|g| taking.iter().map(move |r| (this.cost(g, r), g, r)));
        match pairs.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((cost, g, r)) => Draw::Hit(Box::new(Candidate {
                giver_hold,
                receiver_hold,
                giver_q: g.clone(),
                receiver_q: r.clone(),
                cost,
            })),
            None => Draw::Miss,
        }
    }

    fn cost(&self, giver_q: &[f64], receiver_q: &[f64]) -> f64 {
        let sum =
            |arm: &Arm, near: &[Config], q: &[f64]| near.iter().map(|n| travel_time(arm, n, q)).sum::<f64>();
        sum(self.giver, self.query.giver_near, giver_q)
            + sum(self.receiver, self.query.receiver_near, receiver_q)
    }

    /// Completes one candidate with its lines, if it is free of collision.
    fn ground(&self, candidate: &Candidate) -> Option<HandoffContact> {
        let Candidate { giver_hold, receiver_hold, giver_q, receiver_q, cost } = candidate;
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
        let (approach, retreat) =
            (PathMotion::new(&receiver_approach.waypoints), PathMotion::new(&giver_retreat.waypoints));
        // One arm alone is looked at before two.
        let free = world.motion_free(query.receiver, &approach, None, &empty, none)
            && world.motion_free(query.giver, &retreat, None, &empty, none)
            && world.motions_apart(
                (query.giver, &giver_rests, Some(&giving), none),
                (query.receiver, &approach, None, touching),
                approach.span(),
            )
            && world.motions_apart(
                (query.giver, &retreat, None, touching),
                (query.receiver, &receiver_rests, Some(&taking), none),
                retreat.span(),
            );
        free.then(|| HandoffContact {
            giver_hold: *giver_hold,
            receiver_hold: *receiver_hold,
            giver_q: giver_q.clone(),
            receiver_q: receiver_q.clone(),
            giver_retreat,
            receiver_approach,
            cost: *cost,
        })
    }
}

/// Centre and half extents (m) of the box that holds what both arms may reach, less its outer
/// parts, where they would be at full stretch.
fn meeting_place(giver: &Arm, receiver: &Arm) -> (Vec3, Vec3) {
    let ball = |arm: &Arm| {
        let (centre, radius) = arm.model.greatest_reach();
        let tool = arm.tool.tcp.translation.vector.norm();
        (arm.base.rotation * centre + arm.base.translation.vector, radius + tool)
    };
    let ((a, ra), (b, rb)) = (ball(giver), ball(receiver));
    let low = (a - Vec3::repeat(ra)).sup(&(b - Vec3::repeat(rb)));
    let high = (a + Vec3::repeat(ra)).inf(&(b + Vec3::repeat(rb)));
    ((low + high) / 2.0, ((high - low) * 0.4).map(|x| x.max(0.0)))
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
