//! Who looks at which part of a plan: time is cut where the pairs that count change, the pieces are gathered into spans,
//! and the spans are looked at by one thread or by several, to the same result.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

use super::arms::Arms;
use super::contact::{Closest, Inspector, Overlap, names};
use super::custody::{Custody, Timeline};
use super::scene::{Pair, Scene};
use super::straight::Window;
use super::structure::SAME_TIME;
use super::units::Units;
use super::verdict::{Clearance, Report, Rule};
use crate::run::share;

/// Instants, spread over the plan, at which a first idea of the least clearance is had.
const MOST_SEEDS: usize = 64;
/// Spans into which a plan is cut at most.
const MOST_SPANS: usize = 16;
/// All threads but one together remember so many axes at most.
const MOST_AXES: usize = 4_000_000;
/// The most work before the judge gives up, in units of about 5 ns.
const MAX_WORK: u64 = 1_000_000_000;

/// What is looked at, by however many threads.
pub(super) struct Course<'a, 'p> {
    pub scene: &'a Scene<'p>,
    pub arms: &'a Arms,
    pub units: Units,
    /// The pairs that count all the time; those of the same two units side by side.
    pub standing: Vec<Pair>,
    timeline: &'a Timeline<'p>,
    windows: &'a [Window],
    /// The times at which the pairs change, from 0 to the end.
    cuts: Vec<f64>,
    /// Work that was done.
    work: AtomicU64,
    stop: &'a (dyn Fn() -> bool + Sync),
}

/// What was found out about a span of time.
#[derive(Debug)]
pub(super) struct Found {
    /// By pair of bodies.
    pub overlaps: BTreeMap<(usize, usize), Overlap>,
    pub closest: Option<Closest>,
    /// Since when (s), where it was given up.
    pub gave_up: Option<f64>,
}

/// Certifies the whole time with up to `threads` threads, this one among them, unless `stop` ends it; reports what
/// overlaps, and gives the least clearance. How many threads there are makes no difference, but that where the work becomes
/// too much, which does not depend on them either, one may have seen more than another.
pub(super) fn check(
    scene: &mut Scene<'_>,
    timeline: &Timeline<'_>,
    windows: &[Window],
    arms: &Arms,
    threads: usize,
    stop: &(dyn Fn() -> bool + Sync),
    report: &mut Report,
) -> Option<Clearance> {
    let units = Units::new(scene);
    let mut standing = std::mem::take(&mut scene.standing);
    let scene = &*scene;
    standing.sort_by_key(|pair| (units.of(pair), pair.a, pair.b));
    let course = Course {
        scene,
        arms,
        units,
        standing,
        timeline,
        windows,
        cuts: cut_times(timeline, windows, arms.duration()),
        work: AtomicU64::new(0),
        stop,
    };
    let phases = course.phases();
    let mut first = Inspector::new(&course);
    for number in (0..phases).step_by(phases.div_ceil(MOST_SEEDS).max(1)) {
        first.seed(number);
    }
    // As many threads as have room for what each remembers of the pairs.
    let threads = threads.min(1 + MOST_AXES / first.axes().max(1));
    let (closest, work) = first.closest();
    course.go_on(work);
    let spans = phases.min(MOST_SPANS);
    let found = share(
        spans,
        threads,
        || Inspector::new(&course),
        |inspector, span| inspector.inspect(span * phases / spans..(span + 1) * phases / spans, closest),
    );
    let all = found.into_iter().reduce(Found::and_later);
    let all = all.unwrap_or(Found { overlaps: BTreeMap::new(), closest, gave_up: None });
    if all.gave_up.is_some() {
        let message = "the judge gave up on contacts: too much motion close to other bodies";
        report.add(Rule::TooLarge, all.gave_up, &[], 0.0, message);
    }
    all.tell(scene, report)
}

/// The times at which the set of pairs changes, from 0 to the end.
fn cut_times(timeline: &Timeline<'_>, windows: &[Window], end: f64) -> Vec<f64> {
    let mut cuts = vec![0.0, end];
    cuts.extend(timeline.spells.iter().flatten().map(|spell| spell.from));
    cuts.extend(windows.iter().flat_map(|window| [window.from, window.to]));
    cuts.retain(|t| (0.0..=end).contains(t));
    cuts.sort_by(f64::total_cmp);
    cuts.dedup_by(|later, earlier| *later - *earlier <= SAME_TIME);
    cuts
}

impl Course<'_, '_> {
    /// Into how many pieces time is cut.
    fn phases(&self) -> usize {
        self.cuts.len().saturating_sub(1)
    }

    /// From when to when (s) piece `number` lasts.
    pub(super) fn phase(&self, number: usize) -> (f64, f64) {
        (self.cuts[number], self.cuts[number + 1])
    }

    /// Who holds what in piece `number`, by object, and the pairs that count there for the sake of objects.
    pub(super) fn objects_in(&self, number: usize, custody: &mut Vec<Custody>, pairs: &mut Vec<Pair>) {
        let (from, to) = self.phase(number);
        let middle = 0.5 * (from + to);
        custody.clear();
        custody.extend((0..self.timeline.spells.len()).map(|object| self.timeline.at(object, middle)));
        let open: Vec<Window> =
            self.windows.iter().filter(|w| w.from <= middle && middle <= w.to).copied().collect();
        self.scene.object_pairs(custody, &open, |arm| self.arms.chain(arm), pairs);
    }

    /// Takes note of `work` that was done; whether to go on.
    pub(super) fn go_on(&self, work: u64) -> bool {
        let before = self.work.fetch_add(work, Ordering::Relaxed);
        before + work <= MAX_WORK && !(self.stop)()
    }
}

impl Found {
    /// This, and what was found in a later span.
    fn and_later(mut self, later: Self) -> Self {
        for (bodies, overlap) in later.overlaps {
            self.overlaps.entry(bodies).and_modify(|known| known.join(&overlap)).or_insert(overlap);
        }
        if let Some(new) = later.closest
            && self.closest.is_none_or(|known| new.distance < known.distance)
        {
            self.closest = Some(new);
        }
        self.gave_up = self.gave_up.or(later.gave_up);
        self
    }

    /// Reports the overlaps and gives the least clearance.
    fn tell(self, scene: &Scene<'_>, report: &mut Report) -> Option<Clearance> {
        for (&bodies, overlap) in &self.overlaps {
            let names = names(scene, bodies, overlap.parts);
            let bodies = [names[0].as_str(), names[1].as_str()];
            let (rule, message) = if overlap.decided {
                let message =
                    format!("they overlap by {:.2} mm at t={:.3} s", overlap.depth * 1e3, overlap.deepest);
                (Rule::Collision, message)
            } else {
                let message = format!(
                    "at a distance of {:.2} mm it cannot be shown that they do not overlap by more than 2 mm",
                    -overlap.depth * 1e3
                );
                (Rule::CollisionUndecided, message)
            };
            report.add(rule, Some(overlap.first), &bodies, overlap.depth, message);
        }
        self.closest.map(|closest| Clearance {
            distance_m: closest.distance,
            t: closest.t,
            bodies: names(scene, closest.bodies, closest.parts),
        })
    }
}
