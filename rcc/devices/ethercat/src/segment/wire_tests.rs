//! What leaves for the drives of an emulated segment, frame by frame and in virtual time, while nets give set-points on
//! triangles that no joint can turn on: arms of CiA 402 drives, arms of youBots by position and by velocity, and the wheels
//! of a base. All is differentiated from the bytes of the frames.

use takt_cia402::dictionary::Address;
use takt_ethercat::emulator::{Entry, Segment, ServoConfig, ServoDrive, YouBot, YouBotConfig};
use takt_ethercat::youbot::{ARM, Command, Mecanum};
use takt_net::device::Words;
use takt_net::value::{Twist, Vector};

use super::*;
use crate::config::YouBotControl;
use takt_core::CellConfig;
use takt_core::cell::{DriverKind, Section};
use takt_core::device::driver::DeviceEnd;
use takt_core::device::{DeviceCommand, DeviceState, DeviceStatus, SetPoint};

mod ends;

/// A device as a net thread sees it.
pub(super) struct Seen {
    pub(super) state: LatestReader<DeviceState>,
    command: LatestWriter<DeviceCommand>,
    pub(super) given: DeviceCommand,
}

/// A segment, what leads its devices, and a net thread with the segment's cycle.
pub(super) struct Bench {
    master: Master,
    segment: Segment,
    pub(super) units: Units,
    pub(super) cycle: Nanos,
    tick: u64,
    /// Cycles by which the host was away so far.
    away: u64,
    pub(super) devices: Vec<Seen>,
    /// The one that moves.
    pub(super) device: usize,
    /// Whether a net thread elsewhere gives time and cycle of what is commanded.
    is_led: bool,
    is_ending: bool,
}

const KINDS: &[DriverKind] = &[DriverKind::new::<EthercatConfig>(Section::Bus("ethercat"))];

pub(super) fn config(text: &str) -> EthercatConfig {
    let text = format!("[[ethercat]]\nname = 'segment'\ninterface = 'none'\n{text}");
    let cell = CellConfig::parse(&text, KINDS).unwrap();
    cell.of_kind::<EthercatConfig>().next().unwrap().clone()
}

impl Bench {
    /// With the device of that number operational, which is the one that moves.
    pub(super) fn new(config: &EthercatConfig, segment: Segment, device: usize) -> Self {
        let mut devices = Vec::new();
        let mut ends = Vec::new();
        for _ in describe(config) {
            let (driver_state, state) = latest(1, || DeviceState::new(200));
            let (command, driver_command) = latest(1, || DeviceCommand::new(400));
            devices.push(Seen {
                state,
                command,
                given: DeviceCommand::new(400),
            });
            ends.push(DeviceEnd {
                state: driver_state,
                command: driver_command,
                net_period: config.cycle,
            });
        }
        let mut bench = Self {
            master: Master::new(master_config(config)).unwrap(),
            segment,
            units: Units::new(config, ends),
            cycle: config.cycle.into(),
            tick: 1000,
            away: 0,
            devices,
            device,
            is_led: false,
            is_ending: false,
        };
        for _ in 0..30_000 {
            bench.cycle();
            if bench.status() == DeviceStatus::Operational {
                return bench;
            }
        }
        panic!(
            "not operational, waits for {:?}",
            bench.units.youbots.waits_for()
        );
    }

    fn status(&mut self) -> DeviceStatus {
        self.devices[self.device]
            .state
            .read_with(|state| state.status)
    }

    /// The number of the last cycle.
    pub(super) const fn tick(&self) -> u64 {
        self.tick
    }

    fn now(&self) -> Nanos {
        Nanos((self.tick + self.away).cast_signed() * self.cycle.0)
    }

    /// A frame there and back, then what devices do in the rest of its cycle.
    pub(super) fn cycle(&mut self) {
        self.tick += 1;
        let now = self.now();
        let at = Duration::from_nanos(now.0.unsigned_abs());
        let mut frame = [0; FRAME];
        if let Some(len) = self.master.poll_transmit(at, &mut frame) {
            let mut bytes = frame[..len].to_vec();
            let ns = now.0.unsigned_abs();
            if let Some(returned) = self.segment.process(&mut bytes, Entry::First, ns) {
                let back = at + Duration::from_nanos(returned.after);
                self.master.handle_frame(0, &bytes, back);
            }
        }
        while self.master.poll_event().is_some() {}
        let tick = Tick {
            index: self.tick,
            missed: 0,
            time: now,
            scheduled: now,
            woken: now,
            phase_error: None,
        };
        for device in &mut self.devices {
            if !self.is_led {
                device.given.time = now;
                device.given.cycle = self.tick;
            }
            let given = &device.given;
            device
                .command
                .write_with(|command| command.copy_from(given));
        }
        while let Some(reply) = self.master.poll_reply() {
            let mut arms = self.units.arms.iter_mut();
            let other = arms.try_fold(reply, |reply, arm| arm.handle_reply(reply, &tick).err());
            if let Some(reply) = other {
                self.units.youbots.handle_reply(reply, &tick);
            }
        }
        let Units {
            arms,
            ios,
            servos,
            youbots,
        } = &mut self.units;
        servos.iter_mut().for_each(|servo| servo.take(&tick));
        for arm in arms {
            arm.cycle(&mut self.master, servos, &tick, self.is_ending);
        }
        for servo in servos {
            servo.publish(&tick);
        }
        for io in ios {
            io.cycle(&mut self.master, &tick);
        }
        let is_ending = self.is_ending;
        youbots.cycle(&mut self.master, &tick, is_ending);
    }

    /// The next frames are lost.
    pub(super) const fn lose(&mut self, frames: u32) {
        self.segment.faults.lose = frames;
    }

    /// The segment is without power for a while.
    pub(super) fn power_cycle(&mut self) {
        self.segment.set_power(0, false);
        (0..500).for_each(|_| self.cycle());
        self.segment.set_power(0, true);
    }

    /// The host is away for so many cycles, while slaves go on.
    pub(super) fn stand_still(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.away += 1;
            self.segment.poll(self.now().0.unsigned_abs());
        }
    }

    /// A set-point of a net with one in so many cycles.
    pub(super) fn want(&mut self, joint: usize, position: f64, every: i64) {
        let time = Nanos(self.now().0 + self.cycle.0);
        let set_points = &mut self.devices[self.device].given.joints[joint];
        set_points.period = Nanos(self.cycle.0 * every);
        set_points.advance(Some(SetPoint { time, position }));
    }

    pub(super) fn position(&mut self, joint: usize) -> f64 {
        let commanded = |state: &DeviceState| state.joints[joint].commanded_position;
        self.devices[self.device]
            .state
            .read_with(commanded)
            .unwrap()
    }

    fn onsets(&mut self, part: usize) -> u64 {
        self.devices[self.device]
            .state
            .read_with(|state| state.limited[part].onsets)
    }

    /// Swings a joint by set-points on a triangle, one in so many cycles, with a stall of the host in it. Gives what left
    /// in each frame, as `read` has it.
    fn triangle(
        &mut self,
        joint: usize,
        slope: f64,
        every: i64,
        read: impl Fn(&mut Self) -> f64,
    ) -> Vec<f64> {
        let start = self.position(joint);
        let cycles = 8_000_000_000 / self.cycle.0;
        let mut left = Vec::new();
        for n in 0..cycles {
            if n % every == 0 {
                let t = Nanos(n * self.cycle.0).as_secs_f64();
                let phase = t % 4.0;
                let profile = if phase < 2.0 { phase } else { 4.0 - phase };
                self.want(joint, start + slope * profile, every);
            }
            if n == cycles * 3 / 4 {
                self.away += 3;
            }
            self.cycle();
            left.push(read(self));
        }
        left
    }
}

/// The largest change of a rate between two spans of so many cycles.
fn hardest(values: &[f64], span: usize, dt_s: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few cycles")]
    let span_s = span as f64 * dt_s;
    let windows = values.windows(2 * span + 1);
    windows
        .map(|w| (w[2 * span] - 2.0 * w[span] + w[0]).abs() / (span_s * span_s))
        .fold(0.0, f64::max)
}

fn fastest(values: &[f64], span: usize, dt_s: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few cycles")]
    let span_s = span as f64 * dt_s;
    let windows = values.windows(span + 1);
    windows
        .map(|w| (w[span] - w[0]).abs() / span_s)
        .fold(0.0, f64::max)
}

/// Positions that left, in steps of `resolution`: within limits from frame to frame but for these steps, and over some
/// frames, where they do not count.
fn check(left: &[f64], resolution: f64, dt_s: f64, velocity: f64, acceleration: f64, what: &str) {
    let span = 16;
    let coarse = 2.0 * resolution / (dt_s * dt_s);
    let fine = coarse / 256.0;
    let (each, over) = (hardest(left, 1, dt_s), hardest(left, span, dt_s));
    assert!(
        each <= acceleration * 1.001 + coarse,
        "{what}: {each} rad/s²"
    );
    assert!(over <= acceleration * 1.001 + fine, "{what}: {over} rad/s²");
    let speed = fastest(left, span, dt_s);
    assert!(
        speed <= velocity + resolution / dt_s,
        "{what}: {speed} rad/s"
    );
    assert!(speed > 0.2, "{what}: it moves");
}

#[test]
fn cia402_triangles_leave_within_limits() {
    let turn = 409_600.0;
    let text = format!(
        "cycle = '2ms'\n\
         [[ethercat.slave]]\nname = 'drive'\nposition = 0\naxes = 1\n\
         [[ethercat.arm]]\nname = 'arm'\n\
         [[ethercat.arm.joint]]\nslave = 'drive'\nincrements_per_turn = {turn}\nrange = [-170.0, 170.0]\n\
         velocity_max = 100.0\nacceleration_max = 230.0\n"
    );
    let config = config(&text);
    for (every, slope) in [(1, 0.7), (2, 0.7), (10, 0.7), (50, 0.7), (500, 0.7)] {
        let mut servo = ServoConfig::default();
        let axis = &mut servo.axes[0];
        axis.quirks.missing_set_points = None;
        (axis.motor.negative_limit, axis.motor.positive_limit) = (-1e3, 1e3);
        axis.motor.stops = (-2e3, 2e3);
        let (slave, _drive) = ServoDrive::slave(servo).unwrap();
        let mut bench = Bench::new(&config, Segment::line([slave]), 0);
        let process = bench.master.slave(0).unwrap().process();
        let place = process.locate(Address::new(0x607A, 0), true).unwrap();
        let at = place.bit / 8;
        let left = bench.triangle(0, slope, every, |bench| {
            let bytes = bench.master.outputs_mut(0);
            let target = i32::from_le_bytes(*bytes[at..].first_chunk().unwrap());
            f64::from(target) / turn * std::f64::consts::TAU
        });
        assert_eq!(bench.status(), DeviceStatus::Operational);
        let what = format!("every {every}");
        let resolution = std::f64::consts::TAU / turn;
        check(
            &left,
            resolution,
            2e-3,
            100_f64.to_radians(),
            230_f64.to_radians(),
            &what,
        );
        if every < 100 {
            assert!(bench.onsets(0) > 0, "{what}");
        }
    }
}

pub(super) const YOUBOT: &str = "cycle = '4ms'\n[[ethercat.youbot_base]]\nname = 'base'\n\
    [[ethercat.youbot_arm]]\nname = 'arm'\nposition = 5\nhoming = true\nzero = 'folded'\n";
/// Where the drives of its wheels and of its fourth joint are, behind a power board each.
const WHEELS: [usize; 4] = [1, 2, 3, 4];
const JOINT_3: usize = 9;

fn youbot(control: YouBotControl, every: i64, firmware: usize) -> (Vec<f64>, f64) {
    let mut config = config(YOUBOT);
    config.youbot_arms[0].control = control;
    let firmware = [
        takt_ethercat::emulator::Firmware::V200,
        takt_ethercat::emulator::Firmware::V148,
    ][firmware];
    let (segment, _bot) = YouBot::segment(&YouBotConfig {
        firmware,
        ..YouBotConfig::default()
    });
    let mut bench = Bench::new(&config, segment, 1);
    let slave = JOINT_3;
    let left = bench.triangle(3, 0.6, every, |bench| {
        let bytes = bench.master.outputs_mut(slave);
        let Command { value, .. } = Command::decode(bytes).unwrap();
        match control {
            YouBotControl::Position => ARM[3].angle(value),
            YouBotControl::Velocity => ARM[3].speed(value),
        }
    });
    assert_eq!(bench.status(), DeviceStatus::Operational);
    let resolution = match control {
        YouBotControl::Position => ARM[3].angle(1) - ARM[3].angle(0),
        YouBotControl::Velocity => ARM[3].speed(1),
    };
    (left, resolution.abs())
}

#[test]
fn youbot_arm_triangles_leave_within_limits() {
    for every in [1, 5, 25, 250] {
        let (left, resolution) = youbot(YouBotControl::Position, every, 0);
        let what = format!("every {every}");
        check(
            &left,
            resolution,
            4e-3,
            90_f64.to_radians(),
            180_f64.to_radians(),
            &what,
        );
    }
}

#[test]
fn youbot_arm_triangles_leave_as_speeds_within_limits() {
    for every in [1, 25, 250] {
        let (left, resolution) = youbot(YouBotControl::Velocity, every, 1);
        let changes = left.windows(2).map(|pair| (pair[1] - pair[0]).abs() / 4e-3);
        let acceleration = changes.fold(0.0, f64::max);
        let limit = 180_f64.to_radians() + 1.01 * resolution / 4e-3;
        assert!(
            acceleration <= limit,
            "every {every}: {acceleration} rad/s²"
        );
        let speed = left.iter().fold(0.0_f64, |most, one| most.max(one.abs()));
        assert!(
            speed <= 90_f64.to_radians() + resolution && speed > 0.3,
            "{speed}"
        );
    }
}

#[test]
fn youbot_base_velocities_leave_within_limits() {
    let config = config(YOUBOT);
    let (segment, _bot) = YouBot::segment(&YouBotConfig::default());
    let mut bench = Bench::new(&config, segment, 0);
    let mecanum = Mecanum::default();
    let mut last = [0.0; 3];
    let steps = [
        [0.5, 0.0, 0.0],
        [-0.5, 0.3, 0.4],
        [3.0, 3.0, 5.0],
        [0.0, 0.0, -0.8],
        [0.0; 3],
    ];
    for (number, twist) in steps.into_iter().enumerate() {
        for n in 0..400_u32 {
            let [x, y, turn] = twist;
            let twist = Twist {
                vel: Vector::new(x, y, 0.0),
                rot: Vector::new(0.0, 0.0, turn),
            };
            let words = &mut bench.devices[0].given.words;
            let given = bench.tick + 1;
            (words[0], words[1], words[2]) = (given, given, 1);
            if number < 4 {
                twist.put_words(|i, word| words[3 + i] = word);
            }
            if number == 4 {
                // The net is over.
                words[1] = given - 2;
            }
            if number == 1 && n == 50 {
                bench.away += 20;
            }
            bench.cycle();
            let rpm = WHEELS.map(|slave| {
                Command::decode(bench.master.outputs_mut(slave))
                    .unwrap()
                    .value
            });
            let velocity = mecanum.velocity(rpm.map(|rpm| mecanum.rate(rpm)));
            let change: [f64; 3] = std::array::from_fn(|i| (velocity[i] - last[i]) / 4e-3);
            // Of speeds of motors in whole rpm.
            let coarse = mecanum.rate(1) * mecanum.radius / 4e-3;
            let floor = change[0].hypot(change[1]);
            assert!(
                floor <= 1.6 + 2.0 * coarse,
                "step {number}, {n}: {floor} m/s²"
            );
            let turning = change[2].abs();
            let coarse = coarse / mecanum.lever;
            assert!(
                turning <= 1.6 + coarse,
                "step {number}, {n}: {turning} rad/s²"
            );
            assert!(velocity[0].hypot(velocity[1]) <= 0.801 && velocity[2].abs() <= 0.801);
            last = velocity;
        }
        assert_eq!(bench.status(), DeviceStatus::Operational);
    }
    assert!(last.iter().all(|v| v.abs() < 1e-9), "{last:?}");
    assert!(bench.onsets(0) > 0 && bench.onsets(1) > 0);
}
