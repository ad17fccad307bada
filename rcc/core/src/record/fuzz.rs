//! Fuzz target of recordings: any bytes are read or rejected without a panic. It replays nothing.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use mcap::records::MessageHeader;

use super::cycles::Encoder;
use super::notes::{CYCLES, DEVICES, FORMAT, NETS};
use super::read::Recording;
use super::ros2::cdr::Cdr;

/// Reads the bytes of an MCAP file as a recording.
///
/// # Panics
/// If a recording was read that contains no cycle.
pub fn fuzz(bytes: &[u8]) {
    if let Ok(recording) = Recording::parse(bytes, Path::new("fuzz.mcap")) {
        assert!(!recording.cycles.is_empty());
    }
}

/// Seed recordings for [`fuzz()`]: with chunks and their checksums, and without, so that mutations reach
/// the records.
///
/// # Panics
/// If they cannot be written into memory.
#[must_use]
pub fn files() -> Vec<Vec<u8>> {
    [true, false]
        .map(|chunks| file(chunks).unwrap_or_default())
        .to_vec()
}

fn file(chunks: bool) -> mcap::McapResult<Vec<u8>> {
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .use_chunks(chunks)
        .calculate_chunk_crcs(chunks)
        .calculate_data_section_crc(chunks)
        .profile("ros2")
        .library("takt")
        .create(Cursor::new(Vec::new()))?;
    let net = "id = 1\nevery = 2\nperiod_ns = 1000000\ntext = \"{a=Core::Clock()}\"\n";
    let gone = "[went]\nname = \"left\"\n";
    let mut messages = [NETS, DEVICES, CYCLES].map(|topic| (topic, Cdr::default()));
    let [(_, nets), (_, devices), (_, cycles)] = &mut messages;
    nets.begin().text(net);
    devices.begin().text(gone);
    let words = [7, 0x0807_0605_0403_0201];
    cycles.begin().words(Encoder::default().encode(&words));
    let format = BTreeMap::from([("format".to_owned(), FORMAT.to_owned())]);
    for (topic, data) in &messages {
        let channel_id = writer.add_channel(0, topic, "cdr", &format)?;
        let header = MessageHeader {
            channel_id,
            sequence: 1,
            log_time: 5,
            publish_time: 5,
        };
        writer.write_to_known_channel(&header, data.bytes())?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_for_fuzzing_are_read() {
        for file in files() {
            let recording = Recording::parse(&file, Path::new("x")).unwrap();
            assert_eq!(
                (recording.notes.len(), recording.cycles.iter().count()),
                (2, 1)
            );
        }
    }
}
