//! Network namespaces for tests of programs at real interfaces.

use std::process::Command;

use nix::sched::{CloneFlags, unshare};

/// Moves the calling thread, and all processes it starts, into a network namespace of its own and runs `ip` commands in it.
/// `None` if that is not permitted, which is reported.
pub(crate) fn network(test: &str, needs: &str, commands: &[&str]) -> Option<()> {
    let made = unshare(CloneFlags::CLONE_NEWNET).is_ok();
    if made && commands.iter().all(|command| ip(command)) {
        return Some(());
    }
    takt_tests::skip(test, needs);
    None
}

/// Runs `ip` with these arguments.
pub(crate) fn ip(arguments: &str) -> bool {
    let status = Command::new("ip").args(arguments.split(' ')).status();
    status.is_ok_and(|status| status.success())
}
