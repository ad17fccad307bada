//! A gripper at the other end of the wire, as unkind as a real one: it needs homing, answers motions twice, blocks at
//! parts and end stops, loses parts, and stops fast when its client disappears. No sockets but in [`Port`]; time is an
//! argument.

mod port;

use std::time::Duration;

use crate::session::{FAST_STOP, FAULTS};
use crate::wire::{Command, DecodeError, PACKET_MAX, Packet, PacketReader, Status, float};

pub use port::Port;

/// Longest step of the simulation, s.
const STEP_S: f64 = 1e-3;
/// Longest time simulated in one call; a host that stalls longer loses the rest.
const CATCH_UP_MAX: Duration = Duration::from_secs(5);
/// Speed of homing, mm/s.
const HOMING_SPEED: f64 = 50.0;
/// A part this much narrower than expected is none, mm.
const CLAMPING_TRAVEL: f64 = 5.0;
/// Fingers this near have arrived, mm.
const ARRIVED: f64 = 0.01;

/// States of grasping.
mod grasping {
    pub(super) const IDLE: u8 = 0;
    pub(super) const GRASPING: u8 = 1;
    pub(super) const NO_PART: u8 = 2;
    pub(super) const PART_LOST: u8 = 3;
    pub(super) const HOLDING: u8 = 4;
    pub(super) const RELEASING: u8 = 5;
    pub(super) const POSITIONING: u8 = 6;
}

/// Properties of a gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperConfig {
    /// Largest width, mm.
    pub stroke: f64,
    /// Range of speeds, mm/s.
    pub speed: [f64; 2],
    /// Range of accelerations, mm/s².
    pub acceleration: [f64; 2],
    /// Range of forces, N.
    pub force: [f64; 2],
    /// Width at power-on, mm.
    pub width: f64,
}

impl Default for GripperConfig {
    /// A WSG 50-110.
    fn default() -> Self {
        Self {
            stroke: 110.0,
            speed: [5.0, 420.0],
            acceleration: [100.0, 5000.0],
            force: [5.0, 80.0],
            width: 60.0,
        }
    }
}

/// What fingers meet, such as those of a hand in a world that several emulators share.
pub trait Surroundings: Send + std::fmt::Debug {
    /// The width of the part between the fingers, mm; `None` if there is none. Called at least once per step of the fingers
    /// with their distance, mm, and the force with which they hold, N, 0 while they do not.
    fn part(&mut self, at: Duration, width_mm: f64, force_n: f64) -> Option<f64>;
}

/// Knobs of an emulated gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Knobs {
    /// Width of the part between the fingers, mm; `None` for no part. Surroundings replace it.
    pub part: Option<f64>,
    /// A part of the width that a grasp expects is always between the fingers.
    pub always_finds: bool,
    /// It answers nothing.
    pub silent: bool,
    /// Checksums of its answers are wrong.
    pub bad_checksum: bool,
    /// Fault flags of its system state, such as 4000h for temperature.
    pub faults: u32,
    /// A lost connection does not stop it.
    pub ignores_disconnect: bool,
}

#[derive(Clone, Copy, Debug)]
struct Motion {
    command: Command,
    target: f64,
    speed: f64,
    /// A part is expected at this width.
    expects: Option<f64>,
    /// It ends where the fingers are blocked.
    stops_on_block: bool,
}

/// An emulated gripper.
#[derive(Debug)]
pub struct Gripper {
    config: GripperConfig,
    /// Its knobs.
    pub knobs: Knobs,
    surroundings: Option<Box<dyn Surroundings>>,
    reader: PacketReader,
    now: Duration,
    width: f64,
    velocity: f64,
    acceleration: f64,
    force_limit: f64,
    soft_limits: Option<[f64; 2]>,
    is_homed: bool,
    is_stopped: bool,
    grasping: u8,
    motion: Option<Motion>,
    /// Values that it pushes: period and next time.
    pushes: Vec<(Command, Duration, Duration)>,
    out: Vec<u8>,
}

impl Gripper {
    /// A gripper that was switched on at `now`.
    #[must_use]
    pub fn new(config: GripperConfig, now: Duration) -> Self {
        Self {
            config,
            knobs: Knobs::default(),
            surroundings: None,
            reader: PacketReader::default(),
            now,
            width: config.width,
            velocity: 0.0,
            acceleration: 2000.0,
            force_limit: config.force[1] / 2.0,
            soft_limits: None,
            is_homed: false,
            is_stopped: false,
            grasping: grasping::IDLE,
            motion: None,
            pushes: Vec::new(),
            out: Vec::new(),
        }
    }

    /// Puts something between the fingers: the parts of a world.
    pub fn set_surroundings(&mut self, surroundings: Box<dyn Surroundings>) {
        self.surroundings = Some(surroundings);
    }

    /// Distance between its fingers, mm.
    #[must_use]
    pub const fn width(&self) -> f64 {
        self.width
    }

    /// Whether its fingers rest.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.velocity.abs() < f64::EPSILON
    }

    /// Whether a fast stop is active.
    #[must_use]
    pub const fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// The state of grasping.
    #[must_use]
    pub const fn grasping(&self) -> u8 {
        self.grasping
    }

    /// The bytes that it sends; they are removed.
    pub fn transmit(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.out)
    }

    /// Its connection ended without a goodbye, or never was.
    pub fn handle_disconnect(&mut self) {
        self.reader = PacketReader::default();
        self.pushes.clear();
        if !self.knobs.ignores_disconnect {
            self.stop_fast();
        }
        self.out.clear();
    }

    /// Handles received bytes; true if the client says goodbye.
    pub fn handle_bytes(&mut self, bytes: &[u8], now: Duration) -> bool {
        self.step(now);
        let mut said_goodbye = false;
        for byte in bytes {
            match self.reader.push(*byte) {
                Some(Ok(packet)) => {
                    said_goodbye |= packet.command == Command::Disconnect;
                    self.handle_packet(&packet);
                }
                Some(Err(DecodeError::Checksum(command))) => {
                    self.answer(Command::of(command), Status::CHECKSUM);
                }
                Some(Err(DecodeError::TooLong(_))) | None => {}
            }
        }
        said_goodbye
    }

    fn handle_packet(&mut self, packet: &Packet) {
        let command = packet.command;
        match self.execute(packet) {
            Ok(Some(status)) => self.answer(command, status),
            Ok(None) => {}
            Err(status) => self.answer(command, status),
        }
    }

    /// Executes a command; the status of its answer, or `None` if it was answered.
    fn execute(&mut self, packet: &Packet) -> Result<Option<Status>, Status> {
        let command = packet.command;
        let payload = packet.payload();
        match command {
            Command::Disconnect => self.pushes.clear(),
            Command::Stop => self.stop(),
            Command::FastStop => self.stop_fast(),
            Command::Acknowledge if payload == b"ack" => self.is_stopped = false,
            Command::Acknowledge => return Err(Status::CMD_FORMAT),
            Command::Homing | Command::Preposition | Command::Grasp | Command::Release => {
                return self.begin(command, payload).map(Some);
            }
            Command::SetAcceleration => {
                let [least, most] = self.config.acceleration;
                self.acceleration = one(payload)?.clamp(least, most);
            }
            Command::SetForceLimit => {
                let [least, most] = self.config.force;
                self.force_limit = one(payload)?.clamp(least, most);
            }
            Command::SetSoftLimits => {
                let (inner, outer) = two(payload)?;
                if !(0.0..outer).contains(&inner) || outer > self.config.stroke {
                    return Err(Status::RANGE);
                }
                self.soft_limits = Some([inner, outer]);
            }
            Command::GetSoftLimits => {
                let [inner, outer] = self.soft_limits.unwrap_or([0.0; 2]);
                let answer = Packet::new(command).with_status(Status::SUCCESS);
                self.send(&answer.with_float(single(inner)).with_float(single(outer)));
                return Ok(None);
            }
            Command::ClearSoftLimits => self.soft_limits = None,
            Command::SystemState
            | Command::GraspingState
            | Command::Width
            | Command::Speed
            | Command::Force => {
                self.subscribe(command, payload)?;
                self.push(command);
                return Ok(None);
            }
            Command::Other(_) => return Err(Status::CMD_UNKNOWN),
        }
        Ok(Some(Status::SUCCESS))
    }

    fn subscribe(&mut self, command: Command, payload: &[u8]) -> Result<(), Status> {
        let Some(([flags, low, high], _)) = payload.split_first_chunk() else {
            return if payload.is_empty() {
                Ok(())
            } else {
                Err(Status::NOT_ENOUGH_PARAMS)
            };
        };
        self.pushes.retain(|(pushed, ..)| *pushed != command);
        if flags & 1 != 0 {
            let millis = u16::from_le_bytes([*low, *high]).max(10);
            let period = Duration::from_millis(millis.into());
            self.pushes.push((command, period, self.now + period));
        }
        Ok(())
    }

    fn begin(&mut self, command: Command, payload: &[u8]) -> Result<Status, Status> {
        if self.is_stopped || self.knobs.faults & FAULTS != 0 {
            return Err(Status::ACCESS_DENIED);
        }
        if self.motion.is_some() {
            return Err(Status::ALREADY_RUNNING);
        }
        if !self.is_homed && command != Command::Homing {
            return Err(Status::NOT_INITIALIZED);
        }
        let motion = self.motion_of(command, payload)?;
        let [inner, outer] = self.soft_limits.unwrap_or([0.0, self.config.stroke]);
        let is_homing = command == Command::Homing;
        if !is_homing && !(inner..=outer).contains(&motion.target) {
            return Err(Status::RANGE);
        }
        let [slowest, fastest] = self.config.speed;
        if !(slowest..=fastest).contains(&motion.speed) {
            return Err(Status::RANGE);
        }
        let states = [
            (Command::Grasp, grasping::GRASPING),
            (Command::Release, grasping::RELEASING),
            (Command::Preposition, grasping::POSITIONING),
        ];
        let state = states.iter().find(|(of, _)| *of == command);
        self.grasping = state.map_or(self.grasping, |(_, state)| *state);
        self.motion = Some(motion);
        Ok(Status::PENDING)
    }

    fn motion_of(&self, command: Command, payload: &[u8]) -> Result<Motion, Status> {
        let motion = |target, speed| Motion {
            command,
            target,
            speed,
            expects: None,
            stops_on_block: true,
        };
        if command == Command::Homing {
            let direction = *payload.first().ok_or(Status::NOT_ENOUGH_PARAMS)?;
            let target = if direction == 2 {
                0.0
            } else {
                self.config.stroke
            };
            return Ok(motion(target, HOMING_SPEED));
        }
        if command == Command::Preposition {
            let (flags, rest) = payload.split_first().ok_or(Status::NOT_ENOUGH_PARAMS)?;
            let (width, speed) = two(rest)?;
            let from = if flags & 1 != 0 { self.width } else { 0.0 };
            let stops_on_block = flags & 2 != 0;
            return Ok(Motion {
                stops_on_block,
                ..motion(from + width, speed)
            });
        }
        let (width, speed) = two(payload)?;
        if command == Command::Grasp {
            let target = (width - CLAMPING_TRAVEL).max(0.0);
            return Ok(Motion {
                expects: Some(width),
                ..motion(target, speed)
            });
        }
        Ok(motion(width, speed))
    }

    fn stop(&mut self) {
        self.velocity = 0.0;
        if let Some(motion) = self.motion.take() {
            self.grasping = grasping::IDLE;
            self.answer(motion.command, Status::CMD_ABORTED);
        }
    }

    fn stop_fast(&mut self) {
        self.stop();
        self.is_stopped = true;
    }

    /// Moves its fingers and pushes its values up to `now`.
    pub fn step(&mut self, now: Duration) {
        let span = now.saturating_sub(self.now).min(CATCH_UP_MAX);
        self.now = self.now.max(now);
        let mut left_s = span.as_secs_f64();
        while left_s > 0.0 {
            let dt_s = left_s.min(STEP_S);
            left_s -= dt_s;
            self.advance(dt_s);
            self.meet(Duration::from_secs_f64(left_s.max(0.0)));
        }
        let due: Vec<_> = self
            .pushes
            .iter_mut()
            .filter(|(_, _, at)| *at <= now)
            .collect();
        let mut pushed = Vec::new();
        for (command, period, at) in due {
            *at = (*at + *period).max(now);
            pushed.push(*command);
        }
        pushed.into_iter().for_each(|command| self.push(command));
    }

    fn advance(&mut self, dt_s: f64) {
        let holds = self.grasping == grasping::HOLDING;
        if holds && self.knobs.part.is_none() && !self.knobs.always_finds {
            self.grasping = grasping::PART_LOST;
        }
        let Some(motion) = self.motion else {
            return;
        };
        let way = motion.target - self.width;
        if way.abs() <= ARRIVED {
            self.arrive(motion);
            return;
        }
        // As fast as it may and can still brake.
        let braking = (2.0 * self.acceleration * way.abs()).sqrt();
        let faster = self.velocity.abs() + self.acceleration * dt_s;
        let speed = faster.min(motion.speed).min(braking);
        self.velocity = speed.copysign(way);
        let moved = self.width + (speed * dt_s).min(way.abs()).copysign(way);
        let blocked = self
            .knobs
            .part
            .or_else(|| motion.expects.filter(|_| self.knobs.always_finds))
            .filter(|part| way < 0.0 && moved < *part && self.width >= *part);
        match blocked {
            Some(part) => self.block(motion, part),
            None => self.width = moved.clamp(0.0, self.config.stroke),
        }
    }

    /// What is between the fingers, so long before the present time.
    fn meet(&mut self, before: Duration) {
        let force = self.force();
        let Some(surroundings) = &mut self.surroundings else {
            return;
        };
        let at = self.now.saturating_sub(before);
        self.knobs.part = surroundings.part(at, self.width, force);
    }

    /// Force with which the fingers hold, N.
    fn force(&self) -> f64 {
        if self.grasping == grasping::HOLDING {
            self.force_limit
        } else {
            0.0
        }
    }

    /// The fingers are where they were sent.
    fn arrive(&mut self, motion: Motion) {
        self.width = motion.target;
        self.velocity = 0.0;
        self.motion = None;
        let (state, status) = if motion.command == Command::Grasp {
            (grasping::NO_PART, Status::CMD_FAILED)
        } else {
            (grasping::IDLE, Status::SUCCESS)
        };
        self.is_homed |= motion.command == Command::Homing;
        self.grasping = state;
        self.answer(motion.command, status);
    }

    /// A part blocks the fingers.
    fn block(&mut self, motion: Motion, part: f64) {
        self.width = part;
        self.velocity = 0.0;
        let grips = motion.expects.is_some();
        if !grips && !motion.stops_on_block {
            // It presses with the force limit, for as long as the command lasts.
            self.width = part;
        }
        self.motion = None;
        let (state, status) = if grips {
            (grasping::HOLDING, Status::SUCCESS)
        } else {
            (grasping::IDLE, Status::AXIS_BLOCKED)
        };
        self.grasping = state;
        self.answer(motion.command, status);
    }

    fn flags(&self) -> u32 {
        let flag = |bit: u32, is: bool| if is { 1 << bit } else { 0 };
        flag(0, self.is_homed)
            | flag(1, self.motion.is_some())
            | if self.is_stopped { FAST_STOP } else { 0 }
            | self.knobs.faults
    }

    fn push(&mut self, command: Command) {
        let answer = Packet::new(command).with_status(Status::SUCCESS);
        let force = self.force();
        let values = [
            (Command::Width, self.width),
            (Command::Speed, self.velocity),
            (Command::Force, force),
        ];
        let value = values.iter().find(|(of, _)| *of == command);
        let packet = if let Some((_, value)) = value {
            answer.with_float(single(*value))
        } else if command == Command::GraspingState {
            answer.with(&[self.grasping])
        } else {
            answer.with(&self.flags().to_le_bytes())
        };
        self.send(&packet);
    }

    fn answer(&mut self, command: Command, status: Status) {
        self.send(&Packet::new(command).with_status(status));
    }

    fn send(&mut self, packet: &Packet) {
        if self.knobs.silent {
            return;
        }
        let mut bytes = [0; PACKET_MAX];
        let len = packet.encode(&mut bytes);
        if self.knobs.bad_checksum {
            bytes[len - 1] ^= 0xff;
        }
        self.out.extend_from_slice(&bytes[..len]);
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "single precision is the protocol's"
)]
const fn single(value: f64) -> f32 {
    value as f32
}

/// A finite number of a payload.
fn one(payload: &[u8]) -> Result<f64, Status> {
    let (value, _) = float(payload).ok_or(Status::NOT_ENOUGH_PARAMS)?;
    finite(value)
}

fn two(payload: &[u8]) -> Result<(f64, f64), Status> {
    let (first, rest) = float(payload).ok_or(Status::NOT_ENOUGH_PARAMS)?;
    let (second, _) = float(rest).ok_or(Status::NOT_ENOUGH_PARAMS)?;
    Ok((finite(first)?, finite(second)?))
}

fn finite(value: f32) -> Result<f64, Status> {
    let value = f64::from(value);
    if value.is_finite() {
        Ok(value)
    } else {
        Err(Status::INVALID_PARAMETER)
    }
}

#[cfg(test)]
mod tests;
