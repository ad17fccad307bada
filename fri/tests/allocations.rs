//! Neither state machine allocates after its construction: 10,000 cycles under a counting allocator.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;
use takt_fri::lwr::emulator::{ControllerCounters, Faults, Krc, KrcConfig, LineFaults};
use takt_fri::lwr::wire::{Cmd, Msr};
use takt_fri::lwr::{Session, SessionConfig};
use takt_fri::sunrise;
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, Contact, Control, Overlay, Program, Shape,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, MESSAGE_MAX};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

fn cycle(krc: &mut Krc, session: &mut Session) {
    let now = krc.poll_timeout();
    let (mut msr, mut cmd) = ([0; Msr::LEN], [0; Cmd::LEN]);
    while krc.poll_transmit(now, &mut msr).is_some() {
        session.handle_timeout(now);
        session.handle_datagram(&msr, now).unwrap();
        let mut joints = session.mirror();
        joints[0] += 1e-5;
        if let Ok(len) = session.answer(Some(&joints), &mut cmd) {
            krc.handle_datagram(&cmd[..len], now).unwrap();
        }
    }
    let _refused = krc.handle_datagram(&msr[..17], now);
}

#[test]
fn lwr_10000_faulty_cycles_allocate_nothing() {
    let line = LineFaults {
        drop: 0.02,
        duplicate: 0.02,
        reorder: 0.02,
        jitter: Duration::from_micros(300),
        ..LineFaults::default()
    };
    let faults = Faults {
        to_client: line,
        to_krc: line,
        ..Faults::default()
    };
    let mut krc = Krc::new(
        KrcConfig {
            faults,
            ..KrcConfig::default()
        },
        Duration::ZERO,
    );
    let mut session = Session::new(SessionConfig::default());
    let allocations = Allocations::count();
    for index in 0..10_000 {
        if index % 1_000 == 999 {
            krc.faults_mut().to_krc.drop_next = 15;
        }
        cycle(&mut krc, &mut session);
    }
    assert_eq!(allocations.end(), 0);
    assert_ne!(krc.counters(), ControllerCounters::default());
    assert!(krc.exits() > 0, "{krc:?}");
    assert!(session.counters().answered > 2_000, "{session:?}");
}

fn sunrise_cycle(cabinet: &mut Cabinet, session: &mut sunrise::Session) {
    let now = cabinet.poll_timeout();
    let mut buf = [0; MESSAGE_MAX];
    while let Some(len) = cabinet.poll_transmit(now, &mut buf) {
        session.handle_timeout(now);
        session.handle_datagram(&buf[..len], now).unwrap();
        let _refused = session.engage();
        let demand = sunrise::Demand::Wrench {
            wrench: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0],
            joints: None,
        };
        if let Ok(answer) = session.answer(&demand, &mut buf) {
            cabinet.handle_datagram(&buf[..answer.len], now).unwrap();
        }
    }
    let _refused = cabinet.handle_datagram(&buf[..17], now);
}

#[test]
fn sunrise_10000_faulty_cycles_allocate_nothing() {
    let control = Control::CartesianImpedance {
        stiffness: [1000.0, 1000.0, 1000.0, 100.0, 100.0, 100.0],
        damping: [0.7; 6],
    };
    let command = CommandMode::Wrench;
    let contact = Contact {
        shape: Shape::Spring,
        point: [0.5, 0.0, 0.5],
        normal: [0.0, 0.0, 1.0],
        stiffness: 500.0,
        damping: 5.0,
    };
    let line = LineFaults {
        drop: 0.02,
        duplicate: 0.02,
        reorder: 0.02,
        jitter: Duration::from_micros(300),
        ..LineFaults::default()
    };
    let mut config = CabinetConfig {
        dialect: Dialect::V3,
        contact: Some(contact),
        program: Program::Auto {
            overlay: Overlay { control, command },
            restart: Some(Duration::from_millis(100)),
        },
        ..CabinetConfig::default()
    };
    (config.faults.to_client, config.faults.to_cabinet) = (line, line);
    let mut cabinet = Cabinet::new(config, Duration::ZERO);
    let mut session = sunrise::Session::new(sunrise::SessionConfig::default());
    let allocations = Allocations::count();
    for index in 0..10_000 {
        if index % 1_000 == 999 {
            cabinet.faults_mut().to_cabinet.drop_next = 15;
        }
        sunrise_cycle(&mut cabinet, &mut session);
    }
    assert_eq!(allocations.end(), 0);
    assert!(cabinet.exits() > 0 && session.is_engaged(), "{cabinet:?}");
    assert!(session.counters().answered > 2_000, "{session:?}");
}
