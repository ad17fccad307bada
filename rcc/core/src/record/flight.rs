//! A flight file: what the flight recorder holds around a fault, as MCAP with the messages of a recording. It is written from
//! the rings row by row while these are overwritten, so it takes no copy of them; rows that a slow disk loses are counted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use takt_machine::Program;
use takt_net::netcomm::Directory;
use takt_rt::Nanos;

use crate::cell::CellFrames;
use crate::device::Device;
use crate::error::Error;
use crate::executor::flight::{DEVICE_WOKEN, FlightReader, NET_WOKEN, THREAD_BEGIN};
use crate::record::file::Writer;
use crate::record::flight_log::FlightLog;
use crate::record::journal::{EVENT_WOKEN, EventRow, is_after};
use crate::record::ros2::{FlightRow, ShownDevice};
use crate::record::words::Entry;

/// Rows that are read from a ring at once.
const ROWS_AT_ONCE: usize = 128;

/// A device whose ring is written.
#[derive(Debug)]
pub(crate) struct FlightDevice {
    pub(crate) number: usize,
    pub(crate) device: Arc<Device>,
}

/// A net that ran within the time of a flight file.
#[derive(Clone, Debug)]
pub(crate) struct FlightNet {
    pub(crate) id: u32,
    pub(crate) text: Arc<str>,
    pub(crate) directory: Arc<Directory>,
}

/// The rings of a net thread.
#[derive(Clone, Debug)]
pub(crate) struct ThreadRings {
    pub(crate) period: Duration,
    /// Out values of its nets.
    pub(crate) values: FlightReader,
    /// Timing of its cycles.
    pub(crate) timing: FlightReader,
    /// What happened to its nets and machines.
    pub(crate) happened: FlightReader,
}

impl ThreadRings {
    /// Bytes of them together.
    pub(crate) fn bytes(&self) -> usize {
        self.values.bytes() + self.timing.bytes() + self.happened.bytes()
    }
}

/// What a flight file is written from.
#[derive(Debug)]
pub(crate) struct Sources {
    pub(crate) devices: Vec<FlightDevice>,
    /// By net thread.
    pub(crate) threads: Vec<ThreadRings>,
    /// Machines by number.
    pub(crate) machines: Vec<(u32, Arc<Program>)>,
    pub(crate) nets: Vec<FlightNet>,
    pub(crate) frames: CellFrames,
    pub(crate) log: FlightLog,
}

/// What the rows of a ring are.
#[derive(Debug)]
enum Rows {
    /// Of a device with so many joints.
    Device { number: usize, joints: usize },
    /// Out values of the nets of a thread.
    Nets,
    /// Cycles of a thread.
    Thread(usize),
    /// What happened to the nets and machines of a thread.
    Events,
}

impl Rows {
    /// The word by which the first row is found.
    const fn key(&self) -> usize {
        match self {
            Self::Device { .. } => DEVICE_WOKEN,
            Self::Nets => NET_WOKEN,
            Self::Thread(_) => THREAD_BEGIN,
            Self::Events => EVENT_WOKEN,
        }
    }

    /// When the thread woke for the cycle of a row, ns, and where in its cycle the row is.
    fn place(&self, row: &[u64]) -> Option<(i64, u8)> {
        let word = |at: usize| row.get(at).map(|word| word.cast_signed());
        Some(match self {
            Self::Device { .. } => (word(DEVICE_WOKEN)?, 2),
            Self::Nets => (word(NET_WOKEN)?, 2),
            Self::Thread(_) => (thread_woken(row)?, 1),
            Self::Events => {
                let after = is_after(*row.get(EVENT_WOKEN + 1)?);
                (word(EVENT_WOKEN)?, if after { 3 } else { 0 })
            }
        })
    }
}

/// A ring that is read.
#[derive(Debug)]
struct Feed {
    rows: Rows,
    reader: FlightReader,
    next: u64,
    lost: u64,
    words: Vec<u64>,
    /// Words of it that are written.
    at: usize,
}

impl Feed {
    fn new(rows: Rows, reader: &FlightReader, since: i64) -> Self {
        Self {
            next: reader.cursor_at(since, rows.key()),
            rows,
            reader: reader.clone(),
            lost: 0,
            words: Vec::new(),
            at: 0,
        }
    }

    /// When the thread woke for the cycle of its next row, ns, and where the row is in that; `None` if there is none yet.
    fn peek(&mut self) -> Option<(i64, u8)> {
        if self.at >= self.words.len() {
            let Self {
                reader,
                next,
                words,
                ..
            } = self;
            words.clear();
            self.lost += reader.read_since(next, ROWS_AT_ONCE, words);
            self.at = 0;
        }
        let row = self.words.get(self.at..self.at + self.reader.width())?;
        self.rows.place(row)
    }
}

/// Cycles of a net thread as messages.
#[derive(Debug)]
struct ThreadTopic {
    name: String,
    before: Option<(u64, i64)>,
}

/// A flight file that is being written.
pub(crate) struct FlightFile<W: Write = File> {
    writer: Writer<W>,
    feeds: Vec<Feed>,
    threads: Vec<ThreadTopic>,
    log: FlightLog,
    /// Number of the next line of the log.
    line: u64,
    /// Bytes after which it ends early.
    bytes_max: u64,
}

impl FlightFile {
    /// Begins a file of at most so many bytes with what the rings hold since that instant.
    ///
    /// # Errors
    /// If it cannot be created or written.
    pub(crate) fn create(
        path: &Path,
        sources: &Sources,
        since: i64,
        bytes_max: u64,
    ) -> Result<Self, Error> {
        Self::begin(Writer::create_new(path)?, sources, since, bytes_max)
    }
}

impl<W: Write> FlightFile<W> {
    /// Begins a file on what is not a file of this host.
    ///
    /// # Errors
    /// If it cannot be written.
    #[cfg(test)]
    pub(crate) fn create_on(to: W, path: &Path, sources: &Sources) -> Result<Self, Error> {
        Self::begin(Writer::on(to, path)?, sources, 0, u64::MAX)
    }

    fn begin(
        mut writer: Writer<W>,
        sources: &Sources,
        since: i64,
        bytes_max: u64,
    ) -> Result<Self, Error> {
        let at = writer.stamp(Nanos(since));
        let mut feeds = Vec::new();
        for FlightDevice { number, device } in &sources.devices {
            let Some(reader) = device.flight.get() else {
                continue;
            };
            let joints = device.place.joints;
            let shown = ShownDevice {
                name: &device.name,
                place: &device.place,
                own: device.own.clone(),
                kinematics: device.kinematics.clone(),
            };
            writer.show(|messages, file| messages.device(file, *number, shown))?;
            let number = *number;
            let rows = Rows::Device { number, joints };
            feeds.push(Feed::new(rows, reader, since));
        }
        for (number, rings) in sources.threads.iter().enumerate() {
            feeds.push(Feed::new(Rows::Nets, &rings.values, since));
            feeds.push(Feed::new(Rows::Thread(number), &rings.timing, since));
            feeds.push(Feed::new(Rows::Events, &rings.happened, since));
        }
        for (id, program) in &sources.machines {
            writer.show(|messages, _| {
                messages.machine(*id, program);
                Ok(())
            })?;
        }
        for rings in &sources.threads {
            for (machine, state) in states_at(&rings.happened, since) {
                let (cycle, number, word) = state;
                let entry = Entry::Changed(machine, number, word);
                writer.show(|messages, file| messages.entry(file, (cycle, entry), at))?;
            }
        }
        for net in &sources.nets {
            let shown = (net.id, &net.directory);
            writer.show(|messages, file| messages.net(file, shown, at))?;
        }
        writer.show(|messages, file| messages.frames(file, &sources.frames, at))?;
        let names = sources.threads.iter().enumerate();
        let names = names.map(|(number, rings)| match number {
            0 => "/takt/thread".to_owned(),
            _ => format!("/takt/thread_{}us", rings.period.as_micros()),
        });
        let threads = names.map(|name| ThreadTopic { name, before: None });
        Ok(Self {
            writer,
            feeds,
            threads: threads.collect(),
            line: sources.log.number_at(since),
            log: sources.log.clone(),
            bytes_max,
        })
    }

    /// Writes all rows of cycles for which their thread woke before that instant, in their order; false if the file has reached its bound.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn write_until(&mut self, until: i64) -> Result<bool, Error> {
        loop {
            if self.writer.bytes() > self.bytes_max {
                return Ok(false);
            }
            let begins = self.feeds.iter_mut().map(Feed::peek).enumerate();
            let begins = begins.filter_map(|(number, place)| Some((place?, number)));
            let row = begins.min().filter(|((begin, _), _)| *begin < until);
            let before = row.map_or(until, |((begin, _), _)| begin);
            while let Some(line) = self.log.line(&mut self.line, before) {
                let at = self.writer.stamp(Nanos(line.at));
                let texts = (line.level, line.name.as_str(), line.text.as_str());
                self.writer
                    .show(|messages, file| messages.log(file, texts, at))?;
            }
            let Some((_, number)) = row else {
                return Ok(true);
            };
            self.write_row(number)?;
        }
    }

    fn write_row(&mut self, number: usize) -> Result<(), Error> {
        let Self {
            writer,
            feeds,
            threads,
            ..
        } = self;
        let Some(feed) = feeds.get_mut(number) else {
            return Ok(());
        };
        let width = feed.reader.width();
        let row = feed.words.get(feed.at..feed.at + width);
        feed.at += width;
        let row = row.unwrap_or_default();
        let woken = feed.rows.place(row).map_or(0, |(woken, _)| woken);
        let at = writer.stamp(Nanos(woken));
        match feed.rows {
            Rows::Nets => {
                let &[_, source, ..] = row else {
                    return Ok(());
                };
                let net = u32::try_from(source >> 32).unwrap_or(0);
                writer.show(|messages, file| messages.values_row(file, net, row, at))
            }
            Rows::Device { number, joints } => match FlightRow::of(row, joints) {
                Some(row) => writer.show(|messages, file| messages.row(file, number, &row, at)),
                None => Ok(()),
            },
            Rows::Thread(number) => {
                let (&[cycle, ..], Some(topic)) = (row, threads.get_mut(number)) else {
                    return Ok(());
                };
                let before = topic.before.replace((cycle, woken));
                let shown = (topic.name.as_str(), before);
                writer.show(|messages, file| messages.thread_cycle(file, shown, (cycle, woken), at))
            }
            Rows::Events => match EventRow::of(row) {
                Some(EventRow { cycle, entry, .. }) => {
                    writer.show(|messages, file| messages.entry(file, (cycle, entry), at))
                }
                None => Ok(()),
            },
        }
    }

    /// Number of rows that were overwritten before they were written.
    fn lost(&self) -> u64 {
        self.feeds.iter().map(|feed| feed.lost).sum()
    }

    /// Ends the file with these texts, as name and text, and with its description. Returns its bytes and the rows that it
    /// lost.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn finish(
        mut self,
        texts: impl Iterator<Item = (String, Arc<str>)>,
        mut description: BTreeMap<String, String>,
    ) -> Result<(u64, u64), Error> {
        for (name, text) in texts {
            self.writer.attach(&name, &text)?;
        }
        let lost = self.lost();
        description.insert("rows_lost".to_owned(), lost.to_string());
        self.writer.describe(description)?;
        self.writer.finish()?;
        Ok((self.writer.bytes(), lost))
    }
}

/// The states of machines at an instant: machine, and cycle, number and word of its last change before.
fn states_at(happened: &FlightReader, since: i64) -> Vec<(u32, (u64, usize, u64))> {
    let mut states: Vec<(u32, (u64, usize, u64))> = Vec::new();
    for row in happened.rows() {
        let woken = row.get(EVENT_WOKEN).map_or(since, |it| it.cast_signed());
        let Some(EventRow { cycle, entry, .. }) = EventRow::of(&row).filter(|_| woken < since)
        else {
            continue;
        };
        if let Entry::Changed(machine, number, word) = entry {
            states.retain(|(it, (_, inside, _))| (*it, *inside) != (machine, number));
            states.push((machine, (cycle, number, word)));
        } else if let Entry::MachineRemoved(machine) = entry {
            states.retain(|(it, _)| *it != machine);
        }
    }
    states
}

/// When the thread woke for the cycle of a row of its timing, ns: its begin and the latency.
pub(super) fn thread_woken(row: &[u64]) -> Option<i64> {
    let begin = row.get(THREAD_BEGIN)?.cast_signed();
    let latency = row.get(THREAD_BEGIN + 1)?.cast_signed();
    Some(begin.saturating_add(latency))
}
