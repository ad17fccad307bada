//! The running measurement: a screen if the output is a terminal, a bar if only standard error is one, else nothing.
//!
//! It is drawn seldom, since drawing takes processor time.

use std::io::IsTerminal as _;
use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Style, Stylize as _};
use ratatui::text::Line;
use ratatui::widgets::{Bar, BarChart, BarGroup, Block, Row, Table};

use crate::jitter::histogram::Histogram;
use crate::jitter::report::{ThreadReport, nanos, pooled};
use crate::screen::{Screen, is_end_wanted};

/// Lower bounds of the bars, us; the last bar has no upper one.
const BARS_US: [u32; 16] = [
    0, 2, 5, 10, 15, 20, 30, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 100_000,
];

/// What is shown.
pub(crate) struct Scene<'a> {
    /// What is measured, a line.
    pub(crate) title: &'a str,
    /// What happens now, as in `slice 3 of 10, cyclictest`; may be empty.
    pub(crate) stage: String,
    pub(crate) elapsed: Duration,
    pub(crate) whole: Duration,
    /// What our threads measured so far, in all slices.
    pub(crate) threads: Vec<ThreadReport>,
    /// What the other tool measured in its slices; empty if there is none.
    pub(crate) other: &'a [ThreadReport],
}

/// Where it is shown.
pub(crate) enum View {
    /// Nowhere.
    None,
    /// As a bar among the complaints.
    Bar(indicatif::ProgressBar),
    /// On the whole terminal.
    Screen(Screen),
}

impl View {
    /// The fullest that these streams allow. `is_plain`: no screen, the output is for programs.
    pub(crate) fn open(is_quiet: bool, is_plain: bool) -> Self {
        if is_quiet || !std::io::stderr().is_terminal() {
            return Self::None;
        }
        if let Some(screen) = Screen::open(!is_plain) {
            return Self::Screen(screen);
        }
        let style = indicatif::ProgressStyle::with_template("{msg} {wide_bar} {percent}%");
        let bar = indicatif::ProgressBar::new(1);
        Self::Bar(
            style
                .map(|style| bar.clone().with_style(style))
                .unwrap_or(bar),
        )
    }

    /// Whether there is anything to show it on.
    pub(crate) fn is_open(&self) -> bool {
        !matches!(self, Self::None)
    }

    /// Shows it. True if the user wants to end.
    pub(crate) fn show(&mut self, scene: &Scene<'_>) -> anyhow::Result<bool> {
        let millis = |span: Duration| u64::try_from(span.as_millis()).unwrap_or(u64::MAX);
        match self {
            Self::None => Ok(false),
            Self::Bar(bar) => {
                let worst = pooled(&scene.threads).max_ns();
                bar.set_length(millis(scene.whole));
                bar.set_position(millis(scene.elapsed.min(scene.whole)));
                let stage = if scene.stage.is_empty() {
                    "measuring"
                } else {
                    &scene.stage
                };
                bar.set_message(format!("{stage}, worst {}", nanos(worst)));
                Ok(false)
            }
            Self::Screen(screen) => {
                screen.draw(|frame| draw(frame, scene))?;
                is_end_wanted()
            }
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        if let Self::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

fn draw(frame: &mut Frame<'_>, scene: &Scene<'_>) {
    let rows = u16::try_from(scene.threads.len() + scene.other.len()).unwrap_or(u16::MAX);
    let areas = Layout::vertical([
        Constraint::Length(2),
        Constraint::Length(rows.saturating_add(2)),
        Constraint::Min(5),
        Constraint::Length(1),
    ])
    .split(frame.area());
    let [head, table, chart, foot] = *areas else {
        return;
    };
    let seconds = |span: Duration| span.as_secs();
    let (done, whole) = (
        seconds(scene.elapsed.min(scene.whole)),
        seconds(scene.whole),
    );
    let second = format!("{done} s of {whole} s  {}", scene.stage);
    frame.render_widget(Line::from(scene.title).bold(), head);
    let below = head.rows().nth(1).unwrap_or(head);
    frame.render_widget(Line::from(second), below);
    frame.render_widget(figures(scene), table);
    let title = "cycles by latency from, us; logarithmic";
    frame.render_widget(bars(title, &pooled(&scene.threads), chart.width), chart);
    frame.render_widget(
        Line::from("q or Ctrl-C ends it and keeps what was measured").dim(),
        foot,
    );
}

/// A row per thread; where two tools measure in turns, with the tool's name.
fn figures(scene: &Scene<'_>) -> Table<'static> {
    let (ours, other) = match scene.other {
        [] => ("", ""),
        _ => ("takt ", "other "),
    };
    let ours = scene.threads.iter().map(|thread| row(ours, thread));
    let other = scene.other.iter().map(|thread| row(other, thread));
    let heads = [
        "CPU", "cycles", "missed", "min", "p50", "p99", "p99.9", "max",
    ];
    let heads = heads.map(|head| Line::from(head).right_aligned());
    let widths = [9, 10, 8, 9, 9, 9, 9, 9];
    Table::new(ours.chain(other), widths).header(Row::new(heads).style(Style::new().dim()))
}

fn row(tool: &str, thread: &ThreadReport) -> Row<'static> {
    let latency = &thread.latency_ns;
    let q = latency.quantiles();
    let missed = thread.missed_cycles;
    let mut cells = vec![
        format!("{tool}{}", thread.name()),
        thread.cycles.to_string(),
        missed.map_or_else(|| "?".to_owned(), |missed| missed.to_string()),
    ];
    cells.extend([latency.min_ns(), q.p50, q.p99, q.p999, q.max].map(nanos));
    let right = |cell: String| Line::from(cell).right_aligned();
    Row::new(cells.into_iter().map(right))
}

/// A bar's height goes by the logarithm of its count; the count stands in it.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts are positive; heights are small"
)]
pub(crate) fn bars(title: &'static str, times: &Histogram, width: u16) -> BarChart<'static> {
    let mut bounds: Vec<_> = BARS_US.iter().map(|&us| f64::from(us) * 1e3).collect();
    bounds.push(f64::INFINITY);
    let counts = times.rebinned(&bounds);
    let bar = |(us, count): (&u32, f64)| {
        let height = (count.round() + 1.0).log2() * 16.0;
        let text = if count < 0.5 {
            String::new()
        } else {
            format!("{count:.0}")
        };
        Bar::default()
            .value(height as u64)
            .text_value(text)
            .label(Line::from(label(*us)))
    };
    let all: Vec<_> = BARS_US.iter().zip(counts).map(bar).collect();
    let room = usize::from(width.saturating_sub(2));
    let bar_width = (room / BARS_US.len()).saturating_sub(1).clamp(3, 9);
    BarChart::default()
        .block(Block::bordered().title(title))
        .data(BarGroup::default().bars(&all))
        .bar_width(u16::try_from(bar_width).unwrap_or(3))
        .bar_gap(1)
}

fn label(us: u32) -> String {
    if us < 1000 {
        us.to_string()
    } else {
        format!("{}k", us / 1000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use takt_rt::Nanos;
    use takt_rt::cycle::Grid;

    fn thread(cpu: Option<usize>) -> ThreadReport {
        let (mut writer, reader) = takt_rt::stats::pair();
        let mut grid = Grid::new(Nanos::from_millis(5), Duration::from_millis(1));
        for late_us in [17; 999].into_iter().chain([312]) {
            let tick = grid.next(grid.deadline() + Nanos::from_micros(late_us));
            writer.record(&tick, tick.woken);
        }
        ThreadReport::of_stats(cpu, &reader.snapshot())
    }

    fn screen(width: u16, height: u16, other: &[ThreadReport]) -> String {
        let scene = Scene {
            title: "1.0 ms cycle",
            stage: "slice 3 of 10, takt".into(),
            elapsed: Duration::from_secs(3),
            whole: Duration::from_secs(10),
            threads: vec![thread(Some(0)), thread(None)],
            other,
        };
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, &scene)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn screen_shows_figures_and_every_late_cycle() {
        let text = screen(82, 24, &[]);
        for part in [
            "1.0 ms cycle",
            "3 s of 10 s  slice 3 of 10, takt",
            "p99.9",
            "any",
            "1000",
            "312 us",
            "100k",
            "1998",
            "Ctrl-C",
        ] {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
        assert!(!text.contains("other"), "{text}");
    }

    #[test]
    fn screen_comparison_shows_both_tools() {
        let other = ThreadReport {
            missed_cycles: None,
            ..thread(Some(0))
        };
        let text = screen(82, 24, &[other]);
        for part in ["takt 0", "takt any", "other 0", "?"] {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
    }

    #[test]
    fn screen_of_one_cell_does_not_fail() {
        for (width, height) in [(1, 1), (10, 4), (300, 3)] {
            screen(width, height, &[]);
        }
    }
}
