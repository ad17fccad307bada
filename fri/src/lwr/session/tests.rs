//! Every transition of the session, one cell of the table per row. Loss and time with a real peer: tests/lwr_behaviour.rs.

use super::*;
use crate::lwr::wire::{Control, Interface, Robot, Statistics};

const MS: Duration = Duration::from_millis(1);
const PERIOD: Duration = Duration::from_millis(2);

/// A measurement with set-point 0.5 + 0.25 rad in every joint.
fn msr(sequence: u16, state: State, power: u16) -> [u8; Msr::LEN] {
    let msr = Msr {
        header: Header {
            sequence,
            reflected: 0,
        },
        krl: Krl::default(),
        interface: Interface {
            timestamp_s: 0.0,
            state,
            quality: Quality::Perfect,
            msr_period_s: 0.002,
            cmd_period_s: 0.002,
            safety_scale: 1.0,
        },
        statistics: Statistics::default(),
        robot: Robot {
            power,
            control: Control::Position,
            error: 0,
            warning: 0,
            temperature: [0.0; AXES],
        },
        measured_joints: [0.0; AXES],
        measured_frame: [0.0; 12],
        commanded_joints: [0.5; AXES],
        joint_offset: [0.25; AXES],
        commanded_frame: [0.0; 12],
        frame_offset: [0.0; 12],
        measured_torque: [0.0; AXES],
        external_torque: [0.0; AXES],
        external_wrench: [0.0; 6],
        jacobian: [0.0; 42],
        mass_matrix: [0.0; 49],
        gravity: [0.0; AXES],
    };
    let mut bytes = [0; Msr::LEN];
    msr.encode(&mut bytes).unwrap();
    bytes
}

fn offline() -> Session {
    Session::new(SessionConfig::default())
}

/// Has received measurement 10 at time 0 and answered it.
fn monitor() -> Session {
    let mut session = offline();
    session
        .handle_datagram(&msr(10, State::Mon, 0x7f), Duration::ZERO)
        .unwrap();
    session.answer(None, &mut [0; Cmd::LEN]).unwrap();
    session
}

/// Has received measurement 10 at time 0 and answered it with 0.76 rad.
fn command() -> Session {
    let mut session = offline();
    session
        .handle_datagram(&msr(10, State::Cmd, 0x7f), Duration::ZERO)
        .unwrap();
    session
        .answer(Some(&[0.76; AXES]), &mut [0; Cmd::LEN])
        .unwrap();
    session
}

/// Offline after a silence.
fn lost() -> Session {
    let mut session = command();
    assert!(session.handle_timeout(PERIOD * 50));
    session
}

fn answer(session: &mut Session, joints: Option<f64>) -> Cmd {
    let mut buf = [0; Cmd::LEN];
    session
        .answer(joints.map(|value| [value; AXES]).as_ref(), &mut buf)
        .unwrap();
    Cmd::decode(&buf).unwrap()
}

fn assert_joints(cmd: &Cmd, expected: f32) {
    assert!(
        cmd.joints
            .iter()
            .all(|joint| (joint - expected).abs() < 1e-6),
        "{cmd}"
    );
}

// ---- phase x state and power of the next measurement

/// A session, and where passive and active measurements lead it.
type Row = (fn() -> Session, [(Phase, Option<Event>); 2]);

#[test]
fn session_measurement_transitions_match_diagram() {
    use Event::{CommandEntered, CommandLeft, Online};
    use Phase::{Command, Monitor};
    let inputs = [
        (State::Off, 0x7f),
        (State::Mon, 0x7f),
        (State::Cmd, 0),
        (State::Other(7), 0x7f),
        (State::Cmd, 0x7f),
        (State::Cmd, 1),
    ];
    let rows: [Row; 4] = [
        (
            offline,
            [(Monitor, Some(Online)), (Command, Some(CommandEntered))],
        ),
        (monitor, [(Monitor, None), (Command, Some(CommandEntered))]),
        (command, [(Monitor, Some(CommandLeft)), (Command, None)]),
        (
            lost,
            [(Monitor, Some(Online)), (Command, Some(CommandEntered))],
        ),
    ];
    for (make, [passive, active]) in rows {
        for (index, (state, power)) in inputs.into_iter().enumerate() {
            let mut session = make();
            let got = session
                .handle_datagram(&msr(11, state, power), PERIOD)
                .unwrap();
            let (phase, event) = if index < 4 { passive } else { active };
            assert_eq!(
                (session.phase(), got.event),
                (phase, event),
                "{state} {power}"
            );
            assert_eq!((got.state, got.power), (state, power));
            assert_eq!(session.is_commanding(), phase == Command);
            assert!(session.is_pending());
        }
    }
}

#[test]
fn session_silence_in_any_phase_is_offline() {
    for make in [monitor, command] {
        let mut session = make();
        assert_eq!(session.poll_timeout(), Some(MS * 100));
        assert!(!session.handle_timeout(MS * 99));
        assert!(session.handle_timeout(MS * 100));
        assert_eq!(
            (session.phase(), session.poll_timeout()),
            (Phase::Offline, None)
        );
        assert!(!session.handle_timeout(MS * 200));
        assert_eq!(session.counters().silences, 1);
    }
    assert_eq!(offline().poll_timeout(), None);
    assert!(!offline().handle_timeout(MS * 1000));
}

#[test]
fn session_late_datagram_counts_as_silence() {
    let mut session = command();
    let got = session
        .handle_datagram(&msr(11, State::Cmd, 0x7f), MS * 100)
        .unwrap();
    assert_eq!(
        (got.order, got.event),
        (Order::First, Some(Event::CommandEntered))
    );
}

// ---- order of datagrams

#[test]
fn session_duplicates_and_old_are_ignored() {
    for (sequence, order) in [
        (10, Order::Duplicate),
        (9, Order::Old),
        (65000, Order::Restart),
    ] {
        let mut session = command();
        let got = session
            .handle_datagram(&msr(sequence, State::Mon, 0), PERIOD)
            .unwrap();
        assert_eq!(got.order, order);
        let ignored = order != Order::Restart;
        assert_eq!(session.is_commanding(), ignored);
        assert_eq!(session.is_pending(), !ignored);
        assert_eq!(session.counters().old, u64::from(ignored));
        assert_eq!(session.counters().restarts, u64::from(!ignored));
    }
}

#[test]
fn session_controller_restart_in_command_enters_again() {
    let mut session = command();
    let got = session
        .handle_datagram(&msr(65000, State::Cmd, 0x7f), PERIOD)
        .unwrap();
    assert_eq!(
        (got.order, got.event),
        (Order::Restart, Some(Event::CommandEntered))
    );
    assert_joints(&answer(&mut session, None), 0.75);
}

#[test]
fn session_lost_measurements_are_counted_by_gap() {
    let mut session = monitor();
    let got = session
        .handle_datagram(&msr(14, State::Mon, 0), PERIOD)
        .unwrap();
    assert_eq!((got.lost, got.order), (3, Order::Next { lost: 3 }));
    assert_eq!(
        (session.counters().lost, session.counters().received),
        (3, 2)
    );
}

#[test]
fn session_malformed_datagram_is_only_counted() {
    let mut session = command();
    assert!(session.handle_datagram(&[0; 12], PERIOD).is_err());
    assert_eq!(
        (session.counters().refused, session.phase()),
        (1, Phase::Command)
    );
}

// ---- answers

#[test]
fn session_answers_mirror_unless_commanding() {
    for (state, power) in [(State::Mon, 0x7f), (State::Cmd, 0)] {
        let mut session = command();
        session
            .handle_datagram(&msr(11, state, power), PERIOD)
            .unwrap();
        let cmd = answer(&mut session, Some(2.0));
        assert_joints(&cmd, 0.75);
        assert_eq!((cmd.flags, cmd.header.reflected), (CmdFlags::JNTPOS, 11));
    }
}

#[test]
fn session_command_starts_at_mirror_and_holds() {
    let mut session = monitor();
    session
        .handle_datagram(&msr(11, State::Cmd, 0x7f), PERIOD)
        .unwrap();
    assert!(
        session
            .mirror()
            .iter()
            .all(|joint| (joint - 0.75).abs() < 1e-9)
    );
    assert_joints(&answer(&mut session, None), 0.75);
    session
        .handle_datagram(&msr(12, State::Cmd, 0x7f), PERIOD * 2)
        .unwrap();
    assert_joints(&answer(&mut session, Some(0.8)), 0.8);
    session
        .handle_datagram(&msr(13, State::Cmd, 0x7f), PERIOD * 3)
        .unwrap();
    assert!(
        session
            .mirror()
            .iter()
            .all(|joint| (joint - 0.8).abs() < 1e-9)
    );
    assert_joints(&answer(&mut session, None), 0.8);
}

#[test]
fn session_measurement_gets_one_numbered_answer() {
    let mut session = Session::new(SessionConfig {
        first_sequence: u16::MAX,
        ..SessionConfig::default()
    });
    let buf = &mut [0; Cmd::LEN];
    assert_eq!(session.answer(None, buf), Err(AnswerError::NothingToAnswer));
    for (sequence, own) in [(10, u16::MAX), (11, 0), (12, 1)] {
        session
            .handle_datagram(&msr(sequence, State::Mon, 0), PERIOD)
            .unwrap();
        session.krl_mut().int[0] = i32::from(sequence);
        let cmd = answer(&mut session, None);
        assert_eq!((cmd.header.sequence, cmd.header.reflected), (own, sequence));
        assert_eq!(cmd.krl.int[0], i32::from(sequence));
        assert_eq!(session.answer(None, buf), Err(AnswerError::NothingToAnswer));
    }
    assert_eq!(session.counters().answered, 3);
    assert_eq!(lost().answer(None, buf), Err(AnswerError::NothingToAnswer));
}

#[test]
fn session_non_finite_command_is_rejected_and_retried() {
    let mut session = command();
    session
        .handle_datagram(&msr(11, State::Cmd, 0x7f), PERIOD)
        .unwrap();
    let mut joints = [0.76; AXES];
    joints[2] = f64::NAN;
    let refused = session.answer(Some(&joints), &mut [0; Cmd::LEN]);
    assert_eq!(refused, Err(AnswerError::NotFinite { joint: 2 }));
    assert!(matches!(
        session.answer(None, &mut [0; 3]),
        Err(AnswerError::Encode(_))
    ));
    assert_joints(&answer(&mut session, None), 0.76);
}

#[test]
fn session_extreme_period_is_clamped() {
    for (stated, expected) in [(f32::NAN, 1), (-1.0, 1), (0.012, 12), (f32::INFINITY, 100)] {
        let mut bytes = msr(1, State::Mon, 0);
        bytes[148..152].copy_from_slice(&stated.to_le_bytes());
        let mut session = offline();
        session.handle_datagram(&bytes, Duration::ZERO).unwrap();
        assert_eq!(session.period().unwrap().as_millis(), expected);
    }
}
