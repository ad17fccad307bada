//! A connection watched from outside of its thread: how it stands, and what is to be said about it, each thing once. It
//! decides nothing.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use nix::errno::Errno;
use takt_fri::client::{ClientConfig, Phase, Version};
use takt_fri::sunrise::wire::Dialect;
use takt_rt::interface::{LinkFault, Medium, interface_of, local_address_to};

use super::live::{Live, Seen, Task};
use super::port::{addresses, is_taken, list};
use super::silence::Evidence;
use super::wire::{Wire, has_route};
use crate::jitter::Interrupt;
use crate::output::span;

/// How often the thread is looked at.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(100);
/// After so long without a measurement the wire is looked at.
const WIRE_AFTER: Duration = Duration::from_millis(500);
/// So soon is told what comes instead of measurements.
const REFUSED_AFTER: Duration = Duration::from_millis(500);

/// Where a controller's datagrams arrive, and what they are to be.
#[derive(Clone, Debug, Args)]
pub(super) struct Port {
    /// What the controller must speak, as the SDK of the robot's client does; by default any.
    #[arg(long, value_name = "VERSION", value_enum)]
    expect: Option<Expected>,
    /// So long without a measurement, it is said why.
    #[arg(long, value_name = "TIME", default_value = "3s", value_parser = span)]
    wait: Duration,
}

/// A version of FRI as the command line names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Expected(Version);

impl ValueEnum for Expected {
    fn value_variants<'a>() -> &'a [Self] {
        const fn sunrise(dialect: Dialect) -> Expected {
            Expected(Version::Sunrise(Some(dialect)))
        }
        const ALL: [Expected; 4] = [
            Expected(Version::Lwr),
            sunrise(Dialect::V1),
            sunrise(Dialect::V2),
            sunrise(Dialect::V3),
        ];
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self.0 {
            Version::Lwr => PossibleValue::new("lwr").help("FRI 1.0"),
            Version::Sunrise(Some(Dialect::V1)) => {
                PossibleValue::new("v1").help("Sunrise, 1.7 to 1.17")
            }
            Version::Sunrise(Some(Dialect::V2)) => {
                PossibleValue::new("v2").help("Sunrise, 2.0 to 2.5")
            }
            Version::Sunrise(Some(Dialect::V3) | None) => {
                PossibleValue::new("v3").help("Sunrise, 2.7, with length and checksum")
            }
        })
    }
}

/// A connection and who looks at it.
pub(super) struct Watched {
    pub(super) live: Live,
    wait: Duration,
    interrupt: Interrupt,
    /// Since when nothing comes; `None` while something does.
    silence: Option<Silence>,
    told: Vec<String>,
}

/// A time without measurements.
struct Silence {
    since: Instant,
    /// Datagrams refused before.
    refused: u64,
    evidence: Evidence,
    wire: Option<Wire>,
    is_told: bool,
}

impl Silence {
    fn new(refused: u64) -> Self {
        Self {
            since: Instant::now(),
            refused,
            evidence: Evidence::default(),
            wire: None,
            is_told: false,
        }
    }

    /// Why nothing comes, once, when patience is at its end.
    fn look(&mut self, seen: &Seen, listen: SocketAddr, patience: Duration) -> Option<String> {
        let silent = self.since.elapsed();
        if silent >= WIRE_AFTER.min(patience) {
            self.wire
                .get_or_insert_with(Wire::open)
                .look(&mut self.evidence);
        }
        let refusal = seen.status.last_error;
        let refusal = refusal.filter(|_| seen.status.counters.refused > self.refused);
        let due = refusal.map_or(patience, |_| REFUSED_AFTER.min(patience));
        if self.is_told || silent < due {
            return None;
        }
        self.is_told = true;
        let cause = self
            .evidence
            .judge(listen, refusal, addresses(), has_route, is_taken);
        Some(cause.to_string())
    }
}

impl Watched {
    /// Opens the port and starts the thread.
    pub(super) fn start(
        port: &Port,
        listen: SocketAddr,
        config: ClientConfig,
        task: impl Task,
    ) -> anyhow::Result<Self> {
        let expected = port.expect.map(|Expected(version)| version);
        let config = ClientConfig { expected, ..config };
        Ok(Self {
            interrupt: Interrupt::new()?,
            live: Live::start(listen, config, task)?,
            wait: port.wait,
            silence: Some(Silence::new(0)),
            told: Vec::new(),
        })
    }

    /// Waits a little; whether the user wants to end.
    pub(super) fn pause(&mut self) -> bool {
        self.interrupt.wait(LOOK_EVERY)
    }

    /// How it stands, and what is to be said.
    pub(super) fn look(&mut self) -> (Seen, Vec<String>) {
        let seen = self.live.seen();
        if seen.status.phase == Phase::Offline {
            let refused = seen.status.counters.refused;
            let silence = self.silence.get_or_insert_with(|| Silence::new(refused));
            let why = silence.look(&seen, self.live.local, self.wait);
            return (seen, why.into_iter().collect());
        }
        self.silence = None;
        let news: Vec<_> = faults(&seen)
            .into_iter()
            .filter(|fault| !self.told.contains(fault))
            .collect();
        self.told.extend(news.iter().cloned());
        (seen, news)
    }
}

/// What is wrong with a connection, beside its timing.
pub(super) fn faults(seen: &Seen) -> Vec<String> {
    let mut faults = Vec::new();
    if let (Some(errno), Some(peer)) = (seen.unsent, seen.peer) {
        faults.push(unsent(Errno::from_raw(errno), peer));
    }
    if let (Some(second), Some(peer)) = (seen.second, seen.peer) {
        faults.push(format!(
            "{second} sends measurements to this port too, beside {peer}: give each controller a port of its own"
        ));
    }
    faults
}

/// Why an answer cannot leave.
fn unsent(errno: Errno, peer: SocketAddr) -> String {
    let ip = peer.ip();
    #[expect(clippy::wildcard_enum_match_arm, reason = "some 130 other errors")]
    match errno {
        Errno::ENETUNREACH | Errno::EHOSTUNREACH => format!(
            "answers to {ip} cannot leave, since this host has no way there (it has {}): correct its netmask, or add \
             a route (`ip route`)",
            list(&addresses())
        ),
        Errno::EPERM | Errno::EACCES => format!(
            "this host's firewall forbids answers to {ip}: let it pass UDP to {peer} (`nft list ruleset`)"
        ),
        other => {
            let fault = LinkFault::of_errno(other as i32);
            let interface = local_address_to(ip).and_then(|own| interface_of(own).ok()?);
            let interface = interface.unwrap_or_else(|| "the interface".to_owned());
            format!(
                "answers to {ip} cannot leave: {}",
                fault.on(&interface, Medium::Ip)
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_is_one_sentence() {
        let peer: SocketAddr = "192.168.0.20:49152".parse().unwrap();
        let seen = Seen {
            peer: Some(peer),
            second: Some("192.168.0.21:49152".parse().unwrap()),
            unsent: Some(Errno::ENETUNREACH as i32),
            ..Seen::default()
        };
        let [route, second] = &faults(&seen)[..] else {
            panic!("two faults");
        };
        assert!(
            route.contains("no way there") && route.contains("netmask"),
            "{route}"
        );
        assert!(second.starts_with("192.168.0.21:49152 sends"), "{second}");
        assert!(unsent(Errno::EPERM, peer).contains("firewall"));
        let full = unsent(Errno::ENOBUFS, peer);
        assert!(
            full.contains("No buffer space") && full.contains("\nhint: "),
            "{full}"
        );
        assert!(faults(&Seen::default()).is_empty());
    }
}
