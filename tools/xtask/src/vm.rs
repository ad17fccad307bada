//! Virtual machines with Debian's PREEMPT_RT kernel: one around the host's own files, to run a command or
//! the tests of a part in (`guest`), and one around a Debian of its own, in which the package is
//! installed (`service`). No machine outlives its task, and none writes outside the checkout and the
//! target directory.

mod guest;
mod needs;
mod service;
mod system;

use std::path::Path;

use crate::cargo::{Cargo, note, say};
use crate::metadata::Workspace;
use crate::parts::Part;
use crate::test::tally::Tally;
use guest::Guest;


/// A machine cannot be had here, and why. Not a fault of what was to run in it.
#[derive(Debug)]
pub(crate) struct Obstacle(pub(crate) String);

/// What needs a machine: the thing itself, an obstacle to it, or a failure.
pub(crate) type Had<T> = anyhow::Result<Result<T, Obstacle>>;

/// `cargo xtask vm`: runs the command within a machine; returns its exit status.
pub(crate) fn run(root: &Path, command: &[String], seconds: u64) -> anyhow::Result<u8> {
    match Guest::prepare(root)? {
        Ok(guest) => guest.run(command, seconds),
        Err(Obstacle(why)) => {
            say(&format!("skipped: {why}"));
            Ok(2)
        }
    }
}

/// How long all test binaries may take together within the machine, s.
const TESTS_WITHIN: u64 = 600;

/// The packages whose tests are run on the real-time kernel too.
const ON_THE_KERNEL: &[&str] = &["takt-rt"];

/// What of a part is tested in machines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Wanted {
    /// The real-time crate, on a real-time kernel.
    kernel: bool,
    /// Test binaries that need a virtual CAN interface.
    vcan: bool,
    /// The package, in a Debian of its own.
    service: bool,
}

impl Wanted {
    /// What the parts (none: all) want.
    pub(crate) fn by(parts: &[&Part]) -> Self {
        let any = |names: &[&str]| {
            parts.is_empty()
                || parts
                    .iter()
                    .any(|p| p.name == "all" || names.contains(&p.name))
        };
        Self {
            kernel: any(&["host"]),
            vcan: any(&["can"]),
            service: any(&["host", "deploy"]),
        }
    }

    fn nothing(self) -> bool {
        self == Self::default()
    }
}

/// Runs what the parts want in machines. `lines` are the cargo lines that built the tests; `skips` is the
/// file of skips, in which a test notes why it did not run.
pub(crate) fn test(
    root: &Path,
    wanted: Wanted,
    lines: &[Cargo],
    skips: &Path,
) -> anyhow::Result<Tally> {
    let mut tally = Tally::default();
    if wanted.nothing() {
        return Ok(tally);
    }
    if std::env::var_os("TAKT_VM").is_some_and(|value| value == "off") {
        tally.skips.push("virtual machine: TAKT_VM=off".to_owned());
        return Ok(tally);
    }
    let packages = Workspace::load(root)?.packages;
    let mut binaries = Vec::new();
    for line in lines {
        binaries.extend(guest::binaries(root, line)?);
    }
    binaries.retain(|binary| {
        let of_kernel = packages.iter().any(|package| {
            ON_THE_KERNEL.contains(&package.name.as_str())
                && binary.folder == root.join(&package.dir)
        });
        (wanted.kernel && of_kernel) || (wanted.vcan && binary.needs_vcan() && !guest::has_vcan())
    });
    if !binaries.is_empty() {
        tally.add(in_guest(root, &binaries, skips)?);
    }
    if wanted.service {
        tally.add(match service::test(root)? {
            Ok(tally) => tally,
            Err(Obstacle(why)) => skipped(&format!("service in a virtual machine: {why}")),
        });
    }
    Ok(tally)
}

fn in_guest(root: &Path, binaries: &[guest::Binary], skips: &Path) -> anyhow::Result<Tally> {
    note(&format!(
        "{} test binaries go into a virtual machine",
        binaries.len()
    ));
    Ok(match Guest::prepare(root)? {
        Ok(guest) => guest.test(binaries, skips, TESTS_WITHIN)?,
        Err(Obstacle(why)) => skipped(&format!("tests in a virtual machine: {why}")),
    })
}

fn skipped(why: &str) -> Tally {
    Tally {
        skips: vec![why.to_owned()],
        ..Tally::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parts::find;

    #[test]
    fn parts_want_what_belongs_to_them() {
        let by = |names: &[&str]| {
            let parts: Vec<&Part> = names.iter().filter_map(|name| find(name)).collect();
            Wanted::by(&parts)
        };
        let all = Wanted {
            kernel: true,
            vcan: true,
            service: true,
        };
        assert_eq!(
            (by(&[]), by(&["all"]), by(&["host", "can"])),
            (all, all, all)
        );
        assert!(by(&["can"]).vcan && !by(&["can"]).service);
        assert!(by(&["host"]).service && !by(&["host"]).vcan);
        assert!(by(&["net", "fri"]).nothing());
    }
}
