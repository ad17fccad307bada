//! A flight file: what the flight recorder holds around a fault, as MCAP with the messages of a recording. It is written from
//! the rings row by row while these are overwritten, so it takes no copy of them; rows that a slow disk loses are counted.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Seek, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use takt_net::netcomm::Directory;
use takt_rt::Nanos;

use crate::cell::CellFrames;
use crate::device::Device;
use crate::error::Error;
use crate::executor::flight::{DEVICE_BEGIN, FlightReader, NET_BEGIN};
use crate::record::file::Writer;
use crate::record::flight_log::FlightLog;
use crate::record::ros2::{FlightRow, ShownDevice};

/// Rows that are read from a ring at once.
const ROWS_AT_ONCE: usize = 128;

/// A device whose ring is written.
#[derive(Debug)]
pub(crate) struct FlightDevice {
    pub(crate) number: usize,
    pub(crate) device: Arc<Device>,
    /// Number of the net thread that serves it.
    pub(crate) thread: usize,
}

/// A net that ran within the time of a flight file.
#[derive(Clone, Debug)]
pub(crate) struct FlightNet {
    pub(crate) id: u32,
    pub(crate) text: Arc<str>,
    pub(crate) directory: Arc<Directory>,
}

/// What a flight file is written from.
#[derive(Debug)]
pub(crate) struct Sources {
    pub(crate) devices: Vec<FlightDevice>,
    /// By net thread, its period and the ring of its nets.
    pub(crate) threads: Vec<(Duration, FlightReader)>,
    pub(crate) nets: Vec<FlightNet>,
    pub(crate) frames: CellFrames,
    pub(crate) log: FlightLog,
}

/// What the rows of a ring are.
#[derive(Debug)]
enum Rows {
    /// Of a device with so many joints; the thread whose cycles it shows.
    Device {
        number: usize,
        joints: usize,
        thread: Option<usize>,
    },
    /// Out values of the nets of a thread.
    Nets,
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
        let key = match rows {
            Rows::Device { .. } => DEVICE_BEGIN,
            Rows::Nets => NET_BEGIN,
        };
        Self {
            rows,
            next: reader.cursor_at(since, key),
            reader: reader.clone(),
            lost: 0,
            words: Vec::new(),
            at: 0,
        }
    }

    /// Begin of the cycle of its next row, ns; `None` if there is none yet.
    fn peek(&mut self) -> Option<i64> {
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
        let key = match self.rows {
            Rows::Device { .. } => DEVICE_BEGIN,
            Rows::Nets => NET_BEGIN,
        };
        let word = self.words.get(self.at + key)?;
        Some(word.cast_signed())
    }
}

/// Cycles of a net thread as messages.
#[derive(Debug)]
struct ThreadTopic {
    name: String,
    before: Option<(u64, i64)>,
}

/// A flight file that is being written.
pub(crate) struct FlightFile<W: Write + Seek = File> {
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

impl<W: Write + Seek> FlightFile<W> {
    fn begin(
        mut writer: Writer<W>,
        sources: &Sources,
        since: i64,
        bytes_max: u64,
    ) -> Result<Self, Error> {
        let at = writer.stamp(Nanos(since));
        let mut feeds = Vec::new();
        let mut threads: Vec<_> = sources.threads.iter().map(|_| false).collect();
        for FlightDevice {
            number,
            device,
            thread,
        } in &sources.devices
        {
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
            let shows = threads.get_mut(*thread).filter(|shown| !**shown);
            let rows = Rows::Device {
                number: *number,
                joints,
                thread: shows.map(|shown| {
                    *shown = true;
                    *thread
                }),
            };
            feeds.push(Feed::new(rows, reader, since));
        }
        for (_, reader) in &sources.threads {
            feeds.push(Feed::new(Rows::Nets, reader, since));
        }
        for net in &sources.nets {
            let shown = (net.id, &net.directory);
            writer.show(|messages, file| messages.net(file, shown, at))?;
        }
        writer.show(|messages, file| messages.frames(file, &sources.frames, at))?;
        let names = sources.threads.iter().enumerate();
        let names = names.map(|(number, (period, _))| match number {
            0 => "/takt/thread".to_owned(),
            _ => format!("/takt/thread_{}us", period.as_micros()),
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

    /// Writes all rows of cycles that began before that instant, in their order; false if the file has reached its bound.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn write_until(&mut self, until: i64) -> Result<bool, Error> {
        loop {
            if self.writer.bytes() > self.bytes_max {
                return Ok(false);
            }
            let begins = self.feeds.iter_mut().map(Feed::peek).enumerate();
            let begins = begins.filter_map(|(number, begin)| Some((begin?, number)));
            let row = begins.min().filter(|(begin, _)| *begin < until);
            let before = row.map_or(until, |(begin, _)| begin);
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
        match feed.rows {
            Rows::Nets => {
                let &[begin, source, ..] = row else {
                    return Ok(());
                };
                let net = u32::try_from(source >> 32).unwrap_or(0);
                let at = writer.stamp(Nanos(begin.cast_signed()));
                writer.show(|messages, file| messages.values_row(file, net, row, at))
            }
            Rows::Device {
                number,
                joints,
                thread,
            } => {
                let thread = thread.and_then(|thread| threads.get_mut(thread));
                write_device(writer, (number, joints), row, thread)
            }
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

/// Writes a row of a device, and the cycle of its thread that it shows, if any.
fn write_device<W: Write + Seek>(
    writer: &mut Writer<W>,
    (number, joints): (usize, usize),
    row: &[u64],
    thread: Option<&mut ThreadTopic>,
) -> Result<(), Error> {
    let Some(row) = FlightRow::of(row, joints) else {
        return Ok(());
    };
    let (cycle, begin) = (row.cycle, row.begin.0);
    let at = writer.stamp(Nanos(begin));
    if let Some(topic) = thread {
        let before = topic.before.replace((cycle, begin));
        let shown = (topic.name.as_str(), before);
        writer.show(|messages, file| messages.thread_cycle(file, shown, (cycle, begin), at))?;
    }
    writer.show(|messages, file| messages.row(file, number, &row, at))
}
