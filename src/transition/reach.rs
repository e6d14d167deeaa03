//! Answers the mode graph's questions by grounding transitions.

use crate::collision::CollisionWorld;
use crate::geometry::Pose;
use crate::mode_graph::{HandoffWitness, Hold, Reach, RestAction};
use crate::problem::Problem;
use crate::run::{Rng, Seed};
use crate::workcell::{ArmId, ObjectId, SurfaceId};

use super::contact::{ContactKind, ContactQuery};
use super::contacts::Contacts;
use super::handoff::HandoffQuery;

/// Object poses tried before a handoff counts as impossible.
const HANDOFF_TRIES: usize = 400;

/// Reach by sampled transitions; what it finds stays in its [`Contacts`].
#[derive(Debug)]
pub struct SampledReach<'a> {
    contacts: Contacts<'a>,
    rng: Rng,
}

impl<'a> SampledReach<'a> {
    /// Nothing asked yet.
    pub fn new(problem: &'a Problem, world: &'a CollisionWorld, seed: Seed) -> Self {
        let contacts = Contacts::new(problem, world, seed.stream("reach/contacts"));
        Self { contacts, rng: seed.stream("reach/handoffs") }
    }

    /// The contacts found on the way.
    pub fn into_contacts(self) -> Contacts<'a> {
        self.contacts
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
        self.contacts.has(&contact_query(action, arm, object, pose, surface), &hold.object_in_tcp)
    }

    fn reaches(
        &mut self,
        action: RestAction,
        arm: ArmId,
        object: ObjectId,
        pose: &Pose,
        surface: SurfaceId,
    ) -> bool {
        self.contacts.any(&contact_query(action, arm, object, pose, surface))
    }

    fn handoff(
        &mut self,
        giver: ArmId,
        receiver: ArmId,
        object: ObjectId,
        giver_holds: &[Hold],
        receiver_holds: &[Hold],
    ) -> Option<HandoffWitness> {
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
        let found = self.contacts.handoffs(&query, HANDOFF_TRIES, 1, &mut self.rng);
        let contact = found.into_iter().next()?;
        let named = |holds: &[Hold], pose: &Pose| {
            let same = |hold: &&Hold| hold.object_in_tcp == *pose;
            holds.iter().find(same).copied().unwrap_or(Hold { grasp: None, object_in_tcp: *pose })
        };
        Some(HandoffWitness {
            giver_hold: named(giver_holds, &contact.giver_hold),
            receiver_hold: named(receiver_holds, &contact.receiver_hold),
            giver_q: contact.giver_q,
            receiver_q: contact.receiver_q,
        })
    }
}
