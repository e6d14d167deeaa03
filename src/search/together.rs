//! What arms do at the end of the same step, seen ahead: an outline's grasps are chosen so that the arms can be
//! apart there.

use crate::collision::{Exemption, Held};
use crate::guidance::Move;
use crate::kinematics::Config;
use crate::transition::{ContactKind, ContactQuery};
use crate::workcell::{ArmId, ObjectId};

use super::chain::{Chain, query};
use super::ground::Grounder;
use super::leg::Leg;
use super::outline::Outline;
use super::tree::{Vertex, Whereabouts};

/// Steps that are looked into ahead.
const STEPS_AHEAD: usize = 3;

/// An arm where it acts, with what it holds until then.
pub(super) type End = (ArmId, Config, Option<Held>, Exemption);

/// One action of a chain, and where its arms may be for it: one of the first, and all of the second.
struct Together {
    action: Move,
    any: Vec<End>,
    all: Vec<End>,
}

impl Grounder<'_> {
    /// An action of `leg` by `chain` and another of the same step for which the arms would touch each other however
    /// they bend, with the number of the other's leg.
    pub(super) fn meets_another(
        &mut self,
        vertex: &Vertex,
        outline: &Outline,
        leg: &Leg,
        chain: &Chain,
    ) -> Option<(Move, Move, usize)> {
        let number = outline.chains.get(&leg.object).map_or(0, Vec::len);
        for &(step, action) in leg.moves.iter().filter(|(step, _)| *step <= STEPS_AHEAD) {
            let mut own = None;
            for index in 0..outline.legs.len() {
                let other = &outline.legs[index];
                let Some(&(_, second)) = other.moves.iter().find(|(at, _)| *at == step) else { continue };
                if other.object == leg.object || self.is_handoff(&action) && self.is_handoff(&second) {
                    continue;
                }
                let mine = outline.legs[..index].iter().filter(|before| before.object == other.object);
                let place = mine.count();
                let Some(with) = outline.chains.get(&other.object).and_then(|all| all.get(place)).cloned()
                else {
                    continue;
                };
                let own = match &mut own {
                    Some(own) => own,
                    empty => match self.ends(vertex, outline, (leg, number), chain, &action) {
                        Some(ends) => empty.insert(ends),
                        None => break,
                    },
                };
                let Some(theirs) = self.ends(vertex, outline, (other, place), &with, &second) else {
                    continue;
                };
                if !self.go_together(own, &theirs) {
                    return Some((own.action, theirs.action, index));
                }
            }
        }
        None
    }

    fn is_handoff(&self, action: &Move) -> bool {
        self.map.arm(action.from).is_some() && self.map.arm(action.to).is_some()
    }

    /// Whether there are ends of both that are apart.
    fn go_together(&self, one: &Together, two: &Together) -> bool {
        let apart = |a: &End, b: &End| self.ends_apart(a, b);
        let fixed =
            |one: &Together, two: &Together| one.all.iter().all(|a| two.all.iter().all(|b| apart(a, b)));
        let free = |one: &Together, two: &Together| {
            one.any.is_empty() || one.any.iter().any(|a| two.all.iter().all(|b| apart(a, b)))
        };
        match (one.any.is_empty(), two.any.is_empty()) {
            (false, false) => one.any.iter().any(|a| two.any.iter().any(|b| apart(a, b))),
            (_, true) => fixed(one, two) && free(one, two),
            (true, false) => free(two, one),
        }
    }

    /// Whether two arms are apart.
    pub(super) fn ends_apart(&self, one: &End, two: &End) -> bool {
        let [(arm, q, held, exemption), (other, p, holding, exempt)] = [one, two];
        arm != other
            && self
                .world
                .arms_apart((*arm, q, held.as_ref(), *exemption), (*other, p, holding.as_ref(), *exempt))
    }

    /// Where the arms of `action` may be, which belongs to the `number`th leg of its object.
    fn ends(
        &mut self,
        vertex: &Vertex,
        outline: &Outline,
        (leg, number): (&Leg, usize),
        chain: &Chain,
        action: &Move,
    ) -> Option<Together> {
        let object = ObjectId(leg.object);
        let (mut any, mut all) = (Vec::new(), Vec::new());
        match (self.map.arm(action.from), self.map.arm(action.to)) {
            (None, Some(arm)) => {
                let before = number.checked_sub(1).and_then(|n| outline.chains.get(&leg.object)?.get(n));
                let at = match (before, &vertex.objects[leg.object]) {
                    (Some(before), _) => before.target,
                    (None, Whereabouts::Resting { pose, surface }) => (*pose, *surface),
                    (None, Whereabouts::Held { .. }) => return None,
                };
                let (_, hold) = *chain.carriers.first()?;
                any = self.contact_ends(&query(ContactKind::Pick, arm, object, at), &hold);
            }
            (Some(arm), None) => {
                let (_, hold) = *chain.carriers.last()?;
                any = self.contact_ends(&query(ContactKind::Place, arm, object, chain.target), &hold);
            }
            (Some(giver), Some(receiver)) => {
                let hop =
                    chain.carriers.windows(2).position(|pair| (pair[0].0, pair[1].0) == (giver, receiver))?;
                let meeting = chain.handoffs.get(hop)?;
                let held = Held { object, object_in_tcp: meeting.giver_hold };
                let touching = Exemption { hand_with: Some(object), held_with: None };
                all = vec![
                    (giver, meeting.giver_q.clone(), Some(held), Exemption::default()),
                    (receiver, meeting.receiver_q.clone(), None, touching),
                ];
            }
            (None, None) => {}
        }
        (!any.is_empty() || !all.is_empty()).then_some(Together { action: *action, any, all })
    }

    /// The contacts of a pick or a place in `hold`.
    pub(super) fn contact_ends(&mut self, asked: &ContactQuery, hold: &crate::geometry::Pose) -> Vec<End> {
        let object = asked.object;
        let (held, exemption) = match asked.kind {
            ContactKind::Pick => (None, Exemption { hand_with: Some(object), held_with: None }),
            ContactKind::Place => (
                Some(Held { object, object_in_tcp: *hold }),
                Exemption { hand_with: None, held_with: self.carrier(asked.surface) },
            ),
        };
        let contacts = self.contacts.at(asked, hold);
        contacts.iter().map(|contact| (asked.arm, contact.q.clone(), held, exemption)).collect()
    }
}
