//! Every transition of the session and what each phase answers, one cell of the table per row. Loss and time with a real
//! peer: tests/sunrise_behaviour.rs.

use super::*;
use crate::guard::Breach;
use crate::sunrise::wire::{
    ConnectionInfo, IoDirection, IoType, IpoData, MESSAGE_MAX, MonitorData, Name, Placement,
    Redundancy, RedundancyStrategy,
};

const MS: Duration = Duration::from_millis(1);
const IPO: Joints = [0.5; AXES];
const COMMANDED: Joints = [0.25; AXES];
const MEASURED: Joints = [0.125; AXES];
const STATES: [SessionState; 6] = [
    SessionState::Idle,
    SessionState::MonitoringWait,
    SessionState::MonitoringReady,
    SessionState::CommandingWait,
    SessionState::CommandingActive,
    SessionState::Other(9),
];

/// A message of that state at 1 ms, with distinct measured, commanded and interpolated positions.
fn message(dialect: Dialect, sequence: u32, state: SessionState, mode: CommandMode) -> Monitoring {
    let io = |name, kind, direction| IoValue {
        name: Name::new(name).unwrap(),
        kind,
        direction,
        digital: (kind != IoType::Analog).then_some(3),
        analog: (kind == IoType::Analog).then_some(0.5),
    };
    let mut data = MonitorData {
        measured: Some(MEASURED),
        commanded: (dialect == Dialect::V1).then_some(COMMANDED),
        pose: (dialect != Dialect::V1).then(|| pose(1.0)),
        ..MonitorData::default()
    };
    for (name, kind, direction) in [
        ("G.in", IoType::Digital, IoDirection::Input),
        ("G.out", IoType::Boolean, IoDirection::Output),
        ("G.level", IoType::Analog, IoDirection::Output),
    ] {
        data.ios.push(io(name, kind, direction)).unwrap();
    }
    let mut message = Monitoring {
        header: Header {
            sequence,
            reflected: 0,
        },
        monitor: Some(data),
        connection: Some(ConnectionInfo {
            state,
            quality: Quality::Good,
            send_period_ms: Some(1),
            receive_multiplier: Some(1),
        }),
        ipo: Some(IpoData {
            joints: Phase::from(state).is_commanding().then_some(IPO),
            pose: (dialect != Dialect::V1).then(|| pose(2.0)),
            command_mode: Some(mode),
            ..IpoData::default()
        }),
        ..Monitoring::default()
    };
    let name = Name::new("Frame").unwrap();
    let requested = Transformation {
        name,
        ..Transformation::default()
    };
    message.requested.push(requested).unwrap();
    message
}

fn pose(x: f64) -> Transformation {
    Transformation {
        name: Name::new("tcp").unwrap(),
        placement: Some(Placement::Quaternion([x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])),
        stamp: None,
    }
}

fn bytes(dialect: Dialect, message: &Monitoring) -> Vec<u8> {
    let mut buf = [0; MESSAGE_MAX];
    let len = dialect.frame(&mut buf, |buf| message.encode(buf)).unwrap();
    buf[..len].to_vec()
}

/// A session and its last message.
struct Bench {
    session: Session,
    dialect: Dialect,
    mode: CommandMode,
    sequence: u32,
    now: Duration,
}

impl Bench {
    fn new(dialect: Dialect, mode: CommandMode) -> Self {
        Self {
            session: Session::new(SessionConfig::default()),
            dialect,
            mode,
            sequence: 0,
            now: Duration::ZERO,
        }
    }

    /// In that phase, all answered.
    fn at(phase: Phase, dialect: Dialect, mode: CommandMode) -> Self {
        let mut bench = Self::new(dialect, mode);
        let state = match phase {
            Phase::Offline => return bench,
            Phase::Idle => SessionState::Idle,
            Phase::MonitoringWait => SessionState::MonitoringWait,
            Phase::MonitoringReady => SessionState::MonitoringReady,
            Phase::CommandingWait => SessionState::CommandingWait,
            Phase::CommandingActive => SessionState::CommandingActive,
        };
        if phase == Phase::CommandingActive {
            bench.receive(SessionState::CommandingWait);
            bench.answer(&Demand::Hold);
        }
        bench.receive(state);
        if phase != Phase::Idle {
            bench.answer(&Demand::Hold);
        }
        assert_eq!(bench.session.phase(), phase);
        bench
    }

    fn active(mode: CommandMode) -> Self {
        let mut bench = Self::at(Phase::CommandingActive, Dialect::V2, mode);
        bench.session.engage().unwrap();
        bench.receive(SessionState::CommandingActive);
        bench
    }

    fn receive(&mut self, state: SessionState) -> Reception {
        self.sequence += 1;
        self.now += MS;
        let message = message(self.dialect, self.sequence, state, self.mode);
        self.take(&message).unwrap()
    }

    fn take(&mut self, message: &Monitoring) -> Result<Reception, DecodeError> {
        self.session
            .handle_datagram(&bytes(self.dialect, message), self.now)
    }

    fn answer(&mut self, demand: &Demand) -> (Command, Option<Withheld>) {
        let mut buf = [0; MESSAGE_MAX];
        let answer = self.session.answer(demand, &mut buf).unwrap();
        let (is_framed, message) = unframe(&buf[..answer.len]).unwrap();
        assert_eq!(is_framed, self.dialect.is_framed());
        (Command::decode(message).unwrap(), answer.withheld)
    }
}

// ------------------------------------------------------------------------------------- phase x state of the next message

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn session_state_transitions_match_diagram() {
    use Event::{Closed, CommandEntered, CommandLeft, Online, QualityLost, Ready, Synchronising};
    let rows = [
        (
            Phase::Offline,
            [
                None,
                Some(Online),
                Some(Online),
                Some(Synchronising),
                Some(CommandEntered),
                Some(Online),
            ],
        ),
        (
            Phase::Idle,
            [
                None,
                Some(Online),
                Some(Online),
                Some(Synchronising),
                Some(CommandEntered),
                Some(Online),
            ],
        ),
        (
            Phase::MonitoringWait,
            [
                Some(Closed),
                None,
                Some(Ready),
                Some(Synchronising),
                Some(CommandEntered),
                None,
            ],
        ),
        (
            Phase::MonitoringReady,
            [
                Some(Closed),
                Some(QualityLost),
                None,
                Some(Synchronising),
                Some(CommandEntered),
                Some(QualityLost),
            ],
        ),
        (
            Phase::CommandingWait,
            [
                Some(Closed),
                Some(CommandLeft),
                Some(CommandLeft),
                None,
                Some(CommandEntered),
                Some(CommandLeft),
            ],
        ),
        (
            Phase::CommandingActive,
            [
                Some(Closed),
                Some(CommandLeft),
                Some(CommandLeft),
                Some(CommandLeft),
                None,
                Some(CommandLeft),
            ],
        ),
    ];
    for dialect in [Dialect::V1, Dialect::V2, Dialect::V3] {
        for (phase, events) in rows {
            for (state, event) in STATES.into_iter().zip(events) {
                let mut bench = Bench::at(phase, dialect, CommandMode::Position);
                let reception = bench.receive(state);
                assert_eq!(reception.event, event, "{phase:?} {state}");
                assert_eq!(bench.session.phase(), Phase::from(state));
                assert_eq!(reception.is_due, state != SessionState::Idle);
                assert!(!bench.session.is_engaged());
            }
        }
    }
}

#[test]
fn session_silence_in_any_phase_is_offline() {
    for phase in Phase::ALL {
        let mut bench = Bench::at(phase, Dialect::V2, CommandMode::Position);
        let due = bench.session.poll_timeout();
        let deadline = bench.now + MS * 50;
        assert_eq!(
            due,
            (phase != Phase::Offline).then_some(deadline),
            "{phase:?}"
        );
        assert!(!bench.session.handle_timeout(deadline - MS));
        assert_eq!(bench.session.handle_timeout(deadline), due.is_some());
        assert_eq!(bench.session.phase(), Phase::Offline);
        assert_eq!(bench.session.counters().silences, u64::from(due.is_some()));
    }
}

#[test]
fn session_answers_as_expected_in_every_phase() {
    // Joint positions answered by 1.x and by 2.x, and whether there is an answer at all.
    for (state, v1, v2) in [
        (SessionState::MonitoringWait, Some(COMMANDED), None),
        (SessionState::MonitoringReady, Some(COMMANDED), None),
        (SessionState::CommandingWait, Some(IPO), Some(IPO)),
        (SessionState::CommandingActive, Some(IPO), Some(IPO)),
        (SessionState::Other(9), Some(COMMANDED), None),
    ] {
        for (dialect, joints) in [(Dialect::V1, v1), (Dialect::V2, v2), (Dialect::V3, v2)] {
            let mut bench = Bench::at(Phase::MonitoringReady, dialect, CommandMode::Position);
            bench.receive(state);
            let (command, withheld) = bench.answer(&Demand::Position([9.0; AXES]));
            assert_eq!(
                command.data.and_then(|data| data.joints),
                joints,
                "{state} {dialect}"
            );
            assert_eq!(command.data.is_some(), joints.is_some());
            let expected = match state {
                SessionState::CommandingActive => Withheld::NotEngaged,
                SessionState::Idle
                | SessionState::MonitoringWait
                | SessionState::MonitoringReady
                | SessionState::CommandingWait
                | SessionState::Other(_) => Withheld::NotCommanding {
                    phase: state.into(),
                },
            };
            assert_eq!(withheld, Some(expected));
        }
    }
    let mut bench = Bench::new(Dialect::V2, CommandMode::Position);
    bench.receive(SessionState::Idle);
    let refused = bench.session.answer(&Demand::Hold, &mut [0; MESSAGE_MAX]);
    assert_eq!(refused, Err(AnswerError::NothingToAnswer));
}

// ----------------------------------------------------------------------------------------------- rules of command modes

#[test]
fn session_synchronising_answers_all_overlay_values() {
    for (mode, joints, wrench, torque, has_pose) in [
        (CommandMode::Position, Some(IPO), None, None, false),
        (CommandMode::Wrench, Some(IPO), Some([0.0; 6]), None, false),
        (
            CommandMode::Torque,
            Some(IPO),
            None,
            Some([0.0; AXES]),
            false,
        ),
        (CommandMode::CartesianPose, None, None, None, true),
        (CommandMode::None, Some(IPO), None, None, false),
        (CommandMode::Other(8), Some(IPO), None, None, false),
    ] {
        for state in [SessionState::CommandingWait, SessionState::CommandingActive] {
            let mut bench = Bench::at(Phase::MonitoringReady, Dialect::V3, mode);
            bench.receive(state);
            let data = bench.answer(&Demand::Hold).0.data.unwrap();
            assert_eq!(
                (data.joints, data.wrench, data.torque),
                (joints, wrench, torque)
            );
            assert_eq!(data.pose, has_pose.then(|| pose(2.0)));
        }
    }
}

/// A demand of every kind, in the order of [`CommandMode`], near the interpolator.
fn demands() -> [(CommandMode, Demand); 4] {
    let joints = Some([0.51; AXES]);
    [
        (CommandMode::Position, Demand::Position([0.51; AXES])),
        (
            CommandMode::Wrench,
            Demand::Wrench {
                wrench: [1.0; 6],
                joints,
            },
        ),
        (
            CommandMode::Torque,
            Demand::Torque {
                torque: [2.0; AXES],
                joints,
            },
        ),
        (
            CommandMode::CartesianPose,
            Demand::Pose {
                pose: [5.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
                redundancy: Some(Redundancy {
                    strategy: RedundancyStrategy::E1,
                    value: 0.1,
                }),
            },
        ),
    ]
}

#[test]
fn session_demand_requires_its_command_mode() {
    for (wanted, _) in demands() {
        for (demanded, demand) in demands() {
            let mut bench = Bench::active(wanted);
            let (command, withheld) = bench.answer(&demand);
            let data = command.data.unwrap();
            let mismatch = Withheld::Mode { wanted, demanded };
            assert_eq!(withheld, (wanted != demanded).then_some(mismatch));
            let moved = withheld.is_none();
            let joints = if moved { [0.51; AXES] } else { IPO };
            if wanted == CommandMode::CartesianPose {
                assert_eq!(data.pose, Some(pose(if moved { 5.0 } else { 2.0 })));
                assert_eq!(data.redundancy.is_some(), moved);
            } else {
                assert_eq!(
                    data.joints == Some(joints),
                    wanted != CommandMode::Torque || moved
                );
            }
            let wrench = [if moved { 1.0 } else { 0.0 }; 6];
            assert_eq!(
                data.wrench,
                (wanted == CommandMode::Wrench).then_some(wrench)
            );
            let torque = [if moved { 2.0 } else { 0.0 }; AXES];
            assert_eq!(
                data.torque,
                (wanted == CommandMode::Torque).then_some(torque)
            );
        }
    }
}

#[test]
fn session_torque_without_positions_trails_measured() {
    let mut bench = Bench::active(CommandMode::Torque);
    let demand = Demand::Torque {
        torque: [1.0; AXES],
        joints: None,
    };
    let mut distance = IPO[0] - MEASURED[0];
    for _ in 0..50 {
        let joints = bench.answer(&demand).0.data.unwrap().joints.unwrap();
        distance *= 0.9;
        assert!((joints[3] - MEASURED[3] - distance).abs() < 1e-12);
        bench.receive(SessionState::CommandingActive);
    }
}

#[test]
fn session_guard_violation_withholds_and_holds() {
    let mut bench = Bench::active(CommandMode::Position);
    bench.session.config.guard.speed_rad_per_s = [1.0; AXES];
    let mut joints = IPO;
    joints[1] += 0.002;
    let (command, withheld) = bench.answer(&Demand::Position(joints));
    assert_eq!(command.data.unwrap().joints, Some(IPO));
    assert_eq!(
        withheld.unwrap().to_string(),
        "A2 commanded 2.000 rad/s, limit 1.000 rad/s"
    );
    // Two messages later the same step is slow enough.
    bench.receive(SessionState::CommandingActive);
    bench.receive(SessionState::CommandingActive);
    let (command, withheld) = bench.answer(&Demand::Position(joints));
    assert_eq!(
        (command.data.unwrap().joints, withheld),
        (Some(joints), None)
    );
    assert_eq!(bench.session.counters().withheld, 1);
    for (mode, demand) in [
        (CommandMode::Position, Demand::Position([f64::NAN; AXES])),
        (
            CommandMode::Torque,
            Demand::Torque {
                torque: [f64::NAN; AXES],
                joints: None,
            },
        ),
        (
            CommandMode::Wrench,
            Demand::Wrench {
                wrench: [f64::NAN; 6],
                joints: None,
            },
        ),
        (
            CommandMode::CartesianPose,
            Demand::Pose {
                pose: [f64::NAN; 7],
                redundancy: None,
            },
        ),
    ] {
        let withheld = Bench::active(mode).answer(&demand).1;
        assert!(
            matches!(withheld, Some(Withheld::Guard(it)) if it.breach == Breach::NotFinite),
            "{mode}"
        );
    }
}

// ------------------------------------------------------------------------------------------------ entering and re-entering

#[test]
fn session_re_entry_requires_engage() {
    let mut bench = Bench::active(CommandMode::Position);
    let far = Demand::Position([0.9; AXES]);
    assert_eq!(bench.answer(&far).0.data.unwrap().joints, Some([0.9; AXES]));
    bench.receive(SessionState::MonitoringReady);
    assert_eq!(bench.answer(&far).0.data, None);
    for _ in 0..3 {
        bench.receive(SessionState::CommandingActive);
        let (command, withheld) = bench.answer(&far);
        assert_eq!(command.data.unwrap().joints, Some(IPO));
        assert_eq!(withheld, Some(Withheld::NotEngaged));
    }
    assert_eq!(Some(bench.session.mirror()), Some(IPO));
    bench.session.engage().unwrap();
    bench.receive(SessionState::CommandingActive);
    assert_eq!(bench.answer(&far).1, None);
    bench.session.disengage();
    bench.receive(SessionState::CommandingActive);
    assert_eq!(bench.answer(&far).0.data.unwrap().joints, Some(IPO));
}

#[test]
fn session_joins_active_overlay_at_arm_position() {
    for (dialect, place) in [(Dialect::V1, COMMANDED), (Dialect::V2, MEASURED)] {
        // The first message, the first after silence, and the first of a controller that started again.
        let fresh = Bench::new(dialect, CommandMode::Position);
        let mut silent = Bench::at(Phase::CommandingActive, dialect, CommandMode::Position);
        silent.session.engage().unwrap();
        silent.now += MS * 60;
        let mut restarted = Bench::at(Phase::CommandingActive, dialect, CommandMode::Position);
        restarted.session.engage().unwrap();
        restarted.sequence += 1_000_000;
        for mut bench in [fresh, silent, restarted] {
            let reception = bench.receive(SessionState::CommandingActive);
            assert_eq!(reception.event, Some(Event::CommandEntered));
            assert!(!bench.session.is_engaged());
            let far = Demand::Position([0.9; AXES]);
            assert_eq!(bench.answer(&far).0.data.unwrap().joints, Some(place));
            bench.session.engage().unwrap();
            assert_eq!(Some(bench.session.mirror()), Some(place));
        }
    }
}

#[test]
fn session_engage_requires_active_phase() {
    for phase in Phase::ALL {
        let mut bench = Bench::at(phase, Dialect::V2, CommandMode::Position);
        let engaged = bench.session.engage();
        assert_eq!(
            engaged.is_ok(),
            phase == Phase::CommandingActive,
            "{phase:?}"
        );
    }
}

// ------------------------------------------------------------------------------------- counting, multiplier, lost and late

#[test]
fn session_multiplier_phase_survives_loss() {
    let mut bench = Bench::new(Dialect::V2, CommandMode::Position);
    let mut answered = Vec::new();
    for sequence in [10, 11, 12, 13, 14, 17, 18, 20] {
        let mut message = message(
            Dialect::V2,
            sequence,
            SessionState::MonitoringReady,
            bench.mode,
        );
        message.connection.as_mut().unwrap().receive_multiplier = Some(3);
        assert_eq!(
            bench.take(&message).unwrap().is_due,
            bench.session.is_pending()
        );
        if bench.session.is_pending() {
            answered.push(bench.answer(&Demand::Hold).0.header);
        }
    }
    let header = |(sequence, reflected)| Header {
        sequence,
        reflected,
    };
    assert_eq!(answered, [(0, 10), (1, 13), (2, 17), (3, 20)].map(header));
    assert_eq!(bench.session.counters().lost, 3);
}

#[test]
fn session_answers_newest_and_counts_skipped() {
    let mut bench = Bench::new(Dialect::V1, CommandMode::Position);
    for _ in 0..3 {
        bench.receive(SessionState::MonitoringReady);
    }
    assert_eq!(bench.answer(&Demand::Hold).0.header.reflected, 3);
    assert_eq!(bench.session.counters().skipped, 2);
    let again = bench.session.answer(&Demand::Hold, &mut [0; MESSAGE_MAX]);
    assert_eq!(again, Err(AnswerError::NothingToAnswer));
}

#[test]
fn session_duplicates_and_old_are_ignored() {
    let mut bench = Bench::active(CommandMode::Position);
    let before = bench.sequence;
    for sequence in [before, before - 1] {
        let old = message(
            Dialect::V2,
            sequence,
            SessionState::MonitoringWait,
            bench.mode,
        );
        let reception = bench.take(&old).unwrap();
        assert!(!reception.order.is_new() && !reception.is_due);
        assert_eq!(
            (reception.event, bench.session.phase()),
            (None, Phase::CommandingActive)
        );
    }
    assert_eq!(bench.session.counters().old, 2);
    assert!(bench.session.is_engaged());
}

#[test]
fn session_restarted_controller_may_change_dialect() {
    let mut bench = Bench::at(Phase::MonitoringReady, Dialect::V1, CommandMode::Position);
    assert_eq!(bench.session.dialect(), Some(Dialect::V1));
    bench.dialect = Dialect::V3;
    bench.sequence = 1_000_000;
    assert_eq!(
        bench.receive(SessionState::MonitoringWait).order,
        Order::Restart
    );
    assert_eq!(bench.session.dialect(), Some(Dialect::V3));
    bench.answer(&Demand::Hold);
    assert_eq!(bench.session.counters().restarts, 1);
}

// ------------------------------------------------------------------------------------------------------- what else may come

#[test]
fn session_foreign_datagram_or_dialect_is_named() {
    let mut bench = Bench::new(Dialect::V2, CommandMode::Position);
    let mut take = |datagram: &[u8]| {
        let refused = bench.session.handle_datagram(datagram, MS);
        refused.unwrap_err().to_string()
    };
    let mut msr = [0; 916];
    msr[4..8].copy_from_slice(&[0x94, 0x03, 0x06, 0x20]);
    assert_eq!(
        take(&msr),
        "a measurement of FRI 1.0 (LWR), expected a monitoring message of Sunrise FRI 1.x or 2.0 to 2.5: the \
         other robot generation uses this port: check the device kind and the controller's target port"
    );
    let mut buf = [0; 64];
    let len = Command::default().encode(&mut buf).unwrap();
    assert_eq!(
        take(&buf[..len]),
        "a command message of Sunrise FRI 1.x or 2.0 to 2.5, expected a monitoring message of Sunrise FRI 1.x or 2.0 to \
         2.5: a client sends to this port, not a controller: check for a second client and for equal addresses"
    );
    assert_eq!(
        take(b"hello"),
        "datagram of 5 bytes is no message of Sunrise FRI, bare or framed"
    );
    assert_eq!(bench.session.counters().refused, 3);
    let expected = SessionConfig {
        dialect: Some(Dialect::V1),
        ..SessionConfig::default()
    };
    let mut bench = Bench {
        session: Session::new(expected),
        ..Bench::new(Dialect::V3, CommandMode::Position)
    };
    let message = message(
        Dialect::V3,
        1,
        SessionState::MonitoringWait,
        CommandMode::None,
    );
    assert_eq!(
        bench.take(&message).unwrap_err().to_string(),
        "the controller speaks FRI 2.7 (3.0), this session is configured for FRI 1.x: correct the setting or leave it to \
         detection"
    );
}

#[test]
fn session_outputs_sent_while_listed() {
    let mut bench = Bench::at(Phase::MonitoringReady, Dialect::V2, CommandMode::Position);
    let session = &mut bench.session;
    assert_eq!(session.read("G.in"), Some(IoLevel::Digital(3)));
    assert_eq!(session.read("G.level"), Some(IoLevel::Analog(0.5)));
    assert_eq!(session.read("G.none"), None);
    let on = IoLevel::Boolean(true);
    assert_eq!(session.write("G.none", on), Err(IoError::NotListed));
    assert_eq!(
        session.write("G.in", IoLevel::Digital(1)),
        Err(IoError::Input)
    );
    let wrong = session.write("G.level", on).unwrap_err();
    assert!(
        wrong
            .to_string()
            .starts_with("it is of type analog, not bool\nhint: "),
        "{wrong}"
    );
    assert_eq!(session.write_number("G.in", -1.0), Err(IoError::Range));
    assert_eq!(session.write_number("G.in", f64::NAN), Err(IoError::Range));
    assert_eq!(session.write_number("G.in", 3.4), Err(IoError::Input));
    assert!(session.write_number("G.out", 1.0).is_err());
    session.write("G.out", IoLevel::Boolean(false)).unwrap();
    session.write("G.out", on).unwrap();
    session.write_number("G.level", 1.5).unwrap();
    bench.receive(SessionState::MonitoringReady);
    let data = bench.answer(&Demand::Hold).0.data.unwrap();
    let sent: Vec<_> = data
        .ios
        .iter()
        .map(|io| (io.name.to_string(), IoLevel::of(io)))
        .collect();
    let level = |name: &str, level| (name.to_owned(), Some(level));
    assert_eq!(
        sent,
        [level("G.out", on), level("G.level", IoLevel::Analog(1.5))]
    );
    bench.sequence += 1;
    let mut without = message(
        Dialect::V2,
        bench.sequence,
        SessionState::MonitoringReady,
        bench.mode,
    );
    without.monitor.as_mut().unwrap().ios.clear();
    bench.take(&without).unwrap();
    assert_eq!(bench.answer(&Demand::Hold).0.data, None);
}

#[test]
fn session_requested_frames_use_dialect_form() {
    for (dialect, right, wrong, text) in [
        (
            Dialect::V1,
            Placement::Matrix([0.5; 12]),
            Placement::Quaternion([0.5; 7]),
            "FRI 1.x requires frames as matrix",
        ),
        (
            Dialect::V2,
            Placement::Quaternion([0.5; 7]),
            Placement::Matrix([0.5; 12]),
            "FRI 2.0 to 2.5 requires frames as quaternion",
        ),
    ] {
        let mut bench = Bench::at(Phase::MonitoringReady, dialect, CommandMode::Position);
        assert_eq!(
            bench.session.send_frame("Other", right, None),
            Err(FrameError::NotRequested)
        );
        assert_eq!(
            bench
                .session
                .send_frame("Frame", wrong, None)
                .unwrap_err()
                .to_string(),
            text
        );
        bench.session.send_frame("Frame", right, None).unwrap();
        bench.receive(SessionState::MonitoringReady);
        let data = bench.answer(&Demand::Hold).0.data.unwrap();
        assert_eq!(data.transformations[0].placement, Some(right));
        assert!(data.transformations[0].name.is("Frame"));
    }
}
