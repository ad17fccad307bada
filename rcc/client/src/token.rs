//! The secret that admits a client: read from a file, compared in constant time. Where a request carries it is not known
//! here. Nothing is encrypted: who can capture the network traffic can read the token.

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use constant_time_eq::constant_time_eq;

/// Least characters of a token.
pub const TOKEN_CHARS_MIN: usize = 16;

/// Most characters of a token.
pub const TOKEN_CHARS_MAX: usize = 256;

/// Most bytes of a token file: a token and white space around it.
const TOKEN_FILE_BYTES_MAX: u64 = 4096;

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
    pub fn matches(&self, given: &str) -> bool {
        constant_time_eq(self.0.as_bytes(), given.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

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
