//! Whether processors keep their frequency and stay awake: governor, turbo, idle states.
//!
//! Settings that a controller requests while it runs, such as the latency of sleep, count as set if it may request them.

use super::condition::{Change, Condition, Finding, advice, change, command};
use super::host::Host;
use super::isolation::online;
use super::text::entry;

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "governor",
        governor,
        "A governor that saves power lets the clock drop between cycles and raises it too late.",
    ),
    Condition::host(
        "frequency-range",
        frequency_range,
        "A cap below what the processor can do makes every cycle longer.",
    ),
    Condition::host(
        "turbo",
        turbo,
        "Turbo depends on temperature and on what other cores do, so the time of a cycle does, too.",
    ),
    Condition::host(
        "energy-preference",
        energy_preference,
        "A hint to the processor itself that can undo the governor's choice.",
    ),
    Condition::host(
        "idle-states",
        idle_states,
        "Waking from a deep idle state takes longer than a short cycle may be late.",
    ),
];

const FOLDER: &str = "/sys/devices/system/cpu";

/// The values of a file of each processor's frequency settings, with its path.
fn of_each_cpu(host: &Host, file: &str) -> Vec<(String, String)> {
    let cpus = online(host);
    let paths = cpus
        .iter()
        .map(|cpu| format!("{FOLDER}/cpu{cpu}/cpufreq/{file}"));
    paths
        .filter_map(|path| host.value(&path).map(|value| (path, value)))
        .collect()
}

fn no_scaling() -> Finding {
    Finding::skip("no cpufreq: the firmware or a hypervisor decides")
}

/// The distinct values, in order.
fn distinct(values: &[(String, String)]) -> String {
    let mut values: Vec<&str> = values.iter().map(|(_, value)| &**value).collect();
    values.sort_unstable();
    values.dedup();
    values.join(", ")
}

fn changes(values: &[(String, String)], good: &str) -> Vec<Change> {
    let wrong = values.iter().filter(|(_, value)| value != good);
    wrong.map(|(path, _)| change(path.clone(), good)).collect()
}

fn governor(host: &Host) -> Finding {
    let governors = of_each_cpu(host, "scaling_governor");
    if governors.is_empty() {
        return no_scaling();
    }
    let changes = changes(&governors, "performance");
    if changes.is_empty() {
        return Finding::ok("performance");
    }
    let remedy = command("cpupower frequency-set -g performance");
    Finding::warn(distinct(&governors), remedy).with_changes(changes)
}

fn frequency_range(host: &Host) -> Finding {
    let caps = of_each_cpu(host, "scaling_max_freq");
    let most = of_each_cpu(host, "cpuinfo_max_freq");
    if caps.is_empty() || caps.len() != most.len() {
        return no_scaling();
    }
    let khz = |text: &str| text.parse::<u64>().ok();
    let mut changes = Vec::new();
    let mut lowest = None;
    for ((path, cap), (_, most)) in caps.iter().zip(&most) {
        let (Some(cap), Some(most)) = (khz(cap), khz(most)) else {
            return Finding::skip("frequencies that are no numbers");
        };
        lowest = lowest.min(Some((cap, most))).or(Some((cap, most)));
        if cap < most {
            changes.push(change(path.clone(), most.to_string()));
        }
    }
    let (cap, most) = lowest.unwrap_or_default();
    if changes.is_empty() {
        return Finding::ok(format!("up to {} MHz, all there is", most / 1000));
    }
    let read = format!("capped at {} of {} MHz", cap / 1000, most / 1000);
    let remedy = command(format!("cpupower frequency-set -u {}MHz", most / 1000));
    Finding::warn(read, remedy).with_changes(changes)
}

/// Two drivers, two files of opposite sense.
fn turbo(host: &Host) -> Finding {
    const INTEL: &str = "/sys/devices/system/cpu/intel_pstate/no_turbo";
    const OTHERS: &str = "/sys/devices/system/cpu/cpufreq/boost";
    let (path, on, off) = match (host.value(INTEL), host.value(OTHERS)) {
        (Some(value), _) => (INTEL, value == "0", "1"),
        (None, Some(value)) => (OTHERS, value == "1", "0"),
        (None, None) => return Finding::skip("no turbo, or not for this kernel to switch"),
    };
    match on {
        true => Finding::warn_setting("on", path, off),
        false => Finding::ok("off"),
    }
}

fn energy_preference(host: &Host) -> Finding {
    let hints = of_each_cpu(host, "energy_performance_preference");
    if hints.is_empty() {
        return Finding::skip("these processors take no hint");
    }
    let changes = changes(&hints, "performance");
    if changes.is_empty() {
        return Finding::ok("performance");
    }
    let remedy = command("cpupower set --epp performance");
    Finding::warn(distinct(&hints), remedy).with_changes(changes)
}

/// The slowest idle state that is not switched off: its name and exit latency in µs.
fn deepest(host: &Host) -> Option<(String, i64)> {
    let cpu = online(host).iter().next()?;
    let folder = format!("{FOLDER}/cpu{cpu}/cpuidle");
    let states = host.names(&folder);
    let states = states.iter().filter_map(|state| {
        let of = |file: &str| format!("{folder}/{state}/{file}");
        let off = host.number(&of("disable")).unwrap_or(0) & 1 != 0;
        let latency = host.number(&of("latency"))?;
        let name = host.value(&of("name")).unwrap_or_default();
        (!off).then_some((name, latency))
    });
    states.max_by_key(|(_, latency)| *latency)
}

/// The longest acceptable exit latency, for cycles of 250 µs.
const LATENCY_US: i64 = 10;

fn idle_states(host: &Host) -> Finding {
    let driver = host.value(&format!("{FOLDER}/cpuidle/current_driver"));
    if matches!(driver.as_deref(), None | Some("none" | "")) {
        return Finding::skip("no cpuidle driver");
    }
    let Some((name, latency)) = deepest(host) else {
        return Finding::skip("no idle states reported");
    };
    if latency <= LATENCY_US {
        return Finding::ok(format!("{name} at most, {latency} us to wake"));
    }
    let bound = host.fact("dma-latency");
    let bound = bound.and_then(|text| text.trim().parse::<i64>().ok());
    if let Some(bound) = bound.filter(|bound| (0..=LATENCY_US).contains(bound)) {
        return Finding::ok(format!(
            "{name} takes {latency} us, bound to {bound} us now"
        ));
    }
    let permissions = host.fact("permissions").unwrap_or_default();
    if entry(&permissions, "latency-control") == Some("ok") {
        return Finding::ok(format!("{name} takes {latency} us; takt may forbid it"));
    }
    let remedy = advice(
        "let takt open /dev/cpu_dma_latency (its Debian package does by a udev rule), or boot with \
         `processor.max_cstate=1 intel_idle.max_cstate=1`",
    );
    Finding::warn(format!("{name} takes {latency} us to wake"), remedy)
}
