//! Continuous certification: eight pieces of an interval at a time, the open ones cut again.

use smallvec::SmallVec;

use super::broad::{self, Candidate, Candidates};
use super::cubics;
use super::exact::Exact;
use super::narrow::{Scenery, look};
use super::place::{Limbs, PlacedArm};
use crate::collision::certify::{JointMotion, Stations};
use crate::collision::world::{CollisionWorld, Mover, Resting};
use crate::geometry::lanes::{Bits8, Float8, Kernel};

/// How often pieces in which limbs move far are cut before what is in the limbs is looked at.
const MOST_COARSE: u8 = 6;

/// Answers to several questions.
pub(in crate::collision) type Answers = SmallVec<[bool; 8]>;

/// Whether each of some configurations is free of the arm itself, obstacles, and objects at rest.
pub(in crate::collision) struct Configurations<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) mover: &'a Mover<'a>,
    pub(in crate::collision) around: &'a Resting,
    pub(in crate::collision) configs: &'a [&'a [f64]],
}

/// Whether each of some motions over its span is free of the same.
pub(in crate::collision) struct Motions<'a, 'm> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) mover: &'a Mover<'a>,
    pub(in crate::collision) around: &'a Resting,
    pub(in crate::collision) motions: &'m [&'m dyn JointMotion],
}

/// Whether two arms are apart in some pieces of time, which need not touch each other; in none they are.
pub(in crate::collision) struct Apart<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) first: &'a Mover<'a>,
    pub(in crate::collision) second: &'a Mover<'a>,
    /// Pieces to begin with, in order; at most eight.
    pub(in crate::collision) pieces: &'a [(f64, f64)],
}

/// At which of some pairs of configurations two arms at rest are apart.
pub(in crate::collision) struct PairsApart<'a> {
    pub(in crate::collision) world: &'a CollisionWorld,
    pub(in crate::collision) first: (&'a Mover<'a>, &'a Stations<'a>),
    pub(in crate::collision) second: (&'a Mover<'a>, &'a Stations<'a>),
    /// How many pairs there are.
    pub(in crate::collision) count: usize,
}

impl Kernel for Configurations<'_> {
    type Output = Answers;

    #[inline(always)]
    fn run<F: Float8>(self) -> Answers {
        let (world, mover) = (self.world, self.mover);
        let scenery = Scenery { world, first: mover, second: None, resting: &self.around.lanes };
        let stations = Stations(self.configs);
        let mut exact = Exact::new(world, (mover, &stations), None, &self.around.atoms);
        let (mut at, mut limbs) = (PlacedArm::<F>::new(), Limbs::new());
        let mut candidates = Candidates::new();
        let mut free = Answers::new();
        for (batch, configs) in self.configs.chunks(8).enumerate() {
            stations.sample_batch(8 * batch, &mut at.samples);
            at.place(&mover.lanes, true);
            limbs.clear();
            at.place_limbs(&mover.lanes, &mut limbs);
            let active = Bits8::MAX >> (8 - configs.len());
            candidates.clear();
            broad::with_world(world, mover, self.around, &limbs, active, &mut candidates);
            broad::with_itself(world, mover, (&at, &limbs), active, &mut candidates);
            let middles = std::array::from_fn(|lane| (8 * batch + lane) as f64);
            let mut blocked: Bits8 = 0;
            for candidate in &mut candidates {
                candidate.lanes &= !blocked;
                if candidate.lanes != 0 {
                    blocked |= look(&scenery, candidate, (&at, None), &middles, &mut exact).blocked;
                }
            }
            free.extend((0..configs.len()).map(|n| blocked >> n & 1 == 0));
        }
        free
    }
}

impl Kernel for Motions<'_, '_> {
    type Output = Answers;

    #[inline(always)]
    fn run<F: Float8>(self) -> Answers {
        let (world, mover) = (self.world, self.mover);
        let scenery = Scenery { world, first: mover, second: None, resting: &self.around.lanes };
        let (mut at, mut limbs) = (PlacedArm::<F>::new(), Limbs::new());
        let mut work = Work::new();
        let mut free = Answers::from_elem(false, self.motions.len());
        for (motion, free) in self.motions.iter().zip(&mut free) {
            let mut exact = Exact::new(world, (mover, *motion), None, &self.around.atoms);
            let still = motion.stands_still();
            let (pieces, count) = eighths(motion.span(), still);
            work.begin(&pieces[..count]);
            let mut blocked = false;
            while let Some(job) = work.next() {
                cubics::sample::<F>(*motion, &job.pieces, &mut at.samples);
                at.place(&mover.lanes, still);
                if job.is_fresh {
                    limbs.clear();
                    at.place_limbs(&mover.lanes, &mut limbs);
                    let found = &mut work.candidates;
                    broad::with_world(world, mover, self.around, &limbs, job.active, found);
                    broad::with_itself(world, mover, (&at, &limbs), job.active, found);
                } else {
                    work.inherit(&job);
                }
                let middles = job.middles();
                for candidate in &work.candidates {
                    let found = look(&scenery, candidate, (&at, None), &middles, &mut exact);
                    if found.blocked != 0 {
                        blocked = true;
                        break;
                    }
                    if found.open != 0 {
                        work.stack.push(Candidate { lanes: found.open, ..*candidate });
                    }
                }
                if blocked {
                    break;
                }
                work.cut(&job, 0);
            }
            *free = !blocked;
        }
        free
    }
}

impl Kernel for Apart<'_> {
    /// An instant of contact.
    type Output = Option<f64>;

    #[inline(always)]
    fn run<F: Float8>(self) -> Option<f64> {
        let Self { world, first, second, pieces } = self;
        let scenery = Scenery { world, first, second: Some(second), resting: &[] };
        let are_still = [first.motion.stands_still(), second.motion.stands_still()];
        let still = are_still == [true, true];
        let mut exact = Exact::new(world, (first, first.motion), Some((second, second.motion)), &[]);
        let (mut at, mut other_at) = (PlacedArm::<F>::new(), PlacedArm::<F>::new());
        let (mut limbs, mut others) = (Limbs::new(), Limbs::new());
        let mut work = Work::new();
        work.begin(pieces);
        let mut is_first = true;
        while let Some(job) = work.next() {
            // Who does not move is put in place once.
            if is_first || !are_still[0] {
                cubics::sample::<F>(first.motion, &job.pieces, &mut at.samples);
                at.place(&first.lanes, still);
            }
            if is_first || !are_still[1] {
                cubics::sample::<F>(second.motion, &job.pieces, &mut other_at.samples);
                other_at.place(&second.lanes, still);
            }
            is_first = false;
            let mut swift = 0;
            if job.is_fresh {
                limbs.clear();
                at.place_limbs(&first.lanes, &mut limbs);
                others.clear();
                other_at.place_limbs(&second.lanes, &mut others);
                let (boxes, other_boxes) = ((&at.low, &at.high), (&other_at.low, &other_at.high));
                let among = broad::boxes_meet(world, boxes, other_boxes, job.active);
                let placed = ((&limbs[..], &others[..]), boxes, other_boxes);
                let mut near = broad::limbs_near(world, placed, among);
                if job.depth < MOST_COARSE {
                    swift = broad::leave_out_swift((&limbs, &others), &mut near);
                }
                broad::between_arms(world, (first, second), &near, &mut work.candidates);
            } else {
                work.inherit(&job);
            }
            let middles = job.middles();
            for candidate in &work.candidates {
                let found = look(&scenery, candidate, (&at, Some(&other_at)), &middles, &mut exact);
                if found.blocked != 0 {
                    return Some(middles[found.blocked.trailing_zeros() as usize]);
                }
                if found.open != 0 {
                    work.stack.push(Candidate { lanes: found.open, ..*candidate });
                }
            }
            work.cut(&job, swift);
        }
        None
    }
}

impl Kernel for PairsApart<'_> {
    type Output = Answers;

    #[inline(always)]
    fn run<F: Float8>(self) -> Answers {
        let Self { world, first: (first, ours), second: (second, theirs), count } = self;
        let scenery = Scenery { world, first, second: Some(second), resting: &[] };
        let mut exact = Exact::new(world, (first, ours), Some((second, theirs)), &[]);
        let (mut at, mut other_at) = (PlacedArm::<F>::new(), PlacedArm::<F>::new());
        let (mut limbs, mut others) = (Limbs::new(), Limbs::new());
        let mut candidates = Candidates::new();
        let mut apart = Answers::new();
        for batch in (0..count).step_by(8) {
            ours.sample_batch(batch, &mut at.samples);
            at.place(&first.lanes, true);
            limbs.clear();
            at.place_limbs(&first.lanes, &mut limbs);
            theirs.sample_batch(batch, &mut other_at.samples);
            other_at.place(&second.lanes, true);
            others.clear();
            other_at.place_limbs(&second.lanes, &mut others);
            let here = (count - batch).min(8);
            let (boxes, other_boxes) = ((&at.low, &at.high), (&other_at.low, &other_at.high));
            let among = broad::boxes_meet(world, boxes, other_boxes, Bits8::MAX >> (8 - here));
            let near = broad::limbs_near(world, ((&limbs, &others), boxes, other_boxes), among);
            candidates.clear();
            broad::between_arms(world, (first, second), &near, &mut candidates);
            let middles = std::array::from_fn(|lane| (batch + lane) as f64);
            let mut blocked: Bits8 = 0;
            for candidate in &mut candidates {
                candidate.lanes &= !blocked;
                if candidate.lanes != 0 {
                    let found = look(&scenery, candidate, (&at, Some(&other_at)), &middles, &mut exact);
                    blocked |= found.blocked | found.open;
                }
            }
            apart.extend((0..here).map(|n| blocked >> n & 1 == 0));
        }
        apart
    }
}

/// Up to eight spans, in order, in eight pieces or one each: the longest pieces are halved, cut in three, and so on.
pub(in crate::collision) fn cut_in_eight(spans: &[(f64, f64)]) -> SmallVec<[(f64, f64); 8]> {
    let mut parts: SmallVec<[u32; 8]> = SmallVec::from_elem(1, spans.len());
    for _ in spans.len()..8 {
        let length = |n: usize| (spans[n].1 - spans[n].0) / f64::from(parts[n]);
        let Some(longest) = (0..spans.len()).max_by(|a, b| length(*a).total_cmp(&length(*b))) else { break };
        parts[longest] += 1;
    }
    let mut pieces = SmallVec::new();
    for (&(from, to), parts) in spans.iter().zip(parts) {
        let edge = |n: u32| from + (to - from) * f64::from(n) / f64::from(parts);
        pieces.extend((0..parts).map(|n| (edge(n), edge(n + 1))));
    }
    pieces
}

/// A span in eight pieces, of which only the first counts where nothing moves.
pub(in crate::collision) fn eighths((from, to): (f64, f64), still: bool) -> ([(f64, f64); 8], usize) {
    let edge = |n: usize| from + (to - from) * n as f64 / 8.0;
    (std::array::from_fn(|n| (edge(n), edge(n + 1))), if still { 1 } else { 8 })
}

/// Up to eight intervals and the pairs that are open in them.
#[derive(Clone, Copy)]
struct Job {
    pieces: [(f64, f64); 8],
    /// By lane, the lane of the job before that it comes from.
    from: [u8; 8],
    active: Bits8,
    /// Whether all pairs are looked at, or those in the stack only.
    is_fresh: bool,
    /// Where its pairs are in the stack.
    open: (usize, usize),
    /// How often its pieces were cut.
    depth: u8,
}

/// Jobs that are still to be done, and pairs that are open in them.
struct Work {
    jobs: SmallVec<[Job; 4]>,
    /// The pairs of the job at hand.
    candidates: Candidates,
    stack: Candidates,
    /// From where in the stack on the job at hand leaves what it could not decide.
    start: usize,
}

impl Work {
    #[inline(always)]
    fn new() -> Self {
        Self { jobs: SmallVec::new(), candidates: Candidates::new(), stack: Candidates::new(), start: 0 }
    }

    /// All pairs over `pieces`.
    #[inline(always)]
    fn begin(&mut self, pieces: &[(f64, f64)]) {
        self.jobs.clear();
        self.stack.clear();
        let Some(first) = pieces.first() else { return };
        let mut filled = [*first; 8];
        let mut active = 0;
        for (lane, piece) in pieces.iter().take(8).enumerate() {
            filled[lane] = *piece;
            active |= 1 << lane;
        }
        self.jobs.push(Job { pieces: filled, from: [0; 8], active, is_fresh: true, open: (0, 0), depth: 0 });
    }

    /// The next job, the lists made ready for it.
    #[inline(always)]
    fn next(&mut self) -> Option<Job> {
        let job = self.jobs.pop()?;
        self.stack.truncate(job.open.1);
        self.start = self.stack.len();
        self.candidates.clear();
        Some(job)
    }

    /// Takes over the pairs that the job before left open.
    fn inherit(&mut self, job: &Job) {
        let (from, to) = job.open;
        for pair in &self.stack[from..to] {
            let lanes = job.inherited(pair.lanes);
            if lanes != 0 {
                self.candidates.push(Candidate { lanes, ..*pair });
            }
        }
    }

    /// Cuts the lanes of `job` that are still open into jobs of their own, and those `swift` into such in which all
    /// pairs are looked at again.
    #[inline(always)]
    fn cut(&mut self, job: &Job, swift: Bits8) {
        let open = self.stack[self.start..].iter().fold(0, |open, pair| open | pair.lanes) & !swift;
        let end = self.stack.len();
        if swift != 0 {
            job.cut(swift, true, (end, end), &mut self.jobs);
        }
        if open != 0 {
            job.cut(open, false, (self.start, end), &mut self.jobs);
        }
    }
}

impl Job {
    fn middles(&self) -> [f64; 8] {
        self.pieces.map(|(from, to)| (from + to) / 2.0)
    }

    /// Lanes that come from `lanes` of the job before.
    fn inherited(&self, lanes: Bits8) -> Bits8 {
        let mut own = 0;
        for (lane, from) in self.from.iter().enumerate() {
            own |= (lanes >> from & 1) << lane;
        }
        own & self.active
    }

    /// Cuts `lanes` into jobs of their own; the earliest comes to lie on top.
    fn cut(&self, lanes: Bits8, is_fresh: bool, pairs: (usize, usize), jobs: &mut SmallVec<[Job; 4]>) {
        let count = lanes.count_ones();
        let parts = match count {
            1 => 8,
            2 => 4,
            _ if is_fresh => 3,
            _ => 2,
        };
        let lanes = (0..8_u8).filter(|lane| lanes >> lane & 1 == 1);
        let mut cuts: SmallVec<[(u8, (f64, f64)); 24]> = SmallVec::new();
        for lane in lanes {
            let (from, to) = self.pieces[usize::from(lane)];
            let edge = |part: i32| from + (to - from) * f64::from(part) / f64::from(parts);
            cuts.extend((0..parts).map(|part| (lane, (edge(part), edge(part + 1)))));
        }
        for chunk in cuts.chunks(8).rev() {
            let depth = self.depth.saturating_add(1);
            let pieces = [chunk[0].1; 8];
            let mut job = Job { pieces, from: [0; 8], active: 0, is_fresh, open: pairs, depth };
            for (lane, (from, piece)) in chunk.iter().enumerate() {
                job.pieces[lane] = *piece;
                job.from[lane] = *from;
                job.active |= 1 << lane;
            }
            jobs.push(job);
        }
    }
}
