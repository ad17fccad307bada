//! What must hold for any file, in one function for tests and fuzzers. It generates no input itself.

use super::{Frames, PACKET_MAX, Reader};

/// Reads `bytes` as a recording to its end.
///
/// # Panics
/// If the reader continues after an error, or returns more than the file holds.
pub fn fuzz(bytes: &[u8]) {
    let Ok(mut reader) = Reader::new(bytes) else {
        return;
    };
    let mut total = 0;
    while let Some(packet) = reader.next() {
        let Ok(packet) = packet else {
            assert!(
                reader.next().is_none(),
                "the reader continues after an error"
            );
            break;
        };
        assert!(
            packet.data.len() <= PACKET_MAX as usize,
            "a packet beyond the bound"
        );
        total += packet.data.len();
    }
    assert!(total <= bytes.len(), "more data than the file has");
    let _cut = reader.cut().map(|cut| cut.to_string());
    if let Ok(frames) = Frames::new(bytes) {
        let _count = frames.flatten().count();
    }
}
