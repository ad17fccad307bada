//! Compliant motion as nets, on the emulated controllers and on the real wire: an arm comes down until it touches a
//! wall, presses with a given force, and stops when the wall vanishes. The results are read from the emulators in each
//! cycle; durations are not checked.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test may fail anywhere, its helpers too"
)]

mod common;

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use common::Cell;
use takt_core::NetId;
use takt_core::cell::CellConfig;
use takt_core::controller::Controller;
use takt_core::device::DeviceStatus;
use takt_core::device::driver::DriverConfig;
use takt_devices::fri::iiwa::Iiwa;
use takt_devices::fri::lwr::Lwr;
use takt_devices::fri::{IiwaConfig, IiwaModel, LwrConfig};
use takt_devices::fri::{iiwa, lwr};
use takt_fri::link::Link;
use takt_fri::linux::{UdpLink, monotonic};
use takt_fri::lwr::Protocol;
use takt_fri::lwr::emulator::{Contact, Krc, KrcConfig, Script, Shape, Timing};
use takt_fri::sunrise::emulator::{
    Cabinet, CabinetConfig, Control, Faults, Limits, Overlay, Program, Robot,
};
use takt_fri::sunrise::wire::{CommandMode, Dialect, MESSAGE_MAX, Quality};
use takt_net::JointLimits;
use takt_rt::thread::{Thread, ThreadConfig, spawn};

/// Where the arms begin, rad: bent, the flange well above the base.
const HOME: [f64; 7] = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0];
/// How far below the flange the wall begins, m.
const GAP: f64 = 0.02;
/// Net period, s: inverse kinematics is slow in a test build.
const PERIOD_S: f64 = 0.005;
/// The force to be held, N.
const FORCE: f64 = 20.0;
/// How far from it the force may be while it is held, N.
const BAND: f64 = 2.0;
/// The force that is never exceeded, N.
const FORCE_MAX: f64 = 60.0;
/// Checked cycles of the emulator while the force is held, and after the wall has vanished.
const LOOK: usize = 500;
/// Cycles that a test may last.
const CYCLES_MAX: usize = 120_000;
/// How many stalls of the host are tolerated.
const ATTEMPTS: usize = 5;

/// A robot controller with its arm: its true state.
trait Emulator: Send + 'static {
    fn due(&self) -> Duration;
    fn send(&mut self, now: Duration, buffer: &mut [u8]) -> Option<usize>;
    fn take(&mut self, datagram: &[u8], now: Duration);
    fn remove_wall(&mut self);
    fn sample(&self) -> Sample;
    /// Why it left command mode without a request.
    fn complaint(&self) -> Option<String>;
}

macro_rules! emulator {
    ($type:ty, $asked:pat) => {
        impl Emulator for $type {
            fn due(&self) -> Duration {
                self.poll_timeout()
            }

            fn send(&mut self, now: Duration, buffer: &mut [u8]) -> Option<usize> {
                self.poll_transmit(now, buffer)
            }

            fn take(&mut self, datagram: &[u8], now: Duration) {
                self.handle_datagram(datagram, now).unwrap();
            }

            fn remove_wall(&mut self) {
                *self.contact_mut() = None;
            }

            fn sample(&self) -> Sample {
                Sample {
                    set_point: self.set_point(),
                    joints: self.joints(),
                    height: self.flange()[2],
                    force: self.force()[2],
                }
            }

            fn complaint(&self) -> Option<String> {
                let mut reasons = self.log().map(|left| left.reason);
                let reason = reasons.find(|reason| !matches!(reason, $asked));
                reason.map(|reason| reason.to_string())
            }
        }
    };
}
emulator!(Krc, takt_fri::lwr::emulator::ExitReason::FriStop);
emulator!(Cabinet, takt_fri::sunrise::emulator::ExitReason::Cancelled);

/// One cycle of an emulator.
#[derive(Clone, Copy)]
struct Sample {
    set_point: [f64; 7],
    joints: [f64; 7],
    /// Of the flange, m.
    height: f64,
    /// On the flange, upwards, N.
    force: f64,
}

/// Shared by the thread of an emulator and the test.
#[derive(Default)]
struct Knobs {
    stop: AtomicBool,
    wall_is_gone: AtomicBool,
    cycles: AtomicUsize,
}

/// An emulator in a thread of its own, and its state in each of its cycles.
struct Served<E> {
    knobs: Arc<Knobs>,
    thread: Option<Thread<(Box<E>, Vec<Sample>)>>,
}

impl<E: Emulator> Served<E> {
    fn start(target: SocketAddr, make: impl FnOnce(Duration) -> E) -> Self {
        let knobs = Arc::new(Knobs::default());
        let turned = Arc::clone(&knobs);
        let config = ThreadConfig {
            priority: Some(88),
            ..ThreadConfig::new("emulator")
        };
        // Boxed: the stack of such a thread is small.
        let mut emulator = Box::new(make(monotonic().unwrap()));
        let thread = spawn(config, move || {
            let local = SocketAddr::from(([127, 0, 0, 1], 0));
            let mut link = UdpLink::connect(local, target).unwrap();
            let mut samples = Vec::with_capacity(CYCLES_MAX);
            while !turned.stop.load(Ordering::Relaxed) && samples.len() < CYCLES_MAX {
                turn(&mut *emulator, &mut link, &turned, &mut samples);
            }
            (emulator, samples)
        });
        Self {
            knobs,
            thread: Some(thread.unwrap()),
        }
    }

    fn cycles(&self) -> usize {
        self.knobs.cycles.load(Ordering::Relaxed)
    }

    fn end(mut self) -> (Box<E>, Vec<Sample>) {
        self.knobs.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

/// Until the next deadline of the emulator: answers, then a measurement.
fn turn<E: Emulator>(
    emulator: &mut E,
    link: &mut UdpLink,
    knobs: &Knobs,
    samples: &mut Vec<Sample>,
) {
    let mut buffer = [0; MESSAGE_MAX];
    let mut wait = emulator.due().saturating_sub(monotonic().unwrap());
    while let Some((len, at)) = link.receive(&mut buffer, wait).unwrap() {
        emulator.take(&buffer[..len], at);
        wait = Duration::ZERO;
    }
    let now = monotonic().unwrap();
    if now < emulator.due() {
        return;
    }
    if knobs.wall_is_gone.load(Ordering::Relaxed) {
        emulator.remove_wall();
    }
    while let Some(len) = emulator.send(now, &mut buffer) {
        link.send(&buffer[..len]).unwrap();
    }
    samples.push(emulator.sample());
    knobs.cycles.store(samples.len(), Ordering::Relaxed);
}

/// A stiff wall below the flange.
fn wall(height: f64) -> Contact {
    Contact {
        shape: Shape::Wall,
        point: [0.0, 0.0, height - GAP],
        normal: [0.0, 0.0, 1.0],
        stiffness: 5000.0,
        damping: 100.0,
    }
}

/// Tolerates stalls of tens of milliseconds, as of a host without `PREEMPT_RT`.
fn patient() -> Timing {
    Timing {
        misses_max: 100,
        bad_from: 0.0,
        ..Timing::default()
    }
}

// ----------------------------------------------------------------------------------------- nets

/// A value that is remembered from cycle to cycle, from 0 on, and grows by another one.
fn sum(name: &str, by: &str) -> String {
    format!(
        "{name}_pre=Core::DoublePre(inValue={name}.outValue),
        {name}_null=Core::DoubleIsNull(inValue={name}_pre.outValue),
        {name}_old=Core::DoubleConditional(inCondition={name}_null.outValue,inFalse={name}_pre.outValue),
        {name}=Core::DoubleAdd(inFirst={name}_old.outValue,inSecond={by})"
    )
}

/// A value within a range about 0.
fn within(name: &str, value: &str, limit: f64) -> String {
    let twice = 2.0 * limit;
    format!(
        "{name}_part=Core::Interval(inValue={value},Min='-{limit}',Max='{limit}'),
        {name}_wide=Core::DoubleMultiply(inFirst={name}_part.outValue,Second='{twice}'),
        {name}=Core::DoubleAdd(inFirst={name}_wide.outValue,Second='-{limit}')"
    )
}

fn out(family: &str, key: &str, link: &str) -> String {
    format!("w_{key}=Core::{family}NetcommOut(inValue={link},Key='{key}')")
}

/// Comes down at 3 cm/s until it touches; then the speed is `pressing`, m/s downwards; 0 once the contact is lost.
/// `lacks` is the missing force. Speeds change by 1 m/s² at most.
fn press(pressing: &str, more: &str) -> String {
    let home: Vec<_> = HOME.iter().map(f64::to_string).collect();
    let home = home.join(",");
    let joint = |i: usize| {
        format!(
            "g{i}=Core::DoubleArrayGet(inArray=inverse.outJoints,Size='7',Index='{i}'),
            j{i}=RobotArm::JointPosition(inPosition=g{i}.outValue,Robot='arm',Axis='{i}')"
        )
    };
    let joints: Vec<_> = (0..7).map(joint).collect();
    format!(
        "{{home=Core::DoubleArrayNetcommIn(Key='home',Value='[{home}]'),
        from=ArmKinematics::Kin(inJoints=home.outValue,Robot='arm'),
        sensor=KUKA::LWR::FMonitor(Robot='arm'),
        touch=Core::DoubleGreater(inFirst=sensor.outTcpFz,Second='5'),
        touched=Core::Trigger(inOn=touch.outValue),
        minus=Core::DoubleMultiply(inFirst=sensor.outTcpFz,Second='-1'),
        lacks=Core::DoubleAdd(inFirst=minus.outValue,Second='{FORCE}'),
        near=Core::DoubleGreater(First='{BAND}',inSecond=lacks.outValue),
        held=Core::Trigger(inOn=near.outValue),
        free=Core::DoubleGreater(First='1',inSecond=sensor.outTcpFz),
        gone=Core::BooleanAnd(inFirst=held.outActive,inSecond=free.outValue),
        lost=Core::Trigger(inOn=gone.outValue),
        pressing={pressing},
        {},
        moving=Core::DoubleConditional(inCondition=touched.outActive,inTrue=bounded.outValue,False='0.03'),
        aim=Core::DoubleConditional(inCondition=lost.outActive,inFalse=moving.outValue),
        back=Core::DoubleMultiply(inFirst=speed_old.outValue,Second='-1'),
        change=Core::DoubleAdd(inFirst=aim.outValue,inSecond=back.outValue),
        {},
        {},
        down=Core::DoubleMultiply(inFirst=speed.outValue,Second='-{PERIOD_S}'),
        {},
        shift=World::FrameFromXYZ(inZ=height.outValue),
        to=World::FrameTransform(inFirst=shift.outValue,inSecond=from.outFrame),
        inverse=ArmKinematics::InvKin(inFrame=to.outValue,inHintJoints=home.outValue,Robot='arm'),
        {},{more}{},{},{},cancel=Cancel(),outTerminate=cancel.outCancel}}",
        within("bounded", "pressing.outValue", 0.03),
        within("step", "change.outValue", PERIOD_S),
        sum("speed", "step.outValue"),
        sum("height", "down.outValue"),
        joints.join(","),
        out("Boolean", "held", "held.outActive"),
        out("Boolean", "lost", "lost.outActive"),
        out("Int", "error", "j0.outError"),
    )
}

/// The commanded height follows the force: the springs of the impedance turn it into one.
fn press_by_position() -> String {
    press(
        "Core::DoubleMultiply(inFirst=lacks.outValue,Second='0.002')",
        "",
    )
}

/// The arm stays where it touched, and a force is added to the springs until the sensor shows the wanted force.
fn press_by_wrench() -> String {
    let more = format!(
        "rate=Core::DoubleMultiply(inFirst=lacks.outValue,Second='5'),
        gain=Core::DoubleMultiply(inFirst=rate.outValue,Second='{PERIOD_S}'),
        grow=Core::DoubleConditional(inCondition=touched.outActive,inTrue=gain.outValue),
        {},
        {},
        against=Core::DoubleMultiply(inFirst=limited.outValue,Second='-1'),
        wrench=World::WrenchFromXYZ(inZ=against.outValue),
        added=World::WrenchSetNull(inNull=lost.outActive,inValue=wrench.outValue),
        impedance=KUKA::LWR::CartImpParameters(inAddTorque=added.outValue,Robot='arm'),
        {},",
        sum("push", "grow.outValue"),
        within("limited", "push.outValue", 50.0),
        out("Int", "refused", "impedance.outError"),
    );
    press("Core::DoubleValue(Value='0')", &more)
}

/// Switches an LWR to Cartesian impedance, softer along z than its default.
fn give_way() -> String {
    format!(
        "{{two=Core::IntValue(Value='2'),
        order=KUKA::LWR::ControlStrategy(inStrategy=two.outValue,Robot='arm'),
        soft=World::WrenchValue(Value='{{force:{{x:3000,y:3000,z:1500}},torque:{{x:200,y:200,z:200}}}}'),
        damped=World::WrenchValue(Value='{{force:{{x:0.7,y:0.7,z:0.9}},torque:{{x:0.7,y:0.7,z:0.7}}}}'),
        impedance=KUKA::LWR::CartImpParameters(inStiffness=soft.outValue,inDamping=damped.outValue,
            Robot='arm'),
        {},{},{},cancel=Cancel(),outTerminate=cancel.outCancel}}",
        out("Boolean", "done", "order.outCompleted"),
        out("Int", "refused", "order.outError"),
        out("Int", "impedance", "impedance.outError"),
    )
}

fn is(controller: &Controller, net: NetId, key: &str, value: &str) -> bool {
    let values = controller.out_values(net);
    let key = format!("out{key}");
    values
        .iter()
        .any(|(name, text)| *name == key && text == value)
}

// ---------------------------------------------------------------------------------------- tests

/// Result of an arm that pressed and lost its contact.
struct Seen {
    samples: Vec<Sample>,
    /// Cycle in which the net held its force for the first time.
    held: usize,
    /// Cycle in which the wall vanished.
    vanished: usize,
}

impl Seen {
    /// No joint was beyond its limits, by the emulator's own set-points and joints.
    fn keeps_limits(&self, limits: &[JointLimits], period_s: f64) {
        for pair in self.samples.windows(2) {
            for (axis, limits) in limits.iter().enumerate() {
                let [before, now] = [pair[0], pair[1]].map(|sample| sample.set_point[axis]);
                let speed = (now - before).abs() / period_s;
                assert!(
                    speed <= limits.velocity_max * 1.02,
                    "axis {axis}: {speed} rad/s"
                );
                for position in [now, pair[1].joints[axis]] {
                    let range = limits.position_min..=limits.position_max;
                    assert!(range.contains(&position), "axis {axis}: {position} rad");
                }
            }
        }
    }

    /// The force was reached, never far exceeded, and held while the wall was there.
    fn holds(&self) {
        let there = &self.samples[..self.vanished];
        let most = there.iter().map(|sample| sample.force).fold(0.0, f64::max);
        assert!(most < FORCE_MAX, "{most} N");
        for sample in &there[self.held..] {
            let off = (sample.force - FORCE).abs();
            assert!(off <= BAND + 1.0, "{} N while held", sample.force);
        }
        let settled = &there[there.len() - 50..];
        assert!(settled.iter().all(|s| (s.force - FORCE).abs() <= BAND));
    }

    /// The arm moved beyond the wall by no more than the strain of its springs, and stopped.
    fn stops(&self) {
        let before = self.samples[self.vanished - 1].height;
        let after = &self.samples[self.vanished..];
        let lowest = after.iter().map(|s| s.height).fold(before, f64::min);
        assert!(before - lowest < 0.03, "{} m down", before - lowest);
        let last = self.samples.last().unwrap();
        let end = &self.samples[self.samples.len() - 50..];
        for sample in end {
            assert!((sample.height - last.height).abs() < 1e-4, "it still moves");
            for (now, at_last) in sample.set_point.iter().zip(last.set_point) {
                assert!((now - at_last).abs() < 1e-7, "set-points go on");
            }
            assert!(sample.force.abs() < 1e-9);
        }
    }
}

/// Lets the net press, then takes the wall away. Returns the cause if the arm was lost, as by a stall of the host.
fn run<E: Emulator>(cell: &Cell, served: Served<E>, text: &str) -> Result<(Box<E>, Seen), String> {
    let faults = || cell.controller.arm_state("arm").unwrap().faults;
    let before = faults();
    let net = cell.load(text);
    cell.controller
        .start_net(net)
        .map_err(|error| error.to_string())?;
    let wait = |what: &str, done: &dyn Fn(&Controller) -> bool| {
        cell.wait(what, |c| done(c) || cell.is_over(net));
    };
    wait("the force held", &|c| is(c, net, "held", "true"));
    // The controller of the net settles.
    let held = served.cycles() + 2 * LOOK;
    wait("cycles of holding", &|_| served.cycles() > held + LOOK);
    let vanished = served.cycles() + 100;
    wait("the last of them", &|_| served.cycles() > vanished);
    served.knobs.wall_is_gone.store(true, Ordering::Relaxed);
    wait("the loss to be seen", &|c| is(c, net, "lost", "true"));
    let lost = served.cycles();
    wait("cycles of rest", &|_| served.cycles() > lost + 2 * LOOK);
    let is_running = !cell.is_over(net);
    let is_fine = is(&cell.controller, net, "error", "0");
    let (emulator, samples) = served.end();
    let values = cell.controller.out_values(net);
    if faults() > before {
        let left = emulator.complaint();
        return Err(format!("left command mode: {left:?}, {values:?}"));
    }
    let end = cell.controller.net(net).unwrap().end;
    assert!(is_running && is_fine, "{end:?} {values:?}");
    let first_free = samples[vanished..]
        .iter()
        .position(|s| s.force.abs() < 1e-9);
    let vanished = vanished + first_free.unwrap();
    let seen = Seen {
        samples,
        held,
        vanished,
    };
    Ok((emulator, seen))
}

fn cell(config: Arc<dyn DriverConfig>) -> Cell {
    let mut config = CellConfig {
        devices: vec![config],
        ..CellConfig::default()
    };
    config.controller.period = Duration::from_secs_f64(PERIOD_S);
    Cell {
        controller: Controller::start(&config).unwrap(),
        robots: Vec::new(),
    }
}

fn press_with_lwr() -> Result<(), String> {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let cell = cell(Arc::new(LwrConfig {
        handshake: Some(Protocol::Rcc),
        ..LwrConfig::new("arm", anywhere)
    }));
    let address = cell.controller.with_drivers(Lwr::address)[0];
    let period = Duration::from_millis(1);
    let served = Served::start(address, move |now| {
        let config = KrcConfig {
            period,
            joints: HOME,
            timing: patient(),
            script: Script::Handshake(Protocol::Rcc),
            ..KrcConfig::default()
        };
        let mut krc = Krc::new(config, now);
        *krc.contact_mut() = Some(wall(krc.flange()[2]));
        krc
    });
    cell.wait_for("arm", DeviceStatus::Operational);
    let strategy = cell.load(&give_way());
    cell.controller.start_net(strategy).unwrap();
    cell.wait("Cartesian impedance", |c| {
        assert!(
            !is(c, strategy, "refused", "4"),
            "{:?}",
            c.out_values(strategy)
        );
        is(c, strategy, "done", "true") && is(c, strategy, "impedance", "0")
    });
    cell.wait_for("arm", DeviceStatus::Operational);
    let (krc, seen) = run(&cell, served, &press_by_position())?;
    assert_eq!(krc.complaint(), None);
    seen.keeps_limits(&lwr::describe("arm").limits, period.as_secs_f64());
    seen.holds();
    seen.stops();
    Ok(())
}

fn press_with_iiwa() -> Result<(), String> {
    let anywhere = SocketAddr::from(([127, 0, 0, 1], 0));
    let cell = cell(Arc::new(IiwaConfig {
        model: IiwaModel::Iiwa7,
        ..IiwaConfig::new("arm", anywhere)
    }));
    let address = cell.controller.with_drivers(Iiwa::address)[0];
    let period = Duration::from_millis(2);
    let served = Served::start(address, move |now| {
        let overlay = Overlay {
            control: Control::CartesianImpedance {
                stiffness: [3000.0, 3000.0, 1500.0, 200.0, 200.0, 200.0],
                damping: [0.7, 0.7, 0.9, 0.7, 0.7, 0.7],
            },
            command: CommandMode::Wrench,
        };
        let restart = Some(Duration::from_millis(100));
        let config = CabinetConfig {
            robot: Robot::Iiwa7,
            limits: Limits::of(Robot::Iiwa7),
            // Reports torques only: the force is computed from them.
            dialect: Dialect::V1,
            send_period: period,
            joints: HOME,
            timing: patient(),
            faults: Faults {
                quality: Some(Quality::Excellent),
                ..Faults::default()
            },
            program: Program::Auto { overlay, restart },
            ..CabinetConfig::default()
        };
        let mut cabinet = Cabinet::new(config, now);
        *cabinet.contact_mut() = Some(wall(cabinet.flange()[2]));
        cabinet
    });
    cell.wait_for("arm", DeviceStatus::Operational);
    let (cabinet, seen) = run(&cell, served, &press_by_wrench())?;
    assert_eq!(cabinet.complaint(), None);
    let limits = iiwa::describe("arm", IiwaModel::Iiwa7).limits;
    seen.keeps_limits(&limits, period.as_secs_f64());
    seen.holds();
    seen.stops();
    Ok(())
}

/// Repeats if the arm was lost: the host stalled for longer than the controllers tolerate.
fn retried(attempt: impl Fn() -> Result<(), String>) {
    let mut lost = Vec::new();
    while lost.len() < ATTEMPTS {
        match attempt() {
            Ok(()) => return,
            Err(why) => lost.push(why),
        }
    }
    panic!("the arm was lost in each of {ATTEMPTS} attempts: {lost:#?}");
}

#[test]
fn lwr_presses_wall_stops_when_wall_vanishes() {
    retried(press_with_lwr);
}

#[test]
fn iiwa_presses_wall_stops_when_wall_vanishes() {
    retried(press_with_iiwa);
}
