//! Proof that the master of a running segment does not allocate: cycles with objects, emergencies, lost frames, a cut
//! cable and a returning slave, under a counting allocator.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_cia402::dictionary::Address;
use takt_ethercat::Emergency;
use takt_ethercat::coe::Whole;
use takt_ethercat::config::MasterConfig;
use takt_ethercat::emulator::{Coupler, Entry, Io, Segment, ServoConfig, ServoDrive};
use takt_ethercat::master::{Job, JobKind, Master};
use takt_tests::{Allocations, CountingAllocator};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// What `body` allocates and frees.
fn counted<R>(total: &mut u64, body: impl FnOnce() -> R) -> R {
    let allocations = Allocations::count();
    let result = body();
    *total += allocations.end();
    result
}

/// One frame there and back; what the master allocates is added to `total`.
fn cycle(master: &mut Master, segment: &mut Segment, now: &mut Duration, total: &mut u64) {
    let mut frame = [0; 1500];
    let len = counted(total, || master.poll_transmit(*now, &mut frame));
    if let Some(len) = len {
        let ns = u64::try_from(now.as_nanos()).unwrap();
        if let Some(returned) = segment.process(&mut frame[..len], Entry::First, ns) {
            let at = *now + Duration::from_nanos(returned.after);
            counted(total, || master.handle_frame(0, &frame[..len], at));
        }
    }
    *now += Duration::from_millis(1);
}

#[test]
fn ten_thousand_cycles_with_faults_allocate_nothing() {
    let (terminal, _) = Io::digital(8, 8);
    let (slave, drive) = ServoDrive::slave(ServoConfig::default()).unwrap();
    let mut segment = Segment::line([Coupler::slave(), terminal, slave]);
    let mut master = Master::new(MasterConfig::default()).unwrap();
    let (mut now, mut start) = (Duration::from_secs(1), 0);
    while !master.is_operational() {
        cycle(&mut master, &mut segment, &mut now, &mut start);
        assert!(now < Duration::from_secs(20));
    }
    assert!(start > 0, "the counter counts");
    let (mut total, mut replies, mut emergencies) = (0, 0, 0);
    let mut job = Some(Job {
        slave: 2,
        kind: JobKind::Upload {
            address: Address::new(0x1008, 0),
            whole: Whole::Entry,
        },
        data: Vec::with_capacity(64),
        token: 0,
    });
    for n in 0..10_000_u32 {
        match n % 2500 {
            100 => segment.set_link(2, false),
            600 => segment.set_link(2, true),
            1500 => segment.set_power(2, false),
            1600 => segment.set_power(2, true),
            1200 => drive.emergency(&Emergency {
                code: 0x7320,
                register: 0x20,
                data: [0; 5],
            }),
            at if at % 97 == 0 => segment.faults.lose = 1,
            _ => {}
        }
        if let Some(submitted) = job.take() {
            job = counted(&mut total, || master.submit(submitted))
                .err()
                .map(|reply| reply.job);
        }
        counted(&mut total, || {
            master.outputs_mut(1).fill(n.to_le_bytes()[0]);
        });
        cycle(&mut master, &mut segment, &mut now, &mut total);
        if let Some(reply) = counted(&mut total, || master.poll_reply()) {
            replies += u32::from(reply.result.is_ok());
            job = Some(reply.job);
        }
        emergencies += u32::from(counted(&mut total, || master.poll_emergency()).is_some());
        while counted(&mut total, || master.poll_event()).is_some() {}
    }
    assert!(
        master.is_operational() && replies > 100 && emergencies >= 4,
        "{replies} {emergencies}"
    );
    assert_eq!(total, 0);
}
