//! The numbers of a recording by the names of probes, for tables and plots: decoded by the definitions in the file, so any MCAP
//! file with messages of ROS 2 (`ros2msg`, CDR) has them. Frames, texts and what only a replay needs are left out.

use std::collections::HashMap;
use std::path::Path;

use mcap::records::Record;

use crate::error::Error;
use crate::record::inspect::open;
use crate::record::read::records;

/// Maximum depth of messages in messages.
const DEPTH_MAX: usize = 8;
/// Maximum number of numbers of a message.
const NUMBERS_MAX: usize = 4096;
/// Maximum number of values of a message, texts and messages in it included: arrays of messages without a value take no
/// bytes, so that the length of the message does not bound them.
const VALUES_MAX: usize = 65_536;
/// Types that are left out: frames name their child in the message, and words and texts are no numbers.
const LEFT_OUT: [&str; 5] = [
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "rcl_interfaces/msg/Log",
    "takt_msgs/msg/Words",
    "std_msgs/msg/String",
];

/// How many elements a field has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Count {
    One,
    Fixed(usize),
    Any,
}

/// A field of a message.
#[derive(Clone, Debug)]
struct Field {
    name: String,
    kind: String,
    count: Count,
    /// The name of its probe within its device, of figures: the comment begins with it.
    of_probe: Option<String>,
}

/// The messages of a definition; the outermost has the empty name.
type Definition = HashMap<String, Vec<Field>>;

/// Reads a definition in the form of ROS 2.
fn definition(text: &str) -> Definition {
    let mut messages = Definition::new();
    let mut name = String::new();
    for line in text.lines() {
        let (line, comment) = line.split_once('#').unwrap_or((line, ""));
        let (line, comment) = (line.trim(), comment.split(',').next());
        if let Some(next) = line.strip_prefix("MSG: ") {
            next.trim().clone_into(&mut name);
        }
        let mut words = line.split_whitespace();
        let (Some(kind), Some(field)) = (words.next(), words.next()) else {
            continue;
        };
        // Constants are no part of a message.
        if kind == "MSG:" || kind.starts_with('=') || line.contains('=') {
            continue;
        }
        let (kind, count) = match kind.split_once('[') {
            None => (kind, Count::One),
            Some((kind, count)) => match count.trim_end_matches(']').parse() {
                Ok(count) => (kind, Count::Fixed(count)),
                Err(_) => (kind, Count::Any),
            },
        };
        messages.entry(name.clone()).or_default().push(Field {
            name: field.to_owned(),
            kind: kind.to_owned(),
            count,
            of_probe: comment.map(|name| name.trim().to_owned()),
        });
    }
    messages
}

/// Numbers of a message with their paths; `None` in the middle of a message that is cut off or of an unknown type.
struct Decoder<'a> {
    definition: &'a Definition,
    data: &'a [u8],
    /// Bytes of the body that were read.
    at: usize,
    /// Values that were begun.
    values: usize,
    found: Vec<(String, f64)>,
}

impl Decoder<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let begin = self.at.checked_next_multiple_of(N)?;
        let bytes = self.data.get(begin..begin.checked_add(N)?)?;
        self.at = begin + N;
        bytes.try_into().ok()
    }

    fn skip(&mut self, bytes: usize) -> Option<()> {
        let end = self.at.checked_add(bytes)?;
        self.data.get(self.at..end)?;
        self.at = end;
        Some(())
    }

    fn count(&mut self) -> Option<usize> {
        usize::try_from(u32::from_le_bytes(self.take()?)).ok()
    }

    #[expect(clippy::cast_precision_loss, reason = "numbers to look at")]
    fn number(&mut self, kind: &str) -> Option<f64> {
        Some(match kind {
            "bool" | "byte" | "uint8" | "char" => f64::from(u8::from_le_bytes(self.take()?)),
            "int8" => f64::from(i8::from_le_bytes(self.take()?)),
            "uint16" => f64::from(u16::from_le_bytes(self.take()?)),
            "int16" => f64::from(i16::from_le_bytes(self.take()?)),
            "uint32" => f64::from(u32::from_le_bytes(self.take()?)),
            "int32" => f64::from(i32::from_le_bytes(self.take()?)),
            "uint64" => u64::from_le_bytes(self.take()?) as f64,
            "int64" => i64::from_le_bytes(self.take()?) as f64,
            "float32" => f64::from(f32::from_le_bytes(self.take()?)),
            "float64" => f64::from_le_bytes(self.take()?),
            _ => return None,
        })
    }

    fn message(&mut self, name: &str, path: &str, depth: usize) -> Option<()> {
        let definition = self.definition;
        let fields = definition.get(name).filter(|_| depth < DEPTH_MAX)?;
        for field in fields {
            let inner = if path.is_empty() {
                field.name.clone()
            } else {
                format!("{path}.{}", field.name)
            };
            let count = match field.count {
                Count::One => {
                    self.value(&field.kind, &inner, depth)?;
                    continue;
                }
                Count::Fixed(count) => count,
                Count::Any => self.count()?,
            };
            for number in 0..count {
                self.value(&field.kind, &format!("{inner}.{number}"), depth)?;
            }
        }
        Some(())
    }

    fn value(&mut self, kind: &str, path: &str, depth: usize) -> Option<()> {
        self.values += 1;
        if self.values > VALUES_MAX {
            return None;
        }
        if kind == "string" {
            let bytes = self.count()?;
            return self.skip(bytes);
        }
        if self.definition.contains_key(kind) {
            return self.message(kind, path, depth + 1);
        }
        let number = self.number(kind)?;
        if self.found.len() >= NUMBERS_MAX {
            return None;
        }
        self.found.push((path.to_owned(), number));
        Some(())
    }
}

/// The name of the probe of a number in a message of that definition.
fn named(definition: &Definition, topic: &str, path: &str) -> Option<String> {
    let Some(device) = topic.strip_suffix("/figures") else {
        return probe(topic, path);
    };
    let field = definition.get("")?.iter().find(|it| it.name == path)?;
    let of_probe = field.of_probe.as_deref().filter(|it| !it.is_empty())?;
    Some(format!("{}.{of_probe}", device.trim_start_matches('/')))
}

/// The name of a probe of a number in a message of that topic; `None` for its time.
fn probe(topic: &str, path: &str) -> Option<String> {
    if path.contains("stamp.") {
        return None;
    }
    let topic = topic.trim_start_matches('/');
    if let Some(net) = topic.strip_prefix("takt/nets/") {
        return Some(format!("net:{net}/{path}"));
    }
    if let Some(thread) = topic.strip_prefix("takt/thread") {
        let thread = thread.trim_start_matches('_');
        let thread = if thread.is_empty() { "nets" } else { thread };
        return Some(format!("thread:{thread}.{path}"));
    }
    let (device, what) = topic.rsplit_once('/').unwrap_or(("", topic));
    let (first, rest) = path.split_once('.').unwrap_or((path, ""));
    Some(match (what, first) {
        ("joint_states", "position") => format!("{device}.joint.{rest}.measured"),
        ("joint_states", "velocity") => format!("{device}.joint.{rest}.velocity"),
        ("joint_states", "effort") => format!("{device}.joint.{rest}.torque"),
        ("set_points", "position") => format!("{device}.joint.{rest}.set_point"),
        ("wrench", _) => match path
            .strip_prefix("wrench.")
            .and_then(|it| it.split_once('.'))
        {
            Some(("force", axis)) => format!("{device}.force.{axis}"),
            Some((_, axis)) => format!("{device}.force.r{axis}"),
            None => format!("{device}.{path}"),
        },
        ("signals", "digital_inputs") => format!("{device}.digin.{rest}"),
        ("signals", "digital_outputs") => format!("{device}.digout.{rest}"),
        ("signals", "analogue_inputs") => format!("{device}.anin.{rest}"),
        ("signals", "analogue_outputs") => format!("{device}.anout.{rest}"),
        _ => format!("{}.{path}", topic.replace('/', ".")),
    })
}

/// Passes the numbers of each message to `each`, with its Unix time (ns), named as probes are: `left.joint.0.measured`.
/// Messages of unknown encodings are passed over.
///
/// # Errors
/// If the file cannot be read or is damaged other than by a cut, or `each` fails.
pub fn numbers(
    path: &Path,
    mut each: impl FnMut(u64, &[(String, f64)]) -> Result<(), Error>,
) -> Result<(), Error> {
    let (mut file, is_ended) = open(path)?;
    let (mut schemas, mut channels) = (HashMap::new(), HashMap::new());
    records((&mut file, is_ended), path, |record| {
        if let Record::Schema { header, data } = record {
            let is_known = header.encoding == "ros2msg" && !LEFT_OUT.contains(&&*header.name);
            let text = String::from_utf8_lossy(&data);
            let found = is_known.then(|| definition(&text));
            schemas.insert(header.id, found.unwrap_or_default());
        } else if let Record::Channel(channel) = record {
            if channel.message_encoding == "cdr" {
                channels.insert(channel.id, (channel.topic, channel.schema_id));
            }
        } else if let Record::Message { header, data } = record
            && let Some((topic, schema)) = channels.get(&header.channel_id)
            && let Some(definition) = schemas.get(schema).filter(|it| !it.is_empty())
        {
            let mut decoder = Decoder {
                definition,
                data: data.get(4..).unwrap_or_default(),
                at: 0,
                values: 0,
                found: Vec::new(),
            };
            if decoder.message("", "", 0).is_some() {
                let found = decoder.found.into_iter();
                let found = found
                    .filter_map(|(path, value)| Some((named(definition, topic, &path)?, value)));
                let found: Vec<_> = found.collect();
                each(header.log_time, &found)?;
            }
        }
        Ok(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::ros2::cdr::Cdr;
    use crate::record::ros2::schemas;

    #[test]
    fn figures_have_names_of_probes() {
        let text = "builtin_interfaces/Time stamp\nfloat64 fri_answer_time # fri.answer_time, s\n\
            float64 joint_0_statusword # joint.0.statusword\nfloat64 odd\n";
        let known = definition(text);
        for (path, wanted) in [
            ("fri_answer_time", Some("left.fri.answer_time")),
            ("joint_0_statusword", Some("left.joint.0.statusword")),
            ("odd", None),
            ("stamp.sec", None),
        ] {
            let name = named(&known, "/left/figures", path);
            assert_eq!(name.as_deref(), wanted, "{path}");
        }
        let other = named(&known, "/left/other", "odd");
        assert_eq!(other.as_deref(), Some("left.other.odd"));
    }

    fn decoded(text: &str, data: &[u8]) -> Option<Vec<(String, f64)>> {
        let mut decoder = Decoder {
            definition: &definition(text),
            data: data.get(4..).unwrap_or_default(),
            at: 0,
            values: 0,
            found: Vec::new(),
        };
        decoder.message("", "", 0)?;
        Some(decoder.found)
    }

    #[test]
    fn arrays_without_bytes_are_bounded() {
        // Each message in it has four billion of the next kind, down to one that takes no bytes.
        let mut text = "a[4000000000] x\n".to_owned();
        for (kind, inner) in [("a", "b"), ("b", "c"), ("c", "d")] {
            text += &format!("MSG: {kind}\n{inner}[4000000000] x\n");
        }
        text += "MSG: d\nuint8[0] none\n";
        assert_eq!(decoded(&text, &[0; 8]), None);
    }

    #[test]
    fn joint_state_is_named_as_probes_are() {
        let mut cdr = Cdr::default();
        cdr.begin().i32(7).u32(5).text("");
        cdr.texts(&["left.joint_1".to_owned(), "left.joint_2".to_owned()]);
        cdr.numbers([0.5, 1.5].into_iter());
        cdr.numbers([f64::NAN, 2.0].into_iter());
        cdr.numbers([].into_iter());
        let text = schemas::JOINT_STATE.text();
        let found = decoded(&text, cdr.bytes()).unwrap();
        let names = found.iter().filter_map(|(path, value)| {
            let name = probe("/left/joint_states", path)?;
            Some(format!("{name}={value}"))
        });
        let names: Vec<_> = names.collect();
        let wanted = [
            "left.joint.0.measured=0.5",
            "left.joint.1.measured=1.5",
            "left.joint.0.velocity=NaN",
            "left.joint.1.velocity=2",
        ];
        assert_eq!(names, wanted);
        // A message that is cut off has no numbers.
        for length in 0..cdr.bytes().len() {
            let cut = cdr.bytes().get(..length).unwrap_or_default();
            assert_eq!(decoded(&text, cut), None, "{length}");
        }
    }

    #[test]
    fn names_of_numbers_are_those_of_probes() {
        for (topic, path, wanted) in [
            ("/left/set_points", "position.3", "left.joint.3.set_point"),
            ("/left/wrench", "wrench.force.x", "left.force.x"),
            ("/left/wrench", "wrench.torque.z", "left.force.rz"),
            ("/plant/signals", "digital_inputs.0", "plant.digin.0"),
            ("/plant/signals", "analogue_outputs.2", "plant.anout.2"),
            ("/takt/nets/rpinet3", "progress", "net:rpinet3/progress"),
            ("/takt/thread", "interval_us", "thread:nets.interval_us"),
            ("/takt/thread_4000us", "missed", "thread:4000us.missed"),
            ("/other/imu", "gyro.x", "other.imu.gyro.x"),
        ] {
            assert_eq!(probe(topic, path).as_deref(), Some(wanted));
        }
        assert_eq!(probe("/left/wrench", "header.stamp.sec"), None);
    }

    #[test]
    fn definition_that_contains_itself_ends() {
        let text = "pkg/A a\nMSG: pkg/A\npkg/A a\n";
        assert_eq!(decoded(text, &[0; 64]), None);
        let endless = "float64[] a\n";
        let mut data = vec![0; 4];
        data.extend(u32::MAX.to_le_bytes());
        assert_eq!(decoded(endless, &data), None);
    }
}
