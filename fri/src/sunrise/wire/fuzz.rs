//! What must hold for any received bytes, in one function for tests and fuzzers. It generates no input itself.

use super::{Command, MESSAGE_MAX, Monitoring, unframe};
use crate::generation::Kind;

/// Passes `bytes` to both decoders, framed and bare; what one accepts must be the same after encoding and decoding.
///
/// # Panics
/// If a decoder accepts what its encoder cannot reproduce: a bug of this crate.
pub fn fuzz(bytes: &[u8]) {
    let _named = Kind::of(bytes);
    messages(bytes);
    if let Ok((_, message)) = unframe(bytes) {
        messages(message);
    }
}

fn messages(bytes: &[u8]) {
    // Unpacked numbers get longer when written packed, and so do names of five frames.
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

/// Equal, or equal except for NaN.
fn same<T: PartialEq + std::fmt::Debug>(a: &T, b: &T) -> bool {
    a == b || format!("{a:?}") == format!("{b:?}")
}
