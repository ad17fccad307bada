//! All primitives that existing clients know exist here with the same ports, parameters and
//! defaults, or belong to the crates of devices. What the primitives do is tested elsewhere.

#[path = "../../net/tests/common/signatures.rs"]
mod signatures;

use takt_net::Registry;

/// Families of primitives that are defined where devices and networks are.
const ELSEWHERE: &[&str] = &[
    "ArmKinematics::",
    "CartesianPosition::",
    "IO::",
    "KUKA::",
    "KUKA:LWR::",
    "RobotArm::",
    "RobotBase::",
    "schunkwsg::",
];

/// Families of primitives of Takt alone.
const OWN: &[&str] = &["Motion::", "Takeover"];

/// Out ports that Takt adds to primitives that clients know.
const ADDED: &[(&str, &str)] = &[
    ("ArmKinematics::InvKin", "outError:int"),
    ("KUKA::LWR::InvKin", "outError:int"),
];

fn is_elsewhere(name: &str) -> bool {
    ELSEWHERE.iter().any(|prefix| name.starts_with(prefix)) || name.contains("InterNetcomm")
}

fn registry() -> Registry {
    let mut registry = Registry::core();
    registry.add(takt_motion::all());
    registry
}

#[test]
fn every_primitive_has_its_known_signature() {
    signatures::are_known(&registry(), is_elsewhere, OWN, ADDED);
}

#[test]
fn everything_is_explained() {
    signatures::are_explained(&registry());
}
