//! Where the log goes: to the journal with fields if standard error is the journal, else to standard
//! error as text; to the page; and into a recording. What is logged can be changed while it runs.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::os::linux::fs::MetadataExt as _;
use std::sync::{Arc, PoisonError, RwLock};

use anyhow::Context as _;
use takt_core::record::Recorder;
use takt_server::LogBook;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Registry, fmt, reload};

use crate::output::complain;

/// Fields of the journal begin with this: `TAKT_DEVICE`, `TAKT_NET`.
const PREFIX: &str = "TAKT";
/// The default log level.
const DEFAULT: &str = "info";

/// Changes what is logged.
#[derive(Debug)]
pub(crate) struct Logging {
    filter: reload::Handle<EnvFilter, Registry>,
    recorded: Recorded,
}

/// Takes a line of a part of the program.
type Sink = Box<dyn Fn(Level, &str, &str) + Send + Sync>;

/// Lines for the recording and the flight recorder, once these are there.
#[derive(Clone, Default)]
struct Recorded(Arc<RwLock<Vec<Sink>>>);

impl std::fmt::Debug for Recorded {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorded").finish_non_exhaustive()
    }
}

impl<S: Subscriber> Layer<S> for Recorded {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let sinks = self.0.read().unwrap_or_else(PoisonError::into_inner);
        if sinks.is_empty() {
            return;
        }
        let mut line = Line::default();
        event.record(&mut line);
        let metadata = event.metadata();
        for sink in &*sinks {
            sink(*metadata.level(), metadata.target(), line.0.trim_start());
        }
    }
}

/// The text of an event: its message, then its fields.
#[derive(Default)]
struct Line(String);

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            self.0.insert_str(0, &format!("{value:?}"));
        } else {
            let _cannot_fail = write!(self.0, " {}={value:?}", field.name());
        }
    }
}

impl Logging {
    /// Starts to log, also into `book`. `RUST_LOG` overrides the cell.
    pub(crate) fn start(cell: Option<&str>, book: &LogBook) -> anyhow::Result<Self> {
        Self::begin(cell, book, true)
    }

    /// Starts to log into `book` and recordings alone, for a program that shows something else.
    pub(crate) fn keep(book: &LogBook) -> anyhow::Result<Self> {
        Self::begin(None, book, false)
    }

    fn begin(cell: Option<&str>, book: &LogBook, is_shown: bool) -> anyhow::Result<Self> {
        let (filter, handle) = reload::Layer::new(filter(cell)?);
        let book = book.clone();
        // Colours are for terminals: readers of the kept lines split and show them as they are.
        let kept = fmt::layer().with_ansi(false);
        let kept = kept.with_writer(move || book.clone());
        let recorded = Recorded::default();
        let log = tracing_subscriber::registry();
        let log = log.with(filter).with(kept).with(recorded.clone());
        let journal = (is_shown && is_journal()).then(tracing_journald::layer);
        match journal {
            Some(Ok(journal)) => {
                let journal = journal.with_field_prefix(Some(PREFIX.to_owned()));
                log.with(journal).init();
            }
            text => {
                let is_terminal = std::io::stderr().is_terminal();
                let shown = fmt::layer().with_ansi(is_terminal);
                let shown = is_shown.then(|| shown.with_writer(std::io::stderr));
                log.with(shown).init();
                if let Some(Err(error)) = text {
                    complain(&format!("warning: no journal, the log is text: {error}"));
                }
            }
        }
        Ok(Self {
            filter: handle,
            recorded,
        })
    }

    /// Gives lines to a recording too from now on.
    pub(crate) fn record(&self, sink: impl Fn(Level, &str, &str) + Send + Sync + 'static) {
        let sinks = self.recorded.0.write();
        sinks
            .unwrap_or_else(PoisonError::into_inner)
            .push(Box::new(sink));
    }

    /// Gives lines to that recording too from now on.
    pub(crate) fn record_in(&self, recorder: &Recorder) {
        let log = recorder.log();
        self.record(move |level, part, text| log.line(level, part, text));
    }

    /// Changes what is logged.
    pub(crate) fn change(&self, cell: Option<&str>) -> anyhow::Result<()> {
        self.filter
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
