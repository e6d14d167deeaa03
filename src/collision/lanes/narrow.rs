//! The closer look at one pair of atoms in eight lanes.

use super::arm::UNMOVED;
use super::broad::{Candidate, Target};
use super::core::{Carried, LaneCore, LaneStatic, separation};
use super::exact::Exact;
use super::mover::{PlacedArm, motion_bound};
use crate::collision::UNDECIDED_MOTION;
use crate::collision::world::{CollisionWorld, Mover};
use crate::geometry::lanes::{Bits8, Float8};

/// What surrounds the look at a pair.
pub(super) struct Scenery<'a> {
    pub(super) world: &'a CollisionWorld,
    pub(super) first: &'a Mover<'a>,
    pub(super) second: Option<&'a Mover<'a>>,
    pub(super) resting: &'a [LaneStatic],
}

/// How a pair stands in eight lanes.
pub(super) struct Look {
    /// Lanes in which it is not certified yet.
    pub(super) open: Bits8,
    /// Lanes in which it is in contact.
    pub(super) blocked: Bits8,
}

/// Looks at a pair; `middles` are the instants at which the arms are placed.
#[inline(always)]
pub(super) fn look<F: Float8>(
    scenery: &Scenery<'_>,
    candidate: &Candidate,
    at: (&PlacedArm<F>, &PlacedArm<F>),
    middles: &[f64; 8],
    exact: &mut Exact<'_>,
) -> Look {
    let world = scenery.world;
    let first = &scenery.first.lanes;
    let ours = first.atom(candidate.a);
    let placed: Carried<'_, F> = (&ours.core, ours.frame.map(|frame| &at.0.frames[frame]));
    let (other, bound, both_exact, both_boxes): (Carried<'_, F>, F, bool, bool);
    let box_a = matches!(ours.core, LaneCore::Box { .. });
    match candidate.target {
        Target::World(index) => {
            let index = usize::from(index);
            let fixed = match world.lane_obstacles.get(index) {
                Some(fixed) => fixed,
                None => &scenery.resting[index - world.lane_obstacles.len()],
            };
            other = (fixed.core(), None);
            bound = motion_bound(&ours.levers, &at.0.deviations);
            both_exact = ours.exact && fixed.exact;
            both_boxes = box_a && fixed.is_box();
        }
        Target::Itself(b) => {
            let theirs = first.atom(b);
            other = (&theirs.core, theirs.frame.map(|frame| &at.0.frames[frame]));
            let mut sum = F::splat(0.0);
            for ((x, y), deviation) in ours.levers.iter().zip(&theirs.levers).zip(&at.0.deviations) {
                if (*x == UNMOVED) != (*y == UNMOVED) {
                    sum = F::splat(x.max(*y)).mul_add(*deviation, sum);
                }
            }
            bound = sum;
            both_exact = ours.exact && theirs.exact;
            both_boxes = box_a && matches!(theirs.core, LaneCore::Box { .. });
        }
        Target::Other(b) => {
            let Some(second) = scenery.second else { return Look { open: 0, blocked: candidate.lanes } };
            let theirs = second.lanes.atom(b);
            other = (&theirs.core, theirs.frame.map(|frame| &at.1.frames[frame]));
            bound =
                motion_bound(&ours.levers, &at.0.deviations) + motion_bound(&theirs.levers, &at.1.deviations);
            both_exact = ours.exact && theirs.exact;
            both_boxes = box_a && matches!(theirs.core, LaneCore::Box { .. });
        }
    }
    let apart = separation(placed, other);
    let failing = F::bits(apart.less(bound + F::splat(world.margin))) & candidate.lanes;
    if failing == 0 {
        return Look { open: 0, blocked: 0 };
    }
    decide(
        world,
        candidate,
        failing,
        (&apart.store(), &bound.store()),
        (both_exact, both_boxes),
        middles,
        exact,
    )
}

/// What becomes of the lanes in which a pair is not far enough apart.
fn decide(
    world: &CollisionWorld,
    candidate: &Candidate,
    failing: Bits8,
    (apart, bound): (&[f32; 8], &[f32; 8]),
    (both_exact, both_boxes): (bool, bool),
    middles: &[f64; 8],
    exact: &mut Exact<'_>,
) -> Look {
    let mut look = Look { open: 0, blocked: 0 };
    let (clearance, inflation) = (world.clearance, f64::from(world.inflation));
    for lane in 0..8 {
        let bit = 1 << lane;
        if failing & bit == 0 {
            continue;
        }
        let (apart, bound) = (f64::from(apart[lane]), f64::from(bound[lane]));
        // A gap between boxes is only a lower bound, but one that is negative on all axes is contact.
        let contact = if both_boxes { -inflation } else { clearance - inflation };
        if both_exact && apart < contact {
            look.blocked |= bit;
        } else if apart < clearance + inflation || bound < UNDECIDED_MOTION {
            let distance = exact.distance(candidate.a, candidate.target, middles[lane], clearance + bound);
            if distance >= clearance + bound {
                continue;
            }
            if distance < clearance || bound < UNDECIDED_MOTION {
                look.blocked |= bit;
            } else {
                look.open |= bit;
            }
        } else {
            look.open |= bit;
        }
    }
    look
}
