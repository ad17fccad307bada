//! Commands that can set a machine in motion, or change a slave permanently, run only after confirmation: a question on
//! a terminal, or `--yes`. The caller decides what needs confirmation.

use std::io::{self, IsTerminal as _, Write as _};

use anyhow::{Context as _, ensure};

/// Asks, unless confirmed, before something that can move.
///
/// # Errors
/// If the answer is no, or there is no terminal.
pub(crate) fn motion(action: &str, confirmed: bool) -> anyhow::Result<()> {
    ask(&format!("{action} can set a machine in motion"), confirmed)
}

/// Asks, unless confirmed, before a change that outlasts the next power-on.
///
/// # Errors
/// If the answer is no, or there is no terminal.
pub(crate) fn change(effect: &str, confirmed: bool) -> anyhow::Result<()> {
    ask(effect, confirmed)
}

fn ask(effect: &str, confirmed: bool) -> anyhow::Result<()> {
    if confirmed {
        return Ok(());
    }
    ensure!(
        io::stdin().is_terminal(),
        "{effect}\nhint: if that is safe, run the command with --yes"
    );
    let mut out = io::stderr().lock();
    write!(out, "{effect}. Is that safe? [y/N] ")?;
    out.flush()?;
    let mut answer = String::new();
    io::stdin()
        .read_line(&mut answer)
        .context("cannot read the answer")?;
    let yes = matches!(answer.trim(), "y" | "Y" | "yes");
    ensure!(yes, "nothing was done");
    Ok(())
}
