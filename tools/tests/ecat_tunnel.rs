//! `takt ecat eoe` between real interfaces: the host pings an emulated slave through its mailbox.

mod common;
#[path = "common/network.rs"]
mod network;

use std::process::Command;

use common::{Folder, Process, alone, expect_status, run};
use network::network;

const CABLE: [&str; 4] = [
    "link set lo up",
    "link add near type veth peer name far",
    "link set near up",
    "link set far up",
];

#[test]
fn ecat_tunnel_host_pings_slave() {
    let test = "ecat_tunnel_host_pings_slave";
    let Some(()) = network(test, "needs veth", &CABLE) else {
        return;
    };
    if std::fs::File::open("/dev/net/tun").is_err()
        || Command::new("ping").arg("-V").output().is_err()
    {
        takt_tests::skip(test, "needs /dev/net/tun and ping");
        return;
    }
    let _alone = alone();
    let folder = Folder::new();
    let text = "[[slave]]\nkind = 'coupler'\n[[slave]]\nkind = 'drive'\nethernet = true\n";
    let plan = folder.write("line.toml", text);
    let mut segment = Process::start(&["ecat", "sim", "far", "--devices", &plan]);
    segment.wait_for("2 slaves");
    let get = ["ecat", "eoe", "near", "1", "get"];
    let none = expect_status(&run(&get), 0);
    assert!(none.contains("slave 1: none"), "{none}");
    let set = ["ecat", "eoe", "near", "1", "set-ip", "10.9.0.2/24"];
    expect_status(&run(&set), 0);
    let address = expect_status(&run(&get), 0);
    assert!(
        address.contains("IP 10.9.0.2, mask 255.255.255.0"),
        "{address}"
    );
    let refused = run(&["ecat", "eoe", "near", "0", "get"]);
    assert_eq!(refused.status.code(), Some(1), "{refused:?}");
    let mut tunnel = Process::start(&[
        "ecat",
        "eoe",
        "near",
        "1",
        "tunnel",
        "eoe0",
        "--slave-ip",
        "10.9.0.2/24",
        "--host-ip",
        "10.9.0.1/24",
    ]);
    tunnel.wait_for("slave 1 is at eoe0, at most");
    // Whole frames, each in sixteen messages.
    for size in ["56", "1400"] {
        let ping = Command::new("ping")
            .args(["-c", "3", "-i", "0.2", "-W", "5", "-s", size, "10.9.0.2"])
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&ping.stdout).into_owned();
        assert!(text.contains("3 received"), "{text}");
    }
    tunnel.signal("INT");
    let (lines, status) = tunnel.end();
    let report = lines.join("\n");
    assert_eq!(status, Some(0), "{report}");
    assert!(
        report.contains("0 from the slave with broken fragments"),
        "{report}"
    );
}
