//! One drive of a youBot with its motor: modes, commutation, the EtherCAT timeout, I2t, and TMCL requests. Its frames
//! are handled elsewhere.

use std::f64::consts::TAU;

use takt_cia402::emulator::{Motor, MotorConfig};

use super::Firmware;
use super::gripper::Bar;
use super::parameters::{Parameters, whole};
use super::tmcl::{Rejection, Request, command, reply};
use super::weight::Posture;

/// Period of the control loops, s.
const TICK: f64 = 250e-6;
/// Longest time simulated at once, s.
const STEP_MAX: f64 = 0.1;
/// Encoder ticks in a revolution of the motor.
const TICKS: f64 = 4000.0;
/// Duration of the commutation search, s.
const COMMUTATION: f64 = 0.4;
/// Duty of full supply voltage, steps: the real value is not published.
const PWM_FULL: f64 = 3599.0;
/// V.
const SUPPLY: f64 = 24.0;
/// Of a winding, ohm.
const RESISTANCE: f64 = 1.0;
/// Largest current, A.
const CURRENT_MAX: f64 = 10.0;

/// Modes of the process data.
mod mode {
    pub(super) const STOP: u8 = 0;
    pub(super) const POSITION: u8 = 1;
    pub(super) const VELOCITY: u8 = 2;
    pub(super) const NO_ACTION: u8 = 3;
    pub(super) const SET_POSITION: u8 = 4;
    pub(super) const PWM: u8 = 5;
    pub(super) const CURRENT: u8 = 6;
    pub(super) const INITIALIZE: u8 = 7;
}

/// Bits of the flags.
mod flag {
    pub(super) const OVER_CURRENT: u32 = 1 << 0;
    pub(super) const HALTED: u32 = 1 << 4;
    pub(super) const PWM: u32 = 1 << 8;
    pub(super) const VELOCITY: u32 = 1 << 9;
    pub(super) const POSITION: u32 = 1 << 10;
    pub(super) const TORQUE: u32 = 1 << 11;
    pub(super) const EMERGENCY_STOP: u32 = 1 << 12;
    pub(super) const REACHED: u32 = 1 << 14;
    pub(super) const INITIALIZED: u32 = 1 << 15;
    pub(super) const TIMEOUT: u32 = 1 << 16;
    pub(super) const I2T: u32 = 1 << 17;
}

/// Mechanics of a drive.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    motor: MotorConfig,
    /// Position of the motor at power-on, rad.
    position: f64,
    /// Torque constant, N m/A.
    torque_constant: f64,
    gear: f64,
    has_gripper: bool,
}

/// Gear, torque constant, range in degrees.
const JOINTS: [(f64, f64, f64); 5] = [
    (156.0, 0.0335, 338.0),
    (156.0, 0.0335, 155.0),
    (100.0, 0.0335, 297.0),
    (71.0, 0.051, 205.0),
    (71.0, 0.049, 335.0),
];

impl Axis {
    /// A wheel with its quarter of the base.
    pub fn wheel() -> Self {
        Self {
            motor: MotorConfig {
                inertia: 3e-5,
                viscous: 1e-5,
                coulomb: 0.01,
                stops: (-1e12, 1e12),
                ..MotorConfig::default()
            },
            position: 0.0,
            torque_constant: 0.0335,
            gear: 9405.0 / 364.0,
            has_gripper: false,
        }
    }

    /// A joint of the arm (0 to 4) with its distance from the home stop at power-on (rad of the joint). The home stop
    /// is at the positive end of the motor.
    pub fn joint(number: usize, folded: f64) -> Self {
        let number = number.min(4);
        let (gear, torque_constant, range) = JOINTS[number];
        Self {
            motor: MotorConfig {
                inertia: 1e-5,
                viscous: 1e-5,
                coulomb: 0.006,
                stops: (-range.to_radians() * gear, 0.0),
                ..MotorConfig::default()
            },
            position: -folded * gear,
            torque_constant,
            gear,
            has_gripper: number == 4,
        }
    }
}

/// A drive with its motor.
#[derive(Clone, Debug)]
pub struct Joint {
    axis: Axis,
    /// Its arm, and its joint number.
    arm: Option<(Posture, usize)>,
    firmware: Firmware,
    version: String,
    motor: Motor,
    /// Encoder position is that of the motor plus this, ticks.
    origin: f64,
    parameters: Parameters,
    banks: [Parameters; 2],
    bars: Option<[Bar; 2]>,
    mode: u8,
    value: i32,
    /// Velocity of the ramp, rad/s.
    ramp: f64,
    integral: f64,
    /// A, of the motor.
    current: f64,
    commuting: f64,
    initialized: bool,
    /// Time since the last outputs, s.
    silent: f64,
    timeout: bool,
    i2t: bool,
    unlocked: bool,
    /// I2t sum in (10 mA)².
    heat: f64,
    /// The emergency stop is pressed: the motor gets no current.
    pub emergency_stop: bool,
    /// Injected flags, shown in addition to those of the drive.
    pub extra_flags: u32,
    /// External torque at the joint, N m.
    pub pushed: f64,
}

impl Joint {
    pub(super) fn new(
        axis: Axis,
        arm: Option<(Posture, usize)>,
        firmware: Firmware,
        version: String,
    ) -> Self {
        let mut motor = Motor::new(axis.motor.clone(), axis.position);
        motor.braked = false;
        let bars = axis
            .has_gripper
            .then(|| [Bar::new(-20_000.0), Bar::new(-20_000.0)]);
        Self {
            origin: -axis.position / TAU * TICKS,
            motor,
            axis,
            arm,
            firmware,
            version,
            parameters: Parameters::drive(),
            banks: [Parameters::bank(0), Parameters::bank(2)],
            bars,
            mode: mode::STOP,
            value: 0,
            ramp: 0.0,
            integral: 0.0,
            current: 0.0,
            commuting: 0.0,
            initialized: false,
            silent: 0.0,
            timeout: false,
            i2t: false,
            unlocked: false,
            heat: 0.0,
            emergency_stop: false,
            extra_flags: 0,
            pushed: 0.0,
        }
    }

    /// Power-on: the arm stays where it is, the drive loses its position.
    pub(super) fn reset(&mut self) {
        let mut axis = self.axis.clone();
        axis.position = self.motor.position;
        let mut parameters = self.parameters.clone();
        let mut banks = self.banks.clone();
        parameters.reset();
        banks.iter_mut().for_each(Parameters::reset);
        let bars = self.bars.take();
        let (arm, version) = (self.arm.take(), std::mem::take(&mut self.version));
        *self = Self::new(axis, arm, self.firmware, version);
        (self.parameters, self.banks) = (parameters, banks);
        if let Some(bars) = bars {
            self.bars = Some(bars.map(|bar| Bar::new(bar.position)));
        }
    }

    pub(super) const fn firmware(&self) -> Firmware {
        self.firmware
    }

    /// Sets the I2t flag, as too much current for too long does.
    pub fn overheat(&mut self) {
        self.heat = 2.0 * f64::from(self.parameters.value(26));
    }

    /// Its encoder counts on from so many ticks farther, as a disturbance makes it; nothing turns.
    pub fn disturb_encoder(&mut self, ticks: f64) {
        self.origin += ticks;
    }

    /// Distance of the joint from its home stop, or of the wheel from its start, rad; positive away from the stop.
    pub fn angle(&self) -> f64 {
        -self.motor.position / self.axis.gear
    }

    /// The bars of the gripper, at the last joint.
    pub const fn bars(&self) -> Option<&[Bar; 2]> {
        self.bars.as_ref()
    }

    /// The same, to inject faults.
    pub const fn bars_mut(&mut self) -> Option<&mut [Bar; 2]> {
        self.bars.as_mut()
    }

    /// Encoder position, ticks.
    fn ticks(&self) -> f64 {
        self.motor.position / TAU * TICKS + self.origin
    }

    fn rpm(&self) -> f64 {
        self.motor.velocity * 60.0 / TAU
    }

    /// Takes outputs: a value and a mode.
    pub(super) fn command(&mut self, outputs: &[u8]) {
        let Some([a, b, c, d, mode]) = outputs.first_chunk().copied() else {
            return;
        };
        let value = i32::from_le_bytes([a, b, c, d]);
        match mode {
            mode::NO_ACTION => {}
            mode::SET_POSITION => self.set_ticks(value),
            mode::PWM | mode::INITIALIZE if self.firmware == Firmware::V200 => {}
            mode::STOP..=mode::INITIALIZE => self.order(mode, value),
            _ => {}
        }
    }

    fn order(&mut self, mode: u8, value: i32) {
        if mode != self.mode {
            (self.ramp, self.integral) = (self.motor.velocity, 0.0);
        }
        (self.mode, self.value) = (mode, value);
    }

    fn set_ticks(&mut self, value: i32) {
        self.origin += f64::from(value) - self.ticks();
    }

    /// Advances by a time in ns; `live` while EtherCAT is in OP, `fresh` with new outputs.
    pub(super) fn step(&mut self, dt: u64, live: bool, fresh: bool) {
        let mut left = (dt as f64 * 1e-9).min(STEP_MAX);
        self.silent = if fresh || !live {
            0.0
        } else {
            self.silent + left
        };
        let limit = f64::from(self.banks[0].value(90)) * 1e-3;
        self.timeout |= limit > 0.0 && self.silent > limit;
        while left > 0.0 {
            let tick = left.min(TICK);
            self.tick(tick, live);
            left -= TICK;
        }
        self.show();
    }

    fn tick(&mut self, dt: f64, live: bool) {
        self.commute(dt);
        let wanted = self.wanted_current(dt, live);
        self.current = wanted.clamp(-CURRENT_MAX, CURRENT_MAX);
        self.warm(dt);
        let angle = self.angle();
        let weight = self.arm.as_ref();
        let weight = weight.map_or(0.0, |(posture, number)| posture.weigh(*number, angle));
        self.motor.external = (self.pushed - weight) / self.axis.gear;
        self.motor
            .step(self.current * self.axis.torque_constant, dt);
        for bar in self.bars.iter_mut().flatten() {
            bar.step(dt);
        }
    }

    /// The commutation search: by turning (2.00) or by mode 7 (1.48).
    fn commute(&mut self, dt: f64) {
        let turns = match self.firmware {
            Firmware::V148 => self.mode == mode::INITIALIZE,
            Firmware::V200 => self.mode == mode::VELOCITY && self.value != 0,
        };
        if self.initialized || !turns || self.timeout || self.emergency_stop {
            return;
        }
        self.commuting += dt;
        self.initialized = self.commuting >= COMMUTATION;
    }

    /// The current demanded by the mode, A.
    fn wanted_current(&mut self, dt: f64, live: bool) -> f64 {
        let finding = self.commuting > 0.0 || self.initialized;
        if self.emergency_stop || self.i2t || !finding {
            (self.ramp, self.integral) = (self.motor.velocity, 0.0);
            return 0.0;
        }
        let mode = if self.timeout || !live {
            mode::STOP
        } else {
            self.mode
        };
        let value = f64::from(self.value);
        match mode {
            mode::POSITION if self.initialized => self.current_to(value, dt),
            mode::VELOCITY => self.current_at(value * TAU / 60.0, dt),
            mode::PWM if self.initialized => {
                let volts = (value / PWM_FULL).clamp(-1.0, 1.0) * SUPPLY;
                (volts - self.axis.torque_constant * self.motor.velocity) / RESISTANCE
            }
            // The drive itself does not clamp it to parameter 6.
            mode::CURRENT if self.initialized => value / 1000.0,
            mode::INITIALIZE if !self.initialized => {
                // It pulls the rotor to and fro.
                0.5 * (self.commuting / COMMUTATION * TAU).sin()
            }
            _ => self.current_at(0.0, dt),
        }
    }

    fn current_to(&mut self, target: f64, dt: f64) -> f64 {
        let distance = (target - self.ticks()) / TICKS * TAU;
        let rad = |rpm: i32| f64::from(rpm) * TAU / 60.0;
        let most = rad(self.parameters.value(4));
        let braking = (2.0 * rad(self.parameters.value(11)) * distance.abs()).sqrt();
        let speed = most.min(braking).min(distance.abs() * 30.0);
        self.current_at(speed.copysign(distance), dt)
    }

    /// A PI loop after a ramp (parameters 146 and 11), limited by parameter 6.
    fn current_at(&mut self, target: f64, dt: f64) -> f64 {
        let step = f64::from(self.parameters.value(11)) * TAU / 60.0 * dt;
        self.ramp = if self.parameters.value(146) == 0 {
            target
        } else {
            self.ramp + (target - self.ramp).clamp(-step, step)
        };
        let error = self.ramp - self.motor.velocity;
        let stiffness = self.axis.motor.inertia / self.axis.torque_constant;
        let most = (f64::from(self.parameters.value(6)) / 1000.0).min(CURRENT_MAX);
        let gain = 200.0 * stiffness;
        let integral = self.integral + 40.0 * gain * error * dt;
        self.integral = integral.clamp(-most, most);
        (gain * error + self.integral).clamp(-most, most)
    }

    /// I2t: a low-pass of the squared current over parameter 25 (ms), compared with parameter 26. The unit of the real
    /// parameter is not published; here it is (10 mA)².
    fn warm(&mut self, dt: f64) {
        let time = f64::from(self.parameters.value(25).max(1)) * 1e-3;
        let squared = (self.current * 100.0).powi(2);
        self.heat += (squared - self.heat) * (dt / time).min(1.0);
        if self.heat > f64::from(self.parameters.value(26)) && !self.i2t {
            self.i2t = true;
            let times = self.parameters.value(28);
            self.parameters.set(28, times.saturating_add(1));
        }
    }

    /// The flags, as process data and parameter 156 show them.
    pub fn flags(&self) -> u32 {
        let limit = f64::from(self.parameters.value(6)) / 1000.0;
        let halted = f64::from(self.parameters.value(9));
        let window = f64::from(self.parameters.value(10));
        let reached = (f64::from(self.value) - self.ticks()).abs() <= window;
        let shown = match self.mode {
            mode::POSITION => flag::POSITION,
            mode::VELOCITY | mode::STOP => flag::VELOCITY,
            mode::PWM => flag::PWM,
            mode::CURRENT => flag::TORQUE,
            _ => 0,
        };
        let set = [
            (flag::OVER_CURRENT, self.current.abs() > limit),
            (flag::HALTED, self.rpm().abs() <= halted),
            (flag::EMERGENCY_STOP, self.emergency_stop),
            (flag::REACHED, self.mode == mode::POSITION && reached),
            (flag::INITIALIZED, self.initialized),
            (flag::TIMEOUT, self.timeout),
            (flag::I2T, self.i2t),
        ];
        let found = set.iter().filter(|(_, so)| *so).map(|(bit, _)| bit);
        found.fold(shown | self.extra_flags, |all, bit| all | bit)
    }

    /// Updates parameters that show measurements.
    fn show(&mut self) {
        let values = [
            (1, whole(self.ticks())),
            (3, whole(self.rpm())),
            (13, whole(self.ramp * 60.0 / TAU)),
            (15, i32::from(self.initialized)),
            (27, whole(self.heat)),
            (150, whole(self.current * 1000.0)),
            (156, self.flags().cast_signed()),
        ];
        for (number, value) in values {
            self.parameters.set(number, value);
        }
    }

    /// Writes the inputs of the firmware.
    pub(super) fn feedback(&self, inputs: &mut [u8]) {
        let target = |of: u8| if self.mode == of { self.value } else { 0 };
        let common = [
            whole(self.ticks()),
            whole(self.current * 1000.0),
            whole(self.rpm()),
            self.flags().cast_signed(),
        ];
        let more = match self.firmware {
            Firmware::V148 => {
                let volts =
                    self.current * RESISTANCE + self.axis.torque_constant * self.motor.velocity;
                [whole(volts / SUPPLY * PWM_FULL), 0, 0, 0]
            }
            Firmware::V200 => [
                target(mode::POSITION),
                target(mode::CURRENT),
                target(mode::VELOCITY),
                whole(self.ramp * 60.0 / TAU),
            ],
        };
        let values = common.into_iter().chain(more);
        for (to, value) in inputs.chunks_exact_mut(4).zip(values) {
            to.copy_from_slice(&value.to_le_bytes());
        }
    }

    /// Answers a TMCL request; returns whether there is an answer.
    pub(in crate::emulator) fn tmcl(&mut self, request: &[u8], answer: &mut Vec<u8>) -> bool {
        let Some(request) = Request::decode(request) else {
            return false;
        };
        answer.clear();
        if request.command == command::FIRMWARE {
            answer.extend(self.version.as_bytes().iter().take(8));
            return true;
        }
        let done = match (request.module, &mut self.bars) {
            (0, _) => self.tmcl_drive(&request),
            (1, Some([first, second])) => match (request.command, request.motor) {
                (command::SGP | command::GGP | command::STGP | command::RSGP, _) => {
                    self.tmcl_drive(&request)
                }
                (_, 0) => first.tmcl(&request),
                (_, 1) => second.tmcl(&request),
                _ => Err(Rejection::WrongType),
            },
            _ => Err(Rejection::InvalidCommand),
        };
        answer.extend(reply(&request, done));
        true
    }

    fn tmcl_drive(&mut self, request: &Request) -> Result<i32, Rejection> {
        let value = request.value;
        let bank = match request.motor {
            0 => Some(0),
            2 => Some(1),
            _ => None,
        };
        match request.command {
            command::ROR => self.order(mode::VELOCITY, value),
            command::ROL => self.order(mode::VELOCITY, value.saturating_neg()),
            command::MST => self.order(mode::STOP, 0),
            command::MVP if request.kind == 0 => self.order(mode::POSITION, value),
            command::MVP if request.kind == 1 => {
                let target = whole(self.ticks()).saturating_add(value);
                self.order(mode::POSITION, target);
            }
            command::MVP => return Err(Rejection::WrongType),
            command::GAP => return self.parameters.get(request.kind),
            command::SAP => self.set_parameter(request.kind, value)?,
            command::STAP => return self.parameters.store(request.kind, false),
            command::RSAP => return self.parameters.store(request.kind, true),
            command::SGP | command::GGP | command::STGP | command::RSGP => {
                let bank = bank.and_then(|n: usize| self.banks.get_mut(n));
                let bank = bank.ok_or(Rejection::WrongType)?;
                match request.command {
                    command::SGP => bank.write(request.kind, value, self.unlocked)?,
                    command::GGP => return bank.get(request.kind),
                    // Volatile parameters cannot be stored.
                    other if request.kind == 16 => {
                        let _ = other;
                        return Err(Rejection::InvalidValue);
                    }
                    other => return bank.store(request.kind, other == command::RSGP),
                }
            }
            _ => return Err(Rejection::InvalidCommand),
        }
        Ok(value)
    }

    fn set_parameter(&mut self, number: u8, value: i32) -> Result<(), Rejection> {
        self.parameters.write(number, value, self.unlocked)?;
        match number {
            0 => self.order(mode::POSITION, value),
            1 => self.set_ticks(value),
            2 => self.order(mode::VELOCITY, value),
            15 if value == 0 => (self.initialized, self.commuting) = (false, 0.0),
            29 => (self.i2t, self.heat) = (false, 0.0),
            31 if value == 1 => (self.initialized, self.commuting) = (false, 0.0),
            158 if value == 1 => (self.timeout, self.silent) = (false, 0.0),
            248 => self.unlocked = value != 0,
            _ => {}
        }
        Ok(())
    }
}
