//! Messages and signals by a DBC file: names, values with units, and their ranges over a measurement. The parser is the
//! `can-dbc` crate's; J1939 groups are not resolved.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::Context as _;
use can_dbc::{
    ByteOrder, Dbc, MessageId, MultiplexIndicator, SignalExtendedValueType, ValueDescription,
    ValueType,
};
use takt_can::{AnyFrame, Id};

/// Signals of a database whose ranges are kept; those beyond are decoded, without ranges.
const RANGES_MAX: usize = 4096;

/// How the raw bits of a signal are a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unsigned,
    Signed,
    Float,
    Double,
}

/// When a multiplexed signal is present.
#[derive(Clone, Debug, PartialEq)]
struct Selector {
    /// Name of the signal that selects it.
    by: String,
    /// Its raw values, from and to.
    values: Vec<(u64, u64)>,
}

/// A signal.
#[derive(Clone, Debug, PartialEq)]
struct Signal {
    name: String,
    start: u64,
    len: u64,
    big_endian: bool,
    kind: Kind,
    factor: f64,
    offset: f64,
    unit: String,
    selector: Option<Selector>,
    /// Names of raw values.
    names: Vec<(i64, String)>,
}

/// A message.
#[derive(Clone, Debug, PartialEq)]
struct Message {
    name: String,
    len: u64,
    signals: Vec<Signal>,
}

/// A value of a signal in a frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Value<'d> {
    pub(super) name: &'d str,
    /// In its unit.
    pub(super) value: f64,
    pub(super) unit: &'d str,
    /// The name of this value.
    pub(super) text: Option<&'d str>,
}

/// A frame by the database.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoded<'d> {
    pub(super) message: &'d str,
    pub(super) values: Vec<Value<'d>>,
    /// Length of the frame and of the message, if they differ.
    pub(super) wrong_len: Option<(usize, u64)>,
}

/// The messages of one or more DBC files.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Database {
    messages: BTreeMap<Id, Message>,
}

fn id_of(id: MessageId) -> Option<Id> {
    match id {
        MessageId::Standard(raw) => Id::standard(raw).ok(),
        MessageId::Extended(raw) => Id::extended(raw).ok(),
    }
}

impl Database {
    /// Reads files; a message of a later one replaces that of an earlier one.
    pub(super) fn open(paths: &[impl AsRef<Path>]) -> anyhow::Result<Self> {
        let mut database = Self::default();
        for path in paths {
            let path = path.as_ref();
            let bytes = takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
                .with_context(|| format!("cannot read {}", path.display()))?;
            let read = Self::parse(&bytes).with_context(|| path.display().to_string())?;
            database.messages.extend(read.messages);
        }
        Ok(database)
    }

    fn parse(bytes: &[u8]) -> anyhow::Result<Self> {
        // Editors write them in the code page of their country.
        let text = std::str::from_utf8(bytes).map_or_else(
            |_| bytes.iter().copied().map(char::from).collect(),
            str::to_owned,
        );
        let text = text.trim_start_matches('\u{feff}');
        let dbc =
            Dbc::try_from(text).map_err(|error| anyhow::anyhow!("it is no DBC file: {error}"))?;
        let mut database = Self::default();
        for message in &dbc.messages {
            // The pseudo-message of signals without a message has no identifier of CAN.
            let Some(id) = id_of(message.id) else {
                continue;
            };
            let signals = message.signals.iter();
            let signals = signals
                .map(|signal| of_signal(&dbc, message, signal))
                .collect();
            let message = Message {
                name: message.name.clone(),
                len: message.size,
                signals,
            };
            database.messages.insert(id, message);
        }
        anyhow::ensure!(
            !database.messages.is_empty(),
            "it describes no message (BO_)"
        );
        Ok(database)
    }

    /// The name of the message with that identifier.
    pub(super) fn message(&self, id: Id) -> Option<&str> {
        self.messages.get(&id).map(|message| message.name.as_str())
    }

    /// A frame, if the database has its message.
    pub(super) fn decode(&self, frame: &AnyFrame) -> Option<Decoded<'_>> {
        if matches!(frame, AnyFrame::Classic(frame) if frame.is_remote()) {
            return None;
        }
        let message = self.messages.get(&frame.id()?)?;
        let data = frame.data();
        let values = message.signals.iter().filter_map(|signal| {
            let is_present = message.is_present(signal, data, message.signals.len());
            let raw = signal.raw(data).filter(|_| is_present)?;
            Some(Value {
                name: &signal.name,
                value: signal.value(raw),
                unit: &signal.unit,
                text: signal.text(raw),
            })
        });
        let len = data.len();
        let is_same = u64::try_from(len).is_ok_and(|len| len == message.len);
        Some(Decoded {
            message: &message.name,
            values: values.collect(),
            wrong_len: (!is_same).then_some((len, message.len)),
        })
    }
}

/// A signal with all that other sections of the file say about it.
fn of_signal(dbc: &Dbc, message: &can_dbc::Message, signal: &can_dbc::Signal) -> Signal {
    let types = dbc.signal_extended_value_type_list.iter();
    let mut types = types.filter(|of| of.message_id == message.id && of.signal_name == signal.name);
    let kind = match types.next().map(|of| &of.signal_extended_value_type) {
        Some(SignalExtendedValueType::IEEEfloat32Bit) => Kind::Float,
        Some(SignalExtendedValueType::IEEEdouble64bit) => Kind::Double,
        Some(SignalExtendedValueType::SignedOrUnsignedInteger) | None => match signal.value_type {
            ValueType::Signed => Kind::Signed,
            ValueType::Unsigned => Kind::Unsigned,
        },
    };
    let names = dbc.value_descriptions.iter().filter_map(|of| match of {
        ValueDescription::Signal {
            message_id,
            name,
            value_descriptions,
        } if *message_id == message.id && *name == signal.name => Some(value_descriptions),
        ValueDescription::Signal { .. } | ValueDescription::EnvironmentVariable { .. } => None,
    });
    let names = names
        .flatten()
        .map(|name| (name.id, name.description.clone()))
        .collect();
    Signal {
        name: signal.name.clone(),
        start: signal.start_bit,
        len: signal.size,
        big_endian: signal.byte_order == ByteOrder::BigEndian,
        kind,
        factor: signal.factor,
        offset: signal.offset,
        unit: signal.unit.clone(),
        selector: selector(dbc, message, signal),
        names,
    }
}

/// What selects a multiplexed signal: its extended multiplexing if the file has it, else the one switch of the message.
fn selector(dbc: &Dbc, message: &can_dbc::Message, signal: &can_dbc::Signal) -> Option<Selector> {
    let extended = dbc.extended_multiplex.iter();
    let mut extended =
        extended.filter(|of| of.message_id == message.id && of.signal_name == signal.name);
    if let Some(of) = extended.next() {
        let values = of
            .mappings
            .iter()
            .map(|range| (range.min_value, range.max_value));
        return Some(Selector {
            by: of.multiplexor_signal_name.clone(),
            values: values.collect(),
        });
    }
    let value = match signal.multiplexer_indicator {
        MultiplexIndicator::MultiplexedSignal(value)
        | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value) => value,
        MultiplexIndicator::Multiplexor | MultiplexIndicator::Plain => return None,
    };
    let is_switch =
        |other: &&can_dbc::Signal| other.multiplexer_indicator == MultiplexIndicator::Multiplexor;
    let switch = message.signals.iter().find(is_switch)?;
    Some(Selector {
        by: switch.name.clone(),
        values: vec![(value, value)],
    })
}

impl Message {
    /// Whether a signal is in a frame: its switch, which may be multiplexed too, has its value. `depth` bounds a file
    /// whose switches select each other.
    fn is_present(&self, signal: &Signal, data: &[u8], depth: usize) -> bool {
        let Some(selector) = &signal.selector else {
            return true;
        };
        let switch = self.signals.iter().find(|other| other.name == selector.by);
        let Some((switch, depth)) = switch.zip(depth.checked_sub(1)) else {
            return false;
        };
        let raw = switch.raw(data);
        let ranges = selector.values.iter();
        let is_selected = raw.is_some_and(|raw| {
            ranges
                .clone()
                .any(|(low, high)| (*low..=*high).contains(&raw))
        });
        is_selected && self.is_present(switch, data, depth)
    }
}

impl Signal {
    /// Its bits; `None` if the frame is too short.
    fn raw(&self, data: &[u8]) -> Option<u64> {
        if !(1..=64).contains(&self.len) {
            return None;
        }
        let mut raw = 0;
        let mut at = self.start;
        for n in 0..self.len {
            let byte = data.get(usize::try_from(at / 8).ok()?)?;
            let bit = u64::from(byte >> (at % 8) & 1);
            if self.big_endian {
                // From its highest bit down; bit 0 of a byte is followed by bit 7 of the next.
                raw = raw << 1 | bit;
                at = if at.is_multiple_of(8) {
                    at.checked_add(15)?
                } else {
                    at - 1
                };
            } else {
                raw |= bit << n;
                at = at.checked_add(1)?;
            }
        }
        Some(raw)
    }

    /// As a signed number, if it is one.
    fn integer(&self, raw: u64) -> i64 {
        let unused = 64 - self.len.clamp(1, 64);
        match self.kind {
            Kind::Signed => (raw << unused).cast_signed() >> unused,
            Kind::Unsigned | Kind::Float | Kind::Double => raw.cast_signed(),
        }
    }

    fn value(&self, raw: u64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "shown with few digits")]
        let number = match self.kind {
            Kind::Unsigned => raw as f64,
            Kind::Signed => self.integer(raw) as f64,
            Kind::Float => {
                let [a, b, c, d, ..] = raw.to_le_bytes();
                f32::from_le_bytes([a, b, c, d]).into()
            }
            Kind::Double => f64::from_bits(raw),
        };
        number * self.factor + self.offset
    }

    fn text(&self, raw: u64) -> Option<&str> {
        let integer = self.integer(raw);
        let known = self.names.iter().find(|(value, _)| *value == integer);
        known.map(|(_, name)| name.as_str())
    }
}

/// A value with as many digits as it needs, at most six after the point.
fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "" | "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
}

/// `Name: Signal=value unit, ...`
pub(super) fn text(decoded: &Decoded<'_>) -> String {
    let mut text = format!("{}:", decoded.message);
    for (count, value) in decoded.values.iter().enumerate() {
        let separator = if count == 0 { " " } else { ", " };
        let Value { name, unit, .. } = value;
        let _ = write!(text, "{separator}{name}={}", number(value.value));
        if !unit.is_empty() {
            let _ = write!(text, " {unit}");
        }
        if let Some(name) = value.text {
            let _ = write!(text, " ({name})");
        }
    }
    if let Some((len, wanted)) = decoded.wrong_len {
        let _ = write!(text, " [{len} bytes, the DBC has {wanted}]");
    }
    text
}

pub(super) fn json(decoded: &Decoded<'_>) -> serde_json::Value {
    let signals = decoded.values.iter().map(|value| {
        let shown = serde_json::json!({
            "value": value.value, "unit": value.unit, "text": value.text,
        });
        (value.name.to_owned(), shown)
    });
    serde_json::json!({
        "message": decoded.message,
        "signals": signals.collect::<serde_json::Map<_, _>>(),
        "short": decoded.wrong_len.is_some(),
    })
}

/// The values of a signal over a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    pub(super) frames: u64,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) last: f64,
}

/// The ranges of all signals, by identifier and name.
#[derive(Clone, Debug, Default)]
pub(super) struct Ranges<'d>(BTreeMap<(Id, &'d str), (Range, &'d str)>);

impl<'d> Ranges<'d> {
    pub(super) fn handle(&mut self, database: &'d Database, frame: &AnyFrame) {
        let Some((id, decoded)) = frame.id().zip(database.decode(frame)) else {
            return;
        };
        for Value {
            name, value, unit, ..
        } in decoded.values
        {
            let may_add = self.0.len() < RANGES_MAX;
            match self.0.get_mut(&(id, name)) {
                Some((range, _)) => {
                    range.frames += 1;
                    (range.low, range.high) = (range.low.min(value), range.high.max(value));
                    range.last = value;
                }
                None if may_add => {
                    let range = Range {
                        frames: 1,
                        low: value,
                        high: value,
                        last: value,
                    };
                    self.0.insert((id, name), (range, unit));
                }
                None => {}
            }
        }
    }

    /// As a table; empty without signals.
    pub(super) fn table(&self, database: &Database) -> String {
        let mut text = String::new();
        if self.0.is_empty() {
            return text;
        }
        text.push_str(
            "\n      id  message.signal                      min          max         last  unit\n",
        );
        for ((id, name), (range, unit)) in &self.0 {
            let message = database.message(*id).unwrap_or_default();
            let line = format!(
                "{:>8}  {:<28} {:>11} {:>12} {:>12}  {unit}",
                id.to_string(),
                format!("{message}.{name}"),
                number(range.low),
                number(range.high),
                number(range.last),
            );
            let _ = writeln!(text, "{}", line.trim_end());
        }
        text
    }

    pub(super) fn json(&self, database: &Database) -> serde_json::Value {
        let all = self.0.iter().map(|((id, name), (range, unit))| {
            serde_json::json!({
                "id": id.raw(), "extended": id.is_extended(), "message": database.message(*id),
                "signal": name, "unit": unit, "frames": range.frames, "min": range.low,
                "max": range.high, "last": range.last,
            })
        });
        all.collect()
    }
}

#[cfg(test)]
mod tests;
