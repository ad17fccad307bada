//! Curves on the whole terminal, in braille, with keys: a plot for each unit or for each probe, over the window, which ends now or at
//! the pause; of a capture, around its trigger.

use std::time::{Duration, Instant};

use ratatui::Frame;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use ratatui::layout::Rect;
use ratatui::style::{Color, Style, Stylize as _};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType};

use super::figures::number;
use super::source::Source;
use super::store::{Curve, Point, Store, WINDOW_MAX_S, thinned};
use super::svg::{bounds, by_unit};
use super::wire::Event;
use crate::Verdict;
use crate::screen::{Screen, is_end, keys};
use crate::signal::Stop;

/// How long keys are waited for between two pictures.
const TICK: Duration = Duration::from_millis(50);

/// Most events between two pictures.
const EVENTS_MAX: usize = 256;

/// Fewest lines of a plot, with its heading.
const PLOT_LINES: usize = 7;

/// Window of a stream at the beginning, s.
const WINDOW_S: f64 = 10.0;

const COLOURS: [Color; 6] = [
    Color::Cyan,
    Color::Yellow,
    Color::Green,
    Color::Magenta,
    Color::Blue,
    Color::Red,
];

const HELP: [&str; 9] = [
    "q, Esc       end",
    "Space, p     pause and go on; captures wait",
    "+, -         shorter or longer window",
    "left, right  move the cursor; c removes it",
    "a            hold the scales, or fit them to the values",
    "g            a plot for each unit, or for each probe",
    "up, down     other plots, if not all have room",
    "?            this help",
    "Values are those at the cursor, or the last ones; - is null.",
];

/// Shows it until a key, a signal or the time ends it.
pub(super) fn show(
    mut screen: Screen,
    address: &str,
    duration: Option<Duration>,
    source: Source,
) -> anyhow::Result<Verdict> {
    let stop = Stop::listen()?;
    let begin = Instant::now();
    let mut view = View::new(address);
    loop {
        let events = std::iter::from_fn(|| source.next(Duration::ZERO));
        for event in events.take(EVENTS_MAX) {
            view.handle_event(event);
        }
        screen.draw(|frame| view.draw(frame))?;
        let is_over = duration.is_some_and(|span| begin.elapsed() >= span);
        for key in keys(TICK)? {
            if is_end(&key) {
                return Ok(view.verdict());
            }
            view.handle_key(&key);
        }
        if is_over || stop.is_requested() {
            return Ok(view.verdict());
        }
    }
}

#[derive(Debug)]
struct View {
    address: String,
    store: Store,
    /// Why nothing comes: lost, or refused.
    trouble: Option<String>,
    is_connected: bool,
    window_s: f64,
    /// End of the window while it is paused, s.
    paused_at: Option<f64>,
    /// Captures that came while it is paused.
    waiting: Vec<Event>,
    /// Place of the cursor in the window, 0 to 1.
    cursor: Option<f64>,
    /// Scales that are held, by plot.
    scales: Option<Vec<(f64, f64)>>,
    is_split: bool,
    first_plot: usize,
    is_help: bool,
}

impl View {
    fn new(address: &str) -> Self {
        Self {
            address: address.to_owned(),
            store: Store::default(),
            trouble: None,
            is_connected: false,
            window_s: WINDOW_S,
            paused_at: None,
            waiting: Vec::new(),
            cursor: None,
            scales: None,
            is_split: false,
            first_plot: 0,
            is_help: false,
        }
    }

    fn verdict(&self) -> Verdict {
        match self.trouble {
            Some(_) => Verdict::Failed,
            None => Verdict::Good,
        }
    }

    fn handle_event(&mut self, event: Event) {
        match &event {
            Event::Closed(why) => {
                (self.is_connected, self.trouble) = (false, Some(format!("lost: {why}")));
            }
            Event::Refused(why) => self.trouble = Some(why.clone()),
            Event::Setup(_) => (self.is_connected, self.trouble) = (true, None),
            // A capture is shown as a whole: the one that is looked at stays.
            Event::Triggered(_) if self.paused_at.is_some() => self.waiting.clear(),
            Event::Triggered(_)
            | Event::Ended(_)
            | Event::Lost { .. }
            | Event::Done
            | Event::Frame(_) => {}
        }
        let waits = self.paused_at.is_some() && self.store.trigger.is_some();
        if waits && matches!(event, Event::Triggered(_) | Event::Frame(_)) {
            self.waiting.push(event);
        } else {
            self.store.handle(&event);
        }
    }

    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "some 20 other keys, which do nothing"
    )]
    fn handle_key(&mut self, key: &KeyEvent) {
        /// Least window, s.
        const WINDOW_MIN_S: f64 = 0.01;
        /// How far a key moves the cursor.
        const STEP: f64 = 0.01;
        self.is_help = false;
        let cursor = self.cursor.unwrap_or(0.5);
        match key.code {
            KeyCode::Char(' ' | 'p') => self.pause(),
            KeyCode::Char('+' | '=') => self.window_s = (self.window_s / 2.0).max(WINDOW_MIN_S),
            KeyCode::Char('-') => self.window_s = (self.window_s * 2.0).min(WINDOW_MAX_S),
            KeyCode::Char('a') => {
                self.scales = match self.scales {
                    None => Some(self.plots().iter().map(|plot| self.fitted(plot)).collect()),
                    Some(_) => None,
                }
            }
            KeyCode::Char('g') => {
                (self.is_split, self.scales, self.first_plot) = (!self.is_split, None, 0);
            }
            KeyCode::Char('c') => self.cursor = None,
            KeyCode::Left => self.cursor = Some((cursor - STEP).max(0.0)),
            KeyCode::Right => self.cursor = Some((cursor + STEP).min(1.0)),
            KeyCode::Up => self.first_plot = self.first_plot.saturating_sub(1),
            KeyCode::Down => self.first_plot = self.first_plot.saturating_add(1),
            KeyCode::Char('?' | 'h') => self.is_help = true,
            _ => {}
        }
    }

    fn pause(&mut self) {
        if self.paused_at.take().is_none() {
            self.paused_at = Some(self.store.end_s);
            return;
        }
        for event in std::mem::take(&mut self.waiting) {
            self.store.handle(&event);
        }
    }

    /// The window, s.
    fn window(&self) -> (f64, f64) {
        if self.store.trigger.is_some() {
            let (from, to) = self.store.span();
            return (from, to.max(from + 1e-3));
        }
        let end = self.paused_at.unwrap_or(self.store.end_s);
        (end - self.window_s, end)
    }

    /// Units with their curves, plot by plot; their numbers are those of colours.
    fn plots(&self) -> Vec<(String, Vec<(usize, &Curve)>)> {
        let numbered = |curve: &Curve| {
            let mut curves = self.store.curves.iter();
            curves.position(|it| it == curve).unwrap_or(0)
        };
        if self.is_split {
            let curves = self.store.curves.iter().enumerate();
            return curves.map(|it| (it.1.unit.clone(), vec![it])).collect();
        }
        let plots = by_unit(&self.store.curves).into_iter();
        let numbered = |curve| (numbered(curve), curve);
        plots
            .map(|(unit, curves)| (unit, curves.into_iter().map(numbered).collect()))
            .collect()
    }

    /// The scale that shows all values of a plot.
    fn fitted(&self, (_, curves): &(String, Vec<(usize, &Curve)>)) -> (f64, f64) {
        let (from, to) = self.window();
        let pieces = curves
            .iter()
            .flat_map(|(_, curve)| self.store.pieces(curve, from, to));
        let values: Vec<f64> = pieces.flatten().map(|(_, value)| value).collect();
        bounds(values.into_iter())
    }

    fn draw(&mut self, frame: &mut Frame<'_>) {
        let area = frame.area();
        let row = |number: u16| Rect::new(0, number, area.width, 1).intersection(area);
        frame.render_widget(self.heading(), row(0));
        let last = area.height.saturating_sub(1);
        let body = Rect::new(0, 1, area.width, area.height.saturating_sub(2)).intersection(area);
        if self.is_help {
            for (row, text) in body.rows().zip(HELP) {
                frame.render_widget(Line::from(text), row);
            }
        } else {
            self.draw_plots(frame, body);
        }
        frame.render_widget(self.foot(), row(last.max(1)));
    }

    fn heading(&self) -> Line<'static> {
        let Store {
            lost,
            captures,
            trigger,
            ..
        } = &self.store;
        let mut parts = vec![match (&self.trouble, self.is_connected) {
            (Some(why), _) => {
                let why = why.lines().next().unwrap_or_default().to_owned();
                Span::from(format!("{}: {why}", self.address)).fg(Color::Red)
            }
            (None, true) => Span::from(self.address.clone()),
            (None, false) => Span::from(format!("connecting to {}", self.address)),
        }];
        if let Some(trigger) = trigger {
            let (time, cause) = (trigger.time_s, &trigger.cause);
            parts.push(format!("  capture {captures} at {time:.6} s: {cause}").into());
        }
        if *lost > 0 {
            parts.push(Span::from(format!("  {lost} SAMPLES LOST")).fg(Color::Red));
        }
        if self.paused_at.is_some() {
            parts.push(Span::from("  PAUSED").bold());
        }
        Line::from(parts).bold()
    }

    fn foot(&self) -> Line<'static> {
        let (from, to) = self.window();
        let window = format!("window {} s", number(Some(to - from)));
        let cursor = self.cursor.map_or_else(String::new, |cursor| {
            let zero = self.store.trigger.as_ref().map_or(0.0, |it| it.time_s);
            let time = from + cursor * (to - from) - zero;
            format!("  cursor {time:.6} s")
        });
        let held = if self.scales.is_some() {
            "  scales held"
        } else {
            ""
        };
        let note = self.store.note.as_ref();
        let note = note.map_or_else(String::new, |note| format!("  {note}"));
        let keys = "q end  Space pause  +- window  ? help";
        Line::from(format!("{keys}  {window}{cursor}{held}{note}")).dim()
    }

    fn draw_plots(&mut self, frame: &mut Frame<'_>, body: Rect) {
        let plots = self.plots();
        let height = usize::from(body.height);
        let count = (height / PLOT_LINES).clamp(1, plots.len().max(1));
        let first = self.first_plot.min(plots.len().saturating_sub(count));
        let mut top = 0;
        for (place, (number, plot)) in (0..).zip(plots.iter().enumerate().skip(first).take(count)) {
            // What does not divide goes to the first plots.
            let lines = height / count + usize::from(place < height % count);
            let lines = u16::try_from(lines).unwrap_or(0);
            let area = Rect::new(0, body.y.saturating_add(top), body.width, lines);
            let area = area.intersection(frame.area());
            let held = self
                .scales
                .as_ref()
                .and_then(|all| all.get(number))
                .copied();
            let scale = held.unwrap_or_else(|| self.fitted(plot));
            self.draw_plot(frame, area, plot, scale);
            top = top.saturating_add(lines);
        }
        self.first_plot = first;
    }

    fn draw_plot(
        &self,
        frame: &mut Frame<'_>,
        area: Rect,
        (unit, curves): &(String, Vec<(usize, &Curve)>),
        (low, high): (f64, f64),
    ) {
        let colour = |number: usize| *COLOURS.get(number % COLOURS.len()).unwrap_or(&Color::White);
        let (from, to) = self.window();
        let at = self.cursor.map(|cursor| from + cursor * (to - from));
        let shown_at = at.unwrap_or_else(|| self.paused_at.unwrap_or(self.store.end_s));
        let unit = if unit.is_empty() { "-" } else { unit };
        let mut legend = vec![Span::from(format!("{unit:<6}")).dim()];
        for (number, curve) in curves {
            let text = format!("{} {}  ", curve.name, self.shown(curve, shown_at));
            legend.push(Span::styled(text, Style::new().fg(colour(*number))));
        }
        let mut rows = area.rows();
        if let Some(row) = rows.next() {
            frame.render_widget(Line::from(legend), row);
        }
        let chart = Rect::new(
            area.x,
            area.y.saturating_add(1),
            area.width,
            area.height.saturating_sub(1),
        );
        let parts = usize::from(area.width).saturating_mul(2);
        let pieces: Vec<(usize, Vec<Point>)> = curves
            .iter()
            .flat_map(|(number, curve)| {
                let pieces = self.store.pieces(curve, from, to).into_iter();
                pieces.map(|piece| (*number, thinned(&piece, parts)))
            })
            .collect();
        let line = |time: f64| [(time, low), (time, high)];
        let trigger = self.store.trigger.as_ref().map(|it| line(it.time_s));
        let cursor = at.map(line);
        let rule = |points| {
            let set = Dataset::default().data(points).graph_type(GraphType::Line);
            set.marker(Marker::Braille).style(Style::new().dim())
        };
        let rules = trigger.as_ref().into_iter().chain(cursor.as_ref());
        let sets = rules
            .map(|points| rule(points.as_slice()))
            .chain(pieces.iter().map(|(number, points)| {
                let set = Dataset::default().data(points).marker(Marker::Braille);
                let set = set.graph_type(GraphType::Line);
                set.style(Style::new().fg(colour(*number)))
            }));
        let zero = self.store.trigger.as_ref().map_or(to, |it| it.time_s);
        let times = [from, to].map(|time| format!("{:+.3} s", time - zero));
        let values = [low, high].map(|value| number(Some(value)));
        frame.render_widget(
            Chart::new(sets.collect())
                .x_axis(Axis::default().bounds([from, to]).labels(times))
                .y_axis(Axis::default().bounds([low, high]).labels(values)),
            chart,
        );
    }

    /// The value of a curve as text: that of a state by its name.
    fn shown(&self, curve: &Curve, time: f64) -> String {
        let value = self.store.value(curve, time);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "numbers of states are small; others have no name"
        )]
        let state = value.and_then(|value| curve.states.get(value as usize));
        state.cloned().unwrap_or_else(|| number(value))
    }
}

#[cfg(test)]
mod tests;
