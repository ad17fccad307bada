//! Admission control: which clients need a token, its comparison in constant time, and the delay for addresses that
//! send wrong ones. Where a request carries the token is not known here. Nothing is encrypted: who can capture the
//! network traffic can read the token.

pub(crate) mod origin;

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::net::IpAddr;
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use constant_time_eq::constant_time_eq;
use takt_core::Loopback;

/// Least characters of a token.
pub const TOKEN_CHARS_MIN: usize = 16;

/// Most characters of a token.
pub(crate) const TOKEN_CHARS_MAX: usize = 256;

/// Wrong tokens per address within [`WRONG_WINDOW`] that are answered at once; further ones are answered after
/// [`WRONG_DELAY`]. The right token is always admitted: other programs or web pages of the same host must not lock
/// its holder out.
pub(crate) const WRONG_MAX: u32 = 5;

/// See [`WRONG_MAX`].
pub(crate) const WRONG_WINDOW: Duration = Duration::from_secs(60);

/// Delay of each further answer to an address that sent too many wrong tokens. With tokens of at least
/// [`TOKEN_CHARS_MIN`] characters and a bounded number of connections, guessing is hopeless.
pub const WRONG_DELAY: Duration = Duration::from_secs(1);

/// Most bytes of a token file: a token and white space around it.
const TOKEN_FILE_BYTES_MAX: u64 = 4096;

/// Addresses whose wrong tokens are counted; when full, the entry with the oldest first token is dropped.
const ADDRESSES_MAX: usize = 1024;

/// The secret that a client must send to be admitted. `Debug` does not print it.
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
    /// The file does not exist and cannot be created.
    #[error(
        "cannot create the token file {path}: {source}\nhint: name another one as token_file under [controller] of cell.toml"
    )]
    Create { path: String, source: io::Error },
    /// Other users of the host could read it.
    #[error("the token file {path} is world-readable (mode {mode:o})\nhint: chmod 600 {path}")]
    Readable { path: String, mode: u32 },
    /// Too short, too long, or with characters that cannot be sent in every place where a token may be.
    #[error(
        "a token has {TOKEN_CHARS_MIN} to {TOKEN_CHARS_MAX} letters, digits, `-`, `_`, `.` or `~`\n\
        hint: create one with openssl rand -hex 32"
    )]
    Text,
}

impl Token {
    /// Checks a text; white space around it is removed.
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

    /// Reads a file that contains a token and nothing else.
    ///
    /// # Errors
    /// If it cannot be read, is world-readable, or contains no token.
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
        let mut text = String::new();
        let opened = File::open(path).map_err(file)?;
        let read = opened
            .take(TOKEN_FILE_BYTES_MAX)
            .read_to_string(&mut text)
            .map_err(file)?;
        if read as u64 == TOKEN_FILE_BYTES_MAX {
            return Err(TokenError::Text);
        }
        Self::new(&text)
    }

    /// Reads the token of a file; if there is no file, creates it (mode 600) with a random token.
    ///
    /// # Errors
    /// If the file cannot be created or read, or contains no token.
    pub fn read_or_create(path: &Path) -> Result<Self, TokenError> {
        let file = |source| TokenError::Create {
            path: path.display().to_string(),
            source,
        };
        let mut options = OpenOptions::new();
        match options.write(true).create_new(true).mode(0o600).open(path) {
            Ok(mut created) => {
                let mut random = [0; 32];
                File::open("/dev/urandom")
                    .and_then(|mut source| source.read_exact(&mut random))
                    .map_err(file)?;
                let text: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
                created.write_all(text.as_bytes()).map_err(file)?;
                Self::new(&text)
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Self::read(path),
            Err(error) => Err(file(error)),
        }
    }

    /// The text to be sent to a server.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether `given` is this token, in a time that does not depend on how much of it is right.
    fn matches(&self, given: &str) -> bool {
        constant_time_eq(self.0.as_bytes(), given.as_bytes())
    }
}

/// Result of the admission check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// The client is admitted.
    Admitted(Credential),
    /// It sent no token.
    Missing,
    /// It sent a wrong one.
    Wrong,
    /// It sent a wrong one after too many from the same address; the answer is sent after [`WRONG_DELAY`].
    TooMany,
}

/// Where a client's connection comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// The Unix socket; the kernel reported its account, and that account is admitted.
    Local,
    /// The network, loopback included.
    Address(IpAddr),
}

/// On which grounds a client was admitted. Each has connection slots of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Credential {
    /// None: it is connected to loopback, and loopback is open.
    Loopback,
    /// The right token.
    Token,
    /// The account at the Unix socket.
    Account,
}

/// Admits clients or rejects them.
#[derive(Debug)]
pub struct Gate {
    token: Option<Token>,
    loopback: Loopback,
    wrong: Mutex<BTreeMap<IpAddr, Wrong>>,
}

#[derive(Debug)]
struct Wrong {
    count: u32,
    since: Duration,
}

impl Gate {
    /// A gate that requires this token, if any. `loopback` selects whether network clients of this host need it too;
    /// by default they do if there is one.
    pub fn new(token: Option<Token>, loopback: Option<Loopback>) -> Self {
        let default = if token.is_some() {
            Loopback::Token
        } else {
            Loopback::Open
        };
        Self {
            token,
            loopback: loopback.unwrap_or(default),
            wrong: Mutex::new(BTreeMap::new()),
        }
    }

    /// On which grounds a client is admitted without a token; `None` if it needs one.
    pub(crate) fn without_token(&self, peer: Peer) -> Option<Credential> {
        match peer {
            Peer::Local => Some(Credential::Account),
            Peer::Address(address) => (address.to_canonical().is_loopback()
                && self.loopback == Loopback::Open)
                .then_some(Credential::Loopback),
        }
    }

    /// Checks the token that a client sent; all `now` count from the same moment. The right token is always admitted,
    /// even where none is needed.
    pub fn check(&self, peer: Peer, given: Option<&str>, now: Duration) -> Admission {
        let right = |given: &str| {
            self.token
                .as_ref()
                .is_some_and(|token| token.matches(given))
        };
        match given {
            Some(given) if right(given) => Admission::Admitted(Credential::Token),
            None => match self.without_token(peer) {
                Some(credential) => Admission::Admitted(credential),
                None => Admission::Missing,
            },
            Some(_) => match self.without_token(peer) {
                Some(credential) => Admission::Admitted(credential),
                None => self.count_wrong(peer, now),
            },
        }
    }

    fn count_wrong(&self, peer: Peer, now: Duration) -> Admission {
        let Peer::Address(address) = peer else {
            return Admission::Wrong;
        };
        let mut wrong = self.wrong.lock().unwrap_or_else(PoisonError::into_inner);
        wrong.retain(|_, w| now < w.since.saturating_add(WRONG_WINDOW));
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
        entry.count = entry.count.saturating_add(1);
        if entry.count > WRONG_MAX {
            Admission::TooMany
        } else {
            Admission::Wrong
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::Ipv4Addr;

    const TOKEN: &str = "0123456789abcdef";
    const HERE: Peer = Peer::Address(IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1)));
    const LOOPBACK: Peer = Peer::Address(IpAddr::V4(Ipv4Addr::LOCALHOST));

    fn gate() -> Gate {
        Gate::new(Some(Token::new(TOKEN).unwrap()), None)
    }

    #[test]
    fn only_whole_token_is_admitted() {
        let gate = gate();
        let check = |given| gate.check(HERE, given, Duration::ZERO);
        assert_eq!(check(Some(TOKEN)), Admission::Admitted(Credential::Token));
        assert_eq!(check(None), Admission::Missing);
        for wrong in ["", "0", "0123456789abcdeF", "0123456789abcdef0"] {
            assert_eq!(check(Some(wrong)), Admission::Wrong, "{wrong}");
        }
        let open = Gate::new(None, None);
        let check = |peer| open.check(peer, None, Duration::ZERO);
        let anyone = Admission::Admitted(Credential::Loopback);
        assert_eq!(check(LOOPBACK), anyone);
        assert_eq!(check(HERE), Admission::Missing, "not from this host");
    }

    #[test]
    fn right_token_after_many_wrong_ones_is_admitted() {
        let gate = gate();
        let guess = || gate.check(HERE, Some("guess"), Duration::ZERO);
        for _ in 0..WRONG_MAX {
            assert_eq!(guess(), Admission::Wrong);
        }
        assert_eq!(guess(), Admission::TooMany);
        let right = gate.check(HERE, Some(TOKEN), Duration::ZERO);
        assert_eq!(right, Admission::Admitted(Credential::Token));
        let later = gate.check(HERE, Some("guess"), WRONG_WINDOW);
        assert_eq!(later, Admission::Wrong);
    }

    #[test]
    fn loopback_requires_token_unless_open() {
        let token = || Some(Token::new(TOKEN).unwrap());
        let needs = |token, loopback| {
            let gate = Gate::new(token, loopback);
            gate.without_token(LOOPBACK).is_none()
        };
        assert!(needs(token(), None));
        assert!(!needs(token(), Some(Loopback::Open)));
        assert!(!needs(None, None));
        assert!(needs(None, Some(Loopback::Token)));
        let mapped = Peer::Address("::ffff:127.0.0.1".parse().unwrap());
        let open = Gate::new(token(), Some(Loopback::Open));
        assert_eq!(open.without_token(mapped), Some(Credential::Loopback));
        assert_eq!(open.without_token(HERE), None);
        assert_eq!(open.without_token(Peer::Local), Some(Credential::Account));
    }

    #[test]
    fn remembered_addresses_are_bounded() {
        let gate = gate();
        for number in 0..5_000_u32 {
            let address = IpAddr::V4(Ipv4Addr::from(number));
            let now = Duration::from_millis(number.into());
            gate.check(Peer::Address(address), Some("guess"), now);
        }
        assert_eq!(gate.wrong.lock().unwrap().len(), ADDRESSES_MAX);
    }

    #[test]
    fn token_length_and_characters_are_checked() {
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
    fn world_readable_token_file_is_rejected() {
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
        let made = Token::read_or_create(&path).unwrap();
        assert_eq!(Token::read_or_create(&path).unwrap(), made);
        let made_mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!((made.text().len(), made_mode & 0o777), (64, 0o600));
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn endless_token_file_is_rejected() {
        let error = Token::read(Path::new("/dev/zero")).unwrap_err();
        // The mode is checked before the contents.
        assert!(matches!(error, TokenError::Readable { .. }), "{error}");
        let path = std::env::temp_dir().join(format!("takt-long-token-{}", std::process::id()));
        std::fs::write(&path, "a".repeat(5000)).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        let error = Token::read(&path).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(error, TokenError::Text), "{error}");
    }
}
