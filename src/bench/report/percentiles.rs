//! Distributions side by side: a group per size, a mark per guidance.

use super::axis::{Canvas, Scale};
use super::{Family, View, digits, escape, framed};
use crate::bench::results::Run;
use crate::bench::statistics::Summary;

/// One of the charts of distributions.
pub(super) struct Chart {
    caption: &'static str,
    value: fn(&Run) -> Option<f64>,
    /// Whether equal ratios take equal room.
    ratios: bool,
}

/// The paper's: time to the first plan, duration at the end, action steps.
pub(super) const CHARTS: [Chart; 3] = [
    Chart { caption: "Time to the first plan (s)", value: |run| run.first_plan_s, ratios: true },
    Chart { caption: "Duration at the end (s)", value: |run| run.duration_s, ratios: false },
    Chart { caption: "Action steps", value: |run| run.steps.map(|steps| steps as f64), ratios: false },
];

/// Draws `chart` for `family`, over the solved runs.
pub(super) fn figure(view: &View<'_>, family: &Family, chart: &Chart) -> String {
    let values = |size: &str, guidance: &str| -> Vec<f64> {
        let runs = view.runs(family, size, guidance);
        runs.iter().filter(|run| run.solved).filter_map(|run| (chart.value)(run)).collect()
    };
    let all: Vec<f64> = family
        .sizes
        .iter()
        .flat_map(|size| view.guidances.iter().filter_map(|guidance| Summary::of(&values(size, guidance))))
        .flat_map(|summary| [summary.percentiles[0], summary.percentiles[4], summary.mean])
        .collect();
    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
    let most = all.iter().copied().fold(0.0, f64::max);
    let scale = if chart.ratios { Scale::ratios(least, most) } else { Scale::from_zero(most) };
    let mut canvas = Canvas::new(chart.caption, scale);
    for (index, size) in family.sizes.iter().enumerate() {
        let (middle, width) = canvas.band(index, family.sizes.len(), size);
        let count = view.guidances.len();
        let room = (0.8 * width / count as f64).min(30.0);
        for (place, guidance) in view.guidances.iter().enumerate() {
            let x = middle + (place as f64 - 0.5 * (count as f64 - 1.0)) * room;
            let Some(summary) = Summary::of(&values(size, guidance)) else {
                let y = canvas.floor() - 5.0;
                canvas.add(&format!(
                    "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">–<title>{size} {}: no plan</title></text>",
                    escape(guidance)
                ));
                continue;
            };
            let tip = format!("{size} {}: {}", escape(guidance), in_words(&summary));
            canvas.add(&mark(&canvas, &summary, x, 0.5 * room, place % 4, &tip));
        }
    }
    framed(chart.caption, &canvas.finish())
}

fn in_words(summary: &Summary) -> String {
    let [p10, p25, p50, p75, p90] = summary.percentiles.map(digits);
    format!(
        "median {p50}, mean {}, percentiles 10/25/75/90: {p10} / {p25} / {p75} / {p90}, {} trials",
        digits(summary.mean),
        summary.count
    )
}

fn mark(canvas: &Canvas, summary: &Summary, x: f64, width: f64, colour: usize, tip: &str) -> String {
    let [p10, p25, p50, p75, p90] = summary.percentiles.map(|value| canvas.y(value));
    let mean = canvas.y(summary.mean);
    let width = width.clamp(5.0, 14.0);
    let left = x - 0.5 * width;
    // A bar of no height would not be seen.
    let (top, height) = if p25 - p75 < 3.0 { (0.5 * (p25 + p75) - 1.5, 3.0) } else { (p75, p25 - p75) };
    let median = if height > 6.0 {
        let right = left + width;
        format!("<line class=\"median\" x1=\"{left:.1}\" x2=\"{right:.1}\" y1=\"{p50:.1}\" y2=\"{p50:.1}\"/>")
    } else {
        String::new()
    };
    format!(
        "<g class=\"s{colour}\"><title>{tip}</title>\
         <line class=\"whisker\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{p10:.1}\" y2=\"{p90:.1}\"/>\
         <rect class=\"box\" x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" rx=\"2\"/>\
         {median}<path class=\"mean\" d=\"M{x:.1} {:.1}l3.5 3.5l-3.5 3.5l-3.5 -3.5z\"/></g>",
        mean - 3.5
    )
}
