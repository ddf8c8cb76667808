//! The memory of this process, and of the machine.

/// The line of the peak in `/proc/self/status`.
const PEAK: &str = "VmHWM:";

/// A part of the work of this process whose peak of memory is its own, not that of what was done before.
#[derive(Clone, Copy, Debug)]
pub struct PeakMemory {
    /// Whether the operating system has forgotten the peak of what was done before.
    is_own: bool,
}

impl PeakMemory {
    /// Begins to measure. A process has one peak: parts that began before lose theirs.
    pub fn start() -> Self {
        Self { is_own: std::fs::write("/proc/self/clear_refs", "5").is_ok() }
    }

    /// The most memory that this process has had in use since then, bytes, what it already had included; `None` on systems
    /// other than Linux, and where an earlier peak cannot be told from this one.
    pub fn bytes(self) -> Option<u64> {
        if self.is_own { peak_memory_bytes() } else { None }
    }
}

/// The most memory that this process has had in use so far, or since a [`PeakMemory`] began, bytes, as the operating
/// system counts it; `None` on systems other than Linux.
pub fn peak_memory_bytes() -> Option<u64> {
    kilobytes(&std::fs::read_to_string("/proc/self/status").ok()?, PEAK)
}

/// The memory of the machine, bytes, or what a container allows this process of it; `None` on systems other than Linux.
pub fn machine_memory_bytes() -> Option<u64> {
    let whole = kilobytes(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemTotal:")?;
    let allowed = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    Some(allowed.and_then(|text| text.trim().parse().ok()).map_or(whole, |allowed: u64| allowed.min(whole)))
}

/// The bytes in the line of `text` that begins with `key`.
fn kilobytes(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_in_bytes() {
        let peak_of = |status| kilobytes(status, PEAK);
        assert_eq!(peak_of("VmPeak:\t  900 kB\nVmHWM:\t   123 kB\nVmRSS:\t  99 kB\n"), Some(123 * 1024));
        assert_eq!([peak_of("VmPeak:\t  900 kB\n"), peak_of("VmHWM:\t much\n")], [None; 2]);
    }

    #[test]
    fn a_peak_that_is_not_its_own_is_not_told() {
        assert_eq!(PeakMemory { is_own: false }.bytes(), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_has_a_peak() {
        let peak = peak_memory_bytes().unwrap();
        assert!(peak > 1 << 20 && machine_memory_bytes().is_some_and(|bytes| bytes > peak), "{peak}");
    }
}
