//! Answers the mode graph's questions by grounding transitions.

use std::sync::Arc;

use crate::collision::{CollisionWorld, Scene};
use crate::geometry::Pose;
use crate::kinematics::Config;
use crate::mode_graph::{HandoffWitness, Hold, Reach, RestAction, RestContact};
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::contact::{ContactKind, ContactQuery};
use super::contacts::{Contacts, bits};
use super::handoff::HandoffQuery;
use super::memory::{HandoffQuestion, Matter, ReachMemory, RestQuestion};

/// Draws of a meeting place tried before a handoff counts as impossible.
const HANDOFF_TRIES: usize = 260;

/// Reach by sampled transitions; what it grounds stays in its [`Contacts`], what it finds out in a
/// [`ReachMemory`].
#[derive(Debug)]
pub struct SampledReach<'a> {
    contacts: Contacts<'a>,
}

impl<'a> SampledReach<'a> {
    /// Nothing asked yet; contacts beyond the first ones will depend on `seed`.
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, seed: Seed) -> Self {
        Self::remembering(problem, world, seed, Arc::default())
    }

    /// The same with what is known from other problems with an equal workcell, equal clearance and
    /// an equal number of IK solutions.
    pub fn remembering(
        problem: &'a Problem,
        world: &'a CollisionWorld,
        seed: Seed,
        memory: Arc<ReachMemory>,
    ) -> Self {
        Self { contacts: Contacts::remembering(problem, world, seed.stream("reach/contacts"), memory) }
    }

    /// The contacts found on the way.
    pub fn into_contacts(self) -> Contacts<'a> {
        self.contacts
    }

    fn remembered(&mut self, question: RestQuestion, find: impl FnOnce(&mut Contacts<'a>) -> bool) -> bool {
        if let Some(answer) = self.contacts.memory().rest(&question) {
            return answer;
        }
        let answer = find(&mut self.contacts);
        self.contacts.memory().learn_rest(question, answer);
        answer
    }
}

fn contact_query(
    action: RestAction,
    arm: ArmId,
    object: ObjectId,
    pose: &Pose,
    surface: SurfaceId,
) -> ContactQuery {
    let kind = match action {
        RestAction::Pick => ContactKind::Pick,
        RestAction::Place => ContactKind::Place,
    };
    ContactQuery { kind, arm, object, pose: *pose, surface }
}

impl Reach for SampledReach<'_> {
    fn possible_holds(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> Vec<Hold> {
        self.contacts
            .possible_holds(&contact_query(action, arm, object, pose, surface))
            .into_iter()
            .map(|(grasp, object_in_tcp)| Hold { grasp: Some(grasp), object_in_tcp })
            .collect()
    }

    fn has_hold(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
        hold: &Hold,
    ) -> bool {
        let query = contact_query(action, arm, object, pose, surface);
        let find = |contacts: &mut Contacts<'_>| contacts.has(&query, &hold.object_in_tcp);
        let Some(grasp) = hold.grasp else { return find(&mut self.contacts) };
        let class = self.contacts.class(object);
        self.remembered(RestQuestion::new(class, action, arm, surface, pose, Matter::Grasp(grasp)), find)
    }

    fn reaches(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> bool {
        let query = contact_query(action, arm, object, pose, surface);
        let question =
            RestQuestion::new(self.contacts.class(object), action, arm, surface, pose, Matter::Any);
        self.remembered(question, |contacts| contacts.any(&query))
    }

    fn seems_to_reach(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> bool {
        let query = contact_query(action, arm, object, pose, surface);
        let class = self.contacts.class(object);
        let question = RestQuestion::new(class, action, arm, surface, pose, Matter::Estimate);
        self.remembered(question, |contacts| contacts.seems_possible(&query))
    }

    fn contact(&mut self, contact: &RestContact) -> Option<(Hold, Config)> {
        let RestContact { action, arm, object, pose, surface } = contact;
        let query = contact_query(*action, *arm, *object, pose, *surface);
        let holds = self.possible_holds(*action, *arm, *object, pose, *surface);
        holds.into_iter().find_map(|hold| {
            let found = self.contacts.nth(&query, &hold.object_in_tcp, 0)?;
            Some((hold, found.q))
        })
    }

    fn is_clear(&mut self, contact: &RestContact, hold: &Hold, other: ObjectId, pose: &Pose) -> bool {
        let RestContact { action, arm, object, pose: at, surface } = contact;
        let query = contact_query(*action, *arm, *object, at, *surface);
        self.contacts.is_clear_of(&query, &hold.object_in_tcp, &Scene { resting: vec![(other, *pose)] })
    }

    fn handoff(
        &mut self,
        giver: ArmId,
        receiver: ArmId,
        object: ObjectId,
        giver_holds: &[Hold],
        receiver_holds: &[Hold],
    ) -> Option<HandoffWitness> {
        let class = self.contacts.class(object);
        let question = HandoffQuestion::new(class, (giver, giver_holds), (receiver, receiver_holds));
        if let Some(known) = question.as_ref().and_then(|question| self.contacts.memory().handoff(question)) {
            if let Some(witness) = &known {
                self.contacts.witness((giver, receiver), object, witness);
            }
            return known;
        }
        let holds = |holds: &[Hold]| -> Vec<(usize, Pose)> {
            holds.iter().enumerate().map(|(index, hold)| (index, hold.object_in_tcp)).collect()
        };
        let (giving, taking) = (holds(giver_holds), holds(receiver_holds));
        let query = HandoffQuery {
            giver,
            receiver,
            object,
            giver_holds: &giving,
            receiver_holds: &taking,
            giver_near: &[],
            receiver_near: &[],
        };
        let found = self.contacts.first_handoffs(&query, HANDOFF_TRIES, 1, &mut stream(&query));
        let named = |holds: &[Hold], pose: &Pose| {
            let same = |hold: &&Hold| hold.object_in_tcp == *pose;
            holds.iter().find(same).copied().unwrap_or(Hold { grasp: None, object_in_tcp: *pose })
        };
        let witness = found.into_iter().next().map(|contact| HandoffWitness {
            giver_hold: named(giver_holds, &contact.giver_hold),
            receiver_hold: named(receiver_holds, &contact.receiver_hold),
            giver_q: contact.giver_q,
            receiver_q: contact.receiver_q,
        });
        if let Some(witness) = &witness {
            self.contacts.witness((giver, receiver), object, witness);
        }
        if let Some(question) = question {
            self.contacts.memory().learn_handoff(question, witness.clone());
        }
        witness
    }
}

/// A stream that depends on what is asked alone.
fn stream(query: &HandoffQuery<'_>) -> Rng {
    let arms = [query.giver.0 as u64, query.receiver.0 as u64, query.giver_holds.len() as u64];
    let holds = query.giver_holds.iter().chain(query.receiver_holds).flat_map(|(_, hold)| bits(hold));
    Seed::mixed(arms.into_iter().chain(holds)).stream("handoff")
}
