//! Identifiers and states of nets as encoded on the wire. Every module may use them; they use
//! none.

use std::fmt;
use std::str::FromStr;

/// Identifier of a net, `rpinet0` and so on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NetId(pub u32);

/// Identifier of a session, `s1` and so on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionId(pub u32);

impl SessionId {
    /// Session of nets without a session.
    pub const NONE: Self = Self(0);
}

/// Maximum length of a device name, in characters.
const DEVICE_NAME_MAX: usize = 64;

/// Checks a device name: any text of 1 to 64 characters without control characters. `rcc` is the controller itself.
///
/// # Errors
/// With the reason and the name.
pub fn check_device_name(name: &str) -> Result<(), String> {
    let reason = if name.is_empty() {
        "is empty"
    } else if name.chars().count() > DEVICE_NAME_MAX {
        "is longer than 64 characters"
    } else if name.contains(char::is_control) {
        "contains a control character"
    } else if name == "rcc" {
        "is that of the controller itself"
    } else {
        return Ok(());
    };
    Err(format!("device name {name:?} {reason}"))
}

/// The text is not an identifier of this kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no such identifier")]
pub struct NoId;

fn number(text: &str, prefix: &str) -> Result<u32, NoId> {
    let digits = text.strip_prefix(prefix).ok_or(NoId)?;
    let canonical = digits == "0" || !digits.starts_with(['0', '+']);
    digits.parse().ok().filter(|_| canonical).ok_or(NoId)
}

impl FromStr for NetId {
    type Err = NoId;

    fn from_str(text: &str) -> Result<Self, NoId> {
        number(text, "rpinet").map(Self)
    }
}

impl FromStr for SessionId {
    type Err = NoId;

    fn from_str(text: &str) -> Result<Self, NoId> {
        number(text, "s").map(Self)
    }
}

impl fmt::Display for NetId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "rpinet{}", self.0)
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "s{}", self.0)
    }
}

/// The life cycle of a net (Vistein et al. 2014, figure 3).
///
/// ```text
/// Loading ─▶ Ready ─▶ (Scheduled) ─▶ Running ─▶ (Cancelling) ─▶ Terminated ─▶ Unloaded
///    └─▶ Rejected
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NetState {
    /// It is being checked and made ready.
    Loading,
    /// It has faults.
    Rejected,
    /// It can be started.
    Ready,
    /// A rule will start it.
    Scheduled,
    /// It is evaluated in every cycle.
    Running,
    /// Its cancel was requested and it is still evaluated.
    Cancelling,
    /// It has ended and released its resources.
    Terminated,
    /// It was removed.
    Unloaded,
}

impl NetState {
    /// All states; the index of each is its number.
    pub const ALL: [Self; 8] = [
        Self::Loading,
        Self::Rejected,
        Self::Ready,
        Self::Scheduled,
        Self::Running,
        Self::Cancelling,
        Self::Terminated,
        Self::Unloaded,
    ];

    /// Its number in samples.
    #[must_use]
    pub const fn number(self) -> u64 {
        self as u64
    }

    /// Its name on the wire.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Loading => "LOADING",
            Self::Rejected => "REJECTED",
            Self::Ready => "READY",
            Self::Scheduled => "SCHEDULED",
            Self::Running => "RUNNING",
            Self::Cancelling => "CANCELLING",
            Self::Terminated => "TERMINATED",
            Self::Unloaded => "UNLOADED",
        }
    }
}

impl fmt::Display for NetState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_have_one_spelling() {
        assert_eq!("rpinet17".parse(), Ok(NetId(17)));
        assert_eq!("s0".parse(), Ok(SessionId::NONE));
        for text in [
            "rpinet",
            "rpinet01",
            "rpinet+1",
            "net1",
            "rpinet99999999999",
        ] {
            assert_eq!(text.parse::<NetId>(), Err(NoId), "{text}");
        }
    }
}
