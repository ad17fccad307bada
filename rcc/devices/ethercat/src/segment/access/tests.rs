//! Questions to a master that runs in a thread of its own, with an emulated segment.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use takt_ethercat::config::{Location, MasterConfig, SlaveSpec};
use takt_ethercat::emulator::{Coupler, Entry, Segment, ServoConfig, ServoDrive};

use super::super::wire_tests;
use super::*;

const MS: Duration = Duration::from_millis(1);

/// A coupler and a drive in OP, until the flag is set.
fn run(mut inspector: Inspector, config: MasterConfig, stop: &AtomicBool) {
    let (drive, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut segment = Segment::line([Coupler::slave(), drive]);
    let mut master = Master::new(config).unwrap();
    let mut now = Duration::from_secs(1);
    let mut was_cut = false;
    while !stop.load(Ordering::Relaxed) {
        let mut frame = [0; 1500];
        let len = master.poll_transmit(now, &mut frame).unwrap_or(0);
        let ns = u64::try_from(now.as_nanos()).unwrap();
        if len > 0
            && segment
                .process(&mut frame[..len], Entry::First, ns)
                .is_some()
        {
            master.handle_frame(0, &frame[..len], now);
        }
        now += MS;
        while master.poll_event().is_some() {}
        while let Some(reply) = master.poll_reply() {
            assert_eq!(inspector.handle_reply(reply), None);
        }
        inspector.cycle(&mut master, Nanos::from(now));
        if master.is_operational() && !was_cut {
            // One frame is lost.
            (segment.faults.lose, was_cut) = (1, true);
        }
        std::thread::yield_now();
    }
}

fn with_access(test: impl FnOnce(&Access)) {
    let config = wire_tests::config(
        "[[ethercat.slave]]\nname = 'coupler'\nposition = 0\n\
         [[ethercat.slave]]\nname = 'drive'\nposition = 1\n",
    );
    let at = |name: &str, position| SlaveSpec::new(name, Location::Position(position));
    let master = MasterConfig {
        slaves: vec![at("coupler", 0), at("drive", 1)],
        ..MasterConfig::default()
    };
    let (access, inspector) = pair(&config);
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    let driver = std::thread::spawn(move || run(inspector, master, &stopping));
    test(&access);
    stop.store(true, Ordering::Relaxed);
    driver.join().unwrap();
}

/// The report once the segment runs.
fn operational(access: &Access) -> Value {
    let reports = std::iter::repeat_with(|| access.report().unwrap());
    let mut running = reports.filter(|report| report["frames"]["lost"] == 1);
    running.next().unwrap()
}

#[test]
fn access_reports_and_reads_while_master_runs() {
    with_access(|access| {
        let report = operational(access);
        assert_eq!(report["segment"], access.name());
        assert_eq!(report["slaves"][1]["spec"], "drive");
        assert_eq!(report["slaves"][1]["name"], "TK4021 servo");
        assert!(report["frames"]["last_lost_ago_s"].is_f64(), "{report}");
        let vendor = BusRead::Object {
            index: 0x1018,
            sub: 1,
        };
        let bytes = access.read("drive", vendor).unwrap();
        assert_eq!(bytes, 0x7A87_u32.to_le_bytes());
        let state = BusRead::Register { at: 0x0130, len: 2 };
        assert_eq!(access.read("1", state).unwrap().len(), 2);
    });
}

#[test]
fn access_to_missing_object_or_slave_names_it() {
    with_access(|access| {
        operational(access);
        let object = BusRead::Object {
            index: 0x5FFF,
            sub: 0,
        };
        let refused = access.read("drive", object).unwrap_err().to_string();
        assert!(refused.contains("slave 1: the slave refuses"), "{refused}");
        let missing = access.read("gripper", object).unwrap_err();
        assert!(
            matches!(&missing, BusError::NoSuch(text) if text.contains("it has coupler, drive"))
        );
        let beyond = access.read("7", object).unwrap_err().to_string();
        assert!(beyond.contains("there is no slave 7"), "{beyond}");
    });
}

#[test]
fn access_to_silent_driver_fails_and_recovers() {
    let (access, mut inspector) = pair(&EthercatConfig::default());
    for _ in 0..2 * PENDING_MAX {
        let report = Box::new(Report::with_room(0));
        let asked = access.request(Duration::ZERO, |token| Letter::Report(token, report));
        assert!(asked.unwrap_err().to_string().contains("does not answer"));
    }
    let mut master = Master::new(MasterConfig::default()).unwrap();
    (0..PENDING_MAX).for_each(|_| inspector.cycle(&mut master, Nanos(0)));
    let stop = Arc::new(AtomicBool::new(false));
    let stopping = Arc::clone(&stop);
    let driver = std::thread::spawn(move || {
        while !stopping.load(Ordering::Relaxed) {
            inspector.cycle(&mut master, Nanos(0));
        }
    });
    access.report().unwrap();
    stop.store(true, Ordering::Relaxed);
    driver.join().unwrap();
}
