//! The closer look at one pair of atoms in eight lanes.

use super::arm::{UNMOVED, relative_lever};
use super::broad::{Candidate, Target};
use super::core::{Carried, LaneCore, LaneStatic, separation};
use super::exact::Exact;
use super::mover::LaneMover;
use super::place::{PlacedArm, motion_bound};
use super::tight;
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
    at: (&PlacedArm<F>, Option<&PlacedArm<F>>),
    middles: &[f64; 8],
    exact: &mut Exact<'_>,
) -> Look {
    let world = scenery.world;
    let first = &scenery.first.lanes;
    let ours = first.atom(candidate.a);
    let placed: Carried<'_, F> = (&ours.core, ours.frame.map(|frame| &at.0.frames()[frame]));
    let (other, bound, both_exact, both_boxes): (Carried<'_, F>, F, bool, bool);
    let box_a = matches!(ours.core, LaneCore::Box { .. });
    let still = F::splat(0.0);
    // The other body where it is the arm's own, and another arm's.
    let (mut own_other, mut far_other) = (None, None);
    // The box beside its core.
    let beside_other;
    match candidate.target {
        Target::World(index) => {
            let index = usize::from(index);
            let fixed = match world.lane_obstacles.get(index) {
                Some(fixed) => fixed,
                None => &scenery.resting[index - world.lane_obstacles.len()],
            };
            other = (fixed.core(), None);
            bound = if at.0.still { still } else { motion_bound(&ours.levers, &at.0.samples.deviations) };
            beside_other = fixed.beside();
            both_exact = ours.exact && fixed.exact;
            both_boxes = box_a && fixed.is_box();
        }
        Target::Itself(b) => {
            let theirs = first.atom(b);
            other = (&theirs.core, theirs.frame.map(|frame| &at.0.frames()[frame]));
            let mut sum = still;
            if !at.0.still {
                for (joint, deviation) in at.0.samples.deviations.iter().enumerate() {
                    let (x, y) = (ours.levers[joint], theirs.levers[joint]);
                    let lever = relative_lever(x, y, first.arm.several[joint]);
                    if lever != UNMOVED {
                        sum = F::splat(lever).mul_add(F::load(deviation), sum);
                    }
                }
            }
            bound = sum;
            own_other = Some(theirs);
            beside_other = theirs.beside.as_ref();
            both_exact = ours.exact && theirs.exact;
            both_boxes = box_a && matches!(theirs.core, LaneCore::Box { .. });
        }
        Target::Other(b) => {
            let (Some(second), Some(other_at)) = (scenery.second, at.1) else {
                return Look { open: 0, blocked: candidate.lanes };
            };
            let theirs = second.lanes.atom(b);
            other = (&theirs.core, theirs.frame.map(|frame| &other_at.frames()[frame]));
            bound = motion_bound::<F>(&ours.levers, &at.0.samples.deviations)
                + motion_bound(&theirs.levers, &other_at.samples.deviations);
            far_other = Some((&second.lanes, theirs, other_at, b));
            beside_other = theirs.beside.as_ref();
            both_exact = ours.exact && theirs.exact;
            both_boxes = box_a && matches!(theirs.core, LaneCore::Box { .. });
        }
    }
    let mut apart = separation(placed, other);
    let margin = F::splat(world.margin);
    let mut failing = F::bits(apart.less(bound + margin)) & candidate.lanes;
    if failing == 0 {
        return Look { open: 0, blocked: 0 };
    }
    let mut bound = bound;
    // Where the bodies are too near already, it is of no use to know how far they move.
    if !at.0.still && F::bits(apart.less(margin)) & failing != failing {
        let ours_moves = (placed, ours.frame);
        let now = match (own_other, far_other) {
            (Some(theirs), _) => {
                tight::relative_motion(&first.arm.frames, at.0, ours_moves, (other, theirs.frame))
            }
            (None, Some((second, theirs, other_at, b))) => {
                moved(first, at.0, candidate.a, ours_moves)
                    + moved(second, other_at, b, (other, theirs.frame))
            }
            (None, None) => moved(first, at.0, candidate.a, ours_moves),
        };
        bound = bound.min(now);
        failing &= F::bits(apart.less(bound + margin));
        if failing == 0 {
            return Look { open: 0, blocked: 0 };
        }
    }
    // Before the shapes themselves are asked, the boxes around those that their cores do not show as they are.
    if !both_exact
        && (ours.beside.is_some() || beside_other.is_some())
        && F::bits(apart.less(margin)) & failing != 0
    {
        let (one, two) = (ours.beside.as_ref().unwrap_or(placed.0), beside_other.unwrap_or(other.0));
        apart = apart.max(separation((one, placed.1), (two, other.1)));
        failing &= F::bits(apart.less(bound + margin));
        if failing == 0 {
            return Look { open: 0, blocked: 0 };
        }
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

/// How far an atom moves at most (m), worked out once in a batch.
#[inline(always)]
fn moved<F: Float8>(
    mover: &LaneMover<'_>,
    at: &PlacedArm<F>,
    atom: u16,
    (body, on): (Carried<'_, F>, Option<usize>),
) -> F {
    if let Some(known) = at.motion_of(atom) {
        return known;
    }
    let motion = tight::motion(&mover.arm.frames, at, body, on);
    at.remember_motion(atom, motion);
    motion
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
