//! The page on the whole terminal, with keys. At 80 columns and 24 lines each table has its part; one alone has all.

use std::time::{Duration, Instant};

use ratatui::Frame;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use ratatui::layout::Rect;
use ratatui::style::{Color, Style, Stylize as _};
use ratatui::text;

use super::finding::{Grade, ago};
use super::poll::{Poller, Reading};
use super::report::Report;
use super::table::{Line, Order, Section, sections};
use super::text::head;
use crate::screen::{Screen, is_end, keys};
use crate::signal::Stop;

/// How long keys are waited for between two pictures.
const TICK: Duration = Duration::from_millis(100);

/// What the keys do.
const HELP: [&str; 9] = [
    "q, Esc        end",
    "s             next order: worst first, by cost, by name",
    "Tab, BackTab  next or previous table alone; after the last all of them",
    "arrows, page  scroll the table",
    "Space, p      pause and go on",
    "?             this help",
    "",
    "late: from when a cycle was due to its start. over: cycles above the cost bound.",
    "age: since the last measurement. phase: error on the device's clock, p99.",
];

/// Shows it until a key or a signal ends it.
pub(super) fn show(mut screen: Screen, address: &str, poller: Poller) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let mut view = View::new(address);
    loop {
        if let Some(reading) = poller.latest() {
            view.handle_reading(reading, Instant::now());
        }
        let now = Instant::now();
        screen.draw(|frame| view.draw(frame, now))?;
        for key in keys(TICK)? {
            if is_end(&key) {
                return Ok(());
            }
            view.handle_key(&key);
        }
        if stop.is_requested() {
            return Ok(());
        }
    }
}

/// What is shown, and how.
#[derive(Debug)]
struct View {
    address: String,
    report: Option<Report>,
    /// Since when the controller does not answer, and why.
    lost: Option<(Instant, String)>,
    order: Order,
    /// The table that is shown alone.
    alone: Option<usize>,
    scroll: usize,
    is_paused: bool,
    is_help: bool,
}

impl View {
    fn new(address: &str) -> Self {
        Self {
            address: address.to_owned(),
            report: None,
            lost: None,
            order: Order::default(),
            alone: None,
            scroll: 0,
            is_paused: false,
            is_help: false,
        }
    }

    fn handle_reading(&mut self, reading: Reading, now: Instant) {
        match reading {
            Ok(report) => {
                self.lost = None;
                if !self.is_paused || self.report.is_none() {
                    self.report = Some(report);
                }
            }
            Err(why) => {
                let since = self.lost.take().map_or(now, |(since, _)| since);
                self.lost = Some((since, why));
            }
        }
    }

    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "some 20 other keys, which do nothing"
    )]
    fn handle_key(&mut self, key: &KeyEvent) {
        /// Number of tables.
        const TABLES: usize = 5;
        /// Lines of a page.
        const PAGE: usize = 10;
        let scroll = self.scroll;
        (self.is_help, self.scroll) = (false, 0);
        match key.code {
            KeyCode::Char('s') => self.order = self.order.next(),
            KeyCode::Char('p' | ' ') => self.is_paused = !self.is_paused,
            KeyCode::Char('?' | 'h') => self.is_help = true,
            KeyCode::Tab => {
                let next = self.alone.map_or(0, |table| table + 1);
                self.alone = (next < TABLES).then_some(next);
            }
            KeyCode::BackTab => {
                self.alone = match self.alone {
                    None => Some(TABLES - 1),
                    Some(table) => table.checked_sub(1),
                }
            }
            KeyCode::Down => self.scroll = scroll.saturating_add(1),
            KeyCode::Up => self.scroll = scroll.saturating_sub(1),
            KeyCode::PageDown => self.scroll = scroll.saturating_add(PAGE),
            KeyCode::PageUp => self.scroll = scroll.saturating_sub(PAGE),
            _ => self.scroll = scroll,
        }
    }

    fn draw(&mut self, frame: &mut Frame<'_>, now: Instant) {
        let area = frame.area();
        let put = |frame: &mut Frame<'_>, row: u16, text: text::Line<'_>| {
            let place = Rect::new(0, row, area.width, 1).intersection(area);
            frame.render_widget(text, place);
        };
        put(frame, 0, self.heading(now));
        let height = usize::from(area.height.saturating_sub(2));
        for (row, line) in (1..).zip(self.body(usize::from(area.width), height)) {
            put(frame, row, line);
        }
        let keys = "q end  s order  Tab table  Space pause  ? help";
        let foot = format!("{keys}    {}", self.order.word());
        let last = area.height.saturating_sub(1);
        put(frame, last.max(1), text::Line::from(foot).dim());
    }

    fn heading(&self, now: Instant) -> text::Line<'static> {
        let head = self.report.as_ref().map_or_else(
            || format!("takt at {}: no report yet", self.address),
            |report| head(report, &self.address),
        );
        match &self.lost {
            Some((since, why)) => {
                let span = now.saturating_duration_since(*since).as_nanos();
                let span = ago(i64::try_from(span).unwrap_or(i64::MAX));
                // Its hint is in the body while there is nothing else.
                let why = why.lines().next().unwrap_or_default();
                let text = format!("connection lost {span} ago, retrying: {why}");
                text::Line::from(text).bold().fg(Color::Red)
            }
            None if self.is_paused => text::Line::from(format!("{head}  PAUSED")).bold(),
            None => text::Line::from(head).bold(),
        }
    }

    /// The lines between heading and foot.
    fn body(&mut self, width: usize, height: usize) -> Vec<text::Line<'static>> {
        if self.is_help {
            return HELP.map(text::Line::from).to_vec();
        }
        let Some(report) = &self.report else {
            let lost = self.lost.as_ref().map(|(_, why)| why.as_str());
            let lines = lost.unwrap_or("connecting").lines();
            return lines.map(|it| text::Line::from(it.to_owned())).collect();
        };
        let all = sections(report, self.order, width);
        let head = |head: &str| text::Line::from(head.to_owned()).dim();
        let Some(section) = self.alone.and_then(|table| all.get(table)) else {
            let filled: Vec<&Section> = all.iter().filter(|it| !it.lines.is_empty()).collect();
            let parts = parts(&filled, height);
            let shown = filled.iter().zip(parts).filter(|(_, part)| *part > 0);
            let shown = shown.flat_map(|(section, part)| {
                let lines = clipped(&section.lines, 0, part.saturating_sub(1));
                [head(&section.head)].into_iter().chain(lines)
            });
            return shown.collect();
        };
        let room = height.saturating_sub(1);
        self.scroll = self.scroll.min(section.lines.len().saturating_sub(room));
        let lines = clipped(&section.lines, self.scroll, room);
        [head(&section.head)].into_iter().chain(lines).collect()
    }
}

/// How many lines each table has, with its head, if all together may have `height`: what a table does not need is the
/// others'.
fn parts(sections: &[&Section], height: usize) -> Vec<usize> {
    // A head without a line says nothing.
    let mut parts: Vec<usize> = vec![0; sections.len()];
    let mut left = height;
    for part in &mut parts {
        if left >= 2 {
            *part = 2;
            left -= 2;
        }
    }
    loop {
        let before = left;
        for (part, section) in parts.iter_mut().zip(sections) {
            if left > 0 && *part > 0 && *part < section.lines.len() + 1 {
                *part += 1;
                left -= 1;
            }
        }
        if left == before {
            return parts;
        }
    }
}

/// At most so many lines from one on; the last says how many follow.
fn clipped(
    lines: &[Line],
    from: usize,
    room: usize,
) -> impl Iterator<Item = text::Line<'static>> + use<> {
    let rest = lines.get(from..).unwrap_or_default();
    let is_whole = rest.len() <= room;
    let shown = if is_whole {
        room
    } else {
        room.saturating_sub(1)
    };
    let more = rest.len().saturating_sub(shown);
    let more = (!is_whole && room > 0).then(|| format!("      … {more} more lines: Tab"));
    let lines: Vec<_> = rest.iter().take(shown).map(styled).collect();
    let more = more.map(|text| text::Line::from(text).dim());
    lines.into_iter().chain(more)
}

fn styled(line: &Line) -> text::Line<'static> {
    let style = match line.grade {
        Grade::Good => Style::new(),
        Grade::Warn => Style::new().fg(Color::Yellow),
        Grade::Fail => Style::new().fg(Color::Red).bold(),
    };
    text::Line::styled(line.text.clone(), style)
}

#[cfg(test)]
mod tests;
