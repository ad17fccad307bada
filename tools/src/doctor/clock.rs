//! Whether time can be read cheaply and timers fire exactly.
//!
//! It does not check synchronization with other clocks: cycles run from the monotonic clock.

use super::condition::{Condition, Finding, advice, boot_with};
use super::host::Host;
use super::text::{entry, field};

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "clocksource",
        source,
        "A cycle reads the clock several times; some sources take a microsecond or a system call \
         each.",
    ),
    Condition::host(
        "tsc",
        tsc,
        "A time stamp counter that changes its rate or stops while asleep is no clock, and the \
         kernel drops it in the middle of a run.",
    ),
    Condition::host(
        "timer-resolution",
        resolution,
        "Without high-resolution timers a sleep ends at the next tick, milliseconds late.",
    ),
    Condition::host(
        "timer-migration",
        migration,
        "Timers of an idle processor move to a busy one, such as that of a cycle.",
    ),
];

const CLOCKSOURCE: &str = "/sys/devices/system/clocksource/clocksource0";

fn source(host: &Host) -> Finding {
    /// Read without a system call.
    const GOOD: &[&str] = &[
        "tsc",
        "arch_sys_counter",
        "kvm-clock",
        "hyperv_clocksource_tsc_page",
        "riscv_clocksource",
    ];
    let Some(current) = host.value(&format!("{CLOCKSOURCE}/current_clocksource")) else {
        return Finding::skip("not reported by this kernel");
    };
    if GOOD.contains(&&*current) {
        return Finding::ok(current);
    }
    let available = host.value(&format!("{CLOCKSOURCE}/available_clocksource"));
    let available = available.unwrap_or_default();
    let better = GOOD
        .iter()
        .find(|good| available.split_whitespace().any(|name| name == **good));
    let remedy = match better {
        Some(better) => boot_with(format!("clocksource={better}")),
        None => advice("check the kernel's log for why it abandoned the processor's own clock"),
    };
    Finding::fail(current, remedy)
}

fn tsc(host: &Host) -> Finding {
    let cpuinfo = host.text("/proc/cpuinfo").unwrap_or_default();
    let Some(flags) = field(&cpuinfo, "flags") else {
        return Finding::skip("not a processor of this kind");
    };
    let log = host.fact("kernel-log").unwrap_or_default();
    let distrusted = log
        .lines()
        .find(|line| line.contains("TSC unstable") || line.contains("'tsc"));
    if distrusted.is_some() {
        let remedy =
            advice("update the firmware; if it is known to be sound: boot with `tsc=reliable`");
        return Finding::fail("the kernel found it unstable", remedy);
    }
    let missing: Vec<&str> = ["constant_tsc", "nonstop_tsc"]
        .into_iter()
        .filter(|wanted| !flags.split_whitespace().any(|flag| flag == *wanted))
        .collect();
    if missing.is_empty() {
        return Finding::ok("constant, does not stop");
    }
    let remedy = advice("take a newer processor, or in a guest let the host pass the flags on");
    Finding::warn(format!("without {}", missing.join(", ")), remedy)
}

/// Only root can read the list of timers; the kernel configuration is almost as reliable.
fn resolution(host: &Host) -> Finding {
    let cmdline = host.text("/proc/cmdline").unwrap_or_default();
    let remedy = || advice("boot without `highres=off`, with a kernel built with HIGH_RES_TIMERS");
    if super::text::parameter(&cmdline, "highres") == Some("off") {
        return Finding::fail("switched off by highres=off", remedy());
    }
    let config = host.fact("kernel-config").unwrap_or_default();
    match entry(&config, "HIGH_RES_TIMERS") {
        None => Finding::skip("no kernel configuration to be found"),
        Some("y") => Finding::ok("high-resolution timers"),
        Some(_) => Finding::fail("not built into this kernel", remedy()),
    }
}

fn migration(host: &Host) -> Finding {
    const PATH: &str = "/proc/sys/kernel/timer_migration";
    match host.number(PATH) {
        None => Finding::skip("not in this kernel"),
        Some(0) => Finding::ok("off"),
        Some(_) => Finding::warn_setting("on", PATH, "0"),
    }
}
