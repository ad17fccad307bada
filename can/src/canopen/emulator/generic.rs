//! A device of any kind from its data sheet: its objects, services and PDOs, and process data that move by signal
//! generators. It knows no profile; what is written to it has no effect.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Address, DataType, Dictionary, Entry, Mapped};

use super::super::eds::{Eds, EdsError};
use super::super::node::{Application, Context, Node, NodeError, NodeQuirks};
use super::super::pdo::{Direction, PDOS_MAX, Parameters};
use super::super::{NodeId, node::NodeConfig};

/// Range of a signal without limits of its object, of either sign.
const RANGE: f64 = 1000.0;
/// Shortest time between two values.
const UPDATE_MIN: Duration = Duration::from_millis(1);

/// Shape of a signal over its period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wave {
    /// From the middle of its range.
    Sine,
    /// From the low end to the high one, then again from the low one.
    Ramp,
    /// Up and down.
    Triangle,
    /// The low end for half of the period, then the high one.
    Square,
    /// The low end, for ever.
    Constant,
    /// Anywhere in its range, another value at each update.
    Noise,
}

impl Wave {
    const NAMES: [(&'static str, Self); 6] = [
        ("sine", Self::Sine),
        ("ramp", Self::Ramp),
        ("triangle", Self::Triangle),
        ("square", Self::Square),
        ("constant", Self::Constant),
        ("noise", Self::Noise),
    ];

    /// Its value between 0 and 1 at a phase between 0 and 1.
    fn at(self, phase: f64, dice: &mut u64) -> f64 {
        match self {
            Self::Sine => 0.5 + 0.5 * (phase * std::f64::consts::TAU).sin(),
            Self::Ramp => phase,
            Self::Triangle => 1.0 - (2.0 * phase - 1.0).abs(),
            Self::Square => f64::from(u8::from(phase >= 0.5)),
            Self::Constant => 0.0,
            Self::Noise => {
                *dice ^= *dice << 13;
                *dice ^= *dice >> 7;
                *dice ^= *dice << 17;
                let [a, b, ..] = dice.to_le_bytes();
                f64::from(u16::from_le_bytes([a, b])) / f64::from(u16::MAX)
            }
        }
    }
}

impl FromStr for Wave {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::NAMES.iter().find(|(name, _)| *name == text);
        known.map(|(_, wave)| *wave).ok_or_else(|| {
            let all = Self::NAMES.map(|(name, _)| name).join(", ");
            format!("`{text}` is no signal; those are {all}")
        })
    }
}

impl fmt::Display for Wave {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::NAMES.iter().find(|(_, wave)| wave == self);
        f.write_str(name.map_or("", |(name, _)| name))
    }
}

/// A signal generator of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// The object.
    pub address: Address,
    /// Its shape.
    pub wave: Wave,
    /// Low and high end in the unit of the object; `None` for the limits of the object.
    pub range: Option<(f64, f64)>,
    /// Its period.
    pub period: Duration,
}

/// A signal and the type of its object.
#[derive(Clone, Copy, Debug)]
struct Generator {
    signal: Signal,
    data_type: DataType,
    range: (f64, f64),
}

/// The signal generators of a device.
#[derive(Debug)]
pub struct Generators {
    all: Vec<Generator>,
    update: Duration,
    begun: Duration,
    next: Duration,
    dice: u64,
}

impl Application for Generators {
    fn poll(&mut self, context: &mut Context<'_>) {
        if context.now < self.next {
            return;
        }
        self.next = context.now + self.update;
        let passed = context.now.saturating_sub(self.begun).as_secs_f64();
        for Generator {
            signal,
            data_type,
            range: (low, high),
        } in &self.all
        {
            let phase = passed / signal.period.as_secs_f64().max(1e-3);
            let share = signal.wave.at(phase.fract(), &mut self.dice);
            let value = low + (high - low) * share;
            // A value of another type, or outside the limits of the object, was rejected at the start.
            if let Ok(bytes) = encode(*data_type, value) {
                let _ = context.dictionary.store(signal.address, &bytes);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Duration> {
        (!self.all.is_empty()).then_some(self.next)
    }
}

/// A number as an object of that type has it.
fn encode(data_type: DataType, value: f64) -> Result<Vec<u8>, AbortCode> {
    let is_integer = data_type == DataType::Boolean || data_type.integer(&[0]).is_some();
    let text = if is_integer {
        format!("{:.0}", value.round() + 0.0)
    } else if matches!(data_type, DataType::Real32 | DataType::Real64) {
        value.to_string()
    } else {
        return Err(AbortCode::Value);
    };
    data_type.read(&text).map_err(|_| AbortCode::Value)
}

/// Why a device cannot be made from a data sheet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GenericError {
    /// The data sheet.
    #[error(transparent)]
    Eds(#[from] EdsError),
    /// Its objects do not make a node.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The object of a signal does not exist.
    #[error("{0} is not in the data sheet, so no signal can move it")]
    Absent(Address),
    /// The object of a signal is no number, or the range does not fit it.
    #[error("{address} is {data_type}: a signal from {low} to {high} does not fit it")]
    Unfit {
        /// The object.
        address: Address,
        /// Its type.
        data_type: DataType,
        /// Low end of the signal, as text.
        low: String,
        /// High end, likewise.
        high: String,
    },
}

/// Configuration of a device made from a data sheet.
#[derive(Clone, Debug)]
pub struct GenericConfig {
    /// Node number.
    pub id: NodeId,
    /// Its signals; those of the same object as an earlier one replace that.
    pub signals: Vec<Signal>,
    /// Time between two values of all signals, at least 1 ms.
    pub update: Duration,
    /// 1017h instead of that of the data sheet, ms.
    pub heartbeat_ms: Option<u16>,
    /// Timeout of the SDO server.
    pub sdo_timeout: Duration,
    /// Deviations from the standard.
    pub quirks: NodeQuirks,
}

/// A device made from a data sheet.
pub type GenericNode = Node<Generators>;

impl GenericNode {
    /// Powers a device on. The values of a DCF are its defaults.
    ///
    /// # Errors
    /// If the data sheet does not describe a node, or a signal does not fit its object.
    pub fn of_sheet(eds: &Eds, config: GenericConfig, now: Duration) -> Result<Self, GenericError> {
        let mut eds = configured(eds);
        if let Some(ms) = config.heartbeat_ms {
            set_default(&mut eds, Address::new(0x1017, 0), &ms.to_le_bytes());
        }
        let dictionary = eds.dictionary(config.id)?;
        let mut all: Vec<Generator> = Vec::new();
        for signal in config.signals {
            let generator = generator(&dictionary, signal)?;
            all.retain(|known| known.signal.address != signal.address);
            all.push(generator);
        }
        let node = NodeConfig {
            sdo_timeout: config.sdo_timeout,
            quirks: config.quirks,
            ..eds.node_config(Some(config.id))?
        };
        let generators = Generators {
            all,
            update: config.update.max(UPDATE_MIN),
            begun: now,
            next: now,
            dice: 0x5eed_0000 + u64::from(config.id.raw()),
        };
        Ok(Self::new(node, generators, now)?)
    }
}

/// The data sheet with the values of the DCF as defaults.
fn configured(eds: &Eds) -> Eds {
    let mut configured = eds.clone();
    for (address, value) in &eds.values {
        set_default(&mut configured, *address, value);
    }
    configured
}

fn set_default(eds: &mut Eds, address: Address, value: &[u8]) {
    let object = eds.objects.iter_mut().find(|o| o.index == address.index);
    let entry = object.and_then(|object| {
        let mut entries = object.entries.iter_mut();
        entries.find(|(sub, _)| *sub == address.sub)
    });
    let Some((_, entry)) = entry else {
        return;
    };
    if entry
        .data_type
        .size()
        .is_none_or(|size| size == value.len())
    {
        entry.default = value.to_vec();
        entry.max_len = entry.max_len.max(value.len());
        // The value of a DCF includes the node number.
        eds.relative.retain(|relative| *relative != address);
    }
}

fn generator(dictionary: &Dictionary, signal: Signal) -> Result<Generator, GenericError> {
    let address = signal.address;
    let entry = dictionary.entry(address);
    let entry = entry.ok_or(GenericError::Absent(address))?;
    let range = signal.range.unwrap_or_else(|| range(entry));
    let data_type = entry.data_type;
    #[expect(
        clippy::cast_precision_loss,
        reason = "limits of a signal, to its precision"
    )]
    let fits = |value: f64| {
        let is_above = entry.low.is_none_or(|low| value >= low as f64);
        let is_below = entry.high.is_none_or(|high| value <= high as f64);
        is_above && is_below && encode(data_type, value).is_ok()
    };
    if !(fits(range.0) && fits(range.1)) {
        let (low, high) = (range.0.to_string(), range.1.to_string());
        return Err(GenericError::Unfit {
            address,
            data_type,
            low,
            high,
        });
    }
    Ok(Generator {
        signal,
        data_type,
        range,
    })
}

/// The limits of an entry; without limits, at most [`RANGE`].
fn range(entry: &Entry) -> (f64, f64) {
    let (low, high) = match (entry.data_type, entry.data_type.size()) {
        (DataType::Boolean, _) => (0.0, 1.0),
        (DataType::Integer8, _) => (-100.0, 100.0),
        (DataType::Unsigned8, _) => (0.0, 200.0),
        (DataType::Real32 | DataType::Real64, _) => (-1.0, 1.0),
        (kind, Some(size)) if kind.integer(&vec![0xFF; size]) == Some(-1) => (-RANGE, RANGE),
        _ => (0.0, RANGE),
    };
    #[expect(clippy::cast_precision_loss, reason = "the ends of a signal")]
    let limit = |limit: Option<i128>, without: f64| limit.map_or(without, |limit| limit as f64);
    let (low, high) = (limit(entry.low, low), limit(entry.high, high));
    (low.max(-1e9), high.min(1e9))
}

/// A sine of each numeric object that the enabled TPDOs of a data sheet carry, but for communication objects and the
/// statuswords of drives, which signals would make absurd.
///
/// # Errors
/// If the data sheet does not describe a dictionary.
pub fn signals(eds: &Eds, id: NodeId, period: Duration) -> Result<Vec<Signal>, EdsError> {
    let dictionary = configured(eds).dictionary(id)?;
    let tpdos = (0..PDOS_MAX).filter_map(|number| {
        let tpdo = Parameters::read(&dictionary, Direction::Transmit, number)?;
        tpdo.cob.id().is_some().then_some(tpdo.mapping)
    });
    let is_process = |mapped: &Mapped| {
        let standard = 0x6000 + mapped.address.index % Address::AXIS;
        let of_drive = (0x6000..0xA000).contains(&mapped.address.index);
        let is_word = of_drive && matches!(standard, 0x6041 | 0x6061 | 0x603F);
        mapped.address.index >= 0x2000 && !mapped.is_gap() && !is_word
    };
    let mut signals: Vec<Signal> = Vec::new();
    for mapped in tpdos.flatten().filter(is_process) {
        let signal = Signal {
            address: mapped.address,
            wave: Wave::Sine,
            range: None,
            period,
        };
        let is_new = signals.iter().all(|known| known.address != mapped.address);
        if is_new && generator(&dictionary, signal).is_ok() {
            signals.push(signal);
        }
    }
    Ok(signals)
}

#[cfg(test)]
mod tests;
