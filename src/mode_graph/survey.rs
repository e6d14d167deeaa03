//! Reach at slots and at spots: the questions that are put to a [`Reach`], one class at a time.

use crate::geometry::Pose;
use crate::problem::{InitialPlacement, Problem};
use crate::run::Control;
use crate::workcell::{ArmId, ObjectId, Surface, SurfaceId, rests_on};

use super::fingers::finger_clearance;
use super::footprint::Footprint;
use super::graph::{Slot, Spot};
use super::handoffs::Meetings;
use super::holds::{RestHolds, is_close, merge};
use super::packing::{Bed, pack};
use super::proof::Proof;
use super::reach::{Hold, Reach, RestAction};
use super::regions::{Sample, connect};
use super::slots::{Slots, resting_poses};
use super::stance::{alternatives, stances};

/// Objects with fewer grasps than this are tried at more than one pose per spot.
const MANY_GRASPS: usize = 8;
/// Neighbouring samples are at most this many lattice pitches apart (diagonals included).
const NEIGHBOUR: f64 = 1.6;
/// Surfaces whose heights differ by less than this (m) may both be under one object.
const LEVEL: f64 = 0.01;

/// Which arms can pick from and place at a slot, ascending.
#[derive(Debug, Clone, Default)]
pub(super) struct SlotReach {
    pub(super) pick: Vec<ArmId>,
    pub(super) place: Vec<ArmId>,
}

impl SlotReach {
    /// The arms that can do both.
    pub(super) fn both(&self) -> Vec<ArmId> {
        self.pick.iter().filter(|arm| self.place.contains(arm)).copied().collect()
    }
}

/// A group of placements on one surface that the same arms reach.
#[derive(Debug)]
pub(super) struct Group {
    pub(super) arms: Vec<ArmId>,
    pub(super) spots: Vec<Spot>,
    /// Whether there may be room for more spots on the surface.
    pub(super) more_may_fit: bool,
    /// Slots of the class within it, by number.
    pub(super) slots: Vec<usize>,
}

/// Asks one [`Reach`] about one problem.
pub(super) struct Surveyor<'a> {
    pub(super) problem: &'a Problem,
    pub(super) proof: &'a Proof<'a>,
    pub(super) reach: &'a mut dyn Reach,
    /// Handoffs found so far.
    pub(super) meetings: Meetings,
    pub(super) control: &'a Control,
    /// Whether nothing was cut short.
    pub(super) complete: bool,
}

impl Surveyor<'_> {
    fn arms(&self) -> impl Iterator<Item = ArmId> + use<> {
        (0..self.problem.workcell.arms.len()).map(ArmId)
    }

    /// An object of `class`, and whether there is one.
    fn member(&self, class: usize) -> Option<ObjectId> {
        self.problem.objects.iter().position(|object| object.class == class).map(ObjectId)
    }

    /// Who reaches slot `number`. Holds of its owners' picks and places are added to `holds`.
    pub(super) fn slot(&mut self, slot: &Slot, holds: &mut RestHolds) -> SlotReach {
        let mut out = SlotReach::default();
        let Some(member) = slot.start_of.or(slot.goal_of) else { return out };
        for arm in self.arms() {
            if self.control.should_stop() {
                self.complete = false;
                break;
            }
            let poses = match slot.goal_of {
                Some(object) => {
                    let surface = &self.problem.workcell.surfaces[slot.surface.0];
                    resting_poses(&self.problem.objects[object.0], &slot.pose, surface)
                }
                None => vec![slot.pose],
            };
            if !self.proof.may_hold(arm, slot.class, &poses) {
                continue;
            }
            let picks = slot.start_of.map(|object| {
                let good = self.reach.reaches(RestAction::Pick, arm, object, &slot.pose, slot.surface);
                if good {
                    let likely =
                        self.reach.possible_holds(RestAction::Pick, arm, object, &slot.pose, slot.surface);
                    holds.picked[arm.0].add(object, &[slot.pose], slot.surface, &likely);
                }
                good
            });
            let places = slot.goal_of.map(|object| {
                let likely = self.goal_holds(arm, object, &poses, slot.surface);
                if let Some(likely) = &likely {
                    holds.placeable[arm.0].add(object, &poses, slot.surface, likely);
                }
                likely.is_some()
            });
            // What is not asked of the slot itself follows from the mirror image where it can.
            let is_mirrored = self.is_mirrored(member);
            let mirrored = |known: Option<bool>| known.filter(|_| is_mirrored);
            let mut ask = |action| self.reach.reaches(action, arm, member, &slot.pose, slot.surface);
            let (picks, places) = match (picks.or(mirrored(places)), places.or(mirrored(picks))) {
                (Some(picks), Some(places)) => (picks, places),
                (None, Some(places)) => (ask(RestAction::Pick), places),
                (Some(picks), None) => (picks, ask(RestAction::Place)),
                (None, None) => (ask(RestAction::Pick), ask(RestAction::Place)),
            };
            if picks {
                out.pick.push(arm);
            }
            if places {
                out.place.push(arm);
            }
        }
        out
    }

    /// The holds in which `arm` may place `object` at any of its goal `poses`, of which the first
    /// is the one given; `None` when it can place it at none. A grasp at a symmetric pose is
    /// another grasp at the first one; only where that is none of the object's grasps, or the object
    /// takes other room there, the pose itself is asked about.
    pub(super) fn goal_holds(
        &mut self,
        arm: ArmId,
        object: ObjectId,
        poses: &[Pose],
        surface: SurfaceId,
    ) -> Option<Vec<Hold>> {
        let first = poses.first()?;
        let at_first = self.reach.possible_holds(RestAction::Place, arm, object, first, surface);
        let mut reached = self.reach.reaches(RestAction::Place, arm, object, first, surface);
        let mut likely = at_first.clone();
        let model = &self.problem.objects[object.0];
        let opening = self.problem.workcell.arms[arm.0].tool.max_opening;
        for pose in &poses[1..] {
            let turn = first.inverse() * pose;
            let mut unknown = model.only_counts_as_box();
            for (number, grasp) in model.grasps.iter().enumerate().filter(|(_, grasp)| grasp.fits(opening)) {
                let same = grasp.object_in_tcp * turn.inverse();
                match model.grasps.iter().position(|other| is_close(&other.object_in_tcp, &same)) {
                    Some(other) if at_first.iter().any(|hold| hold.grasp == Some(other)) => {
                        let hold = Hold { grasp: Some(number), object_in_tcp: grasp.object_in_tcp };
                        merge(&mut likely, &[hold]);
                    }
                    Some(_) => {}
                    None => unknown = true,
                }
            }
            if unknown {
                let more = self.reach.possible_holds(RestAction::Place, arm, object, pose, surface);
                merge(&mut likely, &more);
                reached = reached || self.reach.reaches(RestAction::Place, arm, object, pose, surface);
            }
        }
        reached.then_some(likely)
    }

    /// The groups of placements for `class` on `surface`: packed spots around all slots, and the
    /// class's slots with the reach given. About `wanted` spots are looked for.
    pub(super) fn surface(
        &mut self,
        surface: SurfaceId,
        class: usize,
        slots: &Slots,
        slot_reach: &[SlotReach],
        wanted: usize,
    ) -> Vec<Group> {
        let Some(member) = self.member(class) else { return Vec::new() };
        let place = &self.problem.workcell.surfaces[surface.0];
        let shapes = &self.problem.objects[member.0].shapes;
        let stances = stances(self.problem, class);
        let alternatives = alternatives(shapes, &stances);
        let reachable: Vec<ArmId> =
            self.arms().filter(|&arm| self.proof.may_reach_surface(arm, class, surface)).collect();
        let mut samples = Vec::new();
        let mut spots: Vec<Option<Spot>> = Vec::new();
        let mut numbers = Vec::new();
        let (mut pitch, mut more_may_fit) = (0.0, false);
        if let (Some(stance), false) = (stances.first(), reachable.is_empty()) {
            let outline = Footprint::of(shapes, &stance.pose);
            let taken: Vec<Footprint> = slots
                .slots
                .iter()
                .filter(|slot| slot.surface == surface)
                .filter_map(|slot| {
                    let owner = slot.start_of.or(slot.goal_of)?;
                    let in_surface = place.pose.inverse() * slot.pose;
                    Some(Footprint::of(&self.problem.objects[owner.0].shapes, &in_surface))
                })
                .collect();
            let gap = finger_clearance(self.problem, class);
            let bed = Bed { half_extents: place.half_extents, taken: &taken, gap };
            let members = self.problem.objects.iter().filter(|object| object.class == class).count();
            let packing = pack(&outline, &bed, wanted, members + 1);
            (pitch, more_may_fit) = (packing.pitch, packing.more_may_fit);
            let others = level_with(&self.problem.workcell.surfaces, surface);
            // An object rests on one surface.
            let is_alone = |pose: &Pose| others.iter().all(|other| rests_on(shapes, pose, other).is_err());
            for at in packing.shifts {
                let poses = alternatives.iter().map(|(stance, yaw)| stance.on(place, at, *yaw));
                let poses: Vec<Pose> = poses.filter(is_alone).collect();
                if poses.is_empty() {
                    continue;
                }
                let arms = self.spot_arms(&reachable, member, class, &poses, surface);
                samples.push(Sample { at, arms });
                spots.push(Some(Spot { poses }));
                numbers.push(None);
            }
        }
        for (number, slot) in slots.slots.iter().enumerate() {
            if slot.class == class && slot.surface == surface {
                let at = (place.pose.inverse() * slot.pose).translation.vector;
                samples.push(Sample { at: [at.x, at.y], arms: slot_reach[number].both() });
                spots.push(None);
                numbers.push(Some(number));
            }
        }
        let groups = connect(&samples, NEIGHBOUR * pitch);
        groups
            .into_iter()
            .map(|members| Group {
                arms: members.first().map(|&first| samples[first].arms.clone()).unwrap_or_default(),
                spots: members.iter().filter_map(|&index| spots[index].take()).collect(),
                more_may_fit,
                slots: members.iter().filter_map(|&index| numbers[index]).collect(),
            })
            .filter(|group| !group.spots.is_empty())
            .collect()
    }

    /// The arms that seem to be able to both pick and place at a spot.
    fn spot_arms(
        &mut self,
        reachable: &[ArmId],
        object: ObjectId,
        class: usize,
        poses: &[Pose],
        surface: SurfaceId,
    ) -> Vec<ArmId> {
        let tries = if self.problem.objects[object.0].grasps.len() < MANY_GRASPS { 4 } else { 1 };
        let mirrored = self.is_mirrored(object);
        let mut arms = Vec::new();
        for &arm in reachable {
            if self.control.should_stop() {
                self.complete = false;
                break;
            }
            let good = poses.iter().take(tries).any(|pose| {
                self.proof.may_hold(arm, class, std::slice::from_ref(pose))
                    && self.reach.seems_to_reach(RestAction::Place, arm, object, pose, surface)
                    && (mirrored || self.reach.seems_to_reach(RestAction::Pick, arm, object, pose, surface))
            });
            if good {
                arms.push(arm);
            }
        }
        arms
    }

    /// Whether a place is a pick backwards in time: the same contact, the same lines with the same
    /// hand, empty or full, when they are equally long. Then one answer does for both.
    fn is_mirrored(&self, object: ObjectId) -> bool {
        let object = &self.problem.objects[object.0];
        object.approach == object.retreat
    }

    /// Adds the holds that `group`'s arms have at one of its spots, for arms of which none is known
    /// from slots.
    pub(super) fn group_holds(
        &mut self,
        group: &Group,
        class: usize,
        surface: SurfaceId,
        holds: &mut RestHolds,
    ) {
        let Some(object) = self.member(class) else { return };
        let Some(pose) = group.spots.get(group.spots.len() / 2).and_then(|spot| spot.poses.first()) else {
            return;
        };
        for &arm in &group.arms {
            if self.control.should_stop() {
                self.complete = false;
                return;
            }
            for (action, known) in [
                (RestAction::Pick, &mut holds.picked[arm.0]),
                (RestAction::Place, &mut holds.placeable[arm.0]),
            ] {
                if known.is_empty() {
                    let likely = self.reach.possible_holds(action, arm, object, pose, surface);
                    known.add(object, &[*pose], surface, &likely);
                }
            }
        }
    }

    /// The holds that objects of `class` are in at the start.
    pub(super) fn initial_holds(&self, class: usize) -> RestHolds {
        let count = self.problem.workcell.arms.len();
        let mut holds = RestHolds::none(count);
        for (object, initial) in self.problem.objects.iter().zip(&self.problem.initial) {
            if let InitialPlacement::Held { arm, object_in_tcp } = initial
                && object.class == class
            {
                let grasp =
                    object.grasps.iter().position(|grasp| is_close(&grasp.object_in_tcp, object_in_tcp));
                holds.picked[arm.0].add_certain(&[Hold { grasp, object_in_tcp: *object_in_tcp }]);
            }
        }
        holds
    }
}

/// The surfaces that overlap the one with number `surface`, and are level with it.
fn level_with(surfaces: &[Surface], surface: SurfaceId) -> Vec<&Surface> {
    let this = &surfaces[surface.0];
    let size = |surface: &Surface| surface.half_extents[0].hypot(surface.half_extents[1]);
    let others = surfaces.iter().enumerate().filter(|(other, _)| *other != surface.0);
    others
        .map(|(_, other)| other)
        .filter(|other| {
            let offset = other.pose.translation.vector - this.pose.translation.vector;
            offset.norm() < size(this) + size(other) + LEVEL
                && offset.dot(&this.normal()).abs() < LEVEL
                && other.normal().dot(&this.normal()) > 0.99
        })
        .collect()
}
