//! `sample_trans`: grounds the actions of a step, and the ways in which idle arms position
//! themselves ahead.

use std::collections::BTreeMap;

use rand::Rng as _;
use rand::seq::{IndexedRandom, SliceRandom};

use crate::collision::{CollisionWorld, Exemption, Held, Scene};
use crate::geometry::Pose;
use crate::guidance::{Guide, Move, NodeId};
use crate::kinematics::Config;
use crate::motion::{ArmGoal, ArmTask, Departure, StepTask};
use crate::plan::ActionKind;
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::transition::{Contact, ContactKind, ContactQuery, Contacts, HandoffContact, travel_time};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::chain::{Chain, ChainPlanner, ChainRequest, query};
use super::map::Map;
use super::settings::Settings;
use super::tree::{Vertex, Whereabouts};

/// Failures to ground a chain after which detours are tried.
const DETOUR_AFTER: u32 = 60;

/// Buffer poses tried for one detour.
const DETOUR_TARGETS: usize = 12;

/// Why a step could not be grounded.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum GroundingFailure {
    /// No grasps fit together for this move.
    NoChain(Move),
    /// The next contact cannot be had with the hold that the object is in.
    NoContact(Move),
}

/// A grounded step, ready for its motion.
#[derive(Debug)]
pub(super) struct Grounding {
    pub(super) task: StepTask,
    pub(super) actions: Vec<(ObjectId, ActionKind)>,
    /// How arms that act leave afterwards, by arm.
    pub(super) departures: BTreeMap<usize, Departure>,
    /// Receivers and the givers that they wait for.
    pub(super) waits: BTreeMap<usize, ArmId>,
    /// Where the objects are afterwards.
    pub(super) objects: Vec<Whereabouts>,
    pub(super) chains: BTreeMap<usize, Chain>,
    /// The nodes at which objects were put down, which may be others than the guide's.
    pub(super) landed: BTreeMap<usize, NodeId>,
}

/// Samples transitions.
#[derive(Debug)]
pub(super) struct Grounder<'a> {
    problem: &'a Problem,
    world: &'a CollisionWorld,
    map: &'a Map,
    contacts: Contacts<'a>,
    rng: Rng,
    handoff_tries: usize,
    fresh: f64,
    /// How often no chain was found for an object along a sequence of arms to a node.
    barren: BTreeMap<(usize, Vec<ArmId>, NodeId), u32>,
}

impl<'a> Grounder<'a> {
    pub(super) fn new(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        map: &'a Map,
        contacts: Contacts<'a>,
        settings: &Settings,
        seed: Seed,
    ) -> Self {
        Self {
            problem,
            world,
            map,
            contacts,
            rng: seed.stream("grounding"),
            handoff_tries: settings.handoff_tries,
            fresh: settings.fresh_transitions,
            barren: BTreeMap::new(),
        }
    }

    /// Grounds the guide's immediate actions from `vertex`; with `anew` chains that are already
    /// planned may be planned again.
    pub(super) fn ground(
        &mut self,
        vertex: &Vertex,
        guide: &Guide,
        anew: bool,
    ) -> Result<Grounding, GroundingFailure> {
        let now: Vec<Config> = vertex.arms.iter().map(|arm| after_departure(arm).clone()).collect();
        let mut chains = vertex.chains.clone();
        let mut goals: Vec<Option<ArmGoal>> = vec![None; vertex.arms.len()];
        let mut grounding = Grounding {
            task: StepTask { arms: Vec::new(), scene: scene(vertex) },
            actions: Vec::new(),
            departures: BTreeMap::new(),
            waits: BTreeMap::new(),
            objects: vertex.objects.clone(),
            chains: BTreeMap::new(),
            landed: BTreeMap::new(),
        };
        for action in &guide.immediate {
            let chain = self
                .chain(vertex, guide, action.object, &now, anew, &mut chains)
                .ok_or(GroundingFailure::NoChain(*action))?;
            self.ground_action(vertex, action, &chain, &now, &mut goals, &mut grounding)
                .ok_or(GroundingFailure::NoContact(*action))?;
        }
        for action in &guide.heuristic {
            let Some(arm) = self.map.arm(action.arm) else { continue };
            if goals[arm.0].is_none() && action.step > 1 {
                goals[arm.0] =
                    self.ahead(vertex, guide, arm, &action.action, &now, &mut chains).map(ArmGoal::Toward);
            }
        }
        let arms = vertex.arms.iter().enumerate().map(|(index, arm)| ArmTask {
            start: arm.q.clone(),
            held: held_by(vertex, ArmId(index)),
            departure: arm.departure.clone(),
            wait_for: arm.wait_for,
            dwell: arm.dwell,
            goal: goals[index].take().unwrap_or_else(|| self.at_leisure(index)),
        });
        grounding.task.arms = arms.collect();
        for (object, kind) in &grounding.actions {
            match kind {
                ActionKind::Place { .. } => {
                    chains.remove(&object.0);
                }
                ActionKind::Handoff { .. } => {
                    if let Some(chain) = chains.get_mut(&object.0) {
                        chain.carriers.remove(0);
                        chain.handoffs.remove(0);
                    }
                }
                ActionKind::Pick { .. } => {}
            }
        }
        grounding.chains = chains;
        Ok(grounding)
    }

    /// Where an arm goes that has nothing more to do.
    fn at_leisure(&self, arm: usize) -> ArmGoal {
        match self.problem.options.objective {
            crate::problem::Objective::ArcLength => ArmGoal::Anywhere,
            _ => ArmGoal::Toward(self.problem.workcell.arms[arm].home.clone()),
        }
    }

    /// The chain of `object` along the guide's solution: the one that is known, or a fresh one.
    fn chain(
        &mut self,
        vertex: &Vertex,
        guide: &Guide,
        object: usize,
        now: &[Config],
        anew: bool,
        chains: &mut BTreeMap<usize, Chain>,
    ) -> Option<Chain> {
        let route: Vec<NodeId> = route(guide, object);
        let mut arms: Vec<ArmId> = Vec::new();
        if let Whereabouts::Held { arm, .. } = vertex.objects[object] {
            arms.push(arm);
        }
        let mut end = None;
        for node in route {
            match self.map.arm(node) {
                Some(arm) => arms.push(arm),
                None => {
                    end = Some(node);
                    break;
                }
            }
        }
        let end = end?;
        let renew = anew && self.rng.random_bool(0.5);
        if let Some(known) = chains.get(&object)
            && !renew
            && known.carriers.iter().map(|(arm, _)| *arm).eq(arms.iter().copied())
            && (known.node == end || known.wanted == end)
        {
            return Some(known.clone());
        }
        let mut others = scene(vertex);
        others.resting.retain(|(other, _)| other.0 != object);
        // Places promised to others on their way are taken, too.
        for (other, chain) in chains.iter() {
            if *other != object {
                others.resting.push((ObjectId(*other), chain.target.0));
            }
        }
        let last = *arms.last()?;
        let key = (object, arms.clone(), end);
        let failures = self.barren.get(&key).copied().unwrap_or(0);
        let mut ends = Vec::new();
        if failures <= DETOUR_AFTER || self.rng.random_bool(self.fresh) {
            ends.push(end);
        }
        // Where grasps do not fit together all the way, the object is put down on a buffer once,
        // to be taken up in another way.
        let mut detours = self.map.regions_of(object, last);
        detours.retain(|&node| node != end);
        detours.shuffle(&mut self.rng);
        if failures >= DETOUR_AFTER {
            ends.extend(detours);
        }
        for node in ends {
            let mut targets = self.map.placements(object, node);
            if node != end {
                targets.shuffle(&mut self.rng);
                targets.truncate(DETOUR_TARGETS);
                let goals = self.map.placements(object, end);
                targets.retain(|&target| self.leads_on(last, ObjectId(object), target, &goals));
            }
            let request = ChainRequest {
                object: ObjectId(object),
                from: &vertex.objects[object],
                arms: &arms,
                targets: &targets,
                arms_at: now,
                scene: &others,
                node,
                wanted: end,
            };
            let mut planner = ChainPlanner {
                problem: self.problem,
                world: self.world,
                contacts: &mut self.contacts,
                rng: &mut self.rng,
                handoff_tries: self.handoff_tries,
            };
            if let Some(chain) = planner.plan(&request) {
                chains.insert(object, chain.clone());
                return Some(chain);
            }
        }
        *self.barren.entry(key).or_default() += 1;
        None
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
        let taken = self.contacts.holds(&query(ContactKind::Pick, arm, object, from));
        goals.iter().any(|&goal| {
            let put_down = query(ContactKind::Place, arm, object, goal);
            taken.iter().any(|(_, hold)| self.contacts.has(&put_down, hold))
        })
    }

    fn ground_action(
        &mut self,
        vertex: &Vertex,
        action: &Move,
        chain: &Chain,
        now: &[Config],
        goals: &mut [Option<ArmGoal>],
        out: &mut Grounding,
    ) -> Option<()> {
        let object = ObjectId(action.object);
        let around = scene(vertex);
        let touching = Exemption { hand_with: Some(object), held_with: None };
        let (arm, hold) = *chain.carriers.first()?;
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(_)) => {
                let Whereabouts::Resting { pose, surface } = vertex.objects[object.0] else { return None };
                let contact = self.contact(
                    &query(ContactKind::Pick, arm, object, (pose, surface)),
                    &hold,
                    &now[arm.0],
                    &around,
                )?;
                goals[arm.0] = Some(ArmGoal::Contact {
                    q: contact.q.clone(),
                    approach: Some(contact.approach.clone()),
                    exemption: touching,
                    after: None,
                });
                let leaving = Exemption { hand_with: Some(object), held_with: self.carrier(surface) };
                out.departures.insert(arm.0, Departure { line: contact.retreat.clone(), exemption: leaving });
                out.actions.push((object, ActionKind::Pick { arm, object_in_tcp: hold, surface }));
                out.objects[object.0] = Whereabouts::Held { arm, object_in_tcp: hold };
            }
            (Some(_), None) => {
                let (pose, surface) = chain.target;
                let contact = self.contact(
                    &query(ContactKind::Place, arm, object, (pose, surface)),
                    &hold,
                    &now[arm.0],
                    &around,
                )?;
                goals[arm.0] = Some(ArmGoal::Contact {
                    q: contact.q.clone(),
                    approach: Some(contact.approach.clone()),
                    exemption: Exemption { hand_with: None, held_with: self.carrier(surface) },
                    after: None,
                });
                out.departures
                    .insert(arm.0, Departure { line: contact.retreat.clone(), exemption: touching });
                out.actions.push((
                    object,
                    ActionKind::Place { arm, object_in_tcp: hold, object_pose: pose, surface },
                ));
                out.objects[object.0] = Whereabouts::Resting { pose, surface };
                out.landed.insert(object.0, chain.node);
            }
            (Some(_), Some(_)) => {
                let (to_arm, to_hold) = *chain.carriers.get(1)?;
                let meeting: &HandoffContact = chain.handoffs.first()?;
                goals[arm.0] = Some(ArmGoal::Contact {
                    q: meeting.giver_q.clone(),
                    approach: None,
                    exemption: Exemption::default(),
                    after: None,
                });
                goals[to_arm.0] = Some(ArmGoal::Contact {
                    q: meeting.receiver_q.clone(),
                    approach: Some(meeting.receiver_approach.clone()),
                    exemption: touching,
                    after: Some(arm),
                });
                out.departures
                    .insert(arm.0, Departure { line: meeting.giver_retreat.clone(), exemption: touching });
                out.waits.insert(to_arm.0, arm);
                out.actions.push((
                    object,
                    ActionKind::Handoff { arm, to_arm, object_in_tcp: hold, to_object_in_tcp: to_hold },
                ));
                out.objects[object.0] = Whereabouts::Held { arm: to_arm, object_in_tcp: to_hold };
            }
            (None, None) => return None,
        }
        Some(())
    }

    /// A contact: mostly the nearest of those known, sometimes any, sometimes after sampling more.
    fn contact(&mut self, asked: &ContactQuery, hold: &Pose, now: &Config, scene: &Scene) -> Option<Contact> {
        if self.rng.random_bool(self.fresh) {
            self.contacts.more(asked, hold);
        }
        let known: Vec<Contact> = self
            .contacts
            .at(asked, hold)
            .iter()
            .filter(|contact| self.contacts.is_clear(asked, contact, scene))
            .cloned()
            .collect();
        if self.rng.random_bool(0.3) {
            return known.choose(&mut self.rng).cloned();
        }
        let model = &self.problem.workcell.arms[asked.arm.0];
        known
            .iter()
            .min_by(|a, b| travel_time(model, now, &a.q).total_cmp(&travel_time(model, now, &b.q)))
            .cloned()
    }

    /// Where an arm positions itself for a later action of its own.
    fn ahead(
        &mut self,
        vertex: &Vertex,
        guide: &Guide,
        arm: ArmId,
        action: &Move,
        now: &[Config],
        chains: &mut BTreeMap<usize, Chain>,
    ) -> Option<Config> {
        let object = ObjectId(action.object);
        let around = scene(vertex);
        let chain = self.chain(vertex, guide, action.object, now, false, chains)?;
        let position = chain.carriers.iter().position(|(carrier, _)| *carrier == arm)?;
        let (_, hold) = chain.carriers[position];
        let before_contact = |contact: &Contact| contact.approach.waypoints.last().cloned();
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(_)) => {
                let Whereabouts::Resting { pose, surface } = vertex.objects[object.0] else { return None };
                before_contact(&self.contact(
                    &query(ContactKind::Pick, arm, object, (pose, surface)),
                    &hold,
                    &now[arm.0],
                    &around,
                )?)
            }
            (Some(_), None) => before_contact(&self.contact(
                &query(ContactKind::Place, arm, object, chain.target),
                &hold,
                &now[arm.0],
                &around,
            )?),
            (Some(_), Some(_)) => {
                if position > 0 && self.map.arm(action.to) == Some(arm) {
                    chain.handoffs.get(position - 1)?.receiver_approach.waypoints.last().cloned()
                } else {
                    chain.handoffs.get(position).map(|meeting| meeting.giver_q.clone())
                }
            }
            (None, None) => None,
        }
    }

    fn carrier(&self, surface: SurfaceId) -> Option<crate::workcell::ObstacleId> {
        self.problem.workcell.surfaces.get(surface.0).and_then(|s| s.carrier)
    }
}

/// The nodes that the guide's solution leads `object` through, after where it is.
fn route(guide: &Guide, object: usize) -> Vec<NodeId> {
    guide
        .solution
        .steps
        .iter()
        .flatten()
        .filter(|action| action.object == object)
        .map(|action| action.to)
        .collect()
}

/// The objects at rest.
pub(super) fn scene(vertex: &Vertex) -> Scene {
    let resting = vertex.objects.iter().enumerate().filter_map(|(index, object)| match object {
        Whereabouts::Resting { pose, .. } => Some((ObjectId(index), *pose)),
        Whereabouts::Held { .. } => None,
    });
    Scene { resting: resting.collect() }
}

/// What an arm holds.
pub(super) fn held_by(vertex: &Vertex, arm: ArmId) -> Option<Held> {
    vertex.objects.iter().enumerate().find_map(|(index, object)| match object {
        Whereabouts::Held { arm: holder, object_in_tcp } if *holder == arm => {
            Some(Held { object: ObjectId(index), object_in_tcp: *object_in_tcp })
        }
        _ => None,
    })
}

/// Where an arm is once it has left its last contact.
fn after_departure(arm: &super::tree::ArmState) -> &Config {
    arm.departure.as_ref().and_then(|departure| departure.line.waypoints.last()).unwrap_or(&arm.q)
}
