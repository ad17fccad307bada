//! One reading of all cells: which are alive, and what each answers of itself. Nothing is judged here.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use serde_json::Value;
use takt_fleet::session::observer::{Answer, Fleet};

/// What is known about a cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Cell {
    /// Its name.
    pub(super) cell: String,
    /// Whether it is seen as alive.
    pub(super) alive: bool,
    /// Boot ids of the controllers with this name: one, unless two have it.
    pub(super) boots: Vec<String>,
    /// What it is; null if it does not answer.
    pub(super) info: Value,
    /// How it is; null if it does not answer.
    pub(super) summary: Value,
    /// TAI of its host; null if it does not answer.
    pub(super) clock: Value,
    /// From the query to its answer, ns; `None` without one.
    pub(super) answer_ns: Option<u64>,
}

impl Cell {
    /// Its state in a word.
    pub(super) fn state(&self) -> &str {
        match (self.summary["state"].as_str(), self.alive) {
            (Some(state), _) => state,
            (None, true) => "silent",
            (None, false) => "lost",
        }
    }

    /// A number of its summary.
    pub(super) fn count(&self, name: &str) -> u64 {
        self.summary[name].as_u64().unwrap_or(0)
    }

    /// A text of its information.
    pub(super) fn info(&self, name: &str) -> &str {
        self.info[name].as_str().unwrap_or("-")
    }

    /// The run of its controller, shortened for people.
    pub(super) fn boot(&self) -> &str {
        let boot = self.boots.first().map_or("-", String::as_str);
        boot.get(..8).unwrap_or(boot)
    }
}

/// Reads all cells, sorted by name.
pub(crate) fn read(fleet: &Fleet, timeout: Duration) -> anyhow::Result<Vec<Cell>> {
    let mut cells = BTreeMap::new();
    for cell in fleet.alive(timeout)? {
        of(&mut cells, &cell).alive = true;
    }
    for answer in fleet.ask("takt/*/info", timeout)? {
        let (after, Some((cell, info))) = (answer.after, value_of(answer)) else {
            continue;
        };
        let cell = of(&mut cells, &cell);
        if let Some(boot) = info["boot"].as_str() {
            cell.boots.push(boot.to_owned());
        }
        cell.info = info;
        cell.answer_ns = u64::try_from(after.as_nanos()).ok();
    }
    for answer in fleet.ask("takt/*/resource/summary", timeout)? {
        if let Some((cell, summary)) = value_of(answer) {
            of(&mut cells, &cell).summary = summary;
        }
    }
    for answer in fleet.ask("takt/*/resource/clock", timeout)? {
        if let Some((cell, clock)) = value_of(answer) {
            of(&mut cells, &cell).clock = clock;
        }
    }
    let mut cells: Vec<_> = cells.into_values().collect();
    for cell in &mut cells {
        cell.boots.sort();
        cell.boots.dedup();
    }
    Ok(cells)
}

fn of<'a>(cells: &'a mut BTreeMap<String, Cell>, name: &str) -> &'a mut Cell {
    cells.entry(name.to_owned()).or_insert_with(|| Cell {
        cell: name.to_owned(),
        ..Cell::default()
    })
}

fn value_of(answer: Answer) -> Option<(String, Value)> {
    Some((answer.cell?, answer.result.ok()?))
}

/// A table of texts: columns as wide as their widest entry, the last one open.
pub(super) fn table(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns)
        .map(|column| {
            let entries = rows.iter().filter_map(|row| row.get(column));
            entries
                .map(|entry| entry.chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let line = |row: &Vec<String>| {
        let entries = row.iter().zip(&widths);
        let entries: Vec<_> = entries
            .map(|(text, width)| format!("{text:<width$}"))
            .collect();
        entries.join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn cell_state_without_answer_is_silent_or_lost() {
        let mut cell = Cell {
            alive: true,
            ..Cell::default()
        };
        assert_eq!((cell.state(), cell.boot()), ("silent", "-"));
        cell.alive = false;
        assert_eq!(cell.state(), "lost");
        cell.summary = json!({"state": "good", "nets": 3});
        cell.boots = vec!["0123456789abcdef".to_owned()];
        assert_eq!((cell.state(), cell.count("nets")), ("good", 3));
        assert_eq!((cell.boot(), cell.info("host")), ("01234567", "-"));
    }

    #[test]
    fn table_columns_are_as_wide_as_their_widest_entry() {
        let rows = [["CELL", "STATE"], ["weld-line-2", "good"]];
        let rows = rows.map(|row| row.map(str::to_owned).to_vec());
        assert_eq!(table(&rows), ["CELL         STATE", "weld-line-2  good"]);
    }
}
