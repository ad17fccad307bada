//! An axis of a CiA 402 drive over CoE (ETG.6010): where its objects lie in the process data, and one cycle of it:
//! feedback in, targets out, through the profile's own master ([`takt_cia402::Master`]). Several axes in one slave lie
//! 800h apart. It interpolates nothing: a target is sent as it is given, each cycle.

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::{Address, Mapped};
use takt_cia402::{
    ControlWord, Feedback, Goal, Master as Profile, Obstacle, Orders, Patience, State, StatusWord,
};

use crate::config::{PdoSpec, StartupSdo};
use crate::master::{Master, ProcessData};

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

/// Bits of an object in the process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Bits {
    first: usize,
    count: usize,
}

impl Bits {
    fn find(process: &ProcessData, index: u16, axis: u8, outputs: bool) -> Option<Self> {
        let address = Address::new(index, 0).on_axis(axis)?;
        let place = process.locate(address, outputs)?;
        Some(Self {
            first: place.bit,
            count: usize::from(place.bits).min(32),
        })
    }

    fn read(self, bytes: &[u8]) -> u32 {
        let bit = |n: usize| {
            let at = self.first + n;
            let byte = bytes.get(at / 8).copied().unwrap_or(0);
            u32::from(byte >> (at % 8) & 1) << n
        };
        (0..self.count).map(bit).sum()
    }

    fn write(self, bytes: &mut [u8], value: u32) {
        for n in 0..self.count {
            let at = self.first + n;
            if let Some(byte) = bytes.get_mut(at / 8) {
                let mask = 1 << (at % 8);
                *byte = if value >> n & 1 == 0 {
                    *byte & !mask
                } else {
                    *byte | mask
                };
            }
        }
    }
}

fn signed(value: u32) -> i32 {
    value.cast_signed()
}

fn short(value: u32) -> u16 {
    let [a, b, ..] = value.to_le_bytes();
    u16::from_le_bytes([a, b])
}

/// Where the objects of an axis lie.
#[derive(Clone, Copy, Debug)]
struct Places {
    control: Bits,
    mode: Option<Bits>,
    target_position: Option<Bits>,
    target_velocity: Option<Bits>,
    target_torque: Option<Bits>,
    status: Bits,
    shown: Option<Bits>,
    position: Bits,
    velocity: Option<Bits>,
    torque: Option<Bits>,
    error_code: Option<Bits>,
}

impl Places {
    fn find(process: &ProcessData, axis: u8) -> Result<Self, NotMapped> {
        let out = |index| Bits::find(process, index, axis, true);
        let back = |index| Bits::find(process, index, axis, false);
        let missing = |index| {
            let plain = Address::new(index, 0);
            NotMapped {
                address: plain.on_axis(axis).unwrap_or(plain),
            }
        };
        Ok(Self {
            control: out(0x6040).ok_or_else(|| missing(0x6040))?,
            mode: out(0x6060),
            target_position: out(0x607A),
            target_velocity: out(0x60FF),
            target_torque: out(0x6071),
            status: back(0x6041).ok_or_else(|| missing(0x6041))?,
            shown: back(0x6061),
            position: back(0x6064).ok_or_else(|| missing(0x6064))?,
            velocity: back(0x606C),
            torque: back(0x6077),
            error_code: back(0x603F),
        })
    }
}

/// Cycles without inputs after which an axis counts as gone.
const GONE: u32 = 4;
/// Bit 4 of 6040h: in homing, begin.
const HOMING_START: u16 = 0x0010;

/// An axis.
#[derive(Clone, Debug)]
pub struct Axis {
    slave: usize,
    places: Places,
    profile: Profile,
    target: Target,
    /// Homing was begun by bit 4 so many cycles ago.
    begun: Option<u32>,
    online: bool,
}

impl Axis {
    /// An axis (0 to 7) of a slave whose process data is known; without power until [`Self::set_goal`].
    pub fn new(
        slave: usize,
        process: &ProcessData,
        axis: u8,
        patience: Patience,
    ) -> Result<Self, NotMapped> {
        Ok(Self {
            slave,
            places: Places::find(process, axis)?,
            profile: Profile::new(patience),
            target: Target::Hold,
            begun: None,
            online: false,
        })
    }

    /// The slave that it is in.
    #[must_use]
    pub const fn slave(&self) -> usize {
        self.slave
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
        let read = |bits: Bits| bits.read(inputs);
        let places = self.places;
        let feedback = Feedback {
            status: StatusWord::new(short(read(places.status))),
            mode: places
                .shown
                .map(|bits| read(bits).to_le_bytes()[0].cast_signed()),
            position: signed(read(places.position)),
        };
        let mut state = AxisState {
            online: age <= GONE,
            state: feedback.status.state().ok(),
            status: feedback.status,
            control: ControlWord::DISABLE_VOLTAGE,
            obstacle: None,
            follows: false,
            position: feedback.position,
            velocity: places.velocity.map(|bits| signed(read(bits))),
            torque: places.torque.map(|bits| short(read(bits)).cast_signed()),
            error_code: places.error_code.map(|bits| short(read(bits))),
            homing: Homing::Idle,
        };
        let orders = self.lead(&feedback, target, state.online, now);
        (state.follows, state.control) = (orders.follows, orders.control);
        state.obstacle = self.profile.obstacle().filter(|_| state.online);
        state.homing = self.homing(&feedback, &orders);
        self.write(master.outputs_mut(self.slave), &orders);
        state
    }

    fn lead(&mut self, feedback: &Feedback, target: Target, online: bool, now: Duration) -> Orders {
        if self.online && !online {
            self.profile.set_goal(Goal::SwitchOnDisabled);
        }
        self.online = online;
        if target.mode() != self.target.mode() {
            self.begun = None;
        }
        self.target = target;
        self.profile.set_mode(target.mode().raw());
        self.profile.step(feedback, now)
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

    fn write(&self, outputs: &mut [u8], orders: &Orders) {
        let Places {
            control,
            mode,
            target_position,
            target_velocity,
            target_torque,
            ..
        } = self.places;
        // Low for two cycles first, so that there is an edge.
        let begins = self.begun.is_some_and(|cycles| cycles >= 2);
        let word = orders.control.raw() | if begins { HOMING_START } else { 0 };
        control.write(outputs, word.into());
        if let Some(bits) = mode {
            bits.write(outputs, u32::from(orders.mode.cast_unsigned()));
        }
        let position = match self.target {
            Target::Position(position) if orders.follows => position,
            Target::Position(_)
            | Target::Hold
            | Target::Velocity(_)
            | Target::Torque(_)
            | Target::Home => orders.hold,
        };
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
        let all = [
            (target_position, position.cast_unsigned()),
            (target_velocity, velocity.cast_unsigned()),
            (target_torque, u32::from(torque.cast_unsigned())),
        ];
        for (bits, value) in all {
            if let Some(bits) = bits {
                bits.write(outputs, value);
            }
        }
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
