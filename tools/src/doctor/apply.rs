//! Writing settings of the running system, and taking them back.
//!
//! It writes only what it listed before, only to files that exist, and only after the old values are in the undo file.
//! Remedies that need a boot or a package are left to the user.

use std::fs;
use std::io::{self, IsTerminal as _};
use std::path::Path;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};

use super::examine::Row;
use super::host::Host;
use super::text::chosen;
use crate::output::{complain, say};

/// Where the values before the first change are kept, below the root.
const UNDO: &str = "/var/lib/takt/doctor-undo.json";

/// One setting before and after.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Written {
    path: String,
    old: String,
    new: String,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct UndoFile {
    /// In the order they were written.
    changes: Vec<Written>,
}

/// The current value; of alternatives the chosen one.
fn present(host: &Host, path: &str) -> Option<String> {
    host.text(path).map(|text| chosen(&text).to_owned())
}

fn plan(host: &Host, rows: &[Row]) -> Vec<Written> {
    let mut plan: Vec<Written> = Vec::new();
    for change in rows.iter().flat_map(|row| &row.finding.changes) {
        let known = plan.iter().any(|written| written.path == change.path);
        let Some(old) = present(host, &change.path).filter(|old| !known && *old != change.new)
        else {
            continue;
        };
        plan.push(Written {
            path: change.path.clone(),
            old,
            new: change.new.clone(),
        });
    }
    plan
}

/// Lists what would be written, asks unless `yes`, and writes. False if something was refused.
pub(super) fn apply(host: &Host, rows: &[Row], yes: bool) -> anyhow::Result<bool> {
    let mut plan = plan(host, rows);
    if plan.is_empty() {
        say("nothing to write")?;
        return Ok(true);
    }
    say("to be written:")?;
    for Written { path, old, new } in &plan {
        say(&format!("  {path}: {old} -> {new}"))?;
    }
    if !yes && !confirmed()? {
        say("nothing was written")?;
        return Ok(false);
    }
    let file = host.own_file(UNDO);
    remember(&file, &plan)?;
    let mut good = true;
    for Written { path, new, .. } in &mut plan {
        match host.write(path, new) {
            // The kernel may show it in a form of its own, and that is what undoing compares.
            Ok(()) => *new = present(host, path).unwrap_or_default(),
            Err(error) => {
                complain(&format!("takt: {path} does not take {new}: {error}"));
                good = false;
            }
        }
    }
    remember(&file, &plan)?;
    say(&format!(
        "written until the next boot; `takt doctor --undo` takes it back ({})",
        file.display()
    ))?;
    Ok(good)
}

fn confirmed() -> anyhow::Result<bool> {
    if !io::stdin().is_terminal() {
        anyhow::bail!("nothing was written: standard input is no terminal\nhint: add --yes");
    }
    crate::output::print(b"write these? [y/N] ")?;
    let mut answer = String::new();
    io::stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim(), "y" | "Y" | "yes"))
}

/// Adds to the kept changes, or corrects them: of a setting written twice the first old value is restored, unless
/// another program changed it in between.
fn remember(file: &Path, plan: &[Written]) -> anyhow::Result<()> {
    let mut undo = load(file)?;
    for written in plan {
        match undo.changes.iter_mut().find(|w| w.path == written.path) {
            Some(earlier) if earlier.new == written.old || earlier.old == written.old => {
                earlier.new.clone_from(&written.new);
            }
            Some(earlier) => *earlier = written.clone(),
            None => undo.changes.push(written.clone()),
        }
    }
    store(file, &undo)
}

fn load(file: &Path) -> anyhow::Result<UndoFile> {
    match fs::read_to_string(file) {
        Ok(text) => serde_json::from_str(&text)
            .with_context(|| format!("{} is damaged\nhint: remove it", file.display())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(UndoFile::default()),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", file.display())),
    }
}

/// Writes a second file and renames it, so that no crash leaves half of it.
fn store(file: &Path, undo: &UndoFile) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(undo)? + "\n";
    let next = file.with_extension("json.new");
    let write = || {
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(&next, text)?;
        fs::rename(&next, file)
    };
    write().with_context(|| format!("cannot keep what would be changed in {}", file.display()))
}

/// Writes the old values back, the latest first. A setting that another program has changed since is left alone.
/// False if something was refused; that stays in the undo file.
pub(super) fn undo(host: &Host) -> anyhow::Result<bool> {
    let file = host.own_file(UNDO);
    let kept = load(&file)?;
    if kept.changes.is_empty() {
        say("nothing to undo")?;
        return Ok(true);
    }
    let mut refused = Vec::new();
    for written in kept.changes.into_iter().rev() {
        let Written { path, old, new } = &written;
        let now = present(host, path);
        if now.as_deref() != Some(new) {
            let now = now.unwrap_or_else(|| "missing".to_owned());
            say(&format!("  {path}: is {now} by now, left alone"))?;
        } else if let Err(error) = host.write(path, old) {
            complain(&format!("takt: {path} does not take {old}: {error}"));
            refused.push(written);
        } else {
            say(&format!("  {path}: {new} -> {old}"))?;
        }
    }
    let good = refused.is_empty();
    refused.reverse();
    match good {
        true => fs::remove_file(&file)?,
        false => store(&file, &UndoFile { changes: refused })?,
    }
    Ok(good)
}
