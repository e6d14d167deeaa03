//! Where several handoffs happen in one step: meetings at which the arms of each are apart from those
//! of the others.

use rand::Rng as _;
use rand::seq::IndexedRandom;

use crate::collision::{Exemption, Held};
use crate::guidance::Move;
use crate::kinematics::Config;
use crate::transition::{HandoffContact, HandoffQuery};
use crate::workcell::{ArmId, ObjectId};

use super::chain::Chain;
use super::ground::{Grounder, GroundingFailure};
use super::outline::Outline;

/// How many meetings of each of two handoffs are looked for: at first, and before the two are said to clash.
const WANTED: [usize; 2] = [6, 24];

/// Pairs of meetings that are apart to choose from.
const CHOICE: usize = 6;

/// A handoff of a step with its meeting.
#[derive(Debug, Clone)]
pub(super) struct Meeting {
    action: Move,
    arms: [ArmId; 2],
    pub(super) contact: HandoffContact,
}

impl Meeting {
    fn new(action: &Move, chain: &Chain) -> Option<Self> {
        let (giver, _) = *chain.carriers.first()?;
        let (receiver, _) = *chain.carriers.get(1)?;
        let contact = chain.handoffs.first()?.clone();
        Some(Self { action: *action, arms: [giver, receiver], contact })
    }

    /// The object that changes hands.
    pub(super) fn object(&self) -> usize {
        self.action.object
    }
}

impl Grounder<'_> {
    /// A meeting for each of the `handoffs` of one step, by the chains of `outline`: the chain's own, or
    /// where the arms of two would touch each other there, others in the same holds.
    pub(super) fn meetings(
        &mut self,
        now: &[Config],
        handoffs: &[Move],
        outline: &Outline,
    ) -> Result<Vec<Meeting>, GroundingFailure> {
        let mut chosen: Vec<Meeting> = Vec::with_capacity(handoffs.len());
        for action in handoffs {
            let chain = outline.chains.get(&action.object).and_then(|chains| chains.first());
            let meeting = chain.and_then(|chain| Meeting::new(action, chain));
            let meeting = meeting.ok_or(GroundingFailure::NoChain(*action))?;
            match chosen.iter().position(|other| !self.are_apart(other, &meeting)) {
                None => chosen.push(meeting),
                Some(index) => {
                    let other = chosen.remove(index);
                    let clash = GroundingFailure::Clash(other.action, meeting.action);
                    let (one, two) = self.apart(now, &other, &meeting, &chosen).ok_or(clash)?;
                    chosen.extend([one, two]);
                }
            }
        }
        Ok(chosen)
    }

    /// Two meetings like `one` and `two` that are apart from each other and from `others`: mostly those
    /// with the least travel.
    fn apart(
        &mut self,
        now: &[Config],
        one: &Meeting,
        two: &Meeting,
        others: &[Meeting],
    ) -> Option<(Meeting, Meeting)> {
        WANTED.into_iter().find_map(|wanted| {
            let firsts = self.alternatives(now, one, others, wanted);
            let seconds = self.alternatives(now, two, others, wanted);
            let mut pairs: Vec<(&Meeting, &Meeting)> =
                firsts.iter().flat_map(|a| seconds.iter().map(move |b| (a, b))).collect();
            let cost = |(a, b): &(&Meeting, &Meeting)| a.contact.cost + b.contact.cost;
            pairs.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
            let found: Vec<_> =
                pairs.into_iter().filter(|(a, b)| self.are_apart(a, b)).take(CHOICE).collect();
            let first = self.rng.random_bool(0.5);
            let (a, b) = if first { found.first() } else { found.choose(&mut self.rng) }?;
            Some(((*a).clone(), (*b).clone()))
        })
    }

    /// Meetings in the same holds as `meeting` that are apart from `others`.
    fn alternatives(
        &mut self,
        now: &[Config],
        meeting: &Meeting,
        others: &[Meeting],
        wanted: usize,
    ) -> Vec<Meeting> {
        let [giver, receiver] = meeting.arms;
        let asked = HandoffQuery {
            giver,
            receiver,
            object: ObjectId(meeting.action.object),
            giver_holds: &[(usize::MAX, meeting.contact.giver_hold)],
            receiver_holds: &[(usize::MAX, meeting.contact.receiver_hold)],
            giver_near: &now[giver.0..=giver.0],
            receiver_near: &now[receiver.0..=receiver.0],
        };
        let tries = self.handoff_tries * wanted / 4;
        let found =
            self.handoffs.many(self.problem, &mut self.contacts, &asked, tries, wanted, &mut self.rng);
        let meetings = found.into_iter().map(|contact| Meeting { contact, ..meeting.clone() });
        meetings.filter(|one| others.iter().all(|other| self.are_apart(one, other))).collect()
    }

    /// Whether no arm of the one touches an arm of the other, at rest at their meetings.
    pub(super) fn are_apart(&self, one: &Meeting, two: &Meeting) -> bool {
        let sides = |meeting: &Meeting| {
            let object = ObjectId(meeting.action.object);
            let held = Held { object, object_in_tcp: meeting.contact.giver_hold };
            let [giver, receiver] = meeting.arms;
            [
                (giver, meeting.contact.giver_q.clone(), Some(held)),
                (receiver, meeting.contact.receiver_q.clone(), None),
            ]
        };
        let none = Exemption::default();
        sides(one).iter().all(|(a, p, holding)| {
            sides(two).iter().all(|(b, q, other)| {
                a != b
                    && self.world.arms_apart((*a, p, holding.as_ref(), none), (*b, q, other.as_ref(), none))
            })
        })
    }
}
