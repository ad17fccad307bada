//! Key expressions of the fleet: `takt/<cell>/…`. It knows no network.
//!
//! | key | kind | content |
//! |---|---|---|
//! | `takt/<cell>/alive` | liveliness token | the controller runs and is reachable |
//! | `takt/<cell>/session/<id>/alive` | liveliness token | a command session is open |
//! | `takt/<cell>/device/<name>/alive` | liveliness token | the device answers |
//! | `takt/<cell>/info` | publication with history, query | version, boot id, devices, periods, addresses |
//! | `takt/<cell>/clock` | publication | time scale and its quality |
//! | `takt/<cell>/device/<name>/state` | publication with history | state and cause |
//! | `takt/<cell>/device/<name>/joints` | publication while matched | positions, in batches |
//! | `takt/<cell>/net/<id>/state`, `…/net/<id>/value/<name>` | publication with history | life cycle; out values |
//! | `takt/<cell>/machine/<id>/state` | publication with history | components and states |
//! | `takt/<cell>/thread/<name>` | publication | cycles, overruns, load |
//! | `takt/<cell>/log`, `takt/<cell>/findings` | publication with history | lines; what is wrong |
//! | `takt/<cell>/resource/<path>` | query | an HTTP resource |
//! | `takt/<cell>/cmd/session`, `takt/<cell>/cmd/directio` | query | commands |
//! | `takt/<cell>/start/{prepare,commit,abort,status}` | query | coordinated starts |
//! | `takt/<cell>/start/<txn>/{armed,beat}` | publication | arms and beats of a coordinated start |

use std::fmt;

/// First chunk of all keys.
pub const ROOT: &str = "takt";

pub use crate::config::CELL_NAME_BYTES_MAX;

/// All keys of all cells.
pub const ALL: &str = "takt/**";

/// The liveliness tokens of all cells.
pub const ALL_ALIVE: &str = "takt/*/alive";

/// The name of a cell: one chunk of a key, of ASCII letters, digits, `-`, `_` and `.`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CellName(String);

/// Why a text is no name of a cell.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no name of a cell\nhint: 1 to {CELL_NAME_BYTES_MAX} ASCII letters, digits, `-`, `_` and `.`"
)]
pub struct CellNameError(pub String);

impl CellName {
    /// Checks a name.
    ///
    /// # Errors
    /// If it has other characters, or too many.
    pub fn new(name: &str) -> Result<Self, CellNameError> {
        if crate::config::is_cell_name(name) {
            Ok(Self(name.to_owned()))
        } else {
            Err(CellNameError(name.chars().take(80).collect()))
        }
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for CellName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::str::FromStr for CellName {
    type Err = CellNameError;

    fn from_str(name: &str) -> Result<Self, CellNameError> {
        Self::new(name)
    }
}

/// The keys of one cell.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellKeys {
    cell: CellName,
}

impl CellKeys {
    /// The keys of this cell.
    #[must_use]
    pub const fn new(cell: CellName) -> Self {
        Self { cell }
    }

    /// The cell.
    #[must_use]
    pub const fn cell(&self) -> &CellName {
        &self.cell
    }

    /// The key with this rest; chunks of it are not escaped.
    #[must_use]
    pub fn of(&self, rest: &str) -> String {
        format!("{ROOT}/{}/{rest}", self.cell)
    }

    /// Liveliness token of the cell.
    #[must_use]
    pub fn alive(&self) -> String {
        self.of("alive")
    }

    /// Liveliness token of a command session.
    #[must_use]
    pub fn session_alive(&self, session: &str) -> String {
        self.of(&format!("session/{}/alive", chunk(session)))
    }

    /// Liveliness token of a device.
    #[must_use]
    pub fn device_alive(&self, device: &str) -> String {
        self.of(&format!("device/{}/alive", chunk(device)))
    }

    /// What the cell is.
    #[must_use]
    pub fn info(&self) -> String {
        self.of("info")
    }

    /// Its clock.
    #[must_use]
    pub fn clock(&self) -> String {
        self.of("clock")
    }

    /// State of a device.
    #[must_use]
    pub fn device_state(&self, device: &str) -> String {
        self.of(&format!("device/{}/state", chunk(device)))
    }

    /// Joints of a device.
    #[must_use]
    pub fn device_joints(&self, device: &str) -> String {
        self.of(&format!("device/{}/joints", chunk(device)))
    }

    /// State of a net, by its identifier.
    #[must_use]
    pub fn net_state(&self, net: &str) -> String {
        self.of(&format!("net/{}/state", chunk(net)))
    }

    /// An out value of a net.
    #[must_use]
    pub fn net_value(&self, net: &str, value: &str) -> String {
        self.of(&format!("net/{}/value/{}", chunk(net), chunk(value)))
    }

    /// State of a machine.
    #[must_use]
    pub fn machine_state(&self, machine: &str) -> String {
        self.of(&format!("machine/{}/state", chunk(machine)))
    }

    /// Figures of a net thread.
    #[must_use]
    pub fn thread(&self, thread: &str) -> String {
        self.of(&format!("thread/{}", chunk(thread)))
    }

    /// Lines of the log.
    #[must_use]
    pub fn log(&self) -> String {
        self.of("log")
    }

    /// What is wrong now.
    #[must_use]
    pub fn findings(&self) -> String {
        self.of("findings")
    }

    /// Opens, renews and closes command sessions.
    #[must_use]
    pub fn cmd_session(&self) -> String {
        self.of("cmd/session")
    }

    /// Takes DirectIO lines.
    #[must_use]
    pub fn cmd_directio(&self) -> String {
        self.of("cmd/directio")
    }

    /// The root of HTTP resources.
    #[must_use]
    pub fn resources(&self) -> String {
        self.of("resource")
    }

    /// An HTTP resource, such as `nets` or `devices/left`; its chunks must be escaped already.
    #[must_use]
    pub fn resource(&self, path: &str) -> String {
        let path: Vec<_> = path.split('/').filter(|part| !part.is_empty()).collect();
        if path.is_empty() {
            self.resources()
        } else {
            self.of(&format!("resource/{}", path.join("/")))
        }
    }

    /// A query of coordinated starts: `prepare`, `commit`, `abort` or `status`.
    #[must_use]
    pub fn start(&self, step: &str) -> String {
        self.of(&format!("start/{}", chunk(step)))
    }

    /// Where this cell publishes that it is armed for a start.
    #[must_use]
    pub fn start_armed(&self, transaction: &str) -> String {
        self.of(&format!("start/{}/armed", chunk(transaction)))
    }

    /// The rest of a key of this cell.
    #[must_use]
    pub fn rest<'a>(&self, key: &'a str) -> Option<&'a str> {
        let (cell, rest) = parts(key)?;
        (cell == self.cell.as_str()).then_some(rest)
    }
}

/// The cell of a key, and what follows it.
#[must_use]
pub fn parts(key: &str) -> Option<(&str, &str)> {
    let rest = key.strip_prefix(ROOT)?.strip_prefix('/')?;
    let (cell, rest) = rest.split_once('/')?;
    crate::config::is_cell_name(cell).then_some((cell, rest))
}

/// The name of the cell whose liveliness token this is.
#[must_use]
pub fn cell_of_alive(key: &str) -> Option<&str> {
    parts(key).and_then(|(cell, rest)| (rest == "alive").then_some(cell))
}

/// Whether a key expression is one key: it has no wildcard. A query to anything else changes nothing, since it would reach several cells.
#[must_use]
pub fn is_exact(key: &str) -> bool {
    !key.contains(['*', '$'])
}

/// A text as one chunk: what separates chunks or is a wildcard becomes `%` and two hexadecimal digits, as in URLs.
#[must_use]
pub fn chunk(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for (at, c) in text.char_indices() {
        let is_first_at = at == 0 && c == '@';
        if is_first_at || matches!(c, '/' | '*' | '$' | '?' | '#' | '%') || c.is_control() {
            let mut bytes = [0; 4];
            for byte in c.encode_utf8(&mut bytes).bytes() {
                out.push_str(&format!("%{byte:02X}"));
            }
        } else {
            out.push(c);
        }
    }
    if out.is_empty() {
        // An empty chunk is no key; a text of `%` alone is `%25`.
        out.push('%');
    }
    out
}

/// The text of a chunk; what is no escape stays as it is.
#[must_use]
pub fn text_of(chunk: &str) -> String {
    if chunk == "%" {
        return String::new();
    }
    let bytes = chunk.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while let Some(byte) = bytes.get(at) {
        let hex = chunk.get(at + 1..at + 3).filter(|_| *byte == b'%');
        match hex.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(escaped) => {
                out.push(escaped);
                at += 3;
            }
            None => {
                out.push(*byte);
                at += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn keys() -> CellKeys {
        CellKeys::new(CellName::new("weld3").unwrap())
    }

    #[test]
    fn keys_have_cell_and_escaped_names() {
        let keys = keys();
        assert_eq!(keys.alive(), "takt/weld3/alive");
        assert_eq!(
            keys.device_state("left/arm *"),
            "takt/weld3/device/left%2Farm %2A/state"
        );
        assert_eq!(
            keys.net_value("rpinet1", ""),
            "takt/weld3/net/rpinet1/value/%"
        );
        assert_eq!(
            keys.resource("/devices//left/"),
            "takt/weld3/resource/devices/left"
        );
        assert_eq!(keys.resource("/"), keys.resources());
        assert_eq!(keys.start_armed("t1"), "takt/weld3/start/t1/armed");
        assert_eq!(keys.rest("takt/weld3/cmd/session"), Some("cmd/session"));
        assert_eq!(keys.rest("takt/weld4/cmd/session"), None);
    }

    #[test]
    fn cell_name_that_is_no_chunk_is_rejected() {
        let long = "x".repeat(CELL_NAME_BYTES_MAX + 1);
        for name in ["", "a/b", "*", "a$", "@a", "a b", "é", "a?", "a#b", &long] {
            assert!(CellName::new(name).is_err(), "{name}");
        }
        for name in ["weld3", "line-2.cell_a", "A", &long[1..]] {
            assert_eq!(CellName::new(name).unwrap().as_str(), name);
        }
    }

    #[test]
    fn wildcard_key_is_not_exact() {
        assert!(is_exact("takt/weld3/cmd/session"));
        for key in ["takt/*/cmd/session", "takt/**", "takt/weld$*/cmd/session"] {
            assert!(!is_exact(key), "{key}");
        }
    }

    #[test]
    fn alive_key_names_cell() {
        assert_eq!(cell_of_alive("takt/weld3/alive"), Some("weld3"));
        for key in [
            "takt/weld3/info",
            "takt//alive",
            "tact/weld3/alive",
            "takt/*/alive",
            "takt",
        ] {
            assert_eq!(cell_of_alive(key), None, "{key}");
        }
    }

    proptest! {
        #[test]
        fn chunk_is_one_chunk_and_keeps_text(text: String) {
            let chunk = chunk(&text);
            prop_assert!(!chunk.is_empty() && !chunk.starts_with('@'));
            let is_plain = !chunk.contains(['/', '*', '$', '?', '#']);
            prop_assert!(is_plain, "{}", chunk);
            prop_assert_eq!(text_of(&chunk), text);
        }
    }
}
