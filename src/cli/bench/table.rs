//! What a benchmark found, and how it is printed.

use std::fmt;
use std::time::Instant;

use serde::Serialize;

/// Rounds of each measurement; the best one counts, since whatever else runs only makes it slower.
const ROUNDS: usize = 25;

/// Nanoseconds that a round takes at least.
const ROUND_NS: u128 = 2_000_000;

/// One measurement.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Line {
    /// What was done.
    pub(super) work: &'static str,
    /// How long it took each time (ns).
    pub(super) ns: f64,
    /// How long it took the baseline (ns), where there is one.
    pub(super) baseline_ns: Option<f64>,
    /// What the baseline is.
    pub(super) baseline: Option<&'static str>,
}

/// All measurements of a run.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Table {
    /// What the kernels ran on.
    pub(super) instructions: &'static str,
    /// The measurements.
    pub(super) lines: Vec<Line>,
}

impl Table {
    /// Adds a measurement.
    pub(super) fn add(&mut self, work: &'static str, ns: f64) {
        self.lines.push(Line { work, ns, baseline_ns: None, baseline: None });
    }

    /// Adds a measurement beside that of the baseline.
    pub(super) fn compare(&mut self, work: &'static str, ns: f64, baseline: &'static str, baseline_ns: f64) {
        let (baseline_ns, baseline) = (Some(baseline_ns), Some(baseline));
        self.lines.push(Line { work, ns, baseline_ns, baseline });
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "kernels on {}, one thread, best of {ROUNDS} rounds", self.instructions)?;
        for line in &self.lines {
            write!(f, "{:<58} {:>10}", line.work, time(line.ns))?;
            if let (Some(ns), Some(name)) = (line.baseline_ns, line.baseline) {
                write!(f, "   {} {} ({:.1} x)", name, time(ns), ns / line.ns)?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// A time in its unit.
fn time(ns: f64) -> String {
    match ns {
        ns if ns < 1e3 => format!("{ns:.2} ns"),
        ns if ns < 1e6 => format!("{:.2} us", ns / 1e3),
        ns => format!("{:.2} ms", ns / 1e6),
    }
}

/// Nanoseconds that `work` takes for each of the `count` things it does.
pub(super) fn best(count: usize, mut work: impl FnMut()) -> f64 {
    let mut repeats = 1_usize;
    loop {
        let start = Instant::now();
        (0..repeats).for_each(|_| work());
        if start.elapsed().as_nanos() >= ROUND_NS || repeats > 1 << 24 {
            break;
        }
        repeats *= 2;
    }
    let mut least = f64::INFINITY;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        (0..repeats).for_each(|_| work());
        least = least.min(start.elapsed().as_nanos() as f64);
    }
    least / (repeats * count.max(1)) as f64
}
