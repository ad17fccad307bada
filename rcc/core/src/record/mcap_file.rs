//! An MCAP file in compressed chunks (<https://mcap.dev/spec>). It is written in order: one that a crash cuts off is readable up to its
//! last whole chunk.
//!
//! The crate `mcap` defines the records and reads them. Its writer passes each field of a message to two checksums and to the
//! compressor; whole chunks take less time, which SPECIFICATION has with its figures.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};

use binrw::BinWrite;
use mcap::records::{
    AttachmentHeader, AttachmentIndex, Channel, ChunkHeader, ChunkIndex, DataEnd, Footer, Header,
    MessageHeader, Metadata, MetadataIndex, SchemaHeader, Statistics, SummaryOffset, op,
};
use zstd::bulk::Compressor;

#[cfg(test)]
mod tests;

/// Length of a chunk before its compression, bytes: as long as the window of the fast levels, beyond which a search takes longer.
const CHUNK: usize = 512 << 10;
/// Level of the compression: one of the fast ones, because cycles that wait for it too long are lost.
const LEVEL: i32 = -1;
/// Bytes of a message in the index of its topic: time and place.
const INDEX_ENTRY: usize = 2 * size_of::<u64>();

/// A topic, and its messages.
struct Topic {
    channel: Channel,
    /// Of those in this chunk.
    index: Vec<u8>,
    /// Number of those in chunks before.
    messages: u64,
}

/// A file that is being written. After an error, a part of a record may be on the disk, and nothing may follow it.
pub(super) struct McapFile<W> {
    to: W,
    /// Bytes that were written, and their checksum.
    bytes: u64,
    checksum: crc32fast::Hasher,
    schemas: Vec<(SchemaHeader, Vec<u8>)>,
    topics: Vec<Topic>,
    /// Records of this chunk, and the times of its first and last message.
    chunk: Vec<u8>,
    times: Option<(u64, u64)>,
    compressor: Compressor<'static>,
    compressed: Vec<u8>,
    /// Records that are written next.
    next: Vec<u8>,
    chunks: Vec<ChunkIndex>,
    attachments: Vec<AttachmentIndex>,
    metadata: Vec<MetadataIndex>,
}

impl<W: Write> McapFile<W> {
    /// Begins a file.
    pub(super) fn begin(to: W, profile: &str) -> io::Result<Self> {
        let mut file = Self {
            to,
            bytes: 0,
            checksum: crc32fast::Hasher::new(),
            schemas: Vec::new(),
            topics: Vec::new(),
            chunk: Vec::new(),
            times: None,
            compressor: Compressor::new(LEVEL)?,
            compressed: Vec::new(),
            next: mcap::MAGIC.to_vec(),
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
        };
        let header = Header {
            profile: profile.to_owned(),
            library: "takt".to_owned(),
        };
        push(&mut file.next, op::HEADER, &[&body(&header)?]);
        file.write_next()?;
        Ok(file)
    }

    /// Bytes that were written; those of this chunk follow.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Writes the records that wait, in one call.
    fn write_next(&mut self) -> io::Result<()> {
        self.to.write_all(&self.next)?;
        self.checksum.update(&self.next);
        self.bytes += self.next.len() as u64;
        self.next.clear();
        Ok(())
    }

    /// The number of a schema, which is added when it is first used.
    pub(super) fn schema(&mut self, name: &str, encoding: &str, text: &str) -> io::Result<u16> {
        let wanted = (name, encoding, text.as_bytes());
        for (known, data) in &self.schemas {
            if (
                known.name.as_str(),
                known.encoding.as_str(),
                data.as_slice(),
            ) == wanted
            {
                return Ok(known.id);
            }
        }
        let id = number_after(self.schemas.len(), "schemas")?;
        let header = SchemaHeader {
            id,
            name: name.to_owned(),
            encoding: encoding.to_owned(),
        };
        let data = text.as_bytes().to_vec();
        push_schema(&mut self.chunk, &header, &data)?;
        self.schemas.push((header, data));
        Ok(id)
    }

    /// The number of a topic, which is added when it is first used.
    pub(super) fn channel(
        &mut self,
        schema_id: u16,
        topic: &str,
        encoding: &str,
        metadata: &BTreeMap<String, String>,
    ) -> io::Result<u16> {
        for Topic { channel: known, .. } in &self.topics {
            if (known.schema_id, known.topic.as_str()) == (schema_id, topic)
                && (known.message_encoding.as_str(), &known.metadata) == (encoding, metadata)
            {
                return Ok(known.id);
            }
        }
        let id = number_after(self.topics.len(), "topics")?;
        let channel = Channel {
            id,
            schema_id,
            topic: topic.to_owned(),
            message_encoding: encoding.to_owned(),
            metadata: metadata.clone(),
        };
        push(&mut self.chunk, op::CHANNEL, &[&body(&channel)?]);
        self.topics.push(Topic {
            channel,
            index: Vec::new(),
            messages: 0,
        });
        Ok(id)
    }

    /// Writes a message of a topic.
    pub(super) fn message(&mut self, header: MessageHeader, data: &[u8]) -> io::Result<()> {
        let MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time,
        } = header;
        let place = usize::from(channel_id).checked_sub(1);
        let topic = place.and_then(|place| self.topics.get_mut(place));
        let topic = topic.ok_or_else(|| io::Error::other("a message of no topic"))?;
        topic.index.extend(log_time.to_le_bytes());
        topic.index.extend((self.chunk.len() as u64).to_le_bytes());
        let fields: [&[u8]; 5] = [
            &channel_id.to_le_bytes(),
            &sequence.to_le_bytes(),
            &log_time.to_le_bytes(),
            &publish_time.to_le_bytes(),
            data,
        ];
        push(&mut self.chunk, op::MESSAGE, &fields);
        let (first, last) = self.times.unwrap_or((log_time, log_time));
        self.times = Some((first.min(log_time), last.max(log_time)));
        if self.chunk.len() > CHUNK {
            self.end_chunk()?;
        }
        Ok(())
    }

    /// Writes the chunk, if it has records, and the indexes of its messages.
    fn end_chunk(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        let longest = zstd::zstd_safe::compress_bound(self.chunk.len());
        self.compressed.clear();
        self.compressed.reserve(longest);
        let to = &mut self.compressed;
        self.compressor.compress_to_buffer(&self.chunk, to)?;
        let (message_start_time, message_end_time) = self.times.take().unwrap_or_default();
        let header = ChunkHeader {
            message_start_time,
            message_end_time,
            uncompressed_size: self.chunk.len() as u64,
            uncompressed_crc: crc32fast::hash(&self.chunk),
            compression: "zstd".to_owned(),
            compressed_size: self.compressed.len() as u64,
        };
        self.chunk.clear();
        let chunk_start_offset = self.bytes;
        let parts: [&[u8]; 2] = [&body(&header)?, &self.compressed];
        push(&mut self.next, op::CHUNK, &parts);
        let chunk_length = self.next.len() as u64;
        let mut message_index_offsets = BTreeMap::new();
        for topic in self.topics.iter_mut().filter(|it| !it.index.is_empty()) {
            let id = topic.channel.id;
            let offset = chunk_start_offset + self.next.len() as u64;
            message_index_offsets.insert(id, offset);
            let fields: [&[u8]; 3] = [&id.to_le_bytes(), &length(&topic.index)?, &topic.index];
            push(&mut self.next, op::MESSAGE_INDEX, &fields);
            topic.messages += (topic.index.len() / INDEX_ENTRY) as u64;
            topic.index.clear();
        }
        self.chunks.push(ChunkIndex {
            message_start_time,
            message_end_time,
            chunk_start_offset,
            chunk_length,
            message_index_offsets,
            message_index_length: self.next.len() as u64 - chunk_length,
            compression: header.compression,
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        });
        self.write_next()
    }

    /// Writes the chunk, and flushes all.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.end_chunk()?;
        self.to.flush()
    }

    /// Attaches a text.
    pub(super) fn attach(&mut self, name: &str, text: &str, at: u64) -> io::Result<()> {
        self.end_chunk()?;
        let header = AttachmentHeader {
            log_time: at,
            create_time: at,
            name: name.to_owned(),
            media_type: "text/plain".to_owned(),
        };
        let data_size = text.len() as u64;
        let mut content = body(&header)?;
        content.extend(data_size.to_le_bytes());
        content.extend(text.as_bytes());
        let checksum = crc32fast::hash(&content).to_le_bytes();
        push(&mut self.next, op::ATTACHMENT, &[&content, &checksum]);
        self.attachments.push(AttachmentIndex {
            offset: self.bytes,
            length: self.next.len() as u64,
            log_time: at,
            create_time: at,
            data_size,
            name: header.name,
            media_type: header.media_type,
        });
        self.write_next()
    }

    /// Describes the file by keys and values.
    pub(super) fn describe(&mut self, values: BTreeMap<String, String>) -> io::Result<()> {
        self.end_chunk()?;
        let metadata = Metadata {
            name: "takt".to_owned(),
            metadata: values,
        };
        push(&mut self.next, op::METADATA, &[&body(&metadata)?]);
        self.metadata.push(MetadataIndex {
            offset: self.bytes,
            length: self.next.len() as u64,
            name: metadata.name,
        });
        self.write_next()
    }

    /// Ends the file with its summary, and flushes all; returns its bytes.
    pub(super) fn finish(mut self) -> io::Result<u64> {
        self.end_chunk()?;
        let data_section_crc = self.checksum.clone().finalize();
        let end = DataEnd { data_section_crc };
        push(&mut self.next, op::DATA_END, &[&body(&end)?]);
        self.write_next()?;
        self.next = self.summary()?;
        self.write_next()?;
        self.to.flush()?;
        Ok(self.bytes)
    }

    /// The summary, in groups of equal records, and the end of the file.
    fn summary(&self) -> io::Result<Vec<u8>> {
        let mut all = Vec::new();
        let mut groups = Vec::new();
        let mut end_group = |opcode, all: &Vec<u8>| groups.push((opcode, all.len()));
        for (header, data) in &self.schemas {
            push_schema(&mut all, header, data)?;
        }
        end_group(op::SCHEMA, &all);
        for topic in &self.topics {
            push(&mut all, op::CHANNEL, &[&body(&topic.channel)?]);
        }
        end_group(op::CHANNEL, &all);
        push(&mut all, op::STATISTICS, &[&body(&self.statistics())?]);
        end_group(op::STATISTICS, &all);
        for index in &self.chunks {
            push(&mut all, op::CHUNK_INDEX, &[&body(index)?]);
        }
        end_group(op::CHUNK_INDEX, &all);
        for index in &self.attachments {
            push(&mut all, op::ATTACHMENT_INDEX, &[&body(index)?]);
        }
        end_group(op::ATTACHMENT_INDEX, &all);
        for index in &self.metadata {
            push(&mut all, op::METADATA_INDEX, &[&body(index)?]);
        }
        end_group(op::METADATA_INDEX, &all);
        let summary_offset_start = self.bytes + all.len() as u64;
        let mut begin = 0;
        for (group_opcode, end) in groups {
            let offset = SummaryOffset {
                group_opcode,
                group_start: self.bytes + begin as u64,
                group_length: (end - begin) as u64,
            };
            if offset.group_length > 0 {
                push(&mut all, op::SUMMARY_OFFSET, &[&body(&offset)?]);
            }
            begin = end;
        }
        let footer = Footer {
            summary_start: self.bytes,
            summary_offset_start,
            summary_crc: 0,
        };
        push(&mut all, op::FOOTER, &[&body(&footer)?]);
        // The checksum is of all before it, the begin of the footer too.
        all.truncate(all.len() - size_of::<u32>());
        all.extend(crc32fast::hash(&all).to_le_bytes());
        all.extend(mcap::MAGIC);
        Ok(all)
    }

    fn statistics(&self) -> Statistics {
        let used = self.topics.iter().filter(|topic| topic.messages > 0);
        let counts = used.map(|topic| (topic.channel.id, topic.messages));
        let channel_message_counts: BTreeMap<_, _> = counts.collect();
        let chunks = self.chunks.iter();
        let chunks = chunks.filter(|chunk| !chunk.message_index_offsets.is_empty());
        let begin = chunks.clone().map(|chunk| chunk.message_start_time).min();
        let end = chunks.map(|chunk| chunk.message_end_time).max();
        let number = |length: usize| u32::try_from(length).unwrap_or(u32::MAX);
        Statistics {
            message_count: channel_message_counts.values().sum(),
            // Their numbers have as many bits.
            schema_count: u16::try_from(self.schemas.len()).unwrap_or(u16::MAX),
            channel_count: number(self.topics.len()),
            attachment_count: number(self.attachments.len()),
            metadata_count: number(self.metadata.len()),
            chunk_count: number(self.chunks.len()),
            message_start_time: begin.unwrap_or(0),
            message_end_time: end.unwrap_or(0),
            channel_message_counts,
        }
    }
}

/// The number of the next schema or topic, from 1.
fn number_after(count: usize, what: &str) -> io::Result<u16> {
    let number = u16::try_from(count + 1);
    number.map_err(|_| io::Error::other(format!("a file has at most {} {what}", u16::MAX)))
}

/// The fields of a record.
fn body<T>(fields: &T) -> io::Result<Vec<u8>>
where
    T: for<'a> BinWrite<Args<'a> = ()>,
{
    let mut bytes = Cursor::new(Vec::new());
    fields.write_le(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.into_inner())
}

/// The length of a field, which stands before it.
fn length(field: &[u8]) -> io::Result<[u8; 4]> {
    let length = u32::try_from(field.len());
    let length = length.map_err(|_| io::Error::other("a field of more than 4 GiB"))?;
    Ok(length.to_le_bytes())
}

/// Appends a record that consists of these parts.
fn push(to: &mut Vec<u8>, opcode: u8, parts: &[&[u8]]) {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    to.push(opcode);
    to.extend_from_slice(&(length as u64).to_le_bytes());
    for part in parts {
        to.extend_from_slice(part);
    }
}

fn push_schema(to: &mut Vec<u8>, header: &SchemaHeader, data: &[u8]) -> io::Result<()> {
    let parts: [&[u8]; 3] = [&body(header)?, &length(data)?, data];
    push(to, op::SCHEMA, &parts);
    Ok(())
}
