//! `takt ecat sim --second` makes a ring over two veth pairs; a command that is given one of its ends names the other.

mod common;
#[path = "common/network.rs"]
mod network;

use common::{Folder, Process, alone, expect_status, run};
use network::network;

const RING: [&str; 7] = [
    "link set lo up",
    "link add near type veth peer name far",
    "link add back type veth peer name away",
    "link set near up",
    "link set far up",
    "link set back up",
    "link set away up",
];

#[test]
fn ecat_ring_asked_at_one_end_names_the_other() {
    let test = "ecat_ring_asked_at_one_end_names_the_other";
    let Some(()) = network(test, "needs veth", &RING) else {
        return;
    };
    let _alone = alone();
    let devices = ["--devices", "ek1100,el1004,el2004"];
    let mut segment = Process::start(&[
        "ecat", "sim", "far", "--second", "away", devices[0], devices[1],
    ]);
    segment.wait_for("3 slaves in a ring between far and away");
    for (end, other) in [("near", "back"), ("back", "near")] {
        let output = run(&["ecat", "scan", end]);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{error}");
        let named = format!("frames leave the segment at {other}");
        assert!(error.contains(&named), "{error}");
        // In the order in which frames pass the slaves, from either end.
        assert!(error.contains("`near --second back`"), "{error}");
    }
    let whole = expect_status(&run(&["ecat", "scan", "near", "--second", "back"]), 0);
    assert!(whole.contains("the ring is whole"), "{whole}");
    let output = run(&["ecat", "scan", "back", "--second", "near"]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains("the first slave is at near"), "{error}");
    let folder = Folder::new();
    let text = "[[ethercat]]\nname = 'ring'\ninterface = 'near'\nsecond = 'back'\n";
    let cell = folder.write("cell.toml", text);
    let output = run(&["ecat", "stat", "--config", &cell, "--duration", "200ms"]);
    let report = String::from_utf8_lossy(&output.stdout);
    assert!(report.contains("near: 3 slaves"), "{output:?}");
}
