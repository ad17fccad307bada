//! The nets of `tests/nets`: each loads, and has the faults or findings that its README lists. Their
//! behaviour is tested where they run.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use takt_core::device::DeviceTable;
use takt_device_fri::lwr;
use takt_net::{Finding, Limits, LoadContext, Plan, Rejection, check};

fn folders() -> Vec<PathBuf> {
    let nets = Path::new(env!("CARGO_MANIFEST_DIR")).join("nets");
    let entries = std::fs::read_dir(nets).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.filter(|path| path.is_dir()).collect()
}

/// The net of a folder: its file has the name of the folder.
fn text(folder: &Path) -> String {
    let name = folder.file_name().unwrap().to_str().unwrap();
    std::fs::read_to_string(folder.join(format!("{name}.net"))).unwrap()
}

/// Loads a net for a cell with the arms of the demo.
fn try_load(text: &str) -> Result<(Plan, Vec<Finding>), Rejection> {
    let mut devices = DeviceTable::default();
    for name in ["left", "right"] {
        devices.add_arm(lwr::describe(name)).unwrap();
    }
    let registry = Arc::new(takt_core::registry());
    check(
        text,
        &LoadContext {
            registry: &registry,
            devices: &devices,
            period: Duration::from_millis(1),
            limits: Limits::default(),
        },
    )
}

/// The faults and findings listed in a README: the lines of its `text` block that begin with a location.
fn listed(folder: &Path) -> Vec<String> {
    let readme = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let location = |line: &&str| line.starts_with(|c: char| c.is_ascii_digit());
    readme.lines().filter(location).map(str::to_owned).collect()
}

#[test]
fn example_nets_match_faults_and_findings_of_readme() {
    let folders = folders();
    assert!(folders.len() >= 3, "{folders:?}");
    for folder in folders {
        let text = text(&folder);
        let line = |finding: &Finding| {
            let (line, column) = finding.location(&text);
            format!("{line}:{column}: {}", finding.text)
        };
        let found = match try_load(&text) {
            Ok((_, findings)) => findings.iter().map(line).collect(),
            Err(rejection) => rejection.lines(&text),
        };
        assert_eq!(found, listed(&folder), "{}", folder.display());
    }
}

#[test]
fn demo_net_holds_all_joints() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("nets/demo");
    let (plan, _) = try_load(&text(&folder)).unwrap();
    assert_eq!(plan.devices(), ["left", "right"]);
    let joints = |arm: &str| {
        let of_arm = |r: &&String| r.starts_with(&format!("{arm}_Joint_"));
        plan.resources().iter().filter(of_arm).count()
    };
    assert_eq!((joints("left"), joints("right")), (7, 7));
}

#[test]
fn tutorial_nets_load_without_findings() {
    let tutorial = include_str!("../../docs/nets.md");
    let nets = tutorial.split("```net\n").skip(1);
    let nets: Vec<_> = nets.map(|rest| rest.split("```").next().unwrap()).collect();
    assert_eq!(nets.len(), 4, "one for each step that has a net");
    for net in nets {
        match try_load(net) {
            Ok((_, findings)) => assert!(findings.is_empty(), "{net}: {findings:?}"),
            Err(rejection) => panic!("{net}: {:?}", rejection.lines(net)),
        }
    }
}
