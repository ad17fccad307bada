//! A connection on the whole terminal, drawn ten times a second.

use std::net::SocketAddr;
use std::time::Duration;

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Style, Stylize as _};
use ratatui::text::Line;
use ratatui::widgets::{Row, Table};
use takt_fri::client::Version;
use takt_fri::diagnosis::Verdict;
use takt_rt::stats::Distribution;

use super::live::Seen;
use crate::jitter::{Histogram, bars};
use crate::output::time;

/// What is shown.
pub(super) struct Scene<'a> {
    pub(super) seen: &'a Seen,
    pub(super) local: SocketAddr,
    pub(super) elapsed: Duration,
    /// From measurement to answer.
    pub(super) answer_time: Distribution,
    /// By how much measurements come early or late.
    pub(super) deviation: Distribution,
    pub(super) verdict: Verdict,
    pub(super) complaints: &'a [String],
}

pub(super) fn draw(frame: &mut Frame<'_>, scene: &Scene<'_>) {
    let complaints = u16::try_from(scene.complaints.len()).unwrap_or(0);
    let areas = Layout::vertical([
        Constraint::Length(2),
        Constraint::Length(7),
        Constraint::Length(5),
        Constraint::Min(5),
        Constraint::Min(5),
        Constraint::Length(complaints * 3),
        Constraint::Length(2),
    ])
    .split(frame.area());
    let [head, table, joint_table, answers, arrivals, below, foot] = *areas else {
        return;
    };
    lines(frame, head, &heads(scene));
    frame.render_widget(figures(scene), table);
    frame.render_widget(joints(scene.seen), joint_table);
    for (title, times, area) in [
        (
            "answers by time from measurement, us; logarithmic",
            &scene.answer_time,
            answers,
        ),
        (
            "measurements by time early or late, us; logarithmic",
            &scene.deviation,
            arrivals,
        ),
    ] {
        let times = Histogram::from_stats(&times.summary(), times.buckets());
        frame.render_widget(bars(title, &times, area.width), area);
    }
    let complaints = scene.complaints.join("\n");
    let complaints =
        ratatui::widgets::Paragraph::new(complaints).wrap(ratatui::widgets::Wrap { trim: true });
    frame.render_widget(complaints.bold(), below);
    lines(
        frame,
        foot,
        &[
            format!("verdict: {}", scene.verdict),
            "q or Ctrl-C ends it; a robot in command mode then brakes".to_owned(),
        ],
    );
}

fn lines(frame: &mut Frame<'_>, area: Rect, texts: &[String]) {
    for (row, text) in area.rows().zip(texts) {
        frame.render_widget(Line::from(text.as_str()), row);
    }
}

fn heads(scene: &Scene<'_>) -> [String; 2] {
    let status = &scene.seen.status;
    let text = |it: Option<String>| it.unwrap_or_else(|| "-".to_owned());
    let who = match (scene.seen.peer, status.version) {
        (Some(peer), Some(version)) => format!("{peer} speaks {version}"),
        _ => "waiting for a controller".to_owned(),
    };
    let power = match status.has_power {
        Some(true) => "on",
        Some(false) => "off",
        None => "-",
    };
    [
        format!("{who}, at {}, {} s", scene.local, scene.elapsed.as_secs()),
        format!(
            "{}  quality {}  drives {power}  period {}",
            text(status.state.map(|it| it.to_string())),
            text(status.quality.map(|it| it.to_string())),
            text(status.period.map(|it| format!("{it:?}"))),
        ),
    ]
}

/// Figures of this side and, where the controller reports them, of its side.
fn figures(scene: &Scene<'_>) -> Table<'static> {
    let status = &scene.seen.status;
    let counters = status.counters;
    let times = |of: &Distribution| {
        let it = of.summary();
        [it.p50, it.p99, it.p999, it.max].map(|it| time(it.0))
    };
    let row = |name: &str, [a, b, c, d]: [String; 4]| Row::new([name.to_owned(), a, b, c, d]);
    let counts = |all: [u64; 4]| all.map(|it| it.to_string());
    let counted = status.statistics.map_or_else(
        || ["not reported", "", "", ""].map(str::to_owned),
        |it| {
            [
                format!("{:.3}", it.answer_rate),
                format!("{:.2} ms", it.latency_s * 1e3),
                format!("{:.2} ms", it.jitter_s * 1e3),
                it.missed.to_string(),
            ]
        },
    );
    let dim = |all: [&'static str; 5]| Row::new(all).style(Style::new().dim());
    let rows = vec![
        row("answered after", times(&scene.answer_time)),
        row("early or late", times(&scene.deviation)),
        dim(["", "received", "answered", "lost", "silences"]),
        row(
            "datagrams",
            counts([
                counters.received,
                counters.answered,
                counters.lost,
                counters.silences,
            ]),
        ),
        dim(["", "in time", "latency", "jitter", "missed"]),
        row("controller's view", counted),
    ];
    let header = dim(["", "p50", "p99", "p99.9", "max"]);
    Table::new(rows, [18, 12, 12, 12, 12]).header(header)
}

fn joints(seen: &Seen) -> Table<'static> {
    let status = &seen.status;
    let names = status.version.unwrap_or(Version::Lwr).joint_names();
    let row = |name: &'static str, values: Option<[f64; 7]>, scale: f64| {
        let cell = |value: f64| format!("{:.2}", value * scale);
        let values = values.map_or_else(
            || vec!["-".to_owned(); 7],
            |values| values.map(cell).to_vec(),
        );
        Row::new([vec![name.to_owned()], values].concat())
    };
    let degrees = 1.0_f64.to_degrees();
    let rows = [
        row("measured deg", status.measured, degrees),
        row("set-point deg", status.set_point, degrees),
        row("external Nm", status.external_torque, 1.0),
    ];
    let header = [vec![""], names.to_vec()].concat();
    let header = Row::new(header).style(Style::new().dim());
    Table::new(rows, [14, 8, 8, 8, 8, 8, 8, 8]).header(header)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use takt_fri::client::{AnswerStatistics, Counters, Phase, State, Status};
    use takt_fri::diagnosis::Observed;
    use takt_rt::Nanos;
    use takt_rt::stats::Recorder;

    fn screen(width: u16, height: u16, seen: &Seen, complaints: &[String]) -> String {
        let (mut answer_time, mut deviation) = (Recorder::new(), Recorder::new());
        for us in 20..120 {
            answer_time.record(Nanos::from_micros(us));
            deviation.record(Nanos::from_micros(us * 10));
        }
        let scene = Scene {
            seen,
            local: "0.0.0.0:49938".parse().unwrap(),
            elapsed: Duration::from_secs(12),
            answer_time: answer_time.reader().read(),
            deviation: deviation.reader().read(),
            verdict: takt_fri::diagnosis::judge(&Observed::default()),
            complaints,
        };
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, &scene)).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn screen_shows_state_figures_joints_and_times() {
        let status = Status {
            version: Some(Version::Lwr),
            phase: Phase::Command,
            state: Some(State::Lwr(takt_fri::lwr::wire::State::Cmd)),
            measured: Some([0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0]),
            statistics: Some(AnswerStatistics {
                answer_rate: 0.987,
                latency_s: 0.000_4,
                jitter_s: 0.000_1,
                missed: 33,
            }),
            counters: Counters {
                received: 12_000,
                lost: 17,
                ..Counters::default()
            },
            ..Status::default()
        };
        let seen = Seen {
            status,
            peer: Some("192.168.0.20:49152".parse().unwrap()),
            ..Seen::default()
        };
        let text = screen(84, 40, &seen, &["answers cannot leave".to_owned()]);
        for part in [
            "192.168.0.20:49152 speaks FRI 1.0 (LWR), at 0.0.0.0:49938, 12 s",
            "CMD  quality -  drives -",
            "12000",
            "17",
            "0.987",
            "0.40 ms",
            "E1",
            "-68.75",
            "answers by time",
            "early or late, us",
            "answers cannot leave",
            "verdict: no measurement received",
            "Ctrl-C",
        ] {
            assert!(text.contains(part), "{part} is missing:\n{text}");
        }
    }

    #[test]
    fn screen_of_one_cell_does_not_fail() {
        for (width, height) in [(1, 1), (10, 4), (300, 3)] {
            screen(width, height, &Seen::default(), &[]);
        }
        let text = screen(84, 40, &Seen::default(), &[]);
        assert!(text.contains("waiting for a controller"), "{text}");
    }
}
