//! One connection to a gripper, without I/O: bytes in, bytes out, time is an argument. It gives one command at a time and
//! does not repeat one: what a gripper did not answer is not known.
//!
//! ```text
//!           (1) connected                (3) all values arrive
//!   ────────▶ Acknowledging ──▶ Subscribing ──────────▶ Ready
//!                  ▲        (2) answered                  │
//!                  └──────────────────────────────────────┘
//!                       (4) the gripper reports a fast stop
//! ```
//! 1: [`Session::new`]; 2, 3: `handle_answer`; 4: `poll`, a second after the stop. A session ends with its connection.

use std::time::Duration;

use takt_net::device::GripperCommand;

use crate::wire::{Command, PACKET_MAX, Packet, PacketReader, Status, float};

/// Time between two values of the gripper.
pub const PUSH_PERIOD: Duration = Duration::from_millis(20);
/// A gripper that is silent for this time is lost, and an answer that takes longer is missing.
pub const SILENCE_MAX: Duration = Duration::from_secs(1);
/// Longest motion: the whole stroke at the lowest speed, 5 mm/s, and homing before it.
pub const MOTION_MAX: Duration = Duration::from_secs(60);
/// Time between a fast stop and its acknowledgement.
const ACKNOWLEDGE_AFTER: Duration = Duration::from_secs(1);
/// Payload of an acknowledgement.
const ACK: &[u8] = b"ack";
/// Bit of the system state: a fast stop is active.
pub const FAST_STOP: u32 = 1 << 12;
/// Bits of the system state that are faults: temperature, power, current, finger.
pub const FAULTS: u32 = 0b1111 << 14;
/// Values that the gripper pushes.
const SUBSCRIPTIONS: [Command; 5] = [
    Command::Width,
    Command::Speed,
    Command::Force,
    Command::GraspingState,
    Command::SystemState,
];
/// Bytes of packets that wait for transmission: all subscriptions and two commands.
const QUEUE: usize = 256;

/// State of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// A fast stop, if there is one, is being acknowledged.
    Acknowledging,
    /// Values are requested; not all have arrived.
    Subscribing,
    /// The gripper executes commands.
    Ready,
}

/// Last values of the gripper, in SI units.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Values {
    /// Distance between the fingers, m.
    pub width: Option<f64>,
    /// Relative speed of the fingers, m/s.
    pub speed: Option<f64>,
    /// Force, N.
    pub force: Option<f64>,
    /// State of grasping.
    pub grasping: Option<u8>,
    /// Flags of the system.
    pub flags: Option<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Pending {
    number: u64,
    command: Command,
    until: Duration,
}

/// A connection to a gripper.
#[derive(Debug)]
pub struct Session {
    state: State,
    reader: PacketReader,
    queue: [u8; QUEUE],
    queued: usize,
    values: Values,
    pending: Option<Pending>,
    finished: Option<(u64, Status)>,
    received_at: Duration,
    stopped_at: Option<Duration>,
    errors: u64,
}

impl Session {
    /// A session of a connection made at `now`.
    #[must_use]
    pub fn new(now: Duration) -> Self {
        let mut session = Self {
            state: State::Acknowledging,
            reader: PacketReader::default(),
            queue: [0; QUEUE],
            queued: 0,
            values: Values::default(),
            pending: None,
            finished: None,
            received_at: now,
            stopped_at: None,
            errors: 0,
        };
        session.send(&Packet::new(Command::Acknowledge).with(ACK));
        session
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The last values.
    #[must_use]
    pub const fn values(&self) -> &Values {
        &self.values
    }

    /// Whether the gripper executes commands.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        let flags = self.values.flags.unwrap_or(0);
        self.state == State::Ready && flags & (FAST_STOP | FAULTS) == 0
    }

    /// Whether a command is being executed.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.pending.is_some()
    }

    /// Number and status of the command that was finished last.
    #[must_use]
    pub const fn finished(&self) -> Option<(u64, Status)> {
        self.finished
    }

    /// Packets that could not be decoded.
    #[must_use]
    pub const fn errors(&self) -> u64 {
        self.errors
    }

    /// Whether the gripper has been silent for too long.
    #[must_use]
    pub fn is_lost(&self, now: Duration) -> bool {
        now.saturating_sub(self.received_at) > SILENCE_MAX
    }

    /// Handles received bytes.
    pub fn handle_bytes(&mut self, bytes: &[u8], now: Duration) {
        for byte in bytes {
            match self.reader.push(*byte) {
                None => {}
                Some(Err(_)) => self.errors += 1,
                Some(Ok(packet)) => {
                    self.received_at = now;
                    self.handle_answer(&packet, now);
                }
            }
        }
    }

    fn handle_answer(&mut self, packet: &Packet, now: Duration) {
        let Some((status, values)) = packet.answer() else {
            self.errors += 1;
            return;
        };
        if packet.command == Command::Acknowledge && self.state == State::Acknowledging {
            // A gripper without a fast stop has nothing to acknowledge, which is no error.
            self.state = State::Subscribing;
            SUBSCRIPTIONS.iter().for_each(|it| self.subscribe(*it));
        }
        if status == Status::SUCCESS {
            self.take_value(packet.command, values);
        }
        let all = &self.values;
        let complete = all.width.is_some()
            && all.speed.is_some()
            && all.force.is_some()
            && all.grasping.is_some()
            && all.flags.is_some();
        if self.state == State::Subscribing && complete {
            self.state = State::Ready;
        }
        if let Some(pending) = self.pending.filter(|it| it.command == packet.command) {
            if status == Status::PENDING {
                self.pending = Some(Pending {
                    until: now + MOTION_MAX,
                    ..pending
                });
            } else {
                self.finish(pending.number, status);
            }
        }
    }

    fn finish(&mut self, number: u64, status: Status) {
        self.pending = None;
        self.finished = Some((number, status));
    }

    fn take_value(&mut self, command: Command, values: &[u8]) {
        let number = float(values).map(|(value, _)| f64::from(value));
        let metres = number.map(|value| value / 1000.0);
        match command {
            Command::Width => self.values.width = metres,
            Command::Speed => self.values.speed = metres,
            Command::Force => self.values.force = number,
            Command::GraspingState => self.values.grasping = values.first().copied(),
            Command::SystemState => {
                self.values.flags = values.first_chunk().map(|bytes| u32::from_le_bytes(*bytes));
            }
            Command::Disconnect
            | Command::Homing
            | Command::Preposition
            | Command::Stop
            | Command::FastStop
            | Command::Acknowledge
            | Command::Grasp
            | Command::Release
            | Command::SetAcceleration
            | Command::SetForceLimit
            | Command::SetSoftLimits
            | Command::GetSoftLimits
            | Command::ClearSoftLimits
            | Command::Other(_) => {}
        }
    }

    /// Requests a value now and then every [`PUSH_PERIOD`].
    fn subscribe(&mut self, value: Command) {
        let millis = u16::try_from(PUSH_PERIOD.as_millis()).unwrap_or(u16::MAX);
        let packet = Packet::new(value).with(&[1]).with(&millis.to_le_bytes());
        self.send(&packet);
    }

    fn send(&mut self, packet: &Packet) {
        let mut bytes = [0; PACKET_MAX];
        let len = packet.encode(&mut bytes);
        if let Some(place) = self.queue.get_mut(self.queued..self.queued + len) {
            place.copy_from_slice(&bytes[..len]);
            self.queued += len;
        } else {
            // The connection takes nothing: it is lost.
            self.errors += 1;
        }
    }

    /// The bytes to be sent; they are removed.
    pub fn transmit(&mut self, out: &mut [u8; QUEUE]) -> usize {
        *out = self.queue;
        std::mem::take(&mut self.queued)
    }

    /// Gives a command; its outcome is that of this number. One that is being executed is aborted only by a stop.
    pub fn give(&mut self, number: u64, command: &GripperCommand, now: Duration) {
        let Some(packet) = packet(command) else {
            self.finished = Some((number, Status::CMD_UNKNOWN));
            return;
        };
        if !self.is_ready() {
            self.finished = Some((number, Status::ACCESS_DENIED));
        } else if self.is_busy() && packet.command != Command::Stop {
            self.finished = Some((number, Status::ALREADY_RUNNING));
        } else {
            self.send(&packet);
            self.pending = Some(Pending {
                number,
                command: packet.command,
                until: now + SILENCE_MAX,
            });
        }
    }

    /// Stops the command of that number if it is still being executed.
    pub fn withdraw(&mut self, number: u64, now: Duration) {
        let pending = self.pending.filter(|it| it.number == number);
        if pending.is_some_and(|it| it.command != Command::Stop) {
            self.send(&Packet::new(Command::Stop));
            self.pending = Some(Pending {
                number,
                command: Command::Stop,
                until: now + SILENCE_MAX,
            });
        }
    }

    /// Announces the end of the connection, so that the gripper does not stop for it.
    pub fn say_goodbye(&mut self) {
        self.send(&Packet::new(Command::Disconnect));
    }

    /// Executes what is due: missing answers, and the acknowledgement of a fast stop.
    pub fn poll(&mut self, now: Duration) {
        if let Some(pending) = self.pending.filter(|it| now >= it.until) {
            self.finish(pending.number, Status::TIMEOUT);
        }
        let flags = self.values.flags.unwrap_or(0);
        if self.state != State::Ready || flags & FAST_STOP == 0 {
            self.stopped_at = None;
            return;
        }
        let since = *self.stopped_at.get_or_insert(now);
        if now >= since + ACKNOWLEDGE_AFTER {
            self.stopped_at = Some(now);
            self.send(&Packet::new(Command::Acknowledge).with(ACK));
        }
    }
}

/// The packet of a command; `None` if there is no such command for nets.
#[expect(
    clippy::cast_possible_truncation,
    reason = "single precision is the protocol's; values beyond it are infinite and rejected by the gripper"
)]
fn packet(command: &GripperCommand) -> Option<Packet> {
    let milli = |value: f64| (value * 1000.0) as f32;
    let id = Command::of(u8::try_from(command.id).ok()?);
    let options = u8::try_from(command.options).ok()?;
    let (first, second) = (command.first, command.second);
    let packet = Packet::new(id);
    Some(match id {
        Command::Homing => packet.with(&[options]),
        Command::Preposition => packet
            .with(&[options])
            .with_float(milli(first))
            .with_float(milli(second)),
        Command::Grasp | Command::Release | Command::SetSoftLimits => {
            packet.with_float(milli(first)).with_float(milli(second))
        }
        Command::SetAcceleration => packet.with_float(milli(first)),
        Command::SetForceLimit => packet.with_float(first as f32),
        Command::Stop | Command::ClearSoftLimits => packet,
        Command::Disconnect
        | Command::FastStop
        | Command::Acknowledge
        | Command::GetSoftLimits
        | Command::SystemState
        | Command::GraspingState
        | Command::Width
        | Command::Speed
        | Command::Force
        | Command::Other(_) => return None,
    })
}

#[cfg(test)]
mod tests;
