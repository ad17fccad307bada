//! Reads the file of a recording.

use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::de::DeserializeOwned;

use crate::error::Error;
use crate::files;
use crate::record::cycles::Cycles;
use crate::record::notes::{
    CYCLES, DEVICES, DeviceEvent, FORMAT, MACHINES, MachineNote, NETS, NetNote, wrong,
};
use crate::record::parts::Part;
use crate::record::ros2::cdr::{string, words};

/// Last bytes of a complete file; a file without them is truncated.
pub(super) const END: [u8; 8] = *b"\x89MCAP0\r\n";

/// Maximum bytes of a chunk before compression that is read; the writer's are below 1 MiB.
const CHUNK_BYTES_MAX: usize = 64 << 20;

/// Whether a file of that length with these last bytes ends as a whole one does: one that was cut off after its first bytes
/// ends with the same.
pub(super) fn is_ended(length: u64, last: &[u8]) -> bool {
    length >= 2 * END.len() as u64 && last.ends_with(&END)
}

fn of_other_version(format: Option<&str>) -> String {
    let format = format.unwrap_or("4 or older");
    format!(
        "its format is {format}, this version reads {FORMAT}\nhint: replay it with the version that recorded it; viewers \
         open it still"
    )
}

fn too_long(most: u64) -> String {
    format!("more than {most} bytes when unpacked\nhint: record shorter runs")
}

fn note<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    let unreadable = |why: &str| format!("unreadable note: {why}");
    let data = string(data).ok_or_else(|| unreadable("it is no string"))?;
    toml::from_slice(data).map_err(|e| unreadable(&e.to_string()))
}

/// Reads the schemas, channels and messages of a file; true if it is whole, false if it is cut off and does not end as a whole
/// file does.
///
/// # Errors
/// If it is no MCAP file, or damaged, or `each` fails.
pub(super) fn records(
    (from, is_ended): (&mut impl Read, bool),
    path: &Path,
    mut each: impl FnMut(Record<'_>) -> Result<(), Error>,
) -> Result<bool, Error> {
    let damaged = |e: &mcap::McapError| wrong(path, format!("not a complete MCAP file: {e}"));
    // Read record by record, because only this checks all checksums, and because the
    // library's own streams panic on some malformed records of kinds that are not needed here.
    let options = LinearReaderOptions::default()
        .with_prevalidate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_record_length_limit(CHUNK_BYTES_MAX);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        // In a complete file, a record beyond the end is damage.
        if matches!(event, Err(mcap::McapError::UnexpectedEof)) && !is_ended {
            return Ok(false);
        }
        match event.map_err(|e| damaged(&e))? {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = from.read(reader.insert(wanted));
                let read = read.map_err(|source| Error::File {
                    path: path.to_owned(),
                    source,
                })?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record {
                opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE),
                data,
            } => each(mcap::parse_record(opcode, data).map_err(|e| damaged(&e))?)?,
            LinearReadEvent::Record { .. } => {}
        }
    }
    Ok(true)
}

/// Notes of a recording besides cycles.
#[derive(Debug)]
pub(super) enum RecordedNote {
    Device(DeviceEvent),
    Net(NetNote),
    Machine(MachineNote),
}

/// A recording in memory.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// Devices and nets in order.
    pub(super) notes: Vec<RecordedNote>,
    pub(super) cycles: Cycles,
    /// Its place in a recording of several files.
    pub(super) part: Option<Part>,
    /// It was not finished, because of a full disk or a crash; it holds the complete records.
    pub(super) is_cut: bool,
}

impl Recording {
    pub(super) fn read(path: &Path) -> Result<Self, Error> {
        let read = files::read(path, files::RECORDING_BYTES_MAX);
        let bytes = read.map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::parse(&bytes, path)
    }

    /// Parses the bytes of that file.
    pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Self, Error> {
        Self::parse_limited(bytes, path, files::RECORDING_BYTES_MAX)
    }

    /// As [`Self::parse`], of at most so many bytes when unpacked.
    pub(super) fn parse_limited(mut bytes: &[u8], path: &Path, most: u64) -> Result<Self, Error> {
        let mut recording = Self::default();
        let mut topics = HashMap::new();
        let mut recording_part = None;
        let mut unpacked = 0;
        let is_ended = is_ended(bytes.len() as u64, bytes);
        let is_whole = records((&mut bytes, is_ended), path, |record| {
            if let Record::Channel(channel) = record {
                let format = channel.metadata.get("format").map(String::as_str);
                if channel.topic == CYCLES && format != Some(FORMAT) {
                    return Err(wrong(path, of_other_version(format)));
                }
                let part = (
                    channel.metadata.get("recording"),
                    channel.metadata.get("part"),
                );
                if let (Some(recording), Some(number)) = part {
                    let unreadable = |_| wrong(path, format!("it is part `{number}`"));
                    recording_part = Some(Part {
                        recording: recording.clone(),
                        number: number.parse().map_err(unreadable)?,
                    });
                }
                // The other topics are for viewers.
                if [CYCLES, DEVICES, NETS, MACHINES].contains(&channel.topic.as_str()) {
                    topics.insert(channel.id, channel.topic);
                }
            } else if let Record::Message { header, data } = record
                && let Some(topic) = topics.get(&header.channel_id)
            {
                unpacked += data.len() as u64;
                if unpacked > most {
                    return Err(wrong(path, too_long(most)));
                }
                let read = recording.message(topic, &data);
                read.map_err(|why| wrong(path, why))?;
            }
            Ok(())
        })?;
        (recording.is_cut, recording.part) = (!is_whole, recording_part);
        // A further part may have been cut off before its first cycle.
        let is_further = recording.part.as_ref().is_some_and(|it| it.number > 1);
        let why = match (recording.cycles.is_empty() && !is_further, is_whole) {
            (false, _) => return Ok(recording),
            (true, false) => "cut off before its first cycle: a full disk?",
            (true, true) => "no cycles: not a recording of Takt, or an empty one",
        };
        Err(wrong(path, why.to_owned()))
    }

    fn message(&mut self, topic: &str, data: &[u8]) -> Result<(), String> {
        match topic {
            DEVICES => self.notes.push(RecordedNote::Device(note(data)?)),
            NETS => self.notes.push(RecordedNote::Net(note(data)?)),
            MACHINES => self.notes.push(RecordedNote::Machine(note(data)?)),
            CYCLES => {
                let words = words(data).ok_or("a cycle is cut off")?;
                self.cycles.push(words)?;
            }
            _ => {}
        }
        Ok(())
    }
}
