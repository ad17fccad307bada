//! Every transition and rule of the emulated cabinet against a hand-made client. Behaviour with the session of this crate:
//! tests/sunrise_behaviour.rs.

use super::super::{Io, MissingValue, PowerOff, Program};
use super::*;
use crate::sunrise::wire::{CommandData, Header, Monitoring, Name, OperationMode};

const PERIOD: Duration = Duration::from_millis(2);
const START: Duration = Duration::from_secs(5);

/// A cabinet and a client in lock-step; the test sets the client's answers.
struct Bench {
    cabinet: Cabinet,
    now: Duration,
    message: Monitoring,
    sequence: u32,
}

impl Bench {
    fn new(config: CabinetConfig) -> Self {
        Self {
            cabinet: Cabinet::new(config, START),
            now: START,
            message: Monitoring::default(),
            sequence: 7,
        }
    }

    /// One cycle: receives the message, then sends the mirrored answer after `change`.
    fn cycle(&mut self, change: impl FnOnce(&mut CommandData)) -> &mut Self {
        if self.receive() {
            let mut data = self.mirrored();
            change(&mut data);
            self.send(Some(data));
        }
        self
    }

    /// Whether a message was sent.
    fn receive(&mut self) -> bool {
        self.now = self.cabinet.poll_timeout();
        let mut buf = [0; MESSAGE_MAX];
        let mut came = false;
        while let Some(len) = self.cabinet.poll_transmit(self.now, &mut buf) {
            let (_, message) = unframe(&buf[..len]).unwrap();
            self.message = Monitoring::decode(message).unwrap();
            came = true;
        }
        came
    }

    /// The answer of the SDK's default client, with zeros where the overlay expects more.
    fn mirrored(&self) -> CommandData {
        let ipo = self.message.ipo.unwrap_or_default();
        let joints = ipo.joints.or_else(|| self.message.measured());
        let mode = self.message.command_mode();
        CommandData {
            joints,
            wrench: (mode == CommandMode::Wrench).then_some([0.0; 6]),
            torque: (mode == CommandMode::Torque).then_some([0.0; AXES]),
            pose: ipo.pose.filter(|_| mode == CommandMode::CartesianPose),
            ..CommandData::default()
        }
    }

    fn send(&mut self, data: Option<CommandData>) {
        self.sequence += 1;
        let command = Command {
            header: Header {
                sequence: self.sequence,
                reflected: self.message.header.sequence,
            },
            data,
            end: None,
        };
        let mut buf = [0; MESSAGE_MAX];
        let dialect = self.cabinet.config.dialect;
        let len = dialect.frame(&mut buf, |buf| command.encode(buf)).unwrap();
        let at = self.now + PERIOD / 4;
        self.cabinet.handle_datagram(&buf[..len], at).unwrap();
    }

    fn cycles(&mut self, count: u32) -> &mut Self {
        for _ in 0..count {
            self.cycle(|_| {});
        }
        self
    }

    fn silent(&mut self, count: u32) -> &mut Self {
        for _ in 0..count {
            self.receive();
        }
        self
    }

    fn reason(&self) -> Option<ExitReason> {
        self.cabinet.log().next_back().map(|left| left.reason)
    }

    fn start(&mut self, overlay: Overlay) -> &mut Self {
        self.cabinet.start_overlay(overlay).unwrap();
        self.cycles(3);
        assert_eq!(self.cabinet.state(), SessionState::CommandingActive);
        assert_eq!(self.message.state(), SessionState::CommandingActive);
        self
    }
}

fn manual() -> CabinetConfig {
    CabinetConfig {
        program: Program::Manual,
        ..CabinetConfig::default()
    }
}

fn ready() -> Bench {
    ready_with(manual())
}

fn ready_with(config: CabinetConfig) -> Bench {
    let mut bench = Bench::new(config);
    let cycles = 101 * bench.cabinet.multiplier();
    bench.cycles(cycles);
    assert_eq!(
        (bench.cabinet.state(), bench.cabinet.quality()),
        (SessionState::MonitoringReady, Quality::Excellent)
    );
    bench
}

fn joint_impedance() -> Control {
    Control::JointImpedance {
        stiffness: [300.0; AXES],
        damping: [0.7; AXES],
    }
}

fn cartesian_impedance() -> Control {
    Control::CartesianImpedance {
        stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
        damping: [0.7; 6],
    }
}

fn overlay(control: Control, command: CommandMode) -> Overlay {
    Overlay { control, command }
}

fn active(control: Control, command: CommandMode) -> Bench {
    let dialect = Dialect::V3;
    let mut bench = ready_with(CabinetConfig {
        dialect,
        ..manual()
    });
    bench.start(overlay(control, command));
    bench
}

fn active_position() -> Bench {
    active(Control::Position, CommandMode::Position)
}

/// The last set-point of the robot, `delta` further in joint A1.
fn ahead(bench: &Bench, delta: f64) -> [f64; AXES] {
    let mut joints = bench.cabinet.last.1;
    joints[0] += delta;
    joints
}

// ------------------------------------------------------------------------------------------------ quality and monitoring

#[test]
fn cabinet_quality_drives_monitoring_states() {
    let mut bench = Bench::new(manual());
    bench.cycles(90);
    assert_eq!(
        (bench.cabinet.state(), bench.cabinet.quality()),
        (SessionState::MonitoringWait, Quality::Fair)
    );
    bench.cycles(1);
    assert_eq!(
        (bench.cabinet.state(), bench.cabinet.quality()),
        (SessionState::MonitoringReady, Quality::Good)
    );
    bench.cycles(10);
    assert_eq!(bench.cabinet.quality(), Quality::Excellent);
    bench.silent(12);
    assert_eq!(
        (bench.cabinet.state(), bench.cabinet.quality()),
        (SessionState::MonitoringWait, Quality::Fair)
    );
}

#[test]
fn cabinet_dialect_determines_message_fields() {
    for (dialect, has_commanded, has_pose, has_force) in [
        (Dialect::V1, true, false, false),
        (Dialect::V2, false, true, false),
        (Dialect::V3, false, true, true),
    ] {
        let bench = ready_with(CabinetConfig {
            dialect,
            ..manual()
        });
        let data = bench.message.monitor.unwrap();
        assert_eq!(
            (
                data.commanded.is_some(),
                data.pose.is_some(),
                data.external_force.is_some()
            ),
            (has_commanded, has_pose, has_force)
        );
        assert_eq!(
            Dialect::of(dialect.is_framed(), &bench.message),
            Some(dialect)
        );
        assert_eq!(bench.message.ipo.unwrap().joints, None);
        assert_eq!(bench.message.header.reflected, bench.sequence - 1);
    }
}

#[test]
fn cabinet_other_framing_is_rejected_by_name() {
    let mut bench = ready();
    let mut buf = [0; 64];
    let command = Command::default();
    let len = Dialect::V3
        .frame(&mut buf, |buf| command.encode(buf))
        .unwrap();
    let refused = bench
        .cabinet
        .handle_datagram(&buf[..len], bench.now)
        .unwrap_err();
    assert_eq!(
        refused.to_string(),
        "a command message of Sunrise FRI 2.7 (3.0), expected a command message of Sunrise FRI 1.x or 2.0 to 2.5: the \
         other robot generation uses this port: check the device kind and the controller's target port"
    );
    let mut cmd = [0; crate::lwr::wire::Cmd::LEN];
    crate::lwr::wire::Cmd::default().encode(&mut cmd).unwrap();
    let refused = bench.cabinet.handle_datagram(&cmd, bench.now).unwrap_err();
    assert!(
        refused
            .to_string()
            .starts_with("a command of FRI 1.0 (LWR)"),
        "{refused}"
    );
    assert_eq!(bench.cabinet.counters().malformed, 2);
}

// ----------------------------------------------------------------------------------------------------- starting an overlay

#[test]
fn cabinet_motion_refusal_has_reason() {
    let start = |bench: &mut Bench, control, command| {
        let refused = bench.cabinet.start_overlay(overlay(control, command));
        refused.map_err(|error| error.to_string())
    };
    let position = |bench: &mut Bench| start(bench, Control::Position, CommandMode::Position);
    let mut early = Bench::new(manual());
    let text = "session is MONITORING_WAIT, not MONITORING_READY";
    assert_eq!(position(&mut early), Err(text.into()));
    let mut bench = ready();
    for (control, command) in [
        (Control::Position, CommandMode::Wrench),
        (joint_impedance(), CommandMode::Wrench),
        (Control::Position, CommandMode::Torque),
        (cartesian_impedance(), CommandMode::Torque),
        (Control::Position, CommandMode::CartesianPose),
        (Control::Position, CommandMode::None),
    ] {
        let refused = start(&mut bench, control, command).unwrap_err();
        assert!(
            refused.starts_with(&format!("command mode {command} does not fit")),
            "{refused}"
        );
    }
    bench.cabinet.set_power(false);
    assert!(
        position(&mut bench)
            .unwrap_err()
            .starts_with("drives are off")
    );
    bench.cabinet.set_power(true);
    assert_eq!(position(&mut bench), Ok(()));
    let text = "session is COMMANDING_WAIT, not MONITORING_READY";
    assert_eq!(position(&mut bench), Err(text.into()));
}

#[test]
fn cabinet_overlay_waits_for_matching_commands() {
    let mut bench = ready();
    bench.cabinet.start_overlay(Overlay::default()).unwrap();
    for _ in 0..50 {
        bench.cycle(|data| data.joints.as_mut().unwrap()[4] += 0.02);
        assert_eq!(bench.message.state(), SessionState::CommandingWait);
    }
    bench.cycles(2);
    assert_eq!(bench.cabinet.state(), SessionState::CommandingActive);
}

#[test]
fn cabinet_unsynchronised_overlay_ends_with_reason() {
    let mut bench = ready();
    bench.cabinet.start_overlay(Overlay::default()).unwrap();
    for _ in 0..5001 {
        bench.cycle(|data| data.joints.as_mut().unwrap()[4] += 0.02);
    }
    let reason = bench.reason().unwrap();
    assert!(
        matches!(reason, ExitReason::NotSynchronised { joint: 4, .. }),
        "{reason}"
    );
    assert_eq!(bench.cabinet.state(), SessionState::MonitoringReady);
}

#[test]
fn cabinet_synchronising_requires_torque_or_wrench() {
    for (control, command, value) in [
        (joint_impedance(), CommandMode::Torque, MissingValue::Torque),
        (
            cartesian_impedance(),
            CommandMode::Wrench,
            MissingValue::Wrench,
        ),
    ] {
        let mut bench = ready();
        bench
            .cabinet
            .start_overlay(overlay(control, command))
            .unwrap();
        for _ in 0..20 {
            bench.cycle(|data| (data.torque, data.wrench) = (None, None));
        }
        assert_eq!(bench.cabinet.state(), SessionState::CommandingWait);
        assert_eq!(bench.cabinet.waiting.1, ExitReason::Missing { value });
        bench.cycles(2);
        assert_eq!(bench.cabinet.state(), SessionState::CommandingActive);
    }
}

// ----------------------------------------------------------------------------------------------------- rules while active

/// Sends one command in COMMANDING_ACTIVE and returns why the overlay ended.
fn verdict(bench: &mut Bench, change: impl FnOnce(&mut CommandData)) -> Option<ExitReason> {
    bench.cycles(1);
    bench.cycle(change);
    bench.cycles(1);
    assert_eq!(
        bench.reason().is_some(),
        bench.cabinet.state() != SessionState::CommandingActive
    );
    bench.reason()
}

#[test]
fn cabinet_positions_beyond_limits_end_overlay() {
    // 85 degrees per second are 2.97 mrad in 2 ms.
    let mut bench = active_position();
    let joints = ahead(&bench, 0.0029);
    assert_eq!(verdict(&mut bench, |data| data.joints = Some(joints)), None);
    let mut bench = active_position();
    let joints = ahead(&bench, 0.0031);
    let reason = verdict(&mut bench, |data| data.joints = Some(joints));
    assert!(
        matches!(reason, Some(ExitReason::Speed { joint: 0, .. })),
        "{reason:?}"
    );
    let mut beyond = active_position();
    beyond.cabinet.config.limits.position_rad[0] = 0.001;
    let joints = ahead(&beyond, 0.0015);
    let reason = verdict(&mut beyond, |data| data.joints = Some(joints));
    assert!(
        matches!(reason, Some(ExitReason::Position { joint: 0, .. })),
        "{reason:?}"
    );
    for value in [f64::NAN, f64::INFINITY] {
        let reason = verdict(&mut active_position(), |data| {
            data.joints = Some([value; AXES]);
        });
        assert_eq!(reason, Some(ExitReason::NotFinite { joint: 0 }));
    }
    let reason = verdict(&mut active_position(), |data| data.joints = None);
    assert_eq!(
        reason,
        Some(ExitReason::Missing {
            value: MissingValue::Joints
        })
    );
}

#[test]
fn cabinet_torque_requires_positions_near_measured() {
    let mut bench = active(joint_impedance(), CommandMode::Torque);
    let joints = ahead(&bench, 0.19);
    assert_eq!(verdict(&mut bench, |data| data.joints = Some(joints)), None);
    let joints = ahead(&bench, 0.21 + 0.19);
    let reason = verdict(&mut bench, |data| data.joints = Some(joints)).unwrap();
    assert!(
        reason
            .to_string()
            .starts_with("Illegal axis delta: A1 commanded"),
        "{reason}"
    );
    let mut bench = active(joint_impedance(), CommandMode::Torque);
    let reason = verdict(&mut bench, |data| data.torque = Some([f64::NAN; AXES]));
    assert_eq!(reason, Some(ExitReason::NotFinite { joint: 0 }));
}

#[test]
fn cabinet_torque_deflects_joint_by_stiffness() {
    let mut bench = active(joint_impedance(), CommandMode::Torque);
    let before = bench.cabinet.joints();
    for _ in 0..1000 {
        bench.cycle(|data| data.torque = Some([0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0]));
    }
    let moved = bench.cabinet.joints()[2] - before[2];
    assert!((moved - 0.01).abs() < 1e-5, "{moved}");
    let weight = bench.cabinet.arm.body.gravity()[2];
    let measured = bench.message.monitor.unwrap().torque.unwrap()[2];
    assert!((measured - weight).abs() < 1e-3, "spring and overlay agree");
}

#[test]
fn cabinet_wrench_presses_wall_and_reports_loss() {
    let mut bench = active(cartesian_impedance(), CommandMode::Wrench);
    let flange = bench.cabinet.flange();
    *bench.cabinet.contact_mut() = Some(Contact {
        shape: crate::emulator::Shape::Wall,
        point: [0.0, 0.0, flange[2] - 0.002],
        normal: [0.0, 0.0, 1.0],
        stiffness: 20_000.0,
        damping: 50.0,
    });
    for _ in 0..3000 {
        bench.cycle(|data| data.wrench = Some([0.0, 0.0, -26.0, 0.0, 0.0, 0.0]));
    }
    // 4 N bend the controller's spring by the 2 mm to the wall; the other 22 N share 22,000 N/m.
    let force = bench.message.monitor.unwrap().external_force.unwrap();
    assert!((force[2] - 20.0).abs() < 0.1, "{force:?}");
    *bench.cabinet.contact_mut() = None;
    bench.cycles(2);
    assert!(bench.message.monitor.unwrap().external_force.unwrap()[2].abs() < 1e-9);
}

#[test]
fn cabinet_poses_followed_unreachable_rejected() {
    let mut bench = active(Control::Position, CommandMode::CartesianPose);
    let before = bench.cabinet.flange();
    let mut pose = bench.message.ipo.unwrap().pose.unwrap();
    for step in 1..=100 {
        let Some(Placement::Quaternion(mut element)) = pose.placement else {
            panic!("{pose:?}")
        };
        element[0] -= 0.1;
        pose.placement = Some(Placement::Quaternion(element));
        bench.cycle(|data| data.pose = Some(pose));
        assert_eq!(bench.reason(), None, "{step}");
    }
    bench.silent(1);
    for _ in 0..100 {
        bench.cycle(|data| data.pose = Some(pose));
    }
    let moved = bench.cabinet.flange()[0] - before[0];
    assert!((moved + 0.010).abs() < 1e-4, "{moved}");
    pose.placement = Some(Placement::Quaternion([
        5000.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0,
    ]));
    for _ in 0..2 {
        bench.cycle(|data| data.pose = Some(pose));
    }
    assert_eq!(bench.reason(), Some(ExitReason::OutOfReach));
}

#[test]
fn cabinet_t1_limits_flange_to_250_mm_per_s() {
    let mut bench = ready_with(CabinetConfig {
        operation_mode: OperationMode::T1,
        ..manual()
    });
    bench.start(Overlay::default());
    for step in 1..1000 {
        let joints = ahead(&bench, 0.0028);
        bench.cycle(|data| data.joints = Some(joints));
        if bench.reason().is_some() {
            assert!(step > 3, "the arm lags behind its set-point");
            break;
        }
    }
    assert!(
        matches!(bench.reason(), Some(ExitReason::T1Speed { .. })),
        "{:?}",
        bench.reason()
    );
}

// ------------------------------------------------------------------------------------------------ silence, power and safety

#[test]
fn cabinet_missing_commands_bridged_then_end_overlay() {
    let mut bench = active_position();
    let mut joints = ahead(&bench, 0.0);
    for _ in 0..10 {
        joints[0] += 0.002;
        bench.cycle(|data| data.joints = Some(joints));
    }
    let before = bench.cabinet.set_point()[0];
    bench.silent(9);
    assert_eq!(bench.cabinet.state(), SessionState::CommandingActive);
    // The last command is followed, then eight are missing.
    assert!((bench.cabinet.set_point()[0] - before - 9.0 * 0.002).abs() < 1e-9);
    bench.silent(3);
    assert!(
        matches!(bench.reason(), Some(ExitReason::Misses { cycles: 10, .. })),
        "{:?}",
        bench.reason()
    );
    let mut last = bench.cabinet.set_point()[0];
    bench.silent(1);
    let mut step = bench.cabinet.set_point()[0] - last;
    last += step;
    assert!(step > 0.001);
    for _ in 0..60 {
        bench.silent(1);
        let next = bench.cabinet.set_point()[0] - last;
        assert!(
            next >= -1e-12 && step - next < 10.0 * 4e-6 + 1e-12,
            "braked at the limit, never faster"
        );
        (last, step) = (bench.cabinet.set_point()[0], next);
    }
    assert!(step.abs() < 1e-12, "at rest");
}

#[test]
fn cabinet_arm_moves_on_through_stall_as_without() {
    let mut bench = active_position();
    let mut joints = ahead(&bench, 0.0);
    for _ in 0..20 {
        joints[0] += 0.002;
        bench.cycle(|data| data.joints = Some(joints));
    }
    let before = bench.cabinet.set_point()[0];
    let mut buf = [0; MESSAGE_MAX];
    let late = bench.cabinet.poll_timeout() + PERIOD * 7;
    bench.cabinet.poll_transmit(late, &mut buf).unwrap();
    // The last command is followed, and seven cycles go on at its speed.
    let expected = before + 8.0 * 0.002;
    assert!((bench.cabinet.set_point()[0] - expected).abs() < 1e-9);
    // Of a longer stall, 20 ms are made up.
    let late = bench.cabinet.poll_timeout() + PERIOD * 100;
    bench.cabinet.poll_transmit(late, &mut buf).unwrap();
    let expected = expected + 11.0 * 0.002;
    assert!((bench.cabinet.set_point()[0] - expected).abs() < 1e-9);
    assert_eq!(bench.reason(), None);
}

#[test]
fn cabinet_power_loss_or_safety_stop_ends_overlay() {
    let mut bench = active_position();
    bench.cabinet.set_power(false);
    bench.cycles(2);
    assert_eq!(bench.reason(), Some(ExitReason::Power));
    assert_eq!(
        bench.message.robot.unwrap().drives,
        Some([super::super::super::wire::Drive::Off; AXES])
    );
    let mut bench = active_position();
    bench.cabinet.set_safety(Safety::Stop1);
    bench.cycles(2);
    assert_eq!(bench.reason(), Some(ExitReason::Safety(Safety::Stop1)));
    assert_eq!(bench.message.robot.unwrap().safety, Some(Safety::Stop1));
    let mut bench = active_position();
    bench.cabinet.faults_mut().quality = Some(Quality::Fair);
    bench.cycles(1);
    assert!(matches!(bench.reason(), Some(ExitReason::Quality { .. })));
    assert_eq!(bench.cabinet.state(), SessionState::MonitoringWait);
}

#[test]
fn cabinet_arm_without_power_stays_in_place() {
    let mut bench = active(cartesian_impedance(), CommandMode::Wrench);
    for _ in 0..100 {
        bench.cycle(|data| data.wrench = Some([0.0, 20.0, 0.0, 0.0, 0.0, 0.0]));
    }
    bench.cabinet.faults_mut().power_off = Some(PowerOff {
        at: Duration::ZERO,
        span: Duration::from_secs(100),
    });
    bench.cycles(20);
    let frozen = bench.cabinet.joints();
    bench.cycles(100);
    assert_eq!(
        bench.cabinet.joints().map(f64::to_bits),
        frozen.map(f64::to_bits)
    );
}

// -------------------------------------------------------------------------------------------------- program and session

#[test]
fn cabinet_program_quality_timeout_has_original_text() {
    let mut bench = Bench::new(CabinetConfig::default());
    bench.silent(5002);
    let reason = bench.reason().unwrap().to_string();
    assert_eq!(
        reason,
        "Timeout before FRI connection quality reached GOOD or EXCELLENT: 0 % of answers in time"
    );
    bench.cycles(700);
    assert_eq!(
        bench.cabinet.state(),
        SessionState::CommandingActive,
        "and tries again"
    );
    bench.cabinet.cancel();
    bench.cycles(2000);
    assert_eq!(
        (bench.reason(), bench.cabinet.state()),
        (Some(ExitReason::Cancelled), SessionState::MonitoringReady)
    );
}

#[test]
fn cabinet_closed_session_reports_once_reopens_after_5_s() {
    let mut bench = active_position();
    bench.cabinet.close_session();
    assert_eq!(bench.reason(), Some(ExitReason::Closed));
    assert!(bench.receive());
    assert_eq!(bench.message.state(), SessionState::Idle);
    assert!(!bench.receive());
    assert_eq!(bench.cabinet.open_session(), Err(StartError::NotClosed));
    bench.silent(2500);
    bench.cabinet.open_session().unwrap();
    bench.cycles(1);
    assert_eq!(
        (bench.message.state(), bench.message.header.sequence),
        (SessionState::MonitoringWait, 1)
    );
    assert_eq!(bench.cabinet.open_session(), Err(StartError::NotClosed));
    bench.cycles(101);
    assert_eq!(bench.cabinet.state(), SessionState::MonitoringReady);
}

#[test]
fn cabinet_multiplier_two_interpolates_between_answers() {
    let mut bench = ready_with(CabinetConfig {
        receive_multiplier: 2,
        ..manual()
    });
    assert_eq!(
        bench.message.connection.unwrap().receive_multiplier,
        Some(2)
    );
    bench.start(Overlay::default());
    let mut set_points = Vec::new();
    let mut joints = ahead(&bench, 0.0);
    for index in 0..40 {
        if index % 2 == 1 {
            joints[0] += 0.002;
            bench.cycle(|data| data.joints = Some(joints));
        } else {
            bench.silent(1);
        }
        set_points.push(bench.cabinet.set_point()[0]);
    }
    assert_eq!(bench.reason(), None);
    for pair in set_points[10..].windows(2) {
        assert!((pair[1] - pair[0] - 0.001).abs() < 1e-9, "{set_points:?}");
    }
}

#[test]
fn cabinet_accepts_outputs_and_frames() {
    let io = |name: &str, direction, level| Io {
        name: name.into(),
        direction,
        level,
    };
    let config = CabinetConfig {
        ios: vec![
            io("G.in", IoDirection::Input, IoLevel::Analog(1.5)),
            io("G.out", IoDirection::Output, IoLevel::Digital(0)),
        ],
        requested_frames: vec!["Part".into()],
        ..manual()
    };
    let mut bench = ready_with(config);
    assert_eq!(
        IoLevel::of(&bench.message.monitor.unwrap().ios[0]),
        Some(IoLevel::Analog(1.5))
    );
    assert!(bench.message.requested[0].name.is("Part"));
    let placement = Placement::Matrix([0.5; 12]);
    let mut listed = bench.message.monitor.unwrap().ios;
    for io in listed.iter_mut() {
        (io.digital, io.analog) = (Some(9), None);
    }
    bench.cycle(|data| {
        data.ios = listed;
        let name = Name::new("Part").unwrap();
        let frame = Transformation {
            name,
            placement: Some(placement),
            stamp: None,
        };
        data.transformations.push(frame).unwrap();
    });
    assert_eq!(bench.cabinet.io("G.out"), Some(IoLevel::Digital(9)));
    assert_eq!(bench.cabinet.io("G.in"), Some(IoLevel::Analog(1.5)));
    assert_eq!(bench.cabinet.counters().refused_ios, 1);
    assert_eq!(bench.cabinet.frame("Part"), Some(placement));
}

#[test]
fn cabinet_wait_phases_last_as_configured() {
    let mut bench = Bench::new(CabinetConfig {
        monitoring_wait: Duration::from_secs(1),
        commanding_wait: Duration::from_millis(500),
        ..CabinetConfig::default()
    });
    let mut cycles = |while_in: SessionState| {
        let mut count = 0;
        while bench.cabinet.state() == while_in {
            bench.cycle(|_| {});
            count += 1;
        }
        PERIOD * count
    };
    // Quality is good after 90 of 100 answers.
    let monitoring = cycles(SessionState::MonitoringWait);
    let expected = Duration::from_millis(1_180)..Duration::from_millis(1_220);
    assert!(expected.contains(&monitoring), "{monitoring:?}");
    cycles(SessionState::MonitoringReady);
    let commanding = cycles(SessionState::CommandingWait);
    let expected = Duration::from_millis(498)..Duration::from_millis(510);
    assert!(expected.contains(&commanding), "{commanding:?}");
    assert_eq!(bench.cabinet.state(), SessionState::CommandingActive);
}

#[test]
fn cabinet_without_answers_has_poor_quality() {
    let timing = crate::emulator::Timing {
        bad_from: 0.0,
        ok_from: 0.0,
        ..Default::default()
    };
    let mut bench = Bench::new(CabinetConfig {
        timing,
        ..CabinetConfig::default()
    });
    for _ in 0..300 {
        bench.receive();
    }
    assert_eq!(bench.cabinet.quality(), Quality::Poor);
    assert_eq!(bench.cabinet.state(), SessionState::MonitoringWait);
}
