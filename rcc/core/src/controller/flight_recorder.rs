//! Flight recorder: when a device faults, a net fails, cycles are missed in a burst, or on request, its thread writes the last
//! ten seconds of all devices and the second that follows to a file. Triggers never wait for the disk: a trigger determines
//! the name of the file, the thread writes it. Files are bounded in number and bytes, the oldest are deleted first.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use takt_rt::monotonic;

use crate::error::Error;
use crate::executor::flight::{AFTER, BEFORE};
use crate::record::FlightLog;
use crate::record::flight::{FlightFile, Sources};

mod credit;
mod directory;

use credit::Credit;
use directory::{file_name, list, prune};

/// How often its thread checks for bursts of overruns and for the end of the controller.
const POLL: Duration = Duration::from_millis(100);
/// How often it writes what is new while a file is open.
const WRITE_EVERY: Duration = Duration::from_millis(50);
/// Rows younger than this may not be complete yet, ns.
const SETTLED_NS: i64 = 20_000_000;
/// Missed cycles of a net thread within a second that are a burst of overruns.
pub const BURST: u64 = 10;
/// Maximum number of causes that a file names.
const CAUSES_MAX: usize = 32;

/// Where flight files are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlightSettings {
    /// The directory, which is created if needed.
    pub directory: PathBuf,
    /// Maximum bytes of all files together.
    pub bytes_max: u64,
    /// Text of the cell file, attached to each file.
    pub cell: Option<String>,
}

/// A flight file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlightInfo {
    /// Its name.
    pub name: String,
    /// Its path.
    pub path: PathBuf,
    /// Its bytes.
    pub bytes: u64,
    /// When it was changed last.
    pub changed: SystemTime,
    /// Whether it is complete; else it is being written.
    pub is_complete: bool,
}

/// Why a flight file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Trigger {
    /// A device fault or a net failure.
    Fault,
    Overruns,
    Request,
}

/// The answer to a trigger.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// It is in this file, complete a second later.
    Written(PathBuf),
    /// Too many files were written within a short time; the next one can be after so long.
    Limited(Duration),
}

impl Answer {
    /// A line for the log.
    pub(super) fn line(&self) -> String {
        match self {
            Self::Written(path) => format!("\nflight recorder: {}", path.display()),
            Self::Limited(wait) => format!(
                "\nflight recorder: no file, too many within a short time; the next one in {} min at most",
                wait.as_secs().div_ceil(60)
            ),
        }
    }
}

/// A file to be written.
#[derive(Clone, Debug)]
struct Capture {
    path: PathBuf,
    /// When it was triggered, ns on `CLOCK_MONOTONIC`.
    at: i64,
    causes: Vec<String>,
}

#[derive(Debug)]
struct State {
    current: Option<Capture>,
    faults: Credit,
    overruns: Credit,
    is_stopped: bool,
}

/// Level of a line of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Info,
    Error,
}

/// What became of triggers since the start of the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FlightCounts {
    /// Files that were written.
    pub written: u64,
    /// Files that could not be written.
    pub failed: u64,
    /// Triggers without a file, because there were too many within a short time.
    pub limited: u64,
}

#[derive(Debug, Default)]
struct Counts {
    written: AtomicU64,
    failed: AtomicU64,
    limited: AtomicU64,
}

/// Deletes a file that could not be written, unless it holds something that can be read: empty files would push out those
/// of earlier faults.
fn discard_unreadable(path: &Path) {
    let found = crate::record::contents(path);
    let holds_any = found.is_ok_and(|it| it.topics.values().any(|topic| topic.messages > 0));
    if !holds_any {
        // What cannot be deleted either is on a disk that reports it with the next file.
        let _ = std::fs::remove_file(path);
    }
}

#[derive(Debug)]
struct Inner {
    settings: FlightSettings,
    counts: Counts,
    state: Mutex<State>,
    changed: Condvar,
    log: FlightLog,
}

/// The triggers of the flight recorder. Clones trigger the same one.
#[derive(Clone, Debug)]
pub(super) struct FlightRecorder(Arc<Inner>);

impl FlightRecorder {
    /// A recorder to this directory.
    ///
    /// # Errors
    /// If the directory cannot be created or written.
    pub(super) fn new(settings: FlightSettings) -> Result<Self, Error> {
        let directory = &settings.directory;
        let made = std::fs::create_dir_all(directory).and_then(|()| directory::check(directory));
        made.map_err(|source| Error::File {
            path: directory.clone(),
            source,
        })?;
        Ok(Self(Arc::new(Inner {
            settings,
            counts: Counts::default(),
            state: Mutex::new(State {
                current: None,
                faults: Credit::new(6, Duration::from_secs(600)),
                overruns: Credit::new(2, Duration::from_secs(3600)),
                is_stopped: false,
            }),
            changed: Condvar::new(),
            log: FlightLog::default(),
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        let state = self.0.state.lock();
        state.unwrap_or_else(PoisonError::into_inner)
    }

    /// The log of which its files hold the last lines.
    pub(super) fn log(&self) -> FlightLog {
        self.0.log.clone()
    }

    /// Requests a file about a device, a net or a thread. A file that is being written takes in further causes.
    pub(super) fn trigger(&self, trigger: Trigger, subject: &str, cause: &str) -> Answer {
        self.trigger_at(trigger, (subject, cause), monotonic().0)
    }

    fn trigger_at(&self, trigger: Trigger, (subject, cause): (&str, &str), now: i64) -> Answer {
        let mut state = self.state();
        if let Some(current) = &mut state.current {
            if current.causes.len() < CAUSES_MAX {
                current.causes.push(cause.to_owned());
            }
            return Answer::Written(current.path.clone());
        }
        let credit = match trigger {
            Trigger::Fault => Some(&mut state.faults),
            Trigger::Overruns => Some(&mut state.overruns),
            Trigger::Request => None,
        };
        if let Some(Err(wait)) = credit.map(|credit| credit.take(now)) {
            self.0.counts.limited.fetch_add(1, Ordering::Relaxed);
            return Answer::Limited(wait);
        }
        let unix = SystemTime::now().duration_since(UNIX_EPOCH);
        let name = file_name(unix.unwrap_or_default(), subject);
        let path = self.0.settings.directory.join(name);
        state.current = Some(Capture {
            path: path.clone(),
            at: now,
            causes: vec![cause.to_owned()],
        });
        drop(state);
        self.0.changed.notify_all();
        Answer::Written(path)
    }

    /// The files, oldest first.
    pub(super) fn files(&self) -> Vec<FlightInfo> {
        let current = self.state().current.as_ref().map(|it| it.path.clone());
        let mut files = list(&self.0.settings.directory);
        for file in &mut files {
            file.is_complete = Some(&file.path) != current.as_ref();
        }
        files
    }

    /// Ends its thread after the file that is being written, which ends now.
    pub(super) fn stop(&self) {
        self.state().is_stopped = true;
        self.0.changed.notify_all();
    }

    /// Waits for a trigger; `None` if there is none yet.
    fn wait(&self) -> Option<Capture> {
        let state = self.state();
        if state.current.is_some() || state.is_stopped {
            return state.current.clone();
        }
        let waited = self.0.changed.wait_timeout(state, POLL);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.current.clone()
    }

    fn is_stopped(&self) -> bool {
        self.state().is_stopped
    }

    /// Writes files until it is stopped. `sources` gives what there is to write, `texts` what is attached at the end, as name
    /// and text, and `poll` is called between files.
    pub(super) fn run(
        &self,
        sources: impl Fn() -> Sources,
        texts: impl Fn(&Sources) -> Vec<(String, Arc<str>)>,
        poll: impl FnMut(),
    ) {
        let report = |level: Level, text: &str| match level {
            Level::Error => tracing::error!("{text}"),
            Level::Info => tracing::info!("{text}"),
        };
        self.run_on(FlightFile::create, (sources, texts), poll, report);
    }

    /// The same with files that `open` creates, and lines of the log to `report`.
    fn run_on<W: Write>(
        &self,
        open: impl Fn(&Path, &Sources, i64, u64) -> Result<FlightFile<W>, Error>,
        (sources, texts): (
            impl Fn() -> Sources,
            impl Fn(&Sources) -> Vec<(String, Arc<str>)>,
        ),
        mut poll: impl FnMut(),
        mut report: impl FnMut(Level, &str),
    ) {
        // A full disk is reported once, until a file can be written again.
        let mut has_failed = false;
        loop {
            let Some(capture) = self.wait() else {
                if self.is_stopped() {
                    return;
                }
                poll();
                continue;
            };
            let sources = sources();
            let result = self.write(&open, &capture, (&sources, &texts));
            if result.is_err() {
                discard_unreadable(&capture.path);
            }
            self.state().current = None;
            let path = capture.path.display();
            match result {
                Ok((bytes, lost)) => {
                    has_failed = false;
                    let kib = bytes / 1024;
                    let loss = match lost {
                        0 => String::new(),
                        _ => format!(
                            "; {lost} rows are missing: the disk was too slow, or this host stalled"
                        ),
                    };
                    let text = format!("flight recorder: {path} is complete, {kib} KiB{loss}");
                    report(Level::Info, &text);
                }
                Err(error) if !std::mem::replace(&mut has_failed, true) => {
                    let text = format!(
                        "flight recorder: {error}\nflight files that follow are not reported until one is written again"
                    );
                    report(Level::Error, &text);
                }
                Err(_) => {}
            }
            self.count(has_failed);
        }
    }

    /// Counts a file for `/metrics`.
    fn count(&self, has_failed: bool) {
        let counts = &self.0.counts;
        let which = if has_failed {
            &counts.failed
        } else {
            &counts.written
        };
        which.fetch_add(1, Ordering::Relaxed);
    }

    /// Files written, files that could not be written, and triggers without a file.
    pub(super) fn counts(&self) -> FlightCounts {
        let Counts {
            written,
            failed,
            limited,
        } = &self.0.counts;
        let [written, failed, limited] =
            [written, failed, limited].map(|it| it.load(Ordering::Relaxed));
        FlightCounts {
            written,
            failed,
            limited,
        }
    }

    fn write<W: Write>(
        &self,
        open: &impl Fn(&Path, &Sources, i64, u64) -> Result<FlightFile<W>, Error>,
        capture: &Capture,
        (sources, texts): (&Sources, &impl Fn(&Sources) -> Vec<(String, Arc<str>)>),
    ) -> Result<(u64, u64), Error> {
        let settings = &self.0.settings;
        // What is written now: messages and texts.
        let (file_max, texts_max) = (settings.bytes_max / 8, settings.bytes_max / 8);
        let directory = &settings.directory;
        for deleted in prune(
            directory,
            settings.bytes_max.saturating_sub(file_max + texts_max),
        ) {
            tracing::info!(
                "flight recorder: deleted {}, the oldest, to stay within {} MiB",
                deleted.display(),
                settings.bytes_max >> 20
            );
        }
        let ns = |time: Duration| i64::try_from(time.as_nanos()).unwrap_or(i64::MAX);
        let (since, until) = (capture.at - ns(BEFORE), capture.at + ns(AFTER));
        let mut file = open(&capture.path, sources, since, file_max)?;
        let mut is_whole;
        loop {
            let is_stopped = self.is_stopped();
            // The last cycles before the end of the controller may be out of order.
            let settled = if is_stopped { 0 } else { SETTLED_NS };
            let now = monotonic().0 - settled;
            is_whole = file.write_until(until.min(now))?;
            if !is_whole || now >= until || is_stopped {
                break;
            }
            std::thread::sleep(WRITE_EVERY);
        }
        let state = self.state();
        let causes = state.current.as_ref().map(|it| it.causes.join("\n"));
        drop(state);
        let mut about = BTreeMap::new();
        let mut add = |key: &str, value: String| about.insert(key.to_owned(), value);
        add("kind", "flight".to_owned());
        add("cause", causes.unwrap_or_default());
        add("version", env!("CARGO_PKG_VERSION").to_owned());
        add("is_whole", is_whole.to_string());
        let cell = settings.cell.as_deref();
        let cell = cell.map(|cell| ("cell.toml".to_owned(), Arc::from(cell)));
        let (mut left, mut left_out) = (texts_max, Vec::new());
        let mut texts: Vec<_> = cell.into_iter().chain(texts(sources)).collect();
        texts.retain(|(name, text)| {
            let fits = left.checked_sub(text.len() as u64);
            left = fits.unwrap_or(left);
            if fits.is_none() {
                left_out.push(name.clone());
            }
            fits.is_some()
        });
        if !left_out.is_empty() {
            about.insert("texts_left_out".to_owned(), left_out.join(" "));
        }
        file.finish(texts.into_iter(), about)
    }

    /// The directory of its files, as text for people.
    pub(super) fn directory(&self) -> &Path {
        &self.0.settings.directory
    }
}

/// Detects bursts of overruns of a thread from its counter, read every [`POLL`].
#[derive(Debug, Default)]
pub(super) struct Bursts {
    /// The last second of readings, oldest first.
    seen: std::collections::VecDeque<u64>,
}

impl Bursts {
    /// Number of cycles missed within the last second, if that is a burst; then it begins again.
    pub(super) fn poll(&mut self, overruns: u64) -> Option<u64> {
        self.seen.push_back(overruns);
        let missed = overruns - self.seen.front().copied().unwrap_or(overruns).min(overruns);
        if missed >= BURST {
            self.seen = [overruns].into();
            return Some(missed);
        }
        if self.seen.len() > 10 {
            self.seen.pop_front();
        }
        None
    }
}

#[cfg(test)]
mod tests;
