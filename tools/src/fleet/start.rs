//! `takt fleet start`: nets on several cells that begin in the same cycle, or not at all.

use std::time::{Duration, Instant};

use anyhow::{Context as _, anyhow, bail};
use clap::Args;
use serde_json::{Value, json};
use takt_client::Message;
use takt_core::files::{TEXT_BYTES_MAX, read_text};
use takt_core::ids::NetId;
use takt_fleet::keys::CellName;
use takt_fleet::session::observer::Fleet;
use takt_fleet::session::remote::Remote;
use takt_fleet::session::together::{self, Together, TogetherError};
use takt_fleet::start::{Stage, Status};

use super::call::OnLoss;
use super::link::Link;
use crate::Verdict;
use crate::output::{complain, positive_span, say, span_of_ms, time};
use crate::signal::Stop;

/// How often the cells are asked how their nets are.
const PERIOD: Duration = Duration::from_millis(100);
/// How long beyond the instant of the start cells may take to say how it went.
const GRACE: Duration = Duration::from_secs(5);

/// Start nets on several cells at one instant: all begin in the cycle nearest to it, or none does.
///
/// Each NET is a file with a net, which is loaded in a session that ends with this command, or a net that is ready, such as rpinet0. The
/// cells keep what their nets need, then all get the instant; one that refuses, or does not answer, ends it for all. Cells on several
/// hosts need clocks that are synchronised to a quarter of a period (PTP); cells on one host share its clock. Each cell needs the rights `command` and `start` for this link and
/// for the links of its partners ([[fleet.allow]]). It runs until all nets have ended; Ctrl-C cancels them. Exit status: 0 all began and ended by
/// themselves; 1 the start was refused, or a net failed; 2 a cell did not answer.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fleet start weld3=left.net glue1=right.net
  takt fleet start weld3=rpinet0 glue1=rpinet4 --lead 2s --on-loss stop --yes")]
pub(crate) struct Start {
    /// A cell and the net that begins there; of one cell, several are possible.
    #[arg(value_name = "CELL=NET", required = true, num_args = 2.., value_parser = part)]
    parts: Vec<Part>,
    /// How far ahead the start is once all are prepared, 300ms to 9s.
    #[arg(long, value_name = "TIME", default_value = "300ms", value_parser = span_of_ms(300..=9_000))]
    lead: Duration,
    /// Cancel the nets after this time.
    #[arg(long, value_name = "TIME", value_parser = positive_span)]
    duration: Option<Duration>,
    /// What happens to the nets of a cell that loses a partner, or this program.
    #[arg(long, value_enum, default_value = "cancel")]
    on_loss: OnLoss,
    /// Start what can move without a question.
    #[arg(long)]
    yes: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    link: Link,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Part {
    cell: CellName,
    net: String,
}

fn part(text: &str) -> Result<Part, String> {
    let (cell, net) = text
        .split_once('=')
        .ok_or("is not CELL=NET, such as weld3=left.net")?;
    let cell = CellName::new(cell).map_err(|why| why.to_string())?;
    if net.is_empty() {
        return Err("names no net".to_owned());
    }
    let net = net.to_owned();
    Ok(Part { cell, net })
}

/// A session at a cell, and the nets that begin there.
struct Cell {
    remote: Remote,
    nets: Vec<String>,
}

impl Start {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut names: Vec<CellName> = self.parts.iter().map(|part| part.cell.clone()).collect();
        names.sort();
        names.dedup();
        if names.len() < 2 {
            bail!(
                "a start together needs two cells at least\nhint: `takt net start` starts nets of one cell"
            );
        }
        let texts = self.texts()?;
        let listed: Vec<_> = names.iter().map(CellName::as_str).collect();
        crate::confirm::motion(&format!("start on {}", listed.join(" and ")), self.yes)?;
        let stop = Stop::listen()?;
        let fleet = self.link.open()?;
        let mut cells = Vec::new();
        for name in &names {
            let on_loss = self.on_loss.policy();
            let remote = Remote::open(&fleet, name, "takt fleet start", on_loss)?;
            let nets = Vec::new();
            cells.push(Cell { remote, nets });
        }
        for (part, text) in self.parts.iter().zip(texts) {
            let cell = cells
                .iter_mut()
                .find(|cell| *cell.remote.cell() == part.cell);
            let cell = cell.context("each part has a session")?;
            let net = match text {
                Some(text) => load(&mut cell.remote, &part.net, &text)?,
                None => part.net.clone(),
            };
            cell.nets.push(net);
        }
        let parts: Vec<_> = cells
            .iter()
            .map(|it| (&it.remote, it.nets.clone()))
            .collect();
        let together = match together::start(&fleet, &parts, self.lead) {
            Ok(together) => together,
            Err(silent @ TogetherError::Silent { .. }) => return Err(silent.into()),
            Err(
                refused @ (TogetherError::Refused { .. }
                | TogetherError::Mismatch(_)
                | TogetherError::Restarted { .. }),
            ) => {
                complain(&refused.to_string());
                return Ok(Verdict::Failed);
            }
            Err(error) => return Err(error.into()),
        };
        self.follow(&fleet, &together, &mut cells, &stop)
    }

    /// The texts of the nets that are files.
    fn texts(&self) -> anyhow::Result<Vec<Option<String>>> {
        let text = |part: &Part| {
            if part.net.parse::<NetId>().is_ok() {
                return Ok(None);
            }
            let text = read_text(part.net.as_ref(), TEXT_BYTES_MAX)?;
            Ok(Some(text))
        };
        self.parts.iter().map(text).collect()
    }

    /// Reports how they began, and waits until all have ended.
    fn follow(
        &self,
        fleet: &Fleet,
        together: &Together,
        cells: &mut [Cell],
        stop: &Stop,
    ) -> anyhow::Result<Verdict> {
        let begun = together.begun(fleet, self.lead + GRACE)?;
        let spread = spread(&begun);
        if !self.json {
            for line in lines(&begun, together.start_tai_ns) {
                say(&line)?;
            }
            if let Some(spread) = spread {
                say(&format!(
                    "begun on {} cells, spread {}",
                    begun.len(),
                    time(spread)
                ))?;
            }
        }
        let until = self.duration.map(|duration| Instant::now() + duration);
        let mut is_cancelled = false;
        let mut answered = Instant::now();
        let mut silent: Vec<CellName> = Vec::new();
        let ended = loop {
            let asked = Instant::now();
            let all = together.statuses(fleet)?;
            let stages = || all.iter().map(|(_, it)| it.as_ref().map(|it| it.stage));
            if stages().all(|stage| matches!(stage, Some(Stage::Over | Stage::Failed))) {
                break all;
            }
            if stages().all(|stage| stage.is_some()) {
                answered = asked;
            }
            let is_silent = |(cell, status): &(CellName, Option<Status>)| {
                status.is_none().then(|| cell.clone())
            };
            let are_silent: Vec<_> = all.iter().filter_map(is_silent).collect();
            for cell in are_silent.iter().filter(|cell| !silent.contains(cell)) {
                complain(&format!(
                    "{cell}: no answer; waiting up to {:?}",
                    self.link.timeout
                ));
            }
            silent = are_silent;
            // A session that its cell misses meanwhile ends there, and the next answer says so.
            if answered.elapsed() >= self.link.timeout {
                break all;
            }
            let is_due = until.is_some_and(|until| Instant::now() >= until);
            if (is_due || stop.is_requested()) && !is_cancelled {
                is_cancelled = true;
                cancel(cells, self.link.timeout);
            }
            std::thread::sleep(PERIOD);
        };
        if self.json {
            say(&json_of(together, &ended, spread).to_string())?;
        }
        let mut verdict = Verdict::Good;
        for (cell, status) in &ended {
            let why = status.as_ref().and_then(|it| it.why.as_deref());
            if let Some(why) = why {
                complain(&format!("{cell}: {why}"));
                verdict = Verdict::Failed;
            }
        }
        if let Some((cell, _)) = ended.iter().find(|(_, status)| status.is_none()) {
            bail!("{cell}: it does not answer any more, or has restarted\nhint: takt fleet list");
        }
        Ok(verdict)
    }
}

/// Loads a net in a session of the controller that ends with the session of the fleet.
fn load(remote: &mut Remote, file: &str, text: &str) -> anyhow::Result<String> {
    let session = call(remote, Message::new("f", "nse").with("takt fleet start"))?;
    let nene = Message::new("f", "nene");
    let nene = nene.with(text).with(session.as_str()).with(file);
    call(remote, nene).with_context(|| file.to_owned())
}

/// Executes a command whose reply is one text.
fn call(remote: &mut Remote, message: Message) -> anyhow::Result<String> {
    let cell = remote.cell().clone();
    let (lines, _) = remote.execute(&message.to_string(), Duration::from_secs(30))?;
    let line = lines.first().map_or("", String::as_str);
    let reply = Message::decode(line).map_err(|why| anyhow!("{cell}: {line}: {why}"))?;
    let text = reply.args.first().and_then(|value| value.as_str());
    match (reply.command.as_str(), text) {
        ("ok", Some(text)) => Ok(text.to_owned()),
        (_, text) => bail!("{cell}: {}", text.unwrap_or(line)),
    }
}

fn cancel(cells: &mut [Cell], timeout: Duration) {
    for Cell { remote, nets } in cells {
        for net in nets {
            let line = Message::new("f", "neca").with(net.as_str()).to_string();
            if let Err(why) = remote.execute(&line, timeout) {
                complain(&format!("cannot cancel {net}: {why}"));
            }
        }
    }
}

/// From the first to the last begin, ns; `None` unless all have begun.
fn spread(all: &[(CellName, Option<Status>)]) -> Option<i64> {
    let begins = all
        .iter()
        .map(|(_, status)| Some(status.as_ref()?.began?.begin_tai_ns));
    let begins: Vec<i64> = begins.collect::<Option<_>>()?;
    Some(begins.iter().max()? - begins.iter().min()?)
}

fn lines(all: &[(CellName, Option<Status>)], start_tai_ns: i64) -> Vec<String> {
    let line = |(cell, status): &(CellName, Option<Status>)| {
        let began = status.as_ref().and_then(|it| it.began);
        match (began, status) {
            (Some(began), Some(status)) => format!(
                "{cell}  {}  cycle {}, {} from the instant, woken {} later",
                status.nets.join(", "),
                began.cycle,
                time(began.begin_tai_ns - start_tai_ns),
                time(began.woken_tai_ns - began.begin_tai_ns)
            ),
            (_, Some(status)) => {
                let why = status.why.as_deref().unwrap_or("not begun yet");
                format!("{cell}  {}  {why}", status.nets.join(", "))
            }
            (_, None) => format!("{cell}  does not answer"),
        }
    };
    all.iter().map(line).collect()
}

fn json_of(together: &Together, all: &[(CellName, Option<Status>)], spread: Option<i64>) -> Value {
    let cells = all
        .iter()
        .map(|(cell, status)| json!({"cell": cell.as_str(), "status": status}));
    json!({
        "schema": "takt-fleet-start/1",
        "txn": together.txn,
        "start_tai_ns": together.start_tai_ns,
        "spread_ns": spread,
        "cells": cells.collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_fleet::command::Txn;
    use takt_fleet::start::Began;

    fn status(begin: Option<i64>) -> Option<Status> {
        Some(Status {
            txn: Txn(1),
            stage: Stage::Running,
            why: None,
            nets: vec!["rpinet0".to_owned()],
            start_tai_ns: Some(1_000_000),
            began: begin.map(|begin_tai_ns| Began {
                cycle: 7,
                begin_tai_ns,
                woken_tai_ns: begin_tai_ns + 30_000,
                period_ns: 1_000_000,
            }),
            lost: Vec::new(),
        })
    }

    #[test]
    fn start_report_shows_cycles_and_spread() {
        let cell = |name| CellName::new(name).unwrap();
        let mut all = vec![
            (cell("a"), status(Some(1_000_200))),
            (cell("b"), status(Some(999_900))),
        ];
        assert_eq!(spread(&all), Some(300));
        let lines = lines(&all, 1_000_000);
        assert_eq!(
            lines[0],
            "a  rpinet0  cycle 7, 200 ns from the instant, woken 30.0 us later"
        );
        all[1].1 = status(None);
        assert_eq!(spread(&all), None);
    }

    #[test]
    fn part_is_cell_and_net() {
        assert_eq!(part("a=x=y.net").unwrap().net, "x=y.net");
        for wrong in ["a", "a=", "a/b=x"] {
            assert!(part(wrong).is_err(), "{wrong}");
        }
    }
}
