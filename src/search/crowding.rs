//! Two ends of carries that leave each other no room.
//!
//! Single edges of the mode graph say that an arm can pick and another place; a carry, that this goes
//! together by some handoff. In which holds follows from the handoff alone, and where two carries have an end
//! in one step, all contacts in the holds of the one may touch all those of the other. This is looked into
//! where a plan from the start has such ends in one step and the contacts of its chains touch: is there a pair of
//! holds in which some contacts are apart, and in both of which the objects can be carried? The holds are those in which
//! the mode graph knows contacts; carries are sought for each alone, with as many samples as it takes for all together. Where no pair turns
//! up, the two become one of the [`ModeGraph::crowdings`](crate::mode_graph::ModeGraph::crowdings): like missing
//! edges they rest on samples, and the graph's optimum is that of a graph without them. Where one turns up, the plan's
//! chains take those holds.

use crate::collision::{Exemption, Held};
use crate::geometry::Pose;
use crate::mode_graph::{CarryEnd, RestAction};
use crate::problem::{GoalPlacement, GuidanceKind, InitialPlacement};
use crate::run::{Control, Rng};
use crate::transition::{Contact, ContactKind, ContactQuery, HandoffContact, HandoffQuery};
use crate::workcell::{ArmId, ObjectId};

use super::chain::{Chain, query};
use super::leg::Leg;
use super::outline::Outline;
use super::smart::Search;

/// Draws of a meeting place tried before a carry counts as impossible in one hold at its end.
const HANDOFF_TRIES: usize = 260;

/// Further samplings of contacts in a hold before they count as all in each other's way.
const SAMPLINGS: usize = 6;

/// Pairs of contacts that are compared in one look at a plan, and holds for which carries are sought. When they are
/// spent, two ends are taken to leave room.
const MOST_COMPARED: usize = 50_000;
const MOST_ASKED: usize = 24;

/// Pairs of holds that leave room, but cannot be had beside the other objects, before it is left at that.
const MOST_UNSUITED: usize = 8;

/// Changes of chains in one look at a plan.
const MOST_CHANGES: usize = 4;

/// One end of a straight carry in the plan.
struct End {
    carry: CarryEnd,
    /// The steps in which the carry begins and ends, and that of this end.
    steps: (usize, usize),
    step: usize,
    arm: ArmId,
    asked: ContactQuery,
    /// What is asked of the arm at the other end.
    opposite: ContactQuery,
    /// The hold that was chosen.
    chosen: Pose,
}

/// A hold at an end.
struct Choice {
    hold: Pose,
    contacts: Vec<Contact>,
    /// Whether the carry can be done in it, once that was asked.
    leads: Option<Leads>,
}

/// Whether a carry can be done in some hold at one end.
enum Leads {
    Nowhere,
    /// As the plan has it.
    AsChosen,
    /// By this handoff, or without any.
    By(Option<Box<HandoffContact>>),
}

/// Whether two ends leave each other room.
enum Room {
    No,
    /// As the plan has them, or that is taken for granted.
    AsChosen,
    /// By other chains for the one or the other.
    By(Box<[Option<Chain>; 2]>),
}

/// What may still be spent on a look at a plan.
struct Look<'c> {
    control: &'c Control,
    rng: Rng,
    compared: usize,
    asked: usize,
}

impl Look<'_> {
    fn is_over(&self) -> bool {
        self.compared >= MOST_COMPARED || self.asked >= MOST_ASKED || self.control.should_stop()
    }
}

impl Search<'_> {
    /// Whether [`Self::crowding`] looks at anything.
    pub fn looks_for_crowding(&self) -> bool {
        let is_smart = matches!(self.problem.options.guidance, GuidanceKind::Smart);
        is_smart && self.asks_freely() && !self.tree[0].is_goal
    }

    /// The first two actions in one step of the way from the start that were not found to go together, in
    /// any holds in which both objects can be carried straight to their goals. Looked for where the guidance is for
    /// all objects at once and they are few. The way is kept for the next iteration, with chains in other holds where those
    /// leave room.
    pub fn crowding(&mut self, control: &Control) -> Option<[CarryEnd; 2]> {
        if !self.looks_for_crowding() {
            return None;
        }
        if self.tree[0].guided_at != self.version {
            self.guide(0, control);
        }
        let guide = self.tree[0].guide.clone()?;
        let (guide, mut outline) = self.unobstructed(0, guide, control)?;
        let rng = self.seed.stream("crowding");
        let mut look = Look { control, rng, compared: 0, asked: 0 };
        let mut crowded = None;
        for round in 0..=MOST_CHANGES {
            let ends = self.all_ends(&outline);
            let pairs = ends.iter().enumerate().flat_map(|(index, one)| {
                let others = ends[..index].iter();
                others.filter(|two| two.step == one.step && two.arm != one.arm).map(move |two| [one, two])
            });
            let mut changes = None;
            for pair in pairs {
                match self.room(pair, &outline, &mut look) {
                    Room::AsChosen => continue,
                    Room::By(chains) => changes = Some((pair.map(|end| end.carry.object.0), chains)),
                    Room::No => crowded = Some([pair[1].carry.clone(), pair[0].carry.clone()]),
                }
                break;
            }
            let Some((objects, chains)) = changes.filter(|_| round < MOST_CHANGES) else { break };
            for (object, chain) in objects.into_iter().zip(*chains) {
                outline.chains.extend(chain.map(|chain| (object, vec![chain])));
            }
        }
        self.prepared = Some((self.version, guide, outline));
        crowded
    }

    /// The ends of all straight carries of a plan that have but one chain.
    fn all_ends(&self, outline: &Outline) -> Vec<End> {
        let mut ends: Vec<End> = Vec::new();
        for leg in &outline.legs {
            let legs = outline.legs.iter().filter(|other| other.object == leg.object).count();
            if let Some([chain]) = outline.chains.get(&leg.object).map(Vec::as_slice)
                && legs == 1
            {
                ends.extend(self.ends(leg, chain));
            }
        }
        ends
    }

    /// Whether there is a guide from the start.
    pub fn knows_a_way(&self) -> bool {
        self.tree[0].guide.is_some()
    }

    /// The ends of a leg that is a straight carry from the object's start to its goal pose. A goal that stands for
    /// several poses is left alone: it allows so many more holds.
    fn ends(&self, leg: &Leg, chain: &Chain) -> Vec<End> {
        let object = ObjectId(leg.object);
        let (InitialPlacement::Resting { pose, surface }, GoalPlacement::Pose { .. }, [first, ..]) =
            (&self.problem.initial[object.0], &self.problem.goal[object.0], &leg.arms[..])
        else {
            return Vec::new();
        };
        let last = leg.arms.last().unwrap_or(first);
        let goals = self.map.placements(object.0, chain.node);
        if leg.arms.len() > 2 || chain.node != chain.wanted || leg.begins() == 0 || goals != [chain.target] {
            return Vec::new();
        }
        let (Some((_, taken)), Some((_, put))) = (chain.carriers.first(), chain.carriers.last()) else {
            return Vec::new();
        };
        let pick = query(ContactKind::Pick, *first, object, (*pose, *surface));
        let place = query(ContactKind::Place, *last, object, chain.target);
        let end = |action, step, asked: ContactQuery, opposite, chosen| {
            let carry = CarryEnd { object, action, carriers: leg.arms.clone() };
            End { carry, steps: (leg.begins(), leg.ends()), step, arm: asked.arm, asked, opposite, chosen }
        };
        vec![
            end(RestAction::Pick, leg.begins(), pick, place, *taken),
            end(RestAction::Place, leg.ends(), place, pick, *put),
        ]
    }

    /// In which holds, in which both objects can be carried, some contacts at the two ends are apart. When in doubt
    /// they are as they were chosen.
    fn room(&mut self, ends: [&End; 2], outline: &Outline, look: &mut Look<'_>) -> Room {
        // Mostly the first contacts are apart.
        let first = ends.map(|end| self.grounder.contacts.first(&end.asked, &end.chosen, 1));
        if self.some_apart(ends, [&first[0], &first[1]], look) {
            return Room::AsChosen;
        }
        let chosen = ends.map(|end| self.grounder.contacts.at(&end.asked, &end.chosen));
        if self.some_apart(ends, [&chosen[0], &chosen[1]], look) {
            return Room::AsChosen;
        }
        let mut choices = ends.map(|end| self.choices(end));
        let mut unsuited = 0;
        for is_last in [false, true] {
            if is_last {
                // Perhaps a few contacts are too few to tell.
                for (end, choices) in ends.into_iter().zip(&mut choices) {
                    choices.retain_mut(|choice| {
                        let leads = self.leads(end, choice, look);
                        if leads {
                            self.sample_more(end, choice, look);
                        }
                        leads
                    });
                }
            }
            for i in 0..choices[0].len() {
                for j in 0..choices[1].len() {
                    if look.is_over() {
                        return Room::AsChosen;
                    }
                    let (a, b) = (&choices[0][i], &choices[1][j]);
                    let open = |choice: &Choice| !matches!(choice.leads, Some(Leads::Nowhere));
                    if !(open(a)
                        && open(b)
                        && self.some_apart(ends, [&a.contacts, &b.contacts], look)
                        && self.leads(ends[0], &mut choices[0][i], look)
                        && self.leads(ends[1], &mut choices[1][j], look))
                    {
                        continue;
                    }
                    let pair = [&choices[0][i], &choices[1][j]];
                    if let Some(chains) = self.other_chains(ends, pair, outline) {
                        let are_others = chains.iter().any(Option::is_some);
                        return if are_others { Room::By(Box::new(chains)) } else { Room::AsChosen };
                    }
                    unsuited += 1;
                    if unsuited == MOST_UNSUITED {
                        return Room::AsChosen;
                    }
                }
            }
            if unsuited > 0 {
                return Room::AsChosen;
            }
        }
        if look.is_over() { Room::AsChosen } else { Room::No }
    }

    /// Chains in these holds where they are others than the plan's; `None` where one cannot be had beside the other
    /// objects.
    fn other_chains(
        &mut self,
        ends: [&End; 2],
        choices: [&Choice; 2],
        outline: &Outline,
    ) -> Option<[Option<Chain>; 2]> {
        let mut chains = [None, None];
        for ((end, choice), chain) in ends.into_iter().zip(choices).zip(&mut chains) {
            let by = match &choice.leads {
                Some(Leads::By(by)) => by.as_deref(),
                Some(Leads::AsChosen) => continue,
                Some(Leads::Nowhere) | None => return None,
            };
            let object = end.carry.object.0;
            let known = outline.chains.get(&object)?.first()?;
            let holds = match by {
                Some(meeting) => vec![meeting.giver_hold, meeting.receiver_hold],
                None => vec![choice.hold],
            };
            let carriers = end.carry.carriers.iter().copied().zip(holds).collect();
            let other = Chain { carriers, handoffs: by.cloned().into_iter().collect(), ..known.clone() };
            let vertex = &self.tree[0];
            let at_pick = self.grounder.around(vertex, outline, object, end.steps.0);
            let at_place = self.grounder.around(vertex, outline, object, end.steps.1);
            if !self.grounder.suits(&other, object, &vertex.objects[object], &at_pick, &at_place) {
                return None;
            }
            *chain = Some(other);
        }
        Some(chains)
    }

    /// The holds in which there is a contact at an end, with the first contacts.
    fn choices(&mut self, end: &End) -> Vec<Choice> {
        let contacts = &mut self.grounder.contacts;
        let mut holds: Vec<Pose> = contacts.holds(&end.asked).into_iter().map(|(_, hold)| hold).collect();
        if !holds.contains(&end.chosen) {
            holds.push(end.chosen);
        }
        let mut choices = Vec::with_capacity(holds.len());
        for hold in holds {
            let leads = (hold == end.chosen).then_some(Leads::AsChosen);
            choices.push(Choice { hold, contacts: contacts.at(&end.asked, &hold).to_vec(), leads });
        }
        choices
    }

    fn sample_more(&mut self, end: &End, choice: &mut Choice, look: &mut Look<'_>) {
        for _ in 0..SAMPLINGS {
            if look.is_over() {
                return;
            }
            let fresh = self.grounder.contacts.others(&end.asked, &choice.hold, &mut look.rng);
            for contact in fresh {
                if !choice.contacts.iter().any(|known| known.q == contact.q) {
                    choice.contacts.push(contact);
                }
            }
        }
    }

    /// Whether the object can be carried in this hold at this end.
    fn leads(&mut self, end: &End, choice: &mut Choice, look: &mut Look<'_>) -> bool {
        if let Some(known) = &choice.leads {
            return !matches!(known, Leads::Nowhere);
        }
        if look.is_over() {
            return true;
        }
        look.asked += 1;
        let contacts = &mut self.grounder.contacts;
        let opposite = contacts.holds(&end.opposite);
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
                let found = contacts.first_handoffs(&asked, HANDOFF_TRIES, 1, &mut look.rng);
                found.into_iter().next().map(|meeting| Leads::By(Some(Box::new(meeting))))
            }
            _ => opposite.iter().any(|(_, hold)| *hold == choice.hold).then_some(Leads::By(None)),
        };
        let found = choice.leads.insert(found.unwrap_or(Leads::Nowhere));
        !matches!(found, Leads::Nowhere)
    }

    /// Whether the arms are apart at some contact of each end, before the two actions and after them. The contacts of an
    /// end are all in one hold.
    fn some_apart(&self, ends: [&End; 2], contacts: [&[Contact]; 2], look: &mut Look<'_>) -> bool {
        let [[one, ..], [two, ..]] = contacts else { return false };
        let are_alike =
            |all: &&[Contact]| all.iter().all(|other| other.object_in_tcp == all[0].object_in_tcp);
        debug_assert!(contacts.iter().all(are_alike));
        let held = |end: &End, contact: &Contact, when: RestAction| {
            let holds = end.carry.action == when;
            holds.then_some(Held { object: end.carry.object, object_in_tcp: contact.object_in_tcp })
        };
        // Who places holds the object before, who picks afterwards.
        let times = [RestAction::Place, RestAction::Pick]
            .map(|when| [held(ends[0], one, when), held(ends[1], two, when)]);
        let none = Exemption::default();
        let pairs = contacts[0].iter().flat_map(|a| contacts[1].iter().map(move |b| (&a.q[..], &b.q[..])));
        let mut left: Vec<(&[f64], &[f64])> = pairs.collect();
        // Mostly the first are apart.
        let mut batch = 1;
        while !left.is_empty() {
            let rest = left.split_off(batch.min(left.len()));
            look.compared += left.len();
            for [one, two] in &times {
                let sides = ((ends[0].arm, one.as_ref(), none), (ends[1].arm, two.as_ref(), none));
                let mut apart = self.grounder.world.each_apart(sides.0, sides.1, &left).into_iter();
                left.retain(|_| apart.next().unwrap_or(false));
                if left.is_empty() {
                    break;
                }
            }
            if !left.is_empty() {
                return true;
            }
            (left, batch) = (rest, 8);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::CollisionWorld;
    use crate::mode_graph::{ModeGraphOptions, build_mode_graph};
    use crate::run::Seed;
    use crate::scenario::{Family, generate};
    use crate::search::{Map, Settings};
    use crate::transition::SampledReach;
    use crate::wire::{LibraryOnly, ReadLimits, read_problem_value};

    #[test]
    fn chains_are_taken_in_holds_that_leave_room() {
        let control = Control::unbounded();
        let mut changed = 0;
        for seed in 0..400 {
            let family = [Family::Switch, Family::SideToSide, Family::Random][seed as usize % 3];
            let document = generate(family, 4, 4, seed).unwrap();
            let problem =
                read_problem_value(&document, &LibraryOnly, &ReadLimits::default()).unwrap().problem;
            let (seed, world) = (Seed(seed), CollisionWorld::new(&problem));
            let mut reach = SampledReach::new(&problem, &world, seed);
            let graph = build_mode_graph(&problem, &mut reach, &ModeGraphOptions::planning(), &control);
            let (map, contacts) = (Map::new(graph).unwrap(), reach.into_contacts());
            // What is asked here takes no motions.
            let (settings, roadmaps) = (Settings::default(), Vec::new());
            let mut search =
                Search::new(&problem, &world, &map, contacts, roadmaps, settings, seed, &control);
            if search.crowding(&control).is_some() {
                continue;
            }
            let Some((_, _, outline)) = search.prepared.take() else { continue };
            for (object, chains) in &outline.chains {
                let [chain] = chains.as_slice() else { continue };
                for (hop, meeting) in chain.handoffs.iter().enumerate() {
                    assert_eq!(chain.carriers[hop].1, meeting.giver_hold);
                    assert_eq!(chain.carriers[hop + 1].1, meeting.receiver_hold);
                }
                // Those of the outline itself are chosen by what they cost from where the arms are.
                if chain.handoffs.len() != 1 || chain.handoffs[0].cost > 0.0 {
                    continue;
                }
                changed += 1;
                let ends = search.all_ends(&outline);
                assert!(ends.iter().filter(|end| end.carry.object.0 == *object).count() == 2);
                for end in ends.iter().filter(|end| end.carry.object.0 == *object) {
                    let (vertex, steps) = (&search.tree[0], end.steps);
                    let at_pick = search.grounder.around(vertex, &outline, *object, steps.0);
                    let at_place = search.grounder.around(vertex, &outline, *object, steps.1);
                    let from = &vertex.objects[*object];
                    assert!(search.grounder.suits(chain, *object, from, &at_pick, &at_place));
                    for other in ends.iter().filter(|other| other.step == end.step && other.arm != end.arm) {
                        let contacts = &mut search.grounder.contacts;
                        let held = [end, other].map(|end| contacts.at(&end.asked, &end.chosen));
                        let rng = seed.stream("test");
                        let mut look = Look { control: &control, rng, compared: 0, asked: 0 };
                        assert!(search.some_apart([end, other], [&held[0], &held[1]], &mut look));
                    }
                }
            }
            if changed >= 3 {
                return;
            }
        }
        panic!("{changed} chains were changed");
    }
}
