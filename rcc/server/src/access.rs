//! Who may come in: the token that clients give, compared in constant time, and how often one address
//! may give a wrong one. Where a token stands in a request is not known here, and it encrypts nothing:
//! who can listen to the network can read the token.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::net::IpAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use constant_time_eq::constant_time_eq;

/// Least characters of a token.
pub const TOKEN_CHARS_MIN: usize = 16;

/// Most characters of a token.
pub const TOKEN_CHARS_MAX: usize = 256;

/// Wrong tokens that one address may give within [`WRONG_WITHIN`]; then none of its tokens is looked
/// at until that time is over.
pub const WRONG_MAX: u32 = 5;

/// See [`WRONG_MAX`].
pub const WRONG_WITHIN: Duration = Duration::from_secs(60);

/// Addresses whose wrong tokens are remembered; the one that gave its first longest ago makes room.
const ADDRESSES_MAX: usize = 1024;

/// What a client must give to be let in. It is never shown.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// Why a text or file is no token.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum TokenError {
    /// The file cannot be read.
    #[error("cannot read the token file {path}: {source}")]
    File { path: String, source: io::Error },
    /// Others of the host could read it.
    #[error("the token file {path} can be read by everybody (mode {mode:o}): chmod 600 {path}")]
    Readable { path: String, mode: u32 },
    /// Too short, too long, or of characters that some way of giving it does not carry.
    #[error(
        "a token has {TOKEN_CHARS_MIN} to {TOKEN_CHARS_MAX} letters, digits, `-`, `_`, `.` or `~`; \
         make one with: openssl rand -hex 32"
    )]
    Text,
}

impl Token {
    /// Takes a text without the white space around it.
    ///
    /// # Errors
    /// If it is no token.
    pub fn new(text: &str) -> Result<Self, TokenError> {
        let text = text.trim();
        let known = |b: u8| b.is_ascii_alphanumeric() || b"-_.~".contains(&b);
        let long = (TOKEN_CHARS_MIN..=TOKEN_CHARS_MAX).contains(&text.len());
        if long && text.bytes().all(known) {
            Ok(Self(text.to_owned()))
        } else {
            Err(TokenError::Text)
        }
    }

    /// Reads a file that holds a token and nothing else.
    ///
    /// # Errors
    /// If it cannot be read, everybody can read it, or it holds no token.
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let name = || path.display().to_string();
        let file = |source| TokenError::File {
            path: name(),
            source,
        };
        let mode = std::fs::metadata(path).map_err(file)?.permissions().mode() & 0o777;
        if mode & 0o004 != 0 {
            return Err(TokenError::Readable { path: name(), mode });
        }
        Self::new(&std::fs::read_to_string(path).map_err(file)?)
    }

    /// The text, to be sent to a server.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether this is the token that was given, in a time that does not tell how much of it is right.
    fn is(&self, given: &str) -> bool {
        constant_time_eq(self.0.as_bytes(), given.as_bytes())
    }
}

/// Whether a client is let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// It is.
    Admitted,
    /// It gave no token.
    Missing,
    /// It gave another one.
    Wrong,
    /// Its address gave too many wrong ones; this one was not looked at.
    TooMany,
}

/// Lets clients in, or not.
#[derive(Debug)]
pub struct Gate {
    token: Option<Token>,
    wrong: Mutex<BTreeMap<IpAddr, Wrong>>,
}

#[derive(Debug)]
struct Wrong {
    count: u32,
    since: Duration,
}

impl Gate {
    /// A gate that asks for a token, or is open.
    #[must_use]
    pub const fn new(token: Option<Token>) -> Self {
        Self {
            token,
            wrong: Mutex::new(BTreeMap::new()),
        }
    }

    /// Whether nobody needs a token.
    #[must_use]
    pub const fn is_open(&self) -> bool {
        self.token.is_none()
    }

    /// Looks at what a client of that address gave; times count from the same moment.
    pub fn check(&self, address: IpAddr, given: Option<&str>, now: Duration) -> Admission {
        let Some(token) = &self.token else {
            return Admission::Admitted;
        };
        let Some(given) = given else {
            return Admission::Missing;
        };
        let mut wrong = self.wrong.lock().unwrap_or_else(PoisonError::into_inner);
        wrong.retain(|_, w| now < w.since.saturating_add(WRONG_WITHIN));
        if wrong.get(&address).is_some_and(|w| w.count >= WRONG_MAX) {
            return Admission::TooMany;
        }
        if token.is(given) {
            return Admission::Admitted;
        }
        if wrong.len() >= ADDRESSES_MAX && !wrong.contains_key(&address) {
            let first = wrong.iter().min_by_key(|(_, w)| w.since);
            if let Some(first) = first.map(|(address, _)| *address) {
                wrong.remove(&first);
            }
        }
        let entry = wrong.entry(address).or_insert(Wrong {
            count: 0,
            since: now,
        });
        entry.count += 1;
        Admission::Wrong
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const TOKEN: &str = "0123456789abcdef";
    const HERE: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1));
    const THERE: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 0, 2, 2));

    fn gate() -> Gate {
        Gate::new(Some(Token::new(TOKEN).unwrap()))
    }

    #[test]
    fn only_the_whole_token_is_right() {
        let gate = gate();
        let check = |given| gate.check(HERE, given, Duration::ZERO);
        assert_eq!(check(Some(TOKEN)), Admission::Admitted);
        assert_eq!(check(None), Admission::Missing);
        for wrong in ["", "0", "0123456789abcdeF", "0123456789abcdef0"] {
            assert_eq!(check(Some(wrong)), Admission::Wrong, "{wrong}");
        }
        let open = Gate::new(None);
        assert_eq!(open.check(HERE, None, Duration::ZERO), Admission::Admitted);
    }

    #[test]
    fn an_address_that_guesses_is_not_listened_to_for_a_while() {
        let gate = gate();
        for _ in 0..WRONG_MAX {
            let answer = gate.check(HERE, Some("guess"), Duration::ZERO);
            assert_eq!(answer, Admission::Wrong);
        }
        let late = WRONG_WITHIN - Duration::from_nanos(1);
        assert_eq!(gate.check(HERE, Some(TOKEN), late), Admission::TooMany);
        assert_eq!(gate.check(THERE, Some(TOKEN), late), Admission::Admitted);
        assert_eq!(
            gate.check(HERE, Some(TOKEN), WRONG_WITHIN),
            Admission::Admitted
        );
    }

    #[test]
    fn remembered_addresses_are_bounded() {
        let gate = gate();
        for number in 0..5_000_u32 {
            let address = IpAddr::V4(Ipv4Addr::from(number));
            gate.check(address, Some("guess"), Duration::from_millis(number.into()));
        }
        assert_eq!(gate.wrong.lock().unwrap().len(), ADDRESSES_MAX);
    }

    #[test]
    fn tokens_are_long_and_of_plain_characters() {
        assert!(Token::new(&format!(" {TOKEN}\n")).is_ok());
        for bad in [
            "",
            "short",
            "0123456789abcde ",
            "0123456789 abcdef",
            "0123456789äbcdef",
        ] {
            let error = Token::new(bad).unwrap_err().to_string();
            assert!(error.contains("openssl rand -hex 32"), "{bad}: {error}");
        }
        assert!(Token::new(&"a".repeat(TOKEN_CHARS_MAX + 1)).is_err());
        let shown = format!("{:?}", Token::new(TOKEN).unwrap());
        assert!(!shown.contains(TOKEN), "{shown}");
    }

    #[test]
    fn a_file_that_everybody_can_read_is_refused_with_the_remedy() {
        let path = std::env::temp_dir().join(format!("takt-token-{}", std::process::id()));
        std::fs::write(&path, format!("{TOKEN}\n")).unwrap();
        let mode = |mode| {
            let permissions = std::fs::Permissions::from_mode(mode);
            std::fs::set_permissions(&path, permissions).unwrap();
        };
        mode(0o600);
        assert_eq!(Token::read(&path).unwrap().text(), TOKEN);
        mode(0o644);
        let error = Token::read(&path).unwrap_err().to_string();
        assert!(error.contains("chmod 600"), "{error}");
        std::fs::remove_file(&path).unwrap();
        let error = Token::read(&path).unwrap_err().to_string();
        assert!(error.starts_with("cannot read the token file"), "{error}");
    }
}
