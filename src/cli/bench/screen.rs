//! What is seen on stderr while runs go on: a line per case and guidance, and on a terminal a bar.

use std::io::{IsTerminal, Write};

use crate::bench::{Case, Notice, Results, Run, guidance_name, median};

/// Characters of the bar.
const WIDTH: usize = 24;

/// Stderr.
pub(super) struct Screen {
    terminal: bool,
    moving: bool,
}

impl Screen {
    pub(super) fn new() -> Self {
        Self { terminal: std::io::stderr().is_terminal(), moving: false }
    }

    pub(super) fn show(&mut self, notice: &Notice<'_>) {
        match notice {
            Notice::Running { case, guidance, trial, elapsed_s, done, total, left_s } if self.terminal => {
                let guidance = guidance_name(*guidance);
                eprint!(
                    "\r\x1b[2K{} {done}/{total}  {} left  {case} {guidance} trial {trial}, {elapsed_s:.0} s",
                    bar(*done, *total),
                    span(*left_s)
                );
                // A line that cannot be shown is no reason to stop.
                let _ = std::io::stderr().flush();
                self.moving = true;
            }
            Notice::Running { .. } => {}
            Notice::CaseDone { case, results } => {
                self.clear();
                for line in lines(case, results) {
                    eprintln!("{line}");
                }
            }
        }
    }

    pub(super) fn clear(&mut self) {
        if std::mem::take(&mut self.moving) {
            eprint!("\r\x1b[2K");
        }
    }
}

fn bar(done: usize, total: usize) -> String {
    let full = WIDTH * done / total.max(1);
    format!("[{}{}]", "#".repeat(full), ".".repeat(WIDTH.saturating_sub(full)))
}

/// `2 h 5 min`, `5 min`, `40 s`.
fn span(seconds: f64) -> String {
    let whole = seconds.ceil() as u64;
    match whole {
        0..100 => format!("{whole} s"),
        100..6000 => format!("{} min", whole.div_ceil(60)),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

/// A line per guidance.
fn lines(case: &Case, results: &Results) -> Vec<String> {
    let size = case.size.to_string();
    let ours = |run: &&Run| run.family == case.family.name() && run.size == size;
    let runs: Vec<&Run> = results.runs.iter().filter(ours).collect();
    let mut guidances: Vec<&str> = Vec::new();
    for run in &runs {
        if !guidances.contains(&run.guidance.as_str()) {
            guidances.push(&run.guidance);
        }
    }
    let line = |guidance: &str| {
        let runs: Vec<&&Run> = runs.iter().filter(|run| run.guidance == guidance).collect();
        let solved: Vec<&&&Run> = runs.iter().filter(|run| run.solved).collect();
        let middle = |value: fn(&Run) -> Option<f64>| {
            let values: Vec<f64> = solved.iter().filter_map(|run| value(run)).collect();
            median(&values).map_or("-".to_owned(), |value| format!("{value:.3}"))
        };
        format!(
            "{case} {guidance}: {}/{} solved, medians: candidate {} s, first plan {} s, duration {} s",
            solved.len(),
            runs.len(),
            middle(|run| run.candidate_s),
            middle(|run| run.first_plan_s),
            middle(|run| run.duration_s),
        )
    };
    guidances.into_iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_rounded_up_to_what_counts() {
        for (seconds, text) in
            [(0.0, "0 s"), (39.2, "40 s"), (119.0, "2 min"), (600.0, "10 min"), (7500.0, "2 h 5 min")]
        {
            assert_eq!(span(seconds), text);
        }
    }

    #[test]
    fn the_bar_fills() {
        assert_eq!(bar(0, 4), format!("[{}]", ".".repeat(24)));
        assert_eq!(bar(2, 4), format!("[{}{}]", "#".repeat(12), ".".repeat(12)));
        assert_eq!(bar(4, 4), format!("[{}]", "#".repeat(24)));
        assert_eq!(bar(0, 0), format!("[{}]", ".".repeat(24)));
    }
}
