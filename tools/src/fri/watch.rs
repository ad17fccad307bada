//! A connection polled from outside of its thread: its state, and its faults, each reported once. It decides nothing.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use nix::errno::Errno;
use takt_fri::client::{ClientConfig, Phase, Version};
use takt_fri::silence;
use takt_fri::sunrise::wire::Dialect;
use takt_link::linux::host::{addresses, list};
use takt_rt::interface::{LinkFault, Medium, interface_of, local_address_to};

use super::live::{Live, Seen, Task};
use crate::jitter::Interrupt;
use crate::output::span;

/// How often the thread is polled.
pub(super) const POLL_EVERY: Duration = Duration::from_millis(100);
/// Time without a measurement after which packets are captured.
const WIRE_AFTER: Duration = Duration::from_millis(500);
/// Time without a measurement after which refused datagrams are reported.
const REFUSED_AFTER: Duration = Duration::from_millis(500);

/// Expected version of a controller, and how long to wait for it.
#[derive(Clone, Debug, Args)]
pub(super) struct Port {
    /// What the controller must speak, as the SDK of the robot's client does; by default any.
    #[arg(long, value_name = "VERSION", value_enum)]
    expect: Option<Expected>,
    /// How long to wait for a measurement before the cause is reported.
    #[arg(long, alias = "wait", value_name = "TIME", default_value = "3s", value_parser = span)]
    timeout: Duration,
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

/// A connection and what was reported of it.
pub(super) struct Watched {
    pub(super) live: Live,
    timeout: Duration,
    interrupt: Interrupt,
    /// The current time without measurements; `None` while they arrive.
    silence: Option<Silence>,
    reported: Vec<String>,
}

/// A time without measurements.
struct Silence {
    since: Instant,
    /// Datagrams refused before it began.
    refused: u64,
    watch: Option<silence::Watch>,
    is_reported: bool,
}

impl Silence {
    fn new(refused: u64) -> Self {
        Self {
            since: Instant::now(),
            refused,
            watch: None,
            is_reported: false,
        }
    }

    /// Why nothing arrives, once, after the timeout.
    fn poll(&mut self, seen: &Seen, listen: SocketAddr, timeout: Duration) -> Option<String> {
        let silent = self.since.elapsed();
        if silent >= WIRE_AFTER.min(timeout) && !self.is_reported {
            self.watch
                .get_or_insert_with(|| silence::Watch::new(listen))
                .poll();
        }
        let refusal = seen.status.last_error;
        let refusal = refusal.filter(|_| seen.status.counters.refused > self.refused);
        let due = refusal.map_or(timeout, |_| REFUSED_AFTER.min(timeout));
        if self.is_reported || silent < due {
            return None;
        }
        self.is_reported = true;
        let watch = self.watch.take();
        let watch = watch.unwrap_or_else(|| silence::Watch::new(listen));
        Some(watch.cause(refusal).to_string())
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
            timeout: port.timeout,
            silence: Some(Silence::new(0)),
            reported: Vec::new(),
        })
    }

    /// Waits for the next poll; whether the user wants to end.
    pub(super) fn pause(&mut self) -> bool {
        self.interrupt.wait(POLL_EVERY)
    }

    /// Its state, and faults that were not reported before.
    pub(super) fn look(&mut self) -> (Seen, Vec<String>) {
        let seen = self.live.seen();
        if seen.status.phase == Phase::Offline {
            let refused = seen.status.counters.refused;
            let silence = self.silence.get_or_insert_with(|| Silence::new(refused));
            let why = silence.poll(&seen, self.live.local, self.timeout);
            return (seen, why.into_iter().collect());
        }
        self.silence = None;
        let events: Vec<_> = faults(&seen)
            .into_iter()
            .filter(|fault| !self.reported.contains(fault))
            .collect();
        self.reported.extend(events.iter().cloned());
        (seen, events)
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
            "{second} sends measurements to this port too, beside {peer}\nhint: give each controller a port of its own"
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
            "answers to {ip} cannot leave, since this host has no route to it (it has {})\nhint: correct its netmask, or add \
             a route (`ip route`)",
            list(&addresses())
        ),
        Errno::EPERM | Errno::EACCES => format!(
            "this host's firewall forbids answers to {ip}\nhint: let it pass UDP to {peer} (`nft list ruleset`)"
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
    fn each_fault_has_cause_and_hint() {
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
            route.contains("no route to it") && route.contains("netmask"),
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
