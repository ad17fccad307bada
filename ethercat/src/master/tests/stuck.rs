//! Conditions that could block the start or recovery of a segment: a slave that is missing, refuses or falls at the
//! wrong moment must not block others, and failures are reported.

use takt_cia402::dictionary::Address as Object;

use super::*;
use crate::coe::Whole;
use crate::config::{ClockConfig, StartupSdo, SyncSpec, Unlocked};
use crate::emulator::{ServoConfig, ServoDrive, Slave};
use crate::{AlState, AlStatusCode};

const CYCLE: Duration = Duration::from_millis(1);

fn drive() -> Slave {
    ServoDrive::slave(ServoConfig::default()).unwrap().0
}

fn axis(position: u16) -> SlaveSpec {
    SlaveSpec {
        sync: Some(SyncSpec::sync0(CYCLE)),
        ..SlaveSpec::new(format!("axis {position}"), Location::Position(position))
    }
}

fn expecting(slaves: Vec<SlaveSpec>) -> MasterConfig {
    MasterConfig {
        slaves,
        ..MasterConfig::default()
    }
}

fn runs(slave: usize) -> impl Fn(&Master) -> bool {
    move |master| master.slave(slave).is_some_and(|slave| slave.is_running())
}

#[test]
fn segment_refused_is_rescanned_without_loss_event() {
    let mut rig = Rig::new(
        expecting(vec![axis(0), axis(1)]),
        Segment::line([drive(), drive()]),
    );
    rig.segment.set_power(1, false);
    rig.until(3000, |master| master.phase() == Phase::Refused);
    assert_eq!(rig.master.differences().len(), 1);
    rig.cycles(100);
    rig.master.restart();
    rig.until(3000, |master| master.phase() == Phase::Refused);
    rig.segment.set_power(1, true);
    rig.cycles(10);
    assert_eq!(rig.master.phase(), Phase::Refused);
    rig.master.restart();
    rig.until(8000, Master::is_operational);
    let lost = |event: &Event| matches!(event, Event::Fault { .. });
    assert!(!rig.events.iter().any(lost), "{:?}", rig.events);
}

#[test]
fn reference_clock_that_fails_blocks_no_slave() {
    let refused = SlaveSpec {
        startup: vec![StartupSdo::entry(Object::new(0x3000, 0), [0])],
        ..axis(0)
    };
    let mut rig = Rig::new(
        expecting(vec![refused, axis(1), axis(2)]),
        Segment::line([drive(), drive(), drive()]),
    );
    rig.until(8000, runs(1));
    rig.until(8000, runs(2));
    assert_eq!(rig.master.reference(), Some(1));
    assert!(rig.master.slave(1).unwrap().sync_start_ns().is_some());
    assert!(!rig.master.slave(0).unwrap().is_running());
}

#[test]
fn clock_kept_in_pre_op_is_no_reference() {
    let low = SlaveSpec {
        goal: AlState::PreOp,
        ..SlaveSpec::new("asked only", Location::Position(0))
    };
    let mut rig = Rig::new(
        expecting(vec![low, axis(1)]),
        Segment::line([drive(), drive()]),
    );
    rig.until(8000, Master::is_operational);
    assert_eq!(rig.master.reference(), Some(1));
}

#[test]
fn reference_lost_before_first_sample_is_replaced() {
    let mut segment = Segment::line([drive(), drive(), drive()]);
    segment.set_redundant(true);
    let config = MasterConfig {
        redundant: true,
        ..expecting((0..3).map(axis).collect())
    };
    let mut rig = Rig::new(config, segment);
    rig.until(8000, |master| master.phase() == Phase::Running);
    assert_eq!(rig.master.reference(), Some(0));
    rig.segment.set_power(0, false);
    rig.until(8000, runs(1));
    rig.until(8000, runs(2));
    assert_eq!(rig.master.reference(), Some(1));
    rig.segment.set_power(0, true);
    rig.until(8000, Master::is_operational);
}

#[test]
fn reference_lost_with_all_followers_next_returner_replaces() {
    let other = ServoConfig {
        product: 0x4022,
        ..ServoConfig::default()
    };
    let (other, _) = ServoDrive::slave(other).unwrap();
    let mut segment = Segment::line([drive(), other]);
    segment.set_redundant(true);
    let config = MasterConfig {
        redundant: true,
        ..expecting((0..2).map(axis).collect())
    };
    let mut rig = Rig::new(config, segment);
    rig.until(8000, Master::is_operational);
    rig.segment.set_power(0, false);
    rig.segment.set_power(1, false);
    rig.cycles(100);
    rig.segment.set_power(1, true);
    rig.until(8000, runs(1));
    assert_eq!(rig.master.reference(), Some(1));
}

#[test]
fn reference_clock_timeout_names_its_slave() {
    let clocks = ClockConfig {
        lock: Duration::ZERO,
        unlocked: Unlocked::Start,
        ..ClockConfig::default()
    };
    let slow = SlaveSpec {
        watchdog: Some(CYCLE * 100),
        ..axis(0)
    };
    let config = MasterConfig {
        clocks,
        ..expecting(vec![slow, axis(1)])
    };
    let mut rig = Rig::new(config, Segment::line([drive(), drive()]));
    rig.until(8000, Master::is_operational);
    let texts: Vec<_> = rig.events.iter().map(ToString::to_string).collect();
    let text = "slave 1: its clock waits for the reference clock, which is not running; see why slave 0 does not come up";
    assert!(texts.contains(&text.to_owned()), "{texts:?}");
}

#[test]
fn sii_job_ends_when_its_slave_falls() {
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([drive()]));
    rig.until(8000, Master::is_operational);
    let job = Job {
        slave: 0,
        kind: JobKind::ReadSii {
            word: 0,
            words: 128,
        },
        data: Vec::with_capacity(256),
        token: 5,
    };
    rig.master.submit(job).unwrap();
    rig.cycles(4);
    assert!(rig.master.poll_reply().is_none(), "it takes longer");
    rig.segment
        .slave(0)
        .unwrap()
        .fall(AlState::SafeOp, AlStatusCode(0x001A));
    rig.until(2000, |master| !master.is_operational());
    rig.until(2000, Master::is_operational);
    let reply = rig.master.poll_reply().unwrap();
    assert_eq!((reply.job.token, reply.result), (5, Err(JobError::Absent)));
}

/// A drive with such a mailbox beside 800 bytes of analogue channels, in OP.
fn crowded(mailbox: u16) -> Rig {
    let config = ServoConfig {
        mailbox,
        ..ServoConfig::default()
    };
    let (drive, _) = ServoDrive::slave(config).unwrap();
    let io = || Io::analogue(100, 100).0;
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([drive, io(), io()]));
    rig.until(8000, Master::is_operational);
    rig
}

fn device_type(rig: &mut Rig) -> Result<(), JobError> {
    let kind = JobKind::Upload {
        address: Object::new(0x1000, 0),
        whole: Whole::Entry,
    };
    let job = Job {
        slave: 0,
        kind,
        data: Vec::with_capacity(4),
        token: 0,
    };
    rig.master.submit(job).unwrap();
    for _ in 0..200 {
        rig.cycle();
        if let Some(reply) = rig.master.poll_reply() {
            return reply.result;
        }
    }
    panic!("no answer; {:?}", rig.events);
}

#[test]
fn mailbox_too_long_beside_image_reports_both_sizes() {
    let mut rig = crowded(512);
    assert_eq!(device_type(&mut rig), Ok(()));
    let mut rig = crowded(1024);
    let Err(JobError::MailboxTooLong {
        size: 1024,
        capacity,
    }) = device_type(&mut rig)
    else {
        panic!("it must be refused");
    };
    assert!((512..1024).contains(&capacity), "{capacity}");
    let texts: Vec<_> = rig.events.iter().map(ToString::to_string).collect();
    let text = format!(
        "its mailbox of 1024 bytes does not fit into a frame beside the process image, which leaves {capacity};"
    );
    assert!(texts.iter().any(|texts| texts.contains(&text)), "{texts:?}");
    // The reported size is exact: a datagram of that size still fits.
    let mut frame = [0; 1500];
    let len = rig.master.poll_transmit(rig.now, &mut frame).unwrap();
    let left = 1500 - len - 12;
    assert!(
        left <= capacity && capacity - left < 40,
        "{left} of {capacity}"
    );
}

#[test]
fn sync1_follows_sync0_by_its_delay() {
    let both = SlaveSpec {
        sync: Some(SyncSpec {
            assign_activate: SyncSpec::BOTH,
            sync1: Duration::from_micros(250),
            ..SyncSpec::sync0(CYCLE)
        }),
        ..axis(0)
    };
    let mut rig = Rig::new(expecting(vec![both]), Segment::line([drive()]));
    rig.until(8000, Master::is_operational);
    rig.cycles(200);
    let slave = rig.segment.slave(0).unwrap();
    let clock = slave.clock().unwrap();
    let (sync0, sync1) = (clock.next_sync0().unwrap(), clock.next_sync1().unwrap());
    assert_eq!((sync0 % 1_000_000, sync1 % 1_000_000), (0, 250_000));
}
