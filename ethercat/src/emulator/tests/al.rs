//! AL states: every cell of request and state, and every reason to refuse.

use super::*;
use crate::AlStatusCode;
use crate::emulator::{Plain, SiiImage, SlaveConfig, Span, Times};

const STATES: [AlState; 4] = [AlState::Init, AlState::PreOp, AlState::SafeOp, AlState::Op];

/// A slave without process data, brought to a state step by step.
fn in_state(state: AlState) -> Bench {
    let mut bench = Bench::new([Coupler::slave().with_firmware()]);
    bench.address();
    for step in STATES
        .into_iter()
        .skip(1)
        .take_while(|s| s.raw() <= state.raw())
    {
        assert_eq!(bench.request(0x1000, step, false), (step, false, 0));
    }
    bench
}

#[test]
fn al_requests_in_every_state() {
    use AlState::{Boot, Init, Op, Other, PreOp, SafeOp};
    // Rows: from. Columns: Init, PreOp, Boot, SafeOp, Op, 5, 0. A code, or 0 for success.
    let table = [
        (Init, [0, 0, 0x13, 0x11, 0x11, 0x12, 0x12]),
        (PreOp, [0, 0, 0x13, 0, 0x11, 0x12, 0x12]),
        (SafeOp, [0, 0, 0x13, 0, 0, 0x12, 0x12]),
        (Op, [0, 0, 0x13, 0, 0, 0x12, 0x12]),
    ];
    let wanted = [Init, PreOp, Boot, SafeOp, Op, Other(5), Other(0)];
    for (from, codes) in table {
        for (to, code) in wanted.into_iter().zip(codes) {
            let mut bench = in_state(from);
            let expected = if code == 0 {
                (to, false, 0)
            } else {
                (from, true, code)
            };
            assert_eq!(
                bench.request(0x1000, to, false),
                expected,
                "{from:?} to {to:?}"
            );
            if code == 0 {
                continue;
            }
            // With the error bit set, only an acknowledgement or INIT is accepted.
            assert_eq!(bench.request(0x1000, PreOp, false), expected);
            let mut acknowledged = bench.request(0x1000, from, true);
            assert_eq!(acknowledged, (from, false, 0));
            bench.request(0x1000, to, false);
            acknowledged = bench.request(0x1000, Init, false);
            assert_eq!(acknowledged, (Init, false, 0));
        }
    }
}

#[test]
fn al_answer_is_delayed_and_last_request_counts() {
    let mut bench = in_state(AlState::PreOp);
    bench.write(0x1000, register::AL_CONTROL, &[4, 0]);
    assert_eq!(bench.al(0x1000).0, AlState::PreOp, "after some 10 µs");
    bench.write(0x1000, register::AL_CONTROL, &[1, 0]);
    bench.now += MS;
    assert_eq!(bench.al(0x1000).0, AlState::Init);
}

fn with_mailbox() -> Bench {
    let sii = SiiImage {
        mailbox_len: 128,
        coe: 0x01,
        ..SiiImage::default()
    };
    let mut bench = Bench::new([Slave::new(SlaveConfig::new(sii), Box::new(Plain))]);
    bench.address();
    bench
}

#[test]
fn mailboxes_must_match_the_sii() {
    let right = [(0x1000, 128, 0x26), (0x1080, 128, 0x22)];
    let mut wrong = vec![];
    for number in 0..2 {
        for change in 0..3 {
            let mut set = right;
            match change {
                0 => set[number].0 += 1,
                1 => set[number].1 -= 1,
                _ => set[number].2 ^= 0x02,
            }
            wrong.push(set);
        }
    }
    for set in wrong {
        let mut bench = with_mailbox();
        for (number, (start, len, control)) in (0..).zip(set) {
            bench.channel(0x1000, number, start, len, control);
        }
        let answer = bench.request(0x1000, AlState::PreOp, false);
        assert_eq!(answer, (AlState::Init, true, 0x16), "{set:X?}");
    }
    let mut bench = with_mailbox();
    assert_eq!(bench.request(0x1000, AlState::PreOp, false).2, 0x16, "none");
    bench.request(0x1000, AlState::Init, true);
    for (number, (start, len, control)) in (0..).zip(right) {
        bench.channel(0x1000, number, start, len, control);
    }
    let answer = bench.request(0x1000, AlState::PreOp, false);
    assert_eq!(answer, (AlState::PreOp, false, 0));
}

#[test]
fn process_data_must_match_address_and_length() {
    for (outputs, inputs, code) in [
        (None, Some((0x1080, 1, 0x20)), 0x1D),
        (Some((0x1000, 2, 0x64)), Some((0x1080, 1, 0x20)), 0x1D),
        (Some((0x1001, 1, 0x64)), Some((0x1080, 1, 0x20)), 0x1D),
        (Some((0x1000, 1, 0x20)), Some((0x1080, 1, 0x20)), 0x1D),
        (Some((0x1000, 1, 0x64)), None, 0x1E),
        (Some((0x1000, 1, 0x64)), Some((0x1080, 1, 0x24)), 0x1E),
        (Some((0x1000, 1, 0x64)), Some((0x1080, 1, 0x20)), 0),
    ] {
        let (mut bench, _) = Bench::small();
        for (number, set) in (0..).zip([outputs, inputs]) {
            if let Some((start, len, control)) = set {
                bench.channel(0x1002, number, start, len, control);
            }
        }
        bench.request(0x1002, AlState::PreOp, false);
        let answer = bench.request(0x1002, AlState::SafeOp, false);
        assert_eq!(answer.2, code, "{outputs:X?} {inputs:X?}");
    }
}

#[test]
fn op_requires_outputs_within_timeout() {
    let (mut bench, _) = Bench::small();
    bench.map_terminal();
    bench.request(0x1002, AlState::PreOp, false);
    bench.request(0x1002, AlState::SafeOp, false);
    assert_eq!(
        bench.request(0x1002, AlState::Op, false),
        (AlState::SafeOp, false, 0),
        "waits"
    );
    bench.logical(Command::Lrw, 0, &[0, 0]);
    bench.now += MS;
    assert_eq!(bench.al(0x1002), (AlState::Op, false, 0));
    bench.request(0x1002, AlState::PreOp, false);
    bench.request(0x1002, AlState::SafeOp, false);
    bench.request(0x1002, AlState::Op, false);
    bench.now += 300 * MS;
    assert_eq!(bench.al(0x1002), (AlState::SafeOp, true, 0x19));
}

#[test]
fn injected_faults_refuse_states_and_fall_back() {
    let (mut bench, _) = Bench::small();
    let slave = bench.segment.slave(2).unwrap();
    slave.refuse(Some((AlState::SafeOp, AlStatusCode(0x0060))));
    bench.map_terminal();
    bench.request(0x1002, AlState::PreOp, false);
    assert_eq!(
        bench.request(0x1002, AlState::SafeOp, false),
        (AlState::PreOp, true, 0x60)
    );
    bench.segment.slave(2).unwrap().refuse(None);
    assert_eq!(
        bench.request(0x1002, AlState::SafeOp, true),
        (AlState::SafeOp, false, 0)
    );
    bench.logical(Command::Lrw, 0, &[0, 0]);
    bench.request(0x1002, AlState::Op, false);
    let slave = bench.segment.slave(2).unwrap();
    slave.fall(AlState::SafeOp, AlStatusCode(0x0001));
    assert_eq!(bench.al(0x1002), (AlState::SafeOp, true, 1));
    // Its outputs are switched off: the working counter of the master drops.
    assert_eq!(bench.logical(Command::Lrw, 0, &[0, 0]).counter, 1);
    assert_eq!(
        bench.request(0x1002, AlState::SafeOp, true),
        (AlState::SafeOp, false, 0)
    );
    assert_eq!(bench.logical(Command::Lrw, 0, &[0, 0]).counter, 3);
    assert_eq!(
        bench.request(0x1002, AlState::Op, false),
        (AlState::Op, false, 0)
    );
}

#[test]
fn outputs_are_zero_outside_of_op() {
    let (mut bench, io) = Bench::small();
    bench.operate();
    bench.logical(Command::Lrw, 0, &[0x55, 0]);
    bench.now += MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x55]);
    bench.request(0x1002, AlState::SafeOp, false);
    bench.logical(Command::Lrw, 0, &[0x55, 0]);
    bench.now += MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0]);
}

/// A coupler and a terminal of 8 outputs and 8 inputs, whose controllers answer AL control by themselves.
fn emulated() -> (Bench, Io) {
    let (terminal, io) = Io::digital(8, 8);
    let mut bench = Bench::new([Coupler::slave(), Coupler::slave(), terminal]);
    bench.address();
    (bench, io)
}

#[test]
fn device_emulation_shows_al_control_as_it_is() {
    let (mut bench, _) = emulated();
    assert_eq!(
        bench.read::<2>(0x1002, register::PDI_CONTROL),
        [4, 1],
        "digital I/O, device emulation"
    );
    for control in [0x11_u16, 0x12, 0x01, 0x02, 0x14, 0x08, 0x03, 0x31] {
        bench.write(0x1002, register::AL_CONTROL, &control.to_le_bytes());
        for _ in 0..3 {
            let shown = bench.read::<6>(0x1002, register::AL_STATUS);
            let [low, high] = control.to_le_bytes();
            assert_eq!(shown, [low, high, 0, 0, 0, 0], "{control:04X}h, for good");
            bench.now += 500 * MS;
        }
    }
}

#[test]
fn device_emulation_exchanges_in_any_state_and_outputs_work_in_op() {
    let (mut bench, io) = emulated();
    bench.map_terminal();
    bench.segment.poll(bench.now + 2 * MS);
    assert_eq!(
        bench.logical(Command::Lrw, 0, &[0x55, 0]).counter,
        3,
        "in INIT"
    );
    bench.segment.poll(bench.now + 2 * MS);
    assert!(io.outputs().iter().all(|byte| *byte == 0));
    bench.write(0x1002, register::AL_CONTROL, &[8, 0]);
    bench.logical(Command::Lrw, 0, &[0x55, 0]);
    bench.now += 2 * MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x55]);
}

#[test]
fn device_emulation_watchdog_clears_outputs_and_stays_in_op() {
    let (mut bench, io) = emulated();
    bench.map_terminal();
    bench.write(0x1002, register::AL_CONTROL, &[8, 0]);
    bench.logical(Command::Lrw, 0, &[0x55, 0]);
    bench.now += 2 * MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x55]);
    bench.now += 200 * MS;
    bench.segment.poll(bench.now);
    assert_eq!(bench.al(0x1002), (AlState::Op, false, 0));
    assert_eq!(bench.read::<1>(0x1002, register::WATCHDOG_STATUS), [0]);
    assert_eq!(
        (bench.read::<1>(0x1002, 0x0442), io.outputs()),
        ([1], vec![0])
    );
    bench.logical(Command::Lrw, 0, &[0x55, 0]);
    bench.now += 2 * MS;
    bench.segment.poll(bench.now);
    assert_eq!(io.outputs(), [0x55], "as soon as outputs come again");
}

#[test]
fn al_control_unread_by_firmware_takes_no_write() {
    let sii = SiiImage {
        mailbox_len: 128,
        coe: 0x01,
        ..SiiImage::default()
    };
    let config = SlaveConfig {
        times: Times {
            al_read: Some(Span::exactly(7 * MS)),
            ..Times::default()
        },
        ..SlaveConfig::new(sii)
    };
    let mut bench = Bench::new([Slave::new(config, Box::new(Plain))]);
    bench.address();
    bench.write(0x1000, register::AL_CONTROL, &[0x11, 0]);
    for command in [Command::Fpwr, Command::Bwr] {
        let answer = bench.device(command, 0x1000, register::AL_CONTROL, &[2, 0]);
        assert_eq!(answer.counter, 0, "{command:?}");
    }
    assert_eq!(bench.al(0x1000).0, AlState::Init, "its state can be read");
    bench.now += 7 * MS;
    bench.write(0x1000, register::AL_CONTROL, &[0x11, 0]);
}
