//! Files over FoE, BOOT, and slaves that are held in INIT.

use super::*;
use crate::AlStatusCode;
use crate::emulator::{Files, ServoConfig, ServoDrive, Slave};
use crate::foe::{FileName, FoeError};

/// Bytes of a packet in BOOT: the mailbox of 192 bytes without both headers.
const PACKET: usize = 192 - 12;

fn drive() -> Slave {
    let config = ServoConfig::default();
    ServoDrive::slave(config).unwrap().0.with_files()
}

/// A coupler in its usual state, and a drive with files in the given one.
fn held(slave: Slave, goal: AlState) -> (Rig, Option<Files>) {
    let files = slave.files();
    let at = |number, goal| SlaveSpec {
        goal,
        ..SlaveSpec::new(format!("{number}"), Location::Position(number))
    };
    let config = MasterConfig {
        slaves: vec![at(0, AlState::Op), at(1, goal)],
        goal: AlState::PreOp,
        ..MasterConfig::default()
    };
    (
        Rig::new(config, Segment::line([Coupler::slave(), slave])),
        files,
    )
}

/// A job of the drive.
const fn as_job(kind: JobKind, data: Vec<u8>) -> Job {
    Job {
        slave: 1,
        kind,
        data,
        token: 1,
    }
}

/// Runs a job of the drive to its end.
#[track_caller]
fn job(rig: &mut Rig, kind: JobKind, data: Vec<u8>) -> (Result<(), JobError>, Vec<u8>) {
    rig.master.submit(as_job(kind, data)).unwrap();
    for _ in 0..60_000 {
        rig.cycle();
        if let Some(reply) = rig.master.poll_reply() {
            return (reply.result, reply.job.data);
        }
    }
    panic!("no reply; {:?}", rig.events);
}

fn write(password: u32) -> JobKind {
    let name = FileName::new("fw.bin").unwrap();
    JobKind::WriteFile { name, password }
}

fn read(name: &str) -> JobKind {
    let name = FileName::new(name).unwrap();
    JobKind::ReadFile { name, password: 0 }
}

fn content(len: usize) -> Vec<u8> {
    (0..len).map(|at| u8::try_from(at % 251).unwrap()).collect()
}

#[test]
fn foe_files_of_any_length_are_written_and_read() {
    let (mut rig, files) = held(drive(), AlState::Boot);
    rig.until(3000, Master::is_operational);
    assert_eq!(rig.master.slave(1).unwrap().al().0.state, AlState::Boot);
    let files = files.unwrap();
    for (len, busy) in [(0, 0), (1, 3), (PACKET, 0), (2 * PACKET, 2), (5000, 0)] {
        files.lock().busy = busy;
        let data = content(len);
        let (result, _) = job(&mut rig, write(0), data.clone());
        assert_eq!(result, Ok(()), "{len}");
        assert_eq!(files.lock().files[&b"fw.bin"[..]], data, "{len}");
        let (result, found) = job(&mut rig, read("fw.bin"), Vec::with_capacity(len.max(1)));
        assert_eq!((result, found), (Ok(()), data), "{len}");
    }
}

#[test]
fn foe_transfers_survive_one_frame_lost_in_seven() {
    // Two in a row are the most that a slave survives without counting as lost.
    for lost in [1, 2] {
        let (mut rig, files) = held(drive(), AlState::Boot);
        rig.until(3000, Master::is_operational);
        let files = files.unwrap();
        let data = content(4000);
        let mut most = 0;
        let reply = rig.lossy(as_job(write(0), data.clone()), 7, lost, |master| {
            most = most.max(master.slave(1).unwrap().transferred().unwrap_or(0));
        });
        assert_eq!(reply.result, Ok(()), "{lost}");
        assert_eq!(files.lock().files[&b"fw.bin"[..]], data, "{lost}");
        assert!(most > 3000, "{most}");
        let buffer = Vec::with_capacity(data.len());
        let reply = rig.lossy(as_job(read("fw.bin"), buffer), 7, lost, |_| ());
        assert_eq!((reply.result, reply.job.data), (Ok(()), data), "{lost}");
    }
}

#[test]
fn foe_write_three_lost_frames_in_row_end_it() {
    let (mut rig, files) = held(drive(), AlState::Boot);
    rig.until(3000, Master::is_operational);
    let reply = rig.lossy(as_job(write(0), content(4000)), 30, 3, |_| ());
    assert_eq!(reply.result, Err(JobError::Absent));
    assert!(files.unwrap().lock().files.is_empty());
    rig.until(3000, Master::is_operational);
    assert_eq!(job(&mut rig, write(0), content(99)).0, Ok(()));
}

#[test]
fn foe_write_frames_without_census_keep_presence() {
    let (mut rig, files) = held(drive(), AlState::Boot);
    rig.until(3000, Master::is_operational);
    let data = content(4000);
    rig.master.submit(as_job(write(0), data.clone())).unwrap();
    // Many frames between two censuses; one of them in three is lost.
    let config = &mut rig.master.config;
    (config.cycle, config.frame_timeout) = (Duration::from_millis(5), Duration::from_micros(100));
    for _ in 0..60_000 {
        let mut frame = [0; 1500];
        let lost = rig.now < rig.master.next_census && rig.master.frames().sent.is_multiple_of(3);
        rig.segment.faults.lose = u32::from(lost);
        if let Some(len) = rig.master.poll_transmit(rig.now, &mut frame) {
            rig.exchange(&frame[..len]);
        }
        if rig.master.awaits_frame() {
            rig.now += rig.master.config().frame_timeout;
            rig.master.handle_timeout(rig.now);
        }
        rig.now += Duration::from_micros(200);
        if let Some(reply) = rig.master.poll_reply() {
            assert_eq!(reply.result, Ok(()));
            assert_eq!(files.unwrap().lock().files[&b"fw.bin"[..]], data);
            return;
        }
    }
    panic!("no reply");
}

#[test]
fn foe_refusals_carry_code_and_text() {
    let (mut rig, files) = held(drive(), AlState::Boot);
    rig.until(3000, Master::is_operational);
    let files = files.unwrap();
    let refused = |code| (Err(JobError::File(code)), b"emulated".to_vec());
    assert_eq!(
        job(&mut rig, write(5), content(99)),
        refused(FoeError::DENIED)
    );
    let missing = job(&mut rig, read("none"), Vec::with_capacity(99));
    assert_eq!(missing, refused(FoeError::NOT_FOUND));
    files.lock().capacity = 500;
    assert_eq!(
        job(&mut rig, write(0), content(501)),
        refused(FoeError::DISK_FULL)
    );
    assert_eq!(job(&mut rig, write(0), content(500)).0, Ok(()));
    let long = job(&mut rig, read("fw.bin"), Vec::with_capacity(499)).0;
    assert!(matches!(long, Err(JobError::TooLong { .. })), "{long:?}");
    let (mut rig, _) = held(drive(), AlState::PreOp);
    rig.until(3000, Master::is_operational);
    assert_eq!(
        job(&mut rig, write(0), content(99)),
        refused(FoeError::BOOT_ONLY)
    );
}

#[test]
fn slave_without_foe_refuses_boot_and_files() {
    let plain = ServoDrive::slave(ServoConfig::default()).unwrap().0;
    let (mut rig, _) = held(plain, AlState::Boot);
    let fault = |master: &Master| master.slave(1).and_then(|slave| slave.fault());
    rig.until(3000, |master| fault(master).is_some());
    let code = AlStatusCode(0x0013);
    let found = fault(&rig.master).unwrap();
    assert!(matches!(found, Fault::State { wanted: AlState::Boot, code: it, .. } if it == code));
    let plain = ServoDrive::slave(ServoConfig::default()).unwrap().0;
    let (mut rig, _) = held(plain, AlState::PreOp);
    rig.until(3000, Master::is_operational);
    let done = job(&mut rig, write(0), content(9)).0;
    assert_eq!(done, Err(JobError::Unsupported("FoE")));
}

#[test]
fn slave_held_in_init_leaves_others_running() {
    let (mut rig, _) = held(drive(), AlState::Init);
    rig.until(3000, Master::is_operational);
    rig.cycles(500);
    let state = |number| rig.master.slave(number).unwrap().al().0.state;
    assert_eq!([state(0), state(1)], [AlState::PreOp, AlState::Init]);
    let faults = rig
        .events
        .iter()
        .any(|it| matches!(it, Event::Fault { .. }));
    assert!(!faults, "{:?}", rig.events);
}
