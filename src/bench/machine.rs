//! What it was measured on, and how quiet that was.

use std::fs;

use serde::{Deserialize, Serialize};

use super::memory;

/// The machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// The processor's name, as it gives it itself.
    pub processor: String,
    /// Processors that the process may use.
    pub cores: usize,
    /// Main memory (10^9 bytes), where known.
    pub memory_gb: Option<f64>,
    /// Operating system and architecture.
    pub system: String,
    /// Version of the product.
    pub version: String,
    /// Whether peaks of memory are per run; otherwise they are since the process's start.
    pub peak_rss_per_run: bool,
}

impl Machine {
    /// This machine.
    pub fn this() -> Self {
        let cpu = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
        Self {
            processor: processor(&cpu).unwrap_or("unknown").to_owned(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_gb: memory::field(&memory, "MemTotal:").map(|mb| (mb / 100.0).round() / 10.0),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            peak_rss_per_run: memory::reset_peak(),
        }
    }
}

fn processor(text: &str) -> Option<&str> {
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim())
}

/// What else was going on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditions {
    /// When it began (RFC 3339).
    pub started_at: String,
    /// Processes that ran or wanted to run on average over the minute before.
    pub load_before: Option<f64>,
    /// Of the time in which the runs wanted the processor, the share in which another process had
    /// it; with one planner thread only.
    pub waited_share: Option<f64>,
}

impl Conditions {
    /// What can be said at the start, `started_at` by the caller's clock.
    pub fn at_start(started_at: String) -> Self {
        let load = fs::read_to_string("/proc/loadavg").ok();
        let load_before = load.and_then(|text| text.split(' ').next()?.parse().ok());
        Self { started_at, load_before, waited_share: None }
    }
}

/// What the calling thread got of the processor since it started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct ThreadTimes {
    /// Nanoseconds on a processor.
    pub(super) ran: u64,
    /// Nanoseconds in which it could have run.
    pub(super) waited: u64,
}

impl ThreadTimes {
    /// Of the calling thread, where the system tells.
    pub(super) fn now() -> Option<Self> {
        let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
        let mut numbers = text.split_whitespace().map(str::parse);
        Some(Self { ran: numbers.next()?.ok()?, waited: numbers.next()?.ok()? })
    }

    /// Adds what passed from `from` to `to`.
    pub(super) fn add(&mut self, from: Self, to: Self) {
        self.ran += to.ran.saturating_sub(from.ran);
        self.waited += to.waited.saturating_sub(from.waited);
    }

    /// The share of waiting.
    pub(super) fn waited_share(self) -> Option<f64> {
        let all = self.ran + self.waited;
        (all > 0).then(|| self.waited as f64 / all as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_named() {
        let text = "processor\t: 0\nmodel name\t: Some CPU @ 2.50GHz\nprocessor\t: 1\nmodel name\t: Other\n";
        assert_eq!(processor(text), Some("Some CPU @ 2.50GHz"));
        assert_eq!(processor(""), None);
    }

    #[test]
    fn waiting_is_a_share() {
        let mut times = ThreadTimes::default();
        assert_eq!(times.waited_share(), None);
        times.add(ThreadTimes { ran: 10, waited: 5 }, ThreadTimes { ran: 40, waited: 15 });
        assert_eq!(times.waited_share(), Some(0.25));
    }
}
