//! Adapters that could carry EtherCAT or FRI: link, delays that the adapter adds, interrupts.
//!
//! It changes no adapter: a new setting may drop the link, so the command is only printed.

use super::condition::{Condition, Finding, advice, change, command};
use super::host::Host;
use super::irq::{Routed, routed};
use super::isolation::tasks;
use super::text::entry;

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::nic(
        "nic-link",
        link,
        "Without a link, at half duplex or with a link that comes and goes, frames are lost.",
    ),
    Condition::nic(
        "nic-coalescing",
        coalescing,
        "The adapter holds back its interrupt to save some; every answer of the bus is late by \
         that much.",
    ),
    Condition::nic(
        "nic-deferral",
        deferral,
        "The kernel polls later instead of taking the interrupt at once.",
    ),
    Condition::nic(
        "nic-offloads",
        offloads,
        "Received frames are held back until the adapter has been emptied, to merge them.",
    ),
    Condition::nic(
        "nic-energy",
        energy,
        "A link that sleeps between frames has to wake for each one of a cycle.",
    ),
    Condition::nic(
        "nic-pause",
        pause,
        "A pause frame of the other end stops the bus for up to milliseconds.",
    ),
    Condition::nic(
        "nic-timestamps",
        timestamps,
        "Time stamps show whether a frame was late on the wire or in the kernel.",
    ),
    Condition::nic(
        "nic-interrupts",
        interrupts,
        "An interrupt shared with another device runs that device's handler, too.",
    ),
    Condition::nic(
        "nic-irq-thread",
        irq_thread,
        "On PREEMPT_RT an interrupt is handled by a thread; at the same priority as all others it \
         waits for them.",
    ),
];

const ETHERNET: i64 = 1;
pub(super) const CAN: i64 = 280;

/// Number of the kind of an interface, as in `if_arp.h`.
pub(super) fn kind(host: &Host, interface: &str) -> Option<i64> {
    host.number(&format!("/sys/class/net/{interface}/type"))
}

/// The ones that were named and are not CAN; if none was named those with a cable in them, and if none has,
/// all.
pub(super) fn interfaces(host: &Host) -> Vec<String> {
    let named = &host.subject.interfaces;
    if !named.is_empty() {
        let named = named.iter().filter(|i| kind(host, i) != Some(CAN));
        return named.cloned().collect();
    }
    let all: Vec<String> = host
        .names("/sys/class/net")
        .into_iter()
        .filter(|interface| kind(host, interface) == Some(ETHERNET) && is_wired(host, interface))
        .collect();
    let linked: Vec<String> = all
        .iter()
        .filter(|interface| carrier(host, interface) == Some(1))
        .cloned()
        .collect();
    if linked.is_empty() { all } else { linked }
}

/// Real hardware, or what a hypervisor shows as such, and no radio.
fn is_wired(host: &Host, interface: &str) -> bool {
    driver(host, interface).is_some()
        && host
            .link(&format!("/sys/class/net/{interface}/phy80211"))
            .is_none()
}

fn driver(host: &Host, interface: &str) -> Option<String> {
    host.link(&format!("/sys/class/net/{interface}/device/driver"))
}

/// Reading it fails while the interface is down.
fn carrier(host: &Host, interface: &str) -> Option<i64> {
    host.number(&format!("/sys/class/net/{interface}/carrier"))
}

fn is_named(host: &Host, interface: &str) -> bool {
    host.subject.interfaces.iter().any(|name| name == interface)
}

/// More changes of the link than plugging in explains.
const CARRIER_CHANGES_MAX: i64 = 20;

fn link(host: &Host, interface: &str) -> Finding {
    let of = |file: &str| format!("/sys/class/net/{interface}/{file}");
    if kind(host, interface).is_none() {
        let remedy = command("ip -brief link    # lists the interfaces");
        return Finding::fail("no such interface", remedy);
    }
    if carrier(host, interface) != Some(1) {
        let state = host.value(&of("operstate"));
        let state = state.unwrap_or_else(|| "unknown".to_owned());
        let read = format!("no link, state {state}");
        let remedy = command(format!(
            "ip link set {interface} up    # and check the cable"
        ));
        return match is_named(host, interface) {
            true => Finding::fail(read, remedy),
            false => Finding::warn(read, remedy),
        };
    }
    let speed = host.number(&of("speed")).filter(|speed| *speed > 0);
    let speed = speed.map_or_else(
        || "unknown speed".to_owned(),
        |speed| format!("{speed} Mbit/s"),
    );
    let duplex = host.value(&of("duplex")).unwrap_or_default();
    let driver = driver(host, interface).unwrap_or_else(|| "no driver".to_owned());
    let read = format!("{speed}, duplex {duplex}, {driver}");
    if duplex == "half" {
        let remedy = command(format!("ethtool -s {interface} autoneg on"));
        return Finding::warn(read, remedy);
    }
    let changes = host.number(&of("carrier_changes")).unwrap_or(0);
    if changes > CARRIER_CHANGES_MAX {
        let read = format!("{speed}, link came or went {changes} times");
        return Finding::warn(read, advice("change cable and port"));
    }
    Finding::ok(read)
}

/// The facts of an adapter, or why it is skipped.
fn facts(host: &Host, interface: &str) -> Result<String, Finding> {
    let facts = host.fact(&format!("nic/{interface}"));
    facts.ok_or_else(|| Finding::skip("the adapter was not probed"))
}

/// The longest acceptable delay, in µs.
const COALESCING_US: u32 = 3;

fn coalescing(host: &Host, interface: &str) -> Finding {
    let facts = match facts(host, interface) {
        Ok(facts) => facts,
        Err(skip) => return skip,
    };
    let number = |key| entry(&facts, key).and_then(|value| value.parse::<u32>().ok());
    let Some(usecs) = number("rx-usecs") else {
        return Finding::skip("not reported by the driver");
    };
    let adaptive = entry(&facts, "adaptive-rx") == Some("on");
    let each_frame = number("rx-frames") == Some(1);
    let read = match (adaptive, each_frame) {
        (true, _) => "adaptive".to_owned(),
        (false, true) => "an interrupt for each frame".to_owned(),
        (false, false) => format!("up to {usecs} us"),
    };
    if !adaptive && (usecs <= COALESCING_US || each_frame) {
        return Finding::ok(read);
    }
    let off = if adaptive { "adaptive-rx off " } else { "" };
    Finding::warn(
        read,
        command(format!("ethtool -C {interface} {off}rx-usecs 0")),
    )
}

fn deferral(host: &Host, interface: &str) -> Finding {
    let of = |file: &str| format!("/sys/class/net/{interface}/{file}");
    let (defer, flush) = (of("napi_defer_hard_irqs"), of("gro_flush_timeout"));
    match (host.number(&defer), host.number(&flush)) {
        (Some(0), Some(_)) | (Some(_), Some(0)) => Finding::ok("none"),
        (Some(times), Some(ns)) => {
            let read = format!("{times} times by {} us", ns / 1000);
            let remedy = command(format!("echo 0 > {defer}"));
            Finding::warn(read, remedy).with_changes(vec![change(defer, "0")])
        }
        _ => Finding::skip("not in this kernel"),
    }
}

fn offloads(host: &Host, interface: &str) -> Finding {
    let facts = match facts(host, interface) {
        Ok(facts) => facts,
        Err(skip) => return skip,
    };
    let settings: Vec<(&str, &str)> = ["gro", "lro"]
        .into_iter()
        .filter_map(|name| entry(&facts, name).map(|value| (name, value)))
        .collect();
    if settings.is_empty() {
        return Finding::skip("not reported by the driver");
    }
    let names = settings.iter().filter(|(_, value)| *value == "on");
    let on: Vec<&str> = names.map(|(name, _)| *name).collect();
    if on.is_empty() {
        return Finding::ok("frames are not merged");
    }
    let off: Vec<String> = on.iter().map(|name| format!("{name} off")).collect();
    let remedy = command(format!("ethtool -K {interface} {}", off.join(" ")));
    Finding::warn(format!("{} on", on.join(" and ")), remedy)
}

fn energy(host: &Host, interface: &str) -> Finding {
    let facts = match facts(host, interface) {
        Ok(facts) => facts,
        Err(skip) => return skip,
    };
    match (entry(&facts, "eee"), entry(&facts, "eee-active")) {
        (None, _) => Finding::skip("the adapter has no such saving"),
        (Some("on"), active) => {
            let used = if active == Some("on") {
                "in use"
            } else {
                "not in use by the other end"
            };
            let remedy = command(format!("ethtool --set-eee {interface} eee off"));
            Finding::warn(format!("on, {used}"), remedy)
        }
        (Some(_), _) => Finding::ok("no energy-efficient Ethernet"),
    }
}

fn pause(host: &Host, interface: &str) -> Finding {
    let facts = match facts(host, interface) {
        Ok(facts) => facts,
        Err(skip) => return skip,
    };
    let (Some(rx), Some(tx)) = (entry(&facts, "pause-rx"), entry(&facts, "pause-tx")) else {
        return Finding::skip("not reported by the driver");
    };
    if (rx, tx) == ("off", "off") {
        return Finding::ok("no flow control");
    }
    let remedy = command(format!("ethtool -A {interface} autoneg off rx off tx off"));
    Finding::warn(format!("receive {rx}, transmit {tx}"), remedy)
}

fn timestamps(host: &Host, interface: &str) -> Finding {
    let facts = match facts(host, interface) {
        Ok(facts) => facts,
        Err(skip) => return skip,
    };
    let Some(received) = entry(&facts, "software-receive") else {
        return Finding::skip("not reported by the kernel");
    };
    let both = |kind: &str| {
        ["transmit", "receive"]
            .iter()
            .all(|direction| entry(&facts, &format!("{kind}-{direction}")) == Some("on"))
    };
    match (both("hardware"), both("software")) {
        (true, _) => {
            let clock = entry(&facts, "clock").unwrap_or("no clock");
            Finding::ok(format!("on the wire, {clock}"))
        }
        (false, true) => Finding::ok("in the kernel, none on the wire"),
        (false, false) => {
            let read = match received {
                "on" => "received frames only, in the kernel",
                _ => "none",
            };
            let remedy = advice("use an adapter whose driver stamps, such as Intel i210 or i225");
            Finding::warn(read, remedy)
        }
    }
}

/// By the device's list, by the interface's name, or by that of a virtual device.
fn interrupts_of(host: &Host, interface: &str) -> Vec<Routed> {
    let device = format!("/sys/class/net/{interface}/device");
    let listed = host.names(&format!("{device}/msi_irqs"));
    let single = host.value(&format!("{device}/irq"));
    let facts = host.fact(&format!("nic/{interface}")).unwrap_or_default();
    let virtio = entry(&facts, "device").filter(|name| name.starts_with("virtio"));
    let routed = routed(host).into_iter();
    let ours = routed.filter(|irq| {
        let number = irq.number.to_string();
        listed.contains(&number)
            || (listed.is_empty() && single.as_ref() == Some(&number))
            || irq.name.starts_with(interface)
            || virtio.is_some_and(|name| {
                let rest = irq.name.strip_prefix(name);
                rest.is_some_and(|rest| rest.starts_with('-'))
            })
    });
    ours.collect()
}

fn interrupts(host: &Host, interface: &str) -> Finding {
    let ours = interrupts_of(host, interface);
    let Some(first) = ours.first() else {
        return Finding::skip("the kernel does not report which are its own");
    };
    let handlers = |irq: &Routed| host.value(&format!("/sys/kernel/irq/{}/actions", irq.number));
    let shared = ours
        .iter()
        .find_map(|irq| handlers(irq).filter(|names| names.contains(',')));
    if let Some(names) = shared {
        let remedy = advice("put the adapter into another slot, or use one with MSI");
        return Finding::warn(format!("shared by {names}"), remedy);
    }
    let cpus: super::cpus::Cpus = ours.iter().flat_map(|irq| irq.cpus.iter()).collect();
    let last = ours.last().map_or(first.number, |irq| irq.number);
    let numbers = match ours.len() {
        1 => first.number.to_string(),
        n => format!("{n} from {} to {last}", first.number),
    };
    Finding::ok(format!("{numbers}, to processors {cpus}"))
}

/// What the kernel gives every such thread.
const PRIORITY_DEFAULT: u32 = 50;

fn irq_thread(host: &Host, interface: &str) -> Finding {
    let Some(tasks) = tasks(host) else {
        return Finding::skip("no task list");
    };
    let ours = interrupts_of(host, interface);
    let threads = tasks.iter().filter(|task| {
        let number = task.name.strip_prefix("irq/");
        let number = number.and_then(|rest| rest.split('-').next()?.parse::<u32>().ok());
        number.is_some_and(|number| ours.iter().any(|irq| irq.number == number))
    });
    let lowest = threads.min_by_key(|task| task.priority);
    match lowest {
        None => Finding::skip("interrupts are not handled by threads here"),
        Some(task) if task.priority > PRIORITY_DEFAULT => {
            Finding::ok(format!("{} {}", task.policy, task.priority))
        }
        Some(task) => Finding::warn(
            format!(
                "{} {}, as every other ({})",
                task.policy, task.priority, task.name
            ),
            command(format!("chrt -f -p 90 {}", task.id)),
        ),
    }
}
