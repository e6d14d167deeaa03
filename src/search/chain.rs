//! Chains: how one object travels from where it is to its next place of rest, hand by hand, with
//! grasps that fit together all the way.
//!
//! A pick's grasp must suit the handoff that follows, and that one's the place at the end; so the
//! chain is grounded backwards from the place, before the pick is made.

use std::collections::BTreeMap;

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{CollisionWorld, Scene};
use crate::geometry::Pose;
use crate::guidance::NodeId;
use crate::kinematics::Config;
use crate::problem::Problem;
use crate::run::Rng;
use crate::transition::{ContactKind, ContactQuery, Contacts, HandoffContact, HandoffQuery, travel_time};
use crate::workcell::{ArmId, ObjectId, SurfaceId, Symmetry, rests_on};

use super::forecast::{Neighbour, scene_of};
use super::handoffs::{HandoffPool, WANTED};
use super::rests::Rests;
use super::tree::Whereabouts;

/// A grasp number and the object's frame in the TCP frame.
type Hold = (usize, Pose);

/// One object's way to its next place of rest.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    /// The arms that carry it, and how.
    pub(super) carriers: Vec<(ArmId, Pose)>,
    /// The handoffs between them.
    pub(super) handoffs: Vec<HandoffContact>,
    /// Where it is put down.
    pub(super) target: (Pose, SurfaceId),
    /// The node of the mode graph there, and the one that the guide wanted.
    pub(super) node: NodeId,
    pub(super) wanted: NodeId,
}

/// The chains of each object, leg after leg.
pub(super) type Chains = BTreeMap<usize, Vec<Chain>>;

/// What a chain is asked for.
pub(super) struct ChainRequest<'a> {
    pub(super) object: ObjectId,
    pub(super) from: &'a Whereabouts,
    /// The arms on the way, first to last; the one that holds it now included.
    pub(super) arms: &'a [ArmId],
    /// Where it may be put down; the roomiest are tried first.
    pub(super) targets: &'a [(Pose, SurfaceId)],
    /// How many of the targets are tried in full.
    pub(super) most_tried: usize,
    /// Targets that need not be tried.
    pub(super) besides: &'a [Pose],
    /// Where each arm is now.
    pub(super) arms_at: &'a [Config],
    /// The others at rest when it is picked.
    pub(super) at_pick: &'a [Neighbour],
    /// The others at rest when it is put down.
    pub(super) at_place: &'a [Neighbour],
    /// The others at rest when it leaves again.
    pub(super) at_next: &'a [Neighbour],
    /// The node of the targets, and the one that the guide wants.
    pub(super) node: NodeId,
    pub(super) wanted: NodeId,
    /// Whether contacts and handoffs are to be sampled although some are known.
    pub(super) anew: bool,
}

/// One end of a chain: the holds in which the object may be taken up or put down there.
struct End {
    /// Those of which it is not known that they will not do.
    holds: Vec<Hold>,
    /// What is asked of an arm that takes the object up or puts it down, and the others at rest; `None` where it is in
    /// the hand.
    rest: Option<(ContactQuery, Scene)>,
}

impl End {
    /// Whether there is a contact in `hold` that is clear of the others; else it is none of the holds any more.
    fn confirm(&mut self, contacts: &mut Contacts<'_>, hold: &Pose) -> bool {
        let Some((asked, scene)) = &self.rest else { return true };
        let is_clear = contacts.confirm(asked, hold, scene);
        if !is_clear {
            self.holds.retain(|(_, other)| other != hold);
        }
        is_clear
    }
}

/// Why there is no chain.
#[derive(Debug, Clone)]
pub(super) enum Misfit {
    /// No hold in which the first arm can take the object up.
    Pick,
    /// No hold in which the last arm can put it down at a target.
    Place,
    /// Holds for both, but no way from one to the other was found.
    Between,
    /// Others stand in the way of the pick, or of the place.
    Blocked { pick: Vec<Neighbour>, place: Vec<Neighbour> },
}

/// Grounds chains.
pub(super) struct ChainPlanner<'p, 'a> {
    pub(super) problem: &'a Problem,
    pub(super) world: &'a CollisionWorld,
    pub(super) contacts: &'p mut Contacts<'a>,
    pub(super) handoffs: &'p mut HandoffPool,
    pub(super) rests: &'p Rests,
    pub(super) rng: &'p mut Rng,
    pub(super) handoff_tries: usize,
    /// Chance of sampling contacts anew.
    pub(super) fresh: f64,
    /// Whether what is good enough for a first plan will do.
    pub(super) is_hasty: bool,
}

impl ChainPlanner<'_, '_> {
    /// A chain for the request, or why none was found this time.
    pub(super) fn plan(&mut self, request: &ChainRequest<'_>) -> Result<Chain, Misfit> {
        let (Some(&first), Some(&last)) = (request.arms.first(), request.arms.last()) else {
            return Err(Misfit::Between);
        };
        let mut start = match request.from {
            Whereabouts::Resting { pose, surface } => {
                let pick = query(ContactKind::Pick, first, request.object, (*pose, *surface));
                self.sample(request, &pick);
                self.rest_end(pick, request.at_pick)
            }
            Whereabouts::Held { object_in_tcp, .. } => {
                End { holds: vec![(usize::MAX, *object_in_tcp)], rest: None }
            }
        };
        let mut why = Misfit::Place;
        let mut tried = 0;
        for (pose, surface) in self.in_order(request) {
            if tried == request.most_tried {
                break;
            }
            let place = query(ContactKind::Place, last, request.object, (pose, surface));
            self.sample(request, &place);
            let mut end = self.rest_end(place, request.at_place);
            if let Whereabouts::Held { object_in_tcp, .. } = request.from
                && request.arms.len() == 1
                && !end.holds.iter().any(|(_, hold)| hold == object_in_tcp)
            {
                // Held from the start in a way that no grasp lists.
                end.holds.push((usize::MAX, *object_in_tcp));
            }
            if let Some(chain) = self.fit(request, &mut start, &mut end, (pose, surface)) {
                return Ok(chain);
            }
            let misfit = self.blame(request, (&start, &end), (pose, surface));
            match misfit {
                Misfit::Pick => return Err(misfit),
                Misfit::Place => {}
                Misfit::Between | Misfit::Blocked { .. } => {
                    tried += 1;
                    why = misfit;
                }
            }
        }
        Err(why)
    }

    /// Now and then samples more contacts in a hold, be it one in which none is known, where a chain is planned
    /// anew.
    fn sample(&mut self, request: &ChainRequest<'_>, asked: &ContactQuery) {
        if request.anew && self.rng.random_bool(self.fresh) {
            let holds = self.contacts.possible_holds(asked);
            if let Some((_, hold)) = holds.choose(self.rng) {
                self.contacts.more(asked, hold);
            }
        }
    }

    /// Why nothing fits by clear holds: what stands in the way of holds that fit together.
    fn blame(
        &mut self,
        request: &ChainRequest<'_>,
        (start, end): (&End, &End),
        target: (Pose, SurfaceId),
    ) -> Misfit {
        let (mut start, mut end) = (self.beside_nothing(request, start), self.beside_nothing(request, end));
        if start.holds.is_empty() {
            return Misfit::Pick;
        }
        if end.holds.is_empty() {
            return Misfit::Place;
        }
        if request.at_pick.is_empty() && request.at_place.is_empty() {
            return Misfit::Between;
        }
        let Some(chain) = self.fit(request, &mut start, &mut end, target) else { return Misfit::Between };
        let (Some(&(first, taken)), Some(&(last, put))) = (chain.carriers.first(), chain.carriers.last())
        else {
            return Misfit::Between;
        };
        let pick = match request.from {
            Whereabouts::Resting { pose, surface } => {
                let pick = query(ContactKind::Pick, first, request.object, (*pose, *surface));
                self.blockers(&pick, &taken, request.at_pick)
            }
            Whereabouts::Held { .. } => Vec::new(),
        };
        let place = query(ContactKind::Place, last, request.object, target);
        let place = self.blockers(&place, &put, request.at_place);
        if pick.is_empty() && place.is_empty() { Misfit::Between } else { Misfit::Blocked { pick, place } }
    }

    /// The neighbours that keep all contacts with `hold` from being had; empty when one is clear.
    pub(super) fn blockers(
        &mut self,
        query: &ContactQuery,
        hold: &Pose,
        neighbours: &[Neighbour],
    ) -> Vec<Neighbour> {
        let scene = scene_of(neighbours);
        if self.contacts.is_clear_of(query, hold, &scene) {
            return Vec::new();
        }
        let known = self.contacts.at(query, hold);
        let mut alone = |neighbour: &Neighbour, all: bool| {
            let scene = scene_of(std::slice::from_ref(neighbour));
            let mut blocked = known.iter().map(|contact| !self.contacts.is_clear(query, contact, &scene));
            if all { blocked.all(|b| b) } else { blocked.any(|b| b) }
        };
        let mut found: Vec<Neighbour> = neighbours.iter().filter(|n| alone(n, true)).copied().collect();
        if found.is_empty() {
            found = neighbours.iter().filter(|n| alone(n, false)).copied().collect();
        }
        found
    }

    /// The end of a chain where `asked` is asked of an arm, beside `neighbours`.
    fn rest_end(&mut self, asked: ContactQuery, neighbours: &[Neighbour]) -> End {
        let scene = scene_of(neighbours);
        End { holds: self.contacts.open_holds(&asked, &scene), rest: Some((asked, scene)) }
    }

    /// The same end with the contacts that can be had where no other objects are.
    fn beside_nothing(&mut self, request: &ChainRequest<'_>, end: &End) -> End {
        let Some((asked, _)) = &end.rest else { return End { holds: end.holds.clone(), rest: None } };
        let mut holds = self.contacts.holds(asked);
        if let Whereabouts::Held { object_in_tcp, .. } = request.from
            && request.arms.len() == 1
            && !holds.iter().any(|(_, hold)| hold == object_in_tcp)
            && self.contacts.has(asked, object_in_tcp)
        {
            holds.push((usize::MAX, *object_in_tcp));
        }
        End { holds, rest: Some((*asked, Scene::default())) }
    }

    /// The targets in the order in which they are tried, without those that are taken.
    fn in_order(&mut self, request: &ChainRequest<'_>) -> Vec<(Pose, SurfaceId)> {
        if let [(pose, surface)] = request.targets {
            let turned = if request.anew { self.turned(request.object, *pose, *surface) } else { *pose };
            return vec![(turned, *surface)];
        }
        let mut targets = request.targets.to_vec();
        targets.retain(|(pose, _)| !request.besides.contains(pose));
        if !targets.is_empty() && self.rng.random_bool(0.5) {
            let turn = self.rng.random_range(0..targets.len());
            targets.rotate_left(turn);
        }
        let scene = scene_of(request.at_place);
        let surfaces = &self.problem.workcell.surfaces;
        targets.retain(|(pose, surface)| {
            let carrier = surfaces.get(surface.0).and_then(|s| s.carrier);
            self.world.placement_free(request.object, pose, carrier, &scene)
        });
        let others = [request.at_place, request.at_next].concat();
        self.rests.roomiest_first(request.object, &others, &mut targets);
        targets
    }

    /// A chain from one of the holds at its start to one of those at its end.
    fn fit(
        &mut self,
        request: &ChainRequest<'_>,
        start: &mut End,
        end: &mut End,
        target: (Pose, SurfaceId),
    ) -> Option<Chain> {
        let (&first, &last) = (request.arms.first()?, request.arms.last()?);
        let (node, wanted) = (request.node, request.wanted);
        if start.holds.is_empty() || end.holds.is_empty() {
            return None;
        }
        if request.arms.len() == 1 {
            let mut fitting: Vec<Hold> = start.holds.clone();
            fitting.retain(|(_, hold)| {
                end.holds.iter().any(|(_, other)| other == hold)
                    && start.confirm(self.contacts, hold)
                    && end.confirm(self.contacts, hold)
            });
            let hold = self.cheapest_hold(request, first, &target, &fitting)?;
            return Some(Chain { carriers: vec![(first, hold)], handoffs: Vec::new(), target, node, wanted });
        }
        // Backwards: for each meeting those by which the rest of the way can be gone.
        let hops = request.arms.len() - 1;
        let mut meetings: Vec<Vec<HandoffContact>> = Vec::with_capacity(hops);
        let mut receiver_holds: Vec<Hold> = Vec::new();
        for hop in (0..hops).rev() {
            let (giver, receiver) = (request.arms[hop], request.arms[hop + 1]);
            let any = if hop == 0 { Vec::new() } else { self.grasps_of(request.object, giver) };
            let giver_near = self.near(request, giver, hop == 0, &target, false);
            let receiver_near = self.near(request, receiver, false, &target, receiver == last);
            let found = loop {
                let asked = HandoffQuery {
                    giver,
                    receiver,
                    object: request.object,
                    giver_holds: if hop == 0 { &start.holds } else { &any },
                    receiver_holds: if hop + 1 == hops { &end.holds } else { &receiver_holds },
                    giver_near: &giver_near,
                    receiver_near: &receiver_near,
                };
                if asked.giver_holds.is_empty() || asked.receiver_holds.is_empty() {
                    return None;
                }
                // On the first meeting no other depends; to have a choice can wait for a plan.
                let wanted = if hop == 0 && self.is_hasty { 1 } else { WANTED };
                let mut found = self.meet(&asked, wanted, request.anew);
                if found.is_empty() {
                    return None;
                }
                // Contacts are looked for where there is a use for them. Each round in vain leaves fewer holds.
                found.retain(|meeting| {
                    (hop > 0 || start.confirm(self.contacts, &meeting.giver_hold))
                        && (hop + 1 < hops || end.confirm(self.contacts, &meeting.receiver_hold))
                });
                if !found.is_empty() {
                    break found;
                }
            };
            receiver_holds.clear();
            for meeting in &found {
                if !receiver_holds.iter().any(|(_, hold)| *hold == meeting.giver_hold) {
                    receiver_holds.push((usize::MAX, meeting.giver_hold));
                }
            }
            meetings.push(found);
        }
        // Forwards: a meeting at a time, mostly the cheapest that takes over as the last one gave.
        let mut carriers = Vec::with_capacity(hops + 1);
        let mut handoffs: Vec<HandoffContact> = Vec::with_capacity(hops);
        for (hop, found) in meetings.into_iter().rev().enumerate() {
            let in_hand = handoffs.last().map(|meeting| meeting.receiver_hold);
            let fitting: Vec<HandoffContact> =
                found.into_iter().filter(|m| in_hand.is_none_or(|hold| hold == m.giver_hold)).collect();
            let chosen = if self.rng.random_bool(0.7) { fitting.first() } else { fitting.choose(self.rng) }?;
            if hop == 0 {
                carriers.push((request.arms[0], chosen.giver_hold));
            }
            carriers.push((request.arms[hop + 1], chosen.receiver_hold));
            handoffs.push(chosen.clone());
        }
        Some(Chain { carriers, handoffs, target, node, wanted })
    }

    fn meet(&mut self, asked: &HandoffQuery<'_>, wanted: usize, anew: bool) -> Vec<HandoffContact> {
        self.handoffs.find(self.problem, self.contacts, asked, (self.handoff_tries, wanted), anew, self.rng)
    }

    /// Every grasp of `object` that fits the arm's gripper.
    fn grasps_of(&self, object: ObjectId, arm: ArmId) -> Vec<Hold> {
        let opening = self.problem.workcell.arms[arm.0].tool.max_opening;
        let grasps = self.problem.objects[object.0].grasps.iter().enumerate();
        grasps
            .filter(|(_, grasp)| grasp.fits(opening))
            .map(|(number, grasp)| (number, grasp.object_in_tcp))
            .collect()
    }

    /// A pose on `surface` that is the same up to the object's symmetry.
    fn turned(&mut self, object: ObjectId, pose: Pose, surface: SurfaceId) -> Pose {
        let model = &self.problem.objects[object.0];
        let turn = match model.symmetry {
            Symmetry::CylinderZ | Symmetry::Sphere => nalgebra::UnitQuaternion::from_axis_angle(
                &crate::geometry::Vec3::z_axis(),
                self.rng.random_range(0.0..std::f64::consts::TAU),
            ),
            _ => match model.symmetry_rotations.choose(self.rng) {
                Some(rotation) => *rotation,
                None => return pose,
            },
        };
        let turned = pose * turn;
        // What only counts as the box around it may topple there.
        let surface = self.problem.workcell.surfaces.get(surface.0);
        let rests = || surface.is_some_and(|it| rests_on(&model.shapes, &turned, it).is_ok());
        if !model.only_counts_as_box() || rests() { turned } else { pose }
    }

    /// Configurations near which an arm will be before or after a handoff.
    fn near(
        &mut self,
        request: &ChainRequest<'_>,
        arm: ArmId,
        picks: bool,
        target: &(Pose, SurfaceId),
        places: bool,
    ) -> Vec<Config> {
        let mut near: Vec<Config> = request.arms_at.get(arm.0).cloned().into_iter().collect();
        let mut contact = |kind, at: (Pose, SurfaceId)| {
            let asked = query(kind, arm, request.object, at);
            let mut holds = self.contacts.possible_holds(&asked);
            while !holds.is_empty() {
                let (_, hold) = holds.swap_remove(self.rng.random_range(0..holds.len()));
                if let Some(contact) = self.contacts.nth(&asked, &hold, 0) {
                    return Some(contact.q);
                }
            }
            None
        };
        if picks && let Whereabouts::Resting { pose, surface } = request.from {
            near.extend(contact(ContactKind::Pick, (*pose, *surface)));
        }
        if places {
            near.extend(contact(ContactKind::Place, *target));
        }
        near
    }

    /// Of the holds that suit pick and place by one arm the one with the least travel, or now and
    /// then any.
    fn cheapest_hold(
        &mut self,
        request: &ChainRequest<'_>,
        arm: ArmId,
        target: &(Pose, SurfaceId),
        holds: &[Hold],
    ) -> Option<Pose> {
        if self.rng.random_bool(0.3) {
            return holds.choose(self.rng).map(|(_, hold)| *hold);
        }
        let model = &self.problem.workcell.arms[arm.0];
        let place = query(ContactKind::Place, arm, request.object, *target);
        let mut best: Option<(f64, Pose)> = None;
        for (_, hold) in holds {
            let places = self.contacts.at(&place, hold);
            let picks: Vec<Config> = match request.from {
                Whereabouts::Resting { pose, surface } => {
                    let pick = query(ContactKind::Pick, arm, request.object, (*pose, *surface));
                    self.contacts.at(&pick, hold).iter().map(|c| c.q.clone()).collect()
                }
                Whereabouts::Held { .. } => request.arms_at.get(arm.0).cloned().into_iter().collect(),
            };
            for pick in &picks {
                let before = request.arms_at.get(arm.0).map_or(0.0, |now| travel_time(model, now, pick));
                for contact in places.iter() {
                    let cost = before + travel_time(model, pick, &contact.q);
                    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, *hold));
                    }
                }
            }
        }
        best.map(|(_, hold)| hold)
    }
}

/// A contact query.
pub(super) fn query(kind: ContactKind, arm: ArmId, object: ObjectId, at: (Pose, SurfaceId)) -> ContactQuery {
    ContactQuery { kind, arm, object, pose: at.0, surface: at.1 }
}
