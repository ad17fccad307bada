//! A network namespace for tests, on the host's kernel: veth pairs, and virtual CAN if the kernel has it. It needs root
//! or unprivileged user namespaces, and ends with its last process.

use std::path::Path;

use anyhow::Context;

use super::{Bus, NETWORKS};
use crate::cargo;
use crate::shell::{self, Line, quoted};
use crate::vm;

/// Timeout of all tests in the namespace together, s.
const TIMEOUT_S: u64 = 600;

/// Whether a namespace can have that bus.
pub(super) fn has(bus: Bus) -> bool {
    let variable = match bus {
        Bus::Vcan => "TAKT_VCAN",
        Bus::Veth => "TAKT_VETH",
        // A controller is hardware, even if emulated.
        Bus::Can => return false,
    };
    if !(shell::exists("ip") && shell::exists("unshare")) {
        return false;
    }
    let script = format!("{NETWORKS}\n[ -n \"${variable}\" ]\n");
    line().args(["-c", &script]).answers()
}

/// Runs a script in a namespace; returns its exit status.
pub(super) fn run(root: &Path, script: &str, show: impl FnMut(&str)) -> anyhow::Result<u8> {
    let path = cargo::target_dir(root).join(format!("xtask-namespace-{}.sh", std::process::id()));
    let text = format!(
        "cd {}\n{NETWORKS}\n{script}",
        quoted(&root.to_string_lossy())
    );
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
    let status = line()
        .arg(&path)
        .within(root)
        .limited(TIMEOUT_S)
        .lines(show);
    std::fs::remove_file(&path)?;
    status
}

/// A shell in a namespace.
fn line() -> Line {
    let line = Line::new("unshare").arg("--net");
    let line = if vm::is_root() {
        line
    } else {
        line.arg("--map-root-user")
    };
    line.arg("sh")
}
