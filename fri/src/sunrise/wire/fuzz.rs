//! What must hold for any received bytes, in one function for tests and fuzzers. It makes no input of its own.

use super::{Command, MESSAGE_MAX, Monitoring, unframe};
use crate::generation::Kind;

/// Feeds `bytes` to both decoders, with and without framing; if one accepts, what it read is encoded and read again the same.
///
/// # Panics
/// When a decoder accepts what its encoder cannot give back: a bug of this crate.
pub fn fuzz(bytes: &[u8]) {
    let _named = Kind::of(bytes);
    messages(bytes);
    if let Ok((_, message)) = unframe(bytes) {
        messages(message);
    }
}

fn messages(bytes: &[u8]) {
    // Numbers that were not packed take more room than before when written packed, names of five frames too.
    let mut buf = [0; 4 * MESSAGE_MAX];
    if let Ok(value) = Monitoring::decode(bytes) {
        let len = value.encode(&mut buf);
        let again = len.map(|len| Monitoring::decode(buf.get(..len).unwrap_or_default()));
        assert!(matches!(again, Ok(Ok(again)) if same(&again, &value)));
        let _line = value.to_string();
    }
    if let Ok(value) = Command::decode(bytes) {
        let len = value.encode(&mut buf);
        let again = len.map(|len| Command::decode(buf.get(..len).unwrap_or_default()));
        assert!(matches!(again, Ok(Ok(again)) if same(&again, &value)));
        let _line = value.to_string();
    }
}

/// Equal, or equal but for numbers that are none and so never equal themselves.
fn same<T: PartialEq + std::fmt::Debug>(a: &T, b: &T) -> bool {
    a == b || format!("{a:?}") == format!("{b:?}")
}
