//! The installed files say what cycles need and nothing that takes it away. Installs nothing and
//! starts no service.

use std::collections::HashMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Command;

use takt_deploy::{FILES, LIMITS, SERVICE, SYSCTL, SYSUSERS, UDEV_RULES};

fn settings(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
}

/// Values by name; no directive of the unit stands twice.
fn unit() -> HashMap<&'static str, &'static str> {
    let mut found = HashMap::new();
    for (name, value) in settings(SERVICE).filter_map(|line| line.split_once('=')) {
        assert!(found.insert(name, value).is_none(), "{name} stands twice");
    }
    found
}

#[test]
fn nothing_takes_real_time_away() {
    let unit = unit();
    for (name, why) in [
        ("RestrictRealtime", "refuses SCHED_FIFO"),
        ("PrivateDevices", "hides /dev/cpu_dma_latency"),
        ("PrivateNetwork", "hides the buses"),
        (
            "CPUSchedulingPolicy",
            "raises every thread, not only those of cycles",
        ),
        ("CPUQuota", "pauses cycles"),
        ("LimitRTTIME", "kills a thread that works long"),
        ("DynamicUser", "breaks file ownership"),
        (
            "ProtectClock",
            "narrows the devices further than DeviceAllow says",
        ),
    ] {
        assert!(!unit.contains_key(name), "{name} {why}");
    }
    assert!(
        !unit["SystemCallFilter"].contains('~'),
        "a denied group may hold scheduler calls"
    );
}

#[test]
fn sandbox_leaves_what_cycles_need() {
    let unit = unit();
    for (name, value) in [
        ("LimitRTPRIO", "95"),
        ("LimitMEMLOCK", "infinity"),
        ("SystemCallFilter", "@system-service"),
        ("DeviceAllow", "/dev/cpu_dma_latency rw"),
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
fn service_claims_no_readiness_it_does_not_report() {
    let unit = unit();
    assert_eq!(unit["Type"], "exec");
    assert!(!unit.contains_key("WatchdogSec"));
    assert_eq!(
        unit["ExecStart"],
        "/usr/bin/takt run --config /etc/takt/cell.toml"
    );
}

#[test]
fn all_files_speak_of_the_same_account_and_limits() {
    assert!(settings(SYSUSERS).any(|line| line.starts_with("u takt ")));
    assert_eq!((unit()["User"], unit()["Group"]), ("takt", "takt"));
    assert!(settings(UDEV_RULES).all(|line| line.contains("GROUP=\"takt\"")));
    assert!(settings(LIMITS).all(|line| line.starts_with("@takt - ")));
    assert!(
        settings(LIMITS).any(|line| line.ends_with(&format!("rtprio {}", unit()["LimitRTPRIO"])))
    );
}

#[test]
fn kernel_settings_are_well_formed_and_leave_throttling_on() {
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
fn every_file_is_listed() {
    let mut count = 0;
    for folder in ["systemd", "sysusers", "udev", "sysctl", "limits"] {
        for entry in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let text = fs::read_to_string(&path).unwrap();
            let file = FILES.iter().find(|file| file.text == text).unwrap();
            assert!(
                text.contains(file.path),
                "{} does not say where it goes",
                path.display()
            );
            assert_eq!(Path::new(file.path).file_name(), path.file_name());
            count += 1;
        }
    }
    assert_eq!(count, FILES.len());
}

#[test]
fn systemd_accepts_the_unit() {
    // The program is not installed where tests run, and systemd looks for it.
    let text = SERVICE.replace("/usr/bin/takt", "/bin/true");
    assert_ne!(text, SERVICE);
    let folder = std::env::temp_dir().join(format!("takt-unit-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let path = folder.join("takt.service");
    fs::write(&path, text).unwrap();
    let output = Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(&path)
        .output();
    fs::remove_dir_all(&folder).unwrap();
    let Ok(output) = output else {
        eprintln!("skipped: needs systemd-analyze");
        if let Some(path) = std::env::var_os("TAKT_SKIPS") {
            let mut skips = fs::OpenOptions::new().append(true).open(path).unwrap();
            writeln!(skips, "systemd_accepts_the_unit: needs systemd-analyze").unwrap();
        }
        return;
    };
    // It speaks of other units of the host, too.
    let said = String::from_utf8_lossy(&output.stderr);
    let ours: Vec<&str> = said
        .lines()
        .filter(|line| line.contains("takt.service"))
        .collect();
    assert!(ours.is_empty(), "{ours:#?}");
}
