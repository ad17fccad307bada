//! Session and emulated controller against each other over the in-process link, in virtual time with seeded faults.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;
use takt_fri::link::{Link, Memory, pair};
use takt_fri::lwr::emulator::{
    ExitReason, Faults, Krc, KrcConfig, LineFaults, PowerOff, Script, Timing,
};
use takt_fri::lwr::wire::{Cmd, Msr, Quality, State};
use takt_fri::lwr::{AXES, Event, Session, SessionConfig};

const PERIOD: Duration = Duration::from_millis(2);
const START: Duration = Duration::from_secs(100);

/// A client that swings joints A1 and E1 by 0.2 rad while in command mode, and a controller.
struct Pair {
    krc: Krc,
    session: Session,
    krc_end: Memory,
    pc_end: Memory,
    now: Duration,
    started: Option<(Duration, [f64; AXES])>,
    events: Vec<Event>,
    qualities: Vec<Quality>,
}

impl Pair {
    fn new(config: KrcConfig) -> Self {
        let (krc_end, pc_end) = pair();
        Self {
            krc: Krc::new(config, START),
            session: Session::new(SessionConfig::default()),
            krc_end,
            pc_end,
            now: START,
            started: None,
            events: Vec::new(),
            qualities: Vec::new(),
        }
    }

    fn with(to_client: LineFaults, to_krc: LineFaults) -> Self {
        let faults = Faults {
            to_client,
            to_krc,
            ..Faults::default()
        };
        Self::new(KrcConfig {
            faults,
            ..KrcConfig::default()
        })
    }

    /// In command mode, with the faults `line` in both directions from then on.
    fn commanding_then(line: LineFaults) -> Self {
        let mut pair = Self::new(KrcConfig::default());
        pair.run(200);
        assert!(pair.session.is_commanding());
        let faults = Faults {
            to_client: line,
            to_krc: line,
            ..Faults::default()
        };
        *pair.krc.faults_mut() = faults;
        pair
    }

    /// Runs for `cycles` periods of the controller.
    fn run(&mut self, cycles: u32) -> &mut Self {
        let end = self.now + PERIOD * cycles;
        while self.krc.poll_timeout() <= end {
            self.now = self.krc.poll_timeout();
            self.step();
        }
        self
    }

    fn step(&mut self) {
        let mut buf = [0; Msr::LEN];
        self.pc_end.set_now(self.now);
        self.krc_end.set_now(self.now);
        while let Some(len) = self.krc.poll_transmit(self.now, &mut buf) {
            self.krc_end.send(&buf[..len]).unwrap();
        }
        self.session.handle_timeout(self.now);
        while let Some((len, at)) = self.pc_end.receive(&mut buf, Duration::ZERO).unwrap() {
            let reception = self.session.handle_datagram(&buf[..len], at).unwrap();
            self.events.extend(reception.event);
            self.qualities.push(reception.quality);
        }
        let joints = self.joints();
        if let Ok(len) = self.session.answer(joints.as_ref(), &mut buf) {
            self.pc_end.send(&buf[..len]).unwrap();
        }
        while let Some((len, at)) = self.krc_end.receive(&mut buf, Duration::ZERO).unwrap() {
            self.krc.handle_datagram(&buf[..len], at).unwrap();
        }
    }

    fn joints(&mut self) -> Option<[f64; AXES]> {
        if !self.session.is_commanding() {
            self.started = None;
            return None;
        }
        let (since, mut joints) = *self
            .started
            .get_or_insert_with(|| (self.now, self.session.mirror()));
        let swing = 0.1 * (1.0 - (2.0 * (self.now - since).as_secs_f64()).cos());
        joints[0] += swing;
        joints[2] -= swing;
        Some(joints)
    }

    fn statistics(&self) -> takt_fri::lwr::wire::Statistics {
        self.session.measurement().unwrap().statistics
    }

    fn reasons(&self) -> Vec<String> {
        self.krc.log().map(|left| left.reason.to_string()).collect()
    }

    /// Asserts that command mode was entered once and never left.
    fn assert_commanding(&self) {
        assert_eq!(self.reasons(), Vec::<String>::new());
        assert!(self.session.is_commanding(), "{:?}", self.krc);
        assert_eq!(self.events, [Event::Online, Event::CommandEntered]);
    }

    fn qualities(&self, last: usize) -> Vec<Quality> {
        let mut seen = self.qualities[self.qualities.len() - last..].to_vec();
        seen.sort_by_key(|quality| quality.code());
        seen.dedup();
        seen
    }
}

fn lossy(drop: f64) -> LineFaults {
    LineFaults {
        drop,
        ..LineFaults::default()
    }
}

fn delayed(delay: Duration) -> LineFaults {
    LineFaults {
        delay,
        ..LineFaults::default()
    }
}

#[test]
fn lwr_good_line_perfect_quality_and_follows() {
    let mut pair = Pair::new(KrcConfig::default());
    pair.run(96);
    assert!(!pair.session.is_commanding());
    pair.run(5000).assert_commanding();
    assert_eq!(pair.qualities(4900), [Quality::Perfect]);
    assert_eq!(
        (pair.session.counters().lost, pair.krc.counters().missed),
        (0, 0)
    );
    let (commanded, measured) = (pair.session.mirror(), pair.krc.joints());
    for (commanded, measured) in commanded.iter().zip(measured) {
        assert!(
            (commanded - measured).abs() < 0.004,
            "{commanded} {measured}"
        );
    }
    assert!(pair.krc.log().next().is_none());
}

#[test]
fn lwr_1_percent_loss_keeps_command_mode() {
    let mut pair = Pair::with(lossy(0.01), lossy(0.01));
    pair.run(10_000).assert_commanding();
    assert!(pair.session.counters().lost > 50);
    assert!(pair.krc.counters().missed > 100);
    assert!(!pair.qualities(9_000).contains(&Quality::Unacceptable));
}

/// The documented outcome: 5 % of answers lost is a mean answer rate of 0.95, OK, and commanding continues.
#[test]
fn lwr_5_percent_answer_loss_is_quality_ok() {
    let mut pair = Pair::with(LineFaults::default(), lossy(0.05));
    pair.run(10_000).assert_commanding();
    let rest = &pair.qualities[1_000..];
    let ok = rest
        .iter()
        .filter(|quality| **quality == Quality::Ok)
        .count();
    assert!(ok * 2 > rest.len(), "OK in {ok} of {}", rest.len());
    let rate = 1.0 - f64::from(pair.krc.counters().missed) / 10_000.0;
    assert!((0.94..0.96).contains(&rate), "{rate}");
}

/// 5 % lost on each way is 0.9025: quality changes between OK and BAD, and commanding continues.
#[test]
fn lwr_5_percent_loss_each_way_keeps_command() {
    let mut pair = Pair::commanding_then(lossy(0.05));
    pair.run(10_000).assert_commanding();
    assert!(pair.session.counters().lost > 400);
    let seen = pair.qualities(9_000);
    assert!(
        seen.contains(&Quality::Bad) && seen.contains(&Quality::Ok),
        "{seen:?}"
    );
    assert!(!seen.contains(&Quality::Unacceptable));
}

#[test]
fn lwr_100_us_jitter_affects_statistics_only() {
    let line = LineFaults {
        jitter: Duration::from_micros(100),
        ..LineFaults::default()
    };
    let mut pair = Pair::with(line, line);
    pair.run(3_000).assert_commanding();
    assert_eq!(pair.qualities(2_800), [Quality::Perfect]);
    let statistics = pair.statistics();
    assert!(
        (80e-6..120e-6).contains(&statistics.latency_s),
        "{}",
        statistics.latency_s
    );
    assert!(
        (20e-6..60e-6).contains(&statistics.jitter_s),
        "{}",
        statistics.jitter_s
    );
}

#[test]
fn lwr_delay_beyond_one_cycle_is_late() {
    for (delay_us, latency_ms) in [(500, 1.0), (900, 1.8), (1_500, 3.0)] {
        let line = delayed(Duration::from_micros(delay_us));
        let mut pair = Pair::with(line, line);
        pair.run(3_000).assert_commanding();
        assert_eq!(pair.qualities(2_800), [Quality::Perfect]);
        assert!((pair.statistics().latency_s * 1e3 - latency_ms).abs() < 0.01);
    }
    let line = delayed(Duration::from_millis(3));
    let mut pair = Pair::with(line, line);
    pair.run(1_000);
    assert_eq!(pair.events, [Event::Online]);
    assert_eq!(pair.qualities(1_000 - 10), [Quality::Unacceptable]);
}

#[test]
fn lwr_reordering_and_duplicates_are_ignored() {
    for line in [
        LineFaults {
            reorder: 0.02,
            ..LineFaults::default()
        },
        LineFaults {
            duplicate: 0.2,
            ..LineFaults::default()
        },
        LineFaults {
            jitter: PERIOD * 3 / 2,
            ..LineFaults::default()
        },
    ] {
        let mut pair = Pair::commanding_then(line);
        pair.run(5_000).assert_commanding();
        assert!(
            pair.session.counters().old > 50,
            "{:?}",
            pair.session.counters()
        );
        assert!(pair.krc.counters().old > 50, "{:?}", pair.krc.counters());
    }
}

#[test]
fn lwr_power_loss_stops_following_until_return() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    let at = pair.now - START;
    pair.krc.faults_mut().power_off = Some(PowerOff {
        at,
        span: PERIOD * 400,
    });
    pair.run(300);
    assert!(!pair.session.is_commanding());
    let msr = *pair.session.measurement().unwrap();
    assert_eq!((msr.interface.state, msr.robot.power), (State::Cmd, 0));
    pair.run(1_000);
    assert!(pair.session.is_commanding());
    let last = [
        Event::CommandEntered,
        Event::CommandLeft,
        Event::CommandEntered,
    ];
    assert_eq!(pair.events[1..], last);
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn lwr_20_losses_end_command_script_restarts() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    pair.krc.faults_mut().to_krc.drop_next = 20;
    pair.run(30);
    assert_eq!(pair.reasons(), ["no answer for 10 cycles (20.0 ms)"]);
    assert!(!pair.session.is_commanding());
    pair.run(1_000);
    assert!(pair.session.is_commanding());
    assert_eq!(pair.reasons().len(), 1);
}

#[test]
fn lwr_9_losses_are_bridged_either_way() {
    for to_client in [true, false] {
        let mut pair = Pair::commanding_then(LineFaults::default());
        let faults = pair.krc.faults_mut();
        let line = if to_client {
            &mut faults.to_client
        } else {
            &mut faults.to_krc
        };
        line.drop_next = 9;
        pair.run(500).assert_commanding();
        assert_eq!(pair.session.counters().lost, if to_client { 9 } else { 0 });
    }
}

#[test]
fn lwr_controller_restart_is_commanded_again() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    let joints = pair.krc.joints();
    pair.krc = Krc::new(
        KrcConfig {
            joints,
            ..KrcConfig::default()
        },
        pair.now + PERIOD,
    );
    pair.run(300);
    assert_eq!(pair.session.counters().restarts, 1);
    let after = [
        Event::CommandEntered,
        Event::CommandLeft,
        Event::CommandEntered,
    ];
    assert_eq!(pair.events[1..], after);
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn lwr_client_restart_continues_without_jump() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    pair.session = Session::new(SessionConfig::default());
    pair.started = None;
    pair.run(300);
    assert!(pair.session.is_commanding());
    assert_eq!(pair.reasons(), Vec::<String>::new());
}

#[test]
fn lwr_silent_controller_goes_offline_and_returns() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    pair.krc.faults_mut().to_client.drop_next = 60;
    pair.run(70);
    assert_eq!(pair.session.counters().silences, 1);
    assert_eq!(pair.events.last(), Some(&Event::Online));
    pair.run(1_000);
    assert!(pair.session.is_commanding());
}

#[test]
fn lwr_forced_quality_ends_command_mode() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    pair.krc.faults_mut().quality = Some(Quality::Unacceptable);
    pair.run(2);
    assert!(matches!(
        pair.krc.log().next().unwrap().reason,
        ExitReason::Quality { .. }
    ));
    pair.krc.faults_mut().quality = Some(Quality::Bad);
    pair.run(1_000);
    assert_eq!(pair.krc.state(), State::Mon);
}

#[test]
fn lwr_thresholds_and_script_are_configurable() {
    let script = Script::Auto {
        quality: Quality::Ok,
        scale: 0.5,
        restart: None,
    };
    let timing = Timing {
        misses_max: 3,
        ..Timing::default()
    };
    let mut pair = Pair::new(KrcConfig {
        script,
        timing,
        ..KrcConfig::default()
    });
    pair.run(88);
    assert!(!pair.session.is_commanding());
    pair.run(3);
    assert!(pair.session.is_commanding());
    pair.krc.faults_mut().to_krc.drop_next = 3;
    pair.run(2_000);
    assert_eq!(pair.reasons(), ["no answer for 3 cycles (6.0 ms)"]);
    assert_eq!(pair.krc.state(), State::Mon);
}

#[test]
fn lwr_excessive_speed_names_joint() {
    let mut pair = Pair::commanding_then(LineFaults::default());
    let mut joints = pair.session.mirror();
    joints[4] += 0.01;
    let mut buf = [0; Msr::LEN];
    pair.now = pair.krc.poll_timeout();
    pair.krc.poll_transmit(pair.now, &mut buf).unwrap();
    pair.session.handle_datagram(&buf, pair.now).unwrap();
    let len = pair
        .session
        .answer(Some(&joints), &mut buf[..Cmd::LEN])
        .unwrap();
    pair.krc.handle_datagram(&buf[..len], pair.now).unwrap();
    pair.run(2);
    assert_eq!(
        pair.reasons(),
        ["A4 commanded 5.00 rad/s, limit 1.96 rad/s"]
    );
}
