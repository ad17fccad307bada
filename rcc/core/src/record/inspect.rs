//! What a recording contains, and a whole file from one that was cut off.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, BufWriter, Read as _, Seek as _, SeekFrom};
use std::path::Path;
use std::time::Duration;

use mcap::records::{Record, op};

use crate::error::Error;
use crate::record::notes::wrong;
use crate::record::read::{END, is_ended, records};

/// Bytes of the last record of a file.
const FOOTER_BYTES: u64 = 1 + 8 + 20;
/// Most bytes of the index of a file, or of one of its texts, that are read for [`about`].
const END_BYTES_MAX: u64 = 16 << 20;

/// A topic of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topic {
    /// Type of its messages.
    pub schema: String,
    /// Number of its messages.
    pub messages: u64,
    /// Their bytes when unpacked.
    pub bytes: u64,
}

/// What a recording contains.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Topics by name.
    pub topics: BTreeMap<String, Topic>,
    /// Unix time of the first message, ns.
    pub begin: Option<u64>,
    /// Unix time of the last message, ns.
    pub end: Option<u64>,
    /// It was not finished, because of a full disk or a crash: whole records are counted.
    pub is_cut: bool,
}

impl Contents {
    /// Time from the first to the last message.
    #[must_use]
    pub fn duration(&self) -> Duration {
        let bounds = self.begin.zip(self.end);
        let ns = bounds.map_or(0, |(begin, end)| end.saturating_sub(begin));
        Duration::from_nanos(ns)
    }

    /// Number of all messages.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.topics.values().map(|topic| topic.messages).sum()
    }
}

/// An MCAP file, and whether it ends as a whole one does.
pub(super) fn open(path: &Path) -> Result<(BufReader<File>, bool), Error> {
    let try_open = || {
        let mut file = File::open(path)?;
        let mut end = [0; END.len()];
        let length = file.metadata()?.len();
        if let Some(begin) = length.checked_sub(END.len() as u64) {
            file.seek(SeekFrom::Start(begin))?;
            file.read_exact(&mut end)?;
            file.rewind()?;
        }
        Ok((BufReader::new(file), is_ended(length, &end)))
    };
    try_open().map_err(|source| Error::File {
        path: path.to_owned(),
        source,
    })
}

/// Counts what a recording contains; any MCAP file is one.
///
/// # Errors
/// If the file cannot be read, is no MCAP file, or is damaged other than by a cut.
pub fn contents(path: &Path) -> Result<Contents, Error> {
    let (mut file, is_ended) = open(path)?;
    let mut found = Contents::default();
    let (mut schemas, mut channels) = (HashMap::new(), HashMap::new());
    let is_whole = records((&mut file, is_ended), path, |record| {
        if let Record::Schema { header, .. } = record {
            schemas.insert(header.id, header.name);
        } else if let Record::Channel(channel) = record {
            let topic = found.topics.entry(channel.topic.clone()).or_default();
            let schema = schemas.get(&channel.schema_id);
            topic.schema = schema.cloned().unwrap_or_default();
            channels.insert(channel.id, channel.topic);
        } else if let Record::Message { header, data } = record {
            let name = channels.get(&header.channel_id);
            if let Some(topic) = name.and_then(|name| found.topics.get_mut(name)) {
                topic.messages += 1;
                topic.bytes += data.len() as u64;
            }
            let time = header.log_time;
            found.begin = Some(found.begin.map_or(time, |begin| begin.min(time)));
            found.end = Some(found.end.map_or(time, |end| end.max(time)));
        }
        Ok(())
    })?;
    found.is_cut = !is_whole;
    Ok(found)
}

/// Texts that a recording has about itself at its end, by key; those of a flight file have its `cause`. Empty if it was cut off
/// or has none. It reads the end of the file only.
///
/// # Errors
/// If the file cannot be read, or its end is damaged.
pub fn about(path: &Path) -> Result<BTreeMap<String, String>, Error> {
    let (mut file, is_ended) = open(path)?;
    let mut found = BTreeMap::new();
    if !is_ended {
        return Ok(found);
    }
    let damaged = |e: &mcap::McapError| wrong(path, format!("not a complete MCAP file: {e}"));
    let piece = |file: &mut BufReader<File>, begin: u64, end: u64| -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let length = end
            .checked_sub(begin)
            .filter(|length| *length <= END_BYTES_MAX);
        let length = length.ok_or_else(|| wrong(path, "its index is damaged".to_owned()))?;
        let read = file.seek(SeekFrom::Start(begin));
        let read = read.and_then(|_| file.take(length).read_to_end(&mut bytes));
        read.map(|_| bytes).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })
    };
    let length = file.seek(SeekFrom::End(0)).map_err(|source| Error::File {
        path: path.to_owned(),
        source,
    })?;
    let footer_at = length.saturating_sub(FOOTER_BYTES + END.len() as u64);
    let footer = piece(&mut file, footer_at, length)?;
    let Some(Record::Footer(footer)) = first_record(&footer).map_err(|e| damaged(&e))?.0 else {
        return Err(wrong(path, "it has no footer".to_owned()));
    };
    if footer.summary_start == 0 {
        return Ok(found);
    }
    let summary = piece(&mut file, footer.summary_start, footer_at)?;
    let mut rest = summary.as_slice();
    while !rest.is_empty() {
        let (record, behind) = first_record(rest).map_err(|e| damaged(&e))?;
        rest = behind;
        let Some(Record::MetadataIndex(index)) = record else {
            continue;
        };
        let bytes = piece(
            &mut file,
            index.offset,
            index.offset.saturating_add(index.length),
        )?;
        if let (Some(Record::Metadata(texts)), _) = first_record(&bytes).map_err(|e| damaged(&e))? {
            found.extend(texts.metadata);
        }
    }
    Ok(found)
}

/// The first record of these bytes if it is of the index, and the bytes behind it.
fn first_record(bytes: &[u8]) -> mcap::McapResult<(Option<Record<'_>>, &[u8])> {
    let cut = || mcap::McapError::UnexpectedEof;
    let (opcode, rest) = bytes.split_first().ok_or_else(cut)?;
    let (length, rest) = rest.split_first_chunk().ok_or_else(cut)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| cut())?;
    let (body, behind) = rest.split_at_checked(length).ok_or_else(cut)?;
    let record = match *opcode {
        op::FOOTER | op::METADATA | op::METADATA_INDEX => Some(mcap::parse_record(*opcode, body)?),
        _ => None,
    };
    Ok((record, behind))
}

/// Copies all whole messages of a recording that was cut off to a new file with an index; returns their number.
///
/// # Errors
/// If the file cannot be read or is damaged other than by a cut, holds nothing, or the new one exists or cannot be written.
pub fn recover(path: &Path, to: &Path) -> Result<u64, Error> {
    let (mut file, is_ended) = open(path)?;
    let failed = |e: &mcap::McapError| wrong(to, e.to_string());
    let created = File::create_new(to).map_err(|source| Error::File {
        path: to.to_owned(),
        source,
    })?;
    let mut writer = mcap::WriteOptions::new()
        .compression(Some(mcap::Compression::Zstd))
        .profile("ros2")
        .library("takt")
        .create(BufWriter::new(created))
        .map_err(|e| failed(&e))?;
    let (mut schemas, mut channels) = (HashMap::new(), HashMap::new());
    let mut copied = 0;
    let mut copy = |record: Record<'_>| -> mcap::McapResult<()> {
        if let Record::Schema { header, data } = record {
            let added = writer.add_schema(&header.name, &header.encoding, &data)?;
            schemas.insert(header.id, added);
        } else if let Record::Channel(channel) = record {
            let schema = schemas.get(&channel.schema_id).copied().unwrap_or(0);
            let (topic, encoding) = (&channel.topic, &channel.message_encoding);
            let added = writer.add_channel(schema, topic, encoding, &channel.metadata)?;
            channels.insert(channel.id, added);
        } else if let Record::Message { mut header, data } = record
            && let Some(channel) = channels.get(&header.channel_id)
        {
            header.channel_id = *channel;
            writer.write_to_known_channel(&header, &data)?;
            copied += 1;
        }
        Ok(())
    };
    let read = records((&mut file, is_ended), path, |record| {
        copy(record).map_err(|e| failed(&e))
    });
    let finished = read.and_then(|_| writer.finish().map_err(|e| failed(&e)));
    let outcome = finished.and_then(|_| match copied {
        0 => Err(wrong(path, "it holds no whole message".to_owned())),
        copied => Ok(copied),
    });
    if outcome.is_err() {
        // What is half written would be taken for a recording.
        let _ = std::fs::remove_file(to);
    }
    outcome
}
