//! Page faults of threads while they are real-time, counted by the kernel and read by other threads, so
//! that a cycle needs no query. A fault there means memory that was not resident when the cycles began.
//!
//! It does not report the address; `perf trace -F all` does.

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::usage::thread_usage;

/// Page faults by kind.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct PageFaults {
    /// Resolved without disk access.
    pub minor: u64,
    /// Resolved with disk access.
    pub major: u64,
}

impl PageFaults {
    const NONE: Self = Self { minor: 0, major: 0 };

    /// Sum of both kinds.
    pub const fn all(self) -> u64 {
        self.minor + self.major
    }

    const fn plus(self, other: Self) -> Self {
        Self {
            minor: self.minor + other.minor,
            major: self.major + other.major,
        }
    }

    fn at_least(self, other: Self) -> Self {
        Self {
            minor: self.minor.max(other.minor),
            major: self.major.max(other.major),
        }
    }

    const fn since(self, earlier: Self) -> Self {
        Self {
            minor: self.minor.saturating_sub(earlier.minor),
            major: self.major.saturating_sub(earlier.major),
        }
    }

    fn of_this_thread() -> Self {
        let usage = thread_usage();
        Self {
            minor: usage.page_faults_minor,
            major: usage.page_faults_major,
        }
    }

    /// Page faults of a thread of this process; `None` once it has ended.
    fn of_thread(id: u32) -> Option<Self> {
        let stat = std::fs::read_to_string(format!("/proc/self/task/{id}/stat"));
        in_stat(&stat.ok()?)
    }
}

/// Counts in the text of a thread's `stat` (proc(5)): minflt is the eighth field after the name in
/// brackets, majflt the tenth.
fn in_stat(stat: &str) -> Option<PageFaults> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_ascii_whitespace().skip(7);
    let minor = fields.next()?.parse().ok()?;
    let major = fields.nth(1)?.parse().ok()?;
    Some(PageFaults { minor, major })
}

/// The threads that are real-time now, each with its faults at that start, and the faults of those that were.
#[derive(Default)]
struct Table {
    running: Vec<(u32, PageFaults)>,
    over: PageFaults,
    /// Last reported sum. A thread that ends during the query is missed that time.
    reported: PageFaults,
}

impl Table {
    const NEW: Self = Self {
        running: Vec::new(),
        over: PageFaults::NONE,
        reported: PageFaults::NONE,
    };
}

static TABLE: Mutex<Table> = Mutex::new(Table::NEW);

fn table() -> MutexGuard<'static, Table> {
    TABLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Counts the calling thread's faults from now on. Allocates and locks: for set-up only.
pub(crate) fn begin() {
    let thread = nix::unistd::gettid().as_raw().unsigned_abs();
    let mut table = table();
    table.running.reserve(1);
    table.running.push((thread, PageFaults::of_this_thread()));
}

/// Stops counting the calling thread's faults.
pub(crate) fn end() {
    let now = PageFaults::of_this_thread();
    let thread = nix::unistd::gettid().as_raw().unsigned_abs();
    let mut table = table();
    let Some(at) = table.running.iter().position(|(id, _)| *id == thread) else {
        return;
    };
    let (_, before) = table.running.swap_remove(at);
    table.over = table.over.plus(now.since(before));
}

/// Page faults of all threads of this process while they were real-time, up to now. Reads a file per
/// real-time thread, without blocking any of them; not for the real-time path.
pub fn real_time_page_faults() -> PageFaults {
    let running = table().running.clone();
    let since = |(id, before): &(u32, PageFaults)| {
        PageFaults::of_thread(*id).unwrap_or(*before).since(*before)
    };
    let read: Vec<_> = running.iter().map(since).collect();
    let mut table = table();
    // A thread that ended meanwhile is already counted in `over`.
    let still = running.iter().zip(read);
    let still = still.filter(|(entry, _)| table.running.contains(entry));
    let sum = still.fold(table.over, |sum, (_, faults)| sum.plus(faults));
    table.reported = table.reported.at_least(sum);
    table.reported
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_fault_fields_found_after_any_name() {
        let stat = "12 (a ) b) S 1 2 3 4 5 6 70 80 9 100 11";
        let faults = PageFaults {
            minor: 70,
            major: 9,
        };
        assert_eq!(in_stat(stat), Some(faults));
        assert_eq!(in_stat("12 (a) S 1"), None);
        assert_eq!(in_stat(""), None);
    }

    #[test]
    fn page_faults_count_within_scope_only() {
        let scope = crate::alloc::enter_real_time();
        let before = real_time_page_faults().all();
        let pages = std::hint::black_box(vec![1_u8; 4 << 20]);
        let within = real_time_page_faults().all();
        drop(scope);
        drop(pages);
        let after = real_time_page_faults().all();
        assert!(
            within > before && after >= within,
            "{before} {within} {after}"
        );
    }
}
