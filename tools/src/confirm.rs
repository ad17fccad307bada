//! What can set something in motion, or change a slave for good, is done only when somebody stands by it: asked on a
//! terminal, or told by a flag. What needs it is decided by who asks.

use std::io::{self, IsTerminal as _, Write as _};

use anyhow::{Context as _, ensure};

/// Asks, if needed, before something that can move.
///
/// # Errors
/// If the answer is no, or nobody can answer.
pub(crate) fn motion(what: &str, confirmed: bool) -> anyhow::Result<()> {
    asked(
        &format!("{what} can set a machine in motion"),
        "--confirm-motion",
        confirmed,
    )
}

/// Asks, if needed, before something that lasts beyond the next power-on.
///
/// # Errors
/// If the answer is no, or nobody can answer.
pub(crate) fn change(what: &str, confirmed: bool) -> anyhow::Result<()> {
    asked(what, "--yes", confirmed)
}

fn asked(what: &str, flag: &str, confirmed: bool) -> anyhow::Result<()> {
    if confirmed {
        return Ok(());
    }
    ensure!(
        io::stdin().is_terminal(),
        "{what}; if that is safe, say {flag}"
    );
    let mut out = io::stderr().lock();
    write!(out, "{what}. Is that safe? [y/N] ")?;
    out.flush()?;
    let mut answer = String::new();
    io::stdin()
        .read_line(&mut answer)
        .context("cannot read the answer")?;
    let yes = matches!(answer.trim(), "y" | "Y" | "yes");
    ensure!(yes, "nothing was done");
    Ok(())
}
