//! `takt fri stat`: who is late on an FRI connection, the network, this host or the controller, and what to do. Figures
//! and judgement are those of `takt_fri::diagnosis`.

use std::collections::BTreeMap;
use std::net::SocketAddrV4;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use serde_json::{Value, json};
use takt_fri::capture::{Datagram, Decoded};
use takt_fri::diagnosis::Observer;

use super::recording::Recording;
use crate::Verdict;
use crate::output::say;

/// Connections that one recording may hold.
const CONNECTIONS_MAX: usize = 64;

/// Judge the FRI connections of a recording: who is late, and what to do.
///
/// Record at the host that runs the driver: answers count from when a measurement came there. Exit status: 0 all
/// connections are good; 1 one is not; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  tcpdump -i enp3s0 -w arm.pcap udp port 49938
  takt fri stat --from arm.pcap
  takt fri stat --from arm.pcap --json")]
pub(crate) struct Stat {
    /// The recording: pcap or pcapng.
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// Print the verdicts only.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
}

/// What a recording holds.
#[derive(Default)]
struct Seen {
    connections: BTreeMap<Ends, Connection>,
    /// Datagrams that are not FRI.
    foreign: u64,
    /// FRI datagrams that are damaged.
    refused: u64,
}

/// Who talks to whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Ends {
    controller: SocketAddrV4,
    host: SocketAddrV4,
}

struct Connection {
    generation: &'static str,
    observer: Observer,
}

impl Stat {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let mut recording = Recording::open(&self.from)?;
        let mut seen = Seen::default();
        while let Some(datagram) = recording.next()? {
            seen.handle_datagram(&datagram)?;
        }
        anyhow::ensure!(
            !seen.connections.is_empty(),
            "{}: no FRI datagram among {} others and {} damaged ones; record on the interface that the robot is on",
            self.from.display(),
            seen.foreign,
            seen.refused
        );
        if self.json {
            say(&seen.json().to_string())?;
        } else {
            for line in seen.lines(self.quiet) {
                say(&line)?;
            }
        }
        Ok(if seen.is_good() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }
}

/// The ends of the connection that a datagram belongs to, and its generation.
fn place(datagram: &Datagram, decoded: &Decoded) -> Option<(Ends, &'static str)> {
    const LWR: &str = "FRI 1.0";
    const SUNRISE: &str = "FRI of Sunrise";
    let hither = Ends {
        controller: datagram.from,
        host: datagram.to,
    };
    let thither = Ends {
        controller: datagram.to,
        host: datagram.from,
    };
    match decoded {
        Decoded::LwrMeasurement(_) => Some((hither, LWR)),
        Decoded::SunriseMonitoring { .. } => Some((hither, SUNRISE)),
        Decoded::LwrCommand(_) => Some((thither, LWR)),
        Decoded::SunriseCommand { .. } => Some((thither, SUNRISE)),
        Decoded::Foreign { .. } | Decoded::Refused(_) => None,
    }
}

impl Seen {
    fn handle_datagram(&mut self, datagram: &Datagram) -> anyhow::Result<()> {
        let decoded = Decoded::of(&datagram.bytes);
        let Some((ends, generation)) = place(datagram, &decoded) else {
            let is_damaged = matches!(decoded, Decoded::Refused(_));
            self.refused += u64::from(is_damaged);
            self.foreign += u64::from(!is_damaged);
            return Ok(());
        };
        if !self.connections.contains_key(&ends) {
            anyhow::ensure!(
                self.connections.len() < CONNECTIONS_MAX,
                "the recording holds more than {CONNECTIONS_MAX} connections; keep one robot's with `tcpdump -r FILE -w ONE udp port PORT`"
            );
            let observer =
                Observer::of(&decoded).context("an FRI datagram without a generation")?;
            let connection = Connection {
                generation,
                observer,
            };
            self.connections.insert(ends, connection);
        }
        if let Some(connection) = self.connections.get_mut(&ends) {
            connection.observer.handle_datagram(datagram);
        }
        Ok(())
    }

    fn is_good(&self) -> bool {
        let mut all = self.connections.values();
        all.all(|connection| connection.observer.verdict().is_good())
    }

    fn lines(&self, is_quiet: bool) -> Vec<String> {
        let mut lines = Vec::new();
        for (ends, connection) in &self.connections {
            if !is_quiet {
                lines.extend(connection.figures(ends));
            }
            let verdict = connection.observer.verdict();
            let Ends { controller, host } = ends;
            lines.push(format!("{controller} > {host}: {verdict}"));
            if !verdict.is_good() {
                lines.push(format!("  {}", verdict.remedy()));
            }
        }
        if !is_quiet && self.foreign + self.refused > 0 {
            let (foreign, refused) = (self.foreign, self.refused);
            lines.push(format!(
                "{foreign} datagrams are not FRI, {refused} are damaged"
            ));
        }
        lines
    }

    fn json(&self) -> Value {
        let connections = self.connections.iter();
        let connections = connections.map(|(ends, connection)| connection.json(ends));
        json!({
            "version": 1,
            "good": self.is_good(),
            "connections": connections.collect::<Vec<_>>(),
            "foreign": self.foreign,
            "damaged": self.refused,
        })
    }
}

fn us(span: Duration) -> f64 {
    span.as_secs_f64() * 1e6
}

impl Connection {
    fn figures(&self, ends: &Ends) -> Vec<String> {
        let seen = self.observer.observed();
        let stamps = seen.stamp_jitter;
        let stamps = stamps.map_or_else(|| "unknown".to_owned(), |it| format!("{it:.1?}"));
        let rate = seen.answer_rate;
        let rate = rate.map_or_else(|| "not told".to_owned(), |it| format!("{it:.3}"));
        vec![
            format!(
                "{} from {} to {}, period {:?}",
                self.generation, ends.controller, ends.host, seen.period
            ),
            format!(
                "  measurements  {}, lost {}, out of order {}, restarts {}",
                seen.measurements, seen.lost, seen.disordered, seen.restarts
            ),
            format!(
                "  answers       {}, late {}, the worst after {:.1?}; in time as the controller counts: {rate}",
                seen.answers, seen.late, seen.answer_time_max
            ),
            format!(
                "  jitter        {:.1?} on arrival, {stamps} by the controller's stamps",
                seen.arrival_jitter
            ),
        ]
    }

    fn json(&self, ends: &Ends) -> Value {
        let seen = self.observer.observed();
        let verdict = self.observer.verdict();
        json!({
            "controller": ends.controller.to_string(),
            "host": ends.host.to_string(),
            "generation": self.generation,
            "period_us": us(seen.period),
            "measurements": seen.measurements,
            "lost": seen.lost,
            "disordered": seen.disordered,
            "restarts": seen.restarts,
            "answers": seen.answers,
            "late": seen.late,
            "answer_time_max_us": us(seen.answer_time_max),
            "arrival_jitter_us": us(seen.arrival_jitter),
            "stamp_jitter_us": seen.stamp_jitter.map(us),
            "answer_rate": seen.answer_rate,
            "good": verdict.is_good(),
            "verdict": verdict.to_string(),
            "remedy": verdict.remedy(),
        })
    }
}
