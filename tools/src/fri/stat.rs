//! `takt fri stat`: which side of an FRI connection is late (network, host or controller) and what to do; as FRI client, or
//! from a recording. Figures and verdicts are those of `report`.

use std::collections::BTreeMap;
use std::net::{SocketAddr, SocketAddrV4};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use clap::Args;
use serde_json::json;
use takt_fri::capture::{Datagram, Decoded};
use takt_fri::client::{ClientConfig, Phase};
use takt_fri::diagnosis::{Observer, Timeline};

use super::live::Watch;
use super::recording::Recording;
use super::report::Connection;
use super::watch::{Port, Watched};
use crate::Verdict;
use crate::output::{complain, positive_span, say};

/// Connections that one recording may hold.
const CONNECTIONS_MAX: usize = 64;

/// Judge FRI connections: who is late, and what to do.
///
/// With --listen it is the FRI client itself: it answers so that the robot stays where its controller holds it, and
/// never commands motion. With --from it judges a recording, made at the host that runs the driver. Exit status: 0 all
/// connections are good; 1 one is not, or no measurement came; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt fri stat --listen 0.0.0.0:49938 --duration 1min
  tcpdump -i enp3s0 -w arm.pcap udp port 49938
  takt fri stat --from arm.pcap --json")]
pub(crate) struct Stat {
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
    /// How long to observe, from the first measurement on.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = positive_span, conflicts_with = "from")]
    duration: Duration,
    #[command(flatten)]
    port: Port,
    /// Print one JSON object instead of the report.
    #[arg(long)]
    json: bool,
    /// Print the verdicts only.
    #[arg(long, conflicts_with = "json")]
    quiet: bool,
}

/// The result: connections, and why there are none.
#[derive(Default)]
struct Findings {
    connections: Vec<Connection>,
    /// Datagrams that are not FRI.
    foreign: u64,
    /// FRI datagrams that are damaged.
    refused: u64,
    /// Datagrams that no session took.
    refusal: Option<String>,
    /// Why no measurement came.
    silence: Option<String>,
}

impl Stat {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let findings = match (&self.from, self.listen) {
            (Some(path), _) => recorded(path)?,
            (None, Some(listen)) => self.observe(listen)?,
            (None, None) => anyhow::bail!("neither --listen nor --from was given"),
        };
        if self.json {
            say(&findings.json().to_string())?;
        } else {
            for line in findings.lines(self.quiet) {
                say(&line)?;
            }
        }
        Ok(if findings.is_good() {
            Verdict::Good
        } else {
            Verdict::Failed
        })
    }

    /// Answers the controller for the duration; Ctrl-C ends it early and keeps what was observed.
    fn observe(&self, listen: SocketAddr) -> anyhow::Result<Findings> {
        let mut watched = Watched::start(&self.port, listen, ClientConfig::default(), Watch)?;
        if !self.quiet {
            complain(&format!(
                "waiting for a controller at {}",
                watched.live.local
            ));
        }
        let mut since: Option<Instant> = None;
        let mut findings = Findings::default();
        loop {
            let (seen, events) = watched.look();
            if seen.status.phase != Phase::Offline {
                since.get_or_insert_with(Instant::now);
            } else if since.is_none() && !events.is_empty() {
                findings.silence = events.into_iter().next();
                break;
            }
            let is_over = since.is_some_and(|since| since.elapsed() >= self.duration);
            if watched.pause() || is_over {
                break;
            }
        }
        let seen = watched.live.seen();
        let refused = seen.status.counters.refused;
        if let Some(why) = seen.status.last_error.filter(|_| since.is_some()) {
            findings.refusal = Some(format!("{refused} datagrams were refused, the last: {why}"));
        }
        if since.is_some() {
            let connection = Connection::of_live(&seen, &watched.live);
            findings.connections.push(connection);
        } else if findings.silence.is_none() {
            findings.silence = Some("no measurement came before the end".to_owned());
        }
        watched.live.stop()?;
        Ok(findings)
    }
}

/// Judges a recording.
fn recorded(path: &Path) -> anyhow::Result<Findings> {
    let mut recording = Recording::open(path)?;
    let mut seen = Recorded::default();
    while let Some(datagram) = recording.next()? {
        seen.handle_datagram(&datagram)?;
    }
    anyhow::ensure!(
        !seen.observers.is_empty(),
        "{}: no FRI datagram among {} others, {} damaged ones and {} packets without a whole one\n\
         hint: record whole packets (`tcpdump -s 0`) on the interface that the robot is on",
        path.display(),
        seen.foreign,
        seen.refused,
        recording.skipped()
    );
    Ok(Findings {
        foreign: seen.foreign,
        refused: seen.refused,
        connections: seen.connections(),
        ..Findings::default()
    })
}

/// What a recording holds.
#[derive(Default)]
struct Recorded {
    observers: BTreeMap<Endpoints, Observed>,
    foreign: u64,
    refused: u64,
}

/// A connection of a recording.
struct Observed {
    generation: &'static str,
    observer: Observer,
    timeline: Timeline,
}

/// The endpoints of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Endpoints {
    controller: SocketAddrV4,
    host: SocketAddrV4,
}

/// The connection that a datagram belongs to, and its FRI generation.
fn connection_of(datagram: &Datagram, decoded: &Decoded) -> Option<(Endpoints, &'static str)> {
    const LWR: &str = "FRI 1.0";
    const SUNRISE: &str = "FRI of Sunrise";
    let to_host = Endpoints {
        controller: datagram.from,
        host: datagram.to,
    };
    let from_host = Endpoints {
        controller: datagram.to,
        host: datagram.from,
    };
    match decoded {
        Decoded::LwrMeasurement(_) => Some((to_host, LWR)),
        Decoded::SunriseMonitoring { .. } => Some((to_host, SUNRISE)),
        Decoded::LwrCommand(_) => Some((from_host, LWR)),
        Decoded::SunriseCommand { .. } => Some((from_host, SUNRISE)),
        Decoded::Foreign { .. } | Decoded::Refused(_) => None,
    }
}

impl Recorded {
    fn handle_datagram(&mut self, datagram: &Datagram) -> anyhow::Result<()> {
        let decoded = Decoded::of(&datagram.bytes);
        let Some((endpoints, generation)) = connection_of(datagram, &decoded) else {
            let is_damaged = matches!(decoded, Decoded::Refused(_));
            self.refused += u64::from(is_damaged);
            self.foreign += u64::from(!is_damaged);
            return Ok(());
        };
        if !self.observers.contains_key(&endpoints) {
            anyhow::ensure!(
                self.observers.len() < CONNECTIONS_MAX,
                "the recording holds more than {CONNECTIONS_MAX} connections\nhint: keep one robot's with `tcpdump -r FILE -w ONE udp port PORT`"
            );
            let observer =
                Observer::of(&decoded).context("an FRI datagram without a generation")?;
            let observed = Observed {
                generation,
                timeline: Timeline::new(&observer),
                observer,
            };
            self.observers.insert(endpoints, observed);
        }
        if let Some(observed) = self.observers.get_mut(&endpoints) {
            observed.observer.handle_datagram(datagram);
            observed.timeline.handle_datagram(datagram);
        }
        Ok(())
    }

    fn connections(&self) -> Vec<Connection> {
        let all = self.observers.iter();
        let connection = |(endpoints, observed): (&Endpoints, &Observed)| Connection {
            controller: endpoints.controller.to_string(),
            host: endpoints.host.to_string(),
            generation: observed.generation.to_owned(),
            observed: observed.observer.observed(),
            live: None,
            timeline: Some(observed.timeline.clone()),
        };
        all.map(connection).collect()
    }
}

impl Findings {
    fn is_good(&self) -> bool {
        self.silence.is_none() && self.connections.iter().all(Connection::is_good)
    }

    fn lines(&self, is_quiet: bool) -> Vec<String> {
        let connections = self.connections.iter();
        let mut lines: Vec<_> = connections.flat_map(|it| it.lines(is_quiet)).collect();
        lines.extend(self.silence.clone());
        lines.extend(self.refusal.clone().filter(|_| !is_quiet));
        if !is_quiet && self.foreign + self.refused > 0 {
            let (foreign, refused) = (self.foreign, self.refused);
            lines.push(format!(
                "{foreign} datagrams are not FRI, {refused} are damaged"
            ));
        }
        lines
    }

    fn json(&self) -> serde_json::Value {
        let connections = self.connections.iter().map(Connection::json);
        json!({
            "version": 1,
            "good": self.is_good(),
            "connections": connections.collect::<Vec<_>>(),
            "silence": self.silence,
            "refused": self.refusal,
            "rt_allocations": takt_rt::alloc::real_time_allocations(),
            "foreign": self.foreign,
            "damaged": self.refused,
        })
    }
}
