//! The codec against golden datagrams and random bytes. captures/README.md describes the goldens.
#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use proptest::prelude::*;
use takt_fri::error::{DecodeError, EncodeError};
use takt_fri::lwr::wire::{Cmd, CmdFlags, Control, Msr, Quality, State, fuzz};
use takt_tests::Random;

const MSR: &str = include_str!("captures/msr_layout.hex");
const MSR_UNKNOWN: &str = include_str!("captures/msr_unknown_codes.hex");
const CMD: &str = include_str!("captures/cmd_layout.hex");

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

/// Whether the values are the byte offsets from `offset` on.
fn are_offsets(values: &[f32], offset: usize) -> bool {
    let expected = (0..values.len()).map(|i| (offset + 4 * i) as f32);
    values
        .iter()
        .copied()
        .map(f32::to_bits)
        .eq(expected.map(f32::to_bits))
}

fn assert_offsets(fields: &[(&[f32], usize)]) {
    for (values, offset) in fields {
        assert!(
            are_offsets(values, *offset),
            "field at {offset}: {values:?}"
        );
    }
}

#[test]
fn msr_fields_lie_at_their_offsets() {
    let msr = Msr::decode(&bytes(MSR)).unwrap();
    assert_eq!(
        (msr.header.sequence, msr.header.reflected),
        (0x1234, 0xfedc)
    );
    assert_eq!(
        msr.krl.int,
        std::array::from_fn(|i| -(72 + 4 * i32::try_from(i).unwrap()))
    );
    assert_eq!(
        (msr.krl.bools, msr.krl.bool(0), msr.krl.bool(15)),
        (0x8001, true, true)
    );
    assert_eq!(
        (msr.interface.state, msr.interface.quality),
        (State::Cmd, Quality::Perfect)
    );
    assert_eq!(msr.statistics.miss_counter, 176);
    assert_eq!(
        (msr.robot.power, msr.robot.control),
        (0x7f, Control::Position)
    );
    assert_eq!((msr.robot.error, msr.robot.warning), (0x0102, 0x0304));
    let (interface, statistics) = (&msr.interface, &msr.statistics);
    assert_offsets(&[
        (&msr.krl.real, 8),
        (&[interface.timestamp_s], 140),
        (
            &[
                interface.msr_period_s,
                interface.cmd_period_s,
                interface.safety_scale,
            ],
            148,
        ),
        (&[statistics.answer_rate, statistics.latency_s], 160),
        (&[statistics.jitter_s, statistics.miss_rate], 168),
        (&msr.robot.temperature, 188),
        (&msr.measured_joints, 216),
        (&msr.measured_frame, 244),
        (&msr.commanded_joints, 292),
        (&msr.joint_offset, 320),
        (&msr.commanded_frame, 348),
        (&msr.frame_offset, 396),
        (&msr.measured_torque, 444),
        (&msr.external_torque, 472),
        (&msr.external_wrench, 500),
        (&msr.jacobian, 524),
        (&msr.mass_matrix, 692),
        (&msr.gravity, 888),
    ]);
    assert!((msr.set_point()[6] - f64::from(292 + 24 + 320 + 24)).abs() < 1e-9);
}

#[test]
fn cmd_fields_lie_at_their_offsets() {
    let cmd = Cmd::decode(&bytes(CMD)).unwrap();
    assert_eq!(
        (cmd.header.sequence, cmd.header.reflected),
        (0x1234, 0xfedc)
    );
    assert_eq!(cmd.krl.bools, 0x8001);
    assert!(
        cmd.flags
            .contains(CmdFlags::JNTPOS | CmdFlags::CARTPOS | CmdFlags::TCPFT)
    );
    assert_eq!(cmd.flags.bits(), 0x8000_3501);
    assert_offsets(&[
        (&cmd.krl.real, 8),
        (&cmd.joints, 144),
        (&cmd.frame, 172),
        (&cmd.joint_torque, 220),
        (&cmd.wrench, 248),
        (&cmd.joint_stiffness, 272),
        (&cmd.joint_damping, 300),
        (&cmd.cartesian_stiffness, 328),
        (&cmd.cartesian_damping, 352),
    ]);
}

#[test]
fn lwr_encode_matches_golden_bytes() {
    for golden in [MSR, MSR_UNKNOWN].map(bytes) {
        let mut buf = [0xaa; Msr::LEN + 1];
        assert_eq!(Msr::decode(&golden).unwrap().encode(&mut buf), Ok(Msr::LEN));
        assert_eq!((&buf[..Msr::LEN], buf[Msr::LEN]), (&golden[..], 0xaa));
    }
    let golden = bytes(CMD);
    let mut buf = [0xaa; Cmd::LEN];
    assert_eq!(Cmd::decode(&golden).unwrap().encode(&mut buf), Ok(Cmd::LEN));
    assert_eq!(buf[..], golden);
}

#[test]
fn datagrams_are_shown_in_one_line() {
    assert_eq!(
        Msr::decode(&bytes(MSR)).unwrap().to_string(),
        "MSR seq 4660 refl 65244 t 140.000 s CMD PERFECT T 148000 ms power 0x7f position error 0x0102 \
         warning 0x0304 answered 160.00 latency 164000.000 ms jitter 168000.000 ms missed 176 \
         q [216.0000 220.0000 224.0000 228.0000 232.0000 236.0000 240.0000] rad"
    );
    let unknown = Msr::decode(&bytes(MSR_UNKNOWN)).unwrap().to_string();
    assert!(
        unknown.contains("s ?65535 ?7 T") && unknown.contains("0x7f ?9 error"),
        "{unknown}"
    );
    assert_eq!(
        Cmd::decode(&bytes(CMD)).unwrap().to_string(),
        "CMD seq 4660 refl 65244 JNTPOS|CARTPOS|TCPFT|CARTSTIFF|CARTDAMP|0x80000000 \
         q [144.0000 148.0000 152.0000 156.0000 160.0000 164.0000 168.0000] rad"
    );
}

#[test]
fn lwr_decode_error_names_offset_and_values() {
    let golden = bytes(MSR);
    let with = |offset: usize, value: u8| {
        let mut changed = golden.clone();
        changed[offset] = value;
        Msr::decode(&changed).unwrap_err()
    };
    let length = |actual| DecodeError::Length {
        expected: 916,
        actual,
    };
    assert_eq!(Msr::decode(&golden[..915]), Err(length(915)));
    assert_eq!(Msr::decode(&[]), Err(length(0)));
    assert_eq!(
        Msr::decode(&[golden.clone(), vec![0]].concat()),
        Err(length(917))
    );
    let actual = 0x0395;
    assert_eq!(
        with(4, 0x95),
        DecodeError::PacketSize {
            expected: 916,
            actual,
            offset: 4
        }
    );
    let actual = 0x2007;
    let id = with(6, 0x07);
    assert_eq!(
        id,
        DecodeError::DatagramId {
            expected: 0x2006,
            actual,
            offset: 6
        }
    );
    assert!(
        id.to_string()
            .starts_with("datagramId 0x2007 at offset 6, expected 0x2006")
    );
    assert_eq!(
        Cmd::decode(&golden),
        Err(DecodeError::Length {
            expected: 376,
            actual: 916
        })
    );
}

#[test]
fn lwr_encode_short_buffer_is_left_untouched() {
    let mut buf = [0xaa; Cmd::LEN - 1];
    let refused = Err(EncodeError::Buffer {
        needed: 376,
        actual: 375,
    });
    assert_eq!(Cmd::default().encode(&mut buf), refused);
    assert_eq!(buf, [0xaa; Cmd::LEN - 1]);
}

#[test]
fn lwr_decode_hostile_inputs_do_not_panic() {
    let seeds = [bytes(MSR), bytes(CMD)];
    let mut random = Random::new(1);
    for round in 0..10_000 {
        let mut input = seeds[round % 2].clone();
        for _ in 0..random.below(8) {
            let at = random.below(input.len());
            input[at] = random.byte();
        }
        if random.below(4) == 0 {
            input.resize(random.below(1600), 0);
        }
        fuzz(&input);
    }
}

proptest! {
    /// Any content under a good header survives, bit for bit, but the fill that must be 0.
    #[test]
    fn msr_roundtrip(mut content in prop::collection::vec(any::<u8>(), Msr::LEN)) {
        content[4..8].copy_from_slice(&[0x94, 0x03, 0x06, 0x20]);
        content[138..140].fill(0);
        let mut again = [0; Msr::LEN];
        prop_assert_eq!(Msr::decode(&content).unwrap().encode(&mut again), Ok(Msr::LEN));
        prop_assert_eq!(&again[..], &content[..]);
    }

    #[test]
    fn cmd_roundtrip(mut content in prop::collection::vec(any::<u8>(), Cmd::LEN)) {
        content[4..8].copy_from_slice(&[0x78, 0x01, 0x05, 0x10]);
        content[138..140].fill(0);
        let mut again = [0; Cmd::LEN];
        prop_assert_eq!(Cmd::decode(&content).unwrap().encode(&mut again), Ok(Cmd::LEN));
        prop_assert_eq!(&again[..], &content[..]);
    }

    #[test]
    fn lwr_decode_any_bytes_do_not_panic(content in prop::collection::vec(any::<u8>(), 0..1000)) {
        fuzz(&content);
    }
}
