//! Whether processors are emulated or provided by KVM. Programs in the machine see no difference, but take ten times as
//! long.

use std::path::Path;

use crate::cargo::{self, note};
use crate::shell::Line;

/// Processors of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Processors {
    /// Emulated, on any host.
    Emulated,
    /// Provided by the host's KVM.
    Kvm,
}

/// Boot timeout, s; a kernel on a working KVM needs far less.
const BOOT_TIMEOUT_S: u64 = 25;

impl Processors {
    /// The faster kind that works here. Opening the device proves little: some hosts run a boot loader in KVM and never
    /// get through the kernel, so a kernel is booted to check. The result is kept in the target directory.
    pub(super) fn of_host(root: &Path, boot: impl FnOnce(Self) -> Line) -> anyhow::Result<Self> {
        if std::fs::File::options()
            .read(true)
            .write(true)
            .open("/dev/kvm")
            .is_err()
        {
            return Ok(Self::Emulated);
        }
        let answer = cargo::target_dir(root).join("vm/kvm");
        let works = match std::fs::read_to_string(&answer) {
            Ok(text) => text == "works",
            Err(_) => {
                note(&format!(
                    "does the host's KVM boot a kernel within {BOOT_TIMEOUT_S} s?"
                ));
                let works = boot(Self::Kvm).limited(BOOT_TIMEOUT_S).answers();
                std::fs::write(&answer, if works { "works" } else { "fails" })?;
                works
            }
        };
        if works {
            return Ok(Self::Kvm);
        }
        note("the host's KVM does not boot a kernel: processors are emulated");
        Ok(Self::Emulated)
    }
}
