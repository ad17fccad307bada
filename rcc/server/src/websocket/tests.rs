//! Frames of clients in pieces, bounds, and robustness against any bytes.

use proptest::prelude::*;
use tungstenite::protocol::frame::FrameHeader;
use tungstenite::protocol::frame::coding::{Control, Data, OpCode};

use super::*;

fn client_frame(opcode: OpCode, is_final: bool, mask: Option<[u8; 4]>, payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let header = FrameHeader {
        opcode,
        is_final,
        mask,
        ..FrameHeader::default()
    };
    header.format(payload.len() as u64, &mut out).unwrap();
    let mask = mask.unwrap_or_default();
    out.extend(payload.iter().zip(mask.iter().cycle()).map(|(b, m)| b ^ m));
    out
}

/// All events in frames that arrive in pieces of `piece` bytes.
fn events(stream: &[u8], piece: usize) -> Vec<Event> {
    let mut reader = FrameReader::default();
    let mut out = Vec::new();
    for piece in stream.chunks(piece) {
        reader.push(piece);
        while let Some(event) = reader.poll_event().unwrap() {
            out.push(event);
        }
    }
    out
}

const TEXT: OpCode = OpCode::Data(Data::Text);
const CONTINUE: OpCode = OpCode::Data(Data::Continue);

#[test]
fn masked_and_fragmented_frames_are_read() {
    let long = "x".repeat(300);
    let stream = [
        client_frame(TEXT, true, None, b"one"),
        client_frame(TEXT, true, Some([1, 2, 3, 4]), b"masked"),
        client_frame(TEXT, false, None, b"in "),
        client_frame(OpCode::Control(Control::Ping), true, None, b"p7"),
        client_frame(CONTINUE, false, None, b"three "),
        client_frame(CONTINUE, true, None, b"parts"),
        client_frame(OpCode::Control(Control::Pong), true, None, b"ignored"),
        client_frame(TEXT, true, None, long.as_bytes()),
        client_frame(OpCode::Control(Control::Close), true, None, b"BYE"),
    ]
    .concat();
    let message = |text: &str| Event::Message(text.to_owned());
    let expected = [
        message("one"),
        message("masked"),
        Event::Ping(b"p7".to_vec()),
        message("in three parts"),
        message(&long),
        Event::Close(b"BYE".to_vec()),
    ];
    for piece in 1..=stream.len() {
        assert_eq!(events(&stream, piece), expected, "{piece}");
    }
}

#[test]
fn invalid_utf8_keeps_connection() {
    let event = events(&client_frame(TEXT, true, None, b"t=nse(\"\xe4\")"), 64);
    assert_eq!(event, [Event::Message("t=nse(\"\u{fffd}\")".to_owned())]);
}

#[test]
fn frames_are_bounded() {
    let error = |stream: &[u8]| {
        let mut reader = FrameReader::default();
        reader.push(stream);
        while reader.poll_event()?.is_some() {}
        Ok::<_, FrameError>(())
    };
    // The header's length is sufficient: the payload is not waited for.
    let long = [0x81, 127, 0, 0, 0, 0, 0, 0x80, 0, 1];
    assert!(matches!(error(&long), Err(FrameError::TooLong { .. })));
    let longest = [0x81, 127, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff];
    assert!(matches!(error(&longest), Err(FrameError::TooLong { .. })));
    let half = vec![b'x'; MESSAGE_BYTES_MAX / 2 + 1];
    let halves = client_frame(TEXT, false, None, &half).repeat(2);
    assert!(matches!(error(&halves), Err(FrameError::TooLong { .. })));
    let ping = client_frame(OpCode::Control(Control::Ping), true, None, &[0; 126]);
    assert!(matches!(error(&ping), Err(FrameError::Control)));
    let part = client_frame(OpCode::Control(Control::Ping), false, None, b"");
    assert!(matches!(error(&part), Err(FrameError::Control)));
    assert!(matches!(error(&[0xc1, 0]), Err(FrameError::Reserved)));
    assert!(matches!(error(&[0x83, 0]), Err(FrameError::Header(_))));
}

#[test]
fn server_frames_are_unfragmented_and_unmasked() {
    let mut out = Vec::new();
    write_frame(TEXT, b"ab", &mut out);
    write_frame(OpCode::Control(Control::Close), b"BYE", &mut out);
    assert_eq!(out, b"\x81\x02ab\x88\x03BYE");
    let mut long = Vec::new();
    write_frame(TEXT, &[b'x'; 300], &mut long);
    assert_eq!(&long[..4], b"\x81\x7e\x01\x2c");
}

proptest! {
    #[test]
    fn random_frames_do_not_panic(data in proptest::collection::vec(any::<u8>(), 0..200)) {
        fuzz(&data);
    }
}
