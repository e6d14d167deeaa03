//! Timed motions: curves with the windows in which contacts are exempt.

use crate::collision::{Exemption, Held, JointMotion, Samples};
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

    fn sample(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        out.resize(self.table.joints());
        let mut hint = 0;
        for (lane, interval) in intervals.iter().enumerate() {
            self.table.sample(*interval, &mut hint, |joint, value, stray| out.set(joint, lane, value, stray));
        }
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

    fn sample(&self, intervals: &[(f64, f64); 8], out: &mut Samples) {
        out.resize(self.0.table.joints());
        let mut hint = 0;
        for (lane, (from, to)) in intervals.iter().enumerate() {
            let instant = (from + to) / 2.0;
            self.0.table.sample((instant, instant), &mut hint, |joint, value, _| {
                out.set(joint, lane, value, 0.0);
            });
        }
    }
}
