//! Objects over CoE while process data runs, and mailbox faults.

use takt_cia402::dictionary::{AbortCode, Address};

use super::*;
use crate::coe::Whole;
use crate::emulator::{ServoConfig, ServoDrive};
use crate::{Emergency, Frame, register};

/// A drive in OP.
fn running() -> (Rig, ServoDrive) {
    let (slave, drive) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([slave]));
    rig.until(5000, Master::is_operational);
    (rig, drive)
}

impl Rig {
    /// Runs a job to its end.
    #[track_caller]
    fn job(&mut self, kind: JobKind, data: Vec<u8>) -> Reply {
        self.master
            .submit(Job {
                slave: 0,
                kind,
                data,
                token: 7,
            })
            .unwrap();
        for _ in 0..6000 {
            self.cycle();
            if let Some(reply) = self.master.poll_reply() {
                assert_eq!(reply.job.token, 7);
                return reply;
            }
        }
        panic!("no reply; {:?}", self.events);
    }

    fn upload(&mut self, index: u16, sub: u8, capacity: usize) -> (Result<(), JobError>, Vec<u8>) {
        let kind = JobKind::Upload {
            address: Address::new(index, sub),
            whole: Whole::Entry,
        };
        let reply = self.job(kind, Vec::with_capacity(capacity));
        (reply.result, reply.job.data)
    }

    fn download(&mut self, index: u16, sub: u8, data: &[u8]) -> Result<(), JobError> {
        let kind = JobKind::Download {
            address: Address::new(index, sub),
            whole: Whole::Entry,
        };
        self.job(kind, data.to_vec()).result
    }
}

#[test]
fn entries_are_read_and_written_while_the_cycle_runs() {
    let (mut rig, _) = running();
    assert_eq!(
        rig.upload(0x1018, 2, 4),
        (Ok(()), 0x4021_u32.to_le_bytes().to_vec())
    );
    assert_eq!(rig.download(0x6065, 0, &[1, 2, 3, 0]), Ok(()));
    assert_eq!(rig.upload(0x6065, 0, 16).1, [1, 2, 3, 0]);
    let (result, name) = rig.upload(0x1008, 0, 200);
    assert_eq!(
        (result, String::from_utf8(name).unwrap().as_str()),
        (Ok(()), "TK4021 servo")
    );
    assert_eq!(rig.master.groups()[0].misses, 0);
    assert!(rig.master.is_operational());
}

#[test]
fn sdo_aborts_have_code_and_text() {
    let (mut rig, _) = running();
    assert_eq!(
        rig.upload(0x5FFF, 0, 4).0,
        Err(JobError::Abort(AbortCode::NoObject))
    );
    assert_eq!(
        rig.download(0x6041, 0, &[0, 0]),
        Err(JobError::Abort(AbortCode::ReadOnly))
    );
    let (result, _) = rig.upload(0x1008, 0, 5);
    assert_eq!(
        result,
        Err(JobError::TooLong {
            size: 12,
            capacity: 5
        })
    );
    assert_eq!(rig.upload(0x1018, 1, 4).0, Ok(()), "the next one works");
    let error = JobError::Abort(AbortCode::NoObject).to_string();
    assert_eq!(
        error,
        "the slave refuses: there is no such object (0602 0000h)"
    );
}

#[test]
fn complete_access_and_the_information_service() {
    let (mut rig, _) = running();
    let kind = JobKind::Upload {
        address: Address::new(0x1018, 0),
        whole: Whole::Object,
    };
    let reply = rig.job(kind, Vec::with_capacity(64));
    assert_eq!(reply.result, Ok(()));
    assert_eq!((reply.job.data.len(), reply.job.data[0]), (18, 4));
    let reply = rig.job(JobKind::List(1), Vec::with_capacity(1000));
    let list: Vec<u16> = reply
        .job
        .data
        .chunks(2)
        .map(|two| u16::from_le_bytes([two[0], two[1]]))
        .collect();
    assert!(
        list.len() > 60 && list.contains(&0x6041) && list.is_sorted(),
        "{list:04X?}"
    );
    let reply = rig.job(JobKind::DescribeObject(0x6041), Vec::with_capacity(100));
    let object = ObjectDescription::decode(&reply.job.data).unwrap();
    assert_eq!(
        (object.index, object.data_type, object.code),
        (0x6041, 6, 7)
    );
    let reply = rig.job(
        JobKind::DescribeEntry(Address::new(0x6041, 0)),
        Vec::with_capacity(100),
    );
    let entry = EntryDescription::decode(&reply.job.data).unwrap();
    assert_eq!((entry.bits, entry.access & 0x38), (16, 0));
    let reply = rig.job(JobKind::DescribeObject(0x5FFF), Vec::with_capacity(100));
    assert_eq!(reply.result, Err(JobError::Abort(AbortCode::NoObject)));
}

#[test]
fn emergencies_inside_a_transfer_go_to_their_queue() {
    let (mut rig, drive) = running();
    let emergency = Emergency {
        code: 0x7320,
        register: 0x20,
        data: [1, 2, 3, 4, 5],
    };
    for _ in 0..3 {
        drive.emergency(&emergency);
        assert_eq!(rig.upload(0x1018, 2, 4).0, Ok(()));
    }
    rig.cycles(30);
    let reports: Vec<_> = std::iter::from_fn(|| rig.master.poll_emergency()).collect();
    assert_eq!(reports.len(), 3);
    assert!(
        reports
            .iter()
            .all(|report| (report.slave, report.emergency) == (0, emergency))
    );
    drive.emergency(&emergency);
    rig.cycles(40);
    assert!(
        rig.master.poll_emergency().is_some(),
        "unasked, without a transfer"
    );
}

#[test]
fn transfer_with_any_lost_frame_is_executed_once() {
    for lost in 0..24 {
        for returned in [false, true] {
            let (mut rig, _) = running();
            let kind = JobKind::Upload {
                address: Address::new(0x1008, 0),
                whole: Whole::Entry,
            };
            let data = Vec::with_capacity(64);
            rig.master
                .submit(Job {
                    slave: 0,
                    kind,
                    data,
                    token: 7,
                })
                .unwrap();
            rig.cycles(lost);
            if returned {
                rig.segment.faults.lose_returned = 1;
            } else {
                rig.segment.faults.lose = 1;
            }
            let mut reply = None;
            for _ in 0..100 {
                rig.cycle();
                reply = reply.or_else(|| rig.master.poll_reply());
            }
            let reply = reply.unwrap_or_else(|| panic!("frame {lost}, returned {returned}"));
            assert_eq!(
                (reply.result, reply.job.data.len()),
                (Ok(()), 12),
                "frame {lost} {returned}"
            );
            assert!(rig.master.is_operational(), "{:?}", rig.events);
        }
    }
}

#[test]
fn mailbox_without_answer_times_out_and_recovers() {
    let (mut rig, _) = running();
    rig.segment.slave(0).unwrap().faults().lose_answers = 3;
    let (result, _) = rig.upload(0x1018, 2, 4);
    assert_eq!(result, Err(JobError::Timeout(Duration::from_secs(4))));
    assert_eq!(rig.upload(0x1018, 2, 4).0, Ok(()));
}

#[test]
fn mailbox_duplicates_and_errors_are_distinguished() {
    let (mut rig, _) = running();
    rig.segment.slave(0).unwrap().faults().repeat_answers = 1;
    assert_eq!(
        rig.upload(0x1018, 2, 4),
        (Ok(()), 0x4021_u32.to_le_bytes().to_vec())
    );
    assert_eq!(rig.upload(0x1018, 1, 4).1, 0x7A87_u32.to_le_bytes());
    rig.segment.slave(0).unwrap().faults().mailbox_errors = Some((1, 8));
    let error = rig.upload(0x1018, 2, 4).0.unwrap_err();
    assert_eq!(
        error.to_string(),
        "the slave refused the mailbox message: its size is inconsistent (8)"
    );
    assert_eq!(rig.upload(0x1018, 2, 4).0, Ok(()));
}

#[test]
fn registers_and_sii_are_read_and_written() {
    let (mut rig, _) = running();
    let reply = rig.job(
        JobKind::ReadRegister {
            at: register::STATION_ADDRESS,
            len: 2,
        },
        Vec::with_capacity(2),
    );
    assert_eq!((reply.result, reply.job.data), (Ok(()), vec![0x01, 0x10]));
    let reply = rig.job(JobKind::WriteRegister { at: 0x0F80 }, vec![9, 8]);
    assert_eq!(reply.result, Ok(()));
    let reply = rig.job(
        JobKind::ReadRegister { at: 0x0F80, len: 2 },
        Vec::with_capacity(2),
    );
    assert_eq!(reply.job.data, [9, 8]);
    let reply = rig.job(
        JobKind::ReadSii { word: 8, words: 4 },
        Vec::with_capacity(8),
    );
    assert_eq!(reply.job.data[4..], 0x4021_u32.to_le_bytes());
    let reply = rig.job(JobKind::WriteSii { word: 4 }, vec![0x34, 0x12]);
    assert_eq!(reply.result, Ok(()));
    let reply = rig.job(
        JobKind::ReadSii { word: 4, words: 1 },
        Vec::with_capacity(2),
    );
    assert_eq!(reply.job.data, [0x34, 0x12]);
    assert!(rig.master.is_operational());
}

#[test]
fn jobs_are_bounded_and_end_with_their_slave() {
    let (mut rig, _) = running();
    let kind = JobKind::Upload {
        address: Address::new(0x1018, 2),
        whole: Whole::Entry,
    };
    let job = |slave| Job {
        slave,
        kind,
        data: Vec::with_capacity(4),
        token: 0,
    };
    let refused: Vec<_> = (0..20)
        .filter_map(|_| rig.master.submit(job(0)).err())
        .collect();
    assert_eq!(
        (refused.len(), refused[0].result),
        (4, Err(JobError::Busy(16)))
    );
    assert_eq!(
        rig.master.submit(job(3)).unwrap_err().result,
        Err(JobError::NoSlave(3))
    );
    rig.cycle();
    rig.segment.set_power(0, false);
    rig.cycles(20);
    let replies: Vec<_> = std::iter::from_fn(|| rig.master.poll_reply()).collect();
    assert_eq!(replies.len(), 16);
    assert!(
        replies
            .iter()
            .skip(1)
            .all(|reply| reply.result == Err(JobError::Absent))
    );
    assert_eq!(
        rig.master.submit(job(0)).unwrap_err().result,
        Err(JobError::Absent)
    );
}

#[test]
fn sdo_job_without_coe_is_an_error() {
    let (terminal, _) = Io::digital(4, 0);
    let mut rig = Rig::new(MasterConfig::default(), Segment::line([terminal]));
    rig.until(3000, Master::is_operational);
    assert_eq!(
        rig.upload(0x1018, 2, 4).0,
        Err(JobError::Unsupported("CoE"))
    );
}

#[test]
fn acyclic_datagrams_are_limited_to_one_per_frame() {
    let (mut rig, _) = running();
    let kind = JobKind::Upload {
        address: Address::new(0x1008, 0),
        whole: Whole::Entry,
    };
    rig.master
        .submit(Job {
            slave: 0,
            kind,
            data: Vec::with_capacity(64),
            token: 0,
        })
        .unwrap();
    for _ in 0..50 {
        let mut frame = [0; 1500];
        let len = rig.master.poll_transmit(rig.now, &mut frame).unwrap();
        let count = Frame::decode(&frame[..len]).unwrap().datagrams().count();
        assert!(count <= 4, "{}", Frame::decode(&frame[..len]).unwrap());
        rig.exchange(&frame[..len]);
        rig.now += Duration::from_millis(1);
    }
}

#[test]
fn sdo_upload_without_mailbox_repeat_is_requested_again() {
    for lost in 0..24 {
        let (mut rig, _) = running();
        rig.segment.slave(0).unwrap().faults().no_repeat = true;
        let kind = JobKind::Upload {
            address: Address::new(0x1008, 0),
            whole: Whole::Entry,
        };
        let data = Vec::with_capacity(64);
        let job = Job {
            slave: 0,
            kind,
            data,
            token: 7,
        };
        rig.master.submit(job).unwrap();
        rig.cycles(lost);
        rig.segment.faults.lose_returned = 1;
        let mut reply = None;
        for _ in 0..400 {
            rig.cycle();
            reply = reply.or_else(|| rig.master.poll_reply());
        }
        let reply = reply.unwrap_or_else(|| panic!("frame {lost}"));
        assert_eq!((reply.result, reply.job.data.len()), (Ok(()), 12));
    }
}

#[test]
fn sdo_answer_missing_is_requested_three_times() {
    let (mut rig, _) = running();
    for (lost, result) in [
        (2, Ok(())),
        (3, Err(JobError::Timeout(Duration::from_secs(4)))),
    ] {
        rig.segment.slave(0).unwrap().faults().lose_answers = lost;
        let begin = rig.now;
        assert_eq!(rig.upload(0x1018, 2, 4).0, result);
        assert!(rig.now - begin < Duration::from_millis(4100));
    }
    // A command of a program is never sent twice.
    rig.segment.slave(0).unwrap().faults().lose_answers = 1;
    assert_eq!(
        rig.download(0x6065, 0, &[1, 2, 3, 0]),
        Err(JobError::Timeout(Duration::from_secs(4)))
    );
}

#[test]
fn start_up_without_mailbox_repeat_survives_any_lost_frame() {
    for lost in (0..120).step_by(3) {
        let (mut slave, _) = ServoDrive::slave(ServoConfig::default()).unwrap();
        slave.faults().no_repeat = true;
        let mut rig = Rig::new(MasterConfig::default(), Segment::line([slave]));
        rig.cycles(lost);
        rig.segment.faults.lose_returned = 1;
        rig.until(2000, Master::is_operational);
    }
}

#[test]
fn sdo_transfers_survive_one_frame_lost_in_seven() {
    let address = Address::new(0x1008, 0);
    let whole = Whole::Entry;
    let kinds = [
        (JobKind::Upload { address, whole }, Vec::with_capacity(64)),
        (
            JobKind::Download {
                address: Address::new(0x6065, 0),
                whole,
            },
            vec![1, 2, 3, 0],
        ),
        (JobKind::List(1), Vec::with_capacity(1000)),
        (JobKind::DescribeEntry(address), Vec::with_capacity(100)),
    ];
    for lost in [1, 2] {
        for goal in [AlState::PreOp, AlState::Op] {
            let config = MasterConfig {
                goal,
                ..MasterConfig::default()
            };
            let drive = ServoDrive::slave(ServoConfig::default()).unwrap().0;
            let mut rig = Rig::new(config, Segment::line([drive]));
            rig.until(5000, Master::is_operational);
            for (kind, data) in kinds.iter().cycle().take(40) {
                let mut buffer = Vec::with_capacity(data.capacity());
                buffer.extend_from_slice(data);
                let job = Job {
                    slave: 0,
                    kind: *kind,
                    data: buffer,
                    token: 7,
                };
                let reply = rig.lossy(job, 7, lost, |_| ());
                assert_eq!(reply.result, Ok(()), "{kind:?} {lost} {goal}");
                assert!(!reply.job.data.is_empty());
            }
            let faults = |it: &Event| matches!(it, Event::Fault { .. });
            assert!(!rig.events.iter().any(faults), "{:?}", rig.events);
        }
    }
}
