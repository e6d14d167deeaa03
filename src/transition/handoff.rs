//! Grounded handoffs: two arms, one object, one pose in the air, found jointly.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::UnitQuaternion;
use rand::Rng as _;
use rand::seq::IndexedRandom;
use smallvec::SmallVec;

use crate::collision::{
    CollisionWorld, Exemption, Held, JointMotion as _, PathMotion, Scene, StraightMotion,
};
use crate::geometry::{PlacedShape, Pose, Vec3};
use crate::kinematics::Config;
use crate::mode_graph::HandoffWitness;
use crate::problem::Problem;
use crate::run::{Control, Rng};
use crate::workcell::{Arm, ArmId, ObjectId, ObjectModel, shape_rotations};

use super::contacts::same_hand;
use super::draws::{Draws, Grounded, MOST_DRAWN, Meeting, Sequence, Stance};
use super::grains::Grains;
use super::line::Line;
use super::meeting_place::{Ball, MeetingPlace};
use super::memory::{Class, ReachMemory};

/// Random pairs of holds that are looked at before all pairs are.
const DRAWS_OF_HOLDS: usize = 40;

/// Pairs of holds of which a draw takes that in which hands fit and face each other most, where they are to.
const PAIRS_COMPARED: usize = 10;

/// Random places for one draw of which some are kept that neither arm is plainly too far from, and how many.
const MOST_PROPOSALS: usize = 16;
const PROPOSALS_COMPARED: usize = 3;

/// Chance that a draw is at the one of these that is easiest for both arms, or else at the next: not always, since objects
/// at rest or other arms may leave room only where it is not easy. Below 1.
const EASE: f64 = 0.8;

/// Candidates to choose from for each handoff that is wanted, where one may be nearer than another; and where hands are to
/// face each other, which is where time is short.
const HANDFUL: usize = 6;
const SMALL_HANDFUL: usize = 4;

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

/// Chance that a draw in holds in which none hit so far is made at all, once the remembered ones are used up. Above 0:
/// rare handoffs are found at last.
const HOPE: f64 = 0.12;

/// Draws between two looks at whether to stop.
const STOP_PERIOD: usize = 4;

/// What was looked at of the sequence of a pair of holds.
#[derive(Debug, Clone, Copy, Default)]
struct Looked {
    /// How many draws.
    draws: usize,
    /// Whether one of them hit.
    hit: bool,
}

impl Looked {
    fn and(self, other: Self) -> Self {
        Self { draws: self.draws.max(other.draws), hit: self.hit || other.hit }
    }
}

/// What was looked at, by the giver's hold and the receiver's, giver and receiver.
type Seen = BTreeMap<(Grains, Grains, usize, usize), Looked>;

/// Samples handoffs, and goes through the sequence of draws of every pair of holds from its beginning on.
#[derive(Debug, Clone)]
pub(super) struct Handoffs<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    memory: Arc<ReachMemory>,
    /// By arm, the first arm that equals it but for its place, and the ball that its TCP never leaves.
    kinds: Vec<(usize, Ball)>,
    /// By object, its class in the memory, and the rotations that map its shape onto itself.
    classes: Arc<[(Class, Vec<UnitQuaternion<f64>>)]>,
    seen: Seen,
    /// What the mode graph was told: by giver, receiver and class.
    witnessed: BTreeMap<(ArmId, ArmId, Class), Vec<HandoffWitness>>,
    /// Whether each draw compares some pairs of holds, and takes the one in which the hands face each other most.
    faces: bool,
    /// Who may end a search.
    control: Control,
}

impl<'a> Handoffs<'a> {
    pub(super) fn new(problem: &'a Problem, world: &'a CollisionWorld, memory: Arc<ReachMemory>) -> Self {
        let count = problem.workcell.arms.len();
        let first =
            |arm: usize| (0..arm).find(|&other| same_arm(problem, ArmId(other), ArmId(arm))).unwrap_or(arm);
        // Objects of one class are alike, and digests are not free.
        let mut numbers: BTreeMap<usize, (Class, Vec<UnitQuaternion<f64>>)> = BTreeMap::new();
        let class = |object: &ObjectModel| {
            let find = || (memory.class(object), rotations_of(&object.shapes));
            numbers.entry(object.class).or_insert_with(find).clone()
        };
        let classes = problem.objects.iter().map(class).collect();
        let kinds = (0..count).map(|arm| (first(arm), Ball::of(&problem.workcell.arms[arm]))).collect();
        let (seen, witnessed) = (BTreeMap::new(), BTreeMap::new());
        let control = Control::unbounded();
        Self { problem, world, memory, kinds, classes, seen, witnessed, faces: false, control }
    }

    /// Has no search go on when `control` says stop.
    pub(super) fn heed(&mut self, control: &Control) {
        self.control = control.clone();
    }

    /// Prefers holds in which the hands face each other, or all alike: where they face each other the arms are less in
    /// each other's way, but other holds come up rarely.
    pub(super) fn prefer_facing(&mut self, faces: bool) -> bool {
        std::mem::replace(&mut self.faces, faces)
    }

    pub(super) fn memory(&self) -> &Arc<ReachMemory> {
        &self.memory
    }

    /// The class of an object in the memory.
    pub(super) fn class(&self, object: ObjectId) -> Class {
        self.classes[object.0].0
    }

    /// Up to `most` handoffs from up to `tries` draws, the cheapest first. Of each handful that inverse kinematics
    /// allows the cheapest are grounded first, until there are `most`; where nothing is said of nearness, each as it
    /// comes. Each pair of holds goes on with the draws that were not looked at yet.
    pub(super) fn sample(
        &mut self,
        query: &HandoffQuery<'_>,
        tries: usize,
        most: usize,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        let seen = std::mem::take(&mut self.seen);
        let mut sampler = Sampler::new(self, query, seen);
        if self.faces {
            sampler = sampler.facing();
        }
        let found = sampler.sample(tries, most, rng);
        let seen = sampler.into_seen();
        self.seen = seen;
        found
    }

    /// Takes down a handoff of `object`, and that backwards in time where it is one.
    pub(super) fn witness(
        &mut self,
        (giver, receiver): (ArmId, ArmId),
        object: ObjectId,
        witness: &HandoffWitness,
    ) {
        let (class, model) = (self.class(object), &self.problem.objects[object.0]);
        self.witnessed.entry((giver, receiver, class)).or_default().push(witness.clone());
        if model.approach == model.retreat {
            self.witnessed.entry((receiver, giver, class)).or_default().push(witness.reversed());
        }
    }

    /// Those of the handoffs taken down that fit `query`, with their lines.
    pub(super) fn witnessed(&self, query: &HandoffQuery<'_>) -> Vec<HandoffContact> {
        let key = (query.giver, query.receiver, self.class(query.object));
        let has = |holds: &[(usize, Pose)], pose: &Pose| holds.iter().any(|(_, hold)| hold == pose);
        let sampler = Sampler::new(self, query, BTreeMap::new());
        let contact = |witness: &HandoffWitness| {
            let HandoffWitness { giver_q, receiver_q, giver_hold, receiver_hold } = witness;
            let (giver_hold, receiver_hold) = (giver_hold.object_in_tcp, receiver_hold.object_in_tcp);
            if !has(query.giver_holds, &giver_hold) || !has(query.receiver_holds, &receiver_hold) {
                return None;
            }
            let (giver_retreat, receiver_approach) =
                sampler.lines((giver_q, &giver_hold), (receiver_q, &receiver_hold))?;
            let cost = sampler.cost(giver_q, receiver_q);
            let (giver_q, receiver_q) = (giver_q.clone(), receiver_q.clone());
            Some(HandoffContact {
                giver_hold,
                receiver_hold,
                giver_q,
                receiver_q,
                giver_retreat,
                receiver_approach,
                cost,
            })
        };
        self.witnessed.get(&key).into_iter().flatten().filter_map(contact).collect()
    }

    /// [`Self::sample`] as if nothing had been looked at: what comes depends on the question and `rng` alone.
    pub(super) fn first(
        &self,
        query: &HandoffQuery<'_>,
        tries: usize,
        most: usize,
        rng: &mut Rng,
    ) -> Vec<HandoffContact> {
        Sampler::new(self, query, BTreeMap::new()).sample(tries, most, rng)
    }
}

/// Two arms at a handoff that inverse kinematics allows, not checked for anything else.
struct Candidate {
    pair: usize,
    meeting: Arc<Meeting>,
    /// Which of the giver's and the receiver's configurations.
    configurations: (usize, usize),
    cost: f64,
}

/// One draw of holds and a place.
enum Draw {
    Hit(Candidate),
    Miss,
    /// There is no pair of holds in which the hands fit.
    NoHolds,
}

/// A pair of holds.
struct Pair {
    giver_hold: Pose,
    receiver_hold: Pose,
    stance: Stance,
    sequence: Arc<Sequence>,
    /// What was looked at of the sequence, where somebody asked.
    seen: Option<Looked>,
    /// The giver's hold up to what the object's symmetry makes equal, where it was asked for.
    like: Option<Grains>,
}

struct Sampler<'s, 'q> {
    problem: &'s Problem,
    world: &'s CollisionWorld,
    draws: &'s Draws,
    kinds: (usize, usize),
    class: &'s (Class, Vec<UnitQuaternion<f64>>),
    query: &'q HandoffQuery<'q>,
    giver: &'s Arm,
    receiver: &'s Arm,
    /// The receiver's base frame in the giver's.
    bases: (Grains, Pose),
    meeting_place: MeetingPlace,
    /// By pair of holds, the receiver's counted within the giver's, where the hands fit; for those that were asked for.
    pairs: Vec<Option<Option<Box<Pair>>>>,
    /// By how the hands stand to each other, what was looked at for any pair of holds: pairs that an object's symmetry
    /// makes equal do not look at the same draws.
    drawn: BTreeMap<Grains, Looked>,
    seen: Seen,
    /// The directions in which the giver's hand points and the receiver's, by hold, in the object's frame, where hands are
    /// to face each other: see [`Handoffs::prefer_facing`].
    pointing: Option<[Vec<Vec3>; 2]>,
    control: &'s Control,
}

impl<'s, 'q> Sampler<'s, 'q> {
    fn new(handoffs: &'s Handoffs<'_>, query: &'q HandoffQuery<'q>, seen: Seen) -> Self {
        let arms = &handoffs.problem.workcell.arms;
        let (giver, receiver) = (&arms[query.giver.0], &arms[query.receiver.0]);
        let bases = Grains::of(&(giver.base.inverse() * receiver.base));
        let [(giving, from), (taking, to)] = [query.giver, query.receiver].map(|arm| handoffs.kinds[arm.0]);
        let count = query.giver_holds.len() * query.receiver_holds.len();
        Self {
            problem: handoffs.problem,
            world: handoffs.world,
            draws: handoffs.memory.draws(),
            kinds: (giving, taking),
            class: &handoffs.classes[query.object.0],
            query,
            giver,
            receiver,
            meeting_place: MeetingPlace::new(from, to, &bases.pose()),
            bases: (bases, bases.pose()),
            pairs: std::iter::repeat_with(|| None).take(count).collect(),
            drawn: BTreeMap::new(),
            seen,
            pointing: None,
            control: &handoffs.control,
        }
    }

    /// The same that prefers holds in which the hands face each other.
    fn facing(self) -> Self {
        let pointing = [self.query.giver_holds, self.query.receiver_holds].map(|holds| {
            holds.iter().map(|(_, hold)| hold.rotation.inverse_transform_vector(&Vec3::z())).collect()
        });
        Self { pointing: Some(pointing), ..self }
    }

    fn sample(&mut self, tries: usize, most: usize, rng: &mut Rng) -> Vec<HandoffContact> {
        let all_are_equal = self.query.giver_near.is_empty() && self.query.receiver_near.is_empty();
        let handful = if self.pointing.is_some() { SMALL_HANDFUL } else { HANDFUL };
        let handful_size = if all_are_equal { 1 } else { handful * most };
        let mut found: Vec<HandoffContact> = Vec::new();
        let mut left = tries;
        while left > 0 && found.len() < most {
            let mut handful = Vec::new();
            while left > 0 && handful.len() < handful_size {
                // Numeric inverse kinematics may take milliseconds for a draw.
                if left.is_multiple_of(STOP_PERIOD) && self.control.should_stop() {
                    return found;
                }
                left -= 1;
                match self.draw(rng) {
                    Draw::Hit(candidate) => handful.push(candidate),
                    Draw::Miss => {}
                    Draw::NoHolds => left = 0,
                }
            }
            handful.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            for candidate in handful {
                if found.len() >= most {
                    break;
                }
                found.extend(self.ground(&candidate));
            }
        }
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        found
    }

    /// How far every pair of holds has come.
    fn into_seen(mut self) -> Seen {
        for pair in self.pairs.iter().flatten().flatten() {
            if let Some(seen) = pair.seen {
                // Two grasps may be the same hold.
                let key = seen_key(self.query, &pair.giver_hold, &pair.receiver_hold);
                let known = self.seen.entry(key).or_default();
                *known = known.and(seen);
            }
        }
        self.seen
    }

    /// Whether both hands fit around the object in the pair of holds with this number.
    fn fits(&mut self, pair: usize) -> bool {
        if self.pairs[pair].is_none() {
            self.pairs[pair] = Some(self.begin(pair));
        }
        matches!(self.pairs[pair], Some(Some(_)))
    }

    fn begin(&self, pair: usize) -> Option<Box<Pair>> {
        let query = self.query;
        let (g, r) = (pair / query.receiver_holds.len(), pair % query.receiver_holds.len());
        let (giver_hold, receiver_hold) = (query.giver_holds[g].1, query.receiver_holds[r].1);
        let hands = Grains::of(&(giver_hold * receiver_hold.inverse()));
        let stance = Stance { kinds: self.kinds, bases: self.bases.0, hands };
        let sequence = self.draws.of(&stance);
        if !sequence.fits(|| self.world.hands_apart(query.giver, query.receiver, &hands.pose())) {
            return None;
        }
        Some(Box::new(Pair { giver_hold, receiver_hold, stance, sequence, seen: None, like: None }))
    }

    /// Two holds in which the hands do not touch each other; `None` when there are none.
    fn draw_holds(&mut self, rng: &mut Rng) -> Option<usize> {
        let count = self.pairs.len();
        if count == 0 {
            return None;
        }
        let compared = if self.pointing.is_some() { PAIRS_COMPARED } else { 1 };
        for _ in 0..DRAWS_OF_HOLDS / compared {
            let mut drawn: SmallVec<[(i32, usize); PAIRS_COMPARED]> = SmallVec::new();
            for _ in 0..compared {
                let number = rng.random_range(0..count);
                drawn.push((self.alignment(number), number));
            }
            // The first that was drawn of those that face each other alike.
            while let Some(best) = (0..drawn.len()).min_by_key(|&at| drawn[at].0) {
                let (_, number) = drawn.remove(best);
                if self.fits(number) {
                    return Some(number);
                }
            }
        }
        let fitting: Vec<usize> = (0..count).filter(|&pair| self.fits(pair)).collect();
        fitting.choose(rng).copied()
    }

    /// A thousand times the cosine of the angle between the directions in which the hands point in a pair of holds: -1000
    /// where they face each other. Whole, so that pairs that face each other alike are as likely.
    fn alignment(&self, pair: usize) -> i32 {
        let Some([giving, taking]) = &self.pointing else { return 0 };
        let cosine = giving[pair / taking.len()].dot(&taking[pair % taking.len()]);
        (cosine * 1e3).round() as i32
    }

    fn draw(&mut self, rng: &mut Rng) -> Draw {
        let Some(number) = self.draw_holds(rng) else { return Draw::NoHolds };
        let (draws, giver, receiver) = (self.draws, self.giver, self.receiver);
        let (place, bases) = (&self.meeting_place, &self.bases.1);
        let Some(Some(pair)) = &mut self.pairs[number] else { return Draw::NoHolds };
        let hands = pair.stance.hands.pose();
        let solve = |rng: &mut Rng| {
            let mut proposals: SmallVec<[(f64, [Pose; 2]); PROPOSALS_COMPARED]> = SmallVec::new();
            for _ in 0..MOST_PROPOSALS {
                let Some(tcp) = place.draw(rng) else { break };
                let mounts = [
                    tcp * giver.tool.tcp.inverse(),
                    bases.inverse() * tcp * hands * receiver.tool.tcp.inverse(),
                ];
                let is_beyond = |arm: &Arm, mount| arm.model.is_beyond(&arm.limits, mount);
                if is_beyond(giver, &mounts[0]) || is_beyond(receiver, &mounts[1]) {
                    continue;
                }
                proposals.push((place.ease(&tcp, &hands), mounts));
                if proposals.len() == PROPOSALS_COMPARED {
                    break;
                }
            }
            if rng.random_bool(EASE) {
                proposals.sort_by(|a, b| b.0.total_cmp(&a.0));
            }
            let mut solve = |arm: &Arm, mount: &Pose| {
                let mut solutions = Vec::new();
                arm.inverse(mount, 2, rng, &mut solutions);
                (!solutions.is_empty()).then_some(solutions)
            };
            proposals
                .iter()
                .find_map(|(_, [giving, taking])| Some((solve(giver, giving)?, solve(receiver, taking)?)))
        };
        let drawn = self.drawn.entry(pair.stance.hands).or_default();
        let known = || self.seen.get(&seen_key(self.query, &pair.giver_hold, &pair.receiver_hold));
        let seen = pair.seen.unwrap_or_else(|| known().copied().unwrap_or_default()).and(*drawn);
        let meeting = if seen.draws < MOST_DRAWN {
            let meeting = pair.sequence.get(&pair.stance, seen.draws, draws, solve);
            let looked = Looked { draws: seen.draws + 1, hit: seen.hit || meeting.is_some() };
            (pair.seen, *drawn) = (Some(looked), looked);
            meeting
        } else if seen.hit || rng.random_bool(HOPE) {
            let meeting = solve(rng).map(|(giving, taking)| Arc::new(Meeting::passing(giving, taking)));
            let looked = Looked { hit: seen.hit || meeting.is_some(), ..seen };
            (pair.seen, *drawn) = (Some(looked), looked);
            meeting
        } else {
            None
        };
        let Some(meeting) = meeting else { return Draw::Miss };
        let (giving, taking) = (meeting.giving.iter().enumerate(), meeting.taking.iter().enumerate());
        let pairs = giving.flat_map(|(g, p)| taking.clone().map(move |(r, q)| ((g, r), p, q)));
        let costs = pairs.map(|(configurations, p, q)| (configurations, self.cost(p, q)));
        match costs.min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((configurations, cost)) => {
                let meeting = meeting.clone();
                Draw::Hit(Candidate { pair: number, meeting, configurations, cost })
            }
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
    fn ground(&mut self, candidate: &Candidate) -> Option<HandoffContact> {
        let Candidate { pair, meeting, configurations, cost } = candidate;
        let (class, rotations) = self.class;
        let Some(Some(pair)) = &mut self.pairs[*pair] else { return None };
        let like = *pair.like.get_or_insert_with(|| {
            let turned = rotations.iter().map(|rotation| Grains::of(&(pair.giver_hold * rotation)));
            turned.min().unwrap_or_else(|| Grains::of(&pair.giver_hold))
        });
        let (giver_hold, receiver_hold) = (pair.giver_hold, pair.receiver_hold);
        let hands = pair.stance.hands.pose();
        let (p, q) = (&meeting.giving[configurations.0], &meeting.taking[configurations.1]);
        let asked = Grounded {
            arms: (self.query.giver, self.query.receiver),
            class: *class,
            giver_hold: like,
            configurations: *configurations,
        };
        let lines = meeting.lines(asked, self.draws, || {
            let giving = like.pose();
            self.lines((p, &giving), (q, &(hands.inverse() * giving)))
        })?;
        Some(HandoffContact {
            giver_hold,
            receiver_hold,
            giver_q: p.clone(),
            receiver_q: q.clone(),
            giver_retreat: lines.0.clone(),
            receiver_approach: lines.1.clone(),
            cost: *cost,
        })
    }

    /// The giver's line after the release and the receiver's before the grasp, if all is free of collision.
    fn lines(
        &self,
        (giver_q, giver_hold): (&Config, &Pose),
        (receiver_q, receiver_hold): (&Config, &Pose),
    ) -> Option<(Line, Line)> {
        let (world, query) = (self.world, self.query);
        let object = &self.problem.objects[query.object.0];
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
        let giver_retreat =
            Line::follow(self.giver, giver_q, &backwards(self.giver, giver_q), object.retreat)?;
        let receiver_approach =
            Line::follow(self.receiver, receiver_q, &backwards(self.receiver, receiver_q), object.approach)?;
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
        free.then_some((giver_retreat, receiver_approach))
    }
}

/// Whose draws were looked at how far.
fn seen_key(
    query: &HandoffQuery<'_>,
    giver_hold: &Pose,
    receiver_hold: &Pose,
) -> (Grains, Grains, usize, usize) {
    (Grains::of(giver_hold), Grains::of(receiver_hold), query.giver.0, query.receiver.0)
}

/// Whether two arms are the same but for where they stand.
fn same_arm(problem: &Problem, a: ArmId, b: ArmId) -> bool {
    let (first, second) = (&problem.workcell.arms[a.0], &problem.workcell.arms[b.0]);
    same_hand(problem, a, b) && first.limits == second.limits && first.home == second.home
}

/// The rotations about the object's frame that map the shape of an object onto itself, the identity first.
fn rotations_of(shapes: &[PlacedShape]) -> Vec<UnitQuaternion<f64>> {
    match shapes {
        [one] if one.pose == Pose::identity() => shape_rotations(&one.shape),
        _ => vec![UnitQuaternion::identity()],
    }
}

/// Least time (s) from `from` to `to` at the joints' greatest speeds.
#[inline]
pub fn travel_time(arm: &Arm, from: &[f64], to: &[f64]) -> f64 {
    from.iter()
        .zip(to)
        .zip(&arm.limits)
        .map(|((a, b), limit)| (a - b).abs() / limit.velocity)
        .fold(0.0, f64::max)
}
