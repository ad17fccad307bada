//! What must hold for any received bytes, in one function for tests and fuzzers. It generates no input itself.

use super::{Cmd, Msr};

/// Passes `bytes` to both decoders; if one accepts, encoding and decoding again must give the same bytes.
///
/// # Panics
/// If a decoder accepts bytes that its encoder cannot reproduce: a bug of this crate.
pub fn fuzz(bytes: &[u8]) {
    if let Ok(msr) = Msr::decode(bytes) {
        let mut once = [0; Msr::LEN];
        let mut twice = [0; Msr::LEN];
        assert_eq!(msr.encode(&mut once), Ok(Msr::LEN));
        let again = Msr::decode(&once).map(|msr| msr.encode(&mut twice));
        assert_eq!(again, Ok(Ok(Msr::LEN)));
        assert_eq!(once, twice);
    }
    if let Ok(cmd) = Cmd::decode(bytes) {
        let mut once = [0; Cmd::LEN];
        let mut twice = [0; Cmd::LEN];
        assert_eq!(cmd.encode(&mut once), Ok(Cmd::LEN));
        let again = Cmd::decode(&once).map(|cmd| cmd.encode(&mut twice));
        assert_eq!(again, Ok(Ok(Cmd::LEN)));
        assert_eq!(once, twice);
    }
}
