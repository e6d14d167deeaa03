//! `sample_trans`: grounds the actions of a step, and the ways in which idle arms position
//! themselves ahead.

use std::collections::BTreeMap;

use rand::Rng as _;
use rand::seq::{IndexedRandom, SliceRandom};

use crate::collision::{CollisionWorld, Exemption, Held, Scene};
use crate::geometry::Pose;
use crate::guidance::{ArmAction, Guide, Move, NodeId};
use crate::kinematics::Config;
use crate::motion::{ArmGoal, ArmTask, Departure, StepTask};
use crate::plan::ActionKind;
use crate::problem::Problem;
use crate::run::{Control, Rng, Seed};
use crate::transition::{
    Contact, ContactKind, ContactQuery, Contacts, HandoffContact, HandoffQuery, travel_time,
};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::chain::{Chain, Chains, query};
use super::forecast::{Neighbour, scene_of};
use super::handoffs::{HandoffPool, WANTED};
use super::map::Map;
use super::outline::Outline;
use super::rests::Rests;
use super::settings::Settings;
use super::tree::{Vertex, Whereabouts};

/// Why a step could not be grounded.
#[derive(Debug, Clone)]
pub(super) enum GroundingFailure {
    /// No grasps fit together for this move.
    NoChain(Move),
    /// The next contact cannot be had with the hold that the object is in; others may be in its
    /// way.
    NoContact(Move, Vec<Neighbour>),
    /// No meetings were found at which the arms of these two handoffs are apart.
    Clash(Move, Move),
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
    pub(super) chains: Chains,
    /// The nodes at which objects were put down, which may be others than the guide's.
    pub(super) landed: BTreeMap<usize, NodeId>,
    /// Two arms that touch each other at the end of the step.
    pub(super) crowd: Option<(ArmId, ArmId)>,
}

/// Other choices of contacts that are tried for a step in which arms would touch each other at its end.
const CONTACT_TRIALS: usize = 7;

/// The contacts that a step ends with as far as they are chosen, and what an arm does whose own is
/// being chosen.
struct Ends<'a> {
    vertex: &'a Vertex,
    goals: &'a [Option<ArmGoal>],
    held: Option<Held>,
    exemption: Exemption,
}

/// Samples transitions.
#[derive(Debug)]
pub(super) struct Grounder<'a> {
    pub(super) problem: &'a Problem,
    pub(super) world: &'a CollisionWorld,
    pub(super) map: &'a Map,
    pub(super) contacts: Contacts<'a>,
    pub(super) handoffs: HandoffPool,
    pub(super) rests: Rests,
    pub(super) rng: Rng,
    pub(super) handoff_tries: usize,
    pub(super) fresh: f64,
    pub(super) control: Control,
    /// Whether arms without an action stay where they are: they neither position themselves ahead nor go home.
    pub(super) stays_put: bool,
    /// Whether what is good enough for a first plan will do.
    pub(super) is_hasty: bool,
    /// How often no grasps fitted together for an object along a sequence of arms to a node, and how often
    /// something was in the way of the leg that was to follow.
    pub(super) barren: BTreeMap<(usize, Vec<ArmId>, NodeId), u32>,
    pub(super) hindered: BTreeMap<(usize, Vec<ArmId>, NodeId), u32>,
}

impl<'a> Grounder<'a> {
    pub(super) fn new(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        map: &'a Map,
        mut contacts: Contacts<'a>,
        settings: &Settings,
        seed: Seed,
        control: &Control,
    ) -> Self {
        contacts.heed(control);
        Self {
            problem,
            world,
            map,
            contacts,
            handoffs: HandoffPool::default(),
            rests: Rests::of(problem, map),
            rng: seed.stream("grounding"),
            handoff_tries: settings.handoff_tries,
            fresh: settings.fresh_transitions,
            control: control.clone(),
            stays_put: false,
            is_hasty: false,
            barren: BTreeMap::new(),
            hindered: BTreeMap::new(),
        }
    }

    /// Grounds the guide's immediate actions from `vertex` by the chains of `outline`, where possible so that
    /// the arms are apart from each other at the end of the step.
    pub(super) fn ground(
        &mut self,
        vertex: &Vertex,
        guide: &Guide,
        outline: &Outline,
    ) -> Result<Grounding, GroundingFailure> {
        let now: Vec<Config> = vertex.arms.iter().map(|arm| after_departure(arm).clone()).collect();
        let (mut grounding, mut goals) = self.ground_actions((vertex, &now), guide, outline, false)?;
        for _ in 0..CONTACT_TRIALS {
            if grounding.crowd.is_none() {
                break;
            }
            if let Ok((other, ends)) = self.ground_actions((vertex, &now), guide, outline, true)
                && other.crowd.is_none()
            {
                (grounding, goals) = (other, ends);
            }
        }
        for action in &guide.heuristic {
            let Some(arm) = self.map.arm(action.arm) else { continue };
            if goals[arm.0].is_none() && action.step > 1 && !self.stays_put {
                let ahead = self.ahead(vertex, outline, arm, action, &now);
                goals[arm.0] = ahead.map(ArmGoal::Toward);
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
            let Some(chains) = grounding.chains.get_mut(&object.0) else { continue };
            let Some(chain) = chains.first_mut() else { continue };
            match kind {
                ActionKind::Place { .. } => {
                    let astray = chain.node != chain.wanted;
                    chains.remove(0);
                    if astray || chains.is_empty() {
                        grounding.chains.remove(&object.0);
                    }
                }
                ActionKind::Handoff { .. } => {
                    chain.carriers.remove(0);
                    chain.handoffs.remove(0);
                }
                ActionKind::Pick { .. } => {}
            }
        }
        Ok(grounding)
    }

    /// Contacts for the guide's immediate actions; `anew` in another order and mostly others than the
    /// nearest that are known.
    fn ground_actions(
        &mut self,
        (vertex, now): (&Vertex, &[Config]),
        guide: &Guide,
        outline: &Outline,
        anew: bool,
    ) -> Result<(Grounding, Vec<Option<ArmGoal>>), GroundingFailure> {
        let mut goals: Vec<Option<ArmGoal>> = vec![None; vertex.arms.len()];
        let mut grounding = Grounding {
            task: StepTask { arms: Vec::new(), scene: scene(vertex) },
            actions: Vec::new(),
            departures: BTreeMap::new(),
            waits: BTreeMap::new(),
            objects: vertex.objects.clone(),
            chains: outline.chains.clone(),
            landed: BTreeMap::new(),
            crowd: None,
        };
        // Handoffs choose first, and the others choose their contacts apart from them.
        let (handoffs, mut others): (Vec<Move>, Vec<Move>) =
            guide.immediate.iter().partition(|action| self.map.is_handoff(action));
        if anew {
            others.shuffle(&mut self.rng);
        }
        let meetings = self.meetings(now, &handoffs, outline)?;
        for action in handoffs.iter().chain(&others) {
            let chain = outline.chains.get(&action.object).and_then(|chains| chains.first());
            let chain = chain.ok_or(GroundingFailure::NoChain(*action))?;
            let near = self.around(vertex, outline, action.object, 1);
            let meeting = meetings.iter().find(|meeting| meeting.object() == action.object);
            let meeting = meeting.map(|meeting| &meeting.contact);
            let at = (vertex, now);
            self.ground_action(at, (action, meeting), chain, &near, anew, &mut goals, &mut grounding)
                .map_err(|by| GroundingFailure::NoContact(*action, by))?;
        }
        Ok((grounding, goals))
    }

    /// Where an arm goes that has nothing more to do.
    fn at_leisure(&self, arm: usize) -> ArmGoal {
        match self.problem.options.objective {
            crate::problem::Objective::ArcLength => ArmGoal::Anywhere,
            _ if self.stays_put => ArmGoal::Anywhere,
            _ => ArmGoal::Toward(self.problem.workcell.arms[arm].home.clone()),
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn ground_action(
        &mut self,
        (vertex, now): (&Vertex, &[Config]),
        (action, meeting): (&Move, Option<&HandoffContact>),
        chain: &Chain,
        near: &[Neighbour],
        anew: bool,
        goals: &mut Vec<Option<ArmGoal>>,
        out: &mut Grounding,
    ) -> Result<(), Vec<Neighbour>> {
        let object = ObjectId(action.object);
        let touching = Exemption { hand_with: Some(object), held_with: None };
        let nobody = Vec::new;
        let (arm, hold) = *chain.carriers.first().ok_or_else(nobody)?;
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(_)) => {
                let Whereabouts::Resting { pose, surface } = vertex.objects[object.0] else {
                    return Err(nobody());
                };
                let pick = query(ContactKind::Pick, arm, object, (pose, surface));
                let ends = Ends { vertex, goals, held: None, exemption: touching };
                let contact = self.contact(&pick, &hold, &now[arm.0], near, Some((&ends, anew)))?;
                out.crowd =
                    out.crowd.or_else(|| self.touched(arm, &contact.q, &ends).map(|other| (other, arm)));
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
                let place = query(ContactKind::Place, arm, object, (pose, surface));
                let exemption = Exemption { hand_with: None, held_with: self.carrier(surface) };
                let held = Some(Held { object, object_in_tcp: hold });
                let ends = Ends { vertex, goals, held, exemption };
                let contact = self.contact(&place, &hold, &now[arm.0], near, Some((&ends, anew)))?;
                out.crowd =
                    out.crowd.or_else(|| self.touched(arm, &contact.q, &ends).map(|other| (other, arm)));
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
                let (to_arm, to_hold) = *chain.carriers.get(1).ok_or_else(nobody)?;
                let meeting = meeting.ok_or_else(nobody)?;
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
            (None, None) => return Err(nobody()),
        }
        Ok(())
    }

    /// A contact: mostly the nearest of those known, sometimes any, sometimes after sampling more,
    /// and where possible apart from the `ends` of the step that are chosen already; or what is in
    /// the way of all. With the ends comes whether others than the nearest are asked for.
    fn contact(
        &mut self,
        asked: &ContactQuery,
        hold: &Pose,
        now: &Config,
        near: &[Neighbour],
        ends: Option<(&Ends<'_>, bool)>,
    ) -> Result<Contact, Vec<Neighbour>> {
        let anew = ends.is_some_and(|(_, anew)| anew);
        if self.rng.random_bool(if anew { 0.5 } else { self.fresh }) {
            self.contacts.more(asked, hold);
        }
        let known = self.contacts.at(asked, hold);
        let mut order: Vec<&Contact> = known.iter().collect();
        if self.rng.random_bool(if anew { 0.8 } else { 0.3 }) {
            order.shuffle(&mut self.rng);
        } else {
            let model = &self.problem.workcell.arms[asked.arm.0];
            let away = |contact: &Contact| travel_time(model, now, &contact.q);
            order.sort_by(|a, b| away(a).total_cmp(&away(b)));
        }
        let scene = scene_of(near);
        let mut clear = None;
        for contact in order {
            if !self.contacts.is_clear(asked, contact, &scene) {
                continue;
            }
            if ends.is_none_or(|(ends, _)| self.touched(asked.arm, &contact.q, ends).is_none()) {
                return Ok(contact.clone());
            }
            clear.get_or_insert(contact);
        }
        match clear {
            Some(contact) => Ok(contact.clone()),
            None => Err(self.planner().blockers(asked, hold, near)),
        }
    }

    /// Another contact for a pick or a place from `vertex`, clear of the objects at rest there.
    pub(super) fn another_contact(
        &mut self,
        vertex: &Vertex,
        object: ObjectId,
        action: &ActionKind,
    ) -> Option<(ArmId, Contact)> {
        let (asked, hold) = match *action {
            ActionKind::Pick { arm, object_in_tcp, surface } => {
                let Whereabouts::Resting { pose, .. } = vertex.objects[object.0] else { return None };
                (query(ContactKind::Pick, arm, object, (pose, surface)), object_in_tcp)
            }
            ActionKind::Place { arm, object_in_tcp, object_pose, surface } => {
                (query(ContactKind::Place, arm, object, (object_pose, surface)), object_in_tcp)
            }
            ActionKind::Handoff { .. } => return None,
        };
        if self.rng.random_bool(self.fresh) {
            self.contacts.more(&asked, &hold);
        }
        let known = self.contacts.at(&asked, &hold);
        let chosen = known.choose(&mut self.rng)?;
        self.contacts.is_clear(&asked, chosen, &scene(vertex)).then(|| (asked.arm, chosen.clone()))
    }

    /// Another meeting of the arms with the same holds, mostly one of the nearest.
    pub(super) fn another_meeting(
        &mut self,
        object: ObjectId,
        [giver, receiver]: [ArmId; 2],
        [giver_hold, receiver_hold]: [Pose; 2],
        [giver_at, receiver_at]: &[Config; 2],
    ) -> Option<HandoffContact> {
        let asked = HandoffQuery {
            giver,
            receiver,
            object,
            giver_holds: &[(usize::MAX, giver_hold)],
            receiver_holds: &[(usize::MAX, receiver_hold)],
            giver_near: std::slice::from_ref(giver_at),
            receiver_near: std::slice::from_ref(receiver_at),
        };
        let anew = self.rng.random_bool(self.fresh);
        let (limits, rng) = ((self.handoff_tries, WANTED), &mut self.rng);
        let found = self.handoffs.find(self.problem, &mut self.contacts, &asked, limits, anew, rng);
        let nearest = found.len().min(6);
        found[..nearest].choose(&mut self.rng).cloned()
    }

    /// The first of the other arms that have a contact in this step which `arm` at its own touches there.
    fn touched(&self, arm: ArmId, q: &Config, ends: &Ends<'_>) -> Option<ArmId> {
        let touches = |(other, goal): (usize, &Option<ArmGoal>)| {
            let Some(ArmGoal::Contact { q: at, exemption, .. }) = goal else { return None };
            let held = held_by(ends.vertex, ArmId(other));
            let apart = self.world.arms_apart(
                (arm, q, ends.held.as_ref(), ends.exemption),
                (ArmId(other), at, held.as_ref(), *exemption),
            );
            (!apart).then_some(ArmId(other))
        };
        ends.goals.iter().enumerate().find_map(touches)
    }

    /// Where an arm positions itself for a later action of its own.
    fn ahead(
        &mut self,
        vertex: &Vertex,
        outline: &Outline,
        arm: ArmId,
        first: &ArmAction,
        now: &[Config],
    ) -> Option<Config> {
        let action = &first.action;
        let object = ObjectId(action.object);
        let (number, _) = outline.leg_of(action, first.step)?;
        let chains = outline.chains.get(&action.object)?;
        let chain = chains.get(number)?;
        let position = chain.carriers.iter().position(|(carrier, _)| *carrier == arm)?;
        let (_, hold) = chain.carriers[position];
        let near = self.around(vertex, outline, action.object, first.step);
        let before_contact = |contact: Contact| contact.approach.waypoints.last().cloned();
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(_)) => {
                let from = match number.checked_sub(1).and_then(|before| chains.get(before)) {
                    Some(before) => before.target,
                    None => match &vertex.objects[object.0] {
                        Whereabouts::Resting { pose, surface } => (*pose, *surface),
                        Whereabouts::Held { .. } => return None,
                    },
                };
                let pick = query(ContactKind::Pick, arm, object, from);
                before_contact(self.contact(&pick, &hold, &now[arm.0], &near, None).ok()?)
            }
            (Some(_), None) => {
                let place = query(ContactKind::Place, arm, object, chain.target);
                before_contact(self.contact(&place, &hold, &now[arm.0], &near, None).ok()?)
            }
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
pub(super) fn after_departure(arm: &super::tree::ArmState) -> &Config {
    arm.departure.as_ref().and_then(|departure| departure.line.waypoints.last()).unwrap_or(&arm.q)
}
