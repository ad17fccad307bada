//! Faults of rejected nets: every `faults/*.net` is a broken net, and the text file of the same
//! name holds the rendered faults. `TAKT_BLESS=1` rewrites these files; read the difference.

#![allow(clippy::unwrap_used, reason = "this file is a test")]

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use takt_net::definition::port;
use takt_net::{
    ArmBinding, Build, Cycle, Definition, Devices, Fault, JointLimits, Limits, LoadContext, Plan,
    Primitive, Registry, Rejection, load,
};

/// Bounds low enough to be exceeded in a few lines.
const LIMITS: Limits = Limits {
    terminate: true,
    text_bytes: 2000,
    primitives: 12,
    depth: 6,
    array_size: 8,
    netcomm: 4,
    cost: Some(Duration::from_nanos(870)),
    history: 5000,
    memory_bytes: 60_000,
};

/// A cell with one arm of one joint.
struct OneArm;

impl Devices for OneArm {
    fn arm(&self, name: &str) -> Option<ArmBinding> {
        let limits = JointLimits {
            position_min: -1.0,
            position_max: 1.0,
            velocity_max: 1.0,
            acceleration_max: 1.0,
        };
        (name == "lwr1").then(|| ArmBinding {
            first_joint: 0,
            limits: Arc::new([limits]),
            kinematics: None,
        })
    }

    fn names(&self) -> Vec<String> {
        vec!["lwr1".to_owned()]
    }
}

/// A primitive that needs a device; those of real devices are in other crates.
struct Joint;

impl Primitive for Joint {
    fn step(&mut self, _: &Cycle<'_>) {}
}

fn try_load(text: &str) -> Result<Plan, Rejection> {
    let mut registry = Registry::core();
    let build = |b: &mut Build<'_, '_>| -> Result<Joint, Fault> { b.arm("Robot").map(|_| Joint) };
    registry.add([Definition::new("Test::Joint", "Needs an arm.", build)
        .input::<f64>(port("inPosition", "position, rad"))
        .text("Robot", "name of the arm")]);
    let context = LoadContext {
        registry: &registry,
        devices: &OneArm,
        period: Duration::from_millis(1),
        limits: LIMITS,
    };
    load(text, &context)
}

fn nets() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let files = std::fs::read_dir(folder).expect("the folder of broken nets");
    let mut nets: Vec<PathBuf> = files.map(|f| f.unwrap().path()).collect();
    nets.retain(|f| f.extension().is_some_and(|e| e == "net"));
    nets.sort();
    nets
}

fn rendered(path: &Path) -> (String, Rejection) {
    let text = std::fs::read_to_string(path).unwrap();
    let name = path.file_name().unwrap().to_string_lossy();
    let rejection = try_load(&text).expect_err(&name);
    let mut lines = rejection.lines(&text).join("\n");
    write!(lines, "\n\n{}", rejection.render(&name, &text)).unwrap();
    (lines, rejection)
}

#[test]
fn faults_match_golden_texts() {
    let bless = std::env::var_os("TAKT_BLESS").is_some();
    let mut different = Vec::new();
    for path in nets() {
        let (lines, _) = rendered(&path);
        let golden = path.with_extension("txt");
        if bless {
            std::fs::write(&golden, &lines).unwrap();
        } else if std::fs::read_to_string(&golden).unwrap_or_default() != lines {
            different.push(format!("{}:\n{lines}", golden.display()));
        }
    }
    let hint = "if the new texts are right, run again with TAKT_BLESS=1";
    assert!(different.is_empty(), "{}\n{hint}", different.join("\n"));
}

#[test]
fn every_kind_of_fault_has_a_net() {
    let kinds = [
        "ArraySize",
        "Bound",
        "Cycle",
        "Cost",
        "Device",
        "LinkForParameter",
        "Netcomm",
        "NoParent",
        "NoTerminate",
        "NotConnected",
        "Parameter",
        "PortLoop",
        "Syntax",
        "TextForPort",
        "Twice",
        "Type",
        "UnknownChild",
        "UnknownInPort",
        "UnknownOutPort",
        "UnknownParameter",
        "UnknownPrimitive",
    ];
    let mut found = BTreeSet::new();
    for path in nets() {
        for fault in rendered(&path).1.faults {
            let debug = format!("{:?}", fault.kind);
            let name = debug.split([' ', '(']).next().unwrap();
            found.insert(name.to_owned());
        }
    }
    assert_eq!(found, kinds.map(str::to_owned).into());
}

#[test]
fn all_faults_are_reported_with_locations() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let text = std::fs::read_to_string(folder.join("many-faults.net")).unwrap();
    let rejection = try_load(&text).unwrap_err();
    let locations: Vec<_> = rejection.faults.iter().map(|f| f.location(&text)).collect();
    assert_eq!(
        locations,
        [(1, 8), (2, 45), (3, 32), (3, 56), (4, 32), (5, 31)]
    );
    assert_eq!(rejection.render("x", &text).matches("Error:").count(), 6);
}

#[test]
fn net_within_bounds_is_accepted() {
    try_load("{c=Cancel(),outTerminate=c.outCancel}").unwrap();
}
