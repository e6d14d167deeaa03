//! What is measured: printed, and, for the table of `make soak`, added to the file that `QUADRILLE_FIGURES` names.

use std::fs::OpenOptions;
use std::io::Write;

use crate::process::soak;

/// The figures of one test.
pub struct Figures {
    group: &'static str,
    missed: Vec<String>,
}

impl Figures {
    pub fn of(group: &'static str) -> Self {
        Self { group, missed: Vec::new() }
    }

    /// A figure for people to look at.
    pub fn note(&self, what: &str, figure: impl Into<String>) {
        self.put(what, &figure.into(), "", "");
    }

    /// A figure that must keep to `mark`. Only the long forms insist: what depends on time is no test on a busy machine.
    pub fn mark(&mut self, what: &str, figure: impl Into<String>, mark: &str, kept: bool) {
        let figure = figure.into();
        self.put(what, &figure, mark, if kept { "ok" } else { "MISSED" });
        if !kept {
            self.missed.push(format!("{what}: {figure}, where the mark is {mark}"));
        }
    }

    fn put(&self, what: &str, figure: &str, mark: &str, verdict: &str) {
        let group = self.group;
        println!(
            "{group}: {what}: {figure}{}{mark} {verdict}",
            if mark.is_empty() { "" } else { "; mark: " }
        );
        if let Some(path) = std::env::var_os("QUADRILLE_FIGURES") {
            let mut file = OpenOptions::new().append(true).create(true).open(path).unwrap();
            // One write: others append to the file at the same time.
            file.write_all(format!("{group}\t{what}\t{figure}\t{mark}\t{verdict}\n").as_bytes()).unwrap();
        }
    }

    /// To be called in the end: fails when a mark was missed in the long form.
    pub fn finish(self) {
        assert!(!soak() || self.missed.is_empty(), "{}", self.missed.join("\n"));
    }
}
