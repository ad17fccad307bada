//! One axis of a drive: the objects of the profile, the state machine, the modes, the servo and the motor, put
//! together. It does not know which messages carry its objects.

mod report;

use std::time::Duration;

use crate::dictionary::{AbortCode, Address, Dictionary, DictionaryError, Key, Object};
use crate::{ControlWord, State};

use super::distortion::ProcessDataFaults;
use super::guards::{DC_LINK, FaultCode, Guards, WARM, Watched};
use super::homing::Method;
use super::modes::{Follow, ModeOutput, Modes, View, is_supported, shown, wrap};
use super::motor::{Motor, MotorConfig, Switches};
use super::objects::{Keys, objects};
use super::power::{Motion, Options, Power, PowerInput};
use super::quirks::Quirks;
use super::servo::{Demand, Limits, Servo};
use report::milli;

/// Longest computation step, s.
pub(super) const TICK: f64 = 250e-6;
/// Longest time that one [`Drive::step`] simulates.
const STEP_MAX: Duration = Duration::from_millis(100);
/// Below this speed the motor counts as stopped, rad/s.
const REST: f64 = 0.1;

/// Configuration of an emulated axis.
#[derive(Clone, Debug, Default)]
pub struct DriveConfig {
    /// The motor and what it moves.
    pub motor: MotorConfig,
    /// Deviations of the drive from the profile.
    pub quirks: Quirks,
    /// Position of the motor at power-on, rad.
    pub position: f64,
    /// 60C2h after a reset: value and decimal exponent of seconds; `None` for 1 ms, or that of SYNC where it is known.
    pub interpolation: Option<(u8, i8)>,
}

impl DriveConfig {
    /// The objects of such an axis (0 to 7), for the dictionary of the node.
    pub fn objects(&self, axis: u8) -> Vec<Object> {
        let mut objects = objects(axis);
        let quirks = &self.quirks;
        let (quick_stop, abort_connection, window) = quirks.defaults;
        if let Some((value, exponent)) = self.interpolation {
            let period = objects
                .iter_mut()
                .filter(|object| object.index % Address::AXIS == 0x60C2 % Address::AXIS)
                .flat_map(|object| &mut object.entries);
            for (sub, entry) in period {
                match sub {
                    1 => entry.default = vec![value],
                    2 => entry.default = exponent.to_le_bytes().to_vec(),
                    _ => {}
                }
            }
        }
        for (index, default) in [
            (0x605A, quick_stop.to_le_bytes().to_vec()),
            (0x6007, abort_connection.to_le_bytes().to_vec()),
            (0x6065, window.to_le_bytes().to_vec()),
            (0x6502, quirks.supported_modes.to_le_bytes().to_vec()),
            (
                0x6076,
                milli(self.motor.rated_torque).to_le_bytes().to_vec(),
            ),
        ] {
            let index = index + Address::AXIS * u16::from(axis.min(7));
            if let Some(object) = objects.iter_mut().find(|o| o.index == index) {
                object.entries[0].1.default = default;
            }
        }
        objects
    }
}

/// Inputs of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// Time since the last step; at most 100 ms of it are simulated.
    pub dt: Duration,
    /// New cyclic set-points were received (SYNC, SYNC0 or the PDO).
    pub set_point: bool,
    /// The master is lost; 6007h selects the reaction.
    pub link_lost: bool,
}

/// Outputs of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stepped {
    /// An emergency to send: a new fault, or [`FaultCode::NONE`] for a fault that was reset.
    pub emergency: Option<FaultCode>,
}

/// Bit 8 of 6040h.
const HALT: u16 = 0x0100;

/// An emulated axis.
#[derive(Clone, Debug)]
pub struct Drive {
    keys: Keys,
    axis: u8,
    motor: Motor,
    quirks: Quirks,
    power: Power,
    modes: Modes,
    servo: Servo,
    guards: Guards,
    /// User position is motor position times this, plus [`Self::origin`]; user units/rad.
    scale: f64,
    origin: f64,
    /// A fault that was detected or injected and not handled yet.
    new_fault: Option<FaultCode>,
    /// An injected cause that is still present.
    cause: Option<FaultCode>,
    link_was_lost: bool,
    probes: u16,
    /// DC link voltage, V.
    pub dc_link: f64,
    /// Digital inputs 16 to 31 of 60FDh.
    pub inputs: u16,
    /// A service tool controls the drive: bit 9 of 6041h is low, and 6040h is ignored.
    pub local: bool,
    /// Its interlock (a guard, safe torque off) keeps power off: bit 3 of 60FDh, no transition 3.
    pub interlock: bool,
    /// Another program holds bit 8 (halt) of 6040h high.
    pub halted: bool,
    /// The controlword that was last executed.
    applied_word: ControlWord,
    /// How many more enablings end in a fault.
    faults_on_enable: u32,
    /// How it distorts its process data; its node applies this.
    pub process_data: ProcessDataFaults,
}

impl Drive {
    /// An axis over the objects of [`DriveConfig::objects`] in a dictionary.
    ///
    /// # Errors
    /// If the dictionary lacks one of these objects.
    pub fn new(
        config: DriveConfig,
        axis: u8,
        dictionary: &Dictionary,
    ) -> Result<Self, DictionaryError> {
        let keys = Keys::new(dictionary, axis)?;
        Ok(Self {
            keys,
            axis,
            power: Power::new(config.motor.brake_release),
            motor: Motor::new(config.motor, config.position),
            faults_on_enable: config.quirks.faults_on_enable,
            quirks: config.quirks,
            modes: Modes::default(),
            servo: Servo::default(),
            guards: Guards::default(),
            scale: 1.0,
            origin: 0.0,
            new_fault: None,
            cause: None,
            link_was_lost: false,
            probes: 0,
            dc_link: 48.0,
            inputs: 0,
            local: false,
            interlock: false,
            halted: false,
            applied_word: ControlWord::DISABLE_VOLTAGE,
            process_data: ProcessDataFaults::default(),
        })
    }

    /// The state of its power drive system.
    pub const fn state(&self) -> State {
        self.power.state
    }

    /// The motor.
    pub const fn motor(&self) -> &Motor {
        &self.motor
    }

    /// The motor, to apply external torques.
    pub const fn motor_mut(&mut self) -> &mut Motor {
        &mut self.motor
    }

    /// Injects a fault whose cause stays until [`Self::clear_cause`].
    pub const fn fault(&mut self, code: FaultCode) {
        self.new_fault = Some(code);
        self.cause = Some(code);
    }

    /// Removes the injected cause; the fault still has to be reset.
    pub const fn clear_cause(&mut self) {
        self.cause = None;
    }

    /// The bus wrote a data record of interpolated position (60C1h:01), which is used if records are buffered (60C4h).
    /// Returns whether the buffer had a free slot.
    pub fn take_record(&mut self, dictionary: &Dictionary, record: i32) -> bool {
        self.modes.take_record(dictionary, &self.keys, record)
    }

    /// Checks a write from the bus beyond the checks of the dictionary.
    ///
    /// # Errors
    /// If the mode, homing method or option code is not supported.
    pub fn check_download(
        &self,
        dictionary: &Dictionary,
        address: Address,
        data: &[u8],
    ) -> Result<(), AbortCode> {
        let offset = Address::AXIS * u16::from(self.axis);
        let number = |data: &[u8]| data.first().map_or(0, |byte| byte.cast_signed());
        let allowed = match address.index.checked_sub(offset) {
            Some(0x6060) => is_supported(number(data), dictionary.get(self.keys.supported_modes)),
            // Sin² and jerk-free ramps are not supported.
            Some(0x6086) => matches!(data.first_chunk(), Some(&[0 | 3, 0])),
            Some(0x6098) => {
                let number = number(data);
                Method::new(number).is_some() || number == 0 && !self.quirks.no_homing_method_0
            }
            Some(0x605A) if !self.quirks.quick_stop_options.is_empty() => {
                let option = data.first_chunk().map(|bytes| i16::from_le_bytes(*bytes));
                option.is_some_and(|option| self.quirks.quick_stop_options.contains(&option))
            }
            _ => true,
        };
        if allowed {
            Ok(())
        } else {
            Err(AbortCode::Value)
        }
    }

    /// Lets it take the period of its set-points from SYNC until its master writes 60C2h, unless that has been set already.
    /// Until it is known, no set-point counts as missing.
    pub fn expect_sync_period(&mut self, dictionary: &Dictionary) {
        self.modes.expect_sync_period(dictionary, &self.keys);
    }

    /// Takes the period of SYNC, in the format of 60C2h (value, decimal exponent of seconds), as that of the set-points if
    /// its master did not write it.
    pub fn follow_sync(&mut self, d: &mut Dictionary, value: u8, exponent: i8) {
        if self.modes.takes_sync_period() {
            d.set(self.keys.interpolation_value, value);
            d.set(self.keys.interpolation_index, exponent);
        }
    }

    /// The bus wrote an object.
    pub fn after_download(&mut self, address: Address) {
        if Address::new(0x60C2, address.sub).on_axis(self.axis) == Some(address) {
            self.modes.keep_period();
        }
    }

    /// Checks a read from the bus.
    pub fn before_upload(&self, d: &mut Dictionary, address: Address) -> Result<(), AbortCode> {
        let enabled = self.power.state == State::OperationEnabled;
        self.process_data
            .before_upload(self.axis, enabled, d, address)
    }

    /// Advances time: reads what the master wrote, moves the motor, and writes the objects that the master reads.
    pub fn step(&mut self, dictionary: &mut Dictionary, step: &Step) -> Stepped {
        let mut left = step.dt.min(STEP_MAX).as_secs_f64().max(1e-9);
        if self.halted {
            let raw = dictionary.get(self.keys.control_word);
            dictionary.set(self.keys.control_word, raw | HALT);
        }
        let word = self.word(dictionary, step.link_lost);
        self.read_units(dictionary);
        // One transition per step, so that a check once per step sees each state.
        let (motion, emergency) = self.step_power(dictionary, word, left);
        let mut set_point = step.set_point;
        while left > 0.0 {
            let dt = left.min(TICK);
            self.tick(dictionary, word, motion, set_point, dt);
            set_point = false;
            left -= TICK;
        }
        Stepped { emergency }
    }

    fn tick(
        &mut self,
        d: &mut Dictionary,
        word: ControlWord,
        motion: Motion,
        set_point: bool,
        dt: f64,
    ) {
        let halt = word.halt();
        let waits = self.quirks.mode_after_enable && !matches!(motion, Motion::Follow);
        if !waits {
            self.modes.switch(d, &self.keys, halt, &self.quirks, dt);
        }
        let output = self.move_motor(d, word, motion, set_point, dt);
        self.guard(d, &output, motion, dt);
        self.report(d, &output, motion);
    }

    /// The factor group: user units per rad of the motor.
    fn read_units(&mut self, d: &Dictionary) {
        let k = &self.keys;
        let ratio = |a: Key<u32>, b: Key<u32>| f64::from(d.get(a)) / f64::from(d.get(b).max(1));
        let gear = ratio(k.gear_motor, k.gear_shaft).max(1e-9);
        let turn = ratio(k.feed, k.feed_revolutions) / gear;
        let sign = if d.get(k.polarity) & 0x80 != 0 {
            -1.0
        } else {
            1.0
        };
        let scale = sign * turn / std::f64::consts::TAU;
        if scale.total_cmp(&self.scale).is_ne() && scale.is_finite() && scale != 0.0 {
            // The same position in other units.
            self.origin *= scale / self.scale;
            self.modes.shift(self.position_at(scale) - self.position());
            self.scale = scale;
        }
    }

    fn position_at(&self, scale: f64) -> f64 {
        self.motor.position * scale + self.origin
    }

    /// Actual position, user units.
    fn position(&self) -> f64 {
        self.position_at(self.scale)
    }

    /// The controlword, or what 6007h makes of it while the master is lost.
    fn word(&mut self, d: &Dictionary, link_lost: bool) -> ControlWord {
        if !self.local {
            self.applied_word = ControlWord::new(d.get(self.keys.control_word));
        }
        let word = self.applied_word;
        let newly = link_lost && !std::mem::replace(&mut self.link_was_lost, link_lost);
        if !link_lost {
            return word;
        }
        match d.get(self.keys.abort_connection) {
            1 if newly => {
                self.new_fault = self.new_fault.or(Some(FaultCode::HEARTBEAT));
                word
            }
            2 => ControlWord::DISABLE_VOLTAGE,
            3 => ControlWord::QUICK_STOP,
            _ => word,
        }
    }

    /// The state machine; returns the commanded motion, and an emergency.
    fn step_power(
        &mut self,
        d: &mut Dictionary,
        word: ControlWord,
        dt: f64,
    ) -> (Motion, Option<FaultCode>) {
        let k = &self.keys;
        let options = Options {
            quick_stop: d.get(k.quick_stop_option),
            shutdown: d.get(k.shutdown_option),
            disable: d.get(k.disable_option),
            fault: d.get(k.fault_option),
        };
        let (low, high) = DC_LINK;
        let input = PowerInput {
            at_rest: self.is_at_rest(),
            fault: self.new_fault.is_some(),
            cause: self.cause.is_some() || self.dc_link > high || self.motor.heat > 1.0,
            voltage: (low..=high).contains(&self.dc_link) && !self.interlock,
            dt,
        };
        let before = self.power.state;
        let motion = self.power.step(word, &input, &options, &self.quirks);
        let after = self.power.state;
        let enabled = before != after && after == State::OperationEnabled;
        if enabled && self.faults_on_enable > 0 {
            // Counted down unless unlimited. The statusword shows Operation enabled once.
            if self.faults_on_enable < u32::MAX {
                self.faults_on_enable -= 1;
            }
            self.new_fault = self.new_fault.or(Some(FaultCode::POWER_STAGE));
        }
        let code = if after == State::FaultReactionActive && before != after {
            self.new_fault.take().unwrap_or(FaultCode(0x1000))
        } else if before == State::Fault && after != before {
            FaultCode::NONE
        } else {
            return (motion, None);
        };
        d.set(k.error_code, code.0);
        (motion, Some(code))
    }

    fn is_at_rest(&self) -> bool {
        self.motor.velocity.abs() < REST
    }

    fn move_motor(
        &mut self,
        d: &mut Dictionary,
        word: ControlWord,
        motion: Motion,
        set_point: bool,
        dt: f64,
    ) -> ModeOutput {
        let limits = self.limits(d);
        let ramp = self.modes.ramp.velocity.abs();
        let index = self.probe(d, dt);
        let view = View {
            word,
            motion,
            set_point,
            position: self.position(),
            velocity: self.motor.velocity * self.scale,
            switches: self.switches(),
            index,
            at_rest: self.is_at_rest() && ramp < REST * self.scale.abs(),
            velocity_max: limits.speed * self.scale.abs(),
            turn: self.scale * std::f64::consts::TAU,
            dt,
        };
        let output = self.modes.step(d, &self.keys, &self.quirks, &view);
        let demand = self.demand(d, &output);
        let torque = self.servo.torque(demand, &self.motor, &limits, dt);
        self.motor.braked = matches!(motion, Motion::Off | Motion::Opening);
        self.motor.step(torque, dt);
        if let Some(home) = output.home {
            let offset = f64::from(d.get(self.keys.home_offset));
            let sign = if self.quirks.home_offset_positive {
                1.0
            } else {
                -1.0
            };
            let shift = sign * offset - home;
            self.origin += shift;
            self.modes.shift(shift);
        }
        output
    }

    /// Torque limits 6072h, 60E0h and 60E1h, and the speed that motor and profile allow.
    fn limits(&self, d: &Dictionary) -> Limits {
        let k = &self.keys;
        let most = d.get(k.max_torque);
        let rated = self.motor.config().rated_torque / 1000.0;
        let torque = |key: Key<u16>| f64::from(d.get(key).min(most)) * rated;
        let motor = f64::from(d.get(k.max_motor_speed)) * std::f64::consts::TAU / 60.0;
        let profile = f64::from(d.get(k.max_profile_velocity)) / self.scale.abs();
        Limits {
            positive: torque(k.positive_torque_limit),
            negative: torque(k.negative_torque_limit),
            speed: motor.min(profile),
        }
    }

    /// The demand for the servo, in motor units.
    fn demand(&self, d: &Dictionary, output: &ModeOutput) -> Demand {
        let rated = self.motor.config().rated_torque / 1000.0;
        let ramp = self.modes.ramp;
        let velocity = ramp.velocity / self.scale;
        let offset = f64::from(d.get(self.keys.torque_offset)) * rated;
        match output.follow {
            Follow::Nothing => Demand::Off,
            Follow::Position => {
                let position = (ramp.position - self.origin) / self.scale;
                Demand::Position(position, velocity, offset)
            }
            Follow::Velocity => Demand::Velocity(velocity, offset),
            Follow::Torque => Demand::Torque(self.modes.torque * rated),
        }
    }

    /// The switches in user direction.
    fn switches(&self) -> Switches {
        let switches = self.motor.switches();
        if self.scale > 0.0 {
            return switches;
        }
        Switches {
            negative: switches.positive,
            positive: switches.negative,
            home: switches.home,
        }
    }

    /// Touch probes 60B8h to 60BDh: probe 1 is the home switch, probe 2 the negative limit; each may take the index
    /// pulse instead. Returns the position of an index pulse met in the last tick.
    fn probe(&mut self, d: &mut Dictionary, dt: f64) -> Option<f64> {
        let k = self.keys;
        let to = self.motor.position;
        let from = to - self.motor.velocity * dt;
        let index = self.motor.index_between(from, to);
        let index = index.map(|at| at * self.scale + self.origin);
        let switches = self.switches();
        let now = u16::from(switches.home) | u16::from(switches.negative) << 1;
        let (rose, fell) = (now & !self.probes, self.probes & !now);
        self.probes = now;
        let function = d.get(k.probe_function);
        let mut status = d.get(k.probe_status);
        let here = self.position();
        for (number, positive, negative) in [
            (0, k.probe_1_positive, k.probe_1_negative),
            (1, k.probe_2_positive, k.probe_2_negative),
        ] {
            let bit = |n: u16| function >> (8 * number + n) & 1 == 1;
            let shown = |n: u16| 1_u16 << (8 * number + n);
            if !bit(0) {
                status &= !(shown(0) | shown(1) | shown(2));
                continue;
            }
            status |= shown(0);
            let (up, down) = if bit(2) {
                (index, None)
            } else {
                let edge = |edges: u16| (edges >> number & 1 == 1).then_some(here);
                (edge(rose), edge(fell))
            };
            for (at, wanted, stored, key) in [
                (up, bit(4), shown(1), positive),
                (down, bit(5), shown(2), negative),
            ] {
                if let Some(at) = at.filter(|_| wanted && (bit(1) || status & stored == 0)) {
                    d.set(key, wrap(at));
                    status |= stored;
                }
            }
        }
        d.set(k.probe_status, status);
        index
    }

    fn guard(&mut self, d: &Dictionary, output: &ModeOutput, motion: Motion, dt: f64) {
        let k = &self.keys;
        let position = output.follow == Follow::Position;
        let watched = Watched {
            following_error: position.then(|| self.modes.ramp.position - self.position()),
            window: d.get(k.following_window),
            timeout: f64::from(d.get(k.following_timeout)) / 1000.0,
            heat: self.motor.heat,
            dc_link: self.dc_link,
            powered: !matches!(motion, Motion::Off | Motion::Opening),
            dt,
        };
        let found = self.guards.step(&watched);
        let found = found.or_else(|| output.missing.then_some(FaultCode::SYNC));
        let answered = matches!(
            self.power.state,
            State::FaultReactionActive | State::Fault | State::NotReadyToSwitchOn
        );
        if let Some(code) = found.filter(|_| !answered) {
            self.new_fault = self.new_fault.or(Some(code));
        } else if answered {
            self.new_fault = None;
        }
    }
}
