//! Virtual machines with Debian's PREEMPT_RT kernel: one around the host's own files, to run a command or
//! the tests of a part in (`guest`), and one around a Debian of its own, in which the package is
//! installed (`service`). No machine outlives its task, and none writes outside the checkout and the
//! target directory.

mod guest;
mod needs;
mod service;
mod system;

use std::path::Path;

use crate::cargo::say;
use crate::parts::Part;
use crate::test::tally::Tally;
pub(crate) use guest::Guest;
pub(crate) use needs::{is_root, peers};

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

/// Whether the parts (none: all) are to be tested on a real-time kernel.
pub(crate) fn wants_kernel(parts: &[&Part]) -> bool {
    wants(parts, &["all", "host"])
}

/// Whether the package is to be tested, in a Debian of its own.
pub(crate) fn wants_service(parts: &[&Part]) -> bool {
    wants(parts, &["all", "host", "deploy"])
}

fn wants(parts: &[&Part], names: &[&str]) -> bool {
    parts.is_empty() || parts.iter().any(|part| names.contains(&part.name))
}

/// Tests the package in a machine. `takt` is the program, if it is built already.
pub(crate) fn service(root: &Path, takt: Option<&Path>) -> anyhow::Result<Tally> {
    Ok(match service::test(root, takt)? {
        Ok(tally) => tally,
        Err(Obstacle(why)) => Tally::skipped(&format!("service in a virtual machine: {why}")),
    })
}

/// Where a machine is not to be: a person says so, or this is one.
fn refused() -> Result<(), Obstacle> {
    match std::env::var("TAKT_VM").as_deref() {
        Ok("off") => Err(Obstacle("needs TAKT_VM unset; it is off".to_owned())),
        Ok("inside") => Err(Obstacle(
            "needs a host; this is a virtual machine".to_owned(),
        )),
        Ok(_) | Err(_) => Ok(()),
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
            (wants_kernel(&parts), wants_service(&parts))
        };
        for all in [&[][..], &["all"], &["can", "host"]] {
            assert_eq!(by(all), (true, true), "{all:?}");
        }
        assert_eq!(by(&["deploy"]), (false, true));
        assert_eq!(by(&["net", "can"]), (false, false));
    }
}
