//! Ethernet over the mailbox: addresses, frames both ways, lost frames, faults of the slave.

use std::net::Ipv4Addr;

use super::*;
use crate::emulator::{EthernetPort, ServoConfig, ServoDrive};
use crate::eoe::{AddressFilter, EoeRequest, EoeResult, FRAME_MAX, FragmentError, IpSettings};
use takt_cia402::dictionary::Address;

const MAC: [u8; 6] = [2, 0, 0, 0, 0, 7];
const HOST: [u8; 6] = [2, 0, 0, 0, 0, 1];

/// A coupler and a drive with an Ethernet port, in PRE-OP or OP.
fn up(goal: AlState) -> (Rig, EthernetPort) {
    // The filter takes 132 bytes with its headers.
    let config = ServoConfig {
        mailbox: 192,
        ..ServoConfig::default()
    };
    let drive = ServoDrive::slave(config).unwrap().0;
    let drive = drive.with_ethernet();
    let port = drive.ethernet().unwrap();
    let at = |number| SlaveSpec {
        goal,
        ethernet: number == 1,
        ..SlaveSpec::new(format!("{number}"), Location::Position(number))
    };
    let config = MasterConfig {
        slaves: vec![at(0), at(1)],
        goal,
        ..MasterConfig::default()
    };
    let mut rig = Rig::new(config, Segment::line([Coupler::slave(), drive]));
    rig.until(3000, Master::is_operational);
    (rig, port)
}

const fn as_job(kind: JobKind, data: Vec<u8>) -> Job {
    Job {
        slave: 1,
        kind,
        data,
        token: 1,
    }
}

const fn asked(request: EoeRequest) -> JobKind {
    JobKind::Ethernet(EthernetJob::Request { port: 0, request })
}

const SEND: JobKind = JobKind::Ethernet(EthernetJob::Send { port: 0 });

fn settings() -> IpSettings {
    IpSettings {
        mac: Some(MAC),
        ip: Some(Ipv4Addr::new(10, 0, 0, 2)),
        mask: Some(Ipv4Addr::new(255, 255, 255, 0)),
        gateway: Some(Ipv4Addr::UNSPECIFIED),
        ..IpSettings::default()
    }
}

#[track_caller]
fn run(rig: &mut Rig, job: Job) -> Reply {
    rig.lossy(job, u64::MAX, 0, |_| ())
}

/// An ICMP echo request with that many bytes.
fn ping(len: usize) -> Vec<u8> {
    let total = u16::try_from(28 + len).unwrap().to_be_bytes();
    let ip = [0x45, 0, total[0], total[1], 0, 1, 0, 0, 64, 1, 0, 0];
    let mut frame = [&MAC[..], &HOST, &[0x08, 0x00], &ip].concat();
    frame.extend([10, 0, 0, 1, 10, 0, 0, 2, 8, 0, 0, 0, 0, 9, 0, 1]);
    frame.extend((0..len).map(|at| u8::try_from(at % 251).unwrap()));
    frame
}

/// The next frame of the slave.
#[track_caller]
fn received(rig: &mut Rig) -> Vec<u8> {
    let mut frame = [0; FRAME_MAX];
    for _ in 0..2000 {
        if let Some(len) = rig.master.poll_ethernet(1, &mut frame) {
            return frame[..len].to_vec();
        }
        rig.cycle();
    }
    panic!("no frame; {:?}", rig.master.slave(1).unwrap().ethernet());
}

/// Sends a frame, and checks that the reply carries the same data.
#[track_caller]
fn pong(rig: &mut Rig, len: usize) {
    let sent = run(rig, as_job(SEND, ping(len)));
    assert_eq!(sent.result, Ok(()), "{len}");
    let reply = received(rig);
    assert_eq!(reply[..12], [&HOST[..], &MAC].concat(), "{len}");
    assert_eq!(reply[34], 0, "an echo reply");
    assert_eq!(reply[42..42 + len], ping(len)[42..], "{len}");
}

#[test]
fn ethernet_address_and_filter_are_set_and_read() {
    let (mut rig, port) = up(AlState::PreOp);
    let set = asked(EoeRequest::SetAddress);
    let reply = run(&mut rig, as_job(set, settings().encode()));
    assert_eq!(reply.result, Ok(()));
    assert_eq!(port.lock().settings, settings());
    let get = as_job(asked(EoeRequest::GetAddress), Vec::with_capacity(64));
    let reply = run(&mut rig, get);
    assert_eq!(IpSettings::decode(&reply.job.data), Some(settings()));
    let filter = AddressFilter {
        addresses: vec![[1; 6], MAC],
        masks: vec![],
        no_broadcasts: true,
    };
    let set = asked(EoeRequest::SetFilter);
    let reply = run(&mut rig, as_job(set, filter.encode().unwrap()));
    assert_eq!(reply.result, Ok(()));
    let get = as_job(asked(EoeRequest::GetFilter), Vec::with_capacity(128));
    let reply = run(&mut rig, get);
    assert_eq!(AddressFilter::decode(&reply.job.data), Some(filter));
    let small = as_job(asked(EoeRequest::GetFilter), Vec::with_capacity(9));
    let reply = run(&mut rig, small).result;
    assert!(matches!(reply, Err(JobError::TooLong { .. })), "{reply:?}");
}

#[test]
fn ethernet_refusals_carry_their_result() {
    let (mut rig, port) = up(AlState::PreOp);
    port.lock().faults.refuse = (1, EoeResult::NO_DHCP);
    let set = || as_job(asked(EoeRequest::SetAddress), settings().encode());
    let refused = |result| Err(JobError::Ethernet(result));
    assert_eq!(run(&mut rig, set()).result, refused(EoeResult::NO_DHCP));
    assert_eq!(run(&mut rig, set()).result, Ok(()));
    let short = as_job(asked(EoeRequest::SetAddress), vec![1, 0, 0, 0]);
    let result = run(&mut rig, short).result;
    assert_eq!(result, refused(EoeResult::UNSPECIFIED));
    port.lock().faults.no_filter = true;
    let get = as_job(asked(EoeRequest::GetFilter), Vec::with_capacity(128));
    assert_eq!(run(&mut rig, get).result, refused(EoeResult::NO_FILTER));
    for len in [0, 13, FRAME_MAX + 1] {
        let reply = run(&mut rig, as_job(SEND, vec![0; len]));
        assert_eq!(reply.result, Err(JobError::FrameLength(len)));
    }
    // The coupler has no mailbox.
    let job = Job {
        slave: 0,
        ..as_job(SEND, ping(8))
    };
    let reply = run(&mut rig, job);
    assert!(matches!(reply.result, Err(JobError::Unsupported(_))));
}

#[test]
fn ethernet_frames_of_any_length_come_back() {
    for goal in [AlState::PreOp, AlState::Op] {
        let (mut rig, _) = up(goal);
        let set = as_job(asked(EoeRequest::SetAddress), settings().encode());
        assert_eq!(run(&mut rig, set).result, Ok(()));
        for len in [0, 18, 76, 77, 200, 1000, 1472] {
            pong(&mut rig, len);
        }
        let counters = rig.master.slave(1).unwrap().ethernet().unwrap();
        assert_eq!((counters.sent, counters.received), (7, 7));
        assert_eq!((counters.broken, counters.overflowed), (0, 0));
        assert!(rig.master.is_operational(), "{:?}", rig.events);
    }
}

#[test]
fn ethernet_frames_survive_one_frame_lost_in_seven() {
    for lost in [1, 2] {
        let (mut rig, port) = up(AlState::PreOp);
        let set = as_job(asked(EoeRequest::SetAddress), settings().encode());
        assert_eq!(rig.lossy(set, 7, lost, |_| ()).result, Ok(()));
        for _ in 0..5 {
            let reply = rig.lossy(as_job(SEND, ping(700)), 7, lost, |_| ());
            assert_eq!(reply.result, Ok(()));
            assert_eq!(received(&mut rig)[42..742], ping(700)[42..]);
        }
        assert_eq!(port.lock().dropped, 0);
        let counters = rig.master.slave(1).unwrap().ethernet().unwrap();
        assert_eq!((counters.received, counters.broken), (5, 0), "{counters:?}");
    }
}

#[test]
fn ethernet_faults_of_slave_drop_one_frame_each() {
    let (mut rig, port) = up(AlState::PreOp);
    let set = as_job(asked(EoeRequest::SetAddress), settings().encode());
    assert_eq!(run(&mut rig, set).result, Ok(()));
    let lost = |port: &EthernetPort| port.lock().faults.lose = 1;
    let swapped = |port: &EthernetPort| port.lock().faults.swap = 1;
    let wrong = |port: &EthernetPort| port.lock().faults.wrong_frame = 1;
    let long = |port: &EthernetPort| port.lock().faults.too_long = 1;
    type Case<'a> = (&'a dyn Fn(&EthernetPort), fn(FragmentError) -> bool);
    let cases: [Case<'_>; 4] = [
        (&lost, |it| matches!(it, FragmentError::NoBeginning(1))),
        (&swapped, |it| matches!(it, FragmentError::Number { .. })),
        (&wrong, |it| matches!(it, FragmentError::Frame { .. })),
        (&long, |it| matches!(it, FragmentError::TooLong { .. })),
    ];
    for (count, (fault, cause)) in (1..).zip(cases) {
        fault(&port);
        assert_eq!(run(&mut rig, as_job(SEND, ping(700))).result, Ok(()));
        rig.cycles(200);
        assert_eq!(rig.master.poll_ethernet(1, &mut [0; FRAME_MAX]), None);
        let counters = rig.master.slave(1).unwrap().ethernet().unwrap();
        assert_eq!(counters.broken, count, "{counters:?}");
        assert!(counters.cause.is_some_and(cause), "{counters:?}");
        pong(&mut rig, 700);
    }
    port.lock().faults.stamps = true;
    pong(&mut rig, 700);
    port.lock().faults.deaf = 1;
    assert_eq!(run(&mut rig, as_job(SEND, ping(8))).result, Ok(()));
    pong(&mut rig, 9);
}

#[test]
fn ethernet_frames_that_wait_too_long_are_counted() {
    let (mut rig, _) = up(AlState::PreOp);
    let set = as_job(asked(EoeRequest::SetAddress), settings().encode());
    assert_eq!(run(&mut rig, set).result, Ok(()));
    for _ in 0..20 {
        assert_eq!(run(&mut rig, as_job(SEND, ping(8))).result, Ok(()));
        rig.cycles(50);
    }
    let counters = rig.master.slave(1).unwrap().ethernet().unwrap();
    assert_eq!((counters.received, counters.overflowed), (16, 4));
    for _ in 0..16 {
        assert_eq!(received(&mut rig)[..6], HOST);
    }
    assert_eq!(rig.master.poll_ethernet(1, &mut [0; FRAME_MAX]), None);
    pong(&mut rig, 8);
}

#[test]
fn ethernet_chatty_slave_still_answers_objects() {
    let (mut rig, _) = up(AlState::Op);
    let set = as_job(asked(EoeRequest::SetAddress), settings().encode());
    assert_eq!(run(&mut rig, set).result, Ok(()));
    let slave = rig.segment.slave(1).unwrap();
    slave.set_ethernet(Some(1_000_000));
    let upload = JobKind::Upload {
        address: Address::new(0x1018, 1),
        whole: crate::coe::Whole::Entry,
    };
    for _ in 0..10 {
        let reply = run(&mut rig, as_job(upload, Vec::with_capacity(8)));
        assert_eq!((reply.result, reply.job.data.len()), (Ok(()), 4));
        assert_eq!(run(&mut rig, as_job(SEND, ping(300))).result, Ok(()));
        while rig.master.poll_ethernet(1, &mut [0; FRAME_MAX]).is_some() {}
    }
    let counters = rig.master.slave(1).unwrap().ethernet().unwrap();
    assert_eq!((counters.sent, counters.broken), (10, 0), "{counters:?}");
    assert!(counters.received >= 20, "{counters:?}");
    assert!(rig.master.is_operational(), "{:?}", rig.events);
}
