//! Files as the crate `mcap` reads them, and as its writer makes them of the same calls.

use std::borrow::Cow;

use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, Summary};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;

use super::*;

/// What is written to a file.
#[derive(Clone, Debug)]
enum Step {
    Topic(u8, u8, BTreeMap<String, String>),
    /// Place of its topic, time, and content.
    Message(usize, u64, Vec<u8>),
    Flush,
    Attach(String, u64),
    Describe(BTreeMap<String, String>),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let texts = || btree_map("[a-z]{0,3}", ".{0,3}", 0..3);
    let content = prop_oneof![
        8 => vec(any::<u8>(), 0..100),
        // Some of them are as long as a chunk.
        1 => (0..CHUNK + 9).prop_map(|length| vec![7; length]),
    ];
    vec(
        prop_oneof![
            2 => (0..9_u8, 0..4_u8, texts()).prop_map(|(a, b, c)| Step::Topic(a, b, c)),
            9 => (0..9_usize, any::<u64>(), content).prop_map(|(a, b, c)| Step::Message(a, b, c)),
            1 => Just(Step::Flush),
            1 => (".{0,20}", any::<u64>()).prop_map(|(a, b)| Step::Attach(a, b)),
            1 => texts().prop_map(Step::Describe),
        ],
        0..40,
    )
}

fn schema(number: u8) -> (String, String) {
    (
        format!("test/msg/S{number}"),
        format!("float64 v{number}\n"),
    )
}

fn header(channel_id: u16, at: u64) -> MessageHeader {
    MessageHeader {
        channel_id,
        sequence: u32::from(channel_id) + 1,
        log_time: at,
        publish_time: at / 2,
    }
}

fn written(steps: &[Step]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut file = McapFile::begin(&mut bytes, "ros2").unwrap();
    let mut topics = Vec::new();
    for step in steps {
        match step {
            Step::Topic(topic, number, metadata) => {
                let (name, text) = schema(*number);
                let schema = file.schema(&name, "ros2msg", &text).unwrap();
                let topic = format!("/{topic}");
                topics.push(file.channel(schema, &topic, "cdr", metadata).unwrap());
            }
            Step::Message(topic, at, data) => {
                if let Some(channel) = topics.get(*topic) {
                    file.message(header(*channel, *at), data).unwrap();
                }
            }
            Step::Flush => file.flush().unwrap(),
            Step::Attach(text, at) => file.attach("net.net", text, *at).unwrap(),
            Step::Describe(values) => file.describe(values.clone()).unwrap(),
        }
    }
    let length = file.finish().unwrap();
    assert_eq!(length, bytes.len() as u64);
    bytes
}

/// The same by the writer of the crate.
fn written_by_peer(steps: &[Step]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().profile("ros2").library("takt");
    let mut file = options.create(&mut bytes).unwrap();
    let mut topics = Vec::new();
    for step in steps {
        match step {
            Step::Topic(topic, number, metadata) => {
                let (name, text) = schema(*number);
                let schema = file.add_schema(&name, "ros2msg", text.as_bytes()).unwrap();
                let topic = format!("/{topic}");
                topics.push(file.add_channel(schema, &topic, "cdr", metadata).unwrap());
            }
            Step::Message(topic, at, data) => {
                if let Some(channel) = topics.get(*topic) {
                    let header = header(*channel, *at);
                    file.write_to_known_channel(&header, data).unwrap();
                }
            }
            Step::Flush => file.flush().unwrap(),
            Step::Attach(text, at) => {
                let attachment = Attachment {
                    log_time: *at,
                    create_time: *at,
                    name: "net.net".to_owned(),
                    media_type: "text/plain".to_owned(),
                    data: Cow::Borrowed(text.as_bytes()),
                };
                file.attach(&attachment).unwrap();
            }
            Step::Describe(values) => {
                let metadata = Metadata {
                    name: "takt".to_owned(),
                    metadata: values.clone(),
                };
                file.write_metadata(&metadata).unwrap();
            }
        }
    }
    file.finish().unwrap();
    drop(file);
    bytes.into_inner()
}

/// Records outside and inside of chunks, but for those that say where chunks are; all checksums are checked.
fn records(mut bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let options = LinearReaderOptions::default()
        .with_prevalidate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut found = Vec::new();
    while let Some(event) = reader.next_event() {
        match event.unwrap() {
            LinearReadEvent::ReadRequest(wanted) => {
                let read = io::Read::read(&mut bytes, reader.insert(wanted)).unwrap();
                reader.notify_read(read);
            }
            LinearReadEvent::Record { data, opcode } => match opcode {
                op::MESSAGE_INDEX | op::CHUNK_INDEX | op::SUMMARY_OFFSET => {}
                op::DATA_END | op::FOOTER | op::STATISTICS => {}
                op::ATTACHMENT_INDEX | op::METADATA_INDEX => {}
                _ => found.push((opcode, data.to_vec())),
            },
        }
    }
    found
}

/// The first record at an offset: its opcode, and its length with that of its head.
fn record_at(bytes: &[u8], offset: u64) -> (u8, u64) {
    let at = usize::try_from(offset).unwrap();
    let length = bytes[at + 1..at + 9].try_into().unwrap();
    (bytes[at], 9 + u64::from_le_bytes(length))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn files_are_those_of_the_crate(steps in steps()) {
        let (bytes, peer) = (written(&steps), written_by_peer(&steps));
        prop_assert_eq!(records(&bytes), records(&peer));
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let wanted = Summary::read(&peer).unwrap().unwrap();
        prop_assert_eq!(&summary.schemas, &wanted.schemas);
        prop_assert_eq!(&summary.channels, &wanted.channels);
        let (stats, mut wanted_stats) = (summary.stats.clone().unwrap(), wanted.stats.unwrap());
        prop_assert_eq!(stats.chunk_count as usize, summary.chunk_indexes.len());
        // The crate ends a chunk later, before the next message.
        wanted_stats.chunk_count = stats.chunk_count;
        prop_assert_eq!(stats, wanted_stats);

        let mut messages = 0;
        for chunk in &summary.chunk_indexes {
            prop_assert_eq!(record_at(&bytes, chunk.chunk_start_offset), (op::CHUNK, chunk.chunk_length));
            let mut length = 0;
            for offset in chunk.message_index_offsets.values() {
                let (opcode, bytes) = record_at(&bytes, *offset);
                prop_assert_eq!(opcode, op::MESSAGE_INDEX);
                length += bytes;
            }
            prop_assert_eq!(length, chunk.message_index_length);
            if length == 0 {
                // Of topics only; the crate's reader calls its own such chunks damaged.
                continue;
            }
            let indexes = summary.read_message_indexes(&bytes, chunk).unwrap();
            for (channel, entries) in indexes {
                for entry in entries {
                    let message = summary.seek_message(&bytes, chunk, &entry).unwrap();
                    prop_assert_eq!(message.channel.id, channel.id);
                    prop_assert_eq!(message.log_time, entry.log_time);
                    prop_assert!((chunk.message_start_time..=chunk.message_end_time).contains(&entry.log_time));
                    messages += 1;
                }
            }
        }
        prop_assert_eq!(messages, summary.stats.unwrap().message_count);

        let attached = |bytes, index| mcap::read::attachment(bytes, index).unwrap();
        prop_assert_eq!(summary.attachment_indexes.len(), wanted.attachment_indexes.len());
        for (ours, theirs) in summary.attachment_indexes.iter().zip(&wanted.attachment_indexes) {
            prop_assert_eq!(attached(&bytes, ours), attached(&peer, theirs));
            prop_assert_eq!((&ours.name, &ours.media_type), (&theirs.name, &theirs.media_type));
            prop_assert_eq!((ours.length, ours.data_size), (theirs.length, theirs.data_size));
            prop_assert_eq!((ours.log_time, ours.create_time), (theirs.log_time, theirs.create_time));
        }
        let described = |bytes, index| mcap::read::metadata(bytes, index).unwrap();
        prop_assert_eq!(summary.metadata_indexes.len(), wanted.metadata_indexes.len());
        for (ours, theirs) in summary.metadata_indexes.iter().zip(&wanted.metadata_indexes) {
            prop_assert_eq!(described(&bytes, ours), described(&peer, theirs));
            prop_assert_eq!(ours.length, theirs.length);
        }
    }
}

/// The groups of the summary, as pairs of opcode and number of records; each is where the file says.
fn groups(bytes: &[u8]) -> Vec<(u8, usize)> {
    let footer = mcap::read::footer(bytes).unwrap();
    let mut at = footer.summary_offset_start;
    let mut groups = Vec::new();
    while let (op::SUMMARY_OFFSET, length) = record_at(bytes, at) {
        let fields = usize::try_from(at + 9).unwrap()..usize::try_from(at + length).unwrap();
        let record = mcap::parse_record(op::SUMMARY_OFFSET, &bytes[fields]).unwrap();
        let mcap::records::Record::SummaryOffset(group) = record else {
            panic!("{record:?}");
        };
        let (mut begin, end) = (group.group_start, group.group_start + group.group_length);
        let mut count = 0;
        while begin < end {
            let (opcode, length) = record_at(bytes, begin);
            assert_eq!(opcode, group.group_opcode);
            (begin, count) = (begin + length, count + 1);
        }
        assert_eq!(begin, end);
        groups.push((group.group_opcode, count));
        at += length;
    }
    groups
}

#[test]
fn summary_has_offset_of_each_group_that_is_not_empty() {
    let topic = |number| Step::Topic(number, number, BTreeMap::new());
    let mut steps = vec![topic(0), topic(1), topic(1)];
    assert_eq!(groups(&written(&[])), groups(&written_by_peer(&[])));
    steps.extend([Step::Message(0, 1, vec![1]), Step::Attach(String::new(), 1)]);
    steps.extend([
        Step::Flush,
        Step::Describe(BTreeMap::new()),
        Step::Message(1, 2, vec![]),
    ]);
    let found = groups(&written(&steps));
    let wanted = [
        (op::SCHEMA, 2),
        (op::CHANNEL, 2),
        (op::STATISTICS, 1),
        (op::CHUNK_INDEX, 2),
        (op::ATTACHMENT_INDEX, 1),
        (op::METADATA_INDEX, 1),
    ];
    assert_eq!(found, wanted);
    assert_eq!(groups(&written_by_peer(&steps)), wanted);
}

#[test]
fn message_of_no_topic_is_rejected() {
    let mut file = McapFile::begin(Vec::new(), "ros2").unwrap();
    for channel in [0, 1, u16::MAX] {
        assert!(file.message(header(channel, 0), &[]).is_err());
    }
}

#[test]
fn numbers_of_topics_end_at_65535() {
    assert_eq!(number_after(65_534, "topics").unwrap(), u16::MAX);
    let error = number_after(65_535, "topics").unwrap_err();
    assert_eq!(error.to_string(), "a file has at most 65535 topics");
}
