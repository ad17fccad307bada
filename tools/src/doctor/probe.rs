//! Facts that no file shows: read by system calls, or found by trials, as text that can be saved.
//!
//! Permissions are tried, since limits, capabilities, cgroups and system call filters decide together. Nothing here
//! outlasts the probe.

use std::fmt::{Display, Write as _};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, socket};
use socketcan::{CanCtrlMode, CanInterface, nl::CanState};
use takt_rt::ethtool::Ethtool;
use takt_rt::host::{HostConfig, prepare};
use takt_rt::thread::{ThreadConfig, spawn};
use takt_rt::{Grant, Outcome};

/// The priority that is tried: that of the driver threads of a controller.
pub(super) const PRIORITY: u8 = 85;

/// The fact of that name; `None` if there is no such fact or this host does not report it.
///
/// | name | lines |
/// |---|---|
/// | `permissions` | `fifo`, `memory-lock`, `latency-control`, `packet-socket`, `can-socket`, each with `ok` or the system's refusal |
/// | `dma-latency` | the latency in µs that the processors' sleep is bound to at present |
/// | `tasks` | identifier, policy, priority, `kernel` or `user`, allowed processors, name of each real-time thread and of some services |
/// | `kernel-config` | option and value, without `CONFIG_` |
/// | `kernel-log` | lines about preemption and clocks |
/// | `nic/IFACE` | settings and abilities of a network adapter |
/// | `can/IFACE` | settings and state of a CAN interface |
pub(super) fn fact(name: &str) -> Option<String> {
    match name.split_once('/') {
        Some(("nic", interface)) => nic(interface),
        Some(("can", interface)) => can(interface),
        Some(_) => None,
        None => match name {
            "permissions" => Some(permissions()),
            "dma-latency" => dma_latency(),
            "tasks" => Some(tasks()),
            "kernel-config" => kernel_config(),
            "kernel-log" => kernel_log(),
            _ => None,
        },
    }
}

/// The permissions that a controller requests at its start, and its sockets.
fn permissions() -> String {
    let config = HostConfig {
        heap_bytes: 0,
        exact_timers: false,
        ..HostConfig::default()
    };
    let host = prepare(&config);
    let granted = |what: &str| {
        let grant = host.grants().iter().find(|grant| grant.item.contains(what));
        grant.map_or("not asked", answer).to_owned()
    };
    let mut lines = format!("fifo {}\n", fifo());
    line(&mut lines, "memory-lock", granted("memory lock"));
    line(&mut lines, "latency-control", granted("cpu_dma_latency"));
    let kinds = [
        ("packet-socket", AddressFamily::Packet, None),
        ("can-socket", AddressFamily::Can, Some(SockProtocol::CanRaw)),
    ];
    for (name, family, protocol) in kinds {
        let attempt = socket(family, SockType::Raw, SockFlag::SOCK_CLOEXEC, protocol);
        let answer = attempt.map_or_else(|error| error.desc(), |_| "ok");
        line(&mut lines, name, answer);
    }
    lines
}

fn fifo() -> String {
    let config = ThreadConfig {
        priority: Some(PRIORITY),
        ..ThreadConfig::new("takt-doctor")
    };
    let Ok(thread) = spawn(config, || ()) else {
        return "no thread to be had".to_owned();
    };
    let grants = thread.grants().iter();
    let grant = grants.max_by_key(|grant| grant.item.contains("FIFO"));
    let answer = grant.map_or("not asked", answer).to_owned();
    let _ = thread.join();
    answer
}

fn answer(grant: &Grant) -> &str {
    match &grant.outcome {
        Outcome::Granted => "ok",
        Outcome::Refused { why, .. } => why,
        Outcome::NotRequested => "not asked",
    }
}

fn line(lines: &mut String, name: &str, value: impl Display) {
    let _ = writeln!(lines, "{name} {value}");
}

/// The file gives four bytes in the machine's order.
fn dma_latency() -> Option<String> {
    let mut bytes = [0; 4];
    let mut file = File::open("/dev/cpu_dma_latency").ok()?;
    file.read_exact(&mut bytes).ok()?;
    Some(format!("{}\n", i32::from_ne_bytes(bytes)))
}

/// Services that matter to conditions though they are ordinary threads.
const SERVICES: &[&str] = &["irqbalance", "tuned", "ksmtuned"];

fn tasks() -> String {
    let mut lines = String::new();
    for process in numbers("/proc") {
        for thread in numbers(&format!("/proc/{process}/task")) {
            let folder = format!("/proc/{process}/task/{thread}");
            if let Some(task) = task(&folder) {
                let _ = writeln!(lines, "{thread} {task}");
            }
        }
    }
    lines
}

fn numbers(folder: &str) -> Vec<u32> {
    let items = fs::read_dir(folder).into_iter().flatten();
    let mut numbers: Vec<u32> = items
        .filter_map(|item| item.ok()?.file_name().to_str()?.parse().ok())
        .collect();
    numbers.sort_unstable();
    numbers
}

fn task(folder: &str) -> Option<String> {
    let stat = fs::read_to_string(format!("{folder}/stat")).ok()?;
    let (policy, priority, kind, name) = task_stat(&stat)?;
    if policy == "other" && !SERVICES.contains(&name) {
        return None;
    }
    let status = fs::read_to_string(format!("{folder}/status")).ok()?;
    let cpus = super::text::field(&status, "Cpus_allowed_list")?;
    Some(format!("{policy} {priority} {kind} {cpus} {name}"))
}

/// Policy, priority, kind and name. The name stands in parentheses and may hold some itself.
fn task_stat(stat: &str) -> Option<(&str, u32, &str, &str)> {
    const KERNEL_THREAD: u32 = 0x0020_0000;
    let (head, tail) = stat.rsplit_once(')')?;
    let name = head.split_once('(')?.1;
    let fields: Vec<&str> = tail.split_whitespace().collect();
    let number = |field: usize| fields.get(field)?.parse::<u32>().ok();
    let policy = match number(38)? {
        1 => "fifo",
        2 => "rr",
        6 => "deadline",
        _ => "other",
    };
    let kernel = number(6)? & KERNEL_THREAD != 0;
    let kind = if kernel { "kernel" } else { "user" };
    Some((policy, number(37)?, kind, name))
}

/// Options that conditions read.
pub(super) const OPTIONS: &[&str] = &[
    "HIGH_RES_TIMERS",
    "KASAN",
    "DEBUG_PREEMPT",
    "IRQSOFF_TRACER",
    "PREEMPT",
    "PREEMPT_LAZY",
    "PREEMPT_NONE",
    "PREEMPT_RT",
    "PREEMPT_TRACER",
    "PREEMPT_VOLUNTARY",
    "PROVE_LOCKING",
    "RT_GROUP_SCHED",
    "RT_GROUP_SCHED_DEFAULT_DISABLED",
];

fn kernel_config() -> Option<String> {
    let release = fs::read_to_string("/proc/sys/kernel/osrelease").ok()?;
    let boot = format!("/boot/config-{}", release.trim());
    let text = config_of_running().or_else(|_| fs::read_to_string(boot));
    let text = text.ok()?;
    let mut lines = String::new();
    for option in OPTIONS {
        let value = text.lines().find_map(|line| {
            let (name, value) = line.strip_prefix("CONFIG_")?.split_once('=')?;
            (name == *option).then_some(value)
        });
        line(&mut lines, option, value.unwrap_or("n"));
    }
    Some(lines)
}

fn config_of_running() -> io::Result<String> {
    const BYTES_MAX: u64 = 8 << 20;
    let packed = File::open("/proc/config.gz")?;
    let mut text = String::new();
    let plain = flate2::read::GzDecoder::new(packed);
    plain.take(BYTES_MAX).read_to_string(&mut text)?;
    Ok(text)
}

/// Parts of the lines that conditions search for.
const LOG: &[&str] = &["Dynamic Preempt:", "Marking clocksource", "TSC unstable"];

/// Each read of the log gives one record; the text comes after the first semicolon.
fn kernel_log() -> Option<String> {
    const RECORDS_MAX: usize = 1 << 17;
    let mut options = OpenOptions::new();
    let options = options.read(true).custom_flags(nix::libc::O_NONBLOCK);
    let mut log = options.open("/dev/kmsg").ok()?;
    let mut lines = String::new();
    let mut record = [0; 8192];
    for _ in 0..RECORDS_MAX {
        match log.read(&mut record) {
            Ok(0) => break,
            Ok(length) => {
                let text = String::from_utf8_lossy(record.get(..length).unwrap_or_default());
                let text = text.split_once(';').map_or("", |(_, text)| text);
                let text = text.lines().next().unwrap_or_default();
                if LOG.iter().any(|part| text.contains(part)) {
                    lines += &format!("{text}\n");
                }
            }
            // Records were overwritten before they were read: go on with the oldest there is.
            Err(error) if error.raw_os_error() == Some(nix::libc::EPIPE) => {}
            Err(_) => break,
        }
    }
    Some(lines)
}

/// A line is missing where the driver refuses the request.
fn nic(interface: &str) -> Option<String> {
    let adapter = Ethtool::open(interface).ok()?;
    let on = |on: bool| if on { "on" } else { "off" };
    let mut lines = String::new();
    // A link in the middle of paths that are read, so that a saved tree has a folder there.
    let device = fs::read_link(format!("/sys/class/net/{interface}/device"));
    if let Some(name) = device.ok().as_deref().and_then(Path::file_name) {
        line(&mut lines, "device", name.to_string_lossy());
    }
    if let Ok(coalescing) = adapter.coalescing() {
        line(&mut lines, "rx-usecs", coalescing.rx_usecs);
        line(&mut lines, "rx-frames", coalescing.rx_frames);
        line(&mut lines, "tx-usecs", coalescing.tx_usecs);
        line(&mut lines, "adaptive-rx", on(coalescing.adaptive_rx));
        line(&mut lines, "adaptive-tx", on(coalescing.adaptive_tx));
    }
    if let Ok(gro) = adapter.generic_receive_offload() {
        line(&mut lines, "gro", on(gro));
    }
    if let Ok(lro) = adapter.large_receive_offload() {
        line(&mut lines, "lro", on(lro));
    }
    if let Ok(eee) = adapter.energy_efficient() {
        line(&mut lines, "eee", on(eee.enabled));
        line(&mut lines, "eee-active", on(eee.active));
    }
    if let Ok(pause) = adapter.pause() {
        line(&mut lines, "pause-rx", on(pause.rx));
        line(&mut lines, "pause-tx", on(pause.tx));
    }
    if let Ok(stamping) = adapter.time_stamping() {
        line(
            &mut lines,
            "software-transmit",
            on(stamping.software_transmit),
        );
        line(
            &mut lines,
            "software-receive",
            on(stamping.software_receive),
        );
        line(
            &mut lines,
            "hardware-transmit",
            on(stamping.hardware_transmit),
        );
        line(
            &mut lines,
            "hardware-receive",
            on(stamping.hardware_receive),
        );
        if let Some(clock) = stamping.clock {
            line(&mut lines, "clock", format_args!("ptp{clock}"));
        }
    }
    Some(lines)
}

/// A line is missing where the driver does not report the value; a virtual interface reports none.
fn can(interface: &str) -> Option<String> {
    let details = CanInterface::open(interface).ok()?.details().ok()?;
    let can = details.can;
    let mut lines = String::new();
    line(&mut lines, "up", if details.is_up { "yes" } else { "no" });
    if let Some(state) = can.state {
        let state = match state {
            CanState::ErrorActive => "error-active",
            CanState::ErrorWarning => "error-warning",
            CanState::ErrorPassive => "error-passive",
            CanState::BusOff => "bus-off",
            CanState::Stopped => "stopped",
            CanState::Sleeping => "sleeping",
        };
        line(&mut lines, "state", state);
    }
    if let Some(timing) = can.bit_timing {
        line(&mut lines, "bitrate", timing.bitrate);
        line(&mut lines, "sample-point", timing.sample_point);
    }
    if let Some(restart_ms) = can.restart_ms {
        line(&mut lines, "restart-ms", restart_ms);
    }
    if let Some(errors) = can.berr_counter {
        line(&mut lines, "tx-errors", errors.txerr);
        line(&mut lines, "rx-errors", errors.rxerr);
    }
    if let Some(modes) = can.ctrl_mode {
        let on = modes.has_mode(CanCtrlMode::BerrReporting);
        line(&mut lines, "berr-reporting", if on { "on" } else { "off" });
    }
    Some(lines)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn task_name_with_parentheses_is_read() {
        let mut fields = vec!["0"; 39];
        fields[0] = "S";
        fields[6] = "2097152";
        fields[37] = "50";
        fields[38] = "1";
        let stat = format!("12 (irq/9-(a) b) {}\n", fields.join(" "));
        assert_eq!(
            task_stat(&stat),
            Some(("fifo", 50, "kernel", "irq/9-(a) b"))
        );
        assert_eq!(task_stat("12 (x) S"), None);
    }

    /// With any rights of the user: each request has an answer.
    #[test]
    fn permissions_are_tried_and_answered() {
        let text = fact("permissions").unwrap();
        let names: Vec<&str> = text
            .lines()
            .map(|line| line.split_once(' ').unwrap().0)
            .collect();
        assert_eq!(
            names,
            [
                "fifo",
                "memory-lock",
                "latency-control",
                "packet-socket",
                "can-socket"
            ]
        );
        assert!(!text.contains("not asked"), "{text}");
    }

    #[test]
    fn the_loopback_interface_has_facts_and_others_none() {
        let text = fact("nic/lo").unwrap();
        assert!(text.contains("software-receive on\n"), "{text}");
        assert_eq!(fact("can/nowhere0"), None);
        assert_eq!(fact("weather"), None);
    }

    proptest! {
        #[test]
        fn any_stat_is_read_or_refused(text in "[0-9 ()a-zS]{0,160}|\\PC{0,60}") {
            let _ = task_stat(&text);
        }
    }
}
