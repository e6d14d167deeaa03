//! Motions that are certified, and which of the movers' bodies may touch.

use crate::geometry::lanes::Portable;
use crate::kinematics::Config;

use super::lanes::{Cubics, Samples};
use super::world::{CollisionWorld, Mover, Owner};

/// A motion of one arm's joints over a domain.
pub trait JointMotion: Sync {
    /// Joint values at parameter `s` (clamped to the domain).
    fn at(&self, s: f64) -> Config;

    /// For each joint a bound on how far it is from its value at the middle of `[s0, s1]` anywhere
    /// in it.
    fn deviation(&self, s0: f64, s1: f64) -> Config;

    /// The domain.
    fn span(&self) -> (f64, f64);

    /// Whether nothing moves at all.
    fn stands_still(&self) -> bool {
        false
    }

    /// The cubics that it follows, where it does: they are sampled faster.
    fn cubics(&self) -> Option<Cubics<'_>> {
        None
    }

    /// [`Self::at`] the middle of each interval and [`Self::deviation`] over it, rounded to single
    /// precision, deviations upwards.
    fn sample(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        if let Some(cubics) = self.cubics() {
            return cubics.sample::<Portable>(intervals, out);
        }
        out.values.clear();
        out.deviations.clear();
        for (lane, &(from, to)) in intervals.iter().enumerate() {
            // Lanes that are not used repeat another one.
            if lane > 0 && intervals[lane - 1] == (from, to) {
                for row in out.values.iter_mut().chain(&mut out.deviations) {
                    row[lane] = row[lane - 1];
                }
                continue;
            }
            let (values, deviations) = (self.at((from + to) / 2.0), self.deviation(from, to));
            out.values.resize(values.len(), [0.0; 8]);
            out.deviations.resize(values.len(), [0.0; 8]);
            for (joint, (value, deviation)) in values.iter().zip(&deviations).enumerate() {
                out.values[joint][lane] = *value as f32;
                out.deviations[joint][lane] = *deviation as f32 * DEVIATION_ROUND_UP;
            }
        }
    }
}

/// Deviations in single precision are rounded up by this much, relative.
const DEVIATION_ROUND_UP: f32 = 1.0 + 1e-6;

/// The straight joint segment between two configurations, over [0, 1].
#[derive(Debug, Clone)]
pub struct StraightMotion {
    from: Config,
    delta: Config,
}

impl StraightMotion {
    /// From `from` to `to`.
    pub fn new(from: &[f64], to: &[f64]) -> Self {
        Self { from: Config::from_slice(from), delta: from.iter().zip(to).map(|(a, b)| b - a).collect() }
    }

    /// No motion.
    pub fn rest(q: &[f64]) -> Self {
        Self { from: Config::from_slice(q), delta: q.iter().map(|_| 0.0).collect() }
    }
}

impl JointMotion for StraightMotion {
    fn at(&self, s: f64) -> Config {
        self.from.iter().zip(&self.delta).map(|(a, d)| a + d * s).collect()
    }

    fn deviation(&self, s0: f64, s1: f64) -> Config {
        let half = (s1 - s0) / 2.0;
        self.delta.iter().map(|d| d.abs() * half).collect()
    }

    fn span(&self) -> (f64, f64) {
        (0.0, 1.0)
    }

    fn stands_still(&self) -> bool {
        self.delta.iter().all(|d| *d == 0.0)
    }

    fn sample(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        let (mut middles, mut halves) = ([0.0; 8], [0.0; 8]);
        for (lane, (from, to)) in intervals.iter().enumerate() {
            middles[lane] = ((from + to) / 2.0) as f32;
            halves[lane] = ((to - from) / 2.0) as f32 * DEVIATION_ROUND_UP;
        }
        out.resize(self.from.len());
        let rows = out.values.iter_mut().zip(out.deviations.iter_mut());
        for ((values, deviations), (from, delta)) in rows.zip(self.from.iter().zip(&self.delta)) {
            let (from, delta) = (*from as f32, *delta as f32);
            let most = delta.abs() * DEVIATION_ROUND_UP;
            *values = middles.map(|middle| delta * middle + from);
            *deviations = halves.map(|half| most * half);
        }
    }
}

/// Straight joint segments from one waypoint to the next: the n-th over [n, n + 1].
#[derive(Debug, Clone)]
pub struct PathMotion<'a>(&'a [Config]);

impl<'a> PathMotion<'a> {
    /// Through `waypoints`, at least one, all for the same joints.
    pub fn new(waypoints: &'a [Config]) -> Self {
        Self(waypoints)
    }
}

impl PathMotion<'_> {
    /// The waypoints before and after parameter `s` and the part of the way between them.
    fn segment(&self, s: f64) -> Option<(&Config, &Config, f64)> {
        let last = self.0.len().checked_sub(1)?;
        let s = s.clamp(0.0, last as f64);
        let from = (s as usize).min(last.saturating_sub(1));
        Some((&self.0[from], &self.0[last.min(from + 1)], s - from as f64))
    }

    /// The waypoints from `s0` on and before `s1`.
    fn between(&self, s0: f64, s1: f64) -> &[Config] {
        let number = |s: f64| (s.ceil().max(0.0) as usize).min(self.0.len());
        self.0.get(number(s0)..number(s1)).unwrap_or_default()
    }
}

impl JointMotion for PathMotion<'_> {
    fn at(&self, s: f64) -> Config {
        let Some((a, b, part)) = self.segment(s) else { return Config::new() };
        a.iter().zip(b).map(|(a, b)| a + (b - a) * part).collect()
    }

    fn deviation(&self, s0: f64, s1: f64) -> Config {
        let middle = self.at((s0 + s1) / 2.0);
        let (first, last) = (self.at(s0), self.at(s1));
        let mut most: Config = middle.iter().map(|_| 0.0).collect();
        // Greatest at an end or at a waypoint between.
        for q in [&first, &last].into_iter().chain(self.between(s0, s1)) {
            for (most, (a, b)) in most.iter_mut().zip(q.iter().zip(&middle)) {
                *most = most.max((a - b).abs());
            }
        }
        most
    }

    fn span(&self) -> (f64, f64) {
        (0.0, self.0.len().saturating_sub(1) as f64)
    }

    fn stands_still(&self) -> bool {
        self.0.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// The same as of `at` and `deviation`, for intervals within one segment in single precision, as many of these together
    /// as follow each other.
    fn sample(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        out.resize(self.0.first().map_or(0, |q| q.len()));
        let mut next = 0;
        while next < intervals.len() {
            let lane = next;
            let (from, to) = intervals[lane];
            let Some(last) = self.0.len().checked_sub(1) else { return };
            let segment = (from as usize).min(last.saturating_sub(1));
            let (a, b, first) = (&self.0[segment], &self.0[last.min(segment + 1)], segment as f64);
            let is_within = |(from, to): (f64, f64)| from >= first && to <= first + 1.0;
            let count = intervals[lane..].iter().take_while(|interval| is_within(**interval)).count();
            if count > 0 {
                next = lane + count;
                let (mut parts, mut halves) = ([0.0_f32; 8], [0.0_f32; 8]);
                for (lane, (from, to)) in intervals.iter().enumerate().take(next).skip(lane) {
                    parts[lane] = ((from + to) / 2.0 - first) as f32;
                    halves[lane] = ((to - from) / 2.0) as f32 * DEVIATION_ROUND_UP;
                }
                let rows = out.values.iter_mut().zip(out.deviations.iter_mut());
                for ((values, deviations), (a, b)) in rows.zip(a.iter().zip(b)) {
                    let (from, delta) = (*a as f32, (b - a) as f32);
                    let most = delta.abs() * DEVIATION_ROUND_UP;
                    for lane in lane..next {
                        values[lane] = delta * parts[lane] + from;
                        deviations[lane] = most * halves[lane];
                    }
                }
                continue;
            }
            next = lane + 1;
            let ends = (self.segment(from), self.segment((from + to) / 2.0), self.segment(to));
            let (Some(start), Some(middle), Some(end)) = ends else { return };
            let between = self.between(from, to);
            for joint in 0..out.values.len() {
                let at = |(a, b, part): (&Config, &Config, f64)| a[joint] + (b[joint] - a[joint]) * part;
                let value = at(middle);
                let strays = [at(start), at(end)].into_iter().chain(between.iter().map(|q| q[joint]));
                let most = strays.fold(0.0, |most: f64, q| most.max((q - value).abs()));
                out.set(joint, lane, value as f32, most as f32 * DEVIATION_ROUND_UP);
            }
        }
    }
}

/// A body of a mover: one of its arm's atoms, or one of its held object's (counted after them).
pub(super) type BodyIndex = u16;

/// Several configurations, one after the other: from n on to n + 1 it stands still at the n-th.
#[derive(Debug)]
pub(super) struct Stations<'a>(pub(super) &'a [&'a [f64]]);

impl JointMotion for Stations<'_> {
    fn at(&self, s: f64) -> Config {
        self.0.get(s as usize).or(self.0.last()).map(|q| Config::from_slice(q)).unwrap_or_default()
    }

    fn deviation(&self, _: f64, _: f64) -> Config {
        self.0.first().map(|q| q.iter().map(|_| 0.0).collect()).unwrap_or_default()
    }

    fn span(&self) -> (f64, f64) {
        (0.0, self.0.len() as f64)
    }
}

impl Stations<'_> {
    /// The eight from number `first` on, the last one again where there are fewer.
    pub(super) fn sample_batch(&self, first: usize, out: &mut Samples) {
        let Some(last) = self.0.len().checked_sub(1) else { return };
        let lanes: [&[f64]; 8] = std::array::from_fn(|lane| self.0[last.min(first + lane)]);
        let joints = lanes.iter().fold(usize::MAX, |least, q| least.min(q.len()));
        out.resize(joints);
        let lanes = lanes.map(|q| &q[..joints]);
        for (joint, row) in out.values.iter_mut().enumerate() {
            for (value, q) in row.iter_mut().zip(&lanes) {
                *value = q[joint] as f32;
            }
        }
    }
}

impl Mover<'_> {
    pub(super) fn is_held(&self, body: BodyIndex) -> bool {
        usize::from(body) >= self.bodies.atoms.len()
    }

    pub(super) fn is_hand(&self, body: BodyIndex) -> bool {
        self.bodies.atoms.get(usize::from(body)).is_some_and(|atom| atom.is_hand)
    }

    /// Whether a body may touch a static one.
    pub(super) fn may_touch_world(&self, body: BodyIndex, owner: Owner, world: &CollisionWorld) -> bool {
        match owner {
            Owner::Obstacle(obstacle) => match self.bodies.atoms.get(usize::from(body)) {
                Some(atom) => world.workcell.arm_may_touch(self.arm, atom.body, obstacle),
                None => self.exemption.held_with == Some(obstacle),
            },
            Owner::Resting(object) => self.is_hand(body) && self.exemption.hand_with == Some(object),
        }
    }

    /// Whether a body may touch one of another arm.
    pub(super) fn may_touch_arm(
        &self,
        body: BodyIndex,
        other: &Mover<'_>,
        other_body: BodyIndex,
        world: &CollisionWorld,
    ) -> bool {
        let named = |mover: &Mover<'_>, body: BodyIndex| {
            mover.bodies.atoms.get(usize::from(body)).map(|atom| (mover.arm, atom.body))
        };
        if let (Some(ours), Some(theirs)) = (named(self, body), named(other, other_body)) {
            return world.workcell.arms_may_touch(ours, theirs);
        }
        // A hand that takes or has just released the object in the other arm's hand.
        let exempt = |hand: &Mover<'_>, body: BodyIndex, holder: &Mover<'_>, object: BodyIndex| {
            hand.is_hand(body)
                && holder.is_held(object)
                && holder.held.as_ref().is_some_and(|held| hand.exemption.hand_with == Some(held.object))
        };
        exempt(self, body, other, other_body) || exempt(other, other_body, self, body)
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;

    #[test]
    fn paths_are_sampled_as_they_are() {
        let mut rng = crate::run::Seed(26).stream("paths");
        for count in [1, 2, 3, 6] {
            let mut q = || (0..7).map(|_| rng.random_range(-2.0..2.0)).collect::<Config>();
            let waypoints: Vec<Config> = (0..count).map(|_| q()).collect();
            let path = PathMotion::new(&waypoints);
            let (from, to) = path.span();
            for _ in 0..50 {
                let intervals = std::array::from_fn(|_| {
                    let mut part = || rng.random_range(0.0..=1.0_f64);
                    let (a, b) = (part(), part());
                    (from + (to - from) * a.min(b), from + (to - from) * a.max(b))
                });
                let mut found = Samples::default();
                path.sample(&intervals, &mut found);
                for (lane, (s0, s1)) in intervals.into_iter().enumerate() {
                    let (values, deviations) = (path.at((s0 + s1) / 2.0), path.deviation(s0, s1));
                    for joint in 0..7 {
                        assert!((f64::from(found.values[joint][lane]) - values[joint]).abs() < 1e-6);
                        assert!(f64::from(found.deviations[joint][lane]) >= deviations[joint]);
                        assert!(
                            f64::from(found.deviations[joint][lane]) <= deviations[joint] * 1.00001 + 1e-12
                        );
                    }
                    // Nothing in between is farther away.
                    for part in 0..=10 {
                        let q = path.at(s0 + (s1 - s0) * f64::from(part) / 10.0);
                        for joint in 0..7 {
                            let stray = (q[joint] - values[joint]).abs();
                            assert!(stray <= f64::from(found.deviations[joint][lane]) + 1e-12);
                        }
                    }
                }
            }
        }
    }
}
