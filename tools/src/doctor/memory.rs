//! Background work of the kernel on memory: swapping, merging, migration, compaction.
//!
//! The right to lock memory is a condition of the group of rights.

use super::condition::{Condition, Finding, advice, change, command};
use super::host::Host;
use super::text::{chosen, meminfo_kb};

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "swap",
        swap,
        "A page that was swapped out costs milliseconds when it is touched; locked memory is safe, \
         but not what Takt waits for in other programs.",
    ),
    Condition::host(
        "swappiness",
        swappiness,
        "How readily the kernel swaps pages out to keep files in memory.",
    ),
    Condition::host(
        "free-memory",
        free_memory,
        "Without free memory the kernel reclaims pages during an allocation.",
    ),
    Condition::host(
        "huge-pages",
        huge_pages,
        "Making huge pages of small ones locks a program's memory map while it copies.",
    ),
    Condition::host(
        "page-merging",
        page_merging,
        "Merged pages are write-protected; the next write to one takes a fault.",
    ),
    Condition::host(
        "numa-balancing",
        numa_balancing,
        "To sample the use of a page the kernel unmaps it, so that the next access faults.",
    ),
    Condition::host(
        "compaction",
        compaction,
        "To make room for large blocks the kernel moves pages; who touches one meanwhile takes a \
         fault, locked or not.",
    ),
    Condition::host(
        "vm-statistics",
        statistics,
        "Counters of each processor are gathered by a kernel thread on that processor.",
    ),
];

fn swap(host: &Host) -> Finding {
    let Some(text) = host.text("/proc/swaps") else {
        return Finding::skip("no /proc/swaps");
    };
    let devices: Vec<&str> = text
        .lines()
        .skip(1)
        .filter_map(|line| line.split_whitespace().next())
        .collect();
    if devices.is_empty() {
        return Finding::ok("none");
    }
    let remedy = command("swapoff -a    # and remove it from /etc/fstab");
    Finding::warn(devices.join(", "), remedy)
}

const SWAPPINESS_MAX: i64 = 10;

fn swappiness(host: &Host) -> Finding {
    const PATH: &str = "/proc/sys/vm/swappiness";
    let Some(value) = host.number(PATH) else {
        return Finding::skip(format!("no {PATH}"));
    };
    let swaps = host.text("/proc/swaps").unwrap_or_default();
    if swaps.lines().count() < 2 {
        return Finding::ok(format!("{value}, of no effect without swap"));
    }
    if value > SWAPPINESS_MAX {
        return Finding::warn_setting(value.to_string(), PATH, "10");
    }
    Finding::ok(value.to_string())
}

fn free_memory(host: &Host) -> Finding {
    const NEEDED_MB: u64 = 256;
    let meminfo = host.text("/proc/meminfo").unwrap_or_default();
    let available = meminfo_kb(&meminfo, "MemAvailable").map(|kb| kb / 1024);
    match available {
        None => Finding::skip("no /proc/meminfo"),
        Some(mb) if mb < NEEDED_MB => Finding::warn(
            format!("{mb} MB available"),
            advice("end programs that are not needed, or add memory"),
        ),
        Some(mb) => Finding::ok(format!("{mb} MB available")),
    }
}

fn huge_pages(host: &Host) -> Finding {
    const PATH: &str = "/sys/kernel/mm/transparent_hugepage/enabled";
    let Some(text) = host.text(PATH) else {
        return Finding::skip("not in this kernel, as in most of PREEMPT_RT");
    };
    match chosen(&text) {
        "always" => Finding::warn_setting("always", PATH, "madvise"),
        other => Finding::ok(other.to_owned()),
    }
}

fn page_merging(host: &Host) -> Finding {
    const PATH: &str = "/sys/kernel/mm/ksm/run";
    match host.number(PATH) {
        None => Finding::skip("not in this kernel"),
        // 2 stops it and takes apart what was merged.
        Some(1) => Finding::warn(
            "running",
            command(format!("systemctl disable --now ksmtuned; echo 2 > {PATH}")),
        )
        .with_changes(vec![change(PATH, "2")]),
        Some(_) => Finding::ok("off"),
    }
}

fn numa_balancing(host: &Host) -> Finding {
    const PATH: &str = "/proc/sys/kernel/numa_balancing";
    match host.number(PATH) {
        None => Finding::skip("not in this kernel, as in all of PREEMPT_RT"),
        Some(0) => Finding::ok("off"),
        Some(_) => Finding::warn_setting("on", PATH, "0"),
    }
}

/// On demand alone is enough to move locked pages, if the kernel may.
fn compaction(host: &Host) -> Finding {
    const PATH: &str = "/proc/sys/vm/compact_unevictable_allowed";
    match host.number(PATH) {
        None => Finding::skip("not in this kernel"),
        Some(0) => Finding::ok("leaves locked pages where they are"),
        Some(_) => Finding::warn_setting("may move locked pages", PATH, "0"),
    }
}

const STATISTICS_S_MIN: i64 = 10;

fn statistics(host: &Host) -> Finding {
    const PATH: &str = "/proc/sys/vm/stat_interval";
    match host.number(PATH) {
        None => Finding::skip(format!("no {PATH}")),
        Some(seconds) if seconds < STATISTICS_S_MIN => {
            Finding::warn_setting(format!("every {seconds} s"), PATH, "10")
        }
        Some(seconds) => Finding::ok(format!("every {seconds} s")),
    }
}
