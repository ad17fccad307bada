//! `takt run` over interfaces that go down, lose their cable and come back: its log reports each change once. Each
//! test is in a network namespace of its own; where namespaces are not permitted, it reports that it was skipped.

mod common;
#[path = "common/network.rs"]
mod network;

use common::{Folder, Process, complaint, run};
use network::{ip, network};

/// A controller of a cell, which logs as a service does.
fn controller(folder: &Folder, cell: &str) -> Process {
    let cell = format!("[controller]\nwebsocket = '127.0.0.1:0'\ntcp = '127.0.0.1:0'\n{cell}");
    let config = folder.write("cell.toml", &cell);
    Process::start(&["run", "--config", &config])
}

#[track_caller]
fn expect_line(controller: &mut Process, level: &str, text: &str) {
    let line = controller.wait_for(text);
    assert!(line.contains(level), "{level}: {line}");
}

/// How often a text came, once the controller has ended.
fn count(lines: &[String], text: &str) -> usize {
    lines.iter().filter(|line| line.contains(text)).count()
}

const VETH: [&str; 2] = ["link set lo up", "link add bus0 type veth peer name far0"];

#[test]
fn run_reports_ethercat_link_at_once_and_on_change() {
    let test = "run_reports_ethercat_link_at_once_and_on_change";
    let Some(()) = network(test, "needs veth", &VETH) else {
        return;
    };
    let folder = Folder::new();
    let cell = "[[ethercat]]\nname = 'line'\ninterface = 'bus0'\npriority = 50\n\
        [[ethercat.slave]]\nname = 'coupler'\nposition = 0\n";
    let mut controller = controller(&folder, cell);
    expect_line(&mut controller, "ERROR", "bus0: the interface is not up");
    controller.wait_for("hint: `ip link set bus0 up`");
    assert!(ip("link set bus0 up"));
    expect_line(&mut controller, "ERROR", "bus0: no carrier");
    assert!(ip("link set far0 up"));
    expect_line(&mut controller, "INFO", "bus0: the link works again");
    assert!(ip("link set bus0 down"));
    expect_line(&mut controller, "ERROR", "bus0: the interface is not up");
    assert!(ip("link del far0"));
    expect_line(&mut controller, "ERROR", "bus0: no such interface");
    controller.terminate();
    let (lines, status) = controller.end();
    assert_eq!(status, Some(0), "{lines:#?}");
    // Each once for each time that it came to be so.
    assert_eq!(
        count(&lines, "bus0: the interface is not up"),
        2,
        "{lines:#?}"
    );
    assert_eq!(count(&lines, "bus0: no such interface"), 1, "{lines:#?}");
    assert_eq!(count(&lines, "bus0: the link works again"), 1, "{lines:#?}");
}

#[test]
fn run_reports_link_of_fri_address() {
    let test = "run_reports_link_of_fri_address";
    let commands = [VETH[0], VETH[1], "addr add 192.168.7.5/24 dev bus0"];
    let Some(()) = network(test, "needs veth", &commands) else {
        return;
    };
    let folder = Folder::new();
    let cell = "[[device]]\nname = 'left'\ntype = 'kuka_lwr_fri'\nlisten = '192.168.7.5:0'\n";
    let mut controller = controller(&folder, cell);
    expect_line(&mut controller, "ERROR", "bus0: the interface is not up");
    assert!(ip("link set far0 up") && ip("link set bus0 up"));
    expect_line(&mut controller, "INFO", "bus0: the link works again");
    assert!(ip("link set far0 down"));
    expect_line(&mut controller, "ERROR", "bus0: no carrier");
}

#[test]
fn run_reports_can_link_at_once_and_on_change() {
    let test = "run_reports_can_link_at_once_and_on_change";
    let Some(()) = network(
        test,
        "needs vcan",
        &["link set lo up", "link add bus0 type vcan"],
    ) else {
        return;
    };
    let folder = Folder::new();
    let cell = "[[canopen]]\nname = 'net'\ninterface = 'bus0'\npriority = 50\n\
        [[canopen.arm]]\nname = 'arm'\n\
        [[canopen.arm.joint]]\nnode = 1\nincrements_per_turn = 65536\nrange = [-90, 90]\n\
        velocity_max = 10\nacceleration_max = 10\n";
    let mut controller = controller(&folder, cell);
    expect_line(&mut controller, "ERROR", "bus0: the interface is not up");
    controller.wait_for("hint: `ip link set bus0 up type can bitrate BITRATE`");
    assert!(ip("link set bus0 up"));
    expect_line(&mut controller, "INFO", "bus0: the link works again");
    assert!(ip("link set bus0 down"));
    expect_line(&mut controller, "ERROR", "bus0: the interface is not up");
}

#[test]
fn ecat_scan_names_link_fault_and_remedy() {
    let Some(()) = network("ecat_scan_names_link_fault_and_remedy", "needs veth", &VETH) else {
        return;
    };
    let down = run(&["ecat", "scan", "bus0"]);
    assert_eq!(down.status.code(), Some(2));
    let text = complaint(&down);
    assert!(
        text.contains("bus0: the interface is not up: Network is down"),
        "{text}"
    );
    assert!(text.contains("hint: `ip link set bus0 up`"), "{text}");
    assert!(ip("link set bus0 up"));
    let text = complaint(&run(&["ecat", "scan", "bus0"]));
    assert!(text.contains("bus0: no carrier"), "{text}");
}
