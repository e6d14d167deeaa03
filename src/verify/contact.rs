//! Continuous collision: that no pair of bodies overlaps at any time, with a proof.
//!
//! Time is cut where the set of exempt pairs changes. On an interval, the distance of two bodies
//! in its middle less the most that either can have moved from there bounds their distance
//! throughout; where that does not clear the pair, the interval is cut, in two or in more pieces where two
//! would hardly do. Every arm's frames are computed once per interval for all pairs that are still open
//! there. Pairs of the same two arms stand side by side, so that boxes around all that an arm sweeps
//! clear many of them at once.

use std::collections::BTreeMap;
use std::ops::Range;

use super::custody::Custody;
use super::gap::{Frame, Part, gap, lower_along};
use super::scene::{Owner, Pair, Scene};
use super::spans::{Course, Found};
use super::units::Bounds;
use crate::geometry::Vec3;

/// Contact is an overlap deeper than this (m).
const TOLERANCE: f64 = 2e-3;
/// What is still open at a motion bound of this (m) is undecided.
const UNDECIDED: f64 = 1e-4;
/// The least clearance is found to this (m).
const CLEARANCE_STEP: f64 = 1e-3;
/// Overlaps are followed down to intervals of this length (s), for their start and depth.
const FOLLOW: f64 = 0.01;
/// No interval is halved below this length (s).
const SHORTEST: f64 = 1e-9;
/// Work, in units of about 5 ns, between two looks at whether to stop.
const STOP_PERIOD: u64 = 100_000;
/// What a query, and an arm's frames, cost in these units.
const QUERY_WORK: u64 = 60;
const FRAMES_WORK: u64 = 100;
/// Pairs of bodies of more parts than this do without remembered axes.
const MAX_AXES: usize = 64;
/// An interval is cut in at most so many at once.
const MOST_CUTS: f64 = 8.0;
/// Runs of pairs of the same two units from this length on are looked at as a whole first.
const LEAST_RUN: usize = 4;

/// An overlap of two bodies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlap {
    /// The parts that overlap most.
    pub parts: (usize, usize),
    /// Since when (s).
    pub first: f64,
    /// When it is deepest (s), and how deep that is (m).
    pub deepest: f64,
    pub depth: f64,
    /// Whether it is certain.
    pub decided: bool,
}

impl Overlap {
    /// Makes one of this and `new`, an overlap of the same two bodies.
    pub(super) fn join(&mut self, new: &Self) {
        self.first = self.first.min(new.first);
        self.decided |= new.decided;
        if new.depth > self.depth {
            (self.depth, self.deepest, self.parts) = (new.depth, new.deepest, new.parts);
        }
    }
}

/// The closest that a counted pair was seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Closest {
    /// How close (m).
    pub distance: f64,
    /// When (s).
    pub t: f64,
    pub bodies: (usize, usize),
    pub parts: (usize, usize),
}

/// What is known of two bodies at the middle of an interval.
#[derive(Debug, Clone, Copy)]
struct Apart {
    lower: f64,
    estimate: f64,
    parts: (usize, usize),
}

/// Where one body is at the middle of an interval.
#[derive(Debug, Clone)]
struct Place {
    /// For which interval this holds.
    stamp: u64,
    frame: Frame,
    centre: Vec3,
    /// Motion bounds, as [`super::chain::Chain::motion_bounds`] gives them.
    bounds: Vec<f64>,
}

/// Where one arm is at the middle of an interval.
#[derive(Debug, Clone, Default)]
struct ArmPlace {
    stamp: u64,
    q: Vec<f64>,
    frames: Vec<Frame>,
    excursions: Vec<f64>,
}

/// One thread's look at a plan.
pub(super) struct Inspector<'a, 'p> {
    course: &'a Course<'a, 'p>,
    scene: &'a Scene<'p>,
    custody: Vec<Custody>,
    /// The pairs that count for the sake of objects; their numbers follow those of the pairs that count all the time.
    pairs: Vec<Pair>,
    /// By unit, the box around all that it sweeps, and for which interval.
    boxes: Vec<(u64, Bounds)>,
    /// By pair: where its axes start in `axes`.
    axes_at: Vec<Option<usize>>,
    axes: Vec<Vec3>,
    /// How many of the axes are of pairs that count all the time.
    standing_axes: usize,
    places: Vec<Place>,
    arm_places: Vec<ArmPlace>,
    stamp: u64,
    spare: Vec<Vec<usize>>,
    /// By pair of bodies.
    overlaps: BTreeMap<(usize, usize), Overlap>,
    closest: Option<Closest>,
    /// Work that the others do not know of yet.
    work: u64,
}

/// The signed distance (m) of two bodies at these frames.
#[cfg(test)]
pub(super) fn least_distance(
    a: &super::scene::Body,
    at: &Frame,
    b: &super::scene::Body,
    b_at: &Frame,
) -> f64 {
    let pairs = a.parts.iter().flat_map(|part| b.parts.iter().map(move |other| (part, other)));
    pairs.map(|(part, other)| gap(part, at, other, b_at, f64::MAX).estimate).fold(f64::INFINITY, f64::min)
}

impl<'a, 'p> Inspector<'a, 'p> {
    /// One that has looked at nothing of `course`.
    pub(super) fn new(course: &'a Course<'a, 'p>) -> Self {
        let scene = course.scene;
        let place = Place { stamp: 0, frame: Frame::identity(), centre: Vec3::zeros(), bounds: Vec::new() };
        let mut new = Self {
            course,
            scene,
            custody: Vec::new(),
            pairs: Vec::new(),
            boxes: vec![(0, Bounds::empty()); course.units.len()],
            axes_at: Vec::new(),
            axes: Vec::new(),
            standing_axes: 0,
            places: vec![place; scene.bodies.len()],
            arm_places: vec![ArmPlace::default(); course.arms.len()],
            stamp: 0,
            spare: Vec::new(),
            overlaps: BTreeMap::new(),
            closest: None,
            work: 0,
        };
        new.remember_axes(&course.standing);
        new.standing_axes = new.axes.len();
        new
    }

    /// The closest counted pair so far, and the work that it took.
    pub(super) fn closest(self) -> (Option<Closest>, u64) {
        (self.closest, self.work)
    }

    /// How many axes are remembered for pairs that count all the time.
    pub(super) fn axes(&self) -> usize {
        self.standing_axes
    }

    /// Certifies the pieces of time in `phases`, with `closest` known before. The same comes out whatever was looked at
    /// before.
    pub(super) fn inspect(&mut self, phases: Range<usize>, closest: Option<Closest>) -> Found {
        self.closest = closest;
        self.axes[..self.standing_axes].fill(Vec3::zeros());
        self.work += self.standing_axes as u64 / 2;
        let (begin, _) = self.course.phase(phases.start);
        let mut goes_on = self.course.go_on(0);
        for number in phases {
            if !goes_on {
                break;
            }
            self.enter(number);
            let (from, to) = self.course.phase(number);
            let all: Vec<usize> = (0..self.count()).collect();
            goes_on = self.certify(from, to, &all);
        }
        goes_on &= self.course.go_on(std::mem::take(&mut self.work));
        let gave_up = (!goes_on).then_some(begin);
        Found { overlaps: std::mem::take(&mut self.overlaps), closest: self.closest, gave_up }
    }

    /// Turns to the pairs that count in piece `number`.
    fn enter(&mut self, number: usize) {
        self.axes_at.truncate(self.course.standing.len());
        self.axes.truncate(self.standing_axes);
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.clear();
        self.course.objects_in(number, &mut self.custody, &mut pairs);
        self.remember_axes(&pairs);
        self.pairs = pairs;
    }

    /// How many pairs count.
    fn count(&self) -> usize {
        self.course.standing.len() + self.pairs.len()
    }

    /// The pair of this number.
    #[inline]
    fn pair(&self, index: usize) -> &Pair {
        let standing = &self.course.standing;
        standing.get(index).unwrap_or_else(|| &self.pairs[index - standing.len()])
    }

    /// Makes room for the axes of further `pairs`.
    fn remember_axes(&mut self, pairs: &[Pair]) {
        for pair in pairs {
            let count = self.scene.bodies[pair.a].parts.len() * self.scene.bodies[pair.b].parts.len();
            if count <= MAX_AXES {
                self.axes_at.push(Some(self.axes.len()));
                self.axes.resize(self.axes.len() + count, Vec3::zeros());
            } else {
                self.axes_at.push(None);
            }
        }
    }

    /// Brings `places[body]` to the middle of `[a, b]`.
    fn place(&mut self, body: usize, a: f64, b: f64) {
        if self.places[body].stamp == self.stamp {
            return;
        }
        let it = &self.scene.bodies[body];
        let (carrier, grip) = match it.owner {
            Owner::Arm { arm, node } => (Some((arm, node)), None),
            Owner::Obstacle(_) => (None, None),
            Owner::Object(object) => match self.custody[object] {
                Custody::Resting { .. } => (None, None),
                Custody::Held { arm, grip } => {
                    let chain = self.course.arms.chain(arm.0);
                    (Some((arm.0, chain.mount())), Some(chain.tcp().compose(&grip)))
                }
            },
        };
        let place = &mut self.places[body];
        place.stamp = self.stamp;
        let Some((arm, node)) = carrier else {
            place.frame = match it.owner {
                Owner::Obstacle(obstacle) => Frame::of(self.scene.obstacle_pose(obstacle)),
                Owner::Object(object) => match self.custody[object] {
                    Custody::Resting { frame, .. } => frame,
                    Custody::Held { .. } => place.frame,
                },
                Owner::Arm { .. } => place.frame,
            };
            place.centre = place.frame.apply(&it.centre);
            place.bounds.clear();
            place.bounds.push(0.0);
            return;
        };
        let arm_place = &mut self.arm_places[arm];
        if arm_place.stamp != self.stamp {
            arm_place.stamp = self.stamp;
            let ArmPlace { q, frames, excursions, .. } = arm_place;
            let segments = self.course.arms.place(arm, a, b, q, frames, excursions);
            self.work += FRAMES_WORK + 20 * segments;
        }
        let chain = self.course.arms.chain(arm);
        place.frame = match grip {
            Some(grip) => arm_place.frames[node].compose(&grip),
            None => arm_place.frames[node],
        };
        place.centre = place.frame.apply(&it.centre);
        place.bounds.resize(chain.depth(node) + 1, 0.0);
        chain.motion_bounds(
            node,
            &place.centre,
            it.radius,
            &arm_place.frames,
            &arm_place.excursions,
            &mut place.bounds,
        );
    }

    /// The distance of a pair in the middle, exact enough to see that it exceeds `enough` or how
    /// much it is below.
    fn apart(&mut self, index: usize, enough: f64) -> Apart {
        let pair = *self.pair(index);
        let scene = self.scene;
        let (a, b) = (&scene.bodies[pair.a], &scene.bodies[pair.b]);
        let (at, other_at) = (self.places[pair.a].frame, self.places[pair.b].frame);
        let mut apart = Apart { lower: f64::INFINITY, estimate: f64::INFINITY, parts: (0, 0) };
        if let Some(runs) = scene.parts_of(&pair) {
            let parts = runs
                .iter()
                .flat_map(|(one, other)| one.clone().flat_map(move |i| other.clone().map(move |j| (i, j))));
            for (i, j) in parts {
                self.work += 1;
                let (part, other) = (&a.parts[i], &b.parts[j]);
                let far = (at.apply(&part.centre) - other_at.apply(&other.centre)).norm();
                let far = far - part.radius - other.radius;
                if far > enough {
                    apart.lower = apart.lower.min(far);
                } else {
                    self.parts_apart(
                        (index, i * b.parts.len() + j),
                        ((i, j), part, other),
                        enough,
                        &mut apart,
                    );
                }
            }
            apart.estimate = apart.estimate.max(apart.lower);
            return apart;
        }
        let centres: Vec<Vec3> = if a.parts.len() * b.parts.len() > 1 {
            b.parts.iter().map(|part| other_at.apply(&part.centre)).collect()
        } else {
            Vec::new()
        };
        for (i, part) in a.parts.iter().enumerate() {
            let centre = at.apply(&part.centre);
            for (j, other) in b.parts.iter().enumerate() {
                self.work += 1;
                if let Some(other_centre) = centres.get(j) {
                    let far = (centre - other_centre).norm() - part.radius - other.radius;
                    if far > enough {
                        apart.lower = apart.lower.min(far);
                        continue;
                    }
                }
                self.parts_apart((index, i * b.parts.len() + j), ((i, j), part, other), enough, &mut apart);
            }
        }
        apart.estimate = apart.estimate.max(apart.lower);
        apart
    }

    /// Looks closely at two parts of pair `index`, whose axis is the one of that number, and notes their distance in `apart`.
    fn parts_apart(
        &mut self,
        (index, number): (usize, usize),
        (numbers, part, other): ((usize, usize), &Part, &Part),
        enough: f64,
        apart: &mut Apart,
    ) {
        let pair = *self.pair(index);
        let (at, other_at) = (self.places[pair.a].frame, self.places[pair.b].frame);
        let slot = self.axes_at[index].map(|start| start + number);
        if let Some(slot) = slot
            && self.axes[slot] != Vec3::zeros()
        {
            let far = lower_along(part, &at, other, &other_at, &self.axes[slot]);
            if far > enough {
                apart.lower = apart.lower.min(far);
                return;
            }
        }
        self.work += QUERY_WORK;
        let found = gap(part, &at, other, &other_at, enough);
        if let Some(slot) = slot {
            self.axes[slot] = found.axis;
        }
        apart.lower = apart.lower.min(found.lower);
        if found.estimate < apart.estimate {
            apart.estimate = found.estimate;
            apart.parts = numbers;
        }
    }

    /// A first idea of the least clearance, from the beginning of piece `number`.
    pub(super) fn seed(&mut self, number: usize) {
        self.enter(number);
        let (t, _) = self.course.phase(number);
        self.stamp += 1;
        let all: Vec<usize> = (0..self.count()).filter(|&index| self.pair(index).counted).collect();
        let near = self.sift((t, t), &all, self.least());
        for &index in &near {
            self.look_closer(index, t);
        }
        self.spare.push(near);
    }

    /// The least distance (m) of a counted pair so far.
    fn least(&self) -> f64 {
        self.closest.map_or(f64::INFINITY, |closest| closest.distance)
    }

    /// Those of the pairs in `open` that may come to within `target` (m) in `[a, b]` as far as boxes
    /// around their units tell.
    fn sift(&mut self, (a, b): (f64, f64), open: &[usize], target: f64) -> Vec<usize> {
        let mut kept = self.spare.pop().unwrap_or_default();
        kept.clear();
        let units = |it: &Self, index: usize| it.course.units.of(it.pair(index));
        let mut rest = open;
        while let Some(&first) = rest.first() {
            let (one, two) = units(self, first);
            let count = rest.iter().take_while(|&&index| units(self, index) == (one, two)).count();
            let (run, after) = rest.split_at(count);
            rest = after;
            if one == two || run.len() < LEAST_RUN {
                kept.extend_from_slice(run);
                continue;
            }
            self.work += 1;
            let (swept, other) = (self.swept(one, a, b), self.swept(two, a, b));
            if swept.distance(&other) > target {
                continue;
            }
            for of_body in run.chunk_by(|&x, &y| self.pair(x).a == self.pair(y).a) {
                if of_body.len() >= LEAST_RUN {
                    let place = &self.places[self.pair(of_body[0]).a];
                    let needs = self.scene.bodies[self.pair(of_body[0]).a].radius
                        + place.bounds.first().copied().unwrap_or(0.0);
                    if other.distance_to(&place.centre) - needs > target {
                        continue;
                    }
                }
                kept.extend_from_slice(of_body);
            }
        }
        kept
    }

    /// The box around all bodies of a unit over `[a, b]`, each as a ball.
    fn swept(&mut self, unit: usize, a: f64, b: f64) -> Bounds {
        let (stamp, known) = self.boxes[unit];
        if stamp == self.stamp {
            return known;
        }
        let mut bounds = Bounds::empty();
        for member in 0..self.course.units.members(unit).len() {
            let body = self.course.units.members(unit)[member];
            self.place(body, a, b);
            if let Some(still) = self.course.units.still(body) {
                bounds = *still;
                continue;
            }
            let place = &self.places[body];
            let motion = place.bounds.first().copied().unwrap_or(0.0);
            bounds.add_ball(&place.centre, self.scene.bodies[body].radius + motion);
        }
        self.boxes[unit] = (self.stamp, bounds);
        bounds
    }

    /// Takes note of a counted pair at the instant `t` alone, if it is the closest so far.
    fn look_closer(&mut self, index: usize, t: f64) {
        let pair = *self.pair(index);
        self.place(pair.a, t, t);
        self.place(pair.b, t, t);
        self.work += 1;
        let least = self.least();
        if self.coarse_distance(&pair) < least {
            let apart = self.apart(index, least);
            self.note(&pair, &apart, t);
        }
    }

    /// Remembers the closest counted pair.
    fn note(&mut self, pair: &Pair, apart: &Apart, t: f64) {
        if pair.counted && apart.estimate < self.least() {
            let bodies = (pair.a, pair.b);
            self.closest = Some(Closest { distance: apart.estimate, t, bodies, parts: apart.parts });
        }
    }

    /// A lower bound (m) on the signed distance of a pair in the middle: that of their balls or, of an
    /// obstacle, from the box around it.
    fn coarse_distance(&self, pair: &Pair) -> f64 {
        let ball = |body: usize| (&self.places[body].centre, self.scene.bodies[body].radius);
        let ((one, radius), (two, other_radius)) = (ball(pair.a), ball(pair.b));
        let mut apart = (one - two).norm() - radius - other_radius;
        if let Some(still) = self.course.units.still(pair.b) {
            apart = apart.max(still.distance_to(one) - radius);
        }
        if let Some(still) = self.course.units.still(pair.a) {
            apart = apart.max(still.distance_to(two) - other_radius);
        }
        apart
    }

    /// Certifies the pairs in `open` over `[from, to]`; `false` when the work became too much.
    fn certify(&mut self, from: f64, to: f64, open: &[usize]) -> bool {
        self.stamp += 1;
        let middle = 0.5 * (from + to);
        let near = self.sift((from, to), open, (self.least() - CLEARANCE_STEP).max(-TOLERANCE));
        let mut still_open = self.spare.pop().unwrap_or_default();
        still_open.clear();
        // By how much the motion exceeds what would clear a pair, at least.
        let mut excess = f64::INFINITY;
        self.work += near.len() as u64;
        for &index in &near {
            let pair = *self.pair(index);
            self.place(pair.a, from, to);
            self.place(pair.b, from, to);
            let bound = |place: &Place| place.bounds.get(pair.common).copied().unwrap_or(0.0);
            let motion = bound(&self.places[pair.a]) + bound(&self.places[pair.b]);
            let least = self.least();
            // Counted pairs are followed further where they may come closer than any before.
            let target = if pair.counted { (least - CLEARANCE_STEP).max(-TOLERANCE) } else { -TOLERANCE };
            let far = self.coarse_distance(&pair);
            if far - motion > target {
                continue;
            }
            // While the motion is large against the bodies, looking closely is in vain.
            let reach = self.scene.bodies[pair.a].radius.min(self.scene.bodies[pair.b].radius);
            if motion > far.max(0.0) + reach && to - from > FOLLOW {
                excess = excess.min(motion / (far.max(0.0) + reach));
                still_open.push(index);
                continue;
            }
            let enough = if pair.counted { (target + motion).max(least) } else { target + motion };
            let apart = self.apart(index, enough);
            self.note(&pair, &apart, middle);
            if apart.lower - motion > target {
                continue;
            }
            if apart.lower - motion > -TOLERANCE {
                // Free of contact; only the clearance asks for more.
                if motion > CLEARANCE_STEP && to - from > SHORTEST {
                    excess = excess.min(motion / (apart.lower - target).max(CLEARANCE_STEP));
                    still_open.push(index);
                }
            } else if apart.estimate <= -TOLERANCE {
                let since = if motion <= UNDECIDED { from } else { middle };
                self.overlap(&pair, &apart, since, true);
                if to - from > FOLLOW && motion > UNDECIDED {
                    excess = 1.0;
                    still_open.push(index);
                }
            } else if motion <= UNDECIDED || to - from <= SHORTEST {
                self.overlap(&pair, &apart, from, false);
            } else {
                excess = excess.min(motion / (apart.lower - target).max(UNDECIDED));
                still_open.push(index);
            }
        }
        self.spare.push(near);
        let done = if self.is_over() {
            false
        } else {
            // Motion shrinks about as the interval does: fewer pieces would hardly clear a pair.
            let pieces =
                if still_open.is_empty() { 0.0 } else { excess.log2().floor().exp2().clamp(2.0, MOST_CUTS) };
            let edge = |n: f64| if n < pieces { from + (to - from) * (n / pieces) } else { to };
            (0..pieces as usize).all(|n| self.certify(edge(n as f64), edge(n as f64 + 1.0), &still_open))
        };
        self.spare.push(still_open);
        done
    }

    fn is_over(&mut self) -> bool {
        self.work > STOP_PERIOD && !self.course.go_on(std::mem::take(&mut self.work))
    }

    /// Remembers an overlap; one for each pair of bodies.
    fn overlap(&mut self, pair: &Pair, apart: &Apart, t: f64, decided: bool) {
        let (depth, parts) = (-apart.estimate, apart.parts);
        let new = Overlap { parts, first: t, deepest: t, depth, decided };
        self.overlaps.entry((pair.a, pair.b)).and_modify(|known| known.join(&new)).or_insert(new);
    }
}

/// The names of two parts of two bodies.
pub(super) fn names(scene: &Scene<'_>, bodies: (usize, usize), parts: (usize, usize)) -> [String; 2] {
    let name = |body: usize, part: usize| scene.bodies[body].names.get(part).cloned().unwrap_or_default();
    [name(bodies.0, parts.0), name(bodies.1, parts.1)]
}
