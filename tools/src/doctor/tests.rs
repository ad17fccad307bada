//! Every condition on a good and on a bad host, and all of them on random files.
//!
//! How the command line shows them is tested from outside, in `tests/doctor.rs`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use proptest::prelude::*;

use super::condition::Status;
use super::examine::{GROUPS, Row, examine};
use super::host::{Entry, Host};

type Files = BTreeMap<String, Entry>;

static GOOD: LazyLock<Files> = LazyLock::new(|| load("good"));
static BAD: LazyLock<Files> = LazyLock::new(|| load("bad"));

/// All that was saved from a host.
fn load(name: &str) -> Files {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/doctor")
        .join(name);
    let mut files = Files::new();
    read(&root, &root, &mut files);
    assert!(files.len() > 80, "{name} is no complete host");
    files
}

fn read(root: &Path, folder: &Path, files: &mut Files) {
    for item in fs::read_dir(folder).unwrap() {
        let path = item.unwrap().path();
        let name = format!("/{}", path.strip_prefix(root).unwrap().display());
        if let Ok(target) = fs::read_link(&path) {
            files.insert(name, Entry::Link(target.display().to_string()));
        } else if path.is_dir() {
            read(root, &path, files);
        } else {
            files.insert(name, Entry::Text(fs::read_to_string(&path).unwrap()));
        }
    }
    let denied = files.get("/takt-doctor/denied").cloned();
    if let Some(Entry::Text(paths)) = denied {
        files.extend(paths.lines().map(|path| (path.to_owned(), Entry::Denied)));
    }
}

/// The file says this, or is not there.
fn set(files: &mut Files, path: &str, text: Option<&str>) {
    match text {
        Some(text) => drop(files.insert(path.to_owned(), Entry::Text(text.to_owned()))),
        None => drop(files.remove(path)),
    }
}

/// A condition's name without the interface.
fn base(row: &Row) -> &str {
    row.name.split(' ').next().unwrap()
}

/// Name of a condition, what is different from a host, its status then, and a part of what was read.
type Case<'a> = (&'a str, &'a [(&'a str, Option<&'a str>)], Status, &'a str);

/// What a condition finds on the good host with something different.
fn row_of(case: &Case<'_>) -> Row {
    let mut files = GOOD.clone();
    for (path, text) in case.1 {
        set(&mut files, path, *text);
    }
    let rows = examine(&Host::known(files));
    let row = rows.into_iter().find(|row| base(row) == case.0);
    row.unwrap_or_else(|| panic!("no condition {}", case.0))
}

const CPU: &str = "/sys/devices/system/cpu";
const UNIT: &str = "/usr/lib/systemd/system/takt.service";

/// What is wrong with the good host, one thing at a time.
#[rustfmt::skip]
const FALLS: &[Case<'_>] = &[
    ("preemption", &[("/sys/kernel/realtime", None), ("/proc/version", Some("Linux version 6.1 #1 SMP PREEMPT_DYNAMIC Debian")), ("/sys/kernel/debug/sched/preempt", Some("none voluntary (full)"))], Status::Warn, "preempt=full (debugfs)"),
    ("preemption", &[("/sys/kernel/realtime", Some("0")), ("/proc/version", Some("Linux version 6.1 #1 SMP PREEMPT_DYNAMIC")), ("/proc/cmdline", Some("quiet preempt=voluntary"))], Status::Fail, "voluntary (command line)"),
    ("preemption", &[("/sys/kernel/realtime", None), ("/proc/version", Some("Linux version 5.4 #1 SMP")), ("/takt-doctor/kernel-config", Some("PREEMPT_NONE y\n"))], Status::Fail, "none (as built)"),
    ("preemption", &[("/sys/kernel/realtime", None), ("/proc/version", Some("Linux version 5.4 #1 SMP")), ("/takt-doctor/kernel-config", None)], Status::Fail, "mode unknown"),
    ("rt-throttling", &[("/proc/sys/kernel/sched_rt_runtime_us", Some("0"))], Status::Fail, "no real time at all"),
    ("rt-throttling", &[("/proc/sys/kernel/sched_rt_runtime_us", Some("100000"))], Status::Warn, "100000 of 1000000"),
    ("rt-throttling", &[("/proc/sys/kernel/sched_rt_runtime_us", Some("-1"))], Status::Ok, "fair server"),
    ("rt-throttling", &[("/proc/sys/kernel/sched_rt_runtime_us", None)], Status::Skip, "no /proc"),
    ("rt-group-scheduling", &[("/proc/self/cgroup", Some("1:cpu,cpuacct:/robots\n")), ("/sys/fs/cgroup/cpu/robots/cpu.rt_runtime_us", Some("0"))], Status::Fail, "0 us for group /robots"),
    ("rt-group-scheduling", &[("/proc/self/cgroup", Some("1:cpu:/\n")), ("/sys/fs/cgroup/cpu/cpu.rt_runtime_us", Some("950000"))], Status::Ok, "950000 us for group /"),
    ("rt-group-scheduling", &[("/takt-doctor/kernel-config", Some("RT_GROUP_SCHED y\n")), ("/proc/cmdline", Some("rt_group_sched=0"))], Status::Ok, "switched off"),
    ("stolen-time", &[("/proc/stat", Some("cpu 1 2 3"))], Status::Skip, "does not count"),
    ("cpu-isolation", &[("/sys/devices/system/cpu/isolated", Some("0-3"))], Status::Fail, "none is left"),
    ("cpu-isolation", &[("/sys/devices/system/cpu/online", Some("0")), ("/sys/devices/system/cpu/isolated", Some(""))], Status::Warn, "one processor"),
    ("cpu-isolation", &[("/proc/cmdline", Some("isolcpus=domain,2-3"))], Status::Warn, "without managed_irq"),
    ("cpu-isolation", &[("/sys/devices/system/cpu/isolated", Some("")), ("/sys/fs/cgroup/cpuset.cpus.isolated", Some("3"))], Status::Ok, "3 of 0-3"),
    ("tickless-cpus", &[("/sys/devices/system/cpu/nohz_full", Some("(null)"))], Status::Warn, "2-3 isolated but not tickless"),
    ("tickless-cpus", &[("/sys/devices/system/cpu/nohz_full", None)], Status::Skip, "no nohz_full"),
    ("rcu-callbacks", &[("/sys/devices/system/cpu/nohz_full", Some("2")), ("/proc/cmdline", Some("quiet"))], Status::Warn, "run on isolated 3"),
    ("workqueues", &[("/sys/devices/virtual/workqueue/cpumask", Some("f"))], Status::Warn, "isolated 2-3"),
    ("smt", &[("/sys/devices/system/cpu/smt/active", Some("1")), ("/sys/devices/system/cpu/cpu2/topology/thread_siblings_list", Some("0,2"))], Status::Warn, "isolated 2 shares its core with 0"),
    ("smt", &[("/sys/devices/system/cpu/smt/active", Some("1")), ("/sys/devices/system/cpu/cpu2/topology/thread_siblings_list", Some("2-3"))], Status::Ok, "share no core"),
    ("rt-rivals", &[("/takt-doctor/tasks", Some("7 deadline 0 user 2 robot task\n"))], Status::Warn, "robot task (deadline 0) on 2"),
    ("rt-rivals", &[("/takt-doctor/tasks", Some("7 fifo 99 user 0-1 other\n8 fifo 99 kernel 2 migration/2\n9 fifo 90 user 2 takt-net\n"))], Status::Ok, "none"),
    ("lockup-detectors", &[("/proc/sys/kernel/watchdog_cpumask", Some("0-3")), ("/proc/sys/kernel/nmi_watchdog", Some("1"))], Status::Warn, "both watch isolated 2-3"),
    ("irq-affinity", &[("/proc/irq/120/effective_affinity_list", Some("3"))], Status::Warn, "120 nvme0q0 (came 0 times) go to isolated 3"),
    ("irq-affinity", &[("/proc/irq/120/effective_affinity_list", Some("2")), ("/proc/irq/9/effective_affinity_list", Some("2"))], Status::Warn, "and 1 more"),
    ("irq-affinity", &[("/proc/irq/120/effective_affinity_list", Some("3")), ("/proc/irq/120/smp_affinity_list", Some("0-1"))], Status::Ok, "none goes"),
    ("irq-default", &[("/proc/irq/default_smp_affinity", Some("0000000f"))], Status::Warn, "includes isolated 2-3"),
    ("irqbalance", &[("/takt-doctor/tasks", Some("7 other 0 user 0-3 irqbalance\n"))], Status::Warn, "not banned"),
    ("irqbalance", &[("/takt-doctor/tasks", Some("7 other 0 user 0-3 irqbalance\n")), ("/etc/default/irqbalance", Some("IRQBALANCE_BANNED_CPULIST=\"2-3\"\n"))], Status::Ok, "kept away from 2-3"),
    ("turbo", &[("/sys/devices/system/cpu/intel_pstate/no_turbo", None), ("/sys/devices/system/cpu/cpufreq/boost", Some("1"))], Status::Warn, "on"),
    ("idle-states", &[("/sys/devices/system/cpu/cpu0/cpuidle/state2/disable", Some("0"))], Status::Ok, "takt may forbid it"),
    ("idle-states", &[("/sys/devices/system/cpu/cpu0/cpuidle/state2/disable", Some("0")), ("/takt-doctor/permissions", None)], Status::Warn, "C6 takes 170 us"),
    ("idle-states", &[("/sys/devices/system/cpu/cpu0/cpuidle/state2/disable", Some("0")), ("/takt-doctor/permissions", None), ("/takt-doctor/dma-latency", Some("0"))], Status::Ok, "bound to 0 us"),
    ("idle-states", &[("/sys/devices/system/cpu/cpuidle/current_driver", Some("none"))], Status::Skip, "no cpuidle driver"),
    ("huge-pages", &[("/sys/kernel/mm/transparent_hugepage/enabled", Some("always madvise [never]"))], Status::Ok, "never"),
    ("numa-balancing", &[("/proc/sys/kernel/numa_balancing", Some("0"))], Status::Ok, "off"),
    ("clocksource", &[("/sys/devices/system/clocksource/clocksource0/current_clocksource", Some("acpi_pm")), ("/sys/devices/system/clocksource/clocksource0/available_clocksource", Some("tsc acpi_pm"))], Status::Fail, "acpi_pm"),
    ("tsc", &[("/proc/cpuinfo", Some("flags : fpu constant_tsc\n"))], Status::Warn, "without nonstop_tsc"),
    ("tsc", &[("/proc/cpuinfo", Some("Features : fp asimd\n"))], Status::Skip, "not a processor of this kind"),
    ("timer-resolution", &[("/takt-doctor/kernel-config", Some("HIGH_RES_TIMERS n\n"))], Status::Fail, "not built"),
    ("realtime-priority", &[("/takt-doctor/permissions", None)], Status::Ok, "limit 95, not tried"),
    ("realtime-priority", &[("/takt-doctor/permissions", Some("fifo Operation not permitted\n"))], Status::Fail, "refused: Operation not permitted (limit 95)"),
    ("memory-lock", &[("/takt-doctor/permissions", None)], Status::Ok, "limit unlimited, not tried"),
    ("raw-ethernet", &[("/takt-doctor/permissions", None)], Status::Ok, "CAP_NET_RAW, not tried"),
    ("login-limits", &[("/etc/security/limits.d/zz.conf", Some("ada soft rtprio 10\n"))], Status::Warn, "rtprio 10"),
    ("login-limits", &[("/etc/security/limits.conf", None)], Status::Skip, "no PAM"),
    ("service-unit", &[(UNIT, None)], Status::Skip, "no takt.service"),
    ("service-priority", &[(UNIT, Some("[Service]\nUser=takt\nLimitRTPRIO=50\n"))], Status::Fail, "LimitRTPRIO=50"),
    ("service-priority", &[(UNIT, Some("[Service]\nExecStart=/usr/bin/takt run\n"))], Status::Ok, "CAP_SYS_NICE"),
    ("service-scheduling", &[(UNIT, Some("[Service]\nCPUSchedulingPolicy=fifo\n"))], Status::Warn, "for every thread"),
    ("service-scheduling", &[(UNIT, Some("[Service]\nLimitRTTIME=200ms\n"))], Status::Warn, "LimitRTTIME=200ms"),
    ("service-sockets", &[(UNIT, Some("[Service]\nRestrictAddressFamilies=~AF_CAN\n"))], Status::Warn, "without AF_CAN"),
    ("nic-link", &[("/sys/class/net/enp2s0/carrier", Some("0")), ("/sys/class/net/enp2s0/operstate", Some("down"))], Status::Warn, "no link, state down"),
    ("nic-link", &[("/sys/class/net/enp2s0/carrier_changes", Some("99"))], Status::Warn, "came or went 99 times"),
    ("nic-coalescing", &[("/takt-doctor/nic/enp2s0", Some("rx-usecs 50\nadaptive-rx off\n"))], Status::Warn, "up to 50 us"),
    ("nic-coalescing", &[("/takt-doctor/nic/enp2s0", Some("rx-usecs 50\nrx-frames 1\nadaptive-rx off\n"))], Status::Ok, "for each frame"),
    ("nic-timestamps", &[("/takt-doctor/nic/enp2s0", Some("software-transmit on\nsoftware-receive on\n"))], Status::Ok, "none on the wire"),
    ("nic-interrupts", &[("/sys/class/net/enp2s0/device/msi_irqs/131", None), ("/sys/class/net/enp2s0/device/msi_irqs/132", None), ("/takt-doctor/nic/enp2s0", Some("device virtio2\n")), ("/proc/interrupts", Some("CPU0\n 7: 1 PCI-MSIX 1-edge virtio2-input.0\n 8: 1 PCI-MSIX 1-edge virtio20-x\n")), ("/proc/irq/7/effective_affinity_list", Some("1"))], Status::Ok, "7, to processors 1"),
    ("can-state", &[("/takt-doctor/can/can0", Some("up no\nstate stopped\n"))], Status::Fail, "down"),
    ("can-state", &[("/takt-doctor/can/can0", Some("up yes\nstate error-passive\n"))], Status::Warn, "error-passive"),
    ("can-state", &[("/takt-doctor/can/can0", Some("up yes\n"))], Status::Ok, "virtual"),
    ("can-bitrate", &[("/takt-doctor/can/can0", Some("bitrate 83333\nsample-point 875\n"))], Status::Warn, "83 kbit/s"),
    ("can-queue", &[("/takt-doctor/can/can0", Some("up yes\n")), ("/sys/class/net/can0/tx_queue_len", Some("10"))], Status::Ok, "virtual bus"),
];

#[test]
fn doctor_single_fault_fails_only_its_condition() {
    for case in FALLS {
        let row = row_of(case);
        let found = (row.finding.status, row.finding.read.as_str());
        assert!(
            found.0 == case.2 && found.1.contains(case.3),
            "{case:?}: {found:?}"
        );
    }
}

#[test]
fn doctor_every_condition_has_good_and_bad_host() {
    let mut rows = examine(&Host::known(GOOD.clone()));
    rows.extend(examine(&Host::known(BAD.clone())));
    rows.extend(FALLS.iter().map(row_of));
    let with = |wanted: fn(Status) -> bool| -> BTreeSet<&str> {
        let rows = rows.iter().filter(|row| wanted(row.finding.status));
        rows.map(base).collect()
    };
    let (good, bad) = (with(|s| s == Status::Ok), with(Status::is_bad));
    let names: Vec<&str> = GROUPS
        .iter()
        .flat_map(|(_, conditions)| conditions.iter().map(|condition| condition.name))
        .collect();
    assert!(names.len() >= 20);
    for name in &names {
        assert!(good.contains(name), "{name} is ok nowhere");
        assert!(bad.contains(name), "{name} is WARN or FAIL nowhere");
    }
    let distinct: BTreeSet<&&str> = names.iter().collect();
    assert_eq!(distinct.len(), names.len(), "two conditions of one name");
}

#[test]
fn doctor_bad_findings_have_remedy_good_have_none() {
    let mut rows = examine(&Host::known(GOOD.clone()));
    rows.extend(examine(&Host::known(BAD.clone())));
    rows.extend(FALLS.iter().map(row_of));
    for row in rows {
        let finding = &row.finding;
        let has_remedy = !finding.remedy.text().is_empty();
        assert_eq!(finding.status.is_bad(), has_remedy, "{row:?}");
        assert!(has_remedy || finding.changes.is_empty(), "{row:?}");
        assert!(!finding.read.is_empty() && !row.why.is_empty(), "{row:?}");
    }
}

#[test]
fn doctor_unknown_host_skips_all_conditions() {
    for row in examine(&Host::known(Files::new())) {
        let expected = match base(&row) {
            // Nothing is what one reads where nothing runs.
            "rt-group-scheduling" | "irq-affinity" => row.finding.status,
            _ => Status::Skip,
        };
        assert_eq!(row.finding.status, expected, "{row:?}");
    }
}

/// Each change fixes its condition.
#[test]
fn doctor_changes_fix_their_condition() {
    let files = BAD.clone();
    for row in examine(&Host::known(files.clone())) {
        if row.finding.changes.is_empty() {
            continue;
        }
        let mut fixed = files.clone();
        for change in &row.finding.changes {
            set(&mut fixed, &change.path, Some(&change.new));
        }
        let rows = examine(&Host::known(fixed));
        let now = rows.iter().find(|now| now.name == row.name).unwrap();
        assert_eq!(now.finding.status, Status::Ok, "{row:?}: {now:?}");
    }
    assert!(files.contains_key(&format!("{CPU}/online")));
}

/// Text that looks like something, text that does not, and numbers of any length.
fn junk() -> impl Strategy<Value = String> {
    let alphabet: Vec<char> = "0123456789afCPU,:()[]=@~ \n./%-".chars().collect();
    let like = prop::collection::vec(prop::sample::select(alphabet), 0..40);
    let number = prop::collection::vec(prop::sample::select(vec!['9', '0', '-']), 1..30);
    let any = prop::collection::vec(any::<char>(), 0..20);
    prop_oneof![like, number, any].prop_map(String::from_iter)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Any file, any content: numbers out of range, lists that never end, text in the wrong place.
    #[test]
    fn doctor_random_files_do_not_panic(
        contents in prop::collection::vec((junk(), 0..4_usize), 250),
        bad: bool,
    ) {
        let mut files = if bad { BAD.clone() } else { GOOD.clone() };
        for (entry, (text, chance)) in files.values_mut().zip(contents) {
            if chance == 0 {
                *entry = Entry::Text(text);
            }
        }
        let rows = examine(&Host::known(files));
        let report = super::report::text(&rows, false);
        prop_assert!(!report.is_empty());
        prop_assert!(super::report::json(&rows).is_ok());
    }
}
