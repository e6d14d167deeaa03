//! How good the plan in hand is, over time.

use super::axis::{Canvas, Scale};
use super::{Family, View, digits, escape, framed};
use crate::bench::results::Run;
use crate::bench::statistics::percentile;

/// Instants at which the curves are drawn.
const INSTANTS: usize = 120;

/// Median over the trials (and percentiles 25 to 75 behind it) of the duration of the plan in hand. A
/// trial without a plan counts as endless, so a curve begins when half of the trials have one.
pub(super) fn figure(view: &View<'_>, family: &Family, size: &str) -> String {
    let runs: Vec<(usize, &str, Vec<&Run>)> = view
        .guidances
        .iter()
        .enumerate()
        .map(|(place, guidance)| (place, guidance.as_str(), view.runs(family, size, guidance)))
        .collect();
    let all = || runs.iter().flat_map(|(_, _, runs)| runs.iter().flat_map(|run| &run.incumbents));
    let caption = format!("{size}: duration (s) of the plan in hand after t seconds");
    if all().next().is_none() {
        return framed(&caption, "<p>No plan was found.</p>\n");
    }
    let first = all().map(|(t, _)| *t).fold(f64::INFINITY, f64::min);
    let time = Scale::ratios(first, view.results.setup.budget_s);
    let instants: Vec<f64> = (0..=INSTANTS).map(|k| time.value(k as f64 / INSTANTS as f64)).collect();
    let curves: Vec<(usize, &str, [Vec<f64>; 3])> = runs
        .iter()
        .map(|(place, guidance, runs)| {
            let at = |share: f64| instants.iter().map(|t| percentile_at(runs, *t, share)).collect();
            (*place, *guidance, [at(0.25), at(0.5), at(0.75)])
        })
        .collect();
    let shown: Vec<f64> =
        curves.iter().flat_map(|(_, _, at)| at.iter().flatten().copied()).filter(|d| d.is_finite()).collect();
    let least = shown.iter().copied().fold(f64::INFINITY, f64::min);
    let most = shown.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let scale = if shown.is_empty() { Scale::from_zero(1.0) } else { Scale::around(least, most) };
    let mut canvas = Canvas::new(&caption, scale);
    canvas.horizontal(&time);
    for (place, guidance, [low, middle, high]) in &curves {
        let line = steps(&canvas, &time, &instants, middle);
        let band = band(&canvas, &time, &instants, low, high);
        let last = middle.last().copied().unwrap_or(f64::INFINITY);
        let tip = format!("{}: median {} s at the end", escape(guidance), digits(last));
        canvas.add(&format!(
            "<g class=\"s{}\"><title>{tip}</title><path class=\"band\" d=\"{band}\"/>\
             <path class=\"line\" d=\"{line}\"/></g>",
            place % 4
        ));
    }
    framed(&caption, &canvas.finish())
}

/// The duration of the plan in hand at `t`, infinite without one.
fn in_hand(run: &Run, t: f64) -> f64 {
    let found = run.incumbents.iter().take_while(|(at, _)| *at <= t).last();
    found.map_or(f64::INFINITY, |(_, duration)| *duration)
}

fn percentile_at(runs: &[&Run], t: f64, share: f64) -> f64 {
    let values: Vec<f64> = runs.iter().map(|run| in_hand(run, t)).collect();
    percentile(&values, share).unwrap_or(f64::INFINITY)
}

/// A path along the finite values.
fn steps(canvas: &Canvas, time: &Scale, instants: &[f64], values: &[f64]) -> String {
    let mut path = String::new();
    for (t, value) in instants.iter().zip(values).filter(|(_, value)| value.is_finite()) {
        let (x, y) = (canvas.x(time, *t), canvas.y(*value));
        path.push_str(&if path.is_empty() { format!("M{x:.1} {y:.1}") } else { format!("H{x:.1}V{y:.1}") });
    }
    path
}

/// The area between two curves where both are finite.
fn band(canvas: &Canvas, time: &Scale, instants: &[f64], low: &[f64], high: &[f64]) -> String {
    let both: Vec<(f64, f64, f64)> = instants
        .iter()
        .zip(low.iter().zip(high))
        .filter(|(_, (low, high))| low.is_finite() && high.is_finite())
        .map(|(t, (low, high))| (*t, *low, *high))
        .collect();
    let point = |t: f64, value: f64| format!("{:.1} {:.1}", canvas.x(time, t), canvas.y(value));
    let there = both.iter().map(|(t, low, _)| point(*t, *low));
    let back = both.iter().rev().map(|(t, _, high)| point(*t, *high));
    let points: Vec<String> = there.chain(back).collect();
    if points.is_empty() { String::new() } else { format!("M{}z", points.join("L")) }
}
