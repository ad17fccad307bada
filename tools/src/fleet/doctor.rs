//! `takt fleet doctor`: whether a fleet is fit: links, names, runs, clocks, versions. Each condition has a remedy.

use std::collections::BTreeMap;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use serde_json::json;
use takt_fleet::session::observer;

use super::link::Link;
use super::reading::{Cell, read};
use crate::Verdict;
use crate::output::{say, time, wrapped};

/// Uncertainty of TAI from which a start in the same cycle is not to be expected, ns: a quarter of the usual period.
const UNCERTAIN_NS: i64 = 250_000;

/// An answer later than this is a finding, ns.
const SLOW_NS: u64 = 500_000_000;

/// Is the fleet fit? Whether each endpoint is reachable, cells answer, names are unique, clocks are disciplined (PTP, TAI) and versions agree.
///
/// Exit status: 0 no FAIL; 1 something fails; 2 wrong usage.
#[derive(Debug, Args)]
pub(crate) struct Doctor {
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    link: Link,
}

/// How a condition is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "UPPERCASE")]
enum Grade {
    #[serde(rename = "ok")]
    Good,
    Warn,
    Fail,
}

/// A condition.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Row {
    grade: Grade,
    /// Endpoint or cell.
    subject: String,
    cause: String,
    hint: Option<String>,
}

impl Row {
    fn new(grade: Grade, subject: &str, text: impl Into<String>) -> Self {
        let text = text.into();
        let (cause, hint) = match text.split_once("\nhint: ") {
            Some((cause, hint)) => (cause.to_owned(), Some(hint.to_owned())),
            None => (text, None),
        };
        Self {
            grade,
            subject: subject.to_owned(),
            cause,
            hint,
        }
    }
}

impl Doctor {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut rows = Vec::new();
        let mut cells: BTreeMap<String, Cell> = BTreeMap::new();
        for endpoint in &self.link.connect {
            let (row, found) = self.link(endpoint)?;
            rows.push(row);
            // Of a cell that is seen at several endpoints, the first answer.
            for cell in found {
                cells.entry(cell.cell.clone()).or_insert(cell);
            }
        }
        let cells: Vec<_> = cells.into_values().collect();
        rows.extend(judge(&cells));
        if self.json {
            let schema = "takt-fleet-doctor/1";
            say(&json!({"schema": schema, "rows": rows, "cells": cells}).to_string())?;
        } else {
            for row in &rows {
                say(&text(row))?;
            }
        }
        let fails = rows.iter().any(|row| row.grade == Grade::Fail);
        Ok(if fails {
            Verdict::Failed
        } else {
            Verdict::Good
        })
    }

    /// The condition of an endpoint, and the cells that are seen there.
    fn link(&self, endpoint: &str) -> anyhow::Result<(Row, Vec<Cell>)> {
        let begin = Instant::now();
        let observer = self.link.observer(vec![endpoint.to_owned()]);
        let fleet = match observer::Fleet::connect(&observer) {
            Ok(fleet) => fleet,
            Err(error @ observer::FleetError::Unreachable { .. }) => {
                return Ok((
                    Row::new(Grade::Fail, endpoint, error.to_string()),
                    Vec::new(),
                ));
            }
            Err(error) => return Err(error.into()),
        };
        let linked = i64::try_from(begin.elapsed().as_nanos()).unwrap_or(i64::MAX);
        let cells = read(&fleet, self.link.timeout)?;
        let text = format!(
            "reachable, linked in {}, {} cells",
            time(linked),
            cells.len()
        );
        let row = if cells.is_empty() {
            let hint = "a cell gives rights by [[fleet.allow]] of its cell file; a router without cells is alone";
            Row::new(Grade::Fail, endpoint, format!("{text}\nhint: {hint}"))
        } else {
            Row::new(Grade::Good, endpoint, text)
        };
        Ok((row, cells))
    }
}

/// Conditions of the cells.
fn judge(cells: &[Cell]) -> Vec<Row> {
    let mut rows: Vec<Row> = cells.iter().flat_map(of_cell).collect();
    rows.extend(sharing(cells));
    rows.extend(differing(cells, "version", |cell| {
        cell.info["version"].as_str().map(str::to_owned)
    }));
    rows.extend(differing(cells, "TAI - UTC", |cell| {
        cell.clock["tai_utc_s"].as_i64().map(|s| format!("{s} s"))
    }));
    rows
}

fn of_cell(cell: &Cell) -> Vec<Row> {
    let name = cell.cell.as_str();
    let row = |grade, text: String| Row::new(grade, name, text);
    let Some(after) = cell.answer_ns else {
        let hint = "it gives this link no right to read, or its host is overloaded: see its log";
        let text = format!("alive, but does not answer in time\nhint: {hint}");
        return vec![row(Grade::Fail, text)];
    };
    let mut rows = Vec::new();
    let answer = time(i64::try_from(after).unwrap_or(i64::MAX));
    rows.push(if after > SLOW_NS {
        let hint = "see `takt doctor` on its host, and the load of the network";
        row(Grade::Warn, format!("answers in {answer}\nhint: {hint}"))
    } else {
        let boot = cell.boots.first().map_or("-", String::as_str);
        row(Grade::Good, format!("answers in {answer}, boot {boot}"))
    });
    if cell.boots.len() > 1 {
        let boots = cell.boots.join(", ");
        let hint = "set another fleet.cell in one of the two cell files";
        let text = format!(
            "{} controllers have this name: boots {boots}\nhint: {hint}",
            cell.boots.len()
        );
        rows.push(row(Grade::Fail, text));
    }
    if !cell.alive {
        let hint = "it is just joining or leaving: try again";
        rows.push(row(
            Grade::Warn,
            format!("answers, but is not alive\nhint: {hint}"),
        ));
    }
    rows.push(of_clock(cell));
    if let Some(worst) = cell.summary["worst"].as_str() {
        let (failed, warned) = (cell.count("fail"), cell.count("warn"));
        let grade = if failed > 0 { Grade::Fail } else { Grade::Warn };
        let worst = worst.lines().next().unwrap_or_default();
        let at = cell.info["http"].as_str().unwrap_or("its `websocket`");
        let text = format!(
            "{failed} FAIL, {warned} WARN: {worst}\nhint: `takt top --connect {at}` on {}",
            cell.info("host")
        );
        rows.push(row(grade, text));
    }
    rows
}

fn of_clock(cell: &Cell) -> Row {
    let row = |grade, text: String| Row::new(grade, &cell.cell, text);
    let clock = &cell.clock;
    let uncertainty = clock["uncertainty_ns"].as_i64().unwrap_or(i64::MAX);
    match clock["state"].as_str() {
        Some("locked") if uncertainty <= UNCERTAIN_NS => row(
            Grade::Good,
            format!("clock locked to TAI within {}", time(uncertainty)),
        ),
        Some("locked") => {
            let hint = "use PTP with hardware time stamps: ptp4l and phc2sys";
            let text = format!(
                "clock locked to TAI, uncertain by {}\nhint: {hint}",
                time(uncertainty)
            );
            row(Grade::Warn, text)
        }
        Some("holdover") => {
            let hint = "systemctl status ptp4l phc2sys chrony";
            let text = format!(
                "clock in holdover, uncertain by {}\nhint: {hint}",
                time(uncertainty)
            );
            row(Grade::Warn, text)
        }
        Some(_) => {
            let cause = clock["cause"].as_str().unwrap_or("its cause is not known");
            row(
                Grade::Warn,
                format!(
                    "clock is free, no start in the same cycle as cells of other hosts: {cause}"
                ),
            )
        }
        None => row(Grade::Warn, "state of the clock is not known".to_owned()),
    }
}

/// The cells that run on one host: they need no time service to begin in the same cycle.
fn sharing(cells: &[Cell]) -> Vec<Row> {
    let mut by_clock: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for cell in cells {
        let clock = cell.info["clock"].as_str().unwrap_or_default();
        by_clock.entry(clock).or_default().push(&cell.cell);
    }
    let sharing = by_clock
        .into_iter()
        .filter(|(clock, cells)| !clock.is_empty() && cells.len() > 1);
    let row = |cells: Vec<&str>| {
        let text = format!("{} share the clock of one host", cells.join(", "));
        Row::new(Grade::Good, "fleet", text)
    };
    sharing.map(|(_, cells)| row(cells)).collect()
}

/// A row if cells differ in a value.
fn differing(cells: &[Cell], what: &str, value: impl Fn(&Cell) -> Option<String>) -> Option<Row> {
    let mut by_value: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for cell in cells {
        if let Some(value) = value(cell) {
            by_value.entry(value).or_default().push(&cell.cell);
        }
    }
    if by_value.len() < 2 {
        return None;
    }
    let parts = by_value
        .iter()
        .map(|(value, cells)| format!("{value} on {}", cells.join(", ")));
    let parts: Vec<_> = parts.collect();
    Some(Row::new(
        Grade::Warn,
        "fleet",
        format!("{what} differs: {}", parts.join("; ")),
    ))
}

fn text(row: &Row) -> String {
    let word = match row.grade {
        Grade::Good => "ok",
        Grade::Warn => "WARN",
        Grade::Fail => "FAIL",
    };
    let mut out = format!("{word:<4}  {}: {}", row.subject, row.cause);
    if let Some(hint) = &row.hint {
        for line in wrapped(&format!("hint: {hint}"), 6, 100) {
            out.push_str("\n      ");
            out.push_str(&line);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn cell(name: &str, clock: Value) -> Cell {
        Cell {
            cell: name.to_owned(),
            alive: true,
            boots: vec!["1".to_owned()],
            info: json!({"version": "0.1.0", "host": "rob1"}),
            summary: json!({"state": "good"}),
            clock,
            answer_ns: Some(300_000),
        }
    }

    fn locked() -> Value {
        json!({"state": "locked", "uncertainty_ns": 2_000, "tai_utc_s": 37})
    }

    #[test]
    fn healthy_cells_are_all_ok() {
        let mut cells = [cell("a", locked()), cell("b", locked())];
        let alone = judge(&cells);
        cells
            .iter_mut()
            .for_each(|cell| cell.info["clock"] = json!("kernel"));
        let rows = judge(&cells);
        assert_eq!(rows.len(), alone.len() + 1);
        assert_eq!(
            text(&rows[4]),
            "ok    fleet: a, b share the clock of one host"
        );
        assert!(rows.iter().all(|row| row.grade == Grade::Good), "{rows:?}");
        assert_eq!(text(&rows[0]), "ok    a: answers in 300 us, boot 1");
        assert_eq!(text(&rows[1]), "ok    a: clock locked to TAI within 2.0 us");
    }

    #[test]
    fn each_fault_has_its_row() {
        let free =
            json!({"state": "free", "cause": "no service\nhint: start ptp4l", "tai_utc_s": 0});
        let mut twin = cell("a", free);
        twin.boots.push("2".to_owned());
        twin.info["version"] = json!("0.2.0");
        let mut bad = cell("b", locked());
        bad.summary =
            json!({"state": "fail", "fail": 1, "warn": 2, "worst": "left is offline: no answer"});
        let silent = Cell {
            answer_ns: None,
            ..cell("c", Value::Null)
        };
        let rows = judge(&[twin, bad, silent]);
        let shown: Vec<_> = rows.iter().map(text).collect();
        let shown = shown.join("\n");
        for part in [
            "FAIL  a: 2 controllers have this name: boots 1, 2",
            "WARN  a: clock is free, no start in the same cycle as cells of other hosts: no service\n      hint: start ptp4l",
            "FAIL  b: 1 FAIL, 2 WARN: left is offline",
            "FAIL  c: alive, but does not answer in time",
            "WARN  fleet: version differs: 0.1.0 on b, c; 0.2.0 on a",
            "WARN  fleet: TAI - UTC differs: 0 s on a; 37 s on b",
        ] {
            assert!(shown.contains(part), "{part}\n{shown}");
        }
    }
}
