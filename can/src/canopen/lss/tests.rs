//! LSS master and slaves on one bus, and the slave with each command in each mode.

use std::time::Duration;

use super::*;
use crate::canopen::NodeId;

const MS: Duration = Duration::from_millis(1);

fn identity(serial: u32) -> Identity {
    Identity {
        vendor: 0x319,
        product: 0xDEAD_BEEF,
        revision: 0x0001_0000,
        serial,
    }
}

fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

/// A master, slaves, and the actions of the slaves.
struct Line {
    master: Master,
    slaves: Vec<Slave>,
    done: Vec<Done>,
    now: Duration,
    sent: u32,
}

impl Line {
    fn new(slaves: Vec<Slave>) -> Self {
        Self {
            master: Master::new(10 * MS),
            slaves,
            done: vec![],
            now: MS,
            sent: 0,
        }
    }

    fn run(&mut self, job: Job) -> Result<Reply, LssError> {
        self.master.start(job);
        for _ in 0..100_000 {
            if let Some(outcome) = self.master.take_outcome() {
                return outcome;
            }
            let Some(message) = self.master.poll_transmit(self.now) else {
                self.now = self.master.poll_timeout().unwrap_or(self.now);
                continue;
            };
            self.sent += 1;
            for slave in &mut self.slaves {
                let (answer, done) = slave.handle(&message);
                self.done.extend(done);
                if let Some(answer) = answer {
                    self.master.handle(&answer);
                }
            }
        }
        panic!("no end");
    }
}

#[test]
fn lss_fast_scan_finds_and_numbers_slaves() {
    let serials = [0, 1, 0x8000_0000, u32::MAX, 0x1234_5678];
    let slaves = serials
        .map(|serial| Slave::new(identity(serial), None))
        .to_vec();
    let mut line = Line::new(slaves);
    let mut found = vec![];
    for number in 1..=5 {
        assert_eq!(
            line.run(Job::IdentifyUnconfigured),
            Ok(Reply::Present(true))
        );
        let Ok(Reply::Address(address)) = line.run(Job::FastScan([None; 4])) else {
            panic!("slave {number} was not found");
        };
        found.push(address.serial);
        assert_eq!(line.run(Job::SetNode(Some(node(number)))), Ok(Reply::Done));
        assert_eq!(line.run(Job::Inquire), Ok(Reply::Address(address)));
        assert_eq!(line.run(Job::Store), Ok(Reply::Done));
        assert_eq!(line.run(Job::Switch(Mode::Waiting)), Ok(Reply::Done));
        assert_eq!(line.done.pop(), Some(Done::Activate(node(number))));
        line.slaves.iter_mut().for_each(Slave::activate);
    }
    found.sort_unstable();
    assert_eq!(found, [0, 1, 0x1234_5678, 0x8000_0000, u32::MAX]);
    assert_eq!(
        line.run(Job::IdentifyUnconfigured),
        Ok(Reply::Present(false))
    );
    assert_eq!(line.run(Job::FastScan([None; 4])), Err(LssError::Silent));
}

#[test]
fn lss_known_numbers_shorten_scan() {
    let mut line = Line::new(vec![Slave::new(identity(77), None)]);
    let known = [Some(0x319), Some(0xDEAD_BEEF), Some(0x0001_0000), None];
    assert_eq!(
        line.run(Job::FastScan(known)),
        Ok(Reply::Address(identity(77)))
    );
    assert_eq!(line.sent, 1 + 3 + 33);
    let other = [Some(0x31A), None, None, None];
    line.run(Job::Switch(Mode::Waiting)).unwrap();
    assert_eq!(line.run(Job::FastScan(other)), Err(LssError::Silent));
}

/// Slaves respond at different times: the same response arrives several times, the last one late.
#[test]
fn lss_scan_waits_for_all_slaves() {
    let mut slaves = [3, 9].map(|serial| Slave::new(identity(serial), None));
    let (mut master, mut now) = (Master::new(10 * MS), MS);
    master.start(Job::FastScan([None; 4]));
    let outcome = loop {
        if let Some(message) = master.poll_transmit(now) {
            for slave in &mut slaves {
                // The response of the second one is late, after a poll.
                if let (Some(answer), _) = slave.handle(&message) {
                    master.handle(&answer);
                    now += 2 * MS;
                    assert_eq!(master.poll_transmit(now), None);
                }
            }
        }
        if let Some(outcome) = master.take_outcome() {
            break outcome;
        }
        now = now.max(master.poll_timeout().unwrap());
    };
    assert_eq!(outcome, Ok(Reply::Address(identity(3))));
}

#[test]
fn lss_slave_is_selected_by_full_address() {
    let slaves = vec![
        Slave::new(identity(1), Some(node(1))),
        Slave::new(identity(2), Some(node(2))),
    ];
    let mut line = Line::new(slaves);
    assert_eq!(line.run(Job::Select(identity(3))), Err(LssError::Silent));
    assert_eq!(line.run(Job::Select(identity(2))), Ok(Reply::Done));
    assert_eq!(line.slaves[0].mode(), Mode::Waiting);
    assert_eq!(line.run(Job::InquireNode), Ok(Reply::Node(Some(node(2)))));
    assert_eq!(line.run(Job::SetNode(Some(node(9)))), Ok(Reply::Done));
    assert_eq!(
        line.run(Job::InquireNode),
        Ok(Reply::Node(Some(node(2)))),
        "not yet"
    );
    assert_eq!(line.run(Job::SetBitTiming(2)), Ok(Reply::Done));
    let refused = Err(LssError::Refused {
        error: 1,
        specific: 0,
    });
    assert_eq!(line.run(Job::SetBitTiming(5)), refused);
    assert_eq!(line.run(Job::SetBitTiming(3)), Ok(Reply::Done));
    assert_eq!(line.run(Job::ActivateBitTiming(500)), Ok(Reply::Done));
    assert_eq!(line.run(Job::Store), Ok(Reply::Done));
    line.run(Job::Switch(Mode::Waiting)).unwrap();
    // A device that has a number changes it with a reset only.
    assert_eq!(
        line.done,
        [Done::BitTiming(3, 500), Done::Store(Some(node(9)))]
    );
    assert_eq!(line.slaves[1].pending(), Some(node(9)));
}

/// Each command in each mode, with and without a node number: answered, or not.
#[test]
fn lss_slave_every_command_in_every_mode() {
    for command in 0..=u8::MAX {
        for mode in [Mode::Waiting, Mode::Configuration] {
            for active in [None, Some(node(3))] {
                let mut slave = Slave::new(identity(0), active);
                slave.mode = mode;
                // 80h in byte 5 starts a fast scan; the address is vendor 0319h.
                let message = [command, 0x19, 0x03, 0, 0, SCAN_RESET, 0, 0];
                let (answer, _) = slave.handle(&message);
                let configuring = mode == Mode::Configuration;
                let expected = match command {
                    SET_NODE | SET_TIMING | STORE | INQUIRE..=INQUIRE_NODE => configuring,
                    IDENTIFY_NONE => active.is_none(),
                    FAST_SCAN => !configuring && active.is_none(),
                    _ => false,
                };
                assert_eq!(
                    answer.is_some(),
                    expected,
                    "{command:02X}h {mode:?} {active:?}"
                );
            }
        }
    }
}

#[test]
fn lss_node_numbers_are_checked_and_removable() {
    for raw in 0..=u8::MAX {
        let mut slave = Slave::new(identity(0), Some(node(3)));
        slave.mode = Mode::Configuration;
        let (answer, _) = slave.handle(&short(SET_NODE, raw, 0));
        let good = (1..=127).contains(&raw) || raw == NO_NODE;
        assert_eq!(answer, Some(short(SET_NODE, u8::from(!good), 0)));
        let pending = if good {
            NodeId::new(raw).ok()
        } else {
            Some(node(3))
        };
        assert_eq!(slave.pending(), pending);
    }
}

#[test]
fn lss_identification_needs_six_parts_in_order() {
    let mut slave = Slave::new(identity(50), Some(node(3)));
    let mut identify = |values: [u32; 6]| {
        let parts = (IDENTIFY..).zip(values);
        parts
            .filter(|(c, v)| slave.handle(&with_number(*c, *v)).0.is_some())
            .count()
    };
    let (vendor, product) = (0x319, 0xDEAD_BEEF);
    assert_eq!(identify([vendor, product, 0, u32::MAX, 50, 50]), 1);
    assert_eq!(identify([vendor, product, 0, u32::MAX, 51, 60]), 0);
    assert_eq!(identify([vendor, product + 1, 0, u32::MAX, 0, 60]), 0);
}
