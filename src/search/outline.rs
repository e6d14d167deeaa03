//! Outlines: the whole of a guide's plan grounded but for its motions. Chains of grasps for every
//! leg, against where the other objects will be by then, show what stands in the way before anything
//! moves.

use rand::Rng as _;
use rand::seq::SliceRandom;

use crate::geometry::Pose;
use crate::guidance::{Guide, Move, NodeId};
use crate::kinematics::Config;
use crate::transition::{ContactKind, ContactQuery};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::chain::{Chain, ChainPlanner, ChainRequest, Chains, Misfit, query};
use super::forecast::{Neighbour, around};
use super::ground::{Grounder, after_departure};
use super::leg::{Leg, legs};
use super::tree::{Vertex, Whereabouts};

/// Failures of grasps to fit together after which detours are tried.
const DETOUR_AFTER: u32 = 2;

/// Places tried at first for an object that must be able to go on from there.
const LOOK_AHEAD_TRIES: usize = 6;

/// Doublings of that number where something kept being in the way.
const MOST_DOUBLINGS: u32 = 3;

/// Chance that contacts and handoffs are sampled although some are known, where no grasps fitted together.
const ANEW: f64 = 0.3;

/// Places of a region that are tried in full for one chain at first.
const FEWEST_TARGETS: usize = 4;

/// The same where they kept failing.
const MOST_TARGETS: usize = 32;

/// Buffer poses tried for one detour.
const DETOUR_TARGETS: usize = 12;

/// A leg that could not be grounded, and why.
#[derive(Debug, Clone)]
pub(super) struct Obstruction {
    pub(super) leg: Leg,
    pub(super) why: Misfit,
}

/// The legs of a guide with their chains, as far as they were found.
#[derive(Debug, Default)]
pub(super) struct Outline {
    pub(super) legs: Vec<Leg>,
    pub(super) chains: Chains,
    pub(super) obstructions: Vec<Obstruction>,
}

impl Outline {
    /// The number among the legs of its object, and the leg, to which `action` belongs.
    pub(super) fn leg_of(&self, action: &Move, step: usize) -> Option<(usize, &Leg)> {
        let of_object = self.legs.iter().filter(|leg| leg.object == action.object);
        of_object.enumerate().find(|(_, leg)| leg.moves.contains(&(step, *action)))
    }
}

impl<'a> Grounder<'a> {
    /// Grounds the whole of the guide's plan but for its motions: chains for all legs from `vertex`,
    /// those of the parent where they still suit.
    pub(super) fn outline(&mut self, vertex: &Vertex, guide: &Guide) -> Outline {
        let now: Vec<Config> = vertex.arms.iter().map(|arm| after_departure(arm).clone()).collect();
        let mut outline = Outline { legs: legs(self.map, vertex, guide), ..Outline::default() };
        for index in 0..outline.legs.len() {
            let leg = outline.legs[index].clone();
            let before = outline.legs[..index].iter().filter(|other| other.object == leg.object).count();
            if outline.chains.get(&leg.object).map_or(0, Vec::len) != before {
                // An earlier leg of this object has no chain.
                continue;
            }
            let next = outline.legs[index + 1..].iter().find(|other| other.object == leg.object).cloned();
            match self.chain(vertex, &outline, &leg, next.as_ref(), &now, false) {
                Ok(chain) => outline.chains.entry(leg.object).or_default().push(chain),
                Err(why) => outline.obstructions.push(Obstruction { leg, why }),
            }
        }
        outline
    }

    /// Plans chains of the immediate actions again: those of the arms `blamed`, or else one in two of all.
    pub(super) fn renew(&mut self, vertex: &Vertex, guide: &Guide, outline: &mut Outline, blamed: &[ArmId]) {
        let now: Vec<Config> = vertex.arms.iter().map(|arm| after_departure(arm).clone()).collect();
        let map = self.map;
        let is_blamed = |action: &Move| {
            let arms = [action.from, action.to].map(|node| map.arm(node));
            arms.iter().flatten().any(|arm| blamed.contains(arm))
        };
        let some_are_blamed = guide.immediate.iter().any(is_blamed);
        for action in &guide.immediate {
            let is_chosen = if some_are_blamed { is_blamed(action) } else { self.rng.random_bool(0.5) };
            if !is_chosen {
                continue;
            }
            let mut of_object = outline.legs.iter().filter(|leg| leg.object == action.object);
            let (first, next) = (of_object.next().cloned(), of_object.next().cloned());
            let Some(first) = first else { continue };
            let old = outline.chains.remove(&action.object);
            let chains = match self.chain(vertex, outline, &first, next.as_ref(), &now, true) {
                Ok(chain) => Some(vec![chain]),
                Err(_) => old,
            };
            outline.chains.extend(chains.map(|chains| (action.object, chains)));
        }
    }

    /// The chain of `leg`: the one that is known, or a fresh one by which `next` can go on.
    fn chain(
        &mut self,
        vertex: &Vertex,
        outline: &Outline,
        leg: &Leg,
        next: Option<&Leg>,
        now: &[Config],
        renew: bool,
    ) -> Result<Chain, Misfit> {
        let object = leg.object;
        let planned = outline.chains.get(&object);
        let number = planned.map_or(0, Vec::len);
        let from = match planned.and_then(|chains| chains.last()) {
            Some(before) => Whereabouts::Resting { pose: before.target.0, surface: before.target.1 },
            None => vertex.objects[object].clone(),
        };
        let at_pick = self.around(vertex, outline, object, leg.begins());
        let at_place = self.around(vertex, outline, object, leg.ends());
        if !renew
            && let Some(known) = vertex.chains.get(&object).and_then(|chains| chains.get(number))
            && known.carriers.iter().map(|(arm, _)| *arm).eq(leg.arms.iter().copied())
            && (known.node == leg.end || known.wanted == leg.end)
            && self.suits(known, object, &from, &at_pick, &at_place)
        {
            return Ok(known.clone());
        }
        let last = *leg.arms.last().ok_or(Misfit::Between)?;
        let key = (object, leg.arms.clone(), leg.end);
        let failures = self.barren.get(&key).copied().unwrap_or(0);
        let hindrances = self.hindered.get(&key).copied().unwrap_or(0).min(MOST_DOUBLINGS);
        let tries = LOOK_AHEAD_TRIES << hindrances;
        let mut targets = self.map.placements(object, leg.end);
        if hindrances > 0 && self.rng.random_bool(0.5) {
            // The roomiest places have been tried.
            targets.shuffle(&mut self.rng);
            targets.truncate(tries);
        }
        let onward = next.filter(|_| targets.len() > 1);
        let at_next =
            onward.map_or_else(Vec::new, |next| self.around(vertex, outline, object, next.begins()));
        let request = ChainRequest {
            object: ObjectId(object),
            from: &from,
            arms: &leg.arms,
            targets: &targets,
            most_tried: (FEWEST_TARGETS << failures.min(8)).min(MOST_TARGETS),
            besides: &[],
            arms_at: now,
            at_pick: &at_pick,
            at_place: &at_place,
            at_next: &at_next,
            node: leg.end,
            wanted: leg.end,
            anew: renew || failures > 0 && self.rng.random_bool(ANEW),
        };
        let mut why = Misfit::Between;
        let (mut besides, mut hindered) = (Vec::new(), None);
        for _ in 0..onward.map_or(1, |_| tries) {
            if self.control.should_stop() {
                break;
            }
            match self.planner().plan(&ChainRequest { besides: &besides, ..request }) {
                Ok(chain) => match onward.map(|next| self.leads_to(vertex, outline, &chain, next, now)) {
                    None | Some(Ok(())) => return Ok(chain),
                    Some(Err(after)) => {
                        besides.push(chain.target.0);
                        if matches!(after, Misfit::Blocked { .. }) {
                            hindered.get_or_insert(chain);
                        }
                    }
                },
                Err(misfit) => {
                    if besides.is_empty() {
                        why = misfit;
                    }
                    break;
                }
            }
        }
        // Not this leg is at fault when something is only in the way of the next.
        if let Some(chain) = hindered {
            *self.hindered.entry(key).or_default() += 1;
            return Ok(chain);
        }
        if !matches!(why, Misfit::Blocked { .. }) {
            *self.barren.entry(key).or_default() += 1;
            // Where grasps do not fit together all the way, the object is put down on a buffer once,
            // to be taken up in another way.
            if number == 0 && failures >= DETOUR_AFTER {
                // Those that are there by then, as far as the guide goes.
                let others = |nodes: &[NodeId]| {
                    let comes = |other: usize| {
                        let legs = outline.legs.iter().filter(|one| one.object == other);
                        legs.into_iter().any(|one| nodes.contains(&one.end) && one.ends() <= leg.ends())
                    };
                    let there = |(other, at): (usize, &NodeId)| {
                        other != object && (nodes.contains(at) || comes(other))
                    };
                    vertex.mode.iter().enumerate().filter(|one| there(*one)).count()
                };
                let instance = self.map.network().instance();
                let mut detours = self.map.regions_of(object, last);
                detours.retain(|&node| node != leg.end && instance.has_room(node, others));
                detours.shuffle(&mut self.rng);
                for node in detours {
                    let mut targets = self.map.placements(object, node);
                    targets.shuffle(&mut self.rng);
                    targets.truncate(DETOUR_TARGETS);
                    let goals = self.map.placements(object, leg.end);
                    targets.retain(|&target| self.leads_on(last, ObjectId(object), target, &goals));
                    let detour = ChainRequest { targets: &targets, node, ..request };
                    if let Ok(chain) = self.planner().plan(&detour) {
                        return Ok(chain);
                    }
                }
            }
        }
        Err(why)
    }

    pub(super) fn planner(&mut self) -> ChainPlanner<'_, 'a> {
        ChainPlanner {
            problem: self.problem,
            world: self.world,
            contacts: &mut self.contacts,
            handoffs: &mut self.handoffs,
            rests: &self.rests,
            rng: &mut self.rng,
            handoff_tries: self.handoff_tries,
            fresh: self.fresh,
            is_hasty: self.is_hasty,
        }
    }

    pub(super) fn around(
        &self,
        vertex: &Vertex,
        outline: &Outline,
        object: usize,
        step: usize,
    ) -> Vec<Neighbour> {
        around(self.map, vertex, &outline.legs, &outline.chains, object, step)
    }

    /// Whether the contacts at both ends of a known chain can still be had.
    pub(super) fn suits(
        &mut self,
        chain: &Chain,
        object: usize,
        from: &Whereabouts,
        at_pick: &[Neighbour],
        at_place: &[Neighbour],
    ) -> bool {
        let (Some(&(first, taken)), Some(&(last, put))) = (chain.carriers.first(), chain.carriers.last())
        else {
            return false;
        };
        let mut planner = self.planner();
        let mut can = |asked: &ContactQuery, hold: &Pose, neighbours: &[Neighbour]| {
            planner.contacts.has(asked, hold) && planner.blockers(asked, hold, neighbours).is_empty()
        };
        let picks = match from {
            Whereabouts::Resting { pose, surface } => {
                let pick = query(ContactKind::Pick, first, ObjectId(object), (*pose, *surface));
                can(&pick, &taken, at_pick)
            }
            Whereabouts::Held { .. } => true,
        };
        picks && can(&query(ContactKind::Place, last, ObjectId(object), chain.target), &put, at_place)
    }

    /// Whether the object can go on along `next` from where `chain` puts it down, or why not.
    fn leads_to(
        &mut self,
        vertex: &Vertex,
        outline: &Outline,
        chain: &Chain,
        next: &Leg,
        now: &[Config],
    ) -> Result<(), Misfit> {
        let at_pick = self.around(vertex, outline, next.object, next.begins());
        let at_place = self.around(vertex, outline, next.object, next.ends());
        let targets = self.map.placements(next.object, next.end);
        let request = ChainRequest {
            object: ObjectId(next.object),
            from: &Whereabouts::Resting { pose: chain.target.0, surface: chain.target.1 },
            arms: &next.arms,
            targets: &targets,
            most_tried: FEWEST_TARGETS,
            besides: &[],
            arms_at: now,
            at_pick: &at_pick,
            at_place: &at_place,
            at_next: &[],
            node: next.end,
            wanted: next.end,
            anew: false,
        };
        self.planner().plan(&request).map(|_| ())
    }

    /// Whether `arm` can take the object up at `from` in a hold in which it can put it down at one
    /// of `goals`.
    fn leads_on(
        &mut self,
        arm: ArmId,
        object: ObjectId,
        from: (Pose, SurfaceId),
        goals: &[(Pose, SurfaceId)],
    ) -> bool {
        let pick = query(ContactKind::Pick, arm, object, from);
        self.contacts.possible_holds(&pick).into_iter().any(|(_, hold)| {
            self.contacts.has(&pick, &hold)
                && goals.iter().any(|&goal| {
                    let put_down = query(ContactKind::Place, arm, object, goal);
                    self.contacts.has(&put_down, &hold)
                })
        })
    }
}
