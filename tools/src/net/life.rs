//! `takt net load`, `start`, `cancel`, `abort`, `unload` and `schedule`: the life of a net. Each sends one request and
//! prints the answer; `watch` follows the net afterwards.

use std::path::PathBuf;

use clap::Args;
use takt_net::{Limits, Rejection};

use super::{Server, complain_of, read};
use crate::Verdict;
use crate::output::{complain, say};

/// Load a net.
#[derive(Debug, Args)]
pub(crate) struct Load {
    /// The net; `-` for standard input.
    file: PathBuf,
    /// Start it too.
    #[arg(long)]
    start: bool,
    #[command(flatten)]
    server: Server,
}

impl Load {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let text = read(&self.file)?;
        let name = self.file.display().to_string();
        // Syntax errors are reported here, with their locations.
        let mut faults = Vec::new();
        takt_net::text::parse(&text, &Limits::default(), &mut faults);
        if !faults.is_empty() {
            complain_of(&Rejection { faults }, &name, &text);
            return Ok(Verdict::Failed);
        }
        let mut client = self.server.connect()?;
        let net = client.load(&text, &name)?;
        let faults = client.faults(&net)?;
        if !faults.is_empty() {
            for fault in &faults {
                complain(&format!("{name}:{fault}"));
            }
            client.command("neun", &net)?;
            return Ok(Verdict::Failed);
        }
        say(&net)?;
        if self.start {
            client.command("nest", &net)?;
        }
        Ok(Verdict::Good)
    }
}

/// A loaded net.
#[derive(Debug, Args)]
pub(crate) struct Target {
    /// Its identifier, such as rpinet0.
    net: String,
    #[command(flatten)]
    server: Server,
}

impl Target {
    pub(super) fn command(&self, command: &str) -> anyhow::Result<Verdict> {
        self.server.connect()?.command(command, &self.net)?;
        Ok(Verdict::Good)
    }
}

/// Start a net in the cycle after another one.
///
/// Once the condition holds, NET is ended and NEXT starts, with no cycle between them. If NEXT cannot
/// start then, for instance because another net holds its joints, it stays READY.
#[derive(Debug, Args)]
pub(crate) struct Schedule {
    /// The net to start; loaded and not yet started.
    next: String,
    /// The net that it comes after.
    #[arg(long, value_name = "NET")]
    after: String,
    /// Boolean values of nets, joined by `&`, `|`, `!`, such as `rpinet0.outdone`; without it, when
    /// NET has ended by itself.
    #[arg(long, value_name = "CONDITION")]
    when: Option<String>,
    #[command(flatten)]
    server: Server,
}

impl Schedule {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut client = self.server.connect()?;
        let ended = format!("{}.terminated", self.after);
        // A net that ends by itself need not be ended.
        let (condition, stop) = match &self.when {
            Some(condition) => (condition, Some(self.after.as_str())),
            None => (&ended, None),
        };
        let rule = client.schedule(condition, stop, &self.next)?;
        say(&format!("rule {rule}"))?;
        Ok(Verdict::Good)
    }
}
