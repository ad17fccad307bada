//! Whether processors are emulated or lent by the host. What runs within does not see the difference, but
//! waits ten times as long.

use std::path::Path;

use crate::cargo::{self, note};
use crate::shell::Line;

/// How processors come to a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Processors {
    /// Emulated, on any host.
    Emulated,
    /// By the host's KVM.
    Kvm,
}

/// A kernel on a good KVM has booted long before, s.
const BOOT_WITHIN: u64 = 25;

impl Processors {
    /// The better kind that works here. That the device can be opened says little: there are hosts that
    /// run a boot loader in KVM and never get through the kernel, so that a kernel is booted to see. The
    /// answer is kept in the target directory.
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
                    "does the host's KVM boot a kernel within {BOOT_WITHIN} s?"
                ));
                let works = boot(Self::Kvm).limited(BOOT_WITHIN).answers();
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
