//! An axis of a CiA 402 drive over CoE (ETG.6010): where its objects lie in the process data, and one cycle of it:
//! feedback in, targets out, through the profile's own master ([`takt_cia402::Master`]). Several axes in one slave lie
//! 800h apart. It interpolates nothing: a target is sent as it is given, each cycle.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::proof::{Objects, Proof, Values};
use takt_cia402::{
    ControlWord, Feedback, Goal, Master as Profile, Obstacle, Orders, Patience, State, StatusWord,
};

use crate::config::{PdoSpec, StartupSdo};
use crate::master::{Master, ProcessData, Reply};
use places::Places;
use prover::Prover;

mod places;
mod prover;

/// Modes of operation (6060h) that an axis is led in.
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
    #[must_use]
    pub const fn raw(self) -> i8 {
        match self {
            Self::Csp => 8,
            Self::Csv => 9,
            Self::Cst => 10,
            Self::Homing => 6,
        }
    }
}

/// What an axis is to do in this cycle. Numbers are the drive's own units, in a mode that it is not in they are not
/// sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Stay where it is, in CSP.
    Hold,
    /// 607Ah in CSP.
    Position(i32),
    /// 60FFh in CSV.
    Velocity(i32),
    /// 6071h in CST, per mille of the rated torque.
    Torque(i16),
    /// Find home, by the method in 6098h.
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

/// Where homing is (6041h, bits 10, 12 and 13).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Homing {
    /// It is not asked for.
    Idle,
    /// Under way.
    Running,
    /// Home is found, the axis stands.
    Done,
    /// The drive gave up.
    Failed,
}

/// What is known of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisState {
    /// Its slave answers, and what follows is of this cycle or of the last few.
    pub online: bool,
    /// State of the drive; `None` if its statusword shows none.
    pub state: Option<State>,
    /// 6041h.
    pub status: StatusWord,
    /// 6040h as it is sent for it, without the bits of the mode.
    pub control: ControlWord,
    /// Why it is not where it is wanted.
    pub obstacle: Option<Obstacle>,
    /// It follows its target.
    pub follows: bool,
    /// 6064h.
    pub position: i32,
    /// 606Ch; `None` if it is not mapped.
    pub velocity: Option<i32>,
    /// 6077h, per mille of the rated torque; `None` if it is not mapped.
    pub torque: Option<i16>,
    /// 603Fh; `None` if it is not mapped.
    pub error_code: Option<u16>,
    /// Where homing is.
    pub homing: Homing,
}

/// An object of an axis that must be mapped and is not.
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

/// Cycles without inputs after which an axis counts as gone.
const GONE: u32 = 4;
/// Bit 4 of 6040h: in homing, begin.
const HOMING_START: u16 = 0x0010;

/// An axis.
#[derive(Debug)]
pub struct Axis {
    slave: usize,
    places: Places,
    profile: Profile,
    prover: Prover,
    target: Target,
    /// Where it is held while it is enabled and has no position to go to. The actual position of every cycle would give
    /// way to any load.
    held: Option<i32>,
    /// What was sent last.
    sent: Values,
    /// Homing was begun by bit 4 so many cycles ago.
    begun: Option<u32>,
    online: bool,
}

impl Axis {
    /// An axis (0 to 7) of a slave whose process data is known; without power until [`Self::set_goal`], and until its
    /// process data are proven. The owner of the master gives replies to [`Self::handle_reply`], or no axis gets power.
    pub fn new(
        slave: usize,
        process: &ProcessData,
        axis: u8,
        patience: Patience,
    ) -> Result<Self, NotMapped> {
        let places = Places::find(process, axis)?;
        Ok(Self {
            slave,
            places,
            profile: Profile::new(patience),
            prover: Prover::new(slave, axis, places.carried(), Objects::default()),
            target: Target::Hold,
            held: None,
            sent: Values::default(),
            begun: None,
            online: false,
        })
    }

    /// The same, of a drive whose SDO server does not show these objects as its PDOs carry them: they are taken on trust.
    #[must_use]
    pub fn not_mirrored(self, objects: Objects) -> Self {
        let (carried, number) = (self.places.carried(), self.prover.axis());
        Self {
            prover: Prover::new(self.slave, number, carried, objects),
            ..self
        }
    }

    /// The slave that it is in.
    #[must_use]
    pub const fn slave(&self) -> usize {
        self.slave
    }

    /// The proof of its process data.
    #[must_use]
    pub const fn proof(&self) -> &Proof {
        self.prover.proof()
    }

    /// Takes the reply to an upload of its own; gives back what is another's.
    ///
    /// # Errors
    /// A reply that is not to this axis.
    pub fn handle_reply(&mut self, reply: Reply, now: Duration) -> Result<(), Reply> {
        self.prover.handle_reply(reply, now)
    }

    /// Where it is wanted. An axis that was gone is wanted without power from then on: what comes back does not move
    /// by itself.
    pub fn set_goal(&mut self, goal: Goal) {
        self.profile.set_goal(goal);
    }

    /// Asks for a fault to be reset.
    pub const fn reset_fault(&mut self) {
        self.profile.reset_fault();
    }

    /// One cycle: inputs of the last frame in, outputs of the next out.
    pub fn cycle(&mut self, master: &mut Master, target: Target, now: Duration) -> AxisState {
        let (inputs, age) = master.inputs(self.slave);
        let received = self.places.read(inputs);
        let mapped = |index| self.places.has(index).then(|| received.at(index));
        let feedback = Feedback {
            status: StatusWord::new(short(received.at(0x6041))),
            mode: mapped(0x6061).map(|raw| raw.to_le_bytes()[0].cast_signed()),
            position: signed(received.at(0x6064)),
        };
        let mut state = AxisState {
            online: age <= GONE,
            state: feedback.status.state().ok(),
            status: feedback.status,
            control: ControlWord::DISABLE_VOLTAGE,
            obstacle: None,
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
        let orders = self.lead(&feedback, target, now);
        (state.follows, state.control) = (orders.follows, orders.control);
        let refused = self.prover.proof().fault().map(Obstacle::NotProven);
        let obstacle = refused.or_else(|| self.profile.obstacle());
        state.obstacle = obstacle.filter(|_| state.online);
        state.homing = self.homing(&feedback, &orders);
        self.hold(&orders, state.state);
        self.sent = self.outputs(&orders);
        if let Some(instead) = self.prover.proof().instead() {
            self.sent = *instead;
            state.control = ControlWord::new(short(instead.at(0x6040)));
        }
        self.places
            .write(master.outputs_mut(self.slave), &self.sent);
        state
    }

    fn lead(&mut self, feedback: &Feedback, target: Target, now: Duration) -> Orders {
        if target.mode() != self.target.mode() {
            self.begun = None;
        }
        self.target = target;
        self.profile.set_mode(target.mode().raw());
        self.profile.step(feedback, now)
    }

    /// The first target that an enabled drive has is where it is.
    fn hold(&mut self, orders: &Orders, state: Option<State>) {
        let enabled = state == Some(State::OperationEnabled);
        self.held = match self.target {
            Target::Position(position) if enabled && orders.follows => Some(position),
            Target::Position(_) | Target::Hold if enabled => self.held.or(Some(orders.hold)),
            Target::Position(_)
            | Target::Hold
            | Target::Velocity(_)
            | Target::Torque(_)
            | Target::Home => None,
        };
    }

    /// Homing begins by the edge of bit 4 once the drive is enabled in that mode.
    fn homing(&mut self, feedback: &Feedback, orders: &Orders) -> Homing {
        if self.target != Target::Home || !orders.follows {
            self.begun = None;
            return Homing::Idle;
        }
        let cycles = self.begun.map_or(0, |cycles| cycles.saturating_add(1));
        self.begun = Some(cycles);
        let bit = |n: u16| feedback.status.raw() >> n & 1 != 0;
        match (bit(10), bit(12), bit(13)) {
            // What the bits show before the drive has seen the edge is of the time before.
            _ if cycles < 8 => Homing::Running,
            (_, _, true) => Homing::Failed,
            (true, true, false) => Homing::Done,
            (false, _, false) | (true, false, false) => Homing::Running,
        }
    }

    fn outputs(&self, orders: &Orders) -> Values {
        // Low for two cycles first, so that there is an edge.
        let begins = self.begun.is_some_and(|cycles| cycles >= 2);
        let word = orders.control.raw() | if begins { HOMING_START } else { 0 };
        let position = self.held.unwrap_or(orders.hold);
        let (mut velocity, mut torque) = (0, 0);
        if let Target::Velocity(wanted) = self.target
            && orders.follows
        {
            velocity = wanted;
        }
        if let Target::Torque(wanted) = self.target
            && orders.follows
        {
            torque = wanted;
        }
        let mut values = Values::default();
        values.put(0x6040, word.into());
        values.put(0x6060, orders.mode.cast_unsigned().into());
        values.put(0x607A, position.cast_unsigned());
        values.put(0x60FF, velocity.cast_unsigned());
        values.put(0x6071, torque.cast_unsigned().into());
        values
    }
}

impl fmt::Display for AxisState {
    /// `Operation enabled, position 4096`, and what is in the way.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.online, self.state) {
            (false, _) => f.write_str("offline")?,
            (true, Some(state)) => write!(f, "{state}, position {}", self.position)?,
            (true, None) => write!(f, "statusword {} shows no state", self.status)?,
        }
        self.obstacle
            .map_or(Ok(()), |obstacle| write!(f, ": {obstacle}"))
    }
}

/// PDOs that carry what [`Axis`] uses of so many axes (1 to 8) in one slave: one RxPDO and one TxPDO for each, 10h apart
/// as ETG.6010 has them.
#[must_use]
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

/// Start-up objects of an axis for cyclic modes: the interpolation time (60C2h) of a cycle, in its largest unit.
/// Drives that have no 60C2h take the cycle from SYNC0, so a refusal is no fault.
#[must_use]
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

/// Start-up objects of an axis for homing: method (6098h), speeds towards the switch and away from it (6099h), in the
/// drive's units.
#[must_use]
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
