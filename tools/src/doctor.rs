//! `takt doctor`: whether a host is fit for real time, condition by condition, each with a remedy.
//!
//! It checks settings and rights and measures nothing; `takt jitter` measures the latency of cycles.

mod apply;
mod can;
mod clock;
mod condition;
mod cpus;
mod examine;
mod host;
mod irq;
mod isolation;
mod kernel;
mod memory;
mod nic;
mod power;
mod probe;
mod report;
mod rights;
mod service;
mod text;

#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;

use self::condition::Status;
use self::examine::{Row, examine};
use self::host::{Host, Subject};
use crate::Verdict;
use crate::output::say;

/// Is this host fit for real time? One line per condition, and the command that fixes it.
///
/// ok: as it should be. WARN: cycles run, but later or less surely than they could. FAIL: cycles do not run as they
/// must. skip: does not exist here, or cannot be read.
#[derive(Debug, Args)]
pub(crate) struct Doctor {
    /// Examine a tree written by --save instead of this machine
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    /// Print only what is not ok
    #[arg(long)]
    quiet: bool,
    /// List the settings that would fix conditions, ask, write them, and examine again
    #[arg(long, conflicts_with_all = ["json", "save", "undo"])]
    apply: bool,
    /// Write without asking
    #[arg(long, requires = "apply")]
    yes: bool,
    /// Take back what --apply wrote
    #[arg(long, conflicts_with_all = ["json", "save"])]
    undo: bool,
    /// Network or CAN interface to examine; may be repeated. Without it all CAN interfaces, and all network adapters with a cable in them
    #[arg(long = "interface", value_name = "IFACE", value_parser = file_name)]
    interfaces: Vec<String>,
    /// The service's unit [default: takt.service, if there is one]
    #[arg(long, value_name = "UNIT", value_parser = file_name)]
    service: Option<String>,
    /// Write all that is read into this new folder, for --root elsewhere
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
}

/// A name that becomes a part of paths.
fn file_name(text: &str) -> Result<String, String> {
    match text {
        "" | "." | ".." => Err("is no name".to_owned()),
        _ if text.contains(['/', '\0']) => Err("is a name, not a path".to_owned()),
        _ => Ok(text.to_owned()),
    }
}

impl Doctor {
    pub(crate) fn run(self) -> anyhow::Result<Verdict> {
        let mut host = self.host()?;
        if self.undo {
            return Ok(verdict(apply::undo(&host)?));
        }
        let rows = examine(&host);
        if let Some(folder) = &self.save {
            return save(&mut host, folder);
        }
        if self.apply {
            let written = apply::apply(&host, &rows, self.yes)?;
            // From a new host: the first caches what it read.
            let rows = examine(&self.host()?);
            say(report::text(&rows, self.quiet).trim_end())?;
            return Ok(verdict(written && is_fit(&rows)));
        }
        if self.json {
            say(&report::json(&rows)?)?;
        } else {
            say(report::text(&rows, self.quiet).trim_end())?;
        }
        Ok(verdict(is_fit(&rows)))
    }

    fn host(&self) -> anyhow::Result<Host> {
        let subject = Subject {
            interfaces: self.interfaces.clone(),
            service: self.service.clone(),
        };
        let Some(root) = &self.root else {
            return Ok(Host::live(subject));
        };
        let host = Host::tree(root, subject)
            .with_context(|| format!("cannot read the tree {}", root.display()))?;
        if host.text("/proc/version").is_none() {
            anyhow::bail!(
                "{} holds no saved host (no proc/version)\nhint: write one by `takt doctor --save DIR`",
                root.display()
            );
        }
        Ok(host)
    }
}

/// The report on this host as one JSON object, as `takt doctor --json` prints it.
pub(crate) fn findings() -> anyhow::Result<String> {
    let subject = Subject {
        interfaces: Vec::new(),
        service: None,
    };
    Ok(report::json(&examine(&Host::live(subject)))?)
}

fn is_fit(rows: &[Row]) -> bool {
    !rows.iter().any(|row| row.finding.status == Status::Fail)
}

fn verdict(good: bool) -> Verdict {
    if good { Verdict::Good } else { Verdict::Failed }
}

/// Saves to a new folder, so that it holds only what was read. All interfaces are saved, so that any of them can be
/// examined in the tree.
fn save(host: &mut Host, folder: &Path) -> anyhow::Result<Verdict> {
    let cannot = || format!("cannot save to {}", folder.display());
    fs::create_dir(folder).with_context(cannot)?;
    host.subject.interfaces = host.names("/sys/class/net");
    examine(host);
    let count = host.save(folder).with_context(cannot)?;
    say(&format!("{}: {count} files and folders", folder.display()))?;
    Ok(Verdict::Good)
}
