//! Whether some processors are kept for cycles alone: from the scheduler, the tick, RCU, and others' real-time
//! threads.
//!
//! Interrupts are a group of their own. Without isolated processors the finer conditions are skipped: the missing
//! isolation is reported once.

use super::condition::{Condition, Finding, advice, boot_with, change, command};
use super::cpus::Cpus;
use super::host::Host;
use super::probe::PRIORITY;
use super::text::{isolcpus, parameter};

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "cpu-isolation",
        isolation,
        "On processors that others may use, a cycle shares caches, kernel work and interrupts \
         with whatever runs there.",
    ),
    Condition::host(
        "tickless-cpus",
        tickless,
        "The scheduler's tick interrupts a cycle up to a thousand times per second.",
    ),
    Condition::host(
        "rcu-callbacks",
        rcu_callbacks,
        "Memory that kernel code sets free is handled on the processor it was freed on, in bursts, \
         unless moved to threads elsewhere.",
    ),
    Condition::host(
        "workqueues",
        workqueues,
        "Unbound kernel work runs on any processor of this mask.",
    ),
    Condition::host(
        "smt",
        smt,
        "Two threads of one core share its units and caches; what runs on the sibling slows a cycle.",
    ),
    Condition::host(
        "rt-rivals",
        rivals,
        "A real-time thread of another program at the priority of drivers or above delays cycles \
         for as long as it runs.",
    ),
    Condition::host(
        "lockup-detectors",
        lockup_detectors,
        "Detectors of lockups wake a thread and take an interrupt on each processor they watch.",
    ),
];

const NOHZ_FULL: &str = "/sys/devices/system/cpu/nohz_full";

/// The processors that are kept from the scheduler, at boot or by a partition.
pub(super) fn isolated(host: &Host) -> Cpus {
    let at_boot = host.cpus("/sys/devices/system/cpu/isolated");
    let partition = || host.cpus("/sys/fs/cgroup/cpuset.cpus.isolated");
    let some = |cpus: &Cpus| !cpus.is_empty();
    at_boot
        .filter(some)
        .or_else(|| partition().filter(some))
        .unwrap_or_default()
}

pub(super) fn online(host: &Host) -> Cpus {
    host.cpus("/sys/devices/system/cpu/online")
        .unwrap_or_default()
}

/// The processors of a condition about isolated ones, or why it is skipped.
pub(super) fn isolated_or_skip(host: &Host) -> Result<Cpus, Finding> {
    let cpus = isolated(host);
    match cpus.is_empty() {
        true => Err(Finding::skip("no processor is isolated")),
        false => Ok(cpus),
    }
}

fn isolation(host: &Host) -> Finding {
    let online = online(host);
    let isolated = isolated(host);
    let cmdline = host.text("/proc/cmdline").unwrap_or_default();
    let flags = parameter(&cmdline, "isolcpus").map_or(Vec::new(), |value| isolcpus(value).0);
    if online.is_empty() {
        return Finding::skip("no /sys/devices/system/cpu/online");
    }
    if isolated.is_empty() {
        let Some(last) = online.iter().last().filter(|_| online.len() > 1) else {
            let remedy = advice("take a host with at least two processors");
            return Finding::warn("one processor for everything", remedy);
        };
        let read = format!("none of processors {online}");
        let others = online.without(&Cpus::from_iter([last]));
        // Kernels without it reject the parameter.
        let tickless = match host.text(NOHZ_FULL) {
            Some(_) => format!("nohz_full={last} "),
            None => String::new(),
        };
        let parameters = format!(
            "isolcpus=managed_irq,domain,{last} {tickless}rcu_nocbs={last} irqaffinity={others}"
        );
        return Finding::warn(read, boot_with(parameters));
    }
    if isolated.contains_all(&online) {
        let remedy = boot_with(format!("isolcpus= without one of {online}"));
        return Finding::fail(
            format!("all of {online}: none is left for the rest"),
            remedy,
        );
    }
    if !flags.is_empty() && !flags.contains(&"managed_irq") {
        let read = format!("{isolated} of {online}, without managed_irq");
        return Finding::warn(
            read,
            boot_with(format!("isolcpus=managed_irq,domain,{isolated}")),
        );
    }
    Finding::ok(format!("{isolated} of {online}"))
}

fn tickless(host: &Host) -> Finding {
    let isolated = match isolated_or_skip(host) {
        Ok(cpus) => cpus,
        Err(skip) => return skip,
    };
    match host.cpus(NOHZ_FULL) {
        None => Finding::skip("the kernel has no nohz_full"),
        Some(cpus) if cpus.contains_all(&isolated) => Finding::ok(format!("{cpus} tickless")),
        Some(cpus) => {
            let missing = isolated.without(&cpus);
            let read = format!("{missing} isolated but not tickless");
            Finding::warn(read, boot_with(format!("nohz_full={isolated}")))
        }
    }
}

fn rcu_callbacks(host: &Host) -> Finding {
    let isolated = match isolated_or_skip(host) {
        Ok(cpus) => cpus,
        Err(skip) => return skip,
    };
    let cmdline = host.text("/proc/cmdline").unwrap_or_default();
    // A tickless processor is relieved of its callbacks anyway.
    let tickless = host.cpus(NOHZ_FULL);
    let asked = parameter(&cmdline, "rcu_nocbs").map(|value| match value {
        "" | "all" => online(host),
        list => Cpus::from_list(list).unwrap_or_default(),
    });
    let relieved: Cpus = [tickless, asked]
        .iter()
        .flatten()
        .flat_map(Cpus::iter)
        .collect();
    if relieved.contains_all(&isolated) {
        return Finding::ok(format!("moved away from {relieved}"));
    }
    let missing = isolated.without(&relieved);
    let read = format!("run on isolated {missing}");
    Finding::warn(read, boot_with(format!("rcu_nocbs={isolated}")))
}

fn workqueues(host: &Host) -> Finding {
    const MASK: &str = "/sys/devices/virtual/workqueue/cpumask";
    let isolated = match isolated_or_skip(host) {
        Ok(cpus) => cpus,
        Err(skip) => return skip,
    };
    let Some(mask) = host.text(MASK).and_then(|text| Cpus::from_mask(&text)) else {
        return Finding::skip(format!("no {MASK}"));
    };
    if mask.overlaps(&isolated) {
        let rest = online(host).without(&isolated);
        let read = format!("may run on isolated {}", mask.and(&isolated));
        return Finding::warn_setting(read, MASK, rest.mask());
    }
    Finding::ok(format!("confined to {}", mask.and(&online(host))))
}

fn smt(host: &Host) -> Finding {
    const FOLDER: &str = "/sys/devices/system/cpu";
    let control = host.value(&format!("{FOLDER}/smt/control"));
    let active = host.value(&format!("{FOLDER}/smt/active"));
    let Some(active) = active else {
        return Finding::skip("not reported by this kernel");
    };
    if active != "1" {
        return Finding::ok(match control.as_deref() {
            Some("notsupported" | "notimplemented") | None => "none".to_owned(),
            Some(control) => control.to_owned(),
        });
    }
    let isolated = isolated(host);
    let shared = isolated.iter().find_map(|cpu| {
        let path = format!("{FOLDER}/cpu{cpu}/topology/thread_siblings_list");
        let others = host.cpus(&path)?.without(&isolated);
        (!others.is_empty()).then(|| format!("isolated {cpu} shares its core with {others}"))
    });
    let off = command(format!("echo off > {FOLDER}/smt/control"));
    match shared {
        None if isolated.is_empty() => Finding::warn("on", off),
        None => Finding::ok(format!("on, but {isolated} share no core with others")),
        Some(shared) => Finding::warn(shared, off),
    }
}

/// A real-time thread or a service, as the probe writes it.
#[derive(Debug)]
pub(super) struct Task {
    pub(super) id: u32,
    pub(super) policy: String,
    pub(super) priority: u32,
    pub(super) is_kernel: bool,
    pub(super) cpus: Cpus,
    pub(super) name: String,
}

/// The tasks of the probe; `None` if it was not made.
pub(super) fn tasks(host: &Host) -> Option<Vec<Task>> {
    Some(host.fact("tasks")?.lines().filter_map(task).collect())
}

fn task(line: &str) -> Option<Task> {
    let mut words = line.splitn(6, ' ');
    Some(Task {
        id: words.next()?.parse().ok()?,
        policy: words.next()?.to_owned(),
        priority: words.next()?.parse().ok()?,
        is_kernel: words.next()? == "kernel",
        cpus: Cpus::from_list(words.next()?)?,
        name: words.next()?.to_owned(),
    })
}

/// Kernel threads are left out: those above drivers, such as `migration`, run briefly and are indispensable.
fn rivals(host: &Host) -> Finding {
    let Some(tasks) = tasks(host) else {
        return Finding::skip("no task list");
    };
    let (isolated, online) = (isolated(host), online(host));
    let cycles = if isolated.is_empty() {
        online
    } else {
        isolated
    };
    let rival = |task: &&Task| {
        let urgent = task.policy == "deadline" || task.priority >= u32::from(PRIORITY);
        let ours = task.name.starts_with("takt");
        task.policy != "other" && !task.is_kernel && urgent && !ours && task.cpus.overlaps(&cycles)
    };
    let Some(first) = tasks.iter().find(rival) else {
        return Finding::ok(format!("none at {PRIORITY} or above on {cycles}"));
    };
    let others = tasks.iter().filter(rival).count() - 1;
    let more = match others {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    let read = format!(
        "{} ({} {}) on {}{more}",
        first.name, first.policy, first.priority, first.cpus
    );
    Finding::warn(read, command(format!("chrt -f -p 40 {}", first.id)))
}

/// The soft one may stay where it does not watch isolated processors; the hard one takes a performance counter's
/// interrupt.
fn lockup_detectors(host: &Host) -> Finding {
    const HARD: &str = "/proc/sys/kernel/nmi_watchdog";
    const SOFT: &str = "/proc/sys/kernel/soft_watchdog";
    let hard = host.number(HARD) == Some(1);
    let soft = host.number(SOFT);
    if soft.is_none() && host.number(HARD).is_none() {
        return Finding::skip("not built into this kernel");
    }
    let isolated = isolated(host);
    let watched = host.cpus("/proc/sys/kernel/watchdog_cpumask");
    let watched = watched.unwrap_or_else(|| online(host));
    let soft = soft == Some(1) && watched.overlaps(&isolated);
    let mut changes = Vec::new();
    if hard {
        changes.push(change(HARD, "0"));
    }
    if soft {
        changes.push(change(SOFT, "0"));
    }
    let read = match (hard, soft) {
        (false, false) => return Finding::ok("none on the processors of cycles"),
        (true, false) => "the hard one is on".to_owned(),
        (false, true) => format!("the soft one watches isolated {}", watched.and(&isolated)),
        (true, true) => format!("both watch isolated {}", watched.and(&isolated)),
    };
    let settings: Vec<String> = changes
        .iter()
        .map(|c| c.path.replace("/proc/sys/", "").replace('/', ".") + "=0")
        .collect();
    let remedy = command(format!("sysctl -w {}", settings.join(" ")));
    Finding::warn(read, remedy).with_changes(changes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn task_name_with_spaces_is_read() {
        let task = task("71 fifo 50 kernel 2-3 irq/24-can rx").unwrap();
        assert_eq!((task.id, task.priority, task.is_kernel), (71, 50, true));
        assert_eq!(task.name, "irq/24-can rx");
        assert_eq!(task.cpus.to_string(), "2-3");
    }

    proptest! {
        #[test]
        fn any_line_is_a_task_or_none(line in "[0-9a-z ,-]{0,60}|\\PC{0,60}") {
            let _ = task(&line);
        }
    }
}
