//! What single edges do not tell. That an arm can pick an object, that it can hand over to another,
//! and that the other can put the object down does not yet mean that one can follow the other: the
//! grasps of the pick may be none of those from which the other can take over, in a grasp in which it
//! can place. And what stands beside the object at its start or at its goal leaves fewer grasps.

use crate::geometry::Pose;
use crate::problem::{InitialPlacement, Problem};
use crate::workcell::{ArmId, ObjectId, SurfaceId, Symmetry};

use super::graph::{BarredCarry, BlockedPart, Slot};
use super::handoffs::{Finder, Handover};
use super::holds::{ArmHolds, RestHolds, is_close};
use super::reach::{Hold, RestAction, RestContact};
use super::slots::{Slots, resting_poses};
use super::survey::{SlotReach, Surveyor};

/// How far (m) beyond their bounding spheres objects may be in the way of each other's grasps.
const ROOM_FOR_A_HAND: f64 = 0.12;

/// Something that is in the way while it stands in slot number `at`.
#[derive(Debug)]
pub(super) struct Obstacle {
    pub(super) object: ObjectId,
    pub(super) part: BlockedPart,
    pub(super) at: usize,
}

/// What was found out about the carries of all objects.
#[derive(Debug, Default)]
pub(super) struct Carries {
    pub(super) barred: Vec<BarredCarry>,
    pub(super) obstacles: Vec<Obstacle>,
}

impl Carries {
    /// Looks at the carries of `object` from its start straight to its goal pose, by one arm or by two
    /// that `handovers` lets meet, and at its picks from the one and places at the other.
    pub(super) fn look_at(
        &mut self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        slot_reach: &[SlotReach],
        handovers: &[Handover],
        object: ObjectId,
    ) {
        let problem = surveyor.problem;
        // A goal that stands for infinitely many poses is left alone.
        let endless = matches!(problem.objects[object.0].symmetry, Symmetry::CylinderZ | Symmetry::Sphere);
        let goal = slots.goal[object.0].filter(|&goal| slots.start[object.0] != Some(goal) && !endless);
        let mut ends = Ends {
            object,
            takes: By::new(problem),
            puts: By::new(problem),
            start: slots.start[object.0],
            goal,
        };
        let givers = match (&problem.initial[object.0], ends.start) {
            (InitialPlacement::Held { arm, .. }, _) => vec![*arm],
            (InitialPlacement::Resting { .. }, Some(start)) => slot_reach[start].pick.clone(),
            (InitialPlacement::Resting { .. }, None) => return,
        };
        let receivers = goal.map_or(&[][..], |goal| &slot_reach[goal].place);
        let at_start = ends.start.map_or_else(Vec::new, |start| near(problem, slots, start, object));
        let at_goal = goal.map_or_else(Vec::new, |goal| near(problem, slots, goal, object));
        for (action, arms, neighbours) in
            [(RestAction::Pick, &givers[..], &at_start), (RestAction::Place, receivers, &at_goal)]
        {
            for (&arm, &at) in arms.iter().flat_map(|arm| neighbours.iter().map(move |at| (arm, at))) {
                if surveyor.control.should_stop() {
                    surveyor.complete = false;
                    return;
                }
                if ends.is_blocked(surveyor, slots, action, arm, at) {
                    let part = BlockedPart::Contact(action, arm);
                    self.obstacles.push(Obstacle { object, part, at });
                }
            }
        }
        let meets = |giver: ArmId, receiver: ArmId| {
            giver == receiver || handovers.iter().any(|pair| (pair.giver, pair.receiver) == (giver, receiver))
        };
        for &giver in &givers {
            for &receiver in receivers.iter().filter(|&&receiver| meets(giver, receiver)) {
                if surveyor.control.should_stop() {
                    surveyor.complete = false;
                    return;
                }
                let taken = ends.holds(surveyor, slots, RestAction::Pick, giver);
                let put = ends.holds(surveyor, slots, RestAction::Place, receiver);
                let mut carriers = vec![giver, receiver];
                carriers.dedup();
                let Some(known) = ends.fit(surveyor, slots, (giver, &taken), (receiver, &put)) else {
                    self.barred.push(BarredCarry { object, carriers });
                    continue;
                };
                for (action, neighbours) in [(RestAction::Pick, &at_start), (RestAction::Place, &at_goal)] {
                    for &at in neighbours {
                        let (arm, all, known) = match action {
                            RestAction::Pick => (giver, &taken, &known.0),
                            RestAction::Place => (receiver, &put, &known.1),
                        };
                        // The way that is known may do.
                        if ends.is_clear(surveyor, slots, action, arm, at, known) {
                            continue;
                        }
                        let clear = ends.clear(surveyor, slots, action, arm, at);
                        // With no clear hold at all the contact is blocked, not just this carry.
                        if clear.is_empty() || clear.len() == all.len() {
                            continue;
                        }
                        let (first, last) = match action {
                            RestAction::Pick => (&clear, &put),
                            RestAction::Place => (&taken, &clear),
                        };
                        if ends.fit(surveyor, slots, (giver, first), (receiver, last)).is_none() {
                            let part = BlockedPart::Carry(action, carriers.clone());
                            self.obstacles.push(Obstacle { object, part, at });
                        }
                    }
                }
            }
        }
    }
}

/// The slots in which something may be in the way of `object` in slot `of`: those nearby that do not
/// overlap it and are not its own.
fn near(problem: &Problem, slots: &Slots, of: usize, object: ObjectId) -> Vec<usize> {
    let radius = |slot: &Slot| {
        let owner = slot.start_of.or(slot.goal_of);
        owner.map_or(0.0, |owner| problem.objects[owner.0].bounding_radius())
    };
    let this = &slots.slots[of];
    let is_near = |slot: &Slot| {
        let apart = (slot.pose.translation.vector - this.pose.translation.vector).norm();
        apart < radius(slot) + radius(this) + ROOM_FOR_A_HAND
    };
    let is_own = |slot: &Slot| slot.start_of == Some(object) || slot.goal_of == Some(object);
    let numbered = slots.slots.iter().enumerate();
    numbered
        .filter(|(number, slot)| *number != of && !is_own(slot) && is_near(slot))
        .map(|(n, _)| n)
        .collect()
}

/// Holds by arm, and those that are clear of what stands in a slot, asked for when needed.
struct By {
    holds: Vec<Option<Vec<Hold>>>,
    clear: std::collections::BTreeMap<(ArmId, usize), Vec<Hold>>,
}

impl By {
    fn new(problem: &Problem) -> Self {
        Self { holds: vec![None; problem.workcell.arms.len()], clear: Default::default() }
    }
}

/// How one object may be held when it leaves its start, and when it comes to its goal.
struct Ends {
    object: ObjectId,
    start: Option<usize>,
    goal: Option<usize>,
    takes: By,
    puts: By,
}

impl Ends {
    fn by(&mut self, action: RestAction) -> &mut By {
        match action {
            RestAction::Pick => &mut self.takes,
            RestAction::Place => &mut self.puts,
        }
    }

    /// The poses and the surface of an action: of a place, all that meet the goal.
    fn at(&self, problem: &Problem, slots: &Slots, action: RestAction) -> (Vec<Pose>, SurfaceId) {
        let number = match action {
            RestAction::Pick => self.start,
            RestAction::Place => self.goal,
        };
        match number.and_then(|number| slots.slots.get(number)) {
            Some(slot) if action == RestAction::Place => {
                let surface = &problem.workcell.surfaces[slot.surface.0];
                (resting_poses(&problem.objects[self.object.0], &slot.pose, surface), slot.surface)
            }
            Some(slot) => (vec![slot.pose], slot.surface),
            None => (Vec::new(), SurfaceId(0)),
        }
    }

    /// The holds in which `arm` may be able to do `action`.
    fn holds(
        &mut self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        action: RestAction,
        arm: ArmId,
    ) -> Vec<Hold> {
        if let Some(known) = &self.by(action).holds[arm.0] {
            return known.clone();
        }
        let problem = surveyor.problem;
        let (poses, surface) = self.at(problem, slots, action);
        let found = match (&problem.initial[self.object.0], action) {
            (InitialPlacement::Held { object_in_tcp, .. }, RestAction::Pick) => {
                let grasps = &problem.objects[self.object.0].grasps;
                let grasp = grasps.iter().position(|grasp| is_close(&grasp.object_in_tcp, object_in_tcp));
                vec![Hold { grasp, object_in_tcp: *object_in_tcp }]
            }
            (_, RestAction::Place) => {
                surveyor.goal_holds(arm, self.object, &poses, surface).unwrap_or_default()
            }
            (InitialPlacement::Resting { pose, .. }, RestAction::Pick) => {
                surveyor.reach.possible_holds(action, arm, self.object, pose, surface)
            }
        };
        self.by(action).holds[arm.0] = Some(found.clone());
        found
    }

    /// Those of [`Self::holds`] that can be had although something stands in slot `at`.
    fn clear(
        &mut self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        action: RestAction,
        arm: ArmId,
        at: usize,
    ) -> Vec<Hold> {
        if let Some(known) = self.by(action).clear.get(&(arm, at)) {
            return known.clone();
        }
        let mut holds = self.holds(surveyor, slots, action, arm);
        holds.retain(|hold| self.is_clear(surveyor, slots, action, arm, at, hold));
        self.by(action).clear.insert((arm, at), holds.clone());
        holds
    }

    /// Whether `action` can be done in `hold` although something stands in slot `at`.
    fn is_clear(
        &self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        action: RestAction,
        arm: ArmId,
        at: usize,
        hold: &Hold,
    ) -> bool {
        let slot = &slots.slots[at];
        let Some(other) = slot.start_of.or(slot.goal_of) else { return true };
        let (poses, surface) = self.at(surveyor.problem, slots, action);
        poses.iter().any(|&pose| {
            let contact = RestContact { action, arm, object: self.object, pose, surface };
            surveyor.reach.is_clear(&contact, hold, other, &slot.pose)
        })
    }

    /// Whether there are [`Self::holds`], and none of them can be had while something stands in slot `at`.
    fn is_blocked(
        &mut self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        action: RestAction,
        arm: ArmId,
        at: usize,
    ) -> bool {
        let holds = self.holds(surveyor, slots, action, arm);
        let mut clear = holds.iter().filter(|hold| self.is_clear(surveyor, slots, action, arm, at, hold));
        clear.next().is_none() && !holds.is_empty()
    }

    /// The giver's hold and the receiver's by which grasps fit together from the start to the goal, with the giver
    /// taking the object in one hold of the first list and the receiver, which may be the same arm, placing it in
    /// one of the second.
    fn fit(
        &self,
        surveyor: &mut Surveyor<'_>,
        slots: &Slots,
        (giver, taken): (ArmId, &[Hold]),
        (receiver, put): (ArmId, &[Hold]),
    ) -> Option<(Hold, Hold)> {
        let mut ends = RestHolds::none(surveyor.problem.workcell.arms.len());
        for (action, arm, holds) in [(RestAction::Pick, giver, taken), (RestAction::Place, receiver, put)] {
            let (poses, surface) = self.at(surveyor.problem, slots, action);
            let known: &mut ArmHolds = match action {
                RestAction::Pick => &mut ends.picked[arm.0],
                RestAction::Place => &mut ends.placeable[arm.0],
            };
            match poses.as_slice() {
                // In the hand from the start.
                [] => known.add_certain(holds),
                poses => known.add(self.object, poses, surface, holds),
            }
        }
        if giver != receiver {
            let object = (self.object, &surveyor.problem.objects[self.object.0]);
            return Finder::for_rest(surveyor.reach, &mut surveyor.meetings, object, &ends)
                .ends_placed(giver, receiver)
                .map(|witness| (witness.giver_hold, witness.receiver_hold));
        }
        let common = |hold: &&Hold| {
            put.iter().any(|other| is_close(&other.object_in_tcp, &hold.object_in_tcp))
                || hold.grasp.is_none() && self.start.is_none()
        };
        let common: Vec<Hold> = taken.iter().filter(common).copied().collect();
        let found = common.into_iter().find(|hold| {
            ends.placeable[giver.0].confirm(surveyor.reach, RestAction::Place, giver, hold)
                && ends.picked[giver.0].confirm(surveyor.reach, RestAction::Pick, giver, hold)
        })?;
        Some((found, found))
    }
}
