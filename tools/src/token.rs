//! Where the token comes from that a controller asks for, and that tools give it. It is never shown, and
//! it is no argument: those can be read by everybody on the host.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use takt_server::Token;

/// The token itself.
const TOKEN: &str = "TAKT_TOKEN";
/// A file that holds it.
const TOKEN_FILE: &str = "TAKT_TOKEN_FILE";
/// Where systemd puts credentials, and the name of ours: `LoadCredential=takt-token:/etc/takt/token`.
const CREDENTIALS: &str = "CREDENTIALS_DIRECTORY";
const CREDENTIAL: &str = "takt-token";

/// The token that a controller asks for: of the cell's file, else of the file that the environment
/// names, the systemd credential, or the environment itself.
pub(crate) fn of_controller(cell: Option<&Path>) -> anyhow::Result<Option<Token>> {
    find(cell, true, &|name| std::env::var_os(name))
}

/// The token that a tool gives: of the file of its option, else of the environment.
pub(crate) fn of_client(option: Option<&Path>) -> anyhow::Result<Option<Token>> {
    find(option, false, &|name| std::env::var_os(name))
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
    fn the_nearest_place_counts() {
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
        let look = |cell: Option<&Path>, credentials, known: &[&str]| {
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
        assert_eq!(look(Some(&cell), true, &all), text("of-the-cell-aaaaa"));
        assert_eq!(look(None, true, &all), text("of-the-file-aaaaa"));
        let without_file = [TOKEN, CREDENTIALS];
        assert_eq!(look(None, true, &without_file), text("of-systemd-aaaaaa"));
        assert_eq!(look(None, false, &without_file), text("of-the-environment"));
        assert_eq!(look(None, true, &[]), None);
        std::fs::remove_dir_all(&directory).unwrap();
    }

    #[test]
    fn a_bad_token_is_told_with_its_place() {
        let environment = |name: &str| (name == TOKEN).then(|| "short".into());
        let error = find(None, false, &environment).unwrap_err();
        assert!(
            format!("{error:#}").starts_with("TAKT_TOKEN: a token has 16 to 256"),
            "{error:#}"
        );
    }
}
