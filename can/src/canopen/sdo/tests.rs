//! Client and server connected by a lossy line, and each with hand-made messages.

use std::time::Duration;

use proptest::prelude::*;
use takt_cia402::dictionary::{Access, DataType, Dictionary, Entry, Object};

use super::*;

const MS: Duration = Duration::from_millis(1);
const TEXT: Address = Address::new(0x2000, 0);
const NUMBER: Address = Address::new(0x2001, 0);

fn dictionary(text: &[u8]) -> Dictionary {
    let mut value = Entry::of("text", DataType::Domain, Access::ReadWrite, text.to_vec());
    value.max_len = 4000;
    Dictionary::new(vec![
        Object::var(0x2000, value),
        Object::var(
            0x2001,
            Entry::number("number", Access::ReadWrite, 7_u32).within(0, 1000),
        ),
        Object::var(0x2002, Entry::number("constant", Access::Const, 7_u16)),
    ])
    .unwrap()
}

struct Pair {
    client: Client,
    server: Server,
    d: Dictionary,
    now: Duration,
    /// Number of the message from client to server that is lost, counted from 0.
    lost: Option<usize>,
    sent: usize,
}

impl Pair {
    fn new(text: &[u8]) -> Self {
        Self {
            client: Client::new(4000, 50 * MS),
            server: Server::new(4000, 100 * MS),
            d: dictionary(text),
            now: Duration::ZERO,
            lost: None,
            sent: 0,
        }
    }

    /// Runs a transfer to its end.
    fn run(&mut self, first: Message) -> Outcome {
        let mut to_server = Some(first);
        for _ in 0..20_000 {
            self.now += MS / 10;
            let mut outcome = None;
            if to_server.is_none() {
                let polled = self.client.poll(self.now);
                (to_server, outcome) = (polled.send, polled.outcome);
            }
            let mut to_client = None;
            if let Some(message) = to_server.take() {
                let lost = self.lost == Some(self.sent);
                self.sent += 1;
                if !lost {
                    let (d, now) = (&mut self.d, self.now);
                    to_client = self.server.handle(&message, d, &mut (), now);
                }
            }
            if let Some(outcome) = outcome {
                return outcome;
            }
            let to_client = to_client.or_else(|| self.server.poll(self.now));
            if let Some(message) = to_client {
                let progress = self.client.handle(&message, self.now);
                to_server = progress.send;
                if let Some(outcome) = progress.outcome {
                    if let Some(last) = to_server {
                        let _ = self.server.handle(&last, &mut self.d, &mut (), self.now);
                    }
                    return outcome;
                }
            }
        }
        panic!("no end");
    }

    fn read(&mut self, address: Address, blocks: bool) -> Outcome {
        let first = self.client.read(address, blocks, self.now);
        self.run(first)
    }

    fn write(&mut self, address: Address, value: &[u8], blocks: bool) -> Outcome {
        let first = self.client.write(address, value, blocks, self.now).unwrap();
        self.run(first)
    }
}

fn pattern(len: usize) -> Vec<u8> {
    (0..=250).cycle().take(len).collect()
}

#[test]
fn sdo_values_of_every_length_survive_every_transfer_type() {
    for len in (0..30).chain([880, 888, 889, 890, 896, 1777, 1778, 1779, 3994, 4000]) {
        for blocks in [false, true] {
            let value = pattern(len);
            let mut pair = Pair::new(&value);
            assert_eq!(pair.read(TEXT, blocks), Outcome::Read, "{len} {blocks}");
            assert_eq!(pair.client.value(), value, "{len} {blocks}");
            let mut pair = Pair::new(b"");
            let outcome = pair.write(TEXT, &value, blocks);
            assert_eq!(outcome, Outcome::Written, "{len} {blocks}");
            assert_eq!(pair.d.bytes(TEXT), Some(&value[..]), "{len} {blocks}");
            assert!(pair.client.is_idle() && pair.server.is_idle());
        }
    }
}

#[test]
fn sdo_lost_block_segment_is_sent_again() {
    let value = pattern(2000);
    for lost in 2..100 {
        let mut pair = Pair::new(b"");
        pair.lost = Some(lost);
        assert_eq!(pair.write(TEXT, &value, true), Outcome::Written, "{lost}");
        assert_eq!(pair.d.bytes(TEXT), Some(&value[..]), "{lost}");
    }
}

#[test]
fn sdo_timeout_aborts_both_sides_next_transfer_succeeds() {
    for (lost, blocks) in [(0, false), (1, false), (0, true)] {
        let mut pair = Pair::new(&pattern(100));
        pair.lost = Some(lost);
        let outcome = pair.read(TEXT, blocks);
        assert_eq!(outcome, Outcome::GaveUp(AbortCode::TimedOut), "{lost}");
        pair.lost = None;
        assert_eq!(pair.read(TEXT, blocks), Outcome::Read, "{lost}");
    }
    let mut pair = Pair::new(&pattern(100));
    let first = Request::Upload { address: TEXT }.encode();
    let _ = pair
        .server
        .handle(&first, &mut pair.d, &mut (), Duration::ZERO);
    assert_eq!(pair.server.poll_timeout(), Some(100 * MS));
    let abort = pair
        .server
        .poll(100 * MS)
        .and_then(|m| Response::decode(&m));
    let code = AbortCode::TimedOut;
    let address = TEXT;
    assert_eq!(abort, Some(Response::Abort { address, code }));
    assert_eq!(pair.server.poll(101 * MS), None);
}

#[test]
fn sdo_abort_codes_reach_client_in_every_transfer() {
    let constant = Address::new(0x2002, 0);
    let nowhere = Address::new(0x3000, 0);
    for (address, value, code) in [
        (NUMBER, &[0xE9, 3, 0, 0][..], AbortCode::TooHigh),
        (NUMBER, &[1, 0], AbortCode::TooShort),
        (NUMBER, &[0; 6], AbortCode::TooLong),
        (constant, &[1, 0], AbortCode::ReadOnly),
        (nowhere, &[1, 0], AbortCode::NoObject),
        (Address::new(0x2001, 1), &[1, 0], AbortCode::NoSubIndex),
    ] {
        for blocks in [false, true] {
            let mut pair = Pair::new(b"");
            let outcome = pair.write(address, value, blocks);
            assert_eq!(outcome, Outcome::Refused(code), "{address} {blocks}");
        }
    }
    let mut pair = Pair::new(b"");
    for blocks in [false, true] {
        let outcome = pair.read(nowhere, blocks);
        assert_eq!(outcome, Outcome::Refused(AbortCode::NoObject));
    }
}

fn abort_code(messages: &[Message]) -> Option<AbortCode> {
    let mut server = Server::new(100, 100 * MS);
    let mut d = dictionary(&pattern(50));
    let mut last = None;
    for message in messages {
        last = server.handle(message, &mut d, &mut (), Duration::ZERO);
        while server.poll(Duration::ZERO).is_some() {}
    }
    match last.and_then(|m| Response::decode(&m)) {
        Some(Response::Abort { code, .. }) => Some(code),
        _ => None,
    }
}

#[test]
fn sdo_server_invalid_message_gets_specific_abort() {
    let address = TEXT;
    let upload = Request::Upload { address }.encode();
    let next = |toggle| Request::UploadSegment { toggle }.encode();
    let big = Request::Download {
        address,
        data: Initiate::Segmented(Some(101)),
    };
    let begin = Request::Download {
        address,
        data: Initiate::Segmented(Some(10)),
    };
    let part = |toggle, last| {
        let data = Bytes::new(b"abc");
        Request::DownloadSegment { toggle, last, data }.encode()
    };
    let block = |block| {
        let (crc, switch) = (true, 0);
        Request::BlockUpload {
            address,
            crc,
            block,
            switch,
        }
        .encode()
    };
    let ack = |sequence, block| Request::BlockUploadAck { sequence, block }.encode();
    let go = Request::BlockUploadStart.encode();
    for (messages, code) in [
        (vec![[0xE0; 8]], AbortCode::CommandSpecifier),
        (vec![next(false)], AbortCode::CommandSpecifier),
        (vec![upload, next(true)], AbortCode::Toggle),
        (vec![upload, next(false), next(false)], AbortCode::Toggle),
        (vec![big.encode()], AbortCode::OutOfMemory),
        (vec![begin.encode(), part(true, false)], AbortCode::Toggle),
        (vec![begin.encode(), part(false, true)], AbortCode::TooShort),
        (vec![block(0)], AbortCode::BlockSize),
        (vec![block(128)], AbortCode::BlockSize),
        (vec![block(4), go, ack(5, 4)], AbortCode::SequenceNumber),
        (vec![block(4), go, ack(4, 0)], AbortCode::BlockSize),
        (vec![go], AbortCode::CommandSpecifier),
    ] {
        assert_eq!(abort_code(&messages), Some(code), "{messages:02X?}");
    }
    assert_eq!(abort_code(&[upload, next(false)]), None);
}

#[test]
fn sdo_block_checksum_error_aborts() {
    let mut server = Server::new(100, 100 * MS);
    let mut d = dictionary(b"before");
    let begin = Request::BlockDownload {
        address: TEXT,
        crc: true,
        size: Some(5),
    };
    let segment = BlockSegment {
        last: true,
        sequence: 1,
        data: *b"hello\0\0",
    };
    let wrong = Request::BlockDownloadEnd { unused: 2, crc: 1 };
    let mut last = None;
    for message in [begin.encode(), segment.encode(), wrong.encode()] {
        last = server.handle(&message, &mut d, &mut (), Duration::ZERO);
    }
    let code = AbortCode::Crc;
    let address = TEXT;
    let abort = last.and_then(|m| Response::decode(&m));
    assert_eq!(abort, Some(Response::Abort { address, code }));
    assert_eq!(d.bytes(TEXT), Some(&b"before"[..]));
}

/// Frames as masters and drives exchange them, byte by byte.
#[test]
fn sdo_golden_messages_are_decoded() {
    let statusword = Address::new(0x6041, 0);
    let controlword = Address::new(0x6040, 0);
    let word = |bytes: &[u8]| Initiate::Expedited(Bytes::new(bytes));
    for (raw, request, text) in [
        (
            [0x40, 0x41, 0x60, 0, 0, 0, 0, 0],
            Request::Upload {
                address: statusword,
            },
            "read 6041h:00",
        ),
        (
            [0x2B, 0x40, 0x60, 0, 6, 0, 0, 0],
            Request::Download {
                address: controlword,
                data: word(&[6, 0]),
            },
            "write 6040h:00 = 06 00",
        ),
        (
            [0x80, 0x40, 0x60, 0, 0, 0, 4, 5],
            Request::Abort {
                address: controlword,
                code: AbortCode::TimedOut,
            },
            "abort 6040h:00: the transfer timed out (0504 0000h)",
        ),
    ] {
        assert_eq!(Request::decode(&raw), Some(request));
        assert_eq!(request.encode(), raw);
        assert_eq!(request.to_string(), text);
    }
    for (raw, response, text) in [
        (
            [0x4B, 0x41, 0x60, 0, 0x37, 0x02, 0, 0],
            Response::Upload {
                address: statusword,
                data: word(&[0x37, 0x02]),
            },
            "6041h:00 = 37 02",
        ),
        (
            [0x60, 0x40, 0x60, 0, 0, 0, 0, 0],
            Response::Download {
                address: controlword,
            },
            "6040h:00 ok",
        ),
    ] {
        assert_eq!(Response::decode(&raw), Some(response));
        assert_eq!(response.encode(), raw);
        assert_eq!(response.to_string(), text);
    }
}

proptest! {
    #[test]
    fn sdo_server_answers_any_message(messages in prop::collection::vec(any::<[u8; 8]>(), 1..40)) {
        let mut server = Server::new(64, 100 * MS);
        let mut client = Client::new(64, 100 * MS);
        let mut d = dictionary(&pattern(60));
        let mut now = Duration::ZERO;
        let _ = client.read(TEXT, messages[0][7] & 1 == 1, now);
        for message in &messages {
            now += MS;
            let _ = server.handle(message, &mut d, &mut (), now);
            for _ in 0..200 {
                if server.poll(now).is_none() {
                    break;
                }
            }
            let _ = client.handle(message, now);
            let _ = client.poll(now);
            prop_assert!(client.value().len() <= 70);
            if let Some(request) = Request::decode(message) {
                let again = Request::decode(&request.encode());
                prop_assert_eq!(again, Some(request));
                let _ = request.to_string();
            }
            if let Some(response) = Response::decode(message) {
                let again = Response::decode(&response.encode());
                prop_assert_eq!(again, Some(response));
                let _ = response.to_string();
            }
        }
    }
}

/// An answer as a letter or an abort code.
fn answer(message: Option<Message>) -> String {
    let Some(message) = message else {
        return "-".to_owned();
    };
    match Response::decode(&message) {
        None => format!("{message:02X?}"),
        Some(Response::Download { .. }) => "down".to_owned(),
        Some(Response::DownloadSegment { .. }) => "seg".to_owned(),
        Some(Response::Upload { .. }) => "up".to_owned(),
        Some(Response::UploadSegment { .. }) => "upseg".to_owned(),
        Some(Response::BlockDownload { .. }) => "bdown".to_owned(),
        Some(Response::BlockDownloadAck { sequence, .. }) => format!("ack{sequence}"),
        Some(Response::BlockDownloadEnd) => "bdend".to_owned(),
        Some(Response::BlockUpload { .. }) => "bup".to_owned(),
        Some(Response::BlockUploadEnd { .. }) => "bupend".to_owned(),
        Some(Response::Abort { code, .. }) => format!("{:08X}", code.raw()),
    }
}

/// A request of each kind, and an unknown one.
fn requests() -> Vec<(&'static str, Message)> {
    let address = TEXT;
    let (number, data) = (
        Initiate::Expedited(Bytes::new(&[5, 0, 0, 0])),
        Bytes::new(b"abc"),
    );
    let segmented = Initiate::Segmented(Some(10));
    let (crc, block, switch) = (true, 4, 0);
    let code = AbortCode::General;
    [
        (
            "download",
            Request::Download {
                address: NUMBER,
                data: number,
            },
        ),
        (
            "in segments",
            Request::Download {
                address,
                data: segmented,
            },
        ),
        (
            "segment",
            Request::DownloadSegment {
                toggle: false,
                last: false,
                data,
            },
        ),
        ("upload", Request::Upload { address: NUMBER }),
        ("next segment", Request::UploadSegment { toggle: false }),
        (
            "block download",
            Request::BlockDownload {
                address,
                crc,
                size: Some(5),
            },
        ),
        ("its end", Request::BlockDownloadEnd { unused: 2, crc: 0 }),
        (
            "block upload",
            Request::BlockUpload {
                address,
                crc,
                block,
                switch,
            },
        ),
        ("go", Request::BlockUploadStart),
        (
            "acknowledge",
            Request::BlockUploadAck { sequence: 4, block },
        ),
        ("end", Request::BlockUploadEnd),
        ("abort", Request::Abort { address, code }),
    ]
    .map(|(name, request)| (name, request.encode()))
    .into_iter()
    .chain([("nothing", [0xE0; 8])])
    .collect()
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn sdo_server_every_state_with_every_request() {
    let all = requests();
    let of = |name: &str| all.iter().find(|(n, _)| *n == name).unwrap().1;
    let text = Request::Upload { address: TEXT }.encode();
    let last = BlockSegment {
        last: true,
        sequence: 1,
        data: *b"hello\0\0",
    }
    .encode();
    let whole = Request::BlockUpload {
        address: TEXT,
        crc: true,
        block: 127,
        switch: 0,
    }
    .encode();
    let all_came = Request::BlockUploadAck {
        sequence: 8,
        block: 127,
    }
    .encode();
    let wrong = "05040001";
    // Within a block there are no commands: all messages but an abort are segments, numbered by the first byte.
    let table = [
        ("idle", vec![], "down down W up W bdown W bup W W W - W"),
        (
            "download",
            vec![of("in segments")],
            "down down seg up W bdown W bup W W W - W",
        ),
        (
            "upload",
            vec![text],
            "down down W up upseg bdown W bup W W W - W",
        ),
        (
            "block download",
            vec![of("block download")],
            "- - - - - ack0 ack0 ack0 ack0 ack0 ack0 - ack0",
        ),
        (
            "its end",
            vec![of("block download"), last],
            "down down W up W bdown 05040004 bup W W W - W",
        ),
        (
            "block upload",
            vec![of("block upload")],
            "down down W up W bdown W bup - W W - W",
        ),
        (
            "its blocks",
            vec![of("block upload"), of("go")],
            "down down W up W bdown W bup W - W - W",
        ),
        (
            "its last",
            vec![whole, of("go"), all_came],
            "down down W up W bdown W bup W W - - W",
        ),
    ];
    for (state, messages, answers) in table {
        let answers: Vec<_> = answers
            .split(' ')
            .map(|a| if a == "W" { wrong } else { a })
            .collect();
        assert_eq!(answers.len(), all.len());
        for ((name, request), expected) in all.iter().zip(answers) {
            let mut server = Server::new(100, 100 * MS);
            let mut d = dictionary(&pattern(50));
            for message in &messages {
                let _ = server.handle(message, &mut d, &mut (), Duration::ZERO);
                while server.poll(Duration::ZERO).is_some() {}
            }
            let actual = answer(server.handle(request, &mut d, &mut (), Duration::ZERO));
            assert_eq!(actual, expected, "{state}: {name}");
        }
    }
}

/// The reaction of a client: its next request and the outcome.
fn progress(progress: &Progress) -> String {
    let sent = progress
        .send
        .map(|message| match Request::decode(&message) {
            None => "segment".to_owned(),
            Some(Request::Abort { code, .. }) => format!("{:08X}", code.raw()),
            Some(Request::DownloadSegment { .. }) => "seg".to_owned(),
            Some(Request::UploadSegment { .. }) => "next".to_owned(),
            Some(Request::BlockDownloadEnd { .. }) => "end".to_owned(),
            Some(Request::BlockUploadStart) => "go".to_owned(),
            Some(Request::BlockUploadAck { sequence, .. }) => format!("ack{sequence}"),
            Some(Request::BlockUploadEnd) => "bye".to_owned(),
            Some(other) => format!("{other:?}"),
        });
    let outcome = progress.outcome.as_ref().map(|outcome| match outcome {
        Outcome::Read => "read".to_owned(),
        Outcome::Written => "written".to_owned(),
        Outcome::Refused(_) | Outcome::GaveUp(_) => format!("{outcome:?}"),
    });
    match (sent, outcome) {
        (None, None) => "-".to_owned(),
        (Some(one), None) | (None, Some(one)) => one,
        (Some(sent), Some(outcome)) => format!("{sent}+{outcome}"),
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn sdo_client_every_state_with_every_answer() {
    let address = TEXT;
    let (small, data) = (Initiate::Expedited(Bytes::new(b"abc")), Bytes::new(b"abc"));
    let (large, crc, block) = (Initiate::Segmented(Some(10)), true, 4);
    let code = AbortCode::General;
    let all = [
        ("download", Response::Download { address }),
        ("segment", Response::DownloadSegment { toggle: false }),
        (
            "upload",
            Response::Upload {
                address,
                data: small,
            },
        ),
        (
            "in segments",
            Response::Upload {
                address,
                data: large,
            },
        ),
        (
            "its segment",
            Response::UploadSegment {
                toggle: false,
                last: false,
                data,
            },
        ),
        (
            "block download",
            Response::BlockDownload {
                address,
                crc,
                block,
            },
        ),
        (
            "acknowledge",
            Response::BlockDownloadAck { sequence: 2, block },
        ),
        ("end", Response::BlockDownloadEnd),
        (
            "block upload",
            Response::BlockUpload {
                address,
                crc,
                size: Some(10),
            },
        ),
        ("its end", Response::BlockUploadEnd { unused: 4, crc: 0 }),
        ("abort", Response::Abort { address, code }),
    ]
    .map(|(name, response)| (name, response.encode()));
    let of = |name: &str| all.iter().find(|(n, _)| *n == name).unwrap().1;
    let last = BlockSegment {
        last: true,
        sequence: 1,
        data: *b"hello\0\0",
    }
    .encode();
    let wrong = "05040001+GaveUp(CommandSpecifier)";
    let refused = "Refused(General)";
    let table = [
        (
            "idle",
            true,
            false,
            0,
            vec![of("upload")],
            "- - - - - - - - - - -",
        ),
        (
            "download",
            false,
            false,
            2,
            vec![],
            "written W W W W W W W W W R",
        ),
        (
            "its segments",
            false,
            false,
            10,
            vec![of("download")],
            "W seg W W W W W W W W R",
        ),
        (
            "upload",
            true,
            false,
            0,
            vec![],
            "W W read next W W W W W W R",
        ),
        (
            "its segments",
            true,
            false,
            0,
            vec![of("in segments")],
            "W W W W next W W W W W R",
        ),
        (
            "block download",
            false,
            true,
            10,
            vec![],
            "W W W W W - W W W W R",
        ),
        (
            "its blocks",
            false,
            true,
            10,
            vec![of("block download")],
            "W W W W W W end W W W R",
        ),
        (
            "its end",
            false,
            true,
            10,
            vec![of("block download"), of("acknowledge")],
            "W W W W W W W written W W R",
        ),
        // A server may answer a short value without blocks.
        (
            "block upload",
            true,
            true,
            0,
            vec![],
            "W W read next W W W W go W R",
        ),
        // Within a block there are no commands.
        (
            "its blocks",
            true,
            true,
            0,
            vec![of("block upload")],
            "- - - - - ack0 ack0 ack0 ack0 ack0 R",
        ),
        (
            "its end",
            true,
            true,
            0,
            vec![of("block upload"), last],
            "W W W W W W W W W 05040004+GaveUp(Crc) R",
        ),
    ];
    for (state, reads, blocks, len, messages, answers) in table {
        let answers: Vec<_> = answers.split(' ').collect();
        assert_eq!(answers.len(), all.len());
        for ((name, response), expected) in all.iter().zip(answers) {
            let mut client = Client::new(100, 50 * MS);
            if reads {
                let _ = client.read(TEXT, blocks, Duration::ZERO);
            } else {
                let _ = client.write(TEXT, &pattern(len), blocks, Duration::ZERO);
            }
            for message in &messages {
                let _ = client.handle(message, Duration::ZERO);
                while client.poll(Duration::ZERO).send.is_some() {}
            }
            let expected = match expected {
                "W" => wrong,
                "R" => refused,
                other => other,
            };
            let actual = progress(&client.handle(response, Duration::ZERO));
            assert_eq!(actual, expected, "{state}: {name}");
        }
    }
}
