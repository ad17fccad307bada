//! Served controllers of both generations over real UDP on the loopback. It asserts events, never times.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;
use takt_fri::client::{Client, ClientConfig, Phase, Version};
use takt_fri::link::Link;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::lwr::emulator::{self as lwr_emulator, Krc, KrcConfig, KrcStatus, Script};
use takt_fri::sunrise::emulator::{
    self, Cabinet, CabinetConfig, CabinetStatus, Overlay, Program, Timing,
};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX, SessionState};
use takt_fri::{lwr, sunrise};

const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
const TIMEOUT: Duration = Duration::from_secs(20);

/// A client that holds, and tolerates long stalls of a busy test machine.
struct TestClient {
    link: UdpLink,
    client: Client,
}

impl TestClient {
    fn new() -> Self {
        let offline_after = 1_000;
        let config = ClientConfig {
            lwr: lwr::SessionConfig {
                offline_after,
                ..lwr::SessionConfig::default()
            },
            sunrise: sunrise::SessionConfig {
                offline_after,
                ..sunrise::SessionConfig::default()
            },
            ..ClientConfig::default()
        };
        Self {
            link: UdpLink::bind(ANY).unwrap(),
            client: Client::new(config),
        }
    }

    /// Answers until `done`, or panics on timeout.
    fn until(&mut self, mut done: impl FnMut(&Client) -> bool) {
        let end = monotonic().unwrap() + TIMEOUT;
        let mut buf = [0; MESSAGE_MAX + 1];
        while !done(&self.client) {
            assert!(monotonic().unwrap() < end, "{:?}", self.client);
            let mut wait = Duration::from_millis(20);
            while let Some((len, at)) = self.link.receive(&mut buf, wait).unwrap() {
                self.client.handle_datagram(&buf[..len], at).unwrap();
                wait = Duration::ZERO;
            }
            if let Ok(answer) = self.client.answer(None, &mut buf) {
                self.link.send(&buf[..answer.len]).unwrap();
            }
        }
    }
}

/// Stops the served controller when an assertion fails; otherwise the scope would wait for ever.
struct StopOnDrop<'a>(&'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Measurements sent and answers taken by the controller that `serve` serves while a client goes through `steps`.
fn counted(
    serve: impl FnOnce(&mut UdpLink, &AtomicBool) -> io::Result<(u64, u64)> + Send,
    steps: impl FnOnce(&mut TestClient),
) -> (u64, u64) {
    let mut client = TestClient::new();
    let mut link = UdpLink::connect(ANY, client.link.local_addr().unwrap()).unwrap();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let served = scope.spawn(|| serve(&mut link, &stop));
        let stops = StopOnDrop(&stop);
        steps(&mut client);
        drop(stops);
        served.join().unwrap().unwrap()
    })
}

#[test]
fn serve_lwr_reaches_command_mode_over_udp() {
    // Generous for a busy test machine; the test is about transitions.
    let script = Script::Auto {
        quality: lwr::wire::Quality::Bad,
        scale: 1.0,
        restart: None,
    };
    let timing = Timing {
        bad_from: 0.05,
        misses_max: 1_000,
        ..Timing::default()
    };
    let config = KrcConfig {
        script,
        timing,
        joints: [0.25; 7],
        ..KrcConfig::default()
    };
    let status = KrcStatus::new();
    assert_eq!(status.state(), lwr::wire::State::Off);
    let serve = |link: &mut UdpLink, stop: &AtomicBool| {
        let mut krc = Krc::new(config, monotonic()?);
        lwr_emulator::serve(&mut krc, link, &status, stop)?;
        Ok((krc.counters().sent, krc.counters().answers))
    };
    let (sent, answers) = counted(serve, |client| {
        // The status follows the datagram by some microseconds.
        let commanding = |client: &Client| {
            let is_shown = status.state() == lwr::wire::State::Cmd && status.has_power();
            client.phase() == Phase::Command && is_shown
        };
        client.until(commanding);
        let at_rest = |joint: &f64| (joint - 0.25).abs() < 1e-6;
        assert!(status.commanded().iter().all(at_rest));
        status.set_power(false);
        client.until(|client| client.phase() != Phase::Command);
        status.set_power(true);
        client.until(commanding);
        status.set_drop(1.0);
        client.until(|_| status.exits() > 0);
        assert!(matches!(
            status.last_exit(),
            Some(
                lwr_emulator::ExitReason::Misses { .. } | lwr_emulator::ExitReason::Quality { .. }
            )
        ));
    });
    assert!(answers > 5 && sent >= answers, "{sent} {answers}");
    assert_eq!(status.answers(), answers);
}

#[test]
fn serve_sunrise_reaches_commanding_active_over_udp() {
    // As generous.
    let timing = Timing {
        bad_from: 0.02,
        ok_from: 0.05,
        misses_max: 1_000,
        ..Timing::default()
    };
    let config = CabinetConfig {
        timing,
        dialect: Dialect::V3,
        joints: [0.25; 7],
        program: Program::Auto {
            overlay: Overlay::default(),
            restart: Some(Duration::ZERO),
        },
        ..CabinetConfig::default()
    };
    let status = CabinetStatus::new();
    assert_eq!(status.state(), SessionState::Idle);
    let serve = |link: &mut UdpLink, stop: &AtomicBool| {
        let mut cabinet = Cabinet::new(config, monotonic()?);
        emulator::serve(&mut cabinet, link, &status, stop)?;
        Ok((cabinet.counters().sent, cabinet.counters().answers))
    };
    let (sent, answers) = counted(serve, |client| {
        let active = |client: &Client| {
            client.phase() == Phase::Command && status.state() == SessionState::CommandingActive
        };
        client.until(active);
        let at_rest = |joint: &f64| (joint - 0.25).abs() < 1e-6;
        assert!(status.commanded().iter().all(at_rest));
        let version = Version::Sunrise(Some(Dialect::V3));
        assert_eq!(client.client.version(), Some(version));
        status.set_power(false);
        client.until(|client| client.phase() != Phase::Command);
        client.until(|_| !status.has_power());
        assert_eq!(status.last_exit(), Some(emulator::ExitReason::Power));
        status.set_power(true);
        client.until(active);
        status.set_drop(1.0);
        client.until(|_| status.exits() > 1);
    });
    assert!(answers > 5 && sent >= answers, "{sent} {answers}");
    assert_eq!(status.answers(), answers);
}
