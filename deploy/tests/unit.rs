//! The installed files grant what cycles need and nothing that interferes with them. Installs nothing and starts no service.

#![expect(
    clippy::unwrap_used,
    reason = "a test that cannot go on ends, and one that cannot run says so"
)]

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_deploy::{CELL, FILES, LIMITS, SERVICE, SYSCTL, SYSUSERS, UDEV_RULES};
use takt_tests::skip;

fn settings(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Values by name; each directive of the unit occurs once, except those whose lines add up, which are checked
/// separately.
fn unit() -> HashMap<&'static str, &'static str> {
    let mut found = HashMap::new();
    for (name, value) in settings(SERVICE).filter_map(|line| line.split_once('=')) {
        let twice = found.insert(name, value).is_some();
        assert!(!twice || ADDED_UP.contains(&name), "{name} stands twice");
    }
    found
}

const FILTER: &str = "SystemCallFilter";
const DEVICES: &str = "DeviceAllow";
const ADDED_UP: [&str; 4] = [FILTER, DEVICES, "Wants", "After"];

fn values(directive: &str) -> Vec<&'static str> {
    let lines = settings(SERVICE).filter_map(|line| line.split_once('='));
    lines
        .filter(|(name, _)| *name == directive)
        .map(|(_, value)| value)
        .collect()
}

#[test]
fn unit_keeps_real_time() {
    let unit = unit();
    for (name, why) in [
        ("RestrictRealtime", "refuses SCHED_FIFO"),
        ("PrivateDevices", "hides /dev/cpu_dma_latency"),
        ("PrivateNetwork", "hides the buses"),
        (
            "CPUSchedulingPolicy",
            "raises every thread, not only cycle threads",
        ),
        ("CPUQuota", "pauses cycles"),
        ("LimitRTTIME", "kills a thread that works long"),
        ("DynamicUser", "breaks file ownership"),
        ("ProtectClock", "restricts devices further than DeviceAllow"),
    ] {
        assert!(!unit.contains_key(name), "{name} {why}");
    }
    // A denied group may contain scheduler calls, as "resources" does; this one contains none.
    assert_eq!(values(FILTER), ["@system-service", "~@privileged"]);
}

#[test]
fn unit_sandbox_permits_cycles() {
    let unit = unit();
    for (name, value) in [
        ("LimitRTPRIO", "95"),
        ("LimitMEMLOCK", "infinity"),
        ("AmbientCapabilities", "CAP_NET_RAW"),
        ("NoNewPrivileges", "yes"),
    ] {
        assert_eq!(unit.get(name), Some(&value), "{name}");
    }
    let families: Vec<&str> = unit["RestrictAddressFamilies"].split(' ').collect();
    for family in ["AF_INET", "AF_PACKET", "AF_CAN", "AF_NETLINK"] {
        assert!(families.contains(&family), "{family}");
    }
    for capability in unit["AmbientCapabilities"].split(' ') {
        assert!(
            unit["CapabilityBoundingSet"].contains(capability),
            "{capability} is cut off"
        );
    }
}

#[test]
fn unit_matches_program() {
    let unit = unit();
    assert_eq!(unit["Type"], "notify");
    assert_eq!(unit["NotifyAccess"], "main");
    assert_eq!(unit["ExecReload"], "/bin/kill -HUP $MAINPID");
    assert_eq!(unit["StateDirectory"], "takt");
    assert_eq!(
        unit["ExecStart"],
        "/usr/bin/takt run --config /etc/takt/cell.toml"
    );
    // Robots have thirteen seconds to stop; the watchdog must not fire, nor the stop be cut short.
    let seconds = |name: &str| unit[name].parse::<u32>().unwrap();
    assert!(seconds("TimeoutStopSec") > 13);
    assert!((2..=10).contains(&seconds("WatchdogSec")));
}

#[test]
fn unit_restarts_except_for_invalid_cell() {
    let unit = unit();
    assert_eq!(unit["Restart"], "on-failure");
    assert_eq!(unit["RestartPreventExitStatus"], "78");
    // Otherwise a robot's interface that appears late would find no controller.
    assert_eq!(unit["StartLimitIntervalSec"], "0");
    assert_eq!(values("Wants").first(), Some(&"network-online.target"));
    assert_eq!(values("After"), values("Wants"));
}

#[test]
fn unit_admits_serial_lines_of_bases() {
    let devices = [
        "/dev/cpu_dma_latency rw",
        "char-ttyUSB rw",
        "char-ttyACM rw",
    ];
    assert_eq!(values(DEVICES), devices);
    // A group of devices that the kernel does not know yet is not admitted: its module is loaded before.
    for module in ["usbserial", "cdc_acm"] {
        let service = format!("modprobe@{module}.service");
        let is_loaded = values("Wants").iter().any(|units| units.contains(&service));
        assert!(is_loaded, "{module}");
    }
    assert!(settings(SYSUSERS).any(|line| line == "m takt dialout"));
}

/// Score of `systemd-analyze security`, in tenths; lower is better. The README lists what remains.
const EXPOSURE_MAX: u32 = 25;

#[test]
fn unit_exposure_within_limit() {
    let unit = written_unit("exposure");
    let mut analyze = Command::new("systemd-analyze");
    analyze.args(["security", "--no-pager", "--offline=yes"]);
    let output = analyze
        .arg(format!("--threshold={EXPOSURE_MAX}"))
        .arg(&unit)
        .output();
    fs::remove_dir_all(unit.parent().unwrap()).unwrap();
    let Ok(output) = output else {
        skip("unit_exposure_within_limit", "needs systemd-analyze");
        return;
    };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("Overall exposure level"), "{said}");
}

#[test]
fn package_installs_files_at_stated_paths() {
    let manifest = read("Cargo.toml");
    assert!(manifest.contains("unit-name = \"takt\""));
    // The unit is installed with its folder, to systemd's unit path.
    for file in FILES.iter().filter(|file| file.text != SERVICE) {
        let (folder, name) = file.path.rsplit_once('/').unwrap();
        let folder = folder.trim_start_matches('/');
        let found = manifest.lines().any(|line| {
            let words: Vec<&str> = line.split('"').collect();
            words
                .get(1)
                .is_some_and(|from| from.ends_with(&format!("/{name}")))
                && words.get(3) == Some(&format!("{folder}/").as_str())
        });
        assert!(found, "{} is not in the package", file.path);
    }
}

#[test]
fn package_version_is_workspace_version() {
    let version = env!("CARGO_PKG_VERSION");
    let changelog = read("debian/changelog");
    assert!(
        changelog.starts_with(&format!("takt ({version}-1) ")),
        "{changelog}"
    );
}

#[test]
fn maintainer_scripts_are_shell() {
    for name in ["postinst", "prerm", "postrm"] {
        let script = read(&format!("debian/{name}"));
        assert!(script.starts_with("#!/bin/sh\n"), "{name}");
        assert!(
            script.contains("\nset -e\n") && script.contains("\n#DEBHELPER#\n"),
            "{name}"
        );
        let path = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("debian")
            .join(name);
        assert!(
            Command::new("sh")
                .arg("-n")
                .arg(path)
                .status()
                .unwrap()
                .success(),
            "{name}"
        );
    }
    // A purge removes the service's state; a removal does not.
    let postrm = read("debian/postrm");
    let purge = postrm.split("if [ \"$1\" = purge ]").nth(1).unwrap();
    assert!(purge.contains("/var/lib/takt") && postrm.matches("/var/lib/takt").count() == 1);
}

fn read(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap()
}

#[test]
fn files_agree_on_account_and_limits() {
    assert!(settings(SYSUSERS).any(|line| line.starts_with("u takt ")));
    assert_eq!((unit()["User"], unit()["Group"]), ("takt", "takt"));
    assert!(settings(UDEV_RULES).all(|line| line.contains("GROUP=\"takt\"")));
    assert!(settings(LIMITS).all(|line| line.starts_with("@takt - ")));
    assert!(
        settings(LIMITS).any(|line| line.ends_with(&format!("rtprio {}", unit()["LimitRTPRIO"])))
    );
}

#[test]
fn sysctl_is_well_formed_and_keeps_throttling() {
    for line in settings(SYSCTL) {
        let (name, value) = line.split_once(" = ").unwrap();
        assert!(
            name.trim_start_matches('-').contains('.') && value.parse::<u32>().is_ok(),
            "{line}"
        );
        assert!(!name.contains("sched_rt"), "{line}");
    }
}

#[test]
fn files_are_all_listed() {
    let mut count = 0;
    for folder in ["systemd", "sysusers", "udev", "sysctl", "limits", "config"] {
        for entry in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let text = fs::read_to_string(&path).unwrap();
            let file = FILES.iter().find(|file| file.text == text).unwrap();
            assert!(
                text.contains(file.path),
                "{} does not state its path",
                path.display()
            );
            assert_eq!(Path::new(file.path).file_name(), path.file_name());
            count += 1;
        }
    }
    assert_eq!(count, FILES.len());
}

/// The unit in a folder of its own.
fn written_unit(what: &str) -> PathBuf {
    // The program is not installed where tests run, and systemd checks for it.
    let text = SERVICE.replace("/usr/bin/takt", "/bin/true");
    assert_ne!(text, SERVICE);
    let folder = std::env::temp_dir().join(format!("takt-unit-{what}-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join("takt.service");
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn unit_is_accepted_by_systemd() {
    let path = written_unit("verify");
    let output = Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(&path)
        .output();
    fs::remove_dir_all(path.parent().unwrap()).unwrap();
    let Ok(output) = output else {
        skip("unit_is_accepted_by_systemd", "needs systemd-analyze");
        return;
    };
    // It reports other units of the host, too.
    let said = String::from_utf8_lossy(&output.stderr);
    let ours: Vec<&str> = said
        .lines()
        .filter(|line| line.contains("takt.service"))
        .collect();
    assert!(ours.is_empty(), "{ours:#?}");
}

#[test]
fn unit_memory_limit_exceeds_net_limit() {
    let limit = SERVICE.lines().find_map(|line| {
        let mib: u32 = line
            .strip_prefix("MemoryMax=")?
            .strip_suffix('G')?
            .parse()
            .ok()?;
        Some(mib * 1024)
    });
    let nets = 1024;
    assert!(
        limit.is_some_and(|limit| limit >= nets + nets / 2),
        "{limit:?}"
    );
    assert!(
        CELL.lines()
            .all(|line| !line.starts_with("nets_memory_mib"))
    );
}
