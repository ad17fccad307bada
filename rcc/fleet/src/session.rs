//! Sessions on the network, over zenoh. No real-time thread calls anything here: all of it allocates, locks and blocks.

pub mod member;
pub mod observer;
pub mod remote;
pub mod together;
pub mod tunnel;

pub use zenoh;

use zenoh::Wait as _;

use crate::config::Entries;

/// Why a session cannot be opened, or a call on it fails.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "each field is named in its variant's text")]
pub enum SessionError {
    #[error("{key} = {value} is refused: {why}")]
    Config {
        key: &'static str,
        value: String,
        why: String,
    },
    #[error("{what}: {why}")]
    Zenoh { what: &'static str, why: String },
}

impl SessionError {
    fn of(what: &'static str) -> impl Fn(zenoh::Error) -> Self {
        move |why| Self::Zenoh {
            what,
            why: why.to_string(),
        }
    }
}

/// The configuration of a zenoh session.
///
/// # Errors
/// If zenoh refuses a value.
pub fn config(entries: &Entries) -> Result<zenoh::Config, SessionError> {
    let mut config = zenoh::Config::default();
    for (key, value) in entries {
        let text = value.to_string();
        config
            .insert_json5(key, &text)
            .map_err(|why| SessionError::Config {
                key,
                value: text.clone(),
                why: why.to_string(),
            })?;
    }
    Ok(config)
}

/// Opens a session. A listener that cannot be bound is an error; so is, for observers, that no endpoint answers.
///
/// # Errors
/// If zenoh refuses the configuration, an address or all endpoints.
pub fn open(entries: &Entries) -> Result<zenoh::Session, SessionError> {
    let opened = zenoh::open(config(entries)?).wait();
    opened.map_err(SessionError::of("cannot open a session of the fleet"))
}

#[cfg(test)]
mod tests;
