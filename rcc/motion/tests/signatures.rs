//! All primitives that existing clients know exist here with the same ports, parameters and
//! defaults, or belong to the device crates. Their behaviour is tested elsewhere.

#[path = "../../net/tests/common/signatures.rs"]
mod signatures;

use takt_net::Registry;

/// Primitive families defined in the device and network crates.
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

/// Primitive families of Takt alone.
const OWN: &[&str] = &[
    "Motion::",
    "Takeover",
    "DeviceFailure",
    "ArmKinematics::VelKin",
];

/// Out ports that Takt adds to known primitives.
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
fn primitive_signatures_have_descriptions() {
    signatures::are_explained(&registry());
}

#[test]
fn motion_and_geometry_parameters_declare_their_quantity() {
    let families = [
        "Motion::",
        "World::Frame",
        "World::Rotation",
        "World::Twist",
        "World::Wrench",
    ];
    signatures::have_quantities(&registry(), &families, &[]);
}
