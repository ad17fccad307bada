//! The rights that the unit of the service grants.
//!
//! It reads unit files and their drop-ins rather than ask systemd, which a saved tree does not have.

use super::condition::{Condition, Finding, Remedy, advice};
use super::host::Host;
use super::probe::PRIORITY;

pub(super) const CONDITIONS: &[Condition] = &[
    Condition::host(
        "service-unit",
        unit,
        "The controller runs for months only as a service that is restarted after a fault.",
    ),
    Condition::host(
        "service-priority",
        priority,
        "The service raises its cycle threads to real time, if the unit permits it.",
    ),
    Condition::host(
        "service-memory",
        memory,
        "The service locks its memory, if the unit permits it.",
    ),
    Condition::host(
        "service-scheduling",
        scheduling,
        "The unit must neither make every thread real-time, nor ration the processor.",
    ),
    Condition::host(
        "service-sandbox",
        sandbox,
        "Some sandbox settings of a unit forbid real-time scheduling.",
    ),
    Condition::host(
        "service-sockets",
        sockets,
        "Field buses need address families and a capability that a tight unit leaves out.",
    ),
];

const FOLDERS: &[&str] = &[
    "/etc/systemd/system",
    "/run/systemd/system",
    "/usr/local/lib/systemd/system",
    "/usr/lib/systemd/system",
    "/lib/systemd/system",
];

/// The section `[Service]` of a unit, with its drop-ins.
#[derive(Debug, Default)]
struct Unit {
    path: String,
    settings: Vec<(String, String)>,
}

impl Unit {
    /// The last value of a setting that holds one.
    fn value(&self, name: &str) -> Option<&str> {
        let values = self.settings.iter().filter(|(key, _)| key == name);
        let last = values.map(|(_, value)| &**value).next_back();
        last.filter(|value| !value.is_empty())
    }

    /// The words of a setting that adds up; an empty value forgets those before. `None` if it is not set.
    fn words(&self, name: &str) -> Option<Vec<&str>> {
        let mut words = None;
        for (_, value) in self.settings.iter().filter(|(key, _)| key == name) {
            let all: &mut Vec<&str> = words.get_or_insert_default();
            if value.is_empty() {
                all.clear();
            }
            all.extend(value.split_whitespace());
        }
        words
    }

    fn is_on(&self, name: &str) -> bool {
        let value = self.value(name).map(str::to_lowercase);
        matches!(value.as_deref(), Some("yes" | "true" | "on" | "1"))
    }

    fn is_root(&self) -> bool {
        !self.is_on("DynamicUser") && matches!(self.value("User"), None | Some("root" | "0"))
    }

    /// Whether processes of the unit have a capability: given to an ordinary user, not taken from root.
    fn has(&self, capability: &str) -> bool {
        let holds = |words: &[&str]| match words.first().and_then(|word| word.strip_prefix('~')) {
            Some(first) => first != capability && !words.contains(&capability),
            None => words.contains(&capability),
        };
        let bounded = self
            .words("CapabilityBoundingSet")
            .is_none_or(|w| holds(&w));
        let ambient = self.words("AmbientCapabilities").is_some_and(|w| holds(&w));
        bounded && (self.is_root() || ambient)
    }

    /// The soft value of a limit.
    fn limit(&self, name: &str) -> Option<&str> {
        self.value(name)?.split(':').next()
    }
}

/// The settings of the section `[Service]`; lines that end in a backslash go on.
fn service_section(text: &str) -> Vec<(String, String)> {
    let joined = text.replace("\\\n", " ");
    let mut inside = false;
    let mut settings = Vec::new();
    for line in joined.lines().map(str::trim) {
        if line.starts_with('[') {
            inside = line == "[Service]";
        } else if inside
            && !line.starts_with(['#', ';'])
            && let Some((name, value)) = line.split_once('=')
        {
            settings.push((name.trim().to_owned(), value.trim().to_owned()));
        }
    }
    settings
}

fn name(host: &Host) -> String {
    let name = host.subject.service.as_deref().unwrap_or("takt.service");
    match name.contains('.') {
        true => name.to_owned(),
        false => format!("{name}.service"),
    }
}

fn load(host: &Host) -> Option<Unit> {
    let name = name(host);
    let (path, text) = FOLDERS.iter().find_map(|folder| {
        let path = format!("{folder}/{name}");
        host.text(&path).map(|text| (path, text))
    })?;
    let mut settings = service_section(&text);
    for (folder, file) in drop_ins(host, &name) {
        let text = host.text(&format!("{folder}/{file}")).unwrap_or_default();
        settings.extend(service_section(&text));
    }
    Some(Unit { path, settings })
}

/// Folder and name of each file dropped in, by name; of two with one name that of the first folder counts.
fn drop_ins(host: &Host, unit: &str) -> Vec<(String, String)> {
    let mut found: Vec<(String, String)> = Vec::new();
    for folder in FOLDERS {
        let folder = format!("{folder}/{unit}.d");
        for file in host.names(&folder) {
            if file.ends_with(".conf") && !found.iter().any(|(_, name)| *name == file) {
                found.push((folder.clone(), file));
            }
        }
    }
    found.sort_by(|a, b| a.1.cmp(&b.1));
    found
}

/// Edits of a unit are made in a file beside it.
fn edit(host: &Host, settings: &str) -> Remedy {
    advice(format!("systemctl edit {}: {settings}", name(host)))
}

fn with_unit(host: &Host, check: impl Fn(&Unit) -> Finding) -> Finding {
    match load(host) {
        Some(unit) => check(&unit),
        None => Finding::skip(format!("no {}", name(host))),
    }
}

fn unit(host: &Host) -> Finding {
    let name = name(host);
    let Some(unit) = load(host) else {
        let remedy = advice("install Takt's package, or name the unit by --service");
        return match host.subject.service {
            Some(_) => Finding::fail(format!("no {name}"), remedy),
            None => Finding::skip(format!("no {name}")),
        };
    };
    if matches!(unit.value("Restart"), None | Some("no")) {
        let remedy = edit(host, "[Service] Restart=on-failure");
        return Finding::warn(format!("{}, never restarted", unit.path), remedy);
    }
    Finding::ok(unit.path)
}

fn priority(host: &Host) -> Finding {
    with_unit(host, |unit| {
        if unit.has("CAP_SYS_NICE") {
            return Finding::ok("CAP_SYS_NICE");
        }
        let limit = unit.limit("LimitRTPRIO");
        let enough = match limit {
            Some("infinity") => true,
            Some(value) => value.parse::<u8>().is_ok_and(|value| value >= PRIORITY),
            None => false,
        };
        let read = format!("LimitRTPRIO={}", limit.unwrap_or("0, as not set"));
        match enough {
            true => Finding::ok(read),
            false => Finding::fail(read, edit(host, "[Service] LimitRTPRIO=95")),
        }
    })
}

fn memory(host: &Host) -> Finding {
    with_unit(host, |unit| {
        if unit.has("CAP_IPC_LOCK") {
            return Finding::ok("CAP_IPC_LOCK");
        }
        match unit.limit("LimitMEMLOCK") {
            Some("infinity") => Finding::ok("LimitMEMLOCK=infinity"),
            other => Finding::fail(
                format!("LimitMEMLOCK={}", other.unwrap_or("8M, as not set")),
                edit(host, "[Service] LimitMEMLOCK=infinity"),
            ),
        }
    })
}

fn scheduling(host: &Host) -> Finding {
    with_unit(host, |unit| {
        if let Some(quota) = unit.value("CPUQuota") {
            let remedy = edit(host, "[Service] CPUQuota=");
            return Finding::fail(format!("CPUQuota={quota}"), remedy);
        }
        if let Some(limit) = unit
            .limit("LimitRTTIME")
            .filter(|limit| *limit != "infinity")
        {
            let remedy = edit(host, "[Service] LimitRTTIME=infinity");
            return Finding::warn(format!("LimitRTTIME={limit}"), remedy);
        }
        match unit.value("CPUSchedulingPolicy") {
            Some(policy @ ("fifo" | "rr")) => Finding::warn(
                format!("CPUSchedulingPolicy={policy} for every thread"),
                edit(host, "[Service] CPUSchedulingPolicy=other"),
            ),
            _ => Finding::ok("ordinary; cycle threads raise themselves"),
        }
    })
}

fn sandbox(host: &Host) -> Finding {
    with_unit(host, |unit| {
        let mut wrong = Vec::new();
        if unit.is_on("RestrictRealtime") {
            wrong.push(("RestrictRealtime=yes", "RestrictRealtime=no"));
        }
        if unit.is_on("PrivateDevices") {
            wrong.push((
                "PrivateDevices=yes",
                "PrivateDevices=no; DeviceAllow=/dev/cpu_dma_latency rw",
            ));
        }
        if unit.is_on("PrivateNetwork") {
            wrong.push(("PrivateNetwork=yes", "PrivateNetwork=no"));
        }
        if refuses_scheduling(unit) {
            wrong.push((
                "SystemCallFilter= without scheduling",
                "SystemCallFilter=@system-service @resources",
            ));
        }
        if wrong.is_empty() {
            return Finding::ok("leaves scheduler, devices and network alone");
        }
        let (read, fixes): (Vec<&str>, Vec<&str>) = wrong.into_iter().unzip();
        let remedy = edit(host, &format!("[Service] {}", fixes.join("; ")));
        Finding::fail(read.join(", "), remedy)
    })
}

/// The group of calls that changes schedulers, taken away by itself or not among what is allowed. The
/// first list's sign decides whether it allows or denies.
fn refuses_scheduling(unit: &Unit) -> bool {
    let filters = unit
        .settings
        .iter()
        .filter(|(name, value)| name == "SystemCallFilter" && !value.is_empty());
    let mut allows = None;
    for (_, value) in filters {
        let (deny, list) = match value.strip_prefix('~') {
            Some(list) => (true, list),
            None => (false, value.as_str()),
        };
        let named = list.split_whitespace().any(|word| {
            let word = word.split(':').next().unwrap_or_default();
            matches!(word, "@resources" | "sched_setscheduler")
                || (!deny && matches!(word, "@system-service" | "@known"))
        });
        allows = match (deny, named) {
            (true, true) => Some(false),
            (false, true) => Some(true),
            (true, false) => allows.or(Some(true)),
            (false, false) => allows.or(Some(false)),
        };
    }
    allows == Some(false)
}

fn sockets(host: &Host) -> Finding {
    with_unit(host, |unit| {
        let mut missing: Vec<&str> = Vec::new();
        if let Some(families) = unit.words("RestrictAddressFamilies") {
            let denies = families.first().is_some_and(|word| word.starts_with('~'));
            let named = |family: &&str| {
                families
                    .iter()
                    .any(|w| w.trim_start_matches('~') == *family)
            };
            let wanted = ["AF_PACKET", "AF_CAN", "AF_INET"].into_iter();
            missing.extend(wanted.filter(|family| named(family) == denies));
        }
        if !unit.has("CAP_NET_RAW") {
            missing.push("CAP_NET_RAW");
        }
        if missing.is_empty() {
            return Finding::ok("Ethernet, CAN and UDP");
        }
        let remedy = edit(
            host,
            "[Service] RestrictAddressFamilies=AF_INET AF_PACKET AF_CAN; \
             AmbientCapabilities=CAP_NET_RAW",
        );
        Finding::warn(format!("without {}", missing.join(", ")), remedy)
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn service(text: &str) -> Unit {
        Unit {
            path: String::new(),
            settings: service_section(&format!("[Service]\n{text}")),
        }
    }

    #[test]
    fn unit_only_service_section_is_read_with_continuations() {
        let text = "[Unit]\nUser=x\n[Service]\n# User=y\nUser = z\nEnvironment=a \\\n b\n[Install]\nUser=w\n";
        let settings = service_section(text);
        assert_eq!(settings.len(), 2);
        assert_eq!(settings[0], ("User".into(), "z".into()));
        assert_eq!(settings[1].1.split_whitespace().count(), 2);
    }

    #[test]
    fn unit_capabilities_are_ambient_within_bounding_set() {
        let given = "User=takt\nAmbientCapabilities=CAP_NET_RAW CAP_SYS_NICE\n";
        assert!(service(given).has("CAP_SYS_NICE"));
        assert!(
            !service(&format!("{given}CapabilityBoundingSet=CAP_NET_RAW\n")).has("CAP_SYS_NICE")
        );
        assert!(!service(&format!("{given}AmbientCapabilities=\n")).has("CAP_SYS_NICE"));
        assert!(service("").has("CAP_SYS_NICE"), "root has all");
        assert!(!service("CapabilityBoundingSet=~CAP_SYS_NICE\n").has("CAP_SYS_NICE"));
    }

    #[test]
    fn system_call_filters_are_lists_that_allow_or_deny() {
        let refuses = |text: &str| refuses_scheduling(&service(text));
        assert!(!refuses(""));
        assert!(!refuses("SystemCallFilter=@system-service\n"));
        assert!(refuses(
            "SystemCallFilter=@system-service\nSystemCallFilter=~@resources @privileged\n"
        ));
        assert!(refuses("SystemCallFilter=@basic-io\n"));
        assert!(!refuses("SystemCallFilter=~@mount\n"));
        assert!(!refuses(
            "SystemCallFilter=~@resources\nSystemCallFilter=@resources\n"
        ));
    }

    proptest! {
        #[test]
        fn any_unit_is_read(text in "(\\[Service\\]\n)?[A-Za-z=~@ \\\\\n#]{0,120}|\\PC{0,80}") {
            let unit = Unit { path: String::new(), settings: service_section(&text) };
            let _ = (unit.has("CAP_SYS_NICE"), unit.limit("LimitRTPRIO"), refuses_scheduling(&unit));
        }
    }
}
