//! Arms of made-up drives in virtual time: their commands in each cycle, and the positions of their motors. The profile's
//! own machine is not asked here; drives come and go as a test says.

use takt_net::device::JointError;
use takt_rt::latest::latest;

use takt_core::device::{DeviceCommand, DeviceState};
use takt_rt::latest::{LatestReader, LatestWriter};

use super::*;
use crate::check;
use crate::config::{DriveJoint, Recovery};
use takt_core::device::SetPoint;

const CYCLE: Duration = Duration::from_millis(1);
/// One turn of a joint, increments: so many that rounding to them is no acceleration to speak of.
const TURN: f64 = 5e8;
const PER_RAD: f64 = TURN / std::f64::consts::TAU;
/// Share of its distance to the target that a motor moves in a cycle.
const STIFFNESS: f64 = 0.3;

#[expect(clippy::cast_possible_truncation, reason = "positions in here fit")]
fn rounded(position: f64) -> i32 {
    position.round() as i32
}

fn config(joints: u8) -> DriveArm<u8> {
    let joint = |drive| DriveJoint {
        drive,
        axis: 0,
        increments_per_turn: TURN,
        zero: 0.0,
        range: [-170.0, 170.0],
        velocity_max: 100.0,
        acceleration_max: 300.0,
        following_error_max: None,
        rated_torque: None,
        not_mirrored: Vec::new(),
        quirks: Vec::new(),
    };
    DriveArm {
        name: "arm".to_owned(),
        recovery: Recovery::default(),
        model: "".into(),
        feed_forward: 0.0,
        down: Default::default(),
        payload: Default::default(),
        tools: Default::default(),
        joints: (0..joints).map(joint).collect(),
    }
}

/// A drive whose servo gives way to a load in proportion: commanded to its own position, it sags in every cycle.
#[derive(Debug)]
struct Drive {
    state: State,
    goal: Goal,
    has_fault: bool,
    is_online: bool,
    /// It is pushed off its target by so much, increments.
    load: f64,
    /// It turns on by itself, increments per cycle, and heeds no target.
    runaway: f64,
    position: f64,
    velocity: f64,
    /// Targets since it follows.
    targets: Vec<i32>,
    goals: Vec<Goal>,
    /// How fast the motor turned when its power was cut, rad/s.
    cut: Option<f64>,
}

impl Drive {
    const fn new(position: f64) -> Self {
        Self {
            state: State::SwitchOnDisabled,
            goal: Goal::SwitchOnDisabled,
            has_fault: false,
            is_online: true,
            load: 0.0,
            runaway: 0.0,
            position,
            velocity: 0.0,
            targets: Vec::new(),
            goals: Vec::new(),
            cut: None,
        }
    }

    fn step(&mut self, order: Order) -> Option<Feedback> {
        if !self.is_online {
            return None;
        }
        self.goals.extend(order.goal);
        self.goals.dedup();
        self.goal = order.goal.unwrap_or(self.goal);
        let before = self.state;
        self.state = match self.goal {
            _ if self.has_fault => State::Fault,
            Goal::OperationEnabled => State::OperationEnabled,
            Goal::SwitchOnDisabled => State::SwitchOnDisabled,
            Goal::ReadyToSwitchOn => State::ReadyToSwitchOn,
            Goal::SwitchedOn => State::SwitchedOn,
            Goal::QuickStop => State::QuickStopActive,
        };
        let follows = self.state == State::OperationEnabled;
        if before == State::OperationEnabled && self.state == State::SwitchOnDisabled {
            self.cut = Some(self.velocity / PER_RAD / CYCLE.as_secs_f64());
        }
        let position = self.position;
        if follows && self.runaway == 0.0 {
            let target = order.target.map_or(self.position, f64::from);
            self.position += STIFFNESS * (target - self.load - self.position);
            self.targets.extend(order.target);
        } else if self.state == State::QuickStopActive {
            self.runaway = 0.0;
        }
        self.position += self.runaway;
        self.velocity = self.position - position;
        Some(Feedback {
            online: true,
            follows,
            state: Some(self.state),
            status: None,
            increments: rounded(self.position),
            refused: false,
            is_homing: false,
            torque: None,
        })
    }

    /// The fastest change of speed between its last so many targets, rad/s².
    fn acceleration(&self, targets: usize) -> f64 {
        let last = &self.targets[self.targets.len() - targets..];
        let changes = last.windows(3).map(|w| {
            let change = f64::from(w[2]) - 2.0 * f64::from(w[1]) + f64::from(w[0]);
            (change / PER_RAD / CYCLE.as_secs_f64().powi(2)).abs()
        });
        changes.fold(0.0, f64::max)
    }
}

struct Bench {
    arm: Arm,
    drives: Vec<Drive>,
    command: LatestWriter<DeviceCommand>,
    state: LatestReader<DeviceState>,
    given: DeviceCommand,
    tick: u64,
}

impl Bench {
    /// An arm with power and at rest.
    fn new(joints: u8) -> Self {
        let (driver_state, state) = latest(1, DeviceState::default);
        let (command, driver_command) = latest(1, DeviceCommand::default);
        let end = DeviceEnd {
            state: driver_state,
            command: driver_command,
            net_period: CYCLE,
        };
        let mut bench = Self {
            arm: Arm::new(&config(joints), CYCLE, end, []),
            drives: (0..joints)
                .map(|n| Drive::new(f64::from(n) * 1e6))
                .collect(),
            command,
            state,
            given: DeviceCommand::default(),
            tick: 1_000_000,
        };
        bench.run(100, false);
        assert_eq!(bench.status(), DeviceStatus::Operational);
        bench
    }

    fn status(&mut self) -> DeviceStatus {
        self.state.read_with(|state| state.status)
    }

    fn error(&mut self, joint: usize) -> i32 {
        self.state.read_with(|state| state.joints[joint].error)
    }

    fn cycle(&mut self, stopping: bool) {
        self.tick += 1;
        let scheduled = Nanos(self.tick.cast_signed() * Nanos::from(CYCLE).0);
        self.given.time = scheduled;
        let given = &self.given;
        self.command.write_with(|command| command.copy_from(given));
        let tick = Tick {
            index: self.tick,
            missed: 0,
            time: scheduled,
            scheduled,
            woken: scheduled,
            phase_error: None,
        };
        let drives = &mut self.drives;
        self.arm
            .cycle(&tick, stopping, |n, order| drives[n].step(order));
    }

    fn run(&mut self, cycles: usize, stopping: bool) {
        (0..cycles).for_each(|_| self.cycle(stopping));
    }

    /// A cycle in which nets want this of a joint.
    fn want(&mut self, joint: usize, position: Option<f64>) {
        let time = Nanos((self.tick.cast_signed() + 1) * Nanos::from(CYCLE).0);
        let set_points = &mut self.given.joints[joint];
        set_points.period = CYCLE.into();
        set_points.advance(position.map(|position| SetPoint { time, position }));
    }

    /// Nets speed a joint up to 1 rad/s at 4 rad/s² and go on so; returns where it is wanted last.
    fn swing(&mut self, joint: usize, cycles: u32) -> f64 {
        let start = self.drives[joint].position / PER_RAD;
        let mut wanted = start;
        for n in 0..cycles {
            let t = f64::from(n) * CYCLE.as_secs_f64();
            let ramp = t.min(0.25);
            wanted = start + 2.0 * ramp * ramp + (t - ramp);
            self.want(joint, Some(wanted));
            self.cycle(false);
        }
        wanted
    }
}

#[test]
fn drive_arm_fault_other_joints_hold_against_load() {
    let mut bench = Bench::new(3);
    bench.drives[0].load = 2e5;
    bench.run(100, false);
    let before = bench.drives[0].position;
    bench.drives[2].has_fault = true;
    bench.run(2000, false);
    assert_eq!(bench.status(), DeviceStatus::SafeOperational);
    let sagged = (bench.drives[0].position - before) / PER_RAD;
    assert!(sagged.abs() < 1e-6, "sagged by {sagged} rad");
}

#[test]
fn drive_arm_fault_other_joints_brake_within_limit() {
    let mut bench = Bench::new(3);
    bench.swing(0, 500);
    bench.drives[2].has_fault = true;
    let wanted = bench.swing(0, 1);
    bench.drives[0].targets.clear();
    for _ in 0..1000 {
        bench.want(0, Some(wanted));
        bench.cycle(false);
    }
    let drive = &bench.drives[0];
    assert_eq!(drive.targets.len(), 1000, "each cycle has a target");
    // From 1 rad/s at 300°/s².
    let acceleration = drive.acceleration(1000);
    assert!(
        (5.0..5.3).contains(&acceleration),
        "braked at {acceleration} rad/s²"
    );
    assert!(drive.velocity.abs() < 1.0);
    assert_eq!(drive.targets[998], drive.targets[999], "it stays");
}

#[test]
fn drive_arm_bus_stall_causes_no_jump() {
    let mut bench = Bench::new(1);
    bench.swing(0, 500);
    let mut wanted = f64::from(bench.drives[0].targets[499]) / PER_RAD;
    bench.drives[0].targets.drain(..498);
    let mut go_on = |bench: &mut Bench| {
        wanted += CYCLE.as_secs_f64();
        bench.want(0, Some(wanted));
    };
    for _ in 0..50 {
        go_on(&mut bench);
        bench.tick += 1;
    }
    for _ in 0..500 {
        go_on(&mut bench);
        bench.cycle(false);
    }
    let drive = &bench.drives[0];
    let acceleration = drive.acceleration(drive.targets.len());
    assert!(acceleration < 5.3, "caught up at {acceleration} rad/s²");
    let behind = wanted - drive.position / PER_RAD;
    assert!(behind < 0.01, "{behind} rad behind");
}

/// Set-points on a triangle, one in so many cycles, with what upsets them: the bus stalls, another drive has a fault
/// and comes back, the net stops for a while.
#[test]
fn triangles_of_any_period_leave_within_limits() {
    let limit = 300_f64.to_radians();
    for every in [1_u32, 4, 20, 100, 1000] {
        let mut bench = Bench::new(2);
        bench.drives[0].targets.clear();
        let start = bench.drives[0].position / PER_RAD;
        let mut worst = 0.0_f64;
        for n in 0..16_000_u32 {
            let t = f64::from(n / every * every) * CYCLE.as_secs_f64();
            let phase = t % 4.0;
            let wanted = start + 0.7 * if phase < 2.0 { phase } else { 4.0 - phase };
            let is_silent = (9_000..9_300).contains(&n);
            if is_silent {
                bench.want(0, None);
            } else if n % every == 0 {
                bench.want(0, Some(wanted));
                bench.given.joints[0].period = Nanos(Nanos::from(CYCLE).0 * i64::from(every));
            }
            if n == 5_300 {
                bench.tick += 6;
            }
            bench.drives[1].has_fault = (12_100..12_200).contains(&n);
            bench.cycle(false);
            let targets = bench.drives[0].targets.len();
            if targets > 2 {
                worst = worst.max(bench.drives[0].acceleration(3));
            }
        }
        // Of targets in whole increments.
        let coarse = 2.0 / PER_RAD / CYCLE.as_secs_f64().powi(2);
        assert!(worst <= limit + coarse, "every {every}: {worst} rad/s²");
        assert!(worst > 1.0, "every {every}: it moves");
        let limited = bench.state.read_with(|state| state.limited[0]);
        assert!(
            every > 100 || limited.onsets > 0,
            "every {every}: {limited:?}"
        );
    }
}

#[test]
fn drive_arm_set_points_during_fault_are_refused() {
    let mut bench = Bench::new(2);
    bench.swing(0, 100);
    let wanted = bench.drives[0].position / PER_RAD;
    bench.drives[1].has_fault = true;
    let want = |bench: &mut Bench, position, cycles| {
        for _ in 0..cycles {
            bench.want(0, position);
            bench.cycle(false);
        }
    };
    want(&mut bench, Some(wanted), 1000);
    let rest = bench.drives[0].position;
    bench.drives[1].has_fault = false;
    want(&mut bench, Some(wanted), 1000);
    assert_eq!(bench.status(), DeviceStatus::Operational);
    assert_eq!(bench.error(0), JointError::Refused as i32);
    assert!((bench.drives[0].position - rest).abs() < 1.0, "it moved");
    want(&mut bench, None, 2);
    assert_eq!(bench.error(0), JointError::None as i32);
    let target = rest / PER_RAD + 0.01;
    want(&mut bench, Some(target), 1000);
    assert!((bench.drives[0].position / PER_RAD - target).abs() < 1e-4);
}

#[test]
fn drive_arm_shutdown_in_motion_brakes_before_power_off() {
    let mut bench = Bench::new(3);
    let wanted = bench.swing(0, 500);
    bench
        .drives
        .iter_mut()
        .for_each(|drive| drive.targets.clear());
    for _ in 0..1000 {
        bench.want(0, Some(wanted));
        bench.cycle(true);
    }
    assert!(bench.arm.is_off());
    for drive in &bench.drives {
        let acceleration = drive.acceleration(drive.targets.len());
        assert!(acceleration < 5.3, "braked at {acceleration} rad/s²");
        let goals = &drive.goals[1..];
        assert_eq!(goals.first(), Some(&Goal::SwitchedOn), "{goals:?}");
        assert_eq!(goals.last(), Some(&Goal::SwitchOnDisabled));
        assert!(!goals.contains(&Goal::QuickStop));
        assert_eq!(drive.state, State::SwitchOnDisabled);
        assert_eq!(drive.cut, None);
    }
    // 1 rad/s, set-points one and a half periods behind, and 1/(2 · 5.24) rad of braking.
    let stopped = bench.drives[0].position / PER_RAD;
    assert!((stopped - wanted - 0.094).abs() < 5e-3, "{stopped}");
}

#[test]
fn drive_arm_shutdown_does_not_power_off_drives() {
    let mut bench = Bench::new(2);
    let off = &mut bench.drives[1];
    (off.state, off.goal) = (State::SwitchOnDisabled, Goal::SwitchOnDisabled);
    bench.run(1, false);
    bench.drives[1].goals.clear();
    bench.run(1000, true);
    assert!(bench.arm.is_off());
    assert!(bench.drives[0].goals.contains(&Goal::SwitchedOn));
    assert_eq!(bench.drives[1].goals, [Goal::SwitchOnDisabled]);
}

#[test]
fn drive_arm_shutdown_uses_quick_stop_after_timeout() {
    let mut bench = Bench::new(2);
    bench.drives[1].runaway = 2e3;
    bench.run(100, false);
    let before = bench.drives[0].goals.len();
    let timeout = Shutdown::BRAKE_WITHIN.as_millis();
    bench.run(usize::try_from(timeout).unwrap(), true);
    assert_eq!(
        bench.drives[0].goals.len(),
        before,
        "it waits for standstill"
    );
    assert!(!bench.arm.is_off());
    bench.run(1000, true);
    assert_eq!(bench.drives[1].goals[before], Goal::QuickStop);
    assert_eq!(bench.drives[1].cut, None);
    assert!(bench.arm.is_off());
}

#[test]
fn drive_arm_runaway_joint_loses_power_at_once() {
    let mut bench = Bench::new(2);
    // 360 degrees in a second, of a joint that can be commanded 100.
    bench.drives[1].runaway = 5e5;
    let start = bench.drives[1].position;
    let powered = |bench: &Bench| bench.drives[1].state == State::OperationEnabled;
    let cycles = (0..100).take_while(|_| {
        bench.run(1, false);
        powered(&bench)
    });
    let cycles = cycles.count();
    assert!(cycles <= 10, "{cycles} cycles");
    let distance = (bench.drives[1].position - start) / TURN * 360.0;
    assert!(distance < 4.0, "it went {distance} degrees");
    bench.drives[1].runaway = 0.0;
    bench.run(5000, false);
    assert_eq!(bench.drives[1].state, State::SwitchOnDisabled);
    assert_eq!(bench.drives[0].state, State::OperationEnabled, "it holds");
    assert_eq!(bench.error(1), JointError::Runaway as i32);
    assert_eq!(bench.status(), DeviceStatus::SafeOperational);
    let (joint, event) = bench.arm.poll_event().unwrap();
    assert!(
        matches!((joint, event), (1, JointEvent::Runaway(_))),
        "{event}"
    );
    assert!(bench.arm.poll_event().is_none(), "reported once");
    // Its power is cycled.
    bench.drives[1].is_online = false;
    bench.run(1200, false);
    bench.drives[1].is_online = true;
    bench.run(2000, false);
    assert_eq!(bench.status(), DeviceStatus::Operational);
}

#[test]
fn drive_arm_following_error_removes_power() {
    let mut bench = Bench::new(1);
    // 14 degrees, of 10 that it may lag.
    bench.drives[0].load = 2e7;
    bench.run(100, false);
    assert_eq!(bench.error(0), JointError::Runaway as i32);
    assert_eq!(bench.drives[0].state, State::SwitchOnDisabled);
}

#[test]
fn drive_arm_joint_out_of_range_returns_slowly() {
    let degrees = TURN / 360.0;
    let mut bench = Bench::new(1);
    bench.drives[0].is_online = false;
    bench.run(2, false);
    bench.drives[0].position = 175.0 * degrees;
    bench.drives[0].is_online = true;
    bench.run(2000, false);
    assert_eq!(bench.status(), DeviceStatus::Operational);
    assert_eq!(bench.error(0), JointError::OutOfRange as i32);
    let (_, event) = bench.arm.poll_event().unwrap();
    let text = event.to_string();
    assert!(
        text.starts_with("position 175.00 degrees is out of range -170.00 to 170.00"),
        "{text}"
    );
    let stayed = bench.drives[0].position / degrees;
    assert!((stayed - 175.0).abs() < 1e-3, "{stayed}");
    // Set-points that begin at its position, at 30 degrees in a second.
    let mut fastest = 0.0_f64;
    for n in 0..900 {
        let wanted = 175.0 - 0.03 * f64::from(n).min(300.0);
        bench.want(0, Some(wanted.to_radians()));
        bench.cycle(false);
        if bench.drives[0].position > 170.0 * degrees {
            fastest = fastest.max(bench.drives[0].velocity.abs() / degrees / CYCLE.as_secs_f64());
        }
    }
    assert!((1.0..10.5).contains(&fastest), "{fastest} degrees/s");
    let there = bench.drives[0].position / degrees;
    assert!(there < 170.0, "{there}");
    assert_eq!(bench.error(0), JointError::None as i32);
}

#[test]
fn drive_arm_shutdown_skips_offline_drives() {
    let mut bench = Bench::new(2);
    bench.drives[0].has_fault = true;
    bench.drives[1].is_online = false;
    bench.run(2, false);
    assert_eq!(bench.status(), DeviceStatus::Offline);
    bench.run(1, true);
    assert!(bench.arm.is_off());
}

#[test]
fn drive_arm_lost_in_motion_reports_rest() {
    let mut bench = Bench::new(2);
    bench.swing(0, 300);
    for drive in &mut bench.drives {
        drive.is_online = false;
    }
    bench.want(0, None);
    bench.run(2, false);
    let velocity = |state: &DeviceState| state.joints[0].commanded_velocity;
    assert_eq!(bench.state.read_with(velocity), Some(0.0));
}

#[test]
fn drive_arm_invalid_limits_are_rejected() {
    let sound = |_: &DriveJoint<u8>| Ok(());
    assert_eq!(check(&config(2), sound), Ok(()));
    let fields: [fn(&mut DriveJoint<u8>) -> &mut f64; 6] = [
        |joint| &mut joint.increments_per_turn,
        |joint| &mut joint.zero,
        |joint| &mut joint.range[0],
        |joint| &mut joint.range[1],
        |joint| &mut joint.velocity_max,
        |joint| &mut joint.acceleration_max,
    ];
    for (number, field) in fields.iter().enumerate() {
        for value in [f64::INFINITY, f64::NEG_INFINITY, f64::NAN] {
            let mut arm = config(2);
            *field(&mut arm.joints[1]) = value;
            let error = check(&arm, sound).unwrap_err();
            let wanted = "arm arm: joint 1: increments_per_turn must not be 0";
            assert!(error.starts_with(wanted), "{number}, {value}: {error}");
        }
    }
    for (field, value) in [(4, 0.0), (5, 0.0), (5, 1e-320), (4, 1e300)] {
        let mut arm = config(1);
        *fields[field](&mut arm.joints[0]) = value;
        let error = check(&arm, sound).unwrap_err();
        assert!(
            error.contains("from 1e-6 to 1e9"),
            "{field}, {value}: {error}"
        );
    }
    let mut arm = config(1);
    arm.joints[0].zero = 2e9;
    let error = check(&arm, sound).unwrap_err();
    assert!(
        error.contains("170 degrees are 2236111111 increments"),
        "{error}"
    );
}

#[test]
fn drive_arm_nan_position_is_no_target() {
    let arm = config(1);
    let driven = Driven::new(&arm.joints[0]);
    assert_eq!(
        driven.increments(1.0),
        Some(rounded(PER_RAD)),
        "increments of a radian"
    );
    for position in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(driven.increments(position), None);
    }
}

#[test]
fn drive_arm_power_after_fault_follows_recovery_setting() {
    for recovery in [Recovery::Automatic, Recovery::OnRestart] {
        for away in [false, true] {
            let mut bench = Bench::new(3);
            bench.arm.recovery = recovery;
            bench.swing(0, 300);
            bench.want(0, None);
            let drive = &mut bench.drives[2];
            (drive.has_fault, drive.is_online) = (!away, !away);
            bench.run(50, false);
            assert_ne!(bench.status(), DeviceStatus::Operational);
            let drive = &mut bench.drives[2];
            (drive.has_fault, drive.is_online) = (false, true);
            // Braking, resting for a second, and enabling.
            bench.run(4000, false);
            let is_back = recovery == Recovery::Automatic;
            let what = format!("{recovery:?}, away {away}");
            assert_eq!(
                bench.status() == DeviceStatus::Operational,
                is_back,
                "{what}"
            );
            let powered = |drive: &Drive| drive.state == State::OperationEnabled;
            assert_eq!(bench.drives.iter().all(powered), is_back, "{what}");
            assert_eq!(bench.drives.iter().any(powered), is_back, "{what}");
            // The joint that moved was braked before its power went.
            assert!(bench.drives[0].cut.unwrap_or(0.0).abs() < 0.01, "{what}");
            let rests = bench.drives[0].position;
            bench.run(1000, false);
            let moved = (bench.drives[0].position - rests) / PER_RAD;
            assert!(
                moved.abs() < 1e-6,
                "{what}: {moved} rad by what was wanted before"
            );
        }
    }
}

/// A drive that lost its master shows Operation enabled for some cycles after its return, then its quick stop.
#[test]
fn drive_arm_returning_drive_is_not_operational_at_once() {
    let mut bench = Bench::new(2);
    bench.run(100, false);
    assert_eq!(bench.status(), DeviceStatus::Operational);
    bench.drives[1].is_online = false;
    bench.run(20, false);
    assert_eq!(bench.status(), DeviceStatus::Offline);
    bench.drives[1].is_online = true;
    bench.drives[1].state = State::OperationEnabled;
    for _ in 0..10 {
        bench.run(1, false);
        assert_eq!(bench.status(), DeviceStatus::SafeOperational);
    }
    bench.run(4000, false);
    assert_eq!(bench.status(), DeviceStatus::Operational);
}
