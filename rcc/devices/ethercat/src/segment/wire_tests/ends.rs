//! How devices of an emulated segment come to rest when the net that moves them ends: what leaves in its frames, and
//! where the emulated motors are.

use takt_ethercat::emulator::{DriveHandle, Io};
use takt_ethercat::youbot::Mode;

use super::*;
use crate::plant::{Ending, Jumps, Plant, Row, Wire, joint, outputs_follow_their_policy, velocity};
use takt_core::device::DeviceDescription;
use takt_core::device::continuity::JumpPart;

/// A segment with one device that moves.
struct Moved {
    bench: Bench,
    sent: Box<dyn Fn(&mut Bench) -> f64>,
    place: Box<dyn Fn() -> f64>,
    fail: Box<dyn Fn(bool)>,
}

impl Plant for Moved {
    fn now(&self) -> Nanos {
        self.bench.now()
    }

    fn run_to(&mut self, until: Nanos, given: &DeviceCommand, is_ending: bool) {
        let bench = &mut self.bench;
        (bench.is_led, bench.is_ending) = (true, is_ending);
        for device in &mut bench.devices {
            (device.given.time, device.given.cycle) = (given.time, given.cycle);
        }
        bench.devices[bench.device].given.copy_from(given);
        while bench.now() + bench.cycle <= until {
            bench.cycle();
        }
    }

    fn copy_state(&mut self, state: &mut DeviceState) {
        let device = &mut self.bench.devices[self.bench.device];
        device.state.read_with(|reported| state.copy_from(reported));
    }

    fn sent(&mut self) -> f64 {
        (self.sent)(&mut self.bench)
    }

    fn place(&mut self) -> f64 {
        (self.place)()
    }

    fn fail(&mut self, is_on: bool) {
        (self.fail)(is_on);
    }
}

fn description(config: &EthercatConfig, device: usize) -> DeviceDescription {
    describe(config).swap_remove(device)
}

/// Increments of a turn of a joint, and of its motor.
const TURN: f64 = 409_600.0;
const MOTOR: f64 = 4096.0;

fn two_axes() -> EthercatConfig {
    let joint = |axis: u8| {
        format!(
            "[[ethercat.arm.joint]]\nslave = 'drive'\naxis = {axis}\nincrements_per_turn = {TURN}\n\
             range = [-170.0, 170.0]\nvelocity_max = 100.0\nacceleration_max = 230.0\n"
        )
    };
    let [first, second] = [0, 1].map(joint);
    config(&format!(
        "cycle = '2ms'\n[[ethercat.slave]]\nname = 'drive'\nposition = 0\naxes = 2\n\
         [[ethercat.arm]]\nname = 'arm'\n{first}{second}"
    ))
}

fn cia402_row(config: &EthercatConfig) -> Row {
    Row {
        name: "CiA 402 over EtherCAT",
        description: description(config, 0),
        children: joint(0, [0.5, -0.5]),
        runs: 260,
        wire: Wire::Positions,
        acceleration: 230_f64.to_radians(),
        resolution: 2.0 * std::f64::consts::TAU / TURN,
        latency: Duration::from_millis(8),
        creep: 1e-3,
        without: |_, _| None,
    }
}

fn cia402(config: &EthercatConfig) -> (Moved, ServoDrive) {
    let mut axes = ServoConfig::default().axes;
    axes[0].quirks.missing_set_points = None;
    let motor = &mut axes[0].motor;
    (motor.negative_limit, motor.positive_limit) = (-1e3, 1e3);
    motor.stops = (-2e3, 2e3);
    axes.push(axes[0].clone());
    let (slave, drive) = ServoDrive::slave(ServoConfig::with_axes(axes)).unwrap();
    let bench = Bench::new(config, Segment::line([slave]), 0);
    let process = bench.master.slave(0).unwrap().process();
    let target = process.locate(Address::new(0x607A, 0), true).unwrap();
    let at = target.bit / 8;
    let (other, handle) = (drive.clone(), drive.clone());
    let moved = Moved {
        bench,
        sent: Box::new(move |bench| {
            let bytes = bench.master.outputs_mut(0);
            let target = i32::from_le_bytes(*bytes[at..].first_chunk().unwrap());
            f64::from(target) / TURN * std::f64::consts::TAU
        }),
        place: Box::new(move || {
            let turned = drive.axis(0, |axis| axis.motor().position).unwrap();
            turned * MOTOR / TURN
        }),
        // The other axis has a fault: this one brakes.
        fail: Box::new(move |is_on| {
            let volts = if is_on { 0.0 } else { 48.0 };
            other.axis(1, |axis| axis.dc_link = volts).unwrap();
        }),
    };
    (moved, handle)
}

#[test]
fn cia402_net_ends_frames_rest_within_stopping_time() {
    let config = two_axes();
    cia402_row(&config).comes_to_rest(|| cia402(&config).0);
}

/// Farther than its following error, which takes its power.
#[test]
fn cia402_encoder_jump_gives_scheduled_nets_back() {
    let config = two_axes();
    let (moved, drive) = cia402(&config);
    let jumps = Jumps {
        part: JumpPart::Joint(0),
        by: 0.2,
        is_fault: true,
    };
    jumps.check(&cia402_row(&config), moved, |_| {
        let turned = 0.2 * TURN / MOTOR;
        drive.axis(0, |axis| axis.motor_mut().position += turned);
    });
}

fn stop_button(drive: DriveHandle) -> Box<dyn Fn(bool)> {
    Box::new(move |is_on| drive.lock().emergency_stop = is_on)
}

fn youbot_arm_row(config: &EthercatConfig) -> Row {
    Row {
        name: "youBot arm",
        description: description(config, 1),
        // It begins at the end of its range.
        children: joint(3, [0.4, -0.06]),
        runs: 260,
        wire: Wire::Positions,
        acceleration: 180_f64.to_radians(),
        resolution: 2.0 * (ARM[3].angle(1) - ARM[3].angle(0)).abs(),
        latency: Duration::from_millis(16),
        creep: 0.02,
        without: |_, _| None,
    }
}

fn youbot_arm(config: &EthercatConfig) -> (Moved, DriveHandle) {
    let (segment, bot) = YouBot::segment(&YouBotConfig::default());
    let [moved, other] = [3, 2].map(|n: usize| bot.arms[0][n].clone());
    let last = std::cell::Cell::new(0.0);
    let handle = moved.clone();
    let all = Moved {
        bench: Bench::new(config, segment, 1),
        // While another joint does not follow, drives hold by speed: no position leaves.
        sent: Box::new(move |bench| {
            let command = Command::decode(bench.master.outputs_mut(JOINT_3)).unwrap();
            if command.mode == Mode::Position {
                last.set(ARM[3].angle(command.value));
            } else {
                assert_eq!(command, Command::HOLD);
            }
            last.get()
        }),
        place: Box::new(move || moved.lock().angle()),
        fail: stop_button(other),
    };
    (all, handle)
}

#[test]
fn youbot_arm_net_ends_frames_rest_within_stopping_time() {
    let config = config(YOUBOT);
    youbot_arm_row(&config).comes_to_rest(|| youbot_arm(&config).0);
}

#[test]
fn youbot_arm_encoder_jump_gives_scheduled_nets_back() {
    let config = config(YOUBOT);
    let (moved, drive) = youbot_arm(&config);
    let jumps = Jumps {
        part: JumpPart::Joint(3),
        by: 0.3,
        is_fault: false,
    };
    jumps.check(&youbot_arm_row(&config), moved, |_| {
        let ticks = 0.3 / (ARM[3].angle(1) - ARM[3].angle(0));
        drive.lock().disturb_encoder(ticks);
    });
}

fn youbot_base_row(config: &EthercatConfig) -> Row {
    let mecanum = Mecanum::default();
    let rpm = mecanum.rate(1) * mecanum.radius;
    Row {
        name: "youBot base",
        description: description(config, 0),
        children: velocity(0.5),
        runs: 360,
        wire: Wire::Speeds,
        acceleration: 1.6,
        resolution: rpm,
        latency: Duration::from_millis(16),
        creep: 0.01,
        without: |_, _| None,
    }
}

fn youbot_base(config: &EthercatConfig) -> (Moved, DriveHandle) {
    let (segment, bot) = YouBot::segment(&YouBotConfig::default());
    let [moved, other] = [0, 1].map(|n: usize| bot.wheels[n].clone());
    let radius = Mecanum::default().radius;
    let handle = moved.clone();
    let all = Moved {
        bench: Bench::new(config, segment, 0),
        sent: Box::new(|bench| {
            let mecanum = Mecanum::default();
            let rates = WHEELS.map(|slave| {
                let command = Command::decode(bench.master.outputs_mut(slave)).unwrap();
                mecanum.rate(command.value)
            });
            mecanum.velocity(rates)[0]
        }),
        place: Box::new(move || moved.lock().angle() * radius),
        fail: stop_button(other),
    };
    (all, handle)
}

#[test]
fn youbot_base_net_ends_frames_rest_within_stopping_time() {
    let config = config(YOUBOT);
    youbot_base_row(&config).comes_to_rest(|| youbot_base(&config).0);
}

#[test]
fn youbot_base_odometry_jump_gives_scheduled_nets_back() {
    let config = config(YOUBOT);
    let (moved, drive) = youbot_base(&config);
    let mecanum = Mecanum::default();
    let jumps = Jumps {
        part: JumpPart::Floor,
        // A motor has 4096 ticks a turn.
        by: mecanum.rate(60) * 12_000.0 / 4096.0 * mecanum.radius,
        is_fault: false,
    };
    jumps.check(&youbot_base_row(&config), moved, |_| {
        drive.lock().disturb_encoder(12_000.0);
    });
}

/// Its bars are stepper motors that ramp by themselves and get orders by mailbox.
#[test]
fn youbot_gripper_net_ends_bars_rest_within_stopping_time() {
    let config = config(&format!("{YOUBOT}gripper = 'hand'\n"));
    let to = |distance: f64| format!("j=KUKA::youBot::Gripper(Distance='{distance}',Robot='x')");
    let row = Row {
        name: "youBot gripper",
        description: description(&config, 2),
        children: [to(0.002), to(0.02)],
        runs: 120,
        wire: Wire::Positions,
        // The emulated bars stop at once, but the request to each goes through a mailbox.
        acceleration: 1.0,
        resolution: 1e-6,
        latency: Duration::from_millis(60),
        creep: 1e-6,
        without: |ending, every| {
            if ending == Ending::DeviceFault {
                Some("its bars report none: a jammed one stalls and stands")
            } else if every > 100 && matches!(ending, Ending::Itself | Ending::Cancel) {
                Some("its order is carried out before the net is evaluated again")
            } else {
                None
            }
        },
    };
    row.comes_to_rest(|| {
        let (segment, bot) = YouBot::segment(&YouBotConfig::default());
        let hand = bot.arms[0][4].clone();
        let opening = move || {
            let joint = hand.lock();
            let bars = joint.bars().unwrap().iter();
            bars.map(takt_ethercat::emulator::Bar::opening).sum::<f64>()
        };
        let sent = opening.clone();
        Moved {
            bench: Bench::new(&config, segment, 2),
            sent: Box::new(move |_| sent()),
            place: Box::new(opening),
            fail: Box::new(|_| ()),
        }
    });
}

#[test]
fn terminal_net_ends_outputs_follow_stated_policy() {
    for (on_end, expected) in [
        ("", (true, 2.0)),
        ("on_end = { bool = ['hold'], real = ['hold'] }", (true, 2.0)),
        ("on_end = { bool = [false], real = [0.5] }", (false, 0.5)),
        ("on_end = { bool = ['hold'], real = [-3] }", (true, -3.0)),
    ] {
        let config = config(&format!(
            "cycle = '1ms'\n[[ethercat.slave]]\nname = 'bits'\nposition = 0\n\
             [[ethercat.slave]]\nname = 'volts'\nposition = 1\n\
             [[ethercat.io]]\nname = 'io'\ndigital_out = [['bits', 8]]\n\
             analogue_out = [{{ slave = 'volts', bit = 0, scale = 0.5 }}]\n{on_end}\n"
        ));
        let ((bits, _bits), (volts, _volts)) = (Io::digital(8, 8), Io::analogue(2, 2));
        let moved = Moved {
            bench: Bench::new(&config, Segment::line([bits, volts]), 0),
            sent: Box::new(|_| 0.0),
            place: Box::new(|| 0.0),
            fail: Box::new(|_| ()),
        };
        outputs_follow_their_policy(&description(&config, 0), expected, 2, moved);
    }
}
