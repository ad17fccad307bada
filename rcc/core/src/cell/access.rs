//! Admission of clients, and what happens to the nets of lost clients. The server applies
//! these settings.

use serde::Deserialize;

use super::ControllerConfig;

/// Maximum number of names and of origins of a cell.
const NAMES_MAX: usize = 64;

/// What happens to the nets of a session when the connection that opened it is lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnLoss {
    /// They continue, and the session stays for the next connection.
    Keep,
    /// They are cancelled; after 2 s those that still run are aborted, and the session ends.
    #[default]
    End,
}

impl OnLoss {
    /// Its name in configurations and messages.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Keep => "keep",
            Self::End => "end",
        }
    }

    /// The variant of a name.
    #[must_use]
    pub fn of_word(word: &str) -> Option<Self> {
        [Self::Keep, Self::End]
            .into_iter()
            .find(|p| p.word() == word)
    }
}

/// What a client on loopback (127.0.0.1, ::1) needs to be admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Loopback {
    /// Nothing: clients without a token are admitted, and so is every account of this host.
    Open,
    /// The token.
    Token,
}

/// Checks that names and origins have the form that a browser sends.
pub(super) fn check(controller: &ControllerConfig) -> Result<(), String> {
    let lists = [
        ("controller.hosts", &controller.hosts),
        ("controller.origins", &controller.origins),
    ];
    lists
        .into_iter()
        .try_for_each(|(key, names)| check_count(key, names))?;
    if let Some(host) = controller
        .hosts
        .iter()
        .find(|h| is_blank(h) || h.contains('/'))
    {
        return Err(format!(
            "controller.hosts: `{host}` is no host\nhint: write a name or address as in the address line of a \
             browser, such as \"robot\" or \"robot:8080\""
        ));
    }
    check_origins("controller.origins", &controller.origins, &[])
}

fn is_blank(name: &str) -> bool {
    name.is_empty() || name.contains(|c: char| c.is_whitespace())
}

fn check_count(key: &str, names: &[String]) -> Result<(), String> {
    if names.len() <= NAMES_MAX {
        return Ok(());
    }
    let found = names.len();
    Err(format!(
        "{key} has {found} entries; at most {NAMES_MAX} are taken"
    ))
}

/// Checks that these are origins of pages, or one of the others.
pub(super) fn check_origins(key: &str, origins: &[String], others: &[&str]) -> Result<(), String> {
    check_count(key, origins)?;
    let is_origin = |origin: &str| {
        let host = origin.split_once("://").map_or("", |(_, host)| host);
        let is_page = !is_blank(origin) && !host.is_empty() && !host.contains('/');
        is_page || others.contains(&origin)
    };
    match origins.iter().find(|o| !is_origin(o)) {
        None => Ok(()),
        Some(origin) => Err(format!(
            "{key}: `{origin}` is no origin\nhint: write scheme and host of the page, such as \
             \"http://localhost:3000\""
        )),
    }
}

#[cfg(test)]
mod tests {
    use crate::cell::CellConfig;

    #[test]
    fn malformed_hosts_and_origins_are_rejected() {
        let parse = |line: &str| CellConfig::parse(&format!("[controller]\n{line}"), &[]);
        let good = "hosts = [\"robot\", \"robot:8080\"]\norigins = [\"http://localhost:3000\"]\n\
            loopback = \"token\"\nsocket = \"\"\nsocket_group = \"takt\"\non_loss = \"keep\"";
        assert!(parse(good).is_ok(), "{:?}", parse(good));
        for (line, said) in [
            ("hosts = [\"http://robot\"]", "`http://robot` is no host"),
            ("hosts = [\"\"]", "`` is no host"),
            ("origins = [\"robot\"]", "`robot` is no origin"),
            ("origins = [\"http://a/b\"]", "`http://a/b` is no origin"),
            ("loopback = \"maybe\"", "unknown variant `maybe`"),
        ] {
            let error = parse(line).unwrap_err().to_string();
            assert!(error.contains(said), "{line}: {error}");
        }
        let many = format!("hosts = [{}]", "\"a\",".repeat(65));
        let error = parse(&many).unwrap_err().to_string();
        assert!(error.contains("at most 64 are taken"), "{error}");
    }
}
