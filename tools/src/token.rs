//! The source of the token of a controller and its tools. It is never printed, and is no argument, since all users of
//! the host can read those.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use takt_client::Token;
use takt_server::Loopback;

/// The token itself.
const TOKEN: &str = "TAKT_TOKEN";
/// A file that holds it.
const TOKEN_FILE: &str = "TAKT_TOKEN_FILE";
/// Where systemd puts credentials, and the name of ours: `LoadCredential=takt-token:/etc/takt/token`.
const CREDENTIALS: &str = "CREDENTIALS_DIRECTORY";
const CREDENTIAL: &str = "takt-token";

/// Name of the token file that a controller makes, in its state directory.
const MADE: &str = "token";

/// The token that a controller requires: of the cell's file, else of the file that the environment names, the systemd
/// credential, or the environment itself. If there is none and loopback needs one, of a file in the state directory,
/// which is made once.
pub(crate) fn of_controller(
    cell: Option<&Path>,
    loopback: Option<Loopback>,
) -> anyhow::Result<Option<Token>> {
    let environment = |name: &str| std::env::var_os(name);
    let found = find(cell, true, &environment)?;
    if found.is_some() || loopback != Some(Loopback::Token) {
        return Ok(found);
    }
    let path = made_path(&environment).context(
        "loopback = \"token\", but there is no token and no state directory to make one in\n\
         hint: name a file as token_file under [controller] of cell.toml",
    )?;
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory)
            .with_context(|| format!("cannot make {}", directory.display()))?;
    }
    Ok(Some(Token::read_or_create(&path)?))
}

/// The token that a tool gives: of the file of its option, else of the environment, else, to a controller of
/// this host, of the file that such a one made.
pub(crate) fn of_client(
    option: Option<&Path>,
    server: Option<&str>,
) -> anyhow::Result<Option<Token>> {
    let environment = |name: &str| std::env::var_os(name);
    let found = find(option, false, &environment)?;
    // Another host is not given the token of this one.
    let is_here = server.is_none_or(|s| {
        let host = s.rsplit_once(':').map_or(s, |(host, _)| host);
        host == "localhost" || host == "[::1]" || host.starts_with("127.")
    });
    if found.is_some() || !is_here {
        return Ok(found);
    }
    let made = made_path(&environment).and_then(|path| Token::read(&path).ok());
    Ok(made)
}

/// Where a controller makes its token file: in the directory that the service manager gave it, else in that of
/// the account's programs.
fn made_path(environment: &dyn Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    Some(state_directory_of(environment)?.join(MADE))
}

/// Where a controller keeps what outlives it: the directory that the service manager gave it, else that of the account's
/// programs.
pub(crate) fn state_directory() -> Option<PathBuf> {
    state_directory_of(&|name: &str| std::env::var_os(name))
}

fn state_directory_of(environment: &dyn Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let named = |name| environment(name).filter(|value| !value.is_empty());
    if let Some(directory) = named("STATE_DIRECTORY") {
        return Some(PathBuf::from(directory));
    }
    let state = match (named("XDG_STATE_HOME"), named("HOME")) {
        (Some(state), _) => PathBuf::from(state),
        (None, Some(home)) => Path::new(&home).join(".local/state"),
        (None, None) => return None,
    };
    Some(state.join("takt"))
}

fn find(
    given: Option<&Path>,
    credentials: bool,
    environment: &dyn Fn(&str) -> Option<OsString>,
) -> anyhow::Result<Option<Token>> {
    let given = given.map(Path::to_owned);
    let named = || environment(TOKEN_FILE).map(PathBuf::from);
    let credential = || {
        let directory = environment(CREDENTIALS).filter(|_| credentials)?;
        Some(Path::new(&directory).join(CREDENTIAL)).filter(|path| path.exists())
    };
    if let Some(file) = given.or_else(named).or_else(credential) {
        return Ok(Some(Token::read(&file)?));
    }
    let Some(text) = environment(TOKEN) else {
        return Ok(None);
    };
    let text = text.to_str().context("TAKT_TOKEN is no text")?;
    Token::new(text).map(Some).context("TAKT_TOKEN")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    #[test]
    fn token_first_source_wins() {
        let directory = std::env::temp_dir().join(format!("takt-tokens-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        let file = |name: &str, token: &str| {
            let path = directory.join(name);
            std::fs::write(&path, token).unwrap();
            let mode = std::fs::Permissions::from_mode(0o600);
            std::fs::set_permissions(&path, mode).unwrap();
            path
        };
        let cell = file("cell", "of-the-cell-aaaaa");
        let named = file("named", "of-the-file-aaaaa");
        file(CREDENTIAL, "of-systemd-aaaaaa");
        let found = |cell: Option<&Path>, credentials, known: &[&str]| {
            let environment = |name: &str| match name {
                _ if !known.contains(&name) => None,
                TOKEN => Some("of-the-environment".into()),
                TOKEN_FILE => Some(named.clone().into()),
                CREDENTIALS => Some(directory.clone().into()),
                _ => None,
            };
            let token = find(cell, credentials, &environment).unwrap();
            token.map(|token| token.text().to_owned())
        };
        let all = [TOKEN, TOKEN_FILE, CREDENTIALS];
        let text = |text: &str| Some(text.to_owned());
        assert_eq!(found(Some(&cell), true, &all), text("of-the-cell-aaaaa"));
        assert_eq!(found(None, true, &all), text("of-the-file-aaaaa"));
        let without_file = [TOKEN, CREDENTIALS];
        assert_eq!(found(None, true, &without_file), text("of-systemd-aaaaaa"));
        assert_eq!(
            found(None, false, &without_file),
            text("of-the-environment")
        );
        assert_eq!(found(None, true, &[]), None);
        std::fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn token_file_is_made_in_state_directory() {
        let path = |known: &[(&str, &str)]| {
            let environment = |name: &str| {
                let found = known.iter().find(|(n, _)| *n == name);
                found.map(|(_, value)| OsString::from(*value))
            };
            made_path(&environment).map(|path| path.display().to_string())
        };
        let text = |text: &str| Some(text.to_owned());
        let home = ("HOME", "/of/a");
        let service = ("STATE_DIRECTORY", "/var/lib/takt");
        assert_eq!(path(&[home, service]), text("/var/lib/takt/token"));
        let state = ("XDG_STATE_HOME", "/state");
        assert_eq!(path(&[home, state]), text("/state/takt/token"));
        assert_eq!(path(&[home]), text("/of/a/.local/state/takt/token"));
        assert_eq!(path(&[]), None);
    }

    #[test]
    fn token_invalid_error_names_its_source() {
        let environment = |name: &str| (name == TOKEN).then(|| "short".into());
        let error = find(None, false, &environment).unwrap_err();
        assert!(
            format!("{error:#}").starts_with("TAKT_TOKEN: a token has 16 to 256"),
            "{error:#}"
        );
    }
}
