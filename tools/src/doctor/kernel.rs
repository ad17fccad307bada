//! The kernel: preemption, real-time throttling, and whether it runs under a hypervisor.
//!
//! Other load of the processors is checked in the groups of isolation and interrupts.

use super::condition::{Condition, Finding, advice, change, command};
use super::host::Host;
use super::text::{cgroup, chosen, entry, field, parameter, release};

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "preemption",
        preemption,
        "Only PREEMPT_RT bounds how long kernel code keeps a due cycle waiting.",
    ),
    Condition::host(
        "kernel-debugging",
        debugging,
        "Checks compiled into the kernel run with preemption off and add to every latency.",
    ),
    Condition::host(
        "rt-throttling",
        throttling,
        "The share of a processor that real-time threads may take before the kernel stops them, or \
         the safety net under a cycle that never sleeps.",
    ),
    Condition::host(
        "rt-group-scheduling",
        group_scheduling,
        "With real-time group scheduling a thread in a group without budget cannot become \
         real-time, whatever its rights.",
    ),
    Condition::host(
        "virtual-machine",
        virtual_machine,
        "Beneath a guest a hypervisor schedules; nothing inside can bound that.",
    ),
    Condition::host(
        "stolen-time",
        stolen_time,
        "Time in which a hypervisor ran something else while this system had work to do.",
    ),
];

const RT_KERNEL: &str = "install and boot a PREEMPT_RT kernel (Debian: linux-image-rt-amd64; \
                         Ubuntu: pro enable realtime-kernel)";

/// The version string alone does not show the mode: with `PREEMPT_DYNAMIC` it can be chosen.
fn preemption(host: &Host) -> Finding {
    let version = host.text("/proc/version").unwrap_or_default();
    let release = host.value("/proc/sys/kernel/osrelease");
    let release = release.unwrap_or_else(|| "of unknown release".to_owned());
    let flagged = host.value("/sys/kernel/realtime").as_deref() == Some("1");
    if flagged || version.contains("PREEMPT_RT") || version.contains("PREEMPT RT") {
        return Finding::ok(format!("PREEMPT_RT, Linux {release}"));
    }
    if version.is_empty() {
        return Finding::skip("no /proc/version");
    }
    match mode(host, &version) {
        Some((mode, from)) if mode == "full" => Finding::warn(
            format!("preempt=full ({from}), not PREEMPT_RT, Linux {release}"),
            advice(RT_KERNEL),
        ),
        Some((mode, from)) => {
            let read = format!("preempt={mode} ({from}), Linux {release}");
            let meanwhile = match version.contains("PREEMPT_DYNAMIC") {
                true => format!("{RT_KERNEL}; until then boot with `preempt=full`"),
                false => RT_KERNEL.to_owned(),
            };
            Finding::fail(read, advice(meanwhile))
        }
        None => Finding::fail(
            format!("not PREEMPT_RT, mode unknown, Linux {release}"),
            advice(RT_KERNEL),
        ),
    }
}

/// The mode in force and its source, the most reliable source first.
fn mode(host: &Host, version: &str) -> Option<(String, &'static str)> {
    if let Some(text) = host.text("/sys/kernel/debug/sched/preempt") {
        return Some((chosen(&text).to_owned(), "debugfs"));
    }
    let log = host.fact("kernel-log").unwrap_or_default();
    if let Some((_, mode)) = log.rsplit_once("Dynamic Preempt:") {
        return Some((mode.split_whitespace().next()?.to_owned(), "kernel log"));
    }
    let cmdline = host.text("/proc/cmdline").unwrap_or_default();
    if version.contains("PREEMPT_DYNAMIC")
        && let Some(mode) = parameter(&cmdline, "preempt")
    {
        return Some((mode.to_owned(), "command line"));
    }
    let config = host.fact("kernel-config").unwrap_or_default();
    let modes = [
        ("PREEMPT_NONE", "none"),
        ("PREEMPT_VOLUNTARY", "voluntary"),
        ("PREEMPT_LAZY", "lazy"),
        ("PREEMPT", "full"),
    ];
    let built = modes
        .iter()
        .find(|(option, _)| entry(&config, option) == Some("y"));
    built.map(|(_, mode)| ((*mode).to_owned(), "as built"))
}

fn debugging(host: &Host) -> Finding {
    const COSTLY: &[&str] = &[
        "KASAN",
        "DEBUG_PREEMPT",
        "IRQSOFF_TRACER",
        "PREEMPT_TRACER",
        "PROVE_LOCKING",
    ];
    let Some(config) = host.fact("kernel-config") else {
        return Finding::skip("no kernel configuration to be found");
    };
    let found: Vec<&str> = COSTLY
        .iter()
        .copied()
        .filter(|option| entry(&config, option) == Some("y"))
        .collect();
    if found.is_empty() {
        return Finding::ok("none of the costly checks is built in");
    }
    let remedy = advice("boot a kernel built without them, such as the distribution's");
    Finding::warn(format!("built with {}", found.join(", ")), remedy)
}

fn throttling(host: &Host) -> Finding {
    let runtime = host.number("/proc/sys/kernel/sched_rt_runtime_us");
    let period = host.number("/proc/sys/kernel/sched_rt_period_us");
    let (Some(runtime), Some(period)) = (runtime, period) else {
        return Finding::skip("no /proc/sys/kernel/sched_rt_runtime_us");
    };
    let remedy = || command("sysctl -w kernel.sched_rt_runtime_us=950000");
    let read = format!("{runtime} of {period} us");
    match runtime {
        // From then on a deadline server gives ordinary threads their share, whatever this says.
        -1 if is_at_least(host, (6, 12)) => Finding::ok("unlimited, but for the fair server"),
        -1 => Finding::warn(
            "unlimited: a cycle that never sleeps takes its processor",
            remedy(),
        ),
        ..=0 => Finding::fail(format!("{read}: no real time at all"), remedy()),
        _ if period <= 0 || runtime < period / 2 => Finding::warn(read, remedy()),
        _ => Finding::ok(read),
    }
}

fn group_scheduling(host: &Host) -> Finding {
    let own = host.text("/proc/self/cgroup").unwrap_or_default();
    if let Some(path) = cgroup(&own, "cpu") {
        return group_budget(host, path);
    }
    let config = host.fact("kernel-config").unwrap_or_default();
    let cmdline = host.text("/proc/cmdline").unwrap_or_default();
    let has = |option| entry(&config, option) == Some("y");
    let off = match parameter(&cmdline, "rt_group_sched") {
        Some(value) => value == "0",
        None => has("RT_GROUP_SCHED_DEFAULT_DISABLED"),
    };
    match has("RT_GROUP_SCHED") {
        _ if config.is_empty() => Finding::skip("no kernel configuration to be found"),
        false => Finding::ok("not built into this kernel"),
        true if off => Finding::ok("switched off"),
        true => Finding::warn(
            "built in; groups with the cpu controller have no budget",
            advice(
                "boot with `rt_group_sched=0`, which kernels since 6.16 know, or one built without \
                 RT_GROUP_SCHED",
            ),
        ),
    }
}

/// Version 1 of cgroups, where each group has its budget.
fn group_budget(host: &Host, group: &str) -> Finding {
    let group = group.trim_end_matches('/');
    let mounts = ["/sys/fs/cgroup/cpu", "/sys/fs/cgroup/cpu,cpuacct"];
    let budget = mounts.iter().find_map(|mount| {
        let path = format!("{mount}{group}/cpu.rt_runtime_us");
        host.number(&path).map(|budget| (path, budget))
    });
    let name = if group.is_empty() { "/" } else { group };
    match budget {
        None => Finding::ok("no budgets in this kernel"),
        Some((path, budget @ ..=0)) if budget != -1 => {
            // Half of what the root has by default: its parent must have that much to give.
            let new = "475000";
            let remedy = command(format!("echo {new} > {path}"));
            Finding::fail(format!("{budget} us for group {name}"), remedy)
                .with_changes(vec![change(path, new)])
        }
        Some((_, budget)) => Finding::ok(format!("{budget} us for group {name}")),
    }
}

/// Whether a hypervisor reports itself, and which machine the firmware claims to be.
fn virtual_machine(host: &Host) -> Finding {
    let Some(cpuinfo) = host.text("/proc/cpuinfo") else {
        return Finding::skip("no /proc/cpuinfo");
    };
    let flags = field(&cpuinfo, "flags").unwrap_or_default();
    if !flags.split_whitespace().any(|flag| flag == "hypervisor") {
        return Finding::ok("no hypervisor announces itself");
    }
    let kind = host.value("/sys/class/dmi/id/sys_vendor");
    let kind = kind.map_or_else(String::new, |vendor| format!(" ({vendor})"));
    let remedy = advice(
        "run robots from a machine of their own; in a guest, pin its virtual processors and give \
         them real-time priority on the host",
    );
    Finding::warn(format!("a guest of a hypervisor{kind}"), remedy)
}

/// Since boot: the eighth number of the first line, out of the first eight.
fn stolen_time(host: &Host) -> Finding {
    let stat = host.text("/proc/stat").unwrap_or_default();
    let numbers = entry(&stat, "cpu").unwrap_or_default().split_whitespace();
    let ticks: Vec<u64> = numbers.take(8).filter_map(|n| n.parse().ok()).collect();
    let [.., stolen] = ticks.as_slice() else {
        return Finding::skip("no /proc/stat");
    };
    if ticks.len() < 8 {
        return Finding::skip("this kernel does not count it");
    }
    let total = ticks.iter().fold(0_u64, |sum, n| sum.saturating_add(*n));
    let ppm = u128::from(*stolen) * 1_000_000 / u128::from(total.max(1));
    let read = format!("{}.{:02} % since boot", ppm / 10_000, ppm % 10_000 / 100);
    let remedy = advice("give the guest processors of its own on the host");
    match ppm {
        0..100 => Finding::ok(read),
        _ => Finding::warn(read, remedy),
    }
}

/// Whether the kernel is at least of that release; an unknown one is.
fn is_at_least(host: &Host, wanted: (u32, u32)) -> bool {
    let running = host.text("/proc/sys/kernel/osrelease");
    running
        .and_then(|text| release(&text))
        .is_none_or(|running| running >= wanted)
}
