//! When each arm starts, along fixed paths: best-first search over start delays.
//!
//! Like conflict-based search (Sharon et al. 2015), but the only thing that a constraint can do is
//! to make an arm wait before it starts: of two arms that meet, one or the other is delayed until
//! the two pass each other.

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use crate::collision::{CollisionWorld, Exemption, Held, Swept, Taking};
use crate::run::Control;
use crate::trajectory::{Curve, CurveTable, MIN_SPACING_S};
use crate::workcell::ArmId;

use super::legs::Legs;
use super::task::{ArmGoal, StepTask};
use super::timed::{ArmMotion, CurveMotion, Instants, StepMotion, Window};

/// Delays are multiples of this (s).
const TICK: f64 = 0.15;

/// By how many ticks more an arm may wait for another at once, in the order in which it is tried.
const WAITS: [u32; 12] = [1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36, LONGEST_WAIT];

/// The same where time is short.
const HASTY_WAITS: [u32; 6] = [2, 4, 8, 15, 27, LONGEST_WAIT];
const LONGEST_WAIT: u32 = 48;

/// Nodes that are opened at most.
const GREATEST_NODES: usize = 48;

/// Two arms that cannot be kept apart by waiting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Conflict {
    pub(super) first: usize,
    pub(super) second: usize,
}

/// The times at which an arm starts, and goes on from its rest before the approach.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Timing {
    start: f64,
    resume: Option<f64>,
    end: f64,
}

/// Which pairs of arms are kept apart by how their times lie to each other (ns), as far as that was
/// looked at; good for the legs that it was found out with.
#[derive(Debug, Default)]
pub(super) struct PairTimes(BTreeMap<(usize, usize, [i64; 3]), bool>);

impl PairTimes {
    /// Forgets what involves any of `arms`, whose legs are others now.
    pub(super) fn forget(&mut self, arms: &[usize]) {
        self.0.retain(|(first, second, _), _| !arms.contains(first) && !arms.contains(second));
    }
}

/// Finds delays under which all legs are certified apart. `known` holds what was found out about pairs
/// of these legs before, and takes in what is found out now. In haste fewer waits are tried.
pub(super) fn schedule(
    world: &CollisionWorld,
    task: &StepTask,
    legs: &[Legs],
    known: &mut PairTimes,
    is_hasty: bool,
    control: &Control,
) -> Result<StepMotion, Option<Conflict>> {
    let mut search = Search::new(world, task, legs, known);
    let root = vec![0_u32; legs.len()];
    let mut open = vec![(search.duration(&root), root)];
    let mut seen: BTreeSet<Vec<u32>> = open.iter().map(|(_, d)| d.clone()).collect();
    // The first two that no waiting parts, and else the first that meet at all.
    let (mut stuck, mut met) = (None, None);
    for _ in 0..GREATEST_NODES {
        if control.should_stop() {
            return Err(None);
        }
        let Some(best) = (0..open.len()).min_by(|&a, &b| {
            let key = |i: usize| (open[i].0, open[i].1.iter().sum::<u32>());
            let (ka, kb) = (key(a), key(b));
            ka.0.total_cmp(&kb.0).then(ka.1.cmp(&kb.1)).then(a.cmp(&b))
        }) else {
            break;
        };
        let (_, delays) = open.swap_remove(best);
        match search.first_conflict(&delays) {
            None => {
                let motion = search.compose(&delays);
                // What was looked at as it comes about now is certified; the rest was as far as the two
                // arms' times lie alike, and the whole has the last word.
                return match find_conflict_but(world, &motion, &search.certified(&delays)) {
                    None => Ok(motion),
                    conflict => Err(conflict),
                };
            }
            Some(conflict) => {
                met = met.or(Some(conflict));
                let mut they_pass = false;
                for (arm, other) in [(conflict.first, conflict.second), (conflict.second, conflict.first)] {
                    let later = |wait: u32| {
                        let mut next = delays.clone();
                        next[arm] += wait;
                        next
                    };
                    // Who is in the way even of an arm that comes when all is over, or not certified out of it, mostly is
                    // in any case.
                    let timings = search.timings(&delays);
                    let over = ((timings[other].end - timings[arm].start) / TICK).ceil().max(0.0) as u32;
                    let at_last = search.timings(&later(over.max(LONGEST_WAIT)));
                    if search.meets_at_last(conflict, arm, &at_last)
                        || !search.is_apart(conflict, &at_last, true)
                    {
                        continue;
                    }
                    let waits = if is_hasty { &HASTY_WAITS[..] } else { &WAITS[..] };
                    let until_over = Some(over).filter(|over| *over > LONGEST_WAIT);
                    let passing = waits.iter().copied().chain(until_over).find_map(|wait| {
                        let next = later(wait);
                        let timings = search.timings(&next);
                        search.is_apart(conflict, &timings, true).then_some(next)
                    });
                    they_pass |= passing.is_some();
                    if let Some(next) = passing
                        && seen.insert(next.clone())
                    {
                        open.push((search.duration(&next), next));
                    }
                }
                if !they_pass {
                    stuck = stuck.or(Some(conflict));
                }
            }
        }
    }
    Err(stuck.or(met))
}

/// Certifies a composed step: the first pair of arms that is not kept apart.
pub(super) fn find_conflict(world: &CollisionWorld, motion: &StepMotion) -> Option<Conflict> {
    find_conflict_but(world, motion, &BTreeSet::new())
}

/// The same without the pairs in `certified`.
fn find_conflict_but(
    world: &CollisionWorld,
    motion: &StepMotion,
    certified: &BTreeSet<(usize, usize)>,
) -> Option<Conflict> {
    let tables = tables(motion);
    let held: Vec<Option<&Held>> = motion.arms.iter().map(|arm| arm.held.as_ref()).collect();
    pairs(world, &held).into_iter().filter(|pair| !certified.contains(&(pair.first, pair.second))).find(
        |pair| {
            let timed = |arm: usize| {
                let motion = &motion.arms[arm];
                (arm, motion, tables[arm].get_or_init(|| CurveTable::new(&motion.curve)))
            };
            !pair_apart(world, timed(pair.first), timed(pair.second), &[(0.0, motion.duration)])
        },
    )
}

/// The pairs of arms that can come near each other at all, with what they hold.
fn pairs(world: &CollisionWorld, held: &[Option<&Held>]) -> Vec<Conflict> {
    let count = held.len();
    (0..count)
        .flat_map(|first| (first + 1..count).map(move |second| Conflict { first, second }))
        .filter(|pair| {
            let arm = |index: usize| (ArmId(index), held[index]);
            world.may_meet(arm(pair.first), arm(pair.second))
        })
        .collect()
}

/// The arms' curves for sampling, each laid out when it is first asked for.
fn tables(motion: &StepMotion) -> Vec<OnceCell<CurveTable>> {
    motion.arms.iter().map(|_| OnceCell::new()).collect()
}

/// An arm in a step, with its curve laid out for sampling.
type Timed<'a> = (usize, &'a ArmMotion, &'a CurveTable);

/// Spans of time in which the same may touch.
struct Alike {
    exemptions: (Exemption, Exemption),
    spans: Vec<(f64, f64)>,
}

/// Whether two arms are certified apart within `spans` of time.
fn pair_apart(world: &CollisionWorld, first: Timed<'_>, second: Timed<'_>, spans: &[(f64, f64)]) -> bool {
    let ((i, a, a_table), (j, b, b_table)) = (first, second);
    // What may touch is mostly the same.
    let mut alike: Vec<Alike> = Vec::new();
    for (span, first, second) in common_pieces(a, b, spans) {
        match alike.iter_mut().find(|alike| alike.exemptions == (first, second)) {
            Some(alike) => alike.spans.push(span),
            None => alike.push(Alike { exemptions: (first, second), spans: vec![span] }),
        }
    }
    alike.iter().all(|Alike { exemptions: (first, second), spans }| {
        // From the first to the last; only what is in `spans` is looked at.
        let Some(span) = spans.first().zip(spans.last()).map(|(first, last)| (first.0, last.1)) else {
            return true;
        };
        world.motions_apart_in(
            (ArmId(i), &CurveMotion { curve: &a.curve, table: a_table, span }, a.held.as_ref(), *first),
            (ArmId(j), &CurveMotion { curve: &b.curve, table: b_table, span }, b.held.as_ref(), *second),
            spans,
        )
    })
}

/// Whether two arms meet at one of a few instants: cheaper than [`pair_apart`], and a reason why that
/// must fail.
fn pair_meets(world: &CollisionWorld, first: Timed<'_>, second: Timed<'_>, spans: &[(f64, f64)]) -> bool {
    let ((i, a, a_table), (j, b, b_table)) = (first, second);
    common_pieces(a, b, spans).any(|(span, first, second)| {
        let one = Instants(CurveMotion { curve: &a.curve, table: a_table, span });
        let two = Instants(CurveMotion { curve: &b.curve, table: b_table, span });
        let (one, two): (Taking<'_>, Taking<'_>) =
            ((ArmId(i), &one, a.held.as_ref(), first), (ArmId(j), &two, b.held.as_ref(), second));
        !world.motions_apart(one, two, span)
    })
}

/// Pieces of `spans` in which neither of two arms' exemptions change, with these.
fn common_pieces(
    a: &ArmMotion,
    b: &ArmMotion,
    spans: &[(f64, f64)],
) -> impl Iterator<Item = ((f64, f64), Exemption, Exemption)> {
    let pieces = spans.iter().flat_map(move |&(from, to)| a.pieces(from, to));
    pieces.flat_map(move |(from, to, first)| {
        b.pieces(from, to).into_iter().map(move |(from, to, second)| ((from, to), first, second))
    })
}

/// When an arm moves in a step of some duration (s): all that its motion depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Moment([u64; 4]);

impl Moment {
    fn new(timing: &Timing, duration: f64) -> Self {
        Self([timing.start, timing.resume.unwrap_or(-1.0), timing.end, duration].map(f64::to_bits))
    }
}

/// An arm's motion in a step, laid out for sampling.
struct Composed {
    motion: ArmMotion,
    table: CurveTable,
    swept: Swept,
}

impl Composed {
    fn new(world: &CollisionWorld, arm: usize, motion: ArmMotion, duration: f64) -> Self {
        let (table, span) = (CurveTable::new(&motion.curve), (0.0, duration));
        let curve = CurveMotion { curve: &motion.curve, table: &table, span };
        let swept = world.sweep(ArmId(arm), &curve, motion.held.as_ref(), span);
        Self { motion, table, swept }
    }
}

struct Search<'a> {
    world: &'a CollisionWorld,
    task: &'a StepTask,
    legs: &'a [Legs],
    /// Pairs that can come near each other.
    pairs: Rc<[Conflict]>,
    /// Pairs already looked at; see [`PairTimes`].
    known: &'a mut BTreeMap<(usize, usize, [i64; 3]), bool>,
    /// By arm, the motion that was composed last, and for when.
    composed: Vec<Option<(Moment, Rc<Composed>)>>,
    /// By pair of arms, the moments for which they were certified apart last.
    apart: BTreeMap<(usize, usize), (Moment, Moment)>,
    /// By pair of arms and the one that comes after the other, whether they are seen to meet.
    at_last: BTreeMap<(usize, usize, usize), bool>,
}

impl<'a> Search<'a> {
    fn new(
        world: &'a CollisionWorld,
        task: &'a StepTask,
        legs: &'a [Legs],
        known: &'a mut PairTimes,
    ) -> Self {
        let composed = legs.iter().map(|_| None).collect();
        let held: Vec<Option<&Held>> = task.arms.iter().map(|arm| arm.held.as_ref()).collect();
        let pairs = pairs(world, &held).into();
        Self {
            world,
            task,
            legs,
            pairs,
            known: &mut known.0,
            composed,
            apart: BTreeMap::new(),
            at_last: BTreeMap::new(),
        }
    }
}

impl Search<'_> {
    fn timings(&self, delays: &[u32]) -> Vec<Timing> {
        let arms = &self.task.arms;
        // No rest is shorter than the least spacing of breakpoints.
        let dwell = |dwell: f64| if dwell > 0.0 { dwell.max(MIN_SPACING_S) } else { 0.0 };
        let mut start: Vec<f64> =
            delays.iter().zip(arms).map(|(&d, arm)| dwell(arm.dwell) + f64::from(d) * TICK).collect();
        for (i, arm) in arms.iter().enumerate() {
            if let Some(giver) = arm.wait_for {
                start[i] = start[i].max(start[giver.0] + self.legs[giver.0].through.departed);
            }
        }
        let arrives = |i: usize| start[i] + self.legs[i].through.curve.end_time();
        (0..arms.len())
            .map(|i| {
                let legs = &self.legs[i];
                let through = Timing { start: start[i], resume: None, end: arrives(i) };
                let ArmGoal::Contact { after: Some(giver), .. } = &arms[i].goal else { return through };
                let gate = arrives(giver.0);
                match (&legs.split, legs.through.approaching) {
                    (Some((before, after)), approaching)
                        if approaching.is_none_or(|begins| start[i] + begins < gate) =>
                    {
                        let resume = gate.max(start[i] + before.curve.end_time() + MIN_SPACING_S);
                        Timing { start: start[i], resume: Some(resume), end: resume + after.curve.end_time() }
                    }
                    _ => through,
                }
            })
            .collect()
    }

    fn duration(&self, delays: &[u32]) -> f64 {
        self.timings(delays).iter().map(|timing| timing.end).fold(0.0, f64::max)
    }

    fn compose(&self, delays: &[u32]) -> StepMotion {
        let timings = self.timings(delays);
        let duration = whole_duration(&timings);
        let arms = timings
            .iter()
            .zip(self.legs)
            .zip(&self.task.arms)
            .map(|((timing, legs), task)| compose_arm(timing, legs, duration, task.held))
            .collect();
        StepMotion { arms, duration }
    }

    fn first_conflict(&mut self, delays: &[u32]) -> Option<Conflict> {
        let timings = self.timings(delays);
        let pairs = Rc::clone(&self.pairs);
        pairs.iter().copied().find(|&pair| !self.is_apart(pair, &timings, false))
    }

    /// The pairs that were certified apart as they move under `delays`.
    fn certified(&self, delays: &[u32]) -> BTreeSet<(usize, usize)> {
        let timings = self.timings(delays);
        let duration = whole_duration(&timings);
        let now = |arm: usize| Moment::new(&timings[arm], duration);
        self.apart.iter().filter(|((a, b), at)| **at == (now(*a), now(*b))).map(|(pair, _)| *pair).collect()
    }

    /// An arm's motion, laid out for sampling.
    fn motion(&mut self, arm: usize, timing: &Timing, duration: f64) -> Rc<Composed> {
        let moment = Moment::new(timing, duration);
        if let Some((when, known)) = &self.composed[arm]
            && *when == moment
        {
            return known.clone();
        }
        let motion = compose_arm(timing, &self.legs[arm], duration, self.task.arms[arm].held);
        let made = Rc::new(Composed::new(self.world, arm, motion, duration));
        self.composed[arm] = Some((moment, made.clone()));
        made
    }

    /// Whether a pair of arms is kept apart. This depends on nothing but how their times lie to each
    /// other: before the one starts and after the other ends both rest. One that is in `doubt` is looked
    /// at at a few instants first.
    fn is_apart(&mut self, pair: Conflict, timings: &[Timing], doubt: bool) -> bool {
        let (a, b) = (timings[pair.first], timings[pair.second]);
        let nanoseconds = |seconds: f64| (seconds * 1e9).round() as i64;
        let pause = |timing: &Timing| timing.resume.map_or(-1, |resume| nanoseconds(resume - timing.start));
        let key = (pair.first, pair.second, [nanoseconds(b.start - a.start), pause(&a), pause(&b)]);
        if let Some(&known) = self.known.get(&key) {
            return known;
        }
        let duration = whole_duration(timings);
        let [first, second] = self.both(pair, timings);
        let spans = self.world.encounters(&first.swept, &second.swept);
        let (one, two) = (timed(pair.first, &first), timed(pair.second, &second));
        let apart = spans.is_empty()
            || !(doubt && pair_meets(self.world, one, two, &spans))
                && pair_apart(self.world, one, two, &spans);
        if apart {
            let moments = (Moment::new(&a, duration), Moment::new(&b, duration));
            self.apart.insert((pair.first, pair.second), moments);
        }
        self.known.insert(key, apart);
        apart
    }

    /// Whether a pair of arms is seen to meet at one of a few instants when `arm` comes after the other; asked once.
    fn meets_at_last(&mut self, pair: Conflict, arm: usize, timings: &[Timing]) -> bool {
        let key = (pair.first, pair.second, arm);
        if let Some(&known) = self.at_last.get(&key) {
            return known;
        }
        let meets = self.meets(pair, timings);
        self.at_last.insert(key, meets);
        meets
    }

    /// Whether a pair of arms is seen to meet at one of a few instants.
    fn meets(&mut self, pair: Conflict, timings: &[Timing]) -> bool {
        let [first, second] = self.both(pair, timings);
        let spans = self.world.encounters(&first.swept, &second.swept);
        pair_meets(self.world, timed(pair.first, &first), timed(pair.second, &second), &spans)
    }

    /// The motions of a pair.
    fn both(&mut self, pair: Conflict, timings: &[Timing]) -> [Rc<Composed>; 2] {
        let duration = whole_duration(timings);
        [pair.first, pair.second].map(|arm| self.motion(arm, &timings[arm], duration))
    }
}

fn timed(arm: usize, composed: &Composed) -> Timed<'_> {
    (arm, &composed.motion, &composed.table)
}

/// How long the step takes (s).
fn whole_duration(timings: &[Timing]) -> f64 {
    let last = timings.iter().map(|t| t.end).fold(MIN_SPACING_S, f64::max);
    // Nobody may have to wait for less than the least spacing of breakpoints.
    let crowded = timings.iter().any(|t| t.end < last && last - t.end < MIN_SPACING_S);
    if crowded { last + 2.0 * MIN_SPACING_S } else { last }
}

/// An arm's curve from 0 to `duration`: wait, leg, wait, leg, wait.
fn compose_arm(timing: &Timing, legs: &Legs, duration: f64, held: Option<Held>) -> ArmMotion {
    let (first, second) = match (&legs.split, timing.resume) {
        (Some((before, after)), Some(resume)) => (before, Some((after, resume))),
        _ => (&legs.through, None),
    };
    let approaches = second.map_or(first, |(after, _)| after).approaching.is_some();
    let mut curve = Curve::rest(&first.curve.first().q, 0.0);
    curve.wait_until(timing.start);
    let mut windows = Vec::new();
    let mut push = |curve: &mut Curve, leg: &super::legs::Leg| {
        let shift = curve.end_time();
        windows.extend(leg.windows.iter().map(|w| Window { from: w.from + shift, to: w.to + shift, ..*w }));
        // The pieces meet by construction.
        let _ = curve.append(&leg.curve);
    };
    push(&mut curve, first);
    if let Some((after, resume)) = second {
        curve.wait_until(resume);
        push(&mut curve, after);
    }
    curve.wait_until(duration);
    // An arm that waits at its contact is still, or already, where its line ends.
    for window in &mut windows {
        if window.from <= timing.start + MIN_SPACING_S && first.departed > 0.0 {
            window.from = 0.0;
        }
        if window.to + MIN_SPACING_S >= timing.end && approaches {
            window.to = duration;
        }
    }
    ArmMotion { curve, windows, held }
}
