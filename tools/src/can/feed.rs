//! Frame sources: interfaces or a recording, so that every command reads both. It neither selects nor shows frames.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context as _;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use takt_can::link::{Link as _, Origin, Received};
use takt_can::linux::{Clock, Options, SocketCan, interfaces};
use takt_can::log::{Format, Log, Record};
use takt_can::{Direction, LogError};

use crate::output::complain;

/// A frame and where it was received.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) interface: Arc<str>,
    pub(super) received: Received,
    /// `None` if the recording does not contain it.
    pub(super) direction: Option<Direction>,
}

impl Seen {
    /// The record for a log.
    pub(super) fn record(&self) -> Record {
        Record {
            at: self.received.at,
            interface: self.interface.to_string(),
            frame: self.received.frame,
            direction: self.direction,
        }
    }
}

#[derive(Debug)]
struct Source {
    interface: Arc<str>,
    link: SocketCan,
}

/// A sequence of frames.
#[derive(Debug)]
pub(super) enum Feed {
    Live(Live),
    File(std::vec::IntoIter<Record>),
}

/// Frames as the interfaces receive them.
#[derive(Debug)]
pub(super) struct Live {
    sources: Vec<Source>,
    /// The source that was read last.
    turn: usize,
}

impl Feed {
    /// Opens a recording, or interfaces if `file` is `None`.
    pub(super) fn open(interfaces: &[String], file: Option<&Path>) -> anyhow::Result<Self> {
        match file {
            Some(file) => Self::file(file),
            None => Self::live(interfaces),
        }
    }

    fn file(path: &Path) -> anyhow::Result<Self> {
        let log = read_log(path)?;
        Ok(Self::File(log.records.into_iter()))
    }

    fn live(names: &[String]) -> anyhow::Result<Self> {
        let all = names.iter().any(|name| name == "any");
        let names = if all { interfaces() } else { names.to_vec() };
        anyhow::ensure!(!names.is_empty(), "this host has no CAN interface");
        let open = |name: String| {
            let options = Options {
                clock: Clock::Wall,
                ..Options::default()
            };
            let link = SocketCan::open(&name, &options);
            let link = link.map_err(|error| cannot_open(&name, &error))?;
            anyhow::Ok(Source {
                interface: name.into(),
                link,
            })
        };
        let sources: Vec<Source> = names.into_iter().map(open).collect::<Result<_, _>>()?;
        Ok(Self::Live(Live { sources, turn: 0 }))
    }

    pub(super) const fn is_live(&self) -> bool {
        matches!(self, Self::Live(_))
    }

    /// The next frame. Waits at most `timeout` for interfaces; of a recording, `None` is the end.
    pub(super) fn next(&mut self, timeout: Duration) -> anyhow::Result<Option<Seen>> {
        match self {
            Self::Live(live) => live.next(timeout),
            Self::File(records) => Ok(records.next().map(seen)),
        }
    }

    /// Frames lost because they were not read in time.
    pub(super) fn dropped(&self) -> u64 {
        match self {
            Self::Live(live) => {
                let dropped = live.sources.iter().map(|source| source.link.dropped());
                dropped.map(u64::from).sum()
            }
            Self::File(_) => 0,
        }
    }

    /// The same, with losses after the last received frame; for the end of a measurement.
    pub(super) fn read_dropped(&mut self) -> u64 {
        match self {
            Self::Live(live) => {
                let sources = live.sources.iter_mut();
                let dropped = sources.map(|source| source.link.read_dropped());
                dropped.map(u64::from).sum()
            }
            Self::File(_) => 0,
        }
    }
}

/// The error of a socket that cannot be opened, with the CAN interfaces of this host.
pub(super) fn cannot_open(name: &str, error: &io::Error) -> anyhow::Error {
    let others = interfaces().join(", ");
    let others = if others.is_empty() {
        "none".to_owned()
    } else {
        others
    };
    anyhow::anyhow!(
        "cannot open CAN interface {name}: {error}\nhint: CAN interfaces of this host: {others}"
    )
}

/// Reads a recording and reports what it leaves out.
pub(super) fn read_log(path: &Path) -> anyhow::Result<Log> {
    let bytes = takt_core::files::read(path, takt_core::files::RECORDING_BYTES_MAX)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let (log, format) = (Log::read(&bytes), Format::of(&bytes));
    anyhow::ensure!(
        format != Format::Unknown,
        "{}: {}",
        path.display(),
        LogError::Unknown
    );
    let unit = format.location_unit();
    for left_out in &log.left_out {
        let (path, at) = (path.display(), left_out.location);
        complain(&format!("{path}: {unit} {at}: {}", left_out.why));
    }
    let more = log.left_out_count - log.left_out.len();
    if more > 0 {
        complain(&format!("{}: {more} more records left out", path.display()));
    }
    anyhow::ensure!(
        !log.records.is_empty(),
        "{}: no frames; it was read as {format}",
        path.display()
    );
    Ok(log)
}

fn seen(record: Record) -> Seen {
    let origin = match record.direction {
        Some(Direction::Transmitted) => Origin::Host,
        Some(Direction::Received) | None => Origin::Bus,
    };
    Seen {
        interface: record.interface.into(),
        received: Received {
            frame: record.frame,
            at: record.at,
            hardware: None,
            origin,
            dropped: 0,
        },
        direction: record.direction,
    }
}

impl Live {
    fn next(&mut self, timeout: Duration) -> anyhow::Result<Option<Seen>> {
        if let Some(seen) = self.take()? {
            return Ok(Some(seen));
        }
        let fds = self.sources.iter();
        let mut fds: Vec<PollFd<'_>> = fds
            .map(|source| PollFd::new(source.link.fd(), PollFlags::POLLIN))
            .collect();
        let timeout = PollTimeout::try_from(timeout).unwrap_or(PollTimeout::MAX);
        match poll(&mut fds, timeout) {
            Ok(_) | Err(nix::errno::Errno::EINTR) => {}
            Err(error) => return Err(error.into()),
        }
        self.take()
    }

    /// Reads the sources in turn, so that a busy one does not starve the others.
    fn take(&mut self) -> anyhow::Result<Option<Seen>> {
        for _ in 0..self.sources.len() {
            self.turn = (self.turn + 1) % self.sources.len();
            let Some(source) = self.sources.get_mut(self.turn) else {
                return Ok(None);
            };
            let received = source.link.receive(Duration::ZERO);
            if let Some(received) = received.with_context(|| source.interface.to_string())? {
                let direction = match received.origin {
                    Origin::Bus => Direction::Received,
                    Origin::Host | Origin::Own => Direction::Transmitted,
                };
                return Ok(Some(Seen {
                    interface: Arc::clone(&source.interface),
                    received,
                    direction: Some(direction),
                }));
            }
        }
        Ok(None)
    }
}
