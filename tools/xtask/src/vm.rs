//! Virtual machines with Debian's PREEMPT_RT kernel: one with the host's own files, which runs a command or the tests of
//! a part (`guest`), and one with a Debian of its own, in which the package is installed (`service`). No machine
//! outlives its task, and none writes outside the checkout and the target directory.

mod availability;
mod guest;
mod needs;
mod service;
mod system;

use std::path::Path;

use crate::cargo::say;
use crate::parts::Part;
use crate::test::tally::Tally;
use availability::refused;
pub(crate) use availability::{Availability, Unavailable};
pub(crate) use guest::Guest;
pub(crate) use needs::{browser, is_root, packages, peers};

/// `cargo xtask vm`: runs the command in a machine; returns its exit status.
pub(crate) fn run(root: &Path, command: &[String], seconds: u64) -> anyhow::Result<u8> {
    match Guest::prepare(root)? {
        Ok(guest) => guest.run(command, seconds),
        Err(Unavailable(why)) => {
            say(&format!("skipped: {why}"));
            Ok(2)
        }
    }
}

/// Whether the parts (none: all) include tests on a real-time kernel.
pub(crate) fn wants_kernel(parts: &[&Part]) -> bool {
    wants(parts, &["all", "host"])
}

/// Whether the parts include the test of the package in a Debian of its own.
pub(crate) fn wants_service(parts: &[&Part]) -> bool {
    wants(parts, &["all", "host", "deploy"])
}

fn wants(parts: &[&Part], names: &[&str]) -> bool {
    parts.is_empty() || parts.iter().any(|part| names.contains(&part.name))
}

/// Tests the package in a machine. `takt` is the program, if already built.
pub(crate) fn service(root: &Path, takt: Option<&Path>) -> anyhow::Result<Tally> {
    Ok(match service::test(root, takt)? {
        Ok(tally) => tally,
        Err(Unavailable(why)) => Tally::skipped(&format!("service in a virtual machine: {why}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parts::find;

    #[test]
    fn vm_tests_follow_parts() {
        let by = |names: &[&str]| {
            let parts: Vec<&Part> = names.iter().filter_map(|name| find(name)).collect();
            (wants_kernel(&parts), wants_service(&parts))
        };
        for all in [&[][..], &["all"], &["can", "host"]] {
            assert_eq!(by(all), (true, true), "{all:?}");
        }
        assert_eq!(by(&["deploy"]), (false, true));
        assert_eq!(by(&["net", "can"]), (false, false));
    }
}
