//! The master and slaves that answer as real ones do: each device alone, the usual line, and peculiarities of their
//! mailboxes and assignments.

use takt_cia402::dictionary::{Address, Mapped};

use super::*;
use crate::config::{PdoSpec, SyncSpec};
use crate::emulator::{Handles, Profile};

/// Timeout for the state of a segment.
const SOON: Duration = Duration::from_secs(3);

fn mapped(index: u16, bits: u8) -> Mapped {
    Mapped {
        address: Address::new(index, 0),
        bits,
    }
}

/// The configuration of a device; a drive gets a mapping of one PDO each way, and SYNC0.
fn spec(position: u16, profile: Profile, cycle: Duration) -> SlaveSpec {
    let plain = SlaveSpec::new(
        format!("{profile} {position}"),
        Location::Position(position),
    );
    if profile != Profile::Akd {
        return plain;
    }
    let pdo = |index, entries: &[Mapped]| {
        let entries = entries.to_vec();
        Some(vec![PdoSpec { index, entries }])
    };
    SlaveSpec {
        outputs: pdo(0x1600, &[mapped(0x6040, 16), mapped(0x607A, 32)]),
        inputs: pdo(0x1A00, &[mapped(0x6041, 16), mapped(0x6064, 32)]),
        sync: Some(SyncSpec::sync0(cycle)),
        ..plain
    }
}

fn rig(profiles: &[Profile], times: u64, cycle: Duration) -> (Rig, Vec<Handles>) {
    let (segment, handles) = Profile::line(profiles, times).unwrap();
    let specs = (0..).zip(profiles);
    let config = MasterConfig {
        cycle,
        slaves: specs.map(|(n, profile)| spec(n, *profile, cycle)).collect(),
        ..MasterConfig::default()
    };
    (Rig::new(config, segment), handles)
}

impl Rig {
    /// Brings all to OP without a fault; returns the duration.
    #[track_caller]
    fn comes_up(&mut self) -> Duration {
        let begin = self.now;
        let cycles = (2 * SOON).as_micros() / self.master.config().cycle.as_micros();
        self.until(usize::try_from(cycles).unwrap(), Master::is_operational);
        let faults = self
            .events
            .iter()
            .filter(|e| matches!(e, Event::Fault { .. }));
        assert_eq!(faults.count(), 0, "{:?}", self.events);
        self.now - begin
    }
}

#[test]
fn each_device_alone_comes_to_op_without_fault() {
    for profile in Profile::ALL {
        for times in [1, 2] {
            let (mut rig, _) = rig(&[profile], times, Duration::from_millis(1));
            let took = rig.comes_up();
            assert!(took < SOON, "{profile}: {took:?}");
            let info = rig.master.slave(0).unwrap().info();
            assert!(info.name.to_lowercase().starts_with(profile.name()));
            assert!(info.sii_checked, "{profile}");
            // A drive has inputs from its first SYNC0 on.
            rig.cycles(150);
            let group = &rig.master.groups()[0];
            assert_eq!(group.counter, group.expected.0, "{profile}");
        }
    }
}

#[test]
fn all_devices_in_a_line_exchange_with_right_counters() {
    let (mut rig, handles) = rig(&Profile::ALL, 1, Duration::from_millis(1));
    let took = rig.comes_up();
    assert!(took < SOON, "{took:?}");
    assert_eq!(
        rig.master.reference(),
        Some(0),
        "the only first with a clock"
    );
    for (n, (io, _)) in handles.iter().enumerate() {
        let bytes = [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88];
        if let Some(io) = io {
            io.set_inputs(&bytes);
            for (to, from) in rig.master.outputs_mut(n).iter_mut().zip(bytes) {
                *to = from;
            }
        }
    }
    rig.cycles(150);
    let group = &rig.master.groups()[0];
    // EL1004 1, EL2004, EL2828, EL2889 2 each, EL3004 1, EK1914, LAN9252, AKD 3 each.
    assert_eq!((group.counter, group.expected), (17, (17, 17)));
    let io = |n: usize| handles[n].0.as_ref().unwrap();
    assert_eq!(rig.master.inputs(1), (&[0x11][..], 0));
    assert_eq!(io(2).outputs(), [0x11]);
    assert_eq!(
        (io(3).outputs(), io(4).outputs()),
        (vec![0x11], vec![0x11, 0x22])
    );
    assert_eq!(rig.master.inputs(5).0.len(), 16);
    assert_eq!(
        (io(6).outputs().len(), rig.master.inputs(6).0.len()),
        (8, 8)
    );
    assert_eq!(
        (io(7).outputs(), rig.master.inputs(7).0.len()),
        (vec![0x11, 0x22], 6)
    );
    let (inputs, age) = rig.master.inputs(8);
    assert_eq!((inputs[0] & 0x4F, age), (0x40, 0), "switch on disabled");
}

/// A hundred starts of the usual line with clocks, each at another phase of its firmware and its times.
fn a_hundred_starts(times: u64) {
    let mut slowest = Duration::ZERO;
    for start in 0..100_u32 {
        let (mut rig, _) = rig(&Profile::LINE, times, Duration::from_millis(2));
        rig.now += start * Duration::from_micros(137);
        slowest = slowest.max(rig.comes_up());
        assert_eq!(rig.master.reference(), Some(0));
        let drive = rig.segment.slave(5).unwrap().clock().unwrap();
        assert!(drive.next_sync0().is_some(), "start {start}");
    }
    assert!(slowest < SOON, "{slowest:?}");
}

#[test]
fn usual_line_comes_up_100_of_100_times() {
    a_hundred_starts(1);
}

#[test]
fn usual_line_twice_as_slow_comes_up_100_of_100() {
    a_hundred_starts(2);
}

#[test]
fn default_assignment_that_is_refused_shows_its_code() {
    let (segment, _) = Profile::line(&[Profile::Akd], 1).unwrap();
    let mut rig = Rig::new(MasterConfig::default(), segment);
    rig.until(3000, |master| {
        master.slave(0).is_some_and(|slave| slave.fault().is_some())
    });
    let slave = rig.master.slave(0).unwrap();
    let lens = (slave.process().outputs_len(), slave.process().inputs_len());
    assert_eq!(lens, (17, 17), "the SyncManagers are as long as the sum");
    let text = slave.fault().unwrap().to_string();
    assert!(text.contains("(001Dh)"), "{text}");
    assert!(
        text.contains("1C12h lists PDOs that may not be assigned together"),
        "{text}"
    );
}

#[test]
fn ethernet_between_sdo_answers_disturbs_no_transfer() {
    let (mut rig, _) = rig(&[Profile::Akd], 1, Duration::from_millis(1));
    // A master before this one gave it an address: it sends all the time.
    let address = rig.segment.slave(0).unwrap();
    address.set_ethernet(Some(3_000_000));
    rig.comes_up();
    let mut answers = 0;
    for _ in 0..40 {
        let job = Job {
            slave: 0,
            kind: JobKind::Upload {
                address: Address::new(0x1018, 2),
                whole: crate::coe::Whole::Entry,
            },
            data: Vec::with_capacity(4),
            token: 0,
        };
        rig.master.submit(job).unwrap();
        for _ in 0..200 {
            rig.cycle();
            if let Some(reply) = rig.master.poll_reply() {
                assert_eq!(reply.result, Ok(()));
                assert_eq!(reply.job.data, 0x0041_4B44_u32.to_le_bytes());
                answers += 1;
                break;
            }
        }
    }
    assert_eq!(answers, 40);
    let (ignored, _) = rig.master.units[0].mailbox_counters();
    assert!(ignored > 40, "{ignored} Ethernet frames were fetched");
    assert!(rig.master.is_operational());
}

#[test]
fn mailboxes_with_stale_bytes_behind_answers_are_read() {
    let (mut rig, _) = rig(&[Profile::Ek1914], 1, Duration::from_millis(1));
    rig.comes_up();
    let text = |index, len| {
        let job = Job {
            slave: 0,
            kind: JobKind::Upload {
                address: Address::new(index, 0),
                whole: crate::coe::Whole::Entry,
            },
            data: Vec::with_capacity(len),
            token: 0,
        };
        move |rig: &mut Rig| {
            rig.master.submit(job).unwrap();
            for _ in 0..200 {
                rig.cycle();
                if let Some(reply) = rig.master.poll_reply() {
                    return reply.result.map(|()| reply.job.data);
                }
            }
            panic!("no reply");
        }
    };
    assert_eq!(
        text(0x1008, 64)(&mut rig),
        Ok(b"EK1914".to_vec()),
        "a normal upload"
    );
    assert_eq!(text(0x1000, 64)(&mut rig).unwrap().len(), 4);
    assert_eq!(
        text(0x1A00, 64)(&mut rig),
        Ok(vec![6]),
        "one byte, and no more"
    );
}

#[test]
fn delays_of_recorded_receive_times_are_those_recorded() {
    let line = [Profile::Ek1100, Profile::El2828, Profile::El2889];
    let (mut rig, _) = rig(&line, 1, Duration::from_millis(1));
    rig.comes_up();
    let delay = |n| rig.master.slave(n).unwrap().delay_ns();
    assert!(delay(1).abs_diff(145) <= 2, "{} ns", delay(1));
    assert!(delay(2).abs_diff(300) <= 2, "{} ns", delay(2));
}
