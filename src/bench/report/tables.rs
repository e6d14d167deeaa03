//! The figures as tables.

use std::fmt::Write as _;

use super::{Family, View, digits, escape};
use crate::bench::results::{Phases, Results, Run};
use crate::bench::statistics::{Summary, median};

/// A row per family, size and guidance.
pub(super) fn overview(view: &View<'_>) -> String {
    let head = [
        "solved",
        "candidate, median (s)",
        "first plan, median (s)",
        "mean",
        "90 %",
        "steps, median",
        "optimum",
        "actions, median",
        "first duration, median (s)",
        "duration at the end, median (s)",
        "mean",
        "over its lower bound, median",
        "memory, most (MB)",
    ];
    let row = |runs: &[&Run]| -> Vec<String> {
        let of = |value: fn(&Run) -> Option<f64>| values(runs, value);
        let middle = |value: fn(&Run) -> Option<f64>| text(median(&of(value)));
        let first = Summary::of(&of(|run| run.first_plan_s));
        let duration = Summary::of(&of(|run| run.duration_s));
        let memory = runs.iter().filter_map(|run| run.peak_rss_mb).reduce(f64::max);
        vec![
            format!("{}/{}", runs.iter().filter(|run| run.solved).count(), runs.len()),
            middle(|run| run.candidate_s),
            text(first.map(|summary| summary.median())),
            text(first.map(|summary| summary.mean)),
            text(first.map(|summary| summary.percentiles[4])),
            middle(|run| run.steps.map(|steps| steps as f64)),
            range(runs.iter().filter_map(|run| run.mode_graph_optimum)),
            middle(|run| run.actions.map(|actions| actions as f64)),
            middle(|run| run.duration_first_s),
            text(duration.map(|summary| summary.median())),
            text(duration.map(|summary| summary.mean)),
            middle(Run::duration_ratio),
            text(memory),
        ]
    };
    table(view, &head, row)
}

/// Medians of the phases on the way to the first plan, of solved runs.
pub(super) fn phases(view: &View<'_>) -> String {
    let head =
        Phases::NAMES.map(|name| format!("{}, median (ms)", name.trim_end_matches("_s").replace('_', " ")));
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    table(view, &head, |runs| {
        (0..Phases::NAMES.len())
            .map(|index| {
                let solved = runs.iter().filter(|run| run.solved);
                let ms: Vec<f64> =
                    solved.filter_map(|run| run.phases.values()[index].map(|s| 1e3 * s)).collect();
                text(median(&ms))
            })
            .collect()
    })
}

/// Runs without a plan, and candidates that the judge rejected.
pub(super) fn remarks(results: &Results) -> String {
    if results.remarks.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<h2>Runs of which there is more to say</h2>\n<div class=\"wide\"><table>\n<thead><tr>\
         <th class=\"text\">run</th><th>trial</th><th>rejected candidates</th><th class=\"text\">without a plan \
         because</th></tr></thead>\n<tbody>\n",
    );
    for remark in &results.remarks {
        let _ = writeln!(
            out,
            "<tr><td class=\"text\">{}/{} {}</td><td>{}</td><td>{}</td><td class=\"text long\">{}</td></tr>",
            escape(&remark.family),
            escape(&remark.size),
            escape(&remark.guidance),
            remark.trial,
            remark.rejected,
            escape(remark.cause.as_deref().unwrap_or("")),
        );
    }
    out.push_str("</tbody>\n</table></div>\n");
    out
}

fn values(runs: &[&Run], value: fn(&Run) -> Option<f64>) -> Vec<f64> {
    runs.iter().filter(|run| run.solved).filter_map(|run| value(run)).collect()
}

fn text(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), digits)
}

/// `6` or `5 to 7`.
fn range(values: impl Iterator<Item = usize> + Clone) -> String {
    match (values.clone().min(), values.max()) {
        (Some(least), Some(most)) if least < most => format!("{least} to {most}"),
        (Some(least), _) => least.to_string(),
        _ => "–".to_owned(),
    }
}

fn table(view: &View<'_>, head: &[&str], row: impl Fn(&[&Run]) -> Vec<String>) -> String {
    let mut out = String::from("<div class=\"wide\"><table>\n<thead><tr><th class=\"text\">case</th>");
    out.push_str("<th class=\"text\">guidance</th>");
    for name in head {
        let _ = write!(out, "<th>{}</th>", broken(name));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    let rows = view.families.iter().flat_map(|family: &Family| {
        let sizes = family.sizes.iter();
        sizes.flat_map(move |size| view.guidances.iter().map(move |guidance| (family, size, guidance)))
    });
    for (family, size, guidance) in rows {
        let runs = view.runs(family, size, guidance);
        if runs.is_empty() {
            continue;
        }
        let _ = write!(
            out,
            "<tr><td class=\"text\">{}/{}</td><td class=\"text\">{}</td>",
            escape(&family.name),
            escape(size),
            escape(guidance)
        );
        for cell in row(&runs) {
            let _ = write!(out, "<td>{}</td>", escape(&cell));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody>\n</table></div>\n");
    out
}

/// A column's name, with a new line for what follows a comma.
fn broken(name: &str) -> String {
    escape(name).replace(", ", ",<br>")
}
