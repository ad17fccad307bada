//! A servo axis of terminals: the position loop over an analogue output and an encoder, its enabling and its brake, and its
//! homing. For the arm whose joint it moves it is a drive as any other. The steps of homing are in `takt_device_drives`.

mod power;
mod signals;

use std::fmt;
use std::time::Duration;

use takt_ethercat::axis::NotMapped;
use takt_ethercat::encoder::{Encoder, EncoderReading};
use takt_ethercat::master::Master;
use takt_rt::cycle::Tick;

use super::describe::{AXIS_PARTS, slave};
use super::io::{Bit, Lack, Number};
use super::wire::{WireValues, wire_figures};
use crate::config::{AnalogueChannel, EthercatConfig, EthercatHoming, EthercatServo};
use power::Power;
use takt_core::device::driver::DeviceEnd;
use takt_core::device::endpoint::Endpoint;
use takt_core::device::parts::with_figures;
use takt_device_drives::{
    DriveJoint, Feedback, Homing, HomingError, HomingInput, HomingMotion, HomingStep, Order,
};

/// V of one increment of a terminal of ±10 V.
const VOLT_SCALE: f64 = 10.0 / 32_767.0;
/// Largest voltage of the output.
const VOLTS_MAX: f64 = 10.0;
/// Time in which a constant error is compensated by a voltage of its own, s.
const INTEGRAL_S: f64 = 0.5;

/// Why a servo axis has no power.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ServoFault {
    /// The amplifier is not ready although it is enabled.
    NotReady,
    /// The encoder has a broken wire.
    OpenCircuit,
    /// It did not follow in homing or at rest before its zero is known; later its joint watches it. Only a new homing, or a loss
    /// of its terminal, gives it power again.
    NotFollowing,
}

/// An event of a servo axis, reported once per occurrence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ServoEvent {
    /// It cannot be controlled.
    Encoder(NotMapped),
    Output(Lack),
    /// Homing is configured, and the encoder has no latch.
    NoLatch,
    Fault(ServoFault),
    /// It needs a larger offset voltage than is allowed.
    Offset,
    Homed,
    NotHomed(HomingError),
}

impl fmt::Display for ServoEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Encoder(lack) => write!(f, "its encoder has no counter: {lack}"),
            Self::Output(lack) => write!(f, "its output cannot be written: {lack}"),
            Self::NoLatch => f.write_str(
                "it cannot be homed: the PDOs of its encoder have no latch\nhint: assign the PDOs with latch C (6000h:01, \
                 6000h:12, 7000h:01)",
            ),
            Self::Fault(ServoFault::NotReady) => f.write_str(
                "its amplifier is not ready although it is enabled; its brake is closed\nhint: check power, enabling wire and \
                 faults of the amplifier",
            ),
            Self::Fault(ServoFault::OpenCircuit) => f.write_str(
                "a wire of its encoder is broken; its brake is closed\nhint: check the plug of the encoder",
            ),
            Self::Fault(ServoFault::NotFollowing) => f.write_str(
                "it does not follow; its brake is closed until it is homed again\nhint: check brake, motor and encoder, and the \
                 sign of `velocity_10v`",
            ),
            Self::Offset => f.write_str(
                "it needs a larger offset voltage than `offset_max`\nhint: adjust the offset of the amplifier, or raise `offset_max`",
            ),
            Self::Homed => f.write_str("homed: its zero is known"),
            Self::NotHomed(error) => write!(f, "homing failed: {error}"),
        }
    }
}

/// Signals of its terminals in this cycle.
#[derive(Clone, Copy, Debug, Default)]
struct Sensed {
    encoder: EncoderReading,
    /// `true` without such a signal.
    ready: bool,
    proximity: bool,
    online: bool,
}

/// A servo axis.
#[derive(Debug)]
pub(super) struct ServoAxis {
    config: EthercatServo,
    motion: Option<HomingMotion>,
    encoder_slave: usize,
    encoder: Option<Encoder>,
    output: Number,
    enable: Option<Bit>,
    brake: Option<Bit>,
    ready: Option<Bit>,
    proximity: Option<Bit>,
    /// Whether its terminals were looked at since the segment runs.
    is_found: bool,
    power: Power,
    /// Whether its arm wants it to follow.
    is_wanted_on: bool,
    sensed: Sensed,
    cycle_s: f64,
    /// From counts of the encoder to increments of the axis.
    shift: i64,
    is_homed: bool,
    homing: Option<Homing>,
    /// Whether a net wants homing, and whether its thread is alive.
    wanted: bool,
    is_fresh: bool,
    /// Whether a wire of its encoder was broken in the last cycle.
    was_open: bool,
    failure: Option<HomingError>,
    /// Number of the step of the last homing.
    step: u8,
    /// Target of the position loop and of the cycle before, increments.
    target: Option<f64>,
    /// When it changed last.
    moved: Duration,
    /// Voltage that compensates the offset, V, and whether it is at its bound.
    offset: f64,
    is_saturated: bool,
    events: [Option<ServoEvent>; 4],
    end: Endpoint,
}

/// Homing in increments.
fn motion(homing: &EthercatHoming, joint: &DriveJoint<String>) -> HomingMotion {
    let per_degree = joint.increments_per_turn / 360.0;
    let [low, high] = joint.range;
    let at = |angle: f64| angle * per_degree + joint.zero;
    HomingMotion {
        velocity: homing.velocity * per_degree,
        index_speed: (homing.index_velocity * per_degree).abs(),
        acceleration: (joint.acceleration_max * per_degree).abs(),
        travel_max: (homing.travel_max.unwrap_or(high - low) * per_degree).abs(),
        index_every: homing.index_every,
        following_max: (joint.following_error() * per_degree).abs(),
        index_position: at(homing.index_position),
        start: homing.start.map(at),
        timeout: homing.timeout,
    }
}

impl ServoAxis {
    pub(super) fn new(config: &EthercatConfig, servo: &EthercatServo, end: DeviceEnd) -> Self {
        let mut joints = config.arms.iter().flat_map(|arm| &arm.joints);
        let joint = joints.find(|joint| joint.drive == servo.name);
        let homing = servo.homing.as_ref().zip(joint);
        let bit = |of: &Option<(String, usize)>| {
            let (name, bit) = of.as_ref()?;
            let slave = slave(config, name)?;
            Some(Bit { slave, bit: *bit })
        };
        let is_plain = servo.output.scale.to_bits() == 1.0_f64.to_bits();
        let output = AnalogueChannel {
            scale: if is_plain {
                VOLT_SCALE
            } else {
                servo.output.scale
            },
            ..servo.output.clone()
        };
        Self {
            motion: homing.map(|(homing, joint)| motion(homing, joint)),
            encoder_slave: slave(config, &servo.encoder).unwrap_or_default(),
            encoder: None,
            output: Number::new(config, &output),
            enable: bit(&servo.enable),
            brake: bit(&servo.brake),
            ready: bit(&servo.ready),
            proximity: bit(&servo.proximity),
            is_found: false,
            power: Power::Off,
            is_wanted_on: false,
            sensed: Sensed::default(),
            cycle_s: config.cycle.as_secs_f64(),
            shift: 0,
            is_homed: servo.homing.is_none(),
            homing: None,
            wanted: false,
            is_fresh: false,
            was_open: false,
            failure: None,
            step: 0,
            target: None,
            moved: Duration::ZERO,
            offset: 0.0,
            is_saturated: false,
            events: [None; 4],
            end: Endpoint::new(end, &with_figures(&AXIS_PARTS, wire_figures()), 0),
            config: servo.clone(),
        }
    }

    /// Reports the figures of the wire with the next cycle.
    pub(super) fn report_wire(&mut self, values: &WireValues) {
        self.end.report_figures(0, values.iter().copied());
    }

    /// The next event.
    pub(super) fn poll_event(&mut self) -> Option<ServoEvent> {
        self.events.iter_mut().find_map(Option::take)
    }

    /// Events beyond those that fit in a cycle are dropped; each is a state that signals show too.
    fn note(&mut self, event: ServoEvent) {
        if let Some(free) = self.events.iter_mut().find(|it| it.is_none()) {
            *free = Some(event);
        }
    }

    /// Locates its values once the process data are known.
    fn find(&mut self, master: &Master) {
        if !master.is_exchanging() {
            (self.is_found, self.encoder) = (false, None);
            self.lose();
            return;
        }
        if std::mem::replace(&mut self.is_found, true) {
            return;
        }
        if let Some(lack) = self.output.find(master, true) {
            self.note(ServoEvent::Output(lack));
            return;
        }
        let Some(view) = master.slave(self.encoder_slave) else {
            return;
        };
        match Encoder::new(self.encoder_slave, view.process(), self.config.channel) {
            Ok(encoder) if self.motion.is_some() && !encoder.has_latch() => {
                self.note(ServoEvent::NoLatch);
            }
            Ok(encoder) => self.encoder = Some(encoder),
            Err(lack) => self.note(ServoEvent::Encoder(lack)),
        }
    }

    /// One cycle, with the order of its joint.
    pub(super) fn cycle(
        &mut self,
        master: &mut Master,
        order: Order,
        now: Duration,
    ) -> Option<Feedback> {
        self.find(master);
        let arm = matches!(self.homing.map(|it| it.step()), Some(HomingStep::Index));
        let encoder = self.encoder.as_mut()?.cycle(master, arm);
        self.sense(master, encoder);
        self.step_power(order, now);
        let homing = self.step_homing(now);
        let target = homing.or_else(|| order.target.map(f64::from).filter(|_| self.is_homed));
        let volts = self.volts(target, now);
        self.watch();
        let (is_enabled, is_released) = (self.power.is_enabled(), self.power.is_released());
        if let Some(bit) = self.enable {
            bit.write(master, is_enabled);
        }
        if let Some(bit) = self.brake {
            bit.write(master, is_released);
        }
        self.output
            .write(master.outputs_mut(self.output.slave), volts);
        Some(Feedback {
            online: self.sensed.online,
            follows: self.power == Power::On && self.sensed.online,
            state: Some(self.power.state()),
            status: None,
            increments: self.increments(),
            refused: false,
            is_homing: !self.is_homed || homing.is_some(),
            torque: None,
        })
    }

    /// Its terminals are away: it returns without power, and does not go on by itself. Its counter may have lost its power too.
    fn lose(&mut self) {
        (self.power, self.is_wanted_on, self.target) = (Power::Off, false, None);
        self.is_homed &= self.motion.is_none();
        if let Some(homing) = self.homing.take()
            && !homing.has_ended()
        {
            self.fail_homing(HomingError::PowerLost);
        }
    }

    fn fail_homing(&mut self, error: HomingError) {
        (self.failure, self.step) = (Some(error), HomingStep::Failed(error).number());
        self.note(ServoEvent::NotHomed(error));
    }

    fn sense(&mut self, master: &Master, encoder: EncoderReading) {
        let read = |bit: Option<Bit>, without| bit.map_or(Some(without), |bit| bit.read(master));
        let (ready, proximity) = (read(self.ready, true), read(self.proximity, false));
        // A slave with outputs only has no inputs that age.
        let online = encoder.online && ready.is_some() && proximity.is_some();
        self.sensed = Sensed {
            encoder,
            ready: ready.unwrap_or_default(),
            proximity: proximity.unwrap_or_default(),
            online,
        };
    }

    fn position(&self) -> i64 {
        self.sensed.encoder.count.saturating_add(self.shift)
    }

    fn increments(&self) -> i32 {
        let position = self.position();
        let nearest = if position < 0 { i32::MIN } else { i32::MAX };
        i32::try_from(position).unwrap_or(nearest)
    }

    /// Begins, continues and ends homing; its target while it is under way.
    fn step_homing(&mut self, now: Duration) -> Option<f64> {
        let motion = self.motion?;
        let leave = self.home_is_wanted();
        let input = HomingInput {
            position: float(self.position()),
            proximity: self.sensed.proximity,
            may_leave: leave == Some(true),
            latched: self
                .sensed
                .encoder
                .latched
                .map(|at| float(at.saturating_add(self.shift))),
            dt_s: self.cycle_s,
            now,
        };
        self.follow_request(leave.is_some(), motion, &input);
        let mut homing = self.homing.take()?;
        if !self.wanted {
            homing.cancel();
        } else if self.is_withheld() {
            // It brakes, and does not begin again by itself.
            homing.fail(HomingError::PowerLost);
        }
        if self.power != Power::On {
            homing.fail(HomingError::PowerLost);
        }
        let target = homing.advance(&input).target;
        self.step = homing.step().number();
        match homing.step() {
            HomingStep::Done => {
                self.is_homed = true;
                let by = homing.shift().unwrap_or_default().round();
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "whole counts; the cast saturates"
                )]
                let counts = by as i64;
                self.shift = self.shift.saturating_add(counts);
                self.target = None;
                self.note(ServoEvent::Homed);
                return Some(target + by);
            }
            HomingStep::Failed(error) if self.failure.is_none() => {
                self.fail_homing(error);
                if matches!(error, HomingError::WrongDirection | HomingError::NotMoving) {
                    self.fail(ServoFault::NotFollowing);
                }
            }
            HomingStep::Leave
            | HomingStep::Seek
            | HomingStep::Touched
            | HomingStep::Off
            | HomingStep::Index
            | HomingStep::Start
            | HomingStep::Failed(_)
            | HomingStep::Cancelled => {}
        }
        // After a failure it brakes first.
        let is_over = matches!(homing.step(), HomingStep::Failed(_) | HomingStep::Cancelled);
        if !(is_over && homing.is_at_rest()) && self.power == Power::On {
            self.homing = Some(homing);
        }
        Some(target)
    }

    /// Begins homing as a net requests it, if it can.
    fn follow_request(&mut self, wanted: bool, motion: HomingMotion, input: &HomingInput) {
        let was_wanted = std::mem::replace(&mut self.wanted, wanted);
        if self.wanted && !was_wanted {
            (self.failure, self.is_homed, self.step) = (None, false, 0);
            if self.power == Power::Fault(ServoFault::NotFollowing) {
                self.power = Power::Off;
            }
        }
        let has_no_power = matches!(self.power, Power::Fault(_)) || !self.sensed.online;
        if self.wanted && !self.is_homed && self.failure.is_none() && has_no_power {
            self.homing = None;
            self.fail_homing(HomingError::PowerLost);
        }
        let may_begin = self.wanted && !self.is_homed && self.failure.is_none();
        if self.homing.is_none() && may_begin && self.power == Power::On {
            self.homing = Some(Homing::new(motion, input));
        }
    }

    /// The position loop: feed-forward of the target's velocity, its error, and a constant voltage.
    fn volts(&mut self, target: Option<f64>, now: Duration) -> f64 {
        if !self.power.is_controlled() {
            (self.target, self.is_saturated) = (None, false);
            return 0.0;
        }
        let position = float(self.position());
        let before = self.target.unwrap_or(position);
        let target = target.unwrap_or(before);
        if target.to_bits() != before.to_bits() {
            self.moved = now;
        }
        self.target = Some(target);
        let per_volt = self.config.velocity_10v / VOLTS_MAX;
        let forward = (target - before) / self.cycle_s / per_volt;
        let error = self.config.gain * (target - position) / per_volt;
        let most = self.config.offset_max;
        let wanted = self.offset + error * self.cycle_s / INTEGRAL_S;
        self.offset = wanted.clamp(-most, most);
        let is_saturated = most > 0.0 && wanted.abs() > most && forward.abs() < most;
        if is_saturated && !std::mem::replace(&mut self.is_saturated, true) {
            self.note(ServoEvent::Offset);
        }
        (forward + error + self.offset).clamp(-VOLTS_MAX, VOLTS_MAX)
    }

    /// Removes its power if it does not follow while its joint does not watch it.
    fn watch(&mut self) {
        let lag = self
            .target
            .map_or(0.0, |target| target - float(self.position()));
        let most = self
            .motion
            .map_or(f64::INFINITY, |motion| motion.following_max);
        // Homing itself says why it does not follow.
        if !self.is_homed && self.homing.is_none() && lag.abs() > most {
            self.fail(ServoFault::NotFollowing);
        }
    }

    /// Takes what nets command, before the arms are stepped.
    pub(super) fn take(&mut self, tick: &Tick) {
        self.end.take();
        let cycle = Duration::from_secs_f64(self.cycle_s).into();
        self.is_fresh = self.end.is_fresh(tick.scheduled, cycle);
    }

    /// Shows nets its state, after the arms are stepped.
    pub(super) fn publish(&mut self, tick: &Tick) {
        self.report(tick);
        self.end.publish();
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts below 2^53")]
const fn float(count: i64) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests;
