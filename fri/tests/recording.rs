//! From an emulated controller through a pcap file to a verdict: what tools do with a recording, in virtual time.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;
use takt_fri::capture::{Datagram, Decoded, Reader, Writer};
use takt_fri::diagnosis::{Change, Observer, Timeline, Verdict};
use takt_fri::lwr::emulator::{Krc, KrcConfig};
use takt_fri::lwr::wire::{Cmd, Msr};
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX};
use takt_fri::{lwr, sunrise};

const CONTROLLER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 31, 1, 147), 30200);
const HOST: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(172, 31, 1, 100), 30200);
const CYCLES: u32 = 1_500;
const SOON: Duration = Duration::from_micros(60);

/// A recording in memory.
struct Tape(Writer<Vec<u8>>);

impl Tape {
    fn new() -> Self {
        Self(Writer::new(Vec::new()).unwrap())
    }

    fn write(&mut self, at: Duration, is_answer: bool, bytes: &[u8]) {
        let (from, to) = if is_answer {
            (HOST, CONTROLLER)
        } else {
            (CONTROLLER, HOST)
        };
        let bytes = bytes.to_vec();
        let datagram = Datagram {
            at,
            from,
            to,
            bytes,
        };
        self.0.write(&datagram).unwrap();
    }

    fn datagrams(self) -> Vec<Datagram> {
        let file = self.0.into_inner();
        let datagrams = Reader::new(&file[..]).unwrap();
        datagrams.map(Result::unwrap).collect()
    }

    fn verdict(self) -> Verdict {
        let datagrams = self.datagrams();
        let first = Decoded::of(&datagrams[0].bytes);
        let mut observer = Observer::of(&first).unwrap();
        for datagram in &datagrams {
            observer.handle_datagram(datagram);
        }
        observer.verdict()
    }

    /// Changes of state and quality, without their times.
    fn timeline(self) -> Vec<String> {
        let datagrams = self.datagrams();
        let first = Decoded::of(&datagrams[0].bytes);
        let mut timeline = Timeline::new(&Observer::of(&first).unwrap());
        for datagram in &datagrams {
            timeline.handle_datagram(datagram);
        }
        assert_eq!(timeline.omitted(), 0);
        timeline.changes().iter().map(Change::to_string).collect()
    }
}

/// Answers after `delay` of the cycle number; `reaches` decides which answers arrive.
fn sunrise_tape(
    config: CabinetConfig,
    delay: impl Fn(u32) -> Duration,
    reaches: impl Fn(u32) -> bool,
) -> Tape {
    let mut cabinet = Cabinet::new(config, Duration::ZERO);
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let (mut tape, mut buf) = (Tape::new(), [0; MESSAGE_MAX]);
    for cycle in 0..CYCLES {
        let now = cabinet.poll_timeout();
        while let Some(len) = cabinet.poll_transmit(now, &mut buf) {
            tape.write(now, false, &buf[..len]);
            session.handle_datagram(&buf[..len], now).unwrap();
            let Ok(answer) = session.answer(&sunrise::Demand::Hold, &mut buf) else {
                continue;
            };
            let at = now + delay(cycle);
            tape.write(at, true, &buf[..answer.len]);
            if reaches(cycle) {
                cabinet.handle_datagram(&buf[..answer.len], at).unwrap();
            }
        }
    }
    tape
}

fn lwr_tape(config: KrcConfig, reaches: impl Fn(u32) -> bool) -> Tape {
    let mut krc = Krc::new(config, Duration::ZERO);
    let mut session = lwr::Session::new(lwr::SessionConfig::default());
    let (mut tape, mut msr, mut cmd) = (Tape::new(), [0; Msr::LEN], [0; Cmd::LEN]);
    for cycle in 0..CYCLES {
        let now = krc.poll_timeout();
        while krc.poll_transmit(now, &mut msr).is_some() {
            tape.write(now, false, &msr);
            session.handle_datagram(&msr, now).unwrap();
            let Ok(len) = session.answer(None, &mut cmd) else {
                continue;
            };
            tape.write(now + SOON, true, &cmd[..len]);
            if reaches(cycle) {
                krc.handle_datagram(&cmd[..len], now + SOON).unwrap();
            }
        }
    }
    tape
}

#[test]
fn recording_good_connection_has_good_verdict() {
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        let config = CabinetConfig {
            dialect,
            ..CabinetConfig::default()
        };
        assert_eq!(
            sunrise_tape(config, |_| SOON, |_| true).verdict(),
            Verdict::Good
        );
    }
    assert_eq!(
        lwr_tape(KrcConfig::default(), |_| true).verdict(),
        Verdict::Good
    );
}

#[test]
fn recording_late_host_is_found() {
    let late = Duration::from_micros(1_500);
    let delay = |cycle| if cycle % 20 == 3 { late } else { SOON };
    let verdict = sunrise_tape(CabinetConfig::default(), delay, |_| true).verdict();
    assert!(
        matches!(verdict, Verdict::Host { worst, .. } if worst == late),
        "{verdict}"
    );
}

#[test]
fn recording_inbound_loss_is_found() {
    let mut config = CabinetConfig::default();
    config.faults.to_client.drop = 0.03;
    let verdict = sunrise_tape(config, |_| SOON, |_| true).verdict();
    assert!(
        matches!(verdict, Verdict::NetworkInbound { .. }),
        "{verdict}"
    );
}

#[test]
fn recording_inbound_jitter_is_a_network_verdict() {
    let mut config = CabinetConfig::default();
    config.faults.to_client.jitter = Duration::from_micros(1_900);
    let verdict = sunrise_tape(config, |_| SOON, |_| true).verdict();
    assert!(
        matches!(verdict, Verdict::NetworkJitter { .. }),
        "{verdict}"
    );
}

#[test]
fn recording_outbound_loss_is_found_if_reported() {
    let verdict = lwr_tape(KrcConfig::default(), |cycle| cycle % 10 != 0).verdict();
    assert!(
        matches!(verdict, Verdict::NetworkOutbound { missing } if (missing - 0.1).abs() < 0.02),
        "{verdict}"
    );
    // Sunrise reports its quality only.
    let verdict =
        sunrise_tape(CabinetConfig::default(), |_| SOON, |cycle| cycle % 5 != 0).verdict();
    assert_eq!(verdict, Verdict::Unexplained);
}

#[test]
fn recording_timeline_names_reasons() {
    // From the 1000th cycle on, no answer reaches the cabinet.
    let tape = sunrise_tape(CabinetConfig::default(), |_| SOON, |cycle| cycle < 1_000);
    let timeline = tape.timeline();
    assert_eq!(
        timeline[0], "MONITORING_WAIT, quality POOR",
        "{timeline:#?}"
    );
    let says = |text: &str| timeline.iter().any(|line| line.starts_with(text));
    assert!(says("MONITORING_READY, quality GOOD"), "{timeline:#?}");
    assert!(
        says("COMMANDING_ACTIVE, quality EXCELLENT"),
        "{timeline:#?}"
    );
    let last = timeline.last().unwrap();
    assert!(
        last.starts_with("MONITORING_WAIT, quality POOR: "),
        "{timeline:#?}"
    );
    let ended = "the robot program ended it, or the controller rejected a command";
    assert!(
        timeline.iter().any(|line| line.ends_with(ended)),
        "{timeline:#?}"
    );
}

#[test]
fn recording_of_deaf_cabinet_has_not_received_verdict() {
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        let config = CabinetConfig {
            dialect,
            ..CabinetConfig::default()
        };
        let tape = sunrise_tape(config, |_| SOON, |_| false);
        assert_eq!(tape.verdict(), Verdict::NotReceived);
    }
    let tape = lwr_tape(KrcConfig::default(), |_| false);
    assert_eq!(tape.verdict(), Verdict::NotReceived);
}

#[test]
fn recording_multiplier_counts_late_answers() {
    let config = || CabinetConfig {
        receive_multiplier: 5,
        ..CabinetConfig::default()
    };
    assert_eq!(
        sunrise_tape(config(), |_| SOON, |_| true).verdict(),
        Verdict::Good
    );
    let late = |cycle: u32| {
        let is_late = cycle.is_multiple_of(2);
        if is_late {
            Duration::from_millis(7)
        } else {
            SOON
        }
    };
    let verdict = sunrise_tape(config(), late, |_| true).verdict();
    assert!(matches!(verdict, Verdict::Host { .. }), "{verdict}");
}
