//! The served controller over real UDP on the loopback. It asserts what happens, never when.
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
use takt_fri::lwr::emulator::{Krc, KrcConfig, KrcStatus, Leave, Script, Timing, serve};
use takt_fri::lwr::wire::{Msr, Quality, State};
use takt_fri::lwr::{Session, SessionConfig};

const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
const PATIENCE: Duration = Duration::from_secs(20);

/// Answers until `done`, or panics when patience ends.
fn client(link: &mut UdpLink, session: &mut Session, mut done: impl FnMut(&Session) -> bool) {
    let end = monotonic().unwrap() + PATIENCE;
    let mut buf = [0; Msr::LEN + 1];
    while !done(session) {
        assert!(monotonic().unwrap() < end, "{session:?}");
        let mut wait = Duration::from_millis(20);
        while let Some((len, at)) = link.receive(&mut buf, wait).unwrap() {
            session.handle_datagram(&buf[..len], at).unwrap();
            wait = Duration::ZERO;
        }
        if let Ok(len) = session.answer(None, &mut buf) {
            link.send(&buf[..len]).unwrap();
        }
    }
}

/// Ends the served controller when an assertion fails, else the scope would wait for it for ever.
struct StopOnDrop<'a>(&'a AtomicBool);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_session_reaches_command_mode_over_udp_and_the_knobs_work() {
    // Generous where a busy test machine is slow; the transitions are what is tested.
    let script = Script::Auto {
        quality: Quality::Bad,
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
    let mut pc = UdpLink::bind(ANY).unwrap();
    let mut link = UdpLink::connect(ANY, pc.local_addr().unwrap()).unwrap();
    let (status, stop) = (Arc::new(KrcStatus::new()), AtomicBool::new(false));
    let mut session = Session::new(SessionConfig {
        offline_after: 1_000,
        ..SessionConfig::default()
    });
    assert_eq!(status.state(), State::Off);
    thread::scope(|scope| {
        let served = scope.spawn(|| {
            let mut krc = Krc::new(config, monotonic().unwrap());
            serve(&mut krc, &mut link, &status, &stop).map(|()| krc.counters())
        });
        let _stops = StopOnDrop(&stop);
        let mut show = |session: &Session| {
            // The status follows the datagram by some microseconds.
            session.is_commanding() && status.state() == State::Cmd && status.has_power()
        };
        client(&mut pc, &mut session, &mut show);
        assert!(
            status
                .commanded()
                .iter()
                .all(|joint| (joint - 0.25).abs() < 1e-6)
        );
        status.set_power(false);
        client(&mut pc, &mut session, |session| !session.is_commanding());
        status.set_power(true);
        client(&mut pc, &mut session, &mut show);
        status.set_drop(1.0);
        client(&mut pc, &mut session, |_| status.falls() > 0);
        assert!(matches!(
            status.last_fall(),
            Some(Leave::Misses { .. } | Leave::Quality { .. })
        ));
        stop.store(true, Ordering::Relaxed);
        let counters = served.join().unwrap().unwrap();
        assert!(
            counters.answers > 5 && counters.sent >= counters.answers,
            "{counters:?}"
        );
        assert_eq!(status.answers(), counters.answers);
    });
}
