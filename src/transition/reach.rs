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
use super::memory::{Class, HandoffQuestion, Matter, ReachMemory, RestQuestion};

/// Object poses tried before a handoff counts as impossible.
const HANDOFF_TRIES: usize = 400;

/// Object poses tried for one pair of holds before the next pair is.
const HANDOFF_DRAWS: usize = 4;

/// Reach by sampled transitions; what it grounds stays in its [`Contacts`], what it finds out in a
/// [`ReachMemory`].
#[derive(Debug)]
pub struct SampledReach<'a> {
    contacts: Contacts<'a>,
    memory: Arc<ReachMemory>,
    /// By object, its class in the memory.
    classes: Vec<Class>,
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
        let contacts = Contacts::new(problem, world, seed.stream("reach/contacts"));
        // Objects of one class are alike, and digests are not free.
        let mut numbers: std::collections::BTreeMap<usize, Class> = std::collections::BTreeMap::new();
        let classes = problem
            .objects
            .iter()
            .map(|object| *numbers.entry(object.class).or_insert_with(|| memory.class(object)))
            .collect();
        Self { contacts, memory, classes }
    }

    /// The contacts found on the way.
    pub fn into_contacts(self) -> Contacts<'a> {
        self.contacts
    }

    fn remembered(&mut self, question: RestQuestion, find: impl FnOnce(&mut Contacts<'a>) -> bool) -> bool {
        if let Some(answer) = self.memory.rest(&question) {
            return answer;
        }
        let answer = find(&mut self.contacts);
        self.memory.learn_rest(question, answer);
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
        let class = self.classes[object.0];
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
        let question = RestQuestion::new(self.classes[object.0], action, arm, surface, pose, Matter::Any);
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
        let class = self.classes[object.0];
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
        // Always in the same order, so that much of what one question needs was found out for others.
        let rank = |(giving, taking): (&Hold, &Hold)| {
            let arms = [giver.0 as u64, receiver.0 as u64];
            let holds = [giving, taking].into_iter().flat_map(|hold| bits(&hold.object_in_tcp));
            Seed::mixed(arms.into_iter().chain(holds)).0
        };
        let all =
            giver_holds.iter().flat_map(|giving| receiver_holds.iter().map(move |taking| (giving, taking)));
        let mut pairs: Vec<(&Hold, &Hold)> = all
            .filter(|(giving, taking)| {
                self.contacts.hands_fit((giver, &giving.object_in_tcp), (receiver, &taking.object_in_tcp))
            })
            .collect();
        pairs.sort_by_cached_key(|&pair| rank(pair));
        let most = HANDOFF_TRIES / HANDOFF_DRAWS;
        let rounds = (0..).flat_map(|round| pairs.iter().map(move |&pair| (round, pair)));
        let tries = rounds.take(if pairs.is_empty() { 0 } else { most });
        tries.into_iter().find_map(|(round, (giving, taking))| {
            self.meeting((giver, giving), (receiver, taking), object, round)
        })
    }
}

impl SampledReach<'_> {
    /// What a round of draws brings for one pair of holds.
    fn meeting(
        &mut self,
        (giver, giving): (ArmId, &Hold),
        (receiver, taking): (ArmId, &Hold),
        object: ObjectId,
        round: usize,
    ) -> Option<HandoffWitness> {
        let class = self.classes[object.0];
        let question = HandoffQuestion::new(class, (giver, giving), (receiver, taking), round);
        if let Some(known) = question.as_ref().and_then(|question| self.memory.handoff(question)) {
            return known;
        }
        let query = HandoffQuery {
            giver,
            receiver,
            object,
            giver_holds: &[(0, giving.object_in_tcp)],
            receiver_holds: &[(0, taking.object_in_tcp)],
            giver_near: &[],
            receiver_near: &[],
        };
        let found = self.contacts.handoffs(&query, HANDOFF_DRAWS, 1, &mut stream(&query, round));
        let witness = found.into_iter().next().map(|contact| HandoffWitness {
            giver_hold: *giving,
            receiver_hold: *taking,
            giver_q: contact.giver_q,
            receiver_q: contact.receiver_q,
        });
        if let Some(question) = question {
            self.memory.learn_handoff(question, witness.clone());
        }
        witness
    }
}

/// A stream that depends on what is asked alone.
fn stream(query: &HandoffQuery<'_>, round: usize) -> Rng {
    let arms = [query.giver.0 as u64, query.receiver.0 as u64, round as u64];
    let holds = query.giver_holds.iter().chain(query.receiver_holds).flat_map(|(_, hold)| bits(hold));
    Seed::mixed(arms.into_iter().chain(holds)).stream("handoff")
}
