//! `takt fri monitor`: a live connection, as FRI client, or each datagram of a recording in one line. Verdicts are those of
//! `takt fri stat`.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use takt_fri::capture::Decoded;
use takt_fri::client::{ClientConfig, Phase, Status};
use takt_fri::diagnosis::judge;
use takt_rt::stats::Summary;

use super::live::{Live, Seen, Watch};
use super::recording::Recording;
use super::report::Connection;
use super::view::{Scene, draw};
use super::watch::{Port, Watched};
use crate::Verdict;
use crate::output::{complain, positive_span, say};
use crate::screen::{Screen, is_end_wanted};

/// From one line to the next where there is no screen.
const LINE_EVERY: Duration = Duration::from_secs(1);
/// Complaints that the screen shows.
const COMPLAINTS_MAX: usize = 3;

/// Answer a robot as FRI client and show the state of the connection, or show the datagrams of a recording.
///
/// It answers every measurement and never commands motion: in command mode the robot is held where it is. On a terminal
/// it takes the screen; elsewhere it prints a line per second. Without measurements it reports the cause. At the end it
/// prints the verdict of `takt fri stat`. Exit status: 0 the connection is good; 1 it is not; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fri monitor --listen 0.0.0.0:49938
  takt fri monitor --listen 192.168.0.5:30200 --expect v1 --plain
  tcpdump -i enp3s0 -w arm.pcap udp port 49938
  takt fri monitor --from arm.pcap --count 20")]
pub(crate) struct Monitor {
    /// Where the controller's datagrams arrive.
    #[arg(
        long,
        value_name = "IP:PORT",
        required_unless_present = "from",
        conflicts_with = "from"
    )]
    listen: Option<SocketAddr>,
    /// Read a recording instead: pcap or pcapng.
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// End after so many lines.
    #[arg(long, value_name = "N")]
    count: Option<u64>,
    /// Show UDP datagrams of a recording that are not FRI, too.
    #[arg(long, requires = "from")]
    all: bool,
    /// End after this time; without it, at Ctrl-C.
    #[arg(long, value_name = "TIME", value_parser = positive_span, conflicts_with = "from")]
    duration: Option<Duration>,
    /// Print lines even on a terminal.
    #[arg(long, conflicts_with = "from")]
    plain: bool,
    #[command(flatten)]
    port: Port,
}

impl Monitor {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        match (&self.from, self.listen) {
            (Some(path), _) => self.show_recording(path),
            (None, Some(listen)) => self.watch(listen),
            (None, None) => anyhow::bail!("neither --listen nor --from was given"),
        }
    }

    fn show_recording(&self, path: &Path) -> anyhow::Result<Verdict> {
        let mut recording = Recording::open(path)?;
        let mut shown = 0;
        while self.count.is_none_or(|count| shown < count) {
            let Some(datagram) = recording.next()? else {
                break;
            };
            let is_foreign = matches!(Decoded::of(&datagram.bytes), Decoded::Foreign { .. });
            if self.all || !is_foreign {
                say(&datagram.to_string())?;
                shown += 1;
            }
        }
        Ok(Verdict::Good)
    }

    fn watch(&self, listen: SocketAddr) -> anyhow::Result<Verdict> {
        let mut watched = Watched::start(&self.port, listen, ClientConfig::default(), Watch)?;
        let shown = self.show(&mut watched);
        let seen = watched.live.seen();
        let connection = Connection::of_live(&seen, &watched.live);
        watched.live.stop()?;
        shown?;
        for line in connection.lines(true) {
            say(&line)?;
        }
        Ok(if connection.is_good() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    fn show(&self, watched: &mut Watched) -> anyhow::Result<()> {
        let started = Instant::now();
        let mut screen = Screen::open(!self.plain);
        let mut lines = Lines::new(started);
        let mut complaints: Vec<String> = Vec::new();
        if screen.is_none() {
            complain(&format!(
                "waiting for a controller at {}",
                watched.live.local
            ));
        }
        loop {
            let (seen, events) = watched.look();
            let is_end = if let Some(screen) = &mut screen {
                complaints.extend(events);
                if seen.status.phase != Phase::Offline
                    && seen.second.is_none()
                    && seen.unsent.is_none()
                {
                    complaints.clear();
                }
                let from = complaints.len().saturating_sub(COMPLAINTS_MAX);
                let scene = scene(&seen, &watched.live, &complaints[from..], started);
                screen.draw(|frame| draw(frame, &scene))?;
                is_end_wanted()?
            } else {
                for complaint in events {
                    complain(&complaint);
                }
                lines.print(&seen, &watched.live)?;
                self.count.is_some_and(|count| lines.count >= count)
            };
            let is_over = self.duration.is_some_and(|span| started.elapsed() >= span);
            if is_end || is_over || watched.pause() {
                return Ok(());
            }
        }
    }
}

fn scene<'a>(seen: &'a Seen, live: &Live, complaints: &'a [String], started: Instant) -> Scene<'a> {
    Scene {
        seen,
        local: live.local,
        elapsed: started.elapsed(),
        answer_time: live.answer_time.read(),
        deviation: live.deviation.read(),
        verdict: judge(&seen.observed),
        complaints,
    }
}

/// Prints changes of state and, every second, the figures.
struct Lines {
    started: Instant,
    /// Time of the last line, with the counts of received and answered datagrams then.
    last: (Instant, u64, u64),
    /// The state printed last.
    state: Option<String>,
    count: u64,
}

impl Lines {
    fn new(started: Instant) -> Self {
        Self {
            started,
            last: (started, 0, 0),
            state: None,
            count: 0,
        }
    }

    fn print(&mut self, seen: &Seen, live: &Live) -> anyhow::Result<()> {
        let status = &seen.status;
        let state = state_line(seen);
        if self.state.as_ref() != Some(&state) && status.version.is_some() {
            say(&state)?;
            self.state = Some(state);
        }
        let (at, received, answered) = self.last;
        if at.elapsed() < LINE_EVERY || status.phase == Phase::Offline {
            return Ok(());
        }
        let now = (
            Instant::now(),
            status.counters.received,
            status.counters.answered,
        );
        let span = now.0.duration_since(at);
        let rate = Rate::of(now.1 - received, now.2 - answered, span);
        let answer_time = live.answer_time.read().summary();
        let deviation = live.deviation.read().summary();
        say(&line(
            self.started.elapsed(),
            status,
            &rate,
            &answer_time,
            &deviation,
        ))?;
        if let Some(joints) = status.measured {
            say(&format!("         joints {} deg", degrees(&joints)))?;
        }
        self.count += 1;
        self.last = now;
        Ok(())
    }
}

/// Controller, version and state of the connection.
fn state_line(seen: &Seen) -> String {
    let status = &seen.status;
    let text = |it: Option<String>| it.unwrap_or_else(|| "?".to_owned());
    if status.phase == Phase::Offline {
        return "the controller is silent".to_owned();
    }
    let power = match status.has_power {
        Some(true) => "on",
        Some(false) => "off",
        None => "?",
    };
    format!(
        "{} speaks {}, period {:?}: {}, quality {}, drives {power}",
        text(seen.peer.map(|it| it.to_string())),
        text(status.version.map(|it| it.to_string())),
        status.period.unwrap_or_default(),
        text(status.state.map(|it| it.to_string())),
        text(status.quality.map(|it| it.to_string())),
    )
}

/// Rates of received and answered datagrams.
struct Rate {
    per_second: f64,
    /// Share of measurements that was answered, 0..=1.
    answered: f64,
}

impl Rate {
    #[expect(clippy::cast_precision_loss, reason = "thousands a second")]
    fn of(received: u64, answered: u64, span: Duration) -> Self {
        Self {
            per_second: received as f64 / span.as_secs_f64().max(1e-3),
            answered: answered as f64 / received.max(1) as f64,
        }
    }
}

fn line(
    elapsed: Duration,
    status: &Status,
    rate: &Rate,
    answer_time: &Summary,
    deviation: &Summary,
) -> String {
    let us = |time: takt_rt::Nanos| time.0 / 1000;
    let counted = status.statistics;
    let counted = counted.map_or_else(String::new, |it| format!(", in time {:.3}", it.answer_rate));
    format!(
        "{:>6} s {:>5.0}/s answered {:.3}{counted}, after us p50 {} p99 {} max {}, jitter us p50 {} p99 {}, lost {}",
        elapsed.as_secs(),
        rate.per_second,
        rate.answered,
        us(answer_time.p50),
        us(answer_time.p99),
        us(answer_time.max),
        us(deviation.p50),
        us(deviation.p99),
        status.counters.lost,
    )
}

/// Joint positions in degrees.
fn degrees(joints: &[f64]) -> String {
    let all: Vec<_> = joints
        .iter()
        .map(|joint| format!("{:.2}", joint.to_degrees()))
        .collect();
    all.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_fri::client::{AnswerStatistics, Quality, State, Version};
    use takt_fri::lwr::wire::{Quality as LwrQuality, State as LwrState};

    #[test]
    fn line_names_its_figures() {
        let status = Status {
            statistics: Some(AnswerStatistics {
                answer_rate: 0.99,
                latency_s: 0.0,
                jitter_s: 0.0,
                missed: 0,
            }),
            ..Status::default()
        };
        let rate = Rate::of(500, 490, Duration::from_secs(1));
        let times = Summary {
            p50: takt_rt::Nanos(31_000),
            p99: takt_rt::Nanos(52_000),
            max: takt_rt::Nanos(700_000),
            ..Summary::default()
        };
        let text = line(
            Duration::from_secs(7),
            &status,
            &rate,
            &times,
            &Summary::default(),
        );
        assert_eq!(
            text,
            "     7 s   500/s answered 0.980, in time 0.990, after us p50 31 p99 52 max 700, jitter us p50 0 p99 0, lost 0"
        );
        assert_eq!(degrees(&[0.0, std::f64::consts::FRAC_PI_2]), "0.00 90.00");
    }

    #[test]
    fn state_line_names_controller_version_and_state() {
        let mut seen = Seen {
            peer: Some("192.168.0.20:49152".parse().unwrap()),
            ..Seen::default()
        };
        assert_eq!(state_line(&seen), "the controller is silent");
        seen.status = Status {
            version: Some(Version::Lwr),
            phase: Phase::Monitor,
            state: Some(State::Lwr(LwrState::Mon)),
            quality: Some(Quality::Lwr(LwrQuality::Perfect)),
            has_power: Some(false),
            period: Some(Duration::from_millis(2)),
            ..Status::default()
        };
        assert_eq!(
            state_line(&seen),
            "192.168.0.20:49152 speaks FRI 1.0 (LWR), period 2ms: MON, quality PERFECT, drives off"
        );
    }
}
