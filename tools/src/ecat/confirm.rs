//! What can set something in motion is done only when somebody stands by it: asked on a terminal, or told by
//! `--confirm-motion`. What can move is decided by who asks.

use std::io::{self, IsTerminal as _, Write as _};

use anyhow::{Context as _, ensure};

/// Asks if needed.
///
/// # Errors
/// If the answer is no, or nobody can answer.
pub(super) fn motion(what: &str, confirmed: bool) -> anyhow::Result<()> {
    if confirmed {
        return Ok(());
    }
    ensure!(
        io::stdin().is_terminal(),
        "{what} can set a machine in motion; if that is safe, say --confirm-motion"
    );
    let mut out = io::stderr().lock();
    write!(
        out,
        "{what} can set a machine in motion. Is that safe? [y/N] "
    )?;
    out.flush()?;
    let mut answer = String::new();
    io::stdin()
        .read_line(&mut answer)
        .context("cannot read the answer")?;
    let yes = matches!(answer.trim(), "y" | "Y" | "yes");
    ensure!(yes, "nothing was sent");
    Ok(())
}
