//! Coarse checks: from the arm's box over its limbs to the pairs of atoms that need a closer look.

use smallvec::SmallVec;

use super::arm::UNMOVED;
use super::core::LaneStatic;
use super::mover::{PlacedArm, PlacedLimb, motion_bound};
use crate::collision::certify::BodyIndex;
use crate::collision::world::{CollisionWorld, Mover, Owner, WorldAtom};
use crate::geometry::lanes::{Bits8, Float8, V3, segment_segment_squared};

/// What an atom is checked against.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Target {
    /// An obstacle's atom, or counted after them one at rest.
    World(u16),
    /// Another atom of the same mover.
    Itself(BodyIndex),
    /// An atom of the other mover.
    Other(BodyIndex),
}

/// A pair that is open in some lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) a: BodyIndex,
    pub(super) target: Target,
    pub(super) lanes: Bits8,
}

pub(super) type Candidates = SmallVec<[Candidate; 64]>;

/// Pairs of an arm with what stands around it.
#[inline(always)]
pub(super) fn with_world<F: Float8>(
    world: &CollisionWorld,
    mover: &Mover<'_>,
    resting: (&[WorldAtom], &[LaneStatic]),
    at: &PlacedArm<F>,
    active: Bits8,
    out: &mut Candidates,
) {
    let margin = F::splat(world.margin);
    let mut low = at.low;
    let mut high = at.high;
    for k in 0..3 {
        low[k] = low[k] - margin;
        high[k] = high[k] + margin;
    }
    let own = mover.lanes.arm.limbs.len();
    for near in &mover.lanes.arm.near {
        let fixed = &world.lane_obstacles[near.index];
        if !near.any && mover.lanes.held.is_none() {
            continue;
        }
        let among = fixed.meets(&low, &high) & active;
        if among == 0 {
            continue;
        }
        for (index, limb) in at.limbs.iter().enumerate() {
            if index < own && !near.limbs[index] {
                continue;
            }
            let lanes = fixed.near(&limb.axis, limb.need + margin, among);
            if lanes != 0 {
                let owner = world.obstacles[near.index].owner;
                push_world(world, mover, index, (near.index, owner), lanes, out);
            }
        }
    }
    for (index, (atom, fixed)) in resting.0.iter().zip(resting.1).enumerate() {
        if mover.held.as_ref().is_some_and(|held| atom.owner == Owner::Resting(held.object)) {
            continue;
        }
        let among = fixed.meets(&low, &high) & active;
        if among == 0 {
            continue;
        }
        for (limb_index, limb) in at.limbs.iter().enumerate() {
            let lanes = fixed.near(&limb.axis, limb.need + margin, among);
            if lanes != 0 {
                let target = (world.obstacles.len() + index, atom.owner);
                push_world(world, mover, limb_index, target, lanes, out);
            }
        }
    }
}

fn push_world(
    world: &CollisionWorld,
    mover: &Mover<'_>,
    limb: usize,
    (target, owner): (usize, Owner),
    lanes: Bits8,
    out: &mut Candidates,
) {
    let Some(limb) = mover.lanes.limb(limb) else { return };
    for &a in &limb.atoms {
        // What never moves cannot come into contact: it was checked when the problem was read,
        // except against objects that were moved since.
        let fixed = matches!(owner, Owner::Obstacle(_)) && mover.lanes.atom(a).frame.is_none();
        if !fixed && !mover.may_touch_world(a, owner, world) {
            out.push(Candidate { a, target: Target::World(target as u16), lanes });
        }
    }
}

/// Pairs of an arm with itself, what it holds included.
#[inline(always)]
pub(super) fn with_itself<F: Float8>(
    world: &CollisionWorld,
    mover: &Mover<'_>,
    at: &PlacedArm<F>,
    active: Bits8,
    out: &mut Candidates,
) {
    let arm = mover.lanes.arm;
    for group in &arm.self_groups {
        let mut lanes = active;
        if let Some((x, y, levers)) = &group.limbs {
            let radii = arm.limbs[*x].capsule.radius + arm.limbs[*y].capsule.radius;
            let need = motion_bound(levers, &at.deviations) + F::splat(radii + world.margin);
            let squared = segment_segment_squared(&at.limbs[*x].axis, &at.limbs[*y].axis);
            lanes &= F::bits(squared.less(need * need));
        }
        if lanes != 0 {
            for pair in &group.pairs {
                out.push(Candidate { a: pair.a, target: Target::Itself(pair.b), lanes });
            }
        }
    }
    let Some(held) = &mover.lanes.held else { return };
    let Some(held_at) = at.limbs.get(arm.limbs.len()) else { return };
    for (limb, placed) in arm.limbs.iter().zip(&at.limbs) {
        let mut bound = F::splat(limb.capsule.radius + held.limb.capsule.radius + world.margin);
        for ((x, y), deviation) in limb.levers.iter().zip(&held.limb.levers).zip(&at.deviations) {
            if *x == UNMOVED && *y != UNMOVED {
                bound = F::splat(*y).mul_add(*deviation, bound);
            }
        }
        let squared = segment_segment_squared(&placed.axis, &held_at.axis);
        let lanes = F::bits(squared.less(bound * bound)) & active;
        if lanes == 0 {
            continue;
        }
        for &b in &limb.atoms {
            if !mover.is_hand(b) {
                for &a in &held.limb.atoms {
                    out.push(Candidate { a, target: Target::Itself(b), lanes });
                }
            }
        }
    }
}

/// Whether the limb's box meets the other arm's in some of the lanes.
#[inline(always)]
fn meets<F: Float8>(limb: &PlacedLimb<F>, margin: F, low: &V3<F>, high: &V3<F>, among: Bits8) -> bool {
    let need = limb.need + margin;
    let mut lanes = among;
    for k in 0..3 {
        let (a, b) = (limb.axis.start[k], limb.axis.start[k] + limb.axis.along[k]);
        lanes &= F::bits(F::both((a.min(b) - need).less(high[k]), low[k].less(a.max(b) + need)));
    }
    lanes != 0
}

/// Pairs of two arms.
#[inline(always)]
pub(super) fn between_arms<F: Float8>(
    world: &CollisionWorld,
    (first, second): (&Mover<'_>, &Mover<'_>),
    (at, other): (&PlacedArm<F>, &PlacedArm<F>),
    active: Bits8,
    out: &mut Candidates,
) {
    let margin = F::splat(world.margin);
    let mut among = active;
    for k in 0..3 {
        let apart = F::both(at.low[k].less(other.high[k] + margin), other.low[k].less(at.high[k] + margin));
        among &= F::bits(apart);
    }
    if among == 0 {
        return;
    }
    let mut theirs: SmallVec<[usize; 8]> = SmallVec::new();
    for (index, limb) in other.limbs.iter().enumerate() {
        if meets(limb, margin, &at.low, &at.high, among) {
            theirs.push(index);
        }
    }
    if theirs.is_empty() {
        return;
    }
    for (index, limb) in at.limbs.iter().enumerate() {
        if !meets(limb, margin, &other.low, &other.high, among) {
            continue;
        }
        for &their_index in &theirs {
            let their = &other.limbs[their_index];
            let need = limb.need + their.need + margin;
            let squared = segment_segment_squared(&limb.axis, &their.axis);
            let lanes = F::bits(squared.less(need * need)) & among;
            if lanes != 0 {
                push_arms(world, (first, second), (index, their_index), lanes, out);
            }
        }
    }
}

fn push_arms(
    world: &CollisionWorld,
    (first, second): (&Mover<'_>, &Mover<'_>),
    limbs: (usize, usize),
    lanes: Bits8,
    out: &mut Candidates,
) {
    let (Some(ours), Some(theirs)) = (first.lanes.limb(limbs.0), second.lanes.limb(limbs.1)) else { return };
    for &a in &ours.atoms {
        for &b in &theirs.atoms {
            if !first.may_touch_arm(a, second, b, world) {
                out.push(Candidate { a, target: Target::Other(b), lanes });
            }
        }
    }
}
