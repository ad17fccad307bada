//! `takt fri` on misconfigured networks: robot and host are two network namespaces with a cable between them. Where
//! namespaces are not permitted, each test reports that it was skipped.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;

use std::process::Command;

use common::{alone, expect_status};

/// A host with the interface `host0`, and at the other end of its cable `robot0` in a namespace in which `robot` runs
/// commands.
const CABLE: &str = r#"
set -e
ip link set lo up
ip link add host0 type veth peer name robot0
unshare --net sleep 60 &
pid=$!
trap 'kill $pid $emulator 2>/dev/null' EXIT
until [ "$(readlink /proc/$pid/ns/net)" != "$(readlink /proc/$$/ns/net)" ]; do sleep 0.05; done
robot() { nsenter --net=/proc/$pid/ns/net "$@"; }
ip link set robot0 netns $pid
ip link set host0 up
robot ip link set robot0 up
"#;

/// A shell in a network namespace of its own.
fn shell(script: &str) -> Command {
    let mut command = Command::new("unshare");
    let id = Command::new("id").arg("-u").output();
    if !id.is_ok_and(|it| it.stdout == b"0\n") {
        command.arg("--map-root-user");
    }
    command.args(["--net", "sh", "-c", script]);
    command
}

/// Whether such networks can be made here; if not, the test is reported as skipped.
fn is_possible(test: &str) -> bool {
    let made = shell(CABLE).output();
    if made.is_ok_and(|made| made.status.success()) {
        return true;
    }
    takt_tests::skip(test, "needs veth");
    false
}

/// Output and status of `takt fri stat` for an arm that sends to `target`, on a network that `network` sets up.
fn stat(network: &str, target: &str, listen: &str) -> std::process::Output {
    let takt = env!("CARGO_BIN_EXE_takt");
    let script = format!(
        "{CABLE}\n{network}\n\
         nsenter --net=/proc/$pid/ns/net {takt} emulate lwr --period 10ms --connect {target} --duration 30s >/dev/null 2>&1 &\n\
         emulator=$!\n\
         set +e\n\
         {takt} fri stat --listen {listen} --duration 3s --timeout 4s\n\
         exit $?\n"
    );
    shell(&script).output().unwrap()
}

/// Output of a run that has to find a fault.
#[track_caller]
fn fault(network: &str, target: &str) -> String {
    expect_status(&stat(network, target, "0.0.0.0:49938"), 1)
}

const SOUND: &str =
    "ip addr add 192.168.0.5/24 dev host0; robot ip addr add 192.168.0.20/24 dev robot0";

#[test]
fn fri_stat_sees_arm_on_sound_network() {
    if !is_possible("fri_stat_sees_arm_on_sound_network") {
        return;
    }
    let _alone = alone();
    let output = stat(SOUND, "192.168.0.5:49938", "0.0.0.0:49938");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("FRI 1.0 (LWR) from 192.168.0.20:"), "{text}");
    assert!(!text.contains("cannot leave"), "{text}");
}

#[test]
fn wrong_address_at_the_controller_is_found() {
    if !is_possible("wrong_address_at_the_controller_is_found") {
        return;
    }
    let _alone = alone();
    let text = fault(SOUND, "192.168.0.99:49938");
    assert_eq!(
        text,
        "192.168.0.20 requests 192.168.0.99, which is no address of this host (192.168.0.5/24 on host0)\n\
         hint: correct the address that the controller sends to, or this host's\n"
    );
}

#[test]
fn wrong_port_at_the_controller_is_found() {
    if !is_possible("wrong_port_at_the_controller_is_found") {
        return;
    }
    let _alone = alone();
    let text = fault(SOUND, "192.168.0.5:30200");
    assert!(
        text.starts_with(
            "192.168.0.20 sends to port 30200 of this host\nhint: listen at 192.168.0.5:30200"
        ),
        "{text}"
    );
}

#[test]
fn wrong_address_to_listen_at_is_found() {
    if !is_possible("wrong_address_to_listen_at_is_found") {
        return;
    }
    let _alone = alone();
    let two = format!("{SOUND}; ip addr add 192.168.0.6/24 dev host0");
    let output = stat(&two, "192.168.0.5:49938", "192.168.0.6:49938");
    assert_eq!(
        expect_status(&output, 1),
        "192.168.0.20 sends to 192.168.0.5, another address of this host\nhint: listen at 192.168.0.5:49938, or at 0.0.0.0:49938\n"
    );
}

#[test]
fn wrong_netmask_of_the_host_is_found() {
    if !is_possible("wrong_netmask_of_the_host_is_found") {
        return;
    }
    let _alone = alone();
    // Too narrow for the robot, which has the right one. What the kernel does depends on its filter of senders.
    let narrow =
        "ip addr add 192.168.0.5/30 dev host0; robot ip addr add 192.168.0.20/24 dev robot0";
    for filter in [0, 1] {
        let network = format!("{narrow}; echo {filter} >/proc/sys/net/ipv4/conf/host0/rp_filter");
        let text = fault(&network, "192.168.0.5:49938");
        assert!(text.contains("netmask"), "filter {filter}: {text}");
        assert!(
            ["no route to it", "no route back", "excludes it"]
                .iter()
                .any(|part| text.contains(part)),
            "filter {filter}: {text}"
        );
    }
}

#[test]
fn firewall_of_the_host_is_found() {
    if !is_possible("firewall_of_the_host_is_found") {
        return;
    }
    let _alone = alone();
    // The routes drop what a packet filter would; no program is needed for that.
    let dropping = format!(
        "{SOUND}; ip rule add pref 1 from all lookup local; ip rule del pref 0; \
         ip rule add pref 0 iif host0 ipproto udp dport 49938 blackhole"
    );
    let text = fault(&dropping, "192.168.0.5:49938");
    assert!(
        text.starts_with(
            "measurements of 192.168.0.20 reach this host and are dropped by it\nhint: let its firewall pass UDP port 49938"
        ),
        "{text}"
    );
}

#[test]
fn unplugged_arm_is_distinguished_from_wrong_network() {
    if !is_possible("unplugged_arm_is_distinguished_from_wrong_network") {
        return;
    }
    let _alone = alone();
    let text = fault(
        &format!("{SOUND}; robot ip link set robot0 down"),
        "192.168.0.5:49938",
    );
    assert!(
        text.contains("the wire shows no trace of a controller"),
        "{text}"
    );
}
