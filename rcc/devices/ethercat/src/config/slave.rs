//! Cell file configuration of the slaves of an EtherCAT segment, of their clocks, and of their inputs and outputs.
//! The driver is in `segment`.

use std::time::Duration;

use serde::{Deserialize, Deserializer};
use takt_ethercat::config::Timeouts;

use takt_core::device::on_end::OutputsOnEnd;
use takt_core::span;

/// Clock synchronization of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatClocks {
    /// Largest difference to the reference clock (092Ch) at which a clock counts as locked, up to 1 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub window: Duration,
    /// Time for a clock to lock before its slave is given up temporarily.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub lock: Duration,
    /// Reaction to a slave whose clock does not lock in time.
    pub unlocked: UnlockedPolicy,
    /// Reaction of an arm to a clock that leaves the window at run time.
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

/// Reaction to a slave whose clock does not lock in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnlockedPolicy {
    /// The slave stays in PRE-OP and is retried; this is reported.
    #[default]
    Refuse,
    /// The slave is started anyway; the difference is reported.
    Start,
}

/// Reaction of an arm to a drive clock outside of the window in three consecutive checks. The event and the recovery
/// are reported in each case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LostPolicy {
    /// Continue: drives monitor the phase of SYNC0 and set-points themselves, and leave OP if necessary.
    #[default]
    Ignore,
    /// Hold: joints brake within their limits and hold, nets end, and commands are ignored until the clock recovers.
    Hold,
    /// Hold, then remove power at standstill until the clock recovers.
    Stop,
}

/// Target state of a slave.
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

/// An expected slave, identified by one of `position`, `alias` and `sii_name`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatSlave {
    /// Its name.
    pub name: String,
    /// Position in the ring, from 0, counted among the slaves that are not optional.
    pub position: Option<u16>,
    /// Station alias, instead of a position.
    pub alias: Option<u16>,
    /// Name or order code in its SII, instead of a position; of several equal ones the first free one.
    pub sii_name: Option<String>,
    /// Vendor (1018h:01); `None` for any.
    pub vendor: Option<u32>,
    /// Product code (1018h:02); `None` for any.
    pub product: Option<u32>,
    /// Revision (1018h:03); `None` for any.
    pub revision: Option<u32>,
    /// Whether it may be missing at start, and come and go (hot connect); not with `position`.
    pub optional: bool,
    /// Group, 0 to 7: slaves of one group share a datagram and its working counter, so that a failure in one group
    /// does not invalidate the inputs of another.
    pub group: u8,
    /// Target state.
    pub goal: SlaveGoal,
    /// Number of CiA 402 axes, 0 to 8; their process data are mapped unless `outputs` or `inputs` are given.
    pub axes: u8,
    /// Receive PDOs; `None` keeps the assignment of the slave, or that of its axes.
    pub outputs: Option<Vec<SlavePdo>>,
    /// Transmit PDOs; `None` keeps the assignment of the slave, or that of its axes.
    pub inputs: Option<Vec<SlavePdo>>,
    /// Objects written in PRE-OP, in order, before PDO assignment and the objects of its axes.
    pub startup: Vec<StartupObject>,
    /// Whether SYNC0 is enabled.
    pub sync0: bool,
    /// Time from SYNC0 to SYNC1; `None` for no SYNC1. Needs `sync0`.
    #[serde(deserialize_with = "span::text::deserialize_some")]
    pub sync1: Option<Duration>,
    /// Time from the cycle start to SYNC0, ns, less than a cycle; may be negative.
    #[serde(deserialize_with = "shift")]
    pub shift: i32,
    /// Process data watchdog, in steps of 100 us, rounded up; zero disables it, `None` keeps the setting of the
    /// slave.
    #[serde(deserialize_with = "span::text::deserialize_some")]
    pub watchdog: Option<Duration>,
    /// Whether complete access may be used, if its SII supports it.
    pub complete_access: bool,
    /// Timeouts, if longer than usual.
    pub timeouts: SlaveTimeouts,
}

/// Timeouts of a slave, 1 ms to 10 min each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlaveTimeouts {
    /// From a request of INIT or PRE-OP to the state; 3 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub pre_op: Duration,
    /// From a request of SAFE-OP or OP to the state; 10 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub op: Duration,
    /// For a mailbox answer, all attempts together; 4 s.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub mailbox: Duration,
    /// For EEPROM access; 500 ms.
    #[serde(deserialize_with = "span::text::deserialize")]
    pub sii: Duration,
}

impl Default for SlaveTimeouts {
    fn default() -> Self {
        let Timeouts {
            pre_op,
            op,
            mailbox,
            sii,
            ..
        } = Timeouts::default();
        Self {
            pre_op,
            op,
            mailbox,
            sii,
        }
    }
}

impl SlaveTimeouts {
    /// The key of the first timeout that is out of range.
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

    /// Converts them for the master.
    pub(crate) fn for_master(self) -> Timeouts {
        let Self {
            pre_op,
            op,
            mailbox,
            sii,
        } = self;
        Timeouts {
            pre_op,
            op,
            mailbox,
            sii,
            ..Timeouts::default()
        }
    }
}

impl Default for EthercatSlave {
    /// A slave without name and position, to be brought to OP unchanged.
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

/// A signed duration in ns.
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

/// A PDO.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlavePdo {
    /// 1600h or 1A00h and following.
    pub pdo: u16,
    /// Mapping: index, sub-index and bits of each object; index 0 is a gap. Empty keeps the mapping.
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
    /// The value.
    pub value: StartupValue,
    /// Whether all entries from the sub-index on are written by complete access.
    #[serde(default)]
    pub complete: bool,
    /// Whether to continue if the slave aborts the download.
    #[serde(default)]
    pub may_fail: bool,
}

/// A value of an object, with the type that determines its size.
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

/// Inputs and outputs: digital ones are all bits of the process data of these slaves, in order.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EthercatIo {
    /// Name by which nets find it.
    pub name: String,
    /// Slave and number of bits of digital inputs.
    pub digital_in: Vec<(String, usize)>,
    /// Slave and number of bits of digital outputs.
    pub digital_out: Vec<(String, usize)>,
    /// Analogue inputs.
    pub analogue_in: Vec<AnalogueChannel>,
    /// Analogue outputs.
    pub analogue_out: Vec<AnalogueChannel>,
    /// Output policies at the end of a net: of bits and of channels, in order.
    pub on_end: OutputsOnEnd,
}

/// An analogue channel: a number in the process data of a slave, located by its object or by its bit offset. Nets see
/// `scale` times that number plus `offset`; outputs beyond the range of the number are clamped.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnalogueChannel {
    /// The slave.
    pub slave: String,
    /// Index and sub-index of the mapped object.
    #[serde(default)]
    pub object: Option<(u16, u8)>,
    /// Offset of its first bit in the slave's inputs or outputs, instead of an object.
    #[serde(default)]
    pub bit: Option<usize>,
    /// Number of bits if no object determines it, 1 to 32.
    #[serde(default = "AnalogueChannel::default_bits")]
    pub bits: u8,
    /// Whether it is signed.
    #[serde(default = "AnalogueChannel::default_signed")]
    pub signed: bool,
    /// Value of one increment, in the unit that nets use.
    #[serde(default = "AnalogueChannel::default_scale")]
    pub scale: f64,
    /// Value of zero, in that unit.
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
