//! Ways on which no grasps fit together. That an arm can pick an object, that it can hand over to
//! another, and that the other can put the object down does not yet mean that one can follow the
//! other: the grasps of the pick may be none of those from which the other can take over in a
//! grasp in which it can place.

use crate::problem::{InitialPlacement, Problem};
use crate::workcell::{ArmId, ObjectId, Symmetry};

use super::graph::BarredCarry;
use super::handoffs::{Finder, Handover};
use super::holds::{ArmHolds, RestHolds, is_close};
use super::reach::{Hold, RestAction};
use super::slots::{Slots, symmetric_poses};
use super::survey::{SlotReach, Surveyor};

/// The carries of `object` from its start straight to its goal pose, by one arm or by two that
/// `handovers` lets meet, on which no grasps fit together. None where the start is the goal, where
/// there is no goal pose, or where that stands for infinitely many.
pub(super) fn barred_carries(
    surveyor: &mut Surveyor<'_>,
    slots: &Slots,
    slot_reach: &[SlotReach],
    handovers: &[Handover],
    object: ObjectId,
) -> Vec<BarredCarry> {
    let problem = surveyor.problem;
    let (start, Some(goal)) = (slots.start[object.0], slots.goal[object.0]) else { return Vec::new() };
    let endless = matches!(problem.objects[object.0].symmetry, Symmetry::CylinderZ | Symmetry::Sphere);
    if start == Some(goal) || endless {
        return Vec::new();
    }
    let givers = match (&problem.initial[object.0], start) {
        (InitialPlacement::Held { arm, .. }, _) => vec![*arm],
        (InitialPlacement::Resting { .. }, Some(start)) => slot_reach[start].pick.clone(),
        (InitialPlacement::Resting { .. }, None) => return Vec::new(),
    };
    let meets = |giver: ArmId, receiver: ArmId| {
        giver == receiver || handovers.iter().any(|pair| (pair.giver, pair.receiver) == (giver, receiver))
    };
    let receivers = &slot_reach[goal].place;
    let mut holds = OwnHolds { object, start, goal, known: None };
    let mut barred = Vec::new();
    for &giver in &givers {
        for &receiver in receivers.iter().filter(|&&receiver| meets(giver, receiver)) {
            if surveyor.control.should_stop() {
                surveyor.complete = false;
                return barred;
            }
            if !holds.fit(surveyor, slots, giver, receiver) {
                let mut carriers = vec![giver, receiver];
                carriers.dedup();
                barred.push(BarredCarry { object, carriers });
            }
        }
    }
    barred
}

/// How one object may be held when it leaves its start, and when it comes to its goal.
struct OwnHolds {
    object: ObjectId,
    start: Option<usize>,
    goal: usize,
    /// What has been asked for so far, by arm.
    known: Option<(RestHolds, Vec<[bool; 2]>)>,
}

impl OwnHolds {
    /// Whether grasps fit together from the start over `giver` and `receiver`, which may be one, to
    /// the goal.
    fn fit(&mut self, surveyor: &mut Surveyor<'_>, slots: &Slots, giver: ArmId, receiver: ArmId) -> bool {
        self.ask(surveyor, slots, giver, receiver);
        let Some((holds, _)) = &mut self.known else { return true };
        if giver == receiver {
            let (taken, placed) = (holds.picked[giver.0].likely.clone(), &mut holds.placeable[giver.0]);
            return taken.iter().any(|hold| {
                placed.likely.iter().any(|other| is_close(&other.object_in_tcp, &hold.object_in_tcp))
                    && placed.confirm(surveyor.reach, RestAction::Place, giver, hold)
                    && holds.picked[giver.0].confirm(surveyor.reach, RestAction::Pick, giver, hold)
            });
        }
        Finder::for_rest(surveyor.reach, self.object, holds).ends_placed(giver, receiver).is_some()
    }

    /// Asks for the holds of both arms, once.
    fn ask(&mut self, surveyor: &mut Surveyor<'_>, slots: &Slots, giver: ArmId, receiver: ArmId) {
        let problem: &Problem = surveyor.problem;
        let arms = problem.workcell.arms.len();
        let (holds, asked) = self.known.get_or_insert_with(|| (RestHolds::none(arms), vec![[false; 2]; arms]));
        if !std::mem::replace(&mut asked[giver.0][0], true) {
            holds.picked[giver.0] = match (&problem.initial[self.object.0], self.start) {
                (InitialPlacement::Held { object_in_tcp, .. }, _) => {
                    let grasps = &problem.objects[self.object.0].grasps;
                    let grasp = grasps.iter().position(|grasp| is_close(&grasp.object_in_tcp, object_in_tcp));
                    let mut held = ArmHolds::default();
                    held.add_certain(&[Hold { grasp, object_in_tcp: *object_in_tcp }]);
                    held
                }
                (InitialPlacement::Resting { pose, surface }, _) => {
                    let likely = surveyor.reach.possible_holds(
                        RestAction::Pick,
                        giver,
                        self.object,
                        pose,
                        *surface,
                    );
                    let mut picked = ArmHolds::default();
                    picked.add(self.object, &[*pose], *surface, &likely);
                    picked
                }
            };
        }
        if !std::mem::replace(&mut asked[receiver.0][1], true) {
            let slot = &slots.slots[self.goal];
            let poses = symmetric_poses(&problem.objects[self.object.0], &slot.pose);
            let likely = surveyor.goal_holds(receiver, self.object, &poses, slot.surface).unwrap_or_default();
            holds.placeable[receiver.0].add(self.object, &poses, slot.surface, &likely);
        }
    }
}
