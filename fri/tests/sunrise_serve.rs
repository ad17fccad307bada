//! The served cabinet over real UDP on the loopback. It asserts what happens, never when.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;
use takt_fri::link::Link;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, CabinetStatus, Leave, Overlay, Program, Timing, serve,
};
use takt_fri::sunrise::wire::{Dialect, MESSAGE_MAX, SessionState};
use takt_fri::sunrise::{Demand, Phase, Session, SessionConfig};

const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
const PATIENCE: Duration = Duration::from_secs(20);

/// Answers until `done`, or panics when patience ends.
fn client(link: &mut UdpLink, session: &mut Session, mut done: impl FnMut(&Session) -> bool) {
    let end = monotonic().unwrap() + PATIENCE;
    let mut buf = [0; MESSAGE_MAX + 1];
    while !done(session) {
        assert!(monotonic().unwrap() < end, "{session:?}");
        let mut wait = Duration::from_millis(20);
        while let Some((len, at)) = link.receive(&mut buf, wait).unwrap() {
            session.handle_datagram(&buf[..len], at).unwrap();
            wait = Duration::ZERO;
        }
        if let Ok(answer) = session.answer(&Demand::Hold, &mut buf) {
            link.send(&buf[..answer.len]).unwrap();
        }
    }
}

/// Ends the served cabinet when an assertion fails, else the scope would wait for it for ever.
struct StopOnDrop<'a>(&'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_session_reaches_commanding_active_over_udp_and_the_knobs_work() {
    // Generous where a busy test machine is slow; the transitions are what is tested.
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
    let mut pc = UdpLink::bind(ANY).unwrap();
    let mut link = UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap();
    let (status, stop) = (Arc::new(CabinetStatus::new()), AtomicBool::new(false));
    let mut session = Session::new(SessionConfig {
        offline_after: 1_000,
        ..SessionConfig::default()
    });
    assert_eq!(status.state(), SessionState::Idle);
    thread::scope(|scope| {
        let served = scope.spawn(|| {
            let mut cabinet = Cabinet::new(config, monotonic().unwrap());
            serve(&mut cabinet, &mut link, &status, &stop).map(|()| cabinet.counters())
        });
        let _stops = StopOnDrop(&stop);
        let mut active = |session: &Session| {
            // The status follows the datagram by some microseconds.
            session.phase() == Phase::CommandingActive
                && status.state() == SessionState::CommandingActive
        };
        client(&mut pc, &mut session, &mut active);
        assert!(
            status
                .commanded()
                .iter()
                .all(|joint| (joint - 0.25).abs() < 1e-6)
        );
        assert_eq!(session.dialect(), Some(Dialect::V3));
        status.set_power(false);
        client(&mut pc, &mut session, |session| {
            session.phase() != Phase::CommandingActive
        });
        client(&mut pc, &mut session, |_| !status.has_power());
        assert_eq!(status.last_fall(), Some(Leave::Power));
        status.set_power(true);
        client(&mut pc, &mut session, &mut active);
        status.set_drop(1.0);
        client(&mut pc, &mut session, |_| status.falls() > 1);
        stop.store(true, Ordering::Relaxed);
        let counters = served.join().unwrap().unwrap();
        assert!(
            counters.answers > 5 && counters.sent >= counters.answers,
            "{counters:?}"
        );
        assert_eq!(status.answers(), counters.answers);
    });
}
