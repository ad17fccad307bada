//! What this user may do: become real-time, lock memory, keep processors awake, send raw frames, trace.
//!
//! A trial decides; limits and capabilities only explain. A tree without results of trials is judged by limits and
//! capabilities.

use super::condition::{Condition, Finding, Remedy, advice, command};
use super::host::Host;
use super::probe::PRIORITY;
use super::text::{entry, field, has_capability, limit};

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "realtime-priority",
        priority,
        "Without it a cycle waits like any ordinary thread.",
    ),
    Condition::host(
        "memory-lock",
        memory_lock,
        "Memory that is not locked can fault in a cycle.",
    ),
    Condition::host(
        "realtime-time-limit",
        time_limit,
        "The kernel kills a real-time thread that runs this long without sleeping.",
    ),
    Condition::host(
        "latency-control",
        latency_control,
        "Through /dev/cpu_dma_latency takt keeps processors out of deep sleep while it runs.",
    ),
    Condition::host(
        "raw-ethernet",
        raw_ethernet,
        "An EtherCAT master sends raw frames.",
    ),
    Condition::host(
        "can-sockets",
        can_sockets,
        "CANopen drives and CAN bases are reached by CAN sockets.",
    ),
    Condition::host(
        "tracing",
        tracing,
        "The kernel's tracer shows what ran instead of a late cycle.",
    ),
    Condition::host(
        "login-limits",
        login_limits,
        "Limits of PAM give users at a terminal what the unit gives the service.",
    ),
    Condition::host(
        "group",
        group,
        "Members of the group takt may run it by hand with the service's rights.",
    ),
];

const CAP_NET_RAW: u32 = 13;
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;

/// The answer of the probe to one request.
fn tried(host: &Host, question: &str) -> Option<Result<(), String>> {
    let answers = host.fact("permissions")?;
    Some(match entry(&answers, question)? {
        "ok" => Ok(()),
        refusal => Err(refusal.to_owned()),
    })
}

fn has(host: &Host, capability: u32) -> bool {
    let status = host.text("/proc/self/status").unwrap_or_default();
    has_capability(&status, "CapEff", capability).unwrap_or(false)
}

fn soft_limit(host: &Host, name: &str) -> Option<Option<u64>> {
    limit(&host.text("/proc/self/limits")?, name)
}

fn limit_text(limit: Option<Option<u64>>) -> String {
    match limit {
        None => "unknown".to_owned(),
        Some(None) => "unlimited".to_owned(),
        Some(Some(value)) => value.to_string(),
    }
}

fn join_group() -> Remedy {
    advice(
        "install Takt's package, then `usermod -aG takt USER` and log in again; or add rtprio 95 and \
         memlock unlimited in /etc/security/limits.d",
    )
}

fn priority(host: &Host) -> Finding {
    let limit = soft_limit(host, "Max realtime priority");
    let able = has(host, CAP_SYS_NICE);
    let enough = limit.is_some_and(|limit| limit.is_none_or(|max| max >= u64::from(PRIORITY)));
    let read = match able {
        true => "CAP_SYS_NICE".to_owned(),
        false => format!("limit {}", limit_text(limit)),
    };
    match tried(host, "fifo") {
        Some(Ok(())) => Finding::ok(format!("SCHED_FIFO {PRIORITY} granted ({read})")),
        Some(Err(why)) => {
            let remedy = match able || enough {
                // The right is there, so something else refuses.
                true => advice(
                    "give this cgroup a budget (cpu.rt_runtime_us), or lift RestrictRealtime= or the \
                     system call filter",
                ),
                false => join_group(),
            };
            Finding::fail(
                format!("SCHED_FIFO {PRIORITY} refused: {why} ({read})"),
                remedy,
            )
        }
        None if able || enough => Finding::ok(format!("{read}, not tried")),
        None if limit.is_none() => Finding::skip("nothing about it in this tree"),
        None => Finding::fail(format!("{read}, not tried"), join_group()),
    }
}

fn memory_lock(host: &Host) -> Finding {
    let limit = soft_limit(host, "Max locked memory");
    let able = has(host, CAP_IPC_LOCK);
    let read = match (able, limit) {
        (true, _) => "CAP_IPC_LOCK".to_owned(),
        (false, Some(Some(bytes))) => format!("limit {} KiB", bytes / 1024),
        (false, limit) => format!("limit {}", limit_text(limit)),
    };
    match tried(host, "memory-lock") {
        Some(Ok(())) => Finding::ok(format!("granted ({read})")),
        Some(Err(why)) => Finding::fail(format!("refused: {why} ({read})"), join_group()),
        None if able || limit == Some(None) => Finding::ok(format!("{read}, not tried")),
        None if limit.is_none() => Finding::skip("nothing about it in this tree"),
        None => Finding::fail(format!("{read}, not tried"), join_group()),
    }
}

fn time_limit(host: &Host) -> Finding {
    match soft_limit(host, "Max realtime timeout") {
        None => Finding::skip("no /proc/self/limits"),
        Some(None) => Finding::ok("unlimited"),
        Some(Some(us)) => Finding::warn(
            format!("killed after {us} us"),
            command("prlimit --pid $$ --rttime=unlimited"),
        ),
    }
}

fn latency_control(host: &Host) -> Finding {
    match tried(host, "latency-control") {
        None => Finding::skip("not tried"),
        Some(Ok(())) => Finding::ok("granted"),
        Some(Err(why)) => {
            let remedy = advice(
                "install Takt's package and join the group takt, or: chgrp takt \
                 /dev/cpu_dma_latency; chmod g+rw /dev/cpu_dma_latency",
            );
            Finding::warn(why, remedy)
        }
    }
}

fn raw_ethernet(host: &Host) -> Finding {
    let able = has(host, CAP_NET_RAW);
    match tried(host, "packet-socket") {
        Some(Ok(())) => Finding::ok("granted"),
        Some(Err(why)) => {
            let remedy = command("setcap cap_net_raw+ep /usr/bin/takt");
            Finding::warn(format!("refused: {why}"), remedy)
        }
        None if able => Finding::ok("CAP_NET_RAW, not tried"),
        None => Finding::skip("not tried"),
    }
}

fn can_sockets(host: &Host) -> Finding {
    match tried(host, "can-socket") {
        None => Finding::skip("not tried"),
        Some(Ok(())) => Finding::ok("granted"),
        Some(Err(why)) => {
            let remedy = command("modprobe can-raw    # a kernel without it has no CAN");
            Finding::warn(format!("refused: {why}"), remedy)
        }
    }
}

fn tracing(host: &Host) -> Finding {
    const NEW: &str = "/sys/kernel/tracing/current_tracer";
    const OLD: &str = "/sys/kernel/debug/tracing/current_tracer";
    if let Some(tracer) = host.value(NEW).or_else(|| host.value(OLD)) {
        return Finding::ok(format!("available, tracer {tracer}"));
    }
    let filesystems = host.text("/proc/filesystems").unwrap_or_default();
    if host.is_denied(NEW) || host.is_denied(OLD) {
        let remedy = command("mount -o remount,gid=takt,mode=750 /sys/kernel/tracing");
        return Finding::warn("not for this user", remedy);
    }
    if filesystems.contains("tracefs") {
        let remedy = command("mount -t tracefs tracefs /sys/kernel/tracing");
        return Finding::warn("not mounted", remedy);
    }
    Finding::skip("this kernel has no tracer")
}

/// Name, groups' numbers and groups' names of the user.
#[derive(Debug)]
struct User {
    name: String,
    is_root: bool,
    groups: Vec<String>,
}

fn user(host: &Host) -> Option<User> {
    let status = host.text("/proc/self/status")?;
    let uid = field(&status, "Uid")?.split_whitespace().nth(1)?;
    let own = field(&status, "Gid").unwrap_or_default();
    let more = field(&status, "Groups").unwrap_or_default();
    let ids: Vec<&str> = own
        .split_whitespace()
        .take(1)
        .chain(more.split_whitespace())
        .collect();
    let of = |path: &str, id: &str| {
        let text = host.text(path).unwrap_or_default();
        let name = text.lines().find_map(|line| {
            let mut fields = line.split(':');
            let name = fields.next()?;
            (fields.nth(1)? == id).then(|| name.to_owned())
        });
        name.unwrap_or_else(|| id.to_owned())
    };
    Some(User {
        name: of("/etc/passwd", uid),
        is_root: uid == "0",
        groups: ids.iter().map(|id| of("/etc/group", id)).collect(),
    })
}

/// The value of one item that `limits.conf` and its neighbours give a user, the last line counting.
fn granted(text: &str, user: &User, wanted: &str) -> Option<String> {
    let mut lines = text.lines().filter_map(|line| {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        let (domain, kind) = (words.next()?, words.next()?);
        let (item, value) = (words.next()?, words.next()?);
        let applies = match domain.strip_prefix('@') {
            Some(group) => user.groups.iter().any(|name| name == group),
            None => domain == "*" || domain == user.name,
        };
        (applies && item == wanted && matches!(kind, "-" | "soft")).then(|| value.to_owned())
    });
    lines.next_back()
}

fn login_limits(host: &Host) -> Finding {
    const FOLDER: &str = "/etc/security/limits.d";
    let Some(user) = user(host) else {
        return Finding::skip("no /proc/self/status");
    };
    let Some(mut text) = host.text("/etc/security/limits.conf") else {
        return Finding::skip("no PAM limits here");
    };
    for name in host.names(FOLDER) {
        if name.ends_with(".conf") {
            text += "\n";
            text += &host.text(&format!("{FOLDER}/{name}")).unwrap_or_default();
        }
    }
    let priority = granted(&text, &user, "rtprio");
    let memory = granted(&text, &user, "memlock");
    // A `*` is not for root, and root needs none.
    if user.is_root && priority.is_none() {
        return Finding::ok("none for root, who needs none");
    }
    let is_enough = |value: &Option<String>, least: u64| match value.as_deref() {
        Some("unlimited" | "infinity" | "-1") => true,
        Some(value) => value.parse::<u64>().is_ok_and(|value| value >= least),
        None => false,
    };
    let show = |value: &Option<String>| value.clone().unwrap_or_else(|| "not given".to_owned());
    let read = format!("rtprio {}, memlock {}", show(&priority), show(&memory));
    match is_enough(&priority, u64::from(PRIORITY)) && is_enough(&memory, u64::MAX) {
        true => Finding::ok(format!("{read} for {}", user.name)),
        false => Finding::warn(format!("{read} for {}", user.name), join_group()),
    }
}

fn group(host: &Host) -> Finding {
    let Some(user) = user(host) else {
        return Finding::skip("no /proc/self/status");
    };
    if user.is_root {
        return Finding::ok("root");
    }
    if user.groups.iter().any(|group| group == "takt") {
        return Finding::ok(format!("{} is in takt", user.name));
    }
    let remedy = command(format!("usermod -aG takt {}", user.name));
    Finding::warn(format!("{} is not in takt", user.name), remedy)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn user() -> User {
        User {
            name: "ada".into(),
            is_root: false,
            groups: vec!["ada".into(), "realtime".into()],
        }
    }

    #[test]
    fn limits_apply_to_users_and_groups_last_wins() {
        let text = "# @realtime - rtprio 1\n@realtime - rtprio 95 # x\n@video - rtprio 3\nbob soft rtprio 7\n";
        let given = |text: &str| granted(text, &user(), "rtprio");
        assert_eq!(given(text).as_deref(), Some("95"));
        assert_eq!(
            given("ada soft rtprio 7\n* - rtprio 8\n").as_deref(),
            Some("8")
        );
        assert_eq!(given("ada hard rtprio 7\n"), None);
    }

    proptest! {
        #[test]
        fn any_limits_are_read(text in "[@*a-z0-9# \\n-]{0,80}|\\PC{0,80}") {
            let _ = granted(&text, &user(), "rtprio");
        }
    }
}
