//! What must hold for any file, in one function for tests and fuzzers. It generates no input itself.

use super::{Frames, PACKET_MAX, Reader};

/// Reads `bytes` as a recording to its end.
///
/// # Panics
/// If the reader does not end, or returns more than the file holds.
pub fn fuzz(bytes: &[u8]) {
    let Ok(mut reader) = Reader::new(bytes) else {
        return;
    };
    let (mut total, mut count) = (0, 0);
    for packet in reader.by_ref() {
        count += 1;
        assert!(count <= bytes.len(), "more records than bytes");
        let Ok(packet) = packet else { continue };
        assert!(
            packet.data.len() <= PACKET_MAX as usize,
            "a packet beyond the bound"
        );
        total += packet.data.len();
    }
    assert!(
        reader.next().is_none(),
        "the reader continues after its end"
    );
    assert!(total <= bytes.len(), "more data than the file has");
    let _cut = reader.cut().map(|cut| cut.to_string());
    if let Ok(frames) = Frames::new(bytes) {
        let _count = frames.flatten().count();
    }
}
