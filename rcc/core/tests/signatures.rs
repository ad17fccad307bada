//! A controller has all primitives that existing clients know, with the same ports, parameters and
//! defaults.

#[path = "../../net/tests/common/signatures.rs"]
mod signatures;

/// Families of primitives of Takt alone.
const OWN: &[&str] = &[
    "Motion::",
    "Takeover",
    "DeviceFailure",
    "ArmKinematics::VelKin",
    "Homing::",
    "Irl::",
];

/// Out ports that Takt adds to primitives that clients know.
const ADDED: &[(&str, &str)] = &[
    ("ArmKinematics::InvKin", "outError:int"),
    ("KUKA::LWR::InvKin", "outError:int"),
    ("KUKA::LWR::JointImpParameters", "outCompleted:bool"),
    ("KUKA::LWR::JointImpParameters", "outError:int"),
    ("KUKA::LWR::CartImpParameters", "outCompleted:bool"),
    ("KUKA::LWR::CartImpParameters", "outError:int"),
];

#[test]
fn every_primitive_has_its_known_signature() {
    signatures::are_known(&takt_core::registry(), |_| false, OWN, ADDED);
}

#[test]
fn primitive_signatures_have_descriptions() {
    signatures::are_explained(&takt_core::registry());
}

#[test]
fn robot_parameters_declare_their_quantity() {
    let families = [
        "RobotArm::",
        "RobotBase::",
        "KUKA::",
        "Motion::",
        "CartesianPosition::",
        "ArmKinematics::",
        "schunkwsg::",
    ];
    signatures::have_quantities(&takt_core::registry(), &families, &[]);
}
