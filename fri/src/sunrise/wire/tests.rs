//! Messages against golden bytes, foreign encodings of the same schema, and the property that nothing is lost.
#![expect(clippy::indexing_slicing, reason = "a test may fail anywhere")]

use super::*;
use crate::error::{DecodeError, EncodeError};
use crate::generation::Kind;
use crate::lwr::wire::{Cmd, Msr};
use crate::sunrise::AXES;
use proptest::prelude::*;

const Q: Joints = [0.25, -0.5, 1.0, -1.5, 0.0, 2.0, -0.125];

/// Little-endian bytes of `values`, each after `key` if there is one.
fn doubles(key: Option<u8>, values: &[f64]) -> Vec<u8> {
    let one = |value: &f64| {
        key.into_iter()
            .chain(value.to_le_bytes())
            .collect::<Vec<_>>()
    };
    values.iter().flat_map(one).collect()
}

/// A length-delimited field of fewer than 128 bytes.
fn field(tag: u8, content: &[u8]) -> Vec<u8> {
    let len = u8::try_from(content.len()).unwrap();
    assert!(len < 128);
    [&[tag << 3 | 2, len], content].concat()
}

/// The header of a monitoring message with sequence 300 and reflected 2, byte for byte.
const MONITORING_HEADER: [u8; 12] = [
    0x0a, 0x0a, 0x08, 0xc2, 0xa2, 0x91, 0x01, 0x10, 0xac, 0x02, 0x18, 0x02,
];

/// The header of a command message with sequence 2 and reflected 300, byte for byte.
const COMMAND_HEADER: [u8; 11] = [
    0x0a, 0x09, 0x08, 0x81, 0x80, 0x0d, 0x10, 0x02, 0x18, 0xac, 0x02,
];

fn encode_command(command: &Command) -> Vec<u8> {
    let mut buf = [0xaa; MESSAGE_MAX];
    let len = command.encode(&mut buf).unwrap();
    buf[..len].to_vec()
}

fn encode(monitoring: &Monitoring) -> Vec<u8> {
    let mut buf = [0xaa; 4 * MESSAGE_MAX];
    let len = monitoring.encode(&mut buf).unwrap();
    buf[..len].to_vec()
}

fn header(sequence: u32, reflected: u32) -> Header {
    Header {
        sequence,
        reflected,
    }
}

/// What a controller of FRI 1.x reports without I/O, in a COMMANDING state or not.
fn typical(is_commanding: bool) -> Monitoring {
    Monitoring {
        header: header(100, 99),
        robot: Some(RobotInfo {
            joints: Some(7),
            safety: Some(Safety::Normal),
            drives: Some([Drive::Active; AXES]),
            operation_mode: Some(OperationMode::Aut),
            control_mode: Some(ControlMode::Position),
        }),
        monitor: Some(MonitorData {
            measured: Some(Q),
            torque: Some(Q),
            commanded: Some(Q),
            commanded_torque: Some(Q),
            external_torque: Some(Q),
            stamp: Some(TimeStamp {
                seconds: 1_700_000_000,
                nanoseconds: 500_000_000,
            }),
            ..MonitorData::default()
        }),
        connection: Some(ConnectionInfo {
            state: SessionState::MonitoringReady,
            quality: Quality::Excellent,
            send_period_ms: Some(5),
            receive_multiplier: Some(1),
        }),
        ipo: is_commanding.then_some(IpoData {
            joints: Some(Q),
            command_mode: Some(CommandMode::Position),
            overlay: Some(Overlay::Joint),
            tracking: Some(1.0),
            ..IpoData::default()
        }),
        ..Monitoring::default()
    }
}

// ---------------------------------------------------------------------------------------------------- golden bytes

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn monitoring_v1_matches_golden_bytes() {
    let golden = [
        &MONITORING_HEADER[..],
        // robotInfo: 7 joints, stop 1, two kinds of drive states, T2, joint impedance
        &field(
            2,
            &[
                0x08, 7, 0x10, 2, 0x28, 2, 0x28, 2, 0x28, 1, 0x28, 0, 0x28, 2, 0x28, 2, 0x28, 2,
                0x30, 1, 0x38, 2,
            ],
        ),
        // monitorData: measuredJointPosition, timestamp
        &field(
            3,
            &[
                field(1, &doubles(Some(0x09), &Q)),
                field(15, &[0x08, 0x80, 0x01, 0x10, 5]),
            ]
            .concat(),
        ),
        // connectionInfo: COMMANDING_ACTIVE, EXCELLENT, 2 ms, every 3rd
        &field(4, &[0x08, 4, 0x10, 3, 0x18, 2, 0x20, 3]),
        // ipoData: jointPosition, TORQUE, joint overlay, trackingPerformance 0.5
        &field(
            5,
            &[
                &field(1, &doubles(Some(0x09), &Q))[..],
                &[0x50, 3, 0x58, 1, 0x61],
                &0.5_f64.to_le_bytes(),
            ]
            .concat(),
        ),
        // requestedTransformations: one name
        &field(6, &field(1, b"PlanetFrame")),
        // endOfMessageData: messageLength 7, crc32 1
        &field(15, &[&[0x08, 7][..], &field(2, &[0x08, 1])].concat()),
    ]
    .concat();
    let message = Monitoring::decode(&golden).unwrap();
    assert_eq!(message.header, header(300, 2));
    let robot = message.robot.unwrap();
    assert_eq!(
        (robot.safety, robot.operation_mode),
        (Some(Safety::Stop1), Some(OperationMode::T2))
    );
    assert_eq!(
        robot.drives.unwrap()[2..4],
        [Drive::Transitioning, Drive::Off]
    );
    assert_eq!(robot.control_mode, Some(ControlMode::JointImpedance));
    let monitor = message.monitor.unwrap();
    assert_eq!((monitor.measured, monitor.torque), (Some(Q), None));
    assert_eq!(
        monitor.stamp,
        Some(TimeStamp {
            seconds: 128,
            nanoseconds: 5
        })
    );
    let connection = message.connection.unwrap();
    assert_eq!(
        (connection.send_period_ms, connection.receive_multiplier),
        (Some(2), Some(3))
    );
    assert_eq!(
        (message.state(), message.quality()),
        (SessionState::CommandingActive, Quality::Excellent)
    );
    let ipo = message.ipo.unwrap();
    assert_eq!(
        (ipo.joints, message.command_mode(), ipo.tracking),
        (Some(Q), CommandMode::Torque, Some(0.5))
    );
    assert!(message.requested[0].name.is("PlanetFrame"));
    assert_eq!(
        message.end,
        Some(EndOf {
            length: Some(7),
            crc32: Some(1)
        })
    );
    assert_eq!(encode(&message), golden);
    assert_eq!(
        message.to_string(),
        "MON seq 300 refl 2 COMMANDING_ACTIVE EXCELLENT T 2 ms x3 stop-1 T2 joint-impedance wants torque \
         q [0.2500 -0.5000 1.0000 -1.5000 0.0000 2.0000 -0.1250] rad"
    );
}

#[test]
fn monitoring_v3_matches_golden_bytes() {
    let pose = [10.0, 20.0, 30.0, 1.0, 0.0, 0.0, 0.0];
    let quaternion = [field(1, b"tcp"), field(2, &doubles(None, &pose))].concat();
    let redundancy = [&[0x08, 0, 0x11][..], &0.75_f64.to_le_bytes()].concat();
    let io = [&field(1, b"Media.Light")[..], &[0x10, 0, 0x18, 1, 0x20, 1]].concat();
    let force = field(
        6,
        &field(1, &doubles(None, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
    );
    let inner = [
        force,
        field(8, &io),
        field(9, &quaternion),
        field(10, &redundancy),
    ]
    .concat();
    let len = inner.len();
    assert!((128..1 << 14).contains(&len));
    let long = [
        0x1a,
        u8::try_from(len & 0x7f).unwrap() | 0x80,
        u8::try_from(len >> 7).unwrap(),
    ];
    let golden = [&MONITORING_HEADER[..], &long, &inner].concat();
    let data = Monitoring::decode(&golden).unwrap().monitor.unwrap();
    assert_eq!(data.external_force, Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    assert_eq!(
        (data.ios[0].name.to_string(), data.ios[0].digital),
        ("Media.Light".into(), Some(1))
    );
    assert_eq!(
        (data.ios[0].kind, data.ios[0].direction),
        (IoType::Boolean, IoDirection::Output)
    );
    assert_eq!(
        data.pose.unwrap().placement,
        Some(Placement::Quaternion(pose))
    );
    let expected = Redundancy {
        strategy: RedundancyStrategy::E1,
        value: 0.75,
    };
    assert_eq!(data.redundancy, Some(expected));
    assert_eq!(encode(&Monitoring::decode(&golden).unwrap()), golden);
}

#[test]
fn command_matches_golden_bytes() {
    let joints = field(1, &doubles(Some(0x09), &Q));
    let wrench_values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let wrench = field(2, &field(1, &doubles(None, &wrench_values)));
    let io = field(
        5,
        &[
            &field(1, b"A.b")[..],
            &[0x10, 2, 0x18, 1, 0x29],
            &2.5_f64.to_le_bytes(),
        ]
        .concat(),
    );
    let golden = [&COMMAND_HEADER[..], &field(2, &joints)].concat();
    let command = Command::decode(&golden).unwrap();
    assert_eq!(
        (command.header, command.data.unwrap().joints),
        (header(2, 300), Some(Q))
    );
    assert_eq!(encode_command(&command), golden);
    assert_eq!(
        command.to_string(),
        "COM seq 2 refl 300 q [0.2500 -0.5000 1.0000 -1.5000 0.0000 2.0000 -0.1250] rad"
    );
    let golden = [&COMMAND_HEADER[..], &field(2, &[wrench, io].concat())].concat();
    let command = Command::decode(&golden).unwrap();
    let data = command.data.unwrap();
    assert_eq!(
        (data.wrench, data.ios[0].analog),
        (Some(wrench_values), Some(2.5))
    );
    assert_eq!(encode_command(&command), golden);
    assert_eq!(
        command.to_string(),
        "COM seq 2 refl 300 wrench [1.0000 2.0000 3.0000 4.0000 5.0000 6.0000] N, Nm A.b"
    );
    let matrix = [0.5; 12];
    let frame = field(
        4,
        &[
            field(1, b"f"),
            field(2, &doubles(None, &matrix)),
            field(3, &[0x08, 1, 0x10, 2]),
        ]
        .concat(),
    );
    let golden = [&COMMAND_HEADER[..], &field(2, &frame)].concat();
    let command = Command::decode(&golden).unwrap();
    let transformation = command.data.unwrap().transformations[0];
    assert_eq!(transformation.placement, Some(Placement::Matrix(matrix)));
    assert_eq!(encode_command(&command), golden);
}

/// The lengths that clients and controllers of 1.x were measured to send.
#[test]
fn message_lengths_match_measured_ones() {
    let command = |data| {
        let header = header(200, 200);
        encode_command(&Command {
            header,
            data,
            end: None,
        })
        .len()
    };
    let position = CommandData {
        joints: Some(Q),
        ..CommandData::default()
    };
    assert_eq!(command(None), 12);
    assert_eq!(command(Some(position)), 79);
    assert_eq!(
        command(Some(CommandData {
            torque: Some(Q),
            ..position
        })),
        145
    );
    assert_eq!(
        command(Some(CommandData {
            wrench: Some([1.0; 6]),
            ..position
        })),
        131
    );
    assert!((385..=391).contains(&encode(&typical(false)).len()));
    assert!((466..=469).contains(&encode(&typical(true)).len()));
}

// -------------------------------------------------------------------------------------------- what else is accepted

#[test]
fn message_packed_and_unpacked_decode_alike() {
    let packed = field(1, &field(1, &doubles(None, &Q)));
    let split = [
        field(1, &doubles(None, &Q[..3])),
        doubles(Some(0x09), &Q[3..]),
    ]
    .concat();
    let vector = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let unpacked_vector = field(2, &doubles(Some(0x09), &vector));
    for joints in [packed, field(1, &split)] {
        let bytes = [&COMMAND_HEADER[..], &field(2, &joints)].concat();
        assert_eq!(
            Command::decode(&bytes).unwrap().data.unwrap().joints,
            Some(Q)
        );
    }
    let bytes = [&COMMAND_HEADER[..], &field(2, &unpacked_vector)].concat();
    assert_eq!(
        Command::decode(&bytes).unwrap().data.unwrap().wrench,
        Some(vector)
    );
    let drives = field(2, &field(5, &[2, 2, 1, 0, 2, 2, 2]));
    let bytes = [&MONITORING_HEADER[..], &drives].concat();
    let drives = Monitoring::decode(&bytes)
        .unwrap()
        .robot
        .unwrap()
        .drives
        .unwrap();
    assert_eq!(
        drives[1..4],
        [Drive::Active, Drive::Transitioning, Drive::Off]
    );
}

#[test]
fn message_unknown_skipped_missing_is_none() {
    let unknown = [
        &[0x80, 0x7d, 5, 0x75, 1, 2, 3, 4, 0x71][..],
        &[0; 8],
        &field(13, b"new"),
    ]
    .concat();
    let bytes = [
        &unknown[..],
        &MONITORING_HEADER,
        &field(3, &unknown),
        &field(5, &unknown),
        &unknown,
    ]
    .concat();
    let message = Monitoring::decode(&bytes).unwrap();
    assert_eq!(message.monitor, Some(MonitorData::default()));
    assert_eq!(message.ipo, Some(IpoData::default()));
    assert_eq!((message.robot, message.connection), (None, None));
    assert_eq!(
        (message.state(), message.quality()),
        (SessionState::Idle, Quality::Poor)
    );
    let empty = [&MONITORING_HEADER[..], &field(3, &field(1, &[]))].concat();
    assert_eq!(Monitoring::decode(&empty).unwrap().measured(), None);
}

#[test]
fn message_schema_violation_is_named() {
    let decode = |parts: &[&[u8]]| Monitoring::decode(&parts.concat()).unwrap_err().to_string();
    assert_eq!(decode(&[]), "required field header is missing");
    assert_eq!(
        decode(&[&field(1, &[0x08, 0xc2, 0xa2, 0x91, 0x01, 0x10, 1])]),
        "required field reflectedSequenceCounter is missing"
    );
    assert_eq!(
        decode(&[&COMMAND_HEADER]),
        "messageIdentifier 0x34001, expected 0x245142: another direction or version"
    );
    assert_eq!(
        decode(&[
            &MONITORING_HEADER,
            &field(3, &field(1, &doubles(Some(0x09), &Q[..6])))
        ]),
        "6 values of measuredJointPosition, expected 7"
    );
    assert_eq!(
        decode(&[
            &MONITORING_HEADER,
            &field(3, &field(1, &field(1, &doubles(None, &[0.0; 8]))))
        ]),
        "more than 7 values or bytes of measuredJointPosition"
    );
    assert_eq!(
        decode(&[&MONITORING_HEADER, &field(2, &[0x28, 1])]),
        "1 values of driveState, expected 7"
    );
    assert_eq!(
        decode(&[&MONITORING_HEADER, &field(4, &[0x08, 1])]),
        "required field quality is missing"
    );
    assert_eq!(
        decode(&[&MONITORING_HEADER, &[0x18, 1]]),
        "protobuf wire type 0 at offset 12 does not fit the schema"
    );
    assert_eq!(
        decode(&[&MONITORING_HEADER, &field(6, &field(1, &[b'x'; 64]))]),
        "more than 63 values or bytes of Transformation.name"
    );
    let six = field(6, &field(1, b"f")).repeat(6);
    assert_eq!(
        decode(&[&MONITORING_HEADER, &six]),
        "more than 5 values or bytes of requestedTransformations"
    );
}

// ------------------------------------------------------------------------------------------------ frames and dialects

#[test]
fn frame_v3_matches_golden_bytes() {
    let mut buf = [0xaa; 64];
    let command = Command {
        header: header(2, 300),
        ..Command::default()
    };
    let len = Dialect::V3
        .frame(&mut buf, |buf| command.encode(buf))
        .unwrap();
    // The checksum is that of zlib.crc32 over the eleven bytes of the header.
    let crc = crc32fast::hash(&COMMAND_HEADER).to_le_bytes();
    let golden = [&[11, 0, 0, 0][..], &COMMAND_HEADER, &crc].concat();
    assert_eq!(buf[..len], golden);
    assert_eq!(unframe(&golden), Ok((true, &COMMAND_HEADER[..])));
    assert_eq!(unframe(&COMMAND_HEADER), Ok((false, &COMMAND_HEADER[..])));
    let bare = Dialect::V1
        .frame(&mut buf, |buf| command.encode(buf))
        .unwrap();
    assert_eq!(buf[..bare], COMMAND_HEADER);
    let mut damaged = golden.clone();
    damaged[7] ^= 1;
    assert!(matches!(
        unframe(&damaged),
        Err(DecodeError::Checksum { .. })
    ));
    assert_eq!(
        unframe(&golden[..18]),
        Err(DecodeError::NoMessage { actual: 18 })
    );
    for short in 0..len {
        let refused = Dialect::V3.frame(&mut buf[..short], |buf| command.encode(buf));
        assert!(
            matches!(refused, Err(EncodeError::Buffer { .. })),
            "{short}"
        );
    }
}

#[test]
fn frame_checksum_is_ieee_802_3() {
    assert_eq!(crc32fast::hash(b"123456789"), 0xcbf4_3926);
}

#[test]
fn dialect_is_detected_from_message() {
    let v1 = typical(true);
    let mut v2 = v1;
    v2.monitor.as_mut().unwrap().commanded = None;
    let mut silent = v1;
    silent.monitor = None;
    assert_eq!(Dialect::of(false, &v1), Some(Dialect::V1));
    assert_eq!(Dialect::of(false, &v2), Some(Dialect::V2));
    assert_eq!(Dialect::of(true, &v2), Some(Dialect::V3));
    assert_eq!(Dialect::of(false, &silent), None);
}

#[test]
fn kind_of_every_datagram_is_detected() {
    let mut buf = [0; Msr::LEN];
    Cmd::default().encode(&mut buf).unwrap();
    assert_eq!(Kind::of(&buf[..Cmd::LEN]), Kind::LwrCommand);
    buf[4..8].copy_from_slice(&[0x94, 0x03, 0x06, 0x20]);
    assert_eq!(Kind::of(&buf), Kind::LwrMeasurement);
    for (dialect, is_framed) in [(Dialect::V2, false), (Dialect::V3, true)] {
        let len = dialect
            .frame(&mut buf, |buf| typical(true).encode(buf))
            .unwrap();
        assert_eq!(Kind::of(&buf[..len]), Kind::SunriseMonitoring { is_framed });
        let command = Command::default();
        let len = dialect.frame(&mut buf, |buf| command.encode(buf)).unwrap();
        assert_eq!(Kind::of(&buf[..len]), Kind::SunriseCommand { is_framed });
    }
    assert_eq!(Kind::of(b"hello"), Kind::Unknown);
    assert_eq!(Kind::of(&[]), Kind::Unknown);
}

// -------------------------------------------------------------------------------------------------------- properties

fn joints() -> impl Strategy<Value = Option<Joints>> {
    prop::option::of(prop::array::uniform7(-10.0..10.0))
}

fn name() -> impl Strategy<Value = Name> {
    "[ -~]{0,63}".prop_map(|text| Name::new(&text).unwrap())
}

fn list<T: Copy + Default + fmt::Debug, const N: usize>(
    item: impl Strategy<Value = T>,
) -> impl Strategy<Value = List<T, N>> {
    prop::collection::vec(item, 0..=N).prop_map(|items| {
        let mut list = List::new();
        for item in items {
            list.push(item).unwrap();
        }
        list
    })
}

fn transformation() -> impl Strategy<Value = Transformation> {
    let placement = prop_oneof![
        prop::array::uniform12(-1e3..1e3).prop_map(Placement::Matrix),
        prop::array::uniform7(-1e3..1e3).prop_map(Placement::Quaternion),
    ];
    let stamp =
        prop::option::of(
            any::<(u32, u32)>().prop_map(|(seconds, nanoseconds)| TimeStamp {
                seconds,
                nanoseconds,
            }),
        );
    (name(), prop::option::of(placement), stamp).prop_map(|(name, placement, stamp)| {
        Transformation {
            name,
            placement,
            stamp,
        }
    })
}

fn io() -> impl Strategy<Value = IoValue> {
    (
        name(),
        any::<(i32, i32)>(),
        any::<Option<u64>>(),
        prop::option::of(-1e9..1e9),
    )
        .prop_map(|(name, (kind, direction), digital, analog)| IoValue {
            name,
            kind: kind.into(),
            direction: direction.into(),
            digital,
            analog,
        })
}

fn redundancy() -> impl Strategy<Value = Option<Redundancy>> {
    prop::option::of(
        (any::<i32>(), -3.0..3.0).prop_map(|(strategy, value)| Redundancy {
            strategy: strategy.into(),
            value,
        }),
    )
}

fn command() -> impl Strategy<Value = Command> {
    let data = (
        joints(),
        prop::option::of(prop::array::uniform6(-1e3..1e3)),
        joints(),
        list(transformation()),
        list(io()),
        prop::option::of(transformation()),
        redundancy(),
    )
        .prop_map(
            |(joints, wrench, torque, transformations, ios, pose, redundancy)| CommandData {
                joints,
                wrench,
                torque,
                transformations,
                ios,
                pose,
                redundancy,
            },
        );
    (
        any::<(u32, u32)>(),
        prop::option::of(data),
        any::<Option<(Option<i32>, Option<i32>)>>(),
    )
        .prop_map(|((sequence, reflected), data, end)| Command {
            header: header(sequence, reflected),
            data,
            end: end.map(|(length, crc32)| EndOf { length, crc32 }),
        })
}

fn monitoring() -> impl Strategy<Value = Monitoring> {
    let data = (
        joints(),
        joints(),
        joints(),
        list(io()),
        prop::option::of(transformation()),
        redundancy(),
    )
        .prop_map(
            |(measured, commanded, external_torque, ios, pose, redundancy)| MonitorData {
                measured,
                commanded,
                external_torque,
                ios,
                pose,
                redundancy,
                ..MonitorData::default()
            },
        );
    let connection = any::<(i32, i32, Option<u32>, Option<u32>)>().prop_map(
        |(state, quality, period, times)| ConnectionInfo {
            state: state.into(),
            quality: quality.into(),
            send_period_ms: period,
            receive_multiplier: times,
        },
    );
    let robot = any::<(Option<i32>, Option<[i32; AXES]>, Option<i32>)>().prop_map(
        |(joints, drives, mode)| RobotInfo {
            joints,
            drives: drives.map(|drives| drives.map(Drive::from)),
            operation_mode: mode.map(Into::into),
            ..RobotInfo::default()
        },
    );
    let ipo = (joints(), any::<Option<i32>>(), prop::option::of(0.0..1.0)).prop_map(
        |(joints, mode, tracking)| IpoData {
            joints,
            command_mode: mode.map(Into::into),
            tracking,
            ..IpoData::default()
        },
    );
    let parts = (
        prop::option::of(robot),
        prop::option::of(data),
        prop::option::of(connection),
        prop::option::of(ipo),
    );
    (any::<(u32, u32)>(), parts, list(transformation())).prop_map(
        |((sequence, reflected), (robot, monitor, connection, ipo), requested)| Monitoring {
            header: header(sequence, reflected),
            robot,
            monitor,
            connection,
            ipo,
            requested,
            end: None,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn command_roundtrip(command in command()) {
        let mut buf = [0; 4 * MESSAGE_MAX];
        let len = command.encode(&mut buf).unwrap();
        prop_assert_eq!(Command::decode(&buf[..len]), Ok(command));
    }

    #[test]
    fn monitoring_roundtrip_framed_and_bare(monitoring in monitoring()) {
        let mut buf = [0; 4 * MESSAGE_MAX];
        for dialect in [Dialect::V1, Dialect::V3] {
            let len = dialect.frame(&mut buf, |buf| monitoring.encode(buf)).unwrap();
            let (is_framed, message) = unframe(&buf[..len]).unwrap();
            prop_assert_eq!(is_framed, dialect.is_framed());
            prop_assert_eq!(Monitoring::decode(message), Ok(monitoring));
        }
    }

    #[test]
    fn message_any_bytes_accepted_or_rejected(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        fuzz(&bytes);
    }

    #[test]
    fn message_damaged_accepted_or_rejected(monitoring in monitoring(), at in any::<prop::sample::Index>(), to in any::<u8>()) {
        let mut bytes = encode(&monitoring);
        let cut = at.index(bytes.len());
        bytes[cut] = to;
        fuzz(&bytes);
        fuzz(&bytes[..cut]);
    }
}
