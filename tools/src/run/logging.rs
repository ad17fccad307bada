//! Where the log goes: to the journal with fields if standard error is the journal, else to standard
//! error as text. What is logged can be changed while it runs.

use std::os::linux::fs::MetadataExt as _;

use anyhow::Context as _;
use takt_server::LogBook;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Registry, fmt, reload};

use crate::output::complain;

/// Fields of the journal begin with this: `TAKT_DEVICE`, `TAKT_NET`.
const PREFIX: &str = "TAKT";
/// The default log level.
const DEFAULT: &str = "info";

/// Changes what is logged.
#[derive(Debug)]
pub(super) struct Logging(reload::Handle<EnvFilter, Registry>);

impl Logging {
    /// Starts to log, also into `book`. `RUST_LOG` overrides the cell.
    pub(super) fn start(cell: Option<&str>, book: &LogBook) -> anyhow::Result<Self> {
        let (filter, handle) = reload::Layer::new(filter(cell)?);
        let book = book.clone();
        let kept = fmt::layer().with_writer(move || book.clone());
        let log = tracing_subscriber::registry().with(filter).with(kept);
        let journal = is_journal().then(tracing_journald::layer);
        match journal {
            Some(Ok(journal)) => {
                let journal = journal.with_field_prefix(Some(PREFIX.to_owned()));
                log.with(journal).init();
            }
            text => {
                log.with(fmt::layer().with_writer(std::io::stderr)).init();
                if let Some(Err(error)) = text {
                    complain(&format!("warning: no journal, the log is text: {error}"));
                }
            }
        }
        Ok(Self(handle))
    }

    /// Changes what is logged.
    pub(super) fn change(&self, cell: Option<&str>) -> anyhow::Result<()> {
        self.0
            .reload(filter(cell)?)
            .context("cannot change what is logged")
    }
}

fn filter(cell: Option<&str>) -> anyhow::Result<EnvFilter> {
    if let Ok(filter) = EnvFilter::try_from_default_env() {
        return Ok(filter);
    }
    let text = cell.unwrap_or(DEFAULT);
    EnvFilter::try_new(text).map_err(|error| {
        anyhow::anyhow!(
            "controller.log is `{text}`: {error}\nhint: write info, or by part warn,takt_core=debug"
        )
    })
}

/// Whether standard error leads to the journal: systemd names the file it gave.
fn is_journal() -> bool {
    let given = std::env::var("JOURNAL_STREAM").ok();
    let Some((device, inode)) = given.as_deref().and_then(device_and_inode) else {
        return false;
    };
    let here = std::fs::metadata("/proc/self/fd/2");
    here.is_ok_and(|file| (file.st_dev(), file.st_ino()) == (device, inode))
}

fn device_and_inode(text: &str) -> Option<(u64, u64)> {
    let (device, inode) = text.split_once(':')?;
    Some((device.parse().ok()?, inode.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn journal_stream_is_two_numbers() {
        assert_eq!(device_and_inode("8:12345"), Some((8, 12345)));
        for wrong in ["", "8", "8:", "a:b", "8:1:2"] {
            assert_eq!(device_and_inode(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn log_filter_invalid_error_shows_valid_one() {
        // RUST_LOG overrides the cell.
        if std::env::var_os("RUST_LOG").is_none() {
            let error = filter(Some("takt=loud")).unwrap_err().to_string();
            assert!(
                error.contains("takt=loud") && error.contains("info"),
                "{error}"
            );
            assert!(filter(Some("warn,takt_core=debug")).is_ok());
        }
    }
}
