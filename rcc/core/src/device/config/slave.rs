//! What a cell's file tells of the slaves of an EtherCAT segment, of their clocks, and of the inputs and outputs that
//! nets find on them. What a master makes of it is in `device::ethercat`.

use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_ethercat::config::Patience;

use super::OutputsOnEnd;
use crate::span;

/// How the clocks of a segment are brought together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatClocks {
    /// Largest difference to the reference clock (092Ch) at which a clock counts as locked, up to 1 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub window: Duration,
    /// How long a clock may take to lock before its slave is given up for the moment.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub lock: Duration,
    /// What becomes of a slave whose clock does not lock in time.
    pub unlocked: UnlockedPolicy,
    /// What becomes of an arm when a clock of its drives leaves the window while it runs.
    pub lost: LostPolicy,
}

impl Default for EthercatClocks {
    fn default() -> Self {
        Self {
            window: Duration::from_micros(1),
            lock: Duration::from_secs(5),
            unlocked: UnlockedPolicy::Refuse,
            lost: LostPolicy::Ignore,
        }
    }
}

/// What becomes of a slave whose clock does not lock in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnlockedPolicy {
    /// It stays in PRE-OP and is tried again; that is told.
    #[default]
    Refuse,
    /// It is started all the same; its difference is told.
    Start,
}

/// What becomes of an arm when a clock of its drives was outside of the window three times in a row. In each case that is
/// told, and so is the clock's return.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LostPolicy {
    /// It goes on: drives see for themselves how SYNC0 and their set-points lie, and leave OP when they cannot go on.
    #[default]
    Ignore,
    /// Its joints brake within their limits and are held there, its nets end; nothing moves it until the clock is back.
    Hold,
    /// The same, and as soon as its motors stand they lose their power until the clock is back.
    Stop,
}

/// How far a slave is brought.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum SlaveGoal {
    /// PRE-OP: its mailbox works, it exchanges no process data.
    #[serde(rename = "PRE-OP")]
    PreOp,
    /// SAFE-OP: its inputs are read, its outputs stay safe.
    #[serde(rename = "SAFE-OP")]
    SafeOp,
    /// OP.
    #[default]
    #[serde(rename = "OP")]
    Op,
}

/// A slave that is expected: by one of `position`, `alias` and `sii_name`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatSlave {
    /// Its name.
    pub name: String,
    /// Where it is in the ring, from 0, counted among the slaves that are not optional.
    pub position: Option<u16>,
    /// Its station alias, instead of a position.
    pub alias: Option<u16>,
    /// Its name or order code as its SII has it, instead of a position; of several alike the first that is not taken.
    pub sii_name: Option<String>,
    /// Vendor (1018h:01); `None` for any.
    pub vendor: Option<u32>,
    /// Product code (1018h:02); `None` for any.
    pub product: Option<u32>,
    /// Revision (1018h:03); `None` for any.
    pub revision: Option<u32>,
    /// Whether it may be missing at start, and come and go (hot connect); not by position.
    pub optional: bool,
    /// Slaves of one group, 0 to 7, share a datagram and its working counter: what fails in one group does not spoil
    /// the inputs of another.
    pub group: u8,
    /// How far it is brought.
    pub goal: SlaveGoal,
    /// CiA 402 axes in it, 0 to 8; with any, process data are set up for them unless `outputs` or `inputs` say which.
    pub axes: u8,
    /// PDOs that it is to receive; `None` leaves what it has assigned, or what its axes need.
    pub outputs: Option<Vec<SlavePdo>>,
    /// PDOs that it is to send; `None` leaves what it has assigned, or what its axes need.
    pub inputs: Option<Vec<SlavePdo>>,
    /// Objects written in PRE-OP, in order, before PDOs are assigned and before what its axes need.
    pub startup: Vec<StartupObject>,
    /// Whether it is run by SYNC0 each cycle.
    pub sync0: bool,
    /// How long after SYNC0 comes SYNC1; `None` for no SYNC1. Needs `sync0`.
    #[serde(deserialize_with = "span::text::deserialize_some")]
    pub sync1: Option<Duration>,
    /// SYNC0 behind the beginning of the cycle, ns, less than a cycle; negative is before.
    #[serde(deserialize_with = "shift")]
    pub shift: i32,
    /// Process data watchdog, in steps of 100 us, rounded up; zero switches it off, `None` leaves what the slave has.
    #[serde(deserialize_with = "span::text::deserialize_some")]
    pub watchdog: Option<Duration>,
    /// Whether objects may be written by complete access, where its SII says that it has it.
    pub complete_access: bool,
    /// How long it may take where that is longer than usual.
    pub timeouts: SlaveTimeouts,
}

/// How long a slave may take before it counts as failed, 1 ms to 10 min each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlaveTimeouts {
    /// From a request of INIT or PRE-OP to the state; 3 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub pre_op: Duration,
    /// From a request of SAFE-OP or OP to the state; 10 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub op: Duration,
    /// For an answer in its mailbox, all attempts together; 4 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub mailbox: Duration,
    /// For its EEPROM; 500 ms.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub sii: Duration,
}

impl Default for SlaveTimeouts {
    fn default() -> Self {
        let Patience {
            pre_op,
            op,
            mailbox,
            sii,
            ..
        } = Patience::default();
        Self {
            pre_op,
            op,
            mailbox,
            sii,
        }
    }
}

impl SlaveTimeouts {
    /// The key of the first that is out of range.
    pub(crate) fn out_of_range(&self) -> Option<&'static str> {
        let range = Duration::from_millis(1)..=Duration::from_mins(10);
        let Self {
            pre_op,
            op,
            mailbox,
            sii,
        } = self;
        let all = [
            ("pre_op", pre_op),
            ("op", op),
            ("mailbox", mailbox),
            ("sii", sii),
        ];
        let found = all.into_iter().find(|(_, time)| !range.contains(time));
        found.map(|(key, _)| key)
    }

    /// As a master takes them.
    pub(crate) fn patience(self) -> Patience {
        let Self {
            pre_op,
            op,
            mailbox,
            sii,
        } = self;
        Patience {
            pre_op,
            op,
            mailbox,
            sii,
            ..Patience::default()
        }
    }
}

impl Default for EthercatSlave {
    /// One without a name or a place, to be brought to OP as it is.
    fn default() -> Self {
        Self {
            name: String::new(),
            position: None,
            alias: None,
            sii_name: None,
            vendor: None,
            product: None,
            revision: None,
            optional: false,
            group: 0,
            goal: SlaveGoal::Op,
            axes: 0,
            outputs: None,
            inputs: None,
            startup: Vec::new(),
            sync0: false,
            sync1: None,
            shift: 0,
            watchdog: None,
            complete_access: true,
            timeouts: SlaveTimeouts::default(),
        }
    }
}

/// A duration that may have a sign, as ns.
fn shift<'de, D: Deserializer<'de>>(input: D) -> Result<i32, D::Error> {
    use serde::de::Error as _;

    let text = String::deserialize(input)?;
    let trimmed = text.trim();
    let (sign, rest) = trimmed
        .strip_prefix('-')
        .map_or((1, trimmed), |rest| (-1, rest));
    let time = span::parse(rest).map_err(D::Error::custom)?;
    let ns = i32::try_from(time.as_nanos());
    let ns = ns.map_err(|_| D::Error::custom(format!("a shift of {text} is more than 2.1 s")))?;
    Ok(sign * ns)
}

/// A PDO by its objects.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlavePdo {
    /// 1600h or 1A00h and following.
    pub pdo: u16,
    /// What it carries: index, sub-index and bits of each; index 0 is a gap. Empty leaves its mapping as it is.
    #[serde(default)]
    pub entries: Vec<(u16, u8, u8)>,
}

/// An object to write at start.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartupObject {
    /// Its index.
    pub index: u16,
    /// Its sub-index.
    #[serde(default)]
    pub sub: u8,
    /// What is written.
    pub value: StartupValue,
    /// Whether all entries from the sub-index on are written at once, by complete access.
    #[serde(default)]
    pub complete: bool,
    /// Whether to go on if the slave refuses it.
    #[serde(default)]
    pub may_fail: bool,
}

/// A value of an object, with the type that says how many bytes it has.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names are the types")]
pub enum StartupValue {
    Bool(bool),
    U8(u8),
    U16(u16),
    U32(u32),
    U64(u64),
    I8(i8),
    I16(i16),
    I32(i32),
    I64(i64),
    F32(f32),
    F64(f64),
    Text(String),
    Bytes(Vec<u8>),
}

impl StartupValue {
    /// Its bytes, little-endian.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        match self {
            Self::Bool(value) => vec![u8::from(*value)],
            Self::U8(value) => vec![*value],
            Self::U16(value) => value.to_le_bytes().to_vec(),
            Self::U32(value) => value.to_le_bytes().to_vec(),
            Self::U64(value) => value.to_le_bytes().to_vec(),
            Self::I8(value) => value.to_le_bytes().to_vec(),
            Self::I16(value) => value.to_le_bytes().to_vec(),
            Self::I32(value) => value.to_le_bytes().to_vec(),
            Self::I64(value) => value.to_le_bytes().to_vec(),
            Self::F32(value) => value.to_le_bytes().to_vec(),
            Self::F64(value) => value.to_le_bytes().to_vec(),
            Self::Text(value) => value.as_bytes().to_vec(),
            Self::Bytes(value) => value.clone(),
        }
    }
}

/// Inputs and outputs: of digital ones all bits of the process data of these slaves, in their order.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatIo {
    /// Name by which nets find it.
    pub name: String,
    /// Slave and number of bits that are digital inputs.
    pub digital_in: Vec<(String, usize)>,
    /// Slave and number of bits that are digital outputs.
    pub digital_out: Vec<(String, usize)>,
    /// Analogue inputs.
    pub analogue_in: Vec<AnalogueChannel>,
    /// Analogue outputs.
    pub analogue_out: Vec<AnalogueChannel>,
    /// What becomes of outputs when the net that wrote them ends: of bits and of channels, in their order.
    pub on_end: OutputsOnEnd,
}

/// An analogue channel: a number in the process data of a slave, found by its object or by where it lies. Nets see
/// `scale` times that number plus `offset`, and outputs beyond what the number holds are cut to it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnalogueChannel {
    /// The slave.
    pub slave: String,
    /// Index and sub-index of the object that is mapped.
    #[serde(default)]
    pub object: Option<(u16, u8)>,
    /// Instead of an object, its first bit among the slave's inputs or outputs.
    #[serde(default)]
    pub bit: Option<usize>,
    /// How many bits it has where no object says so, 1 to 32.
    #[serde(default = "AnalogueChannel::default_bits")]
    pub bits: u8,
    /// Whether its highest bit is a sign.
    #[serde(default = "AnalogueChannel::default_signed")]
    pub signed: bool,
    /// What one increment means, in the unit that nets use.
    #[serde(default = "AnalogueChannel::default_scale")]
    pub scale: f64,
    /// What zero means, in that unit.
    #[serde(default)]
    pub offset: f64,
}

impl AnalogueChannel {
    const fn default_bits() -> u8 {
        16
    }

    const fn default_signed() -> bool {
        true
    }

    const fn default_scale() -> f64 {
        1.0
    }
}
