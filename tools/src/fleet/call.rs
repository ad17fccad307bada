//! `takt fleet call`: one resource of a cell, or one command to it, through the admission of the cell: executed once, or not at all.

use std::io::Read as _;
use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::{Args, ValueEnum};
use takt_client::Message;
use takt_client::wire::MESSAGE_BYTES_MAX;
use takt_fleet::command::LossPolicy;
use takt_fleet::keys::CellName;
use takt_fleet::session::remote::Remote;

use super::link::Link;
use crate::Verdict;
use crate::output::{complain, say, span_of_ms};

/// Commands that only read.
const READING: [&str; 14] = [
    "ver", "nin", "nva", "nst", "nta", "din", "fin", "main", "magr", "eva", "gse", "gde", "gne",
    "gsy",
];

/// What is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// The resource PATH as JSON, such as nets, devices/left, log, report
    Get,
    /// The DirectIO command PATH with the arguments BODY, such as nin '"rpinet0"'
    Run,
}

/// What happens to the nets of the session if this program does not reach the cell any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum OnLoss {
    /// They run on
    Continue,
    /// They are cancelled, and aborted if they do not end
    Cancel,
    /// They are aborted at once
    Stop,
}

impl OnLoss {
    pub(super) const fn policy(self) -> LossPolicy {
        match self {
            Self::Continue => LossPolicy::Continue,
            Self::Cancel => LossPolicy::Cancel,
            Self::Stop => LossPolicy::Stop,
        }
    }
}

/// Read a resource of a cell, or execute one DirectIO command there.
///
/// A command has a session of its own, which ends with it: nets that it opened a session for (nse) end, those without one stay. It is
/// executed once or not at all; what moves asks on a terminal, and needs --yes elsewhere. Reading needs the right `read`, commands the
/// right `command` in [[fleet.allow]] of the cell file. Exit status: 0 good; 1 the cell refused; 2 no answer.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fleet call weld3 get nets
  takt fleet call weld3 run nin
  takt fleet call weld3 run nest '\"rpinet0\"' --yes")]
pub(crate) struct Call {
    /// The cell.
    cell: CellName,
    /// What to do.
    #[arg(value_enum)]
    method: Method,
    /// The resource, or the command.
    path: String,
    /// The arguments of the command as DirectIO writes them; - for standard input.
    #[arg(allow_hyphen_values = true)]
    body: Option<String>,
    /// Execute what can move without a question.
    #[arg(long)]
    yes: bool,
    /// What happens to nets of this session if the link is lost meanwhile.
    #[arg(long, value_enum, default_value = "cancel")]
    on_loss: OnLoss,
    /// How long the command may take.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = span_of_ms(1..=3_600_000))]
    command_timeout: Duration,
    #[command(flatten)]
    link: Link,
}

impl Call {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        match self.method {
            Method::Get => self.get(),
            Method::Run => self.execute(),
        }
    }

    fn get(&self) -> anyhow::Result<Verdict> {
        if self.body.is_some() {
            bail!("a resource is read without a BODY\nhint: takt fleet call CELL get PATH");
        }
        let fleet = self.link.open()?;
        let path = self.path.trim_matches('/');
        match fleet.resource(&self.cell, path, self.link.timeout) {
            Ok(value) => {
                say(&value.to_string())?;
                Ok(Verdict::Good)
            }
            Err(refused @ takt_fleet::session::observer::FleetError::Refused { .. }) => {
                complain(&refused.to_string());
                Ok(Verdict::Failed)
            }
            Err(error) => Err(error.into()),
        }
    }

    fn execute(&self) -> anyhow::Result<Verdict> {
        let line = self.line()?;
        if !READING.contains(&self.path.as_str()) {
            let action = format!("`{}` on {}", self.path, self.cell);
            crate::confirm::motion(&action, self.yes)?;
        }
        let fleet = self.link.open()?;
        let remote = Remote::open(&fleet, &self.cell, "takt fleet call", self.on_loss.policy());
        let done = remote.and_then(|mut remote| remote.execute(&line, self.command_timeout));
        let (lines, omitted) = match done {
            Ok(done) => done,
            Err(refused @ takt_fleet::session::remote::RemoteError::Refused { .. }) => {
                complain(&refused.to_string());
                return Ok(Verdict::Failed);
            }
            Err(error) => return Err(error.into()),
        };
        for line in &lines {
            say(line)?;
        }
        if omitted > 0 {
            complain(&format!(
                "{omitted} lines were left out: the reply exceeds the bound of the cell"
            ));
        }
        let first = lines.first().map(|line| Message::decode(line));
        let is_good = matches!(first, Some(Ok(reply)) if reply.command == "ok");
        Ok(if is_good {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    /// The command as a line, checked before anything is sent.
    fn line(&self) -> anyhow::Result<String> {
        let body = match self.body.as_deref() {
            Some("-") => {
                let mut text = String::new();
                let bound = u64::try_from(MESSAGE_BYTES_MAX).unwrap_or(u64::MAX);
                std::io::stdin()
                    .take(bound)
                    .read_to_string(&mut text)
                    .context("cannot read standard input")?;
                text.trim_end().to_owned()
            }
            Some(body) => body.to_owned(),
            None => String::new(),
        };
        let line = format!("f={}({body})", self.path);
        let message = Message::decode(&line).map_err(|why| {
            anyhow::anyhow!(
                "{line}: {why}\nhint: BODY has texts in quotation marks and numbers, separated by commas, such as '\"rpinet0\",0.1'"
            )
        })?;
        Ok(message.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Arguments {
        #[command(flatten)]
        call: Call,
    }

    fn line(arguments: &[&str]) -> Result<String, String> {
        let arguments = [&["call", "weld3", "run"], arguments].concat();
        let parsed = Arguments::try_parse_from(arguments).map_err(|error| error.to_string())?;
        parsed.call.line().map_err(|error| error.to_string())
    }

    #[test]
    fn command_line_is_checked_before_it_is_sent() {
        assert_eq!(line(&["nin"]).unwrap(), "f=nin()");
        assert_eq!(
            line(&["nest", "\"rpinet0\""]).unwrap(),
            "f=nest(\"rpinet0\")"
        );
        for wrong in [
            &["nest", "rpinet0"][..],
            &["n est"],
            &["nest", "1)\nx=stop("],
        ] {
            let why = line(wrong).unwrap_err();
            assert!(why.contains("hint: BODY"), "{wrong:?}: {why}");
        }
    }

    #[test]
    fn cell_name_is_checked() {
        let error = Arguments::try_parse_from(["call", "a/b", "get", "nets"]).unwrap_err();
        assert!(error.to_string().contains("no name of a cell"), "{error}");
    }
}
