//! The most memory that the process has used, as Linux counts it.

use std::fs;

/// Forgets the peak so far; whether the system allows that.
pub(super) fn reset_peak() -> bool {
    fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Most memory in use (10^6 bytes) since the last reset or the start.
pub(super) fn peak_mb() -> Option<f64> {
    field(&fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// The value of a line `name NUMBER kB` (10^6 bytes).
pub(super) fn field(text: &str, name: &str) -> Option<f64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let number: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(number * 1024.0 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_the_kernel_are_read() {
        let text = "Name:\tx\nVmPeak:\t  100 kB\nVmHWM:\t  2000000 kB\n";
        assert_eq!(field(text, "VmHWM:"), Some(2048.0));
        assert_eq!(field(text, "VmSwap:"), None);
        assert_eq!(field("VmHWM:\tmany kB", "VmHWM:"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_peak_covers_what_is_in_use() {
        let block = vec![1_u8; 64 << 20];
        assert!(peak_mb().unwrap() > 60.0);
        assert!(block.iter().all(|byte| *byte == 1));
    }
}
