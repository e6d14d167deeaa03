//! Two ends of carries that leave each other no room.
//!
//! Single edges of the mode graph say that an arm can pick and another place; a carry, that this goes
//! together by some handoff. In which holds follows from the handoff alone, and where two carries have an end
//! in one step, all contacts in the holds of the one may touch all those of the other. This is looked into
//! where a plan from the start has such ends in one step and the contacts of its chains touch: all pairs of
//! holds in which some contacts are apart are listed, and for each it is asked whether both carries can
//! be done in them, with more samples than the mode graph takes for its handoffs. Where no pair is left the
//! two become a [`ModeGraph::crowdings`](crate::mode_graph::ModeGraph::crowdings) of the graph: like its missing
//! edges they rest on samples, and its optimum is that of a graph without them.

use crate::collision::{Exemption, Held};
use crate::geometry::Pose;
use crate::mode_graph::{CarryEnd, RestAction};
use crate::problem::{GoalPlacement, GuidanceKind, InitialPlacement};
use crate::run::{Control, Rng};
use crate::transition::{Contact, ContactKind, ContactQuery, HandoffQuery};
use crate::workcell::{ArmId, ObjectId, Symmetry};

use super::chain::{Chain, query};
use super::leg::Leg;
use super::smart::Search;

/// Random object poses tried before a carry counts as impossible in one hold at its end.
const HANDOFF_TRIES: usize = 100;

/// Further samplings of contacts in a hold before they count as all in each other's way.
const SAMPLINGS: usize = 6;

/// One end of a straight carry in the plan.
struct End {
    carry: CarryEnd,
    step: usize,
    arm: ArmId,
    /// What is asked of the arm: one question per pose that meets the goal.
    asked: Vec<ContactQuery>,
    /// The same of the arm at the other end.
    opposite: Vec<ContactQuery>,
    /// The hold that was chosen, and for which question.
    chosen: (ContactQuery, Pose),
}

/// A hold at an end.
struct Choice {
    asked: ContactQuery,
    hold: Pose,
    contacts: Vec<Contact>,
    /// Whether the carry can be done in it, once that was asked.
    leads: Option<bool>,
}

impl Search<'_> {
    /// The first two actions in one step of the way from the start that were not found to go together, in
    /// any holds in which both objects can be carried straight to their goals. Looked for where the guidance is for all
    /// objects at once and they are few. The way is kept for the first iteration.
    pub fn crowding(&mut self, control: &Control) -> Option<[CarryEnd; 2]> {
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        if !is_smart || !self.has_few_objects() || self.tree[0].is_goal {
            return None;
        }
        let (guide, outline) = self.advise(0, control)?;
        let mut ends: Vec<End> = Vec::new();
        for leg in &outline.legs {
            let legs = outline.legs.iter().filter(|other| other.object == leg.object).count();
            if let Some([chain]) = outline.chains.get(&leg.object).map(Vec::as_slice)
                && legs == 1
            {
                ends.extend(self.ends(leg, chain));
            }
        }
        self.prepared = Some((guide, outline));
        let mut rng = self.seed.stream("crowding");
        for (index, one) in ends.iter().enumerate() {
            for two in ends[..index].iter().filter(|two| two.step == one.step && two.arm != one.arm) {
                if control.should_stop() {
                    return None;
                }
                if !self.is_room(one, two, &mut rng, control) {
                    return Some([two.carry.clone(), one.carry.clone()]);
                }
            }
        }
        None
    }

    /// The ends of a leg that is a straight carry from the object's start to its goal pose.
    fn ends(&self, leg: &Leg, chain: &Chain) -> Vec<End> {
        let object = ObjectId(leg.object);
        let symmetry = &self.problem.objects[object.0].symmetry;
        // A goal that stands for infinitely many poses is left alone.
        let is_endless = matches!(symmetry, Symmetry::CylinderZ | Symmetry::Sphere);
        let (InitialPlacement::Resting { pose, surface }, GoalPlacement::Pose { .. }, [first, ..]) =
            (&self.problem.initial[object.0], &self.problem.goal[object.0], &leg.arms[..])
        else {
            return Vec::new();
        };
        let last = leg.arms.last().unwrap_or(first);
        if is_endless || leg.arms.len() > 2 || chain.node != chain.wanted || leg.begins() == 0 {
            return Vec::new();
        }
        let (Some((_, taken)), Some((_, put))) = (chain.carriers.first(), chain.carriers.last()) else {
            return Vec::new();
        };
        let pick = query(ContactKind::Pick, *first, object, (*pose, *surface));
        let goals = self.map.placements(object.0, chain.node).into_iter();
        let places: Vec<ContactQuery> =
            goals.map(|goal| query(ContactKind::Place, *last, object, goal)).collect();
        let end = |action, step, arm: ArmId, asked, opposite, chosen| {
            let carry = CarryEnd { object, action, carriers: leg.arms.clone() };
            End { carry, step, arm, asked, opposite, chosen }
        };
        let placed = (query(ContactKind::Place, *last, object, chain.target), *put);
        vec![
            end(RestAction::Pick, leg.begins(), *first, vec![pick], places.clone(), (pick, *taken)),
            end(RestAction::Place, leg.ends(), *last, places, vec![pick], placed),
        ]
    }

    /// Whether some contacts at the two ends are apart, in holds in which both objects can be carried.
    fn is_room(&mut self, one: &End, two: &End, rng: &mut Rng, control: &Control) -> bool {
        let chosen = [one, two].map(|end| self.grounder.contacts.at(&end.chosen.0, &end.chosen.1));
        if self.some_apart([one, two], [&chosen[0], &chosen[1]]) {
            return true;
        }
        let mut choices = [one, two].map(|end| self.choices(end));
        for is_last in [false, true] {
            if is_last {
                // Perhaps a few contacts are too few to tell.
                for (end, choices) in [one, two].into_iter().zip(&mut choices) {
                    choices.retain_mut(|choice| self.leads(end, choice, rng));
                    choices.iter_mut().for_each(|choice| self.sample_more(choice));
                }
            }
            for i in 0..choices[0].len() {
                for j in 0..choices[1].len() {
                    // When in doubt there is room.
                    if control.should_stop() {
                        return true;
                    }
                    let (a, b) = (&choices[0][i], &choices[1][j]);
                    if a.leads != Some(false)
                        && b.leads != Some(false)
                        && self.some_apart([one, two], [&a.contacts, &b.contacts])
                        && self.leads(one, &mut choices[0][i], rng)
                        && self.leads(two, &mut choices[1][j], rng)
                    {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// The holds in which there is a contact at an end, with the first contacts.
    fn choices(&mut self, end: &End) -> Vec<Choice> {
        let mut choices = Vec::new();
        for asked in &end.asked {
            for (_, hold) in self.grounder.contacts.holds(asked) {
                let contacts = self.grounder.contacts.at(asked, &hold).to_vec();
                choices.push(Choice { asked: *asked, hold, contacts, leads: None });
            }
        }
        choices
    }

    fn sample_more(&mut self, choice: &mut Choice) {
        for _ in 0..SAMPLINGS {
            self.grounder.contacts.more(&choice.asked, &choice.hold);
        }
        choice.contacts = self.grounder.contacts.at(&choice.asked, &choice.hold).to_vec();
    }

    /// Whether the object can be carried in this hold at this end.
    fn leads(&mut self, end: &End, choice: &mut Choice, rng: &mut Rng) -> bool {
        if let Some(known) = choice.leads {
            return known;
        }
        let contacts = &mut self.grounder.contacts;
        let mut opposite: Vec<(usize, Pose)> = Vec::new();
        for asked in &end.opposite {
            for (grasp, hold) in contacts.holds(asked) {
                if !opposite.iter().any(|(_, other)| *other == hold) {
                    opposite.push((grasp, hold));
                }
            }
        }
        let found = match end.carry.carriers[..] {
            [giver, receiver] => {
                let own = [(usize::MAX, choice.hold)];
                let (giving, taking) = match end.carry.action {
                    RestAction::Pick => (&own[..], &opposite[..]),
                    RestAction::Place => (&opposite[..], &own[..]),
                };
                let asked = HandoffQuery {
                    giver,
                    receiver,
                    object: end.carry.object,
                    giver_holds: giving,
                    receiver_holds: taking,
                    giver_near: &[],
                    receiver_near: &[],
                };
                !contacts.handoffs(&asked, HANDOFF_TRIES, 1, rng).is_empty()
            }
            _ => opposite.iter().any(|(_, hold)| *hold == choice.hold),
        };
        choice.leads = Some(found);
        found
    }

    /// Whether the arms are apart at some contact of each end, before the two actions and after them.
    fn some_apart(&self, ends: [&End; 2], contacts: [&[Contact]; 2]) -> bool {
        let held = |end: &End, contact: &Contact, when: RestAction| {
            let holds = end.carry.action == when;
            holds.then_some(Held { object: end.carry.object, object_in_tcp: contact.object_in_tcp })
        };
        let none = Exemption::default();
        contacts[0].iter().any(|a| {
            contacts[1].iter().any(|b| {
                // Who places holds the object before, who picks afterwards.
                [RestAction::Place, RestAction::Pick].into_iter().all(|when| {
                    let [one, two] = [held(ends[0], a, when), held(ends[1], b, when)];
                    self.grounder.world.arms_apart(
                        (ends[0].arm, &a.q, one.as_ref(), none),
                        (ends[1].arm, &b.q, two.as_ref(), none),
                    )
                })
            })
        })
    }
}
