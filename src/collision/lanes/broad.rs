//! Coarse checks: from the arm's box over its limbs to the pairs of atoms that need a closer look.

use smallvec::SmallVec;

use super::arm::{UNMOVED, relative_lever};
use super::place::{PlacedArm, PlacedLimb, motion_bound};
use crate::collision::certify::BodyIndex;
use crate::collision::world::{CollisionWorld, Mover, Owner, Resting};
use crate::geometry::lanes::{Bits8, Float8, Segment8, V3, segment_segment_squared};

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
    around: &Resting,
    limbs: &[PlacedLimb<F>],
    active: Bits8,
    out: &mut Candidates,
) {
    let margin = F::splat(world.margin);
    for (index, limb) in limbs.iter().enumerate() {
        let (low, high) = limb.bounds();
        let hull = (low.map(|x| x.least() - world.margin), high.map(|x| x.greatest() + world.margin));
        let need = limb.need + margin;
        for block in &mover.lanes.arm.near {
            // A held object may get to all of them, an arm's limb not to what comes after this.
            let mut near = block.limbs.get(index).copied().unwrap_or(block.boxes.there);
            if near == 0 {
                continue;
            }
            near &= block.boxes.meet::<F>(&hull);
            while near != 0 {
                let index_in_world = block.boxes.index(near.trailing_zeros());
                near &= near - 1;
                let fixed = &world.lane_obstacles[index_in_world];
                let among = fixed.meets(&low, &high, margin, active);
                if among == 0 {
                    continue;
                }
                let lanes = fixed.near(&limb.axis(), need, among);
                if lanes != 0 {
                    let owner = world.obstacles[index_in_world].owner;
                    push_world(world, mover, index, (index_in_world, owner), lanes, out);
                }
            }
        }
        for block in &around.blocks {
            let mut near = block.meet::<F>(&hull) & block.there;
            while near != 0 {
                let resting = block.index(near.trailing_zeros());
                near &= near - 1;
                let owner = around.atoms[resting].owner;
                if mover.held.as_ref().is_some_and(|held| owner == Owner::Resting(held.object)) {
                    continue;
                }
                let lanes = around.lanes[resting].near(&limb.axis(), need, active);
                if lanes != 0 {
                    let target = (world.obstacles.len() + resting, owner);
                    push_world(world, mover, index, target, lanes, out);
                }
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
    (at, limbs): (&PlacedArm<F>, &[PlacedLimb<F>]),
    active: Bits8,
    out: &mut Candidates,
) {
    let (arm, frames) = (mover.lanes.arm, at.frames());
    // Pairs come sorted by their first atom.
    let mut last = None;
    let mut ours = Segment8::with_length([F::splat(0.0); 3], [F::splat(0.0); 3], 0.0);
    for group in &arm.self_groups {
        let mut lanes = active;
        if let Some(range) = &group.safe {
            lanes &= !range.holds(at);
            if lanes == 0 {
                continue;
            }
        }
        if let Some((x, y, levers)) = &group.limbs {
            let radii = arm.limbs[*x].capsule.radius + arm.limbs[*y].capsule.radius;
            let mut need = F::splat(radii + world.margin);
            if !at.still {
                need = need + motion_bound(levers, &at.samples.deviations);
            }
            let squared = segment_segment_squared(&limbs[*x].axis(), &limbs[*y].axis());
            lanes &= F::bits(squared.less(need * need));
        }
        if lanes != 0 {
            for pair in &group.pairs {
                let (a, b) = (&arm.atoms[usize::from(pair.a)], &arm.atoms[usize::from(pair.b)]);
                if last != Some(pair.a) {
                    (last, ours) = (Some(pair.a), a.hull.place(a.frame.map(|frame| &frames[frame])));
                }
                let mut need = F::splat(a.hull.radius + b.hull.radius + world.margin);
                if !at.still {
                    need = need + motion_bound(&pair.levers, &at.samples.deviations);
                }
                let theirs = b.hull.place(b.frame.map(|frame| &frames[frame]));
                let near = F::bits(segment_segment_squared(&ours, &theirs).less(need * need)) & lanes;
                if near != 0 {
                    out.push(Candidate { a: pair.a, target: Target::Itself(pair.b), lanes: near });
                }
            }
        }
    }
    let Some(held) = &mover.lanes.held else { return };
    let Some(held_at) = limbs.get(arm.limbs.len()) else { return };
    for (limb, placed) in arm.limbs.iter().zip(limbs) {
        let mut bound = F::splat(limb.capsule.radius + held.limb.capsule.radius + world.margin);
        for (joint, deviation) in at.samples.deviations.iter().enumerate() {
            let (x, y) = (limb.levers[joint], held.limb.levers[joint]);
            let lever = relative_lever(x, y, arm.several[joint]);
            if lever != UNMOVED {
                bound = F::splat(lever).mul_add(F::load(deviation), bound);
            }
        }
        let squared = segment_segment_squared(&placed.axis(), &held_at.axis());
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
fn meets<F: Float8>(limb: &PlacedLimb<F>, margin: F, (low, high): Bounds<'_, F>, among: Bits8) -> bool {
    let mut lanes = among;
    for k in 0..3 {
        let (least, greatest) = limb.extent(k);
        let (a, b) = (least - margin, greatest + margin);
        lanes &= F::bits(F::both(a.less(high[k]), low[k].less(b)));
    }
    lanes != 0
}

/// A box in each lane: low and high.
pub(super) type Bounds<'a, F> = (&'a V3<F>, &'a V3<F>);

/// Two arms in place: their limbs, and the box around those of each.
pub(super) type Both<'a, F> = ((&'a [PlacedLimb<F>], &'a [PlacedLimb<F>]), Bounds<'a, F>, Bounds<'a, F>);

/// Lanes of `active` in which the boxes of two arms meet.
#[inline(always)]
pub(super) fn boxes_meet<F: Float8>(
    world: &CollisionWorld,
    (low, high): Bounds<'_, F>,
    (other_low, other_high): Bounds<'_, F>,
    active: Bits8,
) -> Bits8 {
    let margin = F::splat(world.margin);
    let mut all = low[0].less(other_high[0] + margin);
    for k in 0..3 {
        all = F::both(all, low[k].less(other_high[k] + margin));
        all = F::both(all, other_low[k].less(high[k] + margin));
    }
    F::bits(all) & active
}

/// Two limbs, by their numbers, that are near each other in some lanes.
pub(super) type NearLimbs = (usize, usize, Bits8);

/// Pairs of limbs of two arms that are near each other, in lanes of `among`, where the arms' boxes meet.
#[inline(always)]
pub(super) fn limbs_near<F: Float8>(
    world: &CollisionWorld,
    ((ours, others), bounds, other_bounds): Both<'_, F>,
    among: Bits8,
) -> SmallVec<[NearLimbs; 16]> {
    let mut near = SmallVec::new();
    if among == 0 {
        return near;
    }
    let margin = F::splat(world.margin);
    let mut theirs: SmallVec<[usize; 8]> = SmallVec::new();
    for (index, limb) in others.iter().enumerate() {
        if meets(limb, margin, bounds, among) {
            theirs.push(index);
        }
    }
    if theirs.is_empty() {
        return near;
    }
    for (index, limb) in ours.iter().enumerate() {
        if !meets(limb, margin, other_bounds, among) {
            continue;
        }
        for &their_index in &theirs {
            let their = &others[their_index];
            let need = limb.need + their.need + margin;
            let squared = segment_segment_squared(&limb.axis(), &their.axis());
            let lanes = F::bits(squared.less(need * need)) & among;
            if lanes != 0 {
                near.push((index, their_index, lanes));
            }
        }
    }
    near
}

/// Limbs that move farther (m) than this, both together, while they are near each other are too swift for it to be of use to
/// look at what is in them.
const SWIFT: f32 = 0.1;

/// The lanes in which limbs that are `near` each other are too swift for a closer look; they are left out of the list.
#[inline(always)]
pub(super) fn leave_out_swift<F: Float8>(
    (ours, others): (&[PlacedLimb<F>], &[PlacedLimb<F>]),
    near: &mut SmallVec<[NearLimbs; 16]>,
) -> Bits8 {
    let mut swift = 0;
    for &(index, other, lanes) in near.iter() {
        let moves = ours[index].moves() + others[other].moves();
        swift |= F::bits(F::splat(SWIFT).less(moves)) & lanes;
    }
    if swift != 0 {
        near.iter_mut().for_each(|(.., lanes)| *lanes &= !swift);
        near.retain(|(.., lanes)| *lanes != 0);
    }
    swift
}

/// Pairs of atoms in limbs of two arms that are near each other.
pub(super) fn between_arms(
    world: &CollisionWorld,
    (first, second): (&Mover<'_>, &Mover<'_>),
    near: &[NearLimbs],
    out: &mut Candidates,
) {
    for &(ours, theirs, lanes) in near {
        let (Some(ours), Some(theirs)) = (first.lanes.limb(ours), second.lanes.limb(theirs)) else {
            continue;
        };
        for &a in &ours.atoms {
            for &b in &theirs.atoms {
                if !first.may_touch_arm(a, second, b, world) {
                    out.push(Candidate { a, target: Target::Other(b), lanes });
                }
            }
        }
    }
}
