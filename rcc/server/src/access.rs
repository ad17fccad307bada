//! Who is admitted: the token that clients give, compared in constant time, which clients need one, and what
//! becomes of an address that gives wrong ones. Where a token stands in a request is not known here, and it
//! encrypts nothing: who can listen to the network can read the token.

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
pub const TOKEN_CHARS_MAX: usize = 256;

/// Wrong tokens that one address may give within [`WRONG_WITHIN`] and be answered at once; further ones
/// are answered after [`WRONG_PAUSE`]. The right token is admitted at any time: what other programs or pages
/// of the same host do must not lock its holder out.
pub const WRONG_MAX: u32 = 5;

/// See [`WRONG_MAX`].
pub const WRONG_WITHIN: Duration = Duration::from_secs(60);

/// How long an address that gave too many wrong tokens waits for each further answer. With tokens of at least
/// [`TOKEN_CHARS_MIN`] characters and a bounded number of connections this leaves guessing without hope.
pub const WRONG_PAUSE: Duration = Duration::from_secs(1);

/// Most bytes of a token file: a token and blanks around it.
const TOKEN_FILE_BYTES_MAX: u64 = 4096;

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
    /// There is no such file, and none can be made.
    #[error(
        "cannot make the token file {path}: {source}\nhint: name another one as token_file under [controller] of cell.toml"
    )]
    Make { path: String, source: io::Error },
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

    /// Reads the token of a file, or makes a random one and the file (mode 600) if there is none.
    ///
    /// # Errors
    /// If the file cannot be made or read, or holds no token.
    pub fn read_or_make(path: &Path) -> Result<Self, TokenError> {
        let file = |source| TokenError::Make {
            path: path.display().to_string(),
            source,
        };
        let mut options = OpenOptions::new();
        match options.write(true).create_new(true).mode(0o600).open(path) {
            Ok(mut made) => {
                let mut random = [0; 32];
                File::open("/dev/urandom")
                    .and_then(|mut source| source.read_exact(&mut random))
                    .map_err(file)?;
                let text: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
                made.write_all(text.as_bytes()).map_err(file)?;
                Self::new(&text)
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Self::read(path),
            Err(error) => Err(file(error)),
        }
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
    Admitted(Credential),
    /// It gave no token.
    Missing,
    /// It gave another one.
    Wrong,
    /// It gave another one, and its address too many before; it is answered after [`WRONG_PAUSE`].
    TooMany,
}

/// How a client reached the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// By the Unix socket; the kernel said which account it is, and that one is admitted.
    Local,
    /// By the network, loopback included.
    Address(IpAddr),
}

/// What a client was admitted for. Each has places of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Credential {
    /// None: it reached loopback, and loopback is open.
    Loopback,
    /// The right token.
    Token,
    /// Its account, over the Unix socket.
    Account,
}

/// Lets clients in, or not.
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
    /// A gate with that token, if any. `loopback` says whether clients of this host that reach it by the
    /// network need one; without a token they do not.
    #[must_use]
    pub fn new(token: Option<Token>, loopback: Option<Loopback>) -> Self {
        let unless_said = if token.is_some() {
            Loopback::Token
        } else {
            Loopback::Open
        };
        Self {
            token,
            loopback: loopback.unwrap_or(unless_said),
            wrong: Mutex::new(BTreeMap::new()),
        }
    }

    /// What a client is admitted for without a token; `None` if it needs one.
    #[must_use]
    pub fn without_token(&self, peer: Peer) -> Option<Credential> {
        match peer {
            Peer::Local => Some(Credential::Account),
            Peer::Address(address) => (address.to_canonical().is_loopback()
                && self.loopback == Loopback::Open)
                .then_some(Credential::Loopback),
        }
    }

    /// Looks at what a client gave; times count from the same moment. The right token is admitted at any
    /// time, also where none is needed.
    pub fn check(&self, peer: Peer, given: Option<&str>, now: Duration) -> Admission {
        let right = |given: &str| self.token.as_ref().is_some_and(|token| token.is(given));
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
        wrong.retain(|_, w| now < w.since.saturating_add(WRONG_WITHIN));
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
    fn only_the_whole_token_is_right() {
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
        assert_eq!(check(HERE), Admission::Missing, "not of this host");
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
        let later = gate.check(HERE, Some("guess"), WRONG_WITHIN);
        assert_eq!(later, Admission::Wrong);
    }

    #[test]
    fn loopback_needs_the_token_unless_it_is_open() {
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
        let made = Token::read_or_make(&path).unwrap();
        assert_eq!(Token::read_or_make(&path).unwrap(), made);
        let made_mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!((made.text().len(), made_mode & 0o777), (64, 0o600));
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn endless_token_file_is_refused() {
        let error = Token::read(Path::new("/dev/zero")).unwrap_err();
        // It can be read by everybody, which is found first.
        assert!(matches!(error, TokenError::Readable { .. }), "{error}");
        let path = std::env::temp_dir().join(format!("takt-long-token-{}", std::process::id()));
        std::fs::write(&path, "a".repeat(5000)).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        let error = Token::read(&path).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(error, TokenError::Text), "{error}");
    }
}
