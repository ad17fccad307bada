//! An axis of a CiA 402 drive over CoE (ETG.6010): locates its objects in the process data and runs its cycle: feedback
//! in, targets out, through the master of the profile ([`takt_cia402::Master`]). The objects of several axes in one
//! slave are 800h apart. It does not interpolate: each cycle sends the given target.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::proof::{Objects, Proof, Values};
use takt_cia402::{
    ControlWord, DriveCommand, DriveFault, Feedback, Goal, Master as Profile, MasterOptions, State,
    StatusWord,
};

use crate::config::{PdoSpec, StartupSdo};
use crate::master::{Master, ProcessData, Reply};
use layout::Layout;
use prover::Prover;

mod layout;
mod prover;

/// Supported modes of operation (6060h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Cyclic synchronous position.
    Csp,
    /// Cyclic synchronous velocity.
    Csv,
    /// Cyclic synchronous torque.
    Cst,
    /// Homing, by the drive itself.
    Homing,
}

impl Mode {
    /// The number in 6060h.
    pub const fn raw(self) -> i8 {
        match self {
            Self::Csp => 8,
            Self::Csv => 9,
            Self::Cst => 10,
            Self::Homing => 6,
        }
    }
}

/// The command of an axis in this cycle. Values are in units of the drive; they are sent only in their mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Hold the position, in CSP.
    Hold,
    /// 607Ah in CSP.
    Position(i32),
    /// 60FFh in CSV.
    Velocity(i32),
    /// 6071h in CST, per mille of the rated torque.
    Torque(i16),
    /// Home, by the method in 6098h.
    Home,
}

impl Target {
    const fn mode(self) -> Mode {
        match self {
            Self::Hold | Self::Position(_) => Mode::Csp,
            Self::Velocity(_) => Mode::Csv,
            Self::Torque(_) => Mode::Cst,
            Self::Home => Mode::Homing,
        }
    }
}

/// State of homing (6041h, bits 10, 12 and 13).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Homing {
    /// Not requested.
    Idle,
    /// In progress.
    Running,
    /// Home is found, the axis has stopped.
    Done,
    /// The drive reports a homing error.
    Failed,
}

/// State of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisState {
    /// Its slave answers; the other fields are of this cycle or of the last few.
    pub online: bool,
    /// State of the drive; `None` if its statusword shows none.
    pub state: Option<State>,
    /// 6041h.
    pub status: StatusWord,
    /// 6040h as sent, without the mode-specific bits.
    pub control: ControlWord,
    /// Why it has not reached its goal.
    pub drive_fault: Option<DriveFault>,
    /// Whether it follows its target.
    pub follows: bool,
    /// 6064h.
    pub position: i32,
    /// 606Ch; `None` if it is not mapped.
    pub velocity: Option<i32>,
    /// 6077h, per mille of the rated torque; `None` if it is not mapped.
    pub torque: Option<i16>,
    /// 603Fh; `None` if it is not mapped.
    pub error_code: Option<u16>,
    /// State of homing.
    pub homing: Homing,
}

/// A required object of an axis is not mapped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{address} is not in the PDOs; map it, or give the slave the PDOs of `axis::pdos`")]
pub struct NotMapped {
    /// The object.
    pub address: Address,
}

fn signed(value: u32) -> i32 {
    value.cast_signed()
}

fn short(value: u32) -> u16 {
    let [a, b, ..] = value.to_le_bytes();
    u16::from_le_bytes([a, b])
}

/// Bit 4 of 6040h: start of homing.
const HOMING_START: u16 = 0x0010;

/// An axis.
#[derive(Debug)]
pub struct Axis {
    slave: usize,
    layout: Layout,
    profile: Profile,
    prover: Prover,
    target: Target,
    /// Position to hold while it is enabled without a target position. The actual position of each cycle would yield to
    /// any load.
    held: Option<i32>,
    /// 60B2h beside a target position, per mille of the rated torque.
    torque_offset: i16,
    /// The values that were last sent.
    sent: Values,
    /// Number of cycles since homing was started by bit 4.
    begun: Option<u32>,
    online: bool,
}

impl Axis {
    /// An axis (0 to 7) of a slave whose process data is known; without power until [`Self::set_goal`] and until its
    /// process data are proven. The owner of the master must pass replies to [`Self::handle_reply`]; otherwise no axis
    /// gets power.
    pub fn new(
        slave: usize,
        process: &ProcessData,
        axis: u8,
        options: MasterOptions,
    ) -> Result<Self, NotMapped> {
        let layout = Layout::find(process, axis)?;
        Ok(Self {
            slave,
            layout,
            profile: Profile::new(options),
            prover: Prover::new(slave, axis, layout.carried(), Objects::default()),
            target: Target::Hold,
            held: None,
            torque_offset: 0,
            sent: Values::default(),
            begun: None,
            online: false,
        })
    }

    /// The same, for a drive whose SDO server does not mirror these objects of its PDOs: they are not proven.
    #[must_use]
    pub fn not_mirrored(self, objects: Objects) -> Self {
        let (carried, number) = (self.layout.carried(), self.prover.axis());
        Self {
            prover: Prover::new(self.slave, number, carried, objects),
            ..self
        }
    }

    /// Its slave.
    pub const fn slave(&self) -> usize {
        self.slave
    }

    /// The proof of its process data.
    pub const fn proof(&self) -> &Proof {
        self.prover.proof()
    }

    /// Handles the reply to one of its uploads; returns other replies.
    ///
    /// # Errors
    /// A reply to another job.
    pub fn handle_reply(&mut self, reply: Reply, now: Duration) -> Result<(), Reply> {
        self.prover.handle_reply(reply, now)
    }

    /// Sets the goal. The goal of an axis that was offline is reset to no power: a returning axis does not move by
    /// itself.
    pub fn set_goal(&mut self, goal: Goal) {
        self.profile.set_goal(goal);
    }

    /// Sets the torque offset (60B2h) that is sent with target positions while the axis follows them, where it is mapped; per mille
    /// of the rated torque.
    pub const fn set_torque_offset(&mut self, offset: i16) {
        self.torque_offset = offset;
    }

    /// Requests a fault reset.
    pub const fn reset_fault(&mut self) {
        self.profile.reset_fault();
    }

    /// One cycle: reads the inputs of the last frame and writes the outputs of the next.
    pub fn cycle(&mut self, master: &mut Master, target: Target, now: Duration) -> AxisState {
        let (inputs, age) = master.inputs(self.slave);
        let received = self.layout.read(inputs);
        let mapped = |index| self.layout.has(index).then(|| received.at(index));
        let feedback = Feedback {
            status: StatusWord::new(short(received.at(0x6041))),
            mode: mapped(0x6061).map(|raw| raw.to_le_bytes()[0].cast_signed()),
            position: signed(received.at(0x6064)),
        };
        let mut state = AxisState {
            online: master.is_online(age),
            state: feedback.status.state().ok(),
            status: feedback.status,
            control: ControlWord::DISABLE_VOLTAGE,
            drive_fault: None,
            follows: false,
            position: feedback.position,
            velocity: mapped(0x606C).map(signed),
            torque: mapped(0x6077).map(|raw| short(raw).cast_signed()),
            error_code: mapped(0x603F).map(short),
            homing: Homing::Idle,
        };
        if self.online && !state.online {
            self.profile.set_goal(Goal::SwitchOnDisabled);
        }
        self.online = state.online;
        self.prover
            .cycle(master, &mut self.profile, &received, &self.sent, age, now);
        let drive_command = self.lead(&feedback, target, now);
        (state.follows, state.control) = (drive_command.follows, drive_command.control);
        let refused = self.prover.proof().fault().map(DriveFault::NotProven);
        let drive_fault = refused.or_else(|| self.profile.drive_fault());
        state.drive_fault = drive_fault.filter(|_| state.online);
        state.homing = self.homing(&feedback, &drive_command);
        self.hold(&drive_command, state.state);
        self.sent = self.outputs(&drive_command);
        if let Some(instead) = self.prover.proof().instead() {
            self.sent = *instead;
            state.control = ControlWord::new(short(instead.at(0x6040)));
        }
        self.layout
            .write(master.outputs_mut(self.slave), &self.sent);
        state
    }

    fn lead(&mut self, feedback: &Feedback, target: Target, now: Duration) -> DriveCommand {
        if target.mode() != self.target.mode() {
            self.begun = None;
        }
        self.target = target;
        self.profile.set_mode(target.mode().raw());
        self.profile.step(feedback, now)
    }

    /// The first target of an enabled drive is its actual position.
    fn hold(&mut self, drive_command: &DriveCommand, state: Option<State>) {
        let enabled = state == Some(State::OperationEnabled);
        self.held = match self.target {
            Target::Position(position) if enabled && drive_command.follows => Some(position),
            Target::Position(_) | Target::Hold if enabled => self.held.or(Some(drive_command.hold)),
            Target::Position(_)
            | Target::Hold
            | Target::Velocity(_)
            | Target::Torque(_)
            | Target::Home => None,
        };
    }

    /// Homing starts with the edge of bit 4 once the drive is enabled in homing mode.
    fn homing(&mut self, feedback: &Feedback, drive_command: &DriveCommand) -> Homing {
        if self.target != Target::Home || !drive_command.follows {
            self.begun = None;
            return Homing::Idle;
        }
        let cycles = self.begun.map_or(0, |cycles| cycles.saturating_add(1));
        self.begun = Some(cycles);
        let bit = |n: u16| feedback.status.raw() >> n & 1 != 0;
        match (bit(10), bit(12), bit(13)) {
            // Before the drive has seen the edge, the bits show the previous run.
            _ if cycles < 8 => Homing::Running,
            (_, _, true) => Homing::Failed,
            (true, true, false) => Homing::Done,
            (false, _, false) | (true, false, false) => Homing::Running,
        }
    }

    fn outputs(&self, drive_command: &DriveCommand) -> Values {
        // Low for two cycles first, to make an edge.
        let begins = self.begun.is_some_and(|cycles| cycles >= 2);
        let word = drive_command.control.raw() | if begins { HOMING_START } else { 0 };
        let position = self.held.unwrap_or(drive_command.hold);
        let (mut velocity, mut torque) = (0, 0);
        if let Target::Velocity(wanted) = self.target
            && drive_command.follows
        {
            velocity = wanted;
        }
        if let Target::Torque(wanted) = self.target
            && drive_command.follows
        {
            torque = wanted;
        }
        let mut offset = 0;
        if let Target::Position(_) = self.target
            && drive_command.follows
        {
            offset = self.torque_offset;
        }
        let mut values = Values::default();
        values.put(0x60B2, offset.cast_unsigned().into());
        values.put(0x6040, word.into());
        values.put(0x6060, drive_command.mode.cast_unsigned().into());
        values.put(0x607A, position.cast_unsigned());
        values.put(0x60FF, velocity.cast_unsigned());
        values.put(0x6071, torque.cast_unsigned().into());
        values
    }
}

impl fmt::Display for AxisState {
    /// `Operation enabled, position 4096`, and the fault, if any.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.online, self.state) {
            (false, _) => f.write_str("offline")?,
            (true, Some(state)) => write!(f, "{state}, position {}", self.position)?,
            (true, None) => write!(f, "statusword {} shows no state", self.status)?,
        }
        self.drive_fault
            .map_or(Ok(()), |drive_fault| write!(f, ": {drive_fault}"))
    }
}

/// PDOs with the objects that [`Axis`] uses, for `axes` axes (1 to 8) in one slave: one RxPDO and one TxPDO for each,
/// 10h apart as ETG.6010 has them.
pub fn pdos(axes: u8) -> (Vec<PdoSpec>, Vec<PdoSpec>) {
    let one = |first: u16, axis: u8, objects: &[(u16, u8)]| PdoSpec {
        index: first + 0x10 * u16::from(axis),
        entries: objects
            .iter()
            .filter_map(|(index, bits)| {
                let address = Address::new(*index, 0).on_axis(axis)?;
                Some(Mapped {
                    address,
                    bits: *bits,
                })
            })
            .collect(),
    };
    let outputs = [
        (0x6040, 16),
        (0x6060, 8),
        (0x607A, 32),
        (0x60FF, 32),
        (0x6071, 16),
    ];
    let inputs = [
        (0x6041, 16),
        (0x6061, 8),
        (0x6064, 32),
        (0x606C, 32),
        (0x6077, 16),
        (0x603F, 16),
    ];
    let all = |first, objects: &[(u16, u8)]| {
        (0..axes.min(8))
            .map(|axis| one(first, axis, objects))
            .collect()
    };
    (all(0x1600, &outputs), all(0x1A00, &inputs))
}

/// Start-up objects of an axis for cyclic modes: the interpolation time (60C2h) of a cycle, in its largest unit. Drives
/// without 60C2h take the cycle from SYNC0, so that a refusal is not a fault.
pub fn interpolation(axis: u8, cycle: Duration) -> Vec<StartupSdo> {
    let mut value = cycle.as_micros();
    let mut exponent = -6_i8;
    while value > 0 && value.is_multiple_of(10) && exponent < 0 {
        value /= 10;
        exponent += 1;
    }
    let Ok(value) = u8::try_from(value) else {
        return Vec::new();
    };
    let write = |sub, byte: u8| {
        let address = Address::new(0x60C2, sub).on_axis(axis)?;
        Some(StartupSdo {
            may_fail: true,
            ..StartupSdo::entry(address, [byte])
        })
    };
    [write(1, value), write(2, exponent.cast_unsigned())]
        .into_iter()
        .flatten()
        .collect()
}

/// Start-up objects of an axis for homing: method (6098h), speeds towards the switch and away from it (6099h), in units
/// of the drive.
pub fn homing(axis: u8, method: i8, speeds: (u32, u32)) -> Vec<StartupSdo> {
    let write = |index, sub, data: &[u8]| {
        let address = Address::new(index, sub).on_axis(axis)?;
        Some(StartupSdo::entry(address, data))
    };
    [
        write(0x6098, 0, &method.to_le_bytes()),
        write(0x6099, 1, &speeds.0.to_le_bytes()),
        write(0x6099, 2, &speeds.1.to_le_bytes()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests;
