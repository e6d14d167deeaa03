//! Continuous certification: eight pieces of an interval at a time, the open ones cut again.

use smallvec::SmallVec;

use super::broad::{self, Candidate, Candidates};
use super::core::LaneStatic;
use super::exact::Exact;
use super::mover::{PlacedArm, Samples};
use super::narrow::{Scenery, look};
use crate::collision::world::{CollisionWorld, Mover, WorldAtom};
use crate::geometry::lanes::{Bits8, Float8, Kernel};

/// With whom an arm is checked.
#[derive(Clone, Copy)]
pub(in crate::collision) enum Companion<'a> {
    /// With itself, obstacles, and objects at rest.
    Surroundings(&'a [WorldAtom], &'a [LaneStatic]),
    /// With another arm.
    Arm(&'a Mover<'a>),
}

/// A certification to be run by [`crate::geometry::lanes::InstructionSet::run`].
pub(in crate::collision) struct Certification<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) first: &'a Mover<'a>,
    pub(in crate::collision) companion: Companion<'a>,
    /// Pieces to begin with, in order; at most eight.
    pub(in crate::collision) pieces: &'a [(f64, f64)],
    /// Whether each piece is a question of its own; else the first contact ends all.
    pub(in crate::collision) each: bool,
}

/// What came out.
#[derive(Debug, Clone, Copy)]
pub(in crate::collision) struct Outcome {
    /// By piece, whether it is blocked; with `each` unset only whether any is.
    pub(in crate::collision) blocked: Bits8,
    /// An instant of contact.
    pub(in crate::collision) at: Option<f64>,
}

/// Up to eight intervals and the pairs that are open in them.
struct Job {
    pieces: [(f64, f64); 8],
    /// By lane, the lane of the job before that it comes from.
    from: [u8; 8],
    active: Bits8,
    /// Where its pairs are in the stack; `None` for all pairs.
    open: Option<(usize, usize)>,
}

impl Kernel for Certification<'_> {
    type Output = Outcome;

    #[inline(always)]
    fn run<F: Float8>(self) -> Outcome {
        let world = self.world;
        let (second, resting, resting_lanes) = match self.companion {
            Companion::Surroundings(atoms, lanes) => (None, atoms, lanes),
            Companion::Arm(other) => (Some(other), &[][..], &[][..]),
        };
        let scenery = Scenery { world, first: self.first, second, resting: resting_lanes };
        let mut exact = Exact::new(world, self.first, second, resting);
        let mut outcome = Outcome { blocked: 0, at: None };
        let mut samples = Samples::default();
        let mut at = PlacedArm::<F>::room_for(Some(&self.first.lanes));
        let mut other_at = PlacedArm::<F>::room_for(second.map(|second| &second.lanes));
        let mut candidates = Candidates::new();
        let mut stack = Candidates::new();
        let mut jobs: SmallVec<[Job; 4]> = SmallVec::new();
        jobs.extend(Job::first(self.pieces));
        while let Some(job) = jobs.pop() {
            let all = job.open.is_none();
            stack.truncate(job.open.map_or(0, |(_, end)| end));
            self.first.motion.sample(&job.pieces, &mut samples);
            self.first.lanes.place(&samples, all, &mut at);
            if let Some(second) = second {
                second.motion.sample(&job.pieces, &mut samples);
                second.lanes.place(&samples, all, &mut other_at);
            }
            candidates.clear();
            match (job.open, second) {
                (Some((from, to)), _) => {
                    for pair in &stack[from..to] {
                        let lanes = job.inherited(pair.lanes);
                        if lanes != 0 {
                            candidates.push(Candidate { lanes, ..*pair });
                        }
                    }
                }
                (None, Some(second)) => {
                    let movers = (self.first, second);
                    broad::between_arms(world, movers, (&at, &other_at), job.active, &mut candidates);
                }
                (None, None) => {
                    let statics = (resting, resting_lanes);
                    broad::with_world(world, self.first, statics, &at, job.active, &mut candidates);
                    broad::with_itself(world, self.first, &at, job.active, &mut candidates);
                }
            }
            let middles = job.pieces.map(|(from, to)| (from + to) / 2.0);
            let start = stack.len();
            let mut open = 0;
            for candidate in &candidates {
                let mut candidate = *candidate;
                if all && self.each {
                    candidate.lanes &= !outcome.blocked;
                }
                if candidate.lanes == 0 {
                    continue;
                }
                let found = look(&scenery, &candidate, (&at, &other_at), &middles, &mut exact);
                if found.blocked != 0 {
                    outcome.at.get_or_insert(middles[found.blocked.trailing_zeros() as usize]);
                    outcome.blocked |= found.blocked;
                    if !self.each {
                        return outcome;
                    }
                }
                if found.open != 0 {
                    open |= found.open;
                    stack.push(Candidate { lanes: found.open, ..candidate });
                }
            }
            if open != 0 {
                job.cut(open, (start, stack.len()), &mut jobs);
            }
        }
        outcome
    }
}

impl Job {
    /// All pairs over `pieces`; `None` without any.
    fn first(pieces: &[(f64, f64)]) -> Option<Self> {
        let mut filled = [*pieces.first()?; 8];
        let mut active = 0;
        for (lane, piece) in pieces.iter().take(8).enumerate() {
            filled[lane] = *piece;
            active |= 1 << lane;
        }
        Some(Self { pieces: filled, from: [0; 8], active, open: None })
    }

    /// Lanes that come from `lanes` of the job before.
    fn inherited(&self, lanes: Bits8) -> Bits8 {
        let mut own = 0;
        for (lane, from) in self.from.iter().enumerate() {
            own |= (lanes >> from & 1) << lane;
        }
        own & self.active
    }

    /// Cuts the lanes `open` into jobs of their own; the earliest comes to lie on top.
    fn cut(&self, open: Bits8, pairs: (usize, usize), jobs: &mut SmallVec<[Job; 4]>) {
        let count = open.count_ones();
        let parts = match count {
            1 => 8,
            2 => 4,
            _ => 2,
        };
        let lanes = (0..8_u8).filter(|lane| open >> lane & 1 == 1);
        let mut cuts: SmallVec<[(u8, (f64, f64)); 16]> = SmallVec::new();
        for lane in lanes {
            let (from, to) = self.pieces[usize::from(lane)];
            let edge = |part: i32| from + (to - from) * f64::from(part) / f64::from(parts);
            cuts.extend((0..parts).map(|part| (lane, (edge(part), edge(part + 1)))));
        }
        for chunk in cuts.chunks(8).rev() {
            let mut job = Job { pieces: [chunk[0].1; 8], from: [0; 8], active: 0, open: Some(pairs) };
            for (lane, (from, piece)) in chunk.iter().enumerate() {
                job.pieces[lane] = *piece;
                job.from[lane] = *from;
                job.active |= 1 << lane;
            }
            jobs.push(job);
        }
    }
}
