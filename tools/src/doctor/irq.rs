//! Which interrupts arrive at the processors of cycles, and which service moves them.
//!
//! The interrupts of a field bus adapter belong to the group of the network.

use super::condition::{Condition, Finding, advice, change, command};
use super::cpus::Cpus;
use super::host::Host;
use super::isolation::{isolated, isolated_or_skip, online, tasks};
use super::text::interrupts;

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "irq-affinity",
        affinity,
        "An interrupt of another device on an isolated processor delays whatever cycle runs there.",
    ),
    Condition::host(
        "irq-default",
        default_affinity,
        "New interrupts, of a device plugged in later for instance, go to these processors.",
    ),
    Condition::host(
        "irqbalance",
        irqbalance,
        "The service moves interrupts between processors while cycles run.",
    ),
];

/// An interrupt's line with the processors it goes to and how often it came to the ones asked about.
#[derive(Debug)]
pub(super) struct Routed {
    pub(super) number: u32,
    /// The last word of its description: the handler's name as a rule.
    pub(super) name: String,
    pub(super) cpus: Cpus,
}

/// Every numbered interrupt with where it goes: the effective processors if the chip reports them, else those set. A new setting
/// takes effect with the next interrupt, so where both contradict the setting counts.
pub(super) fn routed(host: &Host) -> Vec<Routed> {
    let text = host.text("/proc/interrupts").unwrap_or_default();
    let (_, found) = interrupts(&text);
    let routed = found.into_iter().map(|interrupt| {
        let folder = format!("/proc/irq/{}", interrupt.number);
        let effective = host.cpus(&format!("{folder}/effective_affinity_list"));
        let set = host.cpus(&format!("{folder}/smp_affinity_list"));
        let name = interrupt.description.rsplit(' ').next();
        Routed {
            number: interrupt.number,
            name: name.unwrap_or_default().to_owned(),
            cpus: match (effective.filter(|cpus| !cpus.is_empty()), set) {
                (Some(effective), Some(set)) if !effective.overlaps(&set) => set,
                (effective, set) => effective.or(set).unwrap_or_default(),
            },
        }
    });
    routed.collect()
}

/// How often an interrupt came to a set of processors since boot.
fn count(host: &Host, number: u32, cpus: &Cpus) -> u64 {
    let text = host.text("/proc/interrupts").unwrap_or_default();
    let (columns, found) = interrupts(&text);
    let counts = found.iter().find(|found| found.number == number);
    let counts = counts.map_or(&[][..], |found| &found.counts);
    let there = columns.iter().zip(counts);
    there
        .filter(|(cpu, _)| cpus.contains(**cpu))
        .fold(0, |sum, (_, count)| sum.saturating_add(*count))
}

/// Interrupts of the interfaces that were named on the command line may be there on purpose.
fn affinity(host: &Host) -> Finding {
    let isolated = match isolated_or_skip(host) {
        Ok(cpus) => cpus,
        Err(skip) => return skip,
    };
    let ours = |name: &str| host.subject.interfaces.iter().any(|i| name.contains(&**i));
    let stray: Vec<Routed> = routed(host)
        .into_iter()
        .filter(|irq| irq.cpus.overlaps(&isolated) && !ours(&irq.name))
        .collect();
    let Some(first) = stray.first() else {
        return Finding::ok(format!("none goes to {isolated}"));
    };
    let came = count(host, first.number, &isolated);
    let more = match stray.len() - 1 {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let read = format!(
        "{} {} (came {came} times){more} go to isolated {}",
        first.number,
        first.name,
        first.cpus.and(&isolated)
    );
    let rest = online(host).without(&isolated).to_string();
    let path = |irq: &Routed| format!("/proc/irq/{}/smp_affinity_list", irq.number);
    let text = match stray.len() {
        1 => format!("echo {rest} > {}", path(first)),
        _ => {
            let numbers: Vec<String> = stray.iter().map(|irq| irq.number.to_string()).collect();
            let numbers = numbers.join(" ");
            format!("for i in {numbers}; do echo {rest} > /proc/irq/$i/smp_affinity_list; done")
        }
    };
    let changes = stray.iter().map(|irq| change(path(irq), rest.clone()));
    Finding::warn(read, command(text)).with_changes(changes.collect())
}

fn default_affinity(host: &Host) -> Finding {
    const MASK: &str = "/proc/irq/default_smp_affinity";
    let isolated = match isolated_or_skip(host) {
        Ok(cpus) => cpus,
        Err(skip) => return skip,
    };
    let Some(mask) = host.text(MASK).and_then(|text| Cpus::from_mask(&text)) else {
        return Finding::skip(format!("no {MASK}"));
    };
    if mask.overlaps(&isolated) {
        let rest = online(host).without(&isolated);
        let read = format!("includes isolated {}", mask.and(&isolated));
        return Finding::warn_setting(read, MASK, rest.mask());
    }
    Finding::ok(format!("processors {}", mask.and(&online(host))))
}

/// By default it excludes isolated processors; without isolation it excludes none.
fn irqbalance(host: &Host) -> Finding {
    let Some(tasks) = tasks(host) else {
        return Finding::skip("no task list");
    };
    if !tasks.iter().any(|task| task.name == "irqbalance") {
        return Finding::ok("does not run");
    }
    let settings = host.text("/etc/default/irqbalance").unwrap_or_default();
    let banned = settings
        .lines()
        .filter_map(|line| line.trim().strip_prefix("IRQBALANCE_BANNED_CPULIST="))
        .next_back();
    let banned = banned.and_then(|list| Cpus::from_list(list.trim_matches('"')));
    let isolated = isolated(host);
    match banned {
        Some(banned) if !isolated.is_empty() && banned.contains_all(&isolated) => {
            Finding::ok(format!("runs, kept away from {banned}"))
        }
        _ if isolated.is_empty() => Finding::warn(
            "runs, over all processors",
            command("systemctl disable --now irqbalance"),
        ),
        _ => Finding::warn(
            format!("runs; isolated {isolated} are not banned"),
            advice(format!(
                "set IRQBALANCE_BANNED_CPULIST={isolated} in /etc/default/irqbalance and restart \
                 it, or systemctl disable --now irqbalance"
            )),
        ),
    }
}
