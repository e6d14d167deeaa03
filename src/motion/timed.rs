//! Timed motions: curves with the windows in which contacts are exempt.

use crate::collision::{Cubics, Exemption, Held, JointMotion};
use crate::kinematics::Config;
use crate::trajectory::{Curve, CurveTable};

/// A span of time in which an exemption holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// From when (s).
    pub from: f64,
    /// Until when (s).
    pub to: f64,
    /// What may touch.
    pub exemption: Exemption,
}

/// One arm's motion in a step.
#[derive(Debug, Clone)]
pub struct ArmMotion {
    /// Its curve from 0 to the step's duration.
    pub curve: Curve,
    /// Exempt windows, in order, not overlapping.
    pub windows: Vec<Window>,
    /// What it holds.
    pub held: Option<Held>,
}

/// A step's motion, certified free of contact.
#[derive(Debug, Clone)]
pub struct StepMotion {
    /// By arm; all curves run from 0 to the duration.
    pub arms: Vec<ArmMotion>,
    /// Seconds.
    pub duration: f64,
}

impl ArmMotion {
    /// Pieces of `[from, to]` within which the exemption does not change.
    pub(super) fn pieces(&self, from: f64, to: f64) -> Vec<(f64, f64, Exemption)> {
        pieces(&self.windows, from, to)
    }
}

/// Pieces of `[from, to]` within which the exemption given by `windows` does not change.
pub(super) fn pieces(windows: &[Window], from: f64, to: f64) -> Vec<(f64, f64, Exemption)> {
    let mut pieces = Vec::with_capacity(2 * windows.len() + 1);
    let mut at = from;
    for window in windows {
        let (start, end) = (window.from.max(at), window.to.min(to));
        if start >= end {
            continue;
        }
        if start > at {
            pieces.push((at, start, Exemption::default()));
        }
        pieces.push((start, end, window.exemption));
        at = end;
    }
    if at < to || pieces.is_empty() {
        pieces.push((at, to, Exemption::default()));
    }
    pieces
}

/// A part of a curve as a motion to be certified.
#[derive(Debug)]
pub(super) struct CurveMotion<'a> {
    pub(super) curve: &'a Curve,
    /// The same curve for sampling.
    pub(super) table: &'a CurveTable,
    pub(super) span: (f64, f64),
}

impl JointMotion for CurveMotion<'_> {
    fn at(&self, s: f64) -> Config {
        self.curve.position_at(s)
    }

    fn deviation(&self, s0: f64, s1: f64) -> Config {
        self.curve.displacement_from((s0 + s1) / 2.0, s0, s1)
    }

    fn span(&self) -> (f64, f64) {
        self.span
    }

    fn stands_still(&self) -> bool {
        self.curve.stands_still()
    }

    fn cubics(&self) -> Option<Cubics<'_>> {
        let table = self.table;
        Some(Cubics { joints: table.joints(), times: table.times(), rows: table.rows(), instants: false })
    }
}

/// Eight instants of a part of a curve, between which it is not looked at: what meets there cannot be
/// certified, what does not may still meet in between.
#[derive(Debug)]
pub(super) struct Instants<'a>(pub(super) CurveMotion<'a>);

impl JointMotion for Instants<'_> {
    fn at(&self, s: f64) -> Config {
        self.0.at(s)
    }

    fn deviation(&self, s0: f64, s1: f64) -> Config {
        self.at((s0 + s1) / 2.0).iter().map(|_| 0.0).collect()
    }

    fn span(&self) -> (f64, f64) {
        self.0.span()
    }

    fn stands_still(&self) -> bool {
        self.0.stands_still()
    }

    fn cubics(&self) -> Option<Cubics<'_>> {
        Some(Cubics { instants: true, ..self.0.cubics()? })
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::collision::Samples;
    use crate::run::Seed;
    use crate::trajectory::CurvePoint;

    /// A curve through random points.
    fn random_curve(joints: usize, count: usize, rng: &mut crate::run::Rng) -> Curve {
        let mut t = -1.0;
        let points = (0..count).map(|_| {
            t += rng.random_range(0.05..0.7);
            let mut many =
                |size: f64| -> Config { (0..joints).map(|_| rng.random_range(-size..size)).collect() };
            CurvePoint { t, q: many(2.0), qd: many(1.5) }
        });
        Curve::new(points.collect()).unwrap()
    }

    #[test]
    fn samples_hold_what_the_curve_does() {
        let mut rng = Seed(5).stream("table");
        for case in 0..300 {
            let (joints, count) = ([1, 6, 7, 8, 11][case % 5], rng.random_range(1..30));
            let curve = random_curve(joints, count, &mut rng);
            let (table, end) = (CurveTable::new(&curve), curve.end_time());
            let motion = CurveMotion { curve: &curve, table: &table, span: (-1.0, end) };
            for _ in 0..5 {
                let intervals: [(f64, f64); 8] = std::array::from_fn(|lane| {
                    let from = rng.random_range(-1.5..end + 0.5);
                    (from, from + [1e-4, 0.05, 1.0][lane % 3])
                });
                let mut found = Samples::default();
                motion.sample(&intervals, &mut found);
                let mut still = Samples::default();
                let instants = Instants(CurveMotion { curve: &curve, table: &table, span: (-1.0, end) });
                instants.sample(&intervals, &mut still);
                assert_eq!((found.values.len(), found.deviations.len()), (joints, joints));
                for (lane, (from, to)) in intervals.into_iter().enumerate() {
                    let middle = (from + to) / 2.0;
                    let truth = curve.position_at(middle);
                    let exact = curve.displacement_from(middle, from, to);
                    for joint in 0..joints {
                        let (value, stray) =
                            (found.values[joint][lane], f64::from(found.deviations[joint][lane]));
                        assert!((f64::from(value) - truth[joint]).abs() < 1e-5);
                        assert!(stray + 1e-5 >= exact[joint], "{stray} {}", exact[joint]);
                        // And not much more on short intervals, where nearly all is velocity.
                        if to - from < 1e-3 {
                            assert!(stray < 1.2 * exact[joint] + 1e-4, "{stray} {}", exact[joint]);
                        }
                        assert_eq!((still.values[joint][lane], still.deviations[joint][lane]), (value, 0.0));
                    }
                }
            }
        }
    }
}
