//! `takt fleet top`: how all cells are, in a table that is refreshed. `takt top` shows one controller in full.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel, sync_channel};
use std::time::{Duration, Instant};

use clap::Args;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style, Stylize as _};
use ratatui::text::Line;
use takt_fleet::session::observer::Fleet;

use super::link::Link;
use super::reading::{Cell, read, table};
use crate::Verdict;
use crate::output::{chain, say, span_of_ms, time};
use crate::screen::{Screen, is_end, keys};
use crate::signal::Stop;

/// How long keys are waited for between two pictures.
const TICK: Duration = Duration::from_millis(100);

/// Show how all cells are, live: state, devices, nets, missed cycles, clock and the worst finding.
///
/// A cell that was there stays in the table as lost. q ends it. Exit status of --once: 0 good; 1 there is no cell, or one fails or is
/// silent; 2 the fleet is not reachable.
#[derive(Debug, Args)]
pub(crate) struct Top {
    /// Print the table once and end; so it does if standard output is no terminal.
    #[arg(long)]
    once: bool,
    /// How often cells are read, 200ms to 60s.
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = span_of_ms(200..=60_000))]
    interval: Duration,
    #[command(flatten)]
    link: Link,
}

impl Top {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let fleet = self.link.open()?;
        let timeout = self.link.timeout;
        let screen = Screen::open(!self.once);
        let Some(screen) = screen else {
            return once(&read(&fleet, timeout)?);
        };
        let poller = Poller::start(fleet, self.interval, timeout);
        show(screen, &self.link.connect.join(", "), &poller)?;
        Ok(Verdict::Good)
    }
}

fn once(cells: &[Cell]) -> anyhow::Result<Verdict> {
    for line in lines(cells) {
        say(&line)?;
    }
    let is_good = |cell: &Cell| matches!(cell.state(), "good" | "warn");
    Ok(if !cells.is_empty() && cells.iter().all(is_good) {
        Verdict::Good
    } else {
        Verdict::Failed
    })
}

/// The table; the first line is its head.
fn lines(cells: &[Cell]) -> Vec<String> {
    let head = [
        "CELL", "STATE", "DEVICES", "NETS", "MISSED", "LATE MAX", "CLOCK", "WORST",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    rows.extend(cells.iter().map(|cell| {
        let late = cell.summary["latency_ns_max"].as_i64();
        let worst = cell.summary["worst"].as_str().unwrap_or_default();
        vec![
            cell.cell.clone(),
            cell.state().to_owned(),
            format!("{}/{} op", cell.count("operational"), cell.count("devices")),
            cell.count("running").to_string(),
            cell.count("missed").to_string(),
            late.map_or_else(|| "-".to_owned(), time),
            cell.clock["state"].as_str().unwrap_or("-").to_owned(),
            worst.lines().next().unwrap_or_default().to_owned(),
        ]
    }));
    table(&rows)
}

type Reading = Result<Vec<Cell>, String>;

/// The thread that reads cells, so that keys are handled while one does not answer. It ends when this is dropped.
#[derive(Debug)]
struct Poller {
    readings: Receiver<Reading>,
    _end: Sender<()>,
}

impl Poller {
    fn start(fleet: Fleet, interval: Duration, timeout: Duration) -> Self {
        let (sender, readings) = sync_channel(1);
        let (end, ended) = channel::<()>();
        std::thread::spawn(move || {
            let mut known: Vec<Cell> = Vec::new();
            loop {
                let begin = Instant::now();
                let reading = read(&fleet, timeout).map(|cells| merged(&known, cells));
                if let Ok(cells) = &reading {
                    known.clone_from(cells);
                }
                if sender.send(reading.map_err(|it| chain(&it))).is_err() {
                    return;
                }
                let rest = interval.saturating_sub(begin.elapsed());
                if ended.recv_timeout(rest) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        });
        Self {
            readings,
            _end: end,
        }
    }
}

/// The cells of a reading, and those that were there before as lost.
fn merged(known: &[Cell], mut now: Vec<Cell>) -> Vec<Cell> {
    let is_there = |name: &str, cells: &[Cell]| cells.iter().any(|it| it.cell == name);
    let lost = known.iter().filter(|cell| !is_there(&cell.cell, &now));
    let lost = lost.map(|cell| Cell {
        cell: cell.cell.clone(),
        info: cell.info.clone(),
        boots: cell.boots.clone(),
        ..Cell::default()
    });
    let lost: Vec<_> = lost.collect();
    now.extend(lost);
    now.sort_by(|a, b| a.cell.cmp(&b.cell));
    now
}

fn show(mut screen: Screen, at: &str, poller: &Poller) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let mut reading: Option<Reading> = None;
    loop {
        if let Some(newest) = poller.readings.try_iter().last() {
            reading = Some(newest);
        }
        screen.draw(|frame| draw(frame, at, reading.as_ref()))?;
        let is_over = keys(TICK)?.iter().any(is_end);
        if is_over || stop.is_requested() {
            return Ok(());
        }
    }
}

fn draw(frame: &mut Frame<'_>, at: &str, reading: Option<&Reading>) {
    let area = frame.area();
    let mut shown = match reading {
        None => vec![Line::from(format!("fleet at {at}: no reading yet")).bold()],
        Some(Err(why)) => {
            let mut why = why.lines().map(|line| Line::from(line.to_owned()));
            let first = why.next().unwrap_or_default();
            [first.bold().fg(Color::Red)]
                .into_iter()
                .chain(why)
                .collect()
        }
        Some(Ok(cells)) => {
            let alive = cells.iter().filter(|cell| cell.alive).count();
            let head = format!("fleet at {at}: {alive} of {} cells alive", cells.len());
            let mut lines = lines(cells).into_iter();
            let columns = lines.next().unwrap_or_default();
            let rows = lines
                .zip(cells)
                .map(|(line, cell)| styled(line, cell.state()));
            let head = [Line::from(head).bold(), Line::from(columns).dim()];
            head.into_iter().chain(rows).collect()
        }
    };
    // The last line is for the keys.
    shown.truncate(usize::from(area.height.saturating_sub(1)));
    let last = area.height.saturating_sub(1);
    let keys = (
        last,
        Line::from("q end    takt top --connect HOST:PORT shows one in full").dim(),
    );
    for (row, line) in (0..).zip(shown).chain([keys]) {
        frame.render_widget(line, Rect::new(0, row, area.width, 1).intersection(area));
    }
}

fn styled(line: String, state: &str) -> Line<'static> {
    let style = match state {
        "good" => Style::new(),
        "warn" => Style::new().fg(Color::Yellow),
        _ => Style::new().fg(Color::Red).bold(),
    };
    Line::styled(line, style)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn cell(name: &str) -> Cell {
        Cell {
            cell: name.to_owned(),
            alive: true,
            summary: json!({"state": "good", "latency_ns_max": 43_000, "missed": 2}),
            clock: json!({"state": "locked"}),
            ..Cell::default()
        }
    }

    #[test]
    fn cell_that_was_there_stays_as_lost() {
        let known = [cell("a"), cell("b")];
        let now = merged(&known, vec![cell("b"), cell("c")]);
        let states: Vec<_> = now
            .iter()
            .map(|it| (it.cell.as_str(), it.state()))
            .collect();
        assert_eq!(states, [("a", "lost"), ("b", "good"), ("c", "good")]);
        // It stays as long as it is not there.
        assert_eq!(merged(&now, vec![cell("a")]).len(), 3);
    }

    #[test]
    fn table_shows_units_and_clock() {
        let lines = lines(&[cell("a")]);
        assert!(lines[0].starts_with("CELL  STATE"), "{lines:?}");
        assert!(
            lines[1].contains("43.0 us") && lines[1].contains("locked"),
            "{lines:?}"
        );
    }
}
