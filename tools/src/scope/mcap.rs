//! Samples as a recording that viewers open: MCAP with messages of ROS 2 (`ros2msg`, CDR), a topic for each net thread with a
//! field of each probe. It is no recording of `takt run --record`: nothing is replayed from it.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Seek, Write};
use std::time::{SystemTime, UNIX_EPOCH};

use mcap::records::MessageHeader;

use super::wire::{Frame, Group, Setup};

/// Representation identifier `CDR_LE` and options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Writes samples.
pub(super) struct Mcap<W: Write + Seek> {
    writer: mcap::Writer<W>,
    channels: Vec<u16>,
    /// Unix time at the controller's start, ns; known from the first sample on.
    epoch: Option<u64>,
    sequence: u32,
}

impl<W: Write + Seek> Mcap<W> {
    pub(super) fn begin(out: W, setup: &Setup) -> anyhow::Result<Self> {
        let mut writer = mcap::WriteOptions::new().profile("ros2").create(out)?;
        let mut channels = Vec::new();
        let mut topics = BTreeSet::new();
        for group in &setup.groups {
            let name = unique(&identifier(&group.thread), &mut topics);
            // Names of types have no underscores: readers reject the file.
            let kind = format!("takt_msgs/msg/Scope{}", channels.len() + 1);
            let schema = writer.add_schema(&kind, "ros2msg", definition(group).as_bytes())?;
            let topic = format!("/takt/scope/{name}");
            channels.push(writer.add_channel(schema, &topic, "cdr", &BTreeMap::new())?);
        }
        Ok(Self {
            writer,
            channels,
            epoch: None,
            sequence: 0,
        })
    }

    pub(super) fn add(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let Some(channel_id) = self.channels.get(frame.group).copied() else {
            return Ok(());
        };
        // Times are those of the controller's start, which is not known otherwise: the last sample is the newest.
        let last = frame.rows().last().map_or(0.0, |(time, _)| time);
        let epoch = *self.epoch.get_or_insert_with(|| {
            let now = SystemTime::now().duration_since(UNIX_EPOCH);
            let now = now.map_or(0, |now| u64::try_from(now.as_nanos()).unwrap_or(0));
            now.saturating_sub(ns(last))
        });
        for (time, values) in frame.rows() {
            let time = epoch.saturating_add(ns(time));
            self.sequence = self.sequence.wrapping_add(1);
            let header = MessageHeader {
                channel_id,
                sequence: self.sequence,
                log_time: time,
                publish_time: time,
            };
            self.writer
                .write_to_known_channel(&header, &message(time, values))?;
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> anyhow::Result<()> {
        self.writer.finish()?;
        Ok(())
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the conversion saturates"
)]
fn ns(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

/// A stamp and numbers, in CDR.
fn message(time: u64, values: &[f64]) -> Vec<u8> {
    const SECOND: u64 = 1_000_000_000;
    let mut bytes = HEADER.to_vec();
    let seconds = i32::try_from(time / SECOND).unwrap_or(i32::MAX);
    bytes.extend_from_slice(&seconds.to_le_bytes());
    // Below a second it fits.
    let rest = u32::try_from(time % SECOND).unwrap_or(0);
    bytes.extend_from_slice(&rest.to_le_bytes());
    // The numbers begin at 8 bytes behind the header, a multiple of their size.
    for value in values {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes
}

/// The fields of a message, with their units as comments.
fn definition(group: &Group) -> String {
    let mut used = BTreeSet::from(["stamp".to_owned()]);
    let mut text = "builtin_interfaces/Time stamp\n".to_owned();
    for probe in &group.probes {
        let name = unique(&identifier(&probe.name), &mut used);
        let what: String = probe.name.chars().filter(|c| !c.is_control()).collect();
        text.push_str(&format!("float64 {name} # {what}, {}\n", probe.unit));
    }
    text.push_str(
        "================================================================================\n",
    );
    text.push_str("MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n");
    text
}

/// What names of topics and fields may contain: a letter, then letters, digits and single underscores.
fn identifier(name: &str) -> String {
    let mut found = String::new();
    for letter in name.chars().map(|letter| letter.to_ascii_lowercase()) {
        if letter.is_ascii_alphanumeric() {
            found.push(letter);
        } else if !found.is_empty() && !found.ends_with('_') {
            found.push('_');
        }
    }
    let found = found.trim_end_matches('_');
    if found.starts_with(|first: char| first.is_ascii_alphabetic()) {
        found.to_owned()
    } else {
        format!("v{found}")
    }
}

/// The name, with a number if it is in use.
fn unique(name: &str, used: &mut BTreeSet<String>) -> String {
    let mut names = std::iter::once(name.to_owned()).chain((2..).map(|n| format!("{name}_{n}")));
    let found = names.find(|it| used.insert(it.clone()));
    found.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::super::store::tests::setup;
    use super::*;

    #[test]
    fn mcap_of_samples_is_read_back() {
        let names = [
            ("left.joint.0.measured", "rad"),
            ("left joint.0 measured", "rad"),
        ];
        let setup = setup(&[&names, &[("0.x", "")]]);
        let mut bytes = Cursor::new(Vec::new());
        let mut file = Mcap::begin(&mut bytes, &setup).unwrap();
        file.add(&Frame::of(0, 2, &[1.0, 0.5, -0.5, 1.001, 0.25, 0.75]))
            .unwrap();
        file.add(&Frame::of(1, 1, &[1.0, 9.0])).unwrap();
        file.add(&Frame::of(5, 1, &[1.0, 9.0])).unwrap();
        file.finish().unwrap();
        let bytes = bytes.into_inner();
        let messages: Vec<_> = mcap::MessageStream::new(&bytes)
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(messages.len(), 3);
        let topics: Vec<_> = messages
            .iter()
            .map(|it| it.channel.topic.as_str())
            .collect();
        assert_eq!(
            topics,
            ["/takt/scope/nets", "/takt/scope/nets", "/takt/scope/nets_2"]
        );
        let schema = messages[0].channel.schema.as_ref().unwrap();
        assert_eq!(schema.encoding, "ros2msg");
        let text = String::from_utf8(schema.data.to_vec()).unwrap();
        assert!(
            text.starts_with(
                "builtin_interfaces/Time stamp\n\
                 float64 left_joint_0_measured # left.joint.0.measured, rad\n\
                 float64 left_joint_0_measured_2 # left joint.0 measured, rad\n=====",
            ),
            "{text}"
        );
        assert_eq!(messages[1].log_time - messages[0].log_time, 1_000_000);
        let numbers = &messages[1].data[12..];
        assert_eq!(
            numbers,
            [0.25_f64.to_le_bytes(), 0.75_f64.to_le_bytes()].concat()
        );
    }
}
