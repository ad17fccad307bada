//! The file of a recording: MCAP with messages of ROS 2 (`ros2msg`, CDR). What a replay needs is in `/takt/cycles` (words),
//! `/takt/devices`, `/takt/nets` and `/takt/machines` (TOML in strings); the other topics are for viewers.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use mcap::records::MessageHeader;
use serde::Serialize;
use takt_rt::monotonic;

use crate::error::Error;
use crate::record::cycles::Encoder;
use crate::record::mcap_file::McapFile;
use crate::record::notes::{
    CYCLES, DEVICES, DeviceEvent, DeviceNote, FORMAT, MACHINES, MachineNote, NETS, NetNote, Note,
    wrong,
};
use crate::record::parts::{InUse, Part};
use crate::record::ros2::cdr::Cdr;
use crate::record::ros2::{Messages, ShownDevice, Sink, Stamp, schemas};
use crate::record::words::{Entry, Reader, start};

/// Encoding of all messages, and of their schemas.
const ENCODING: &str = "cdr";
const SCHEMAS: &str = "ros2msg";

/// Writes the file: after a full disk or a crash it is readable up to the last complete chunk.
pub(super) struct Writer<W: Write = File> {
    /// `None` after its end, or after an error: nothing follows half a record.
    mcap: Option<McapFile<W>>,
    path: PathBuf,
    channels: [u16; 4],
    cdr: Cdr,
    encoder: Encoder,
    messages: Messages,
    sequence: u32,
    /// Cycles written to the file.
    written: u64,
    /// Bytes that were written; the last chunk follows.
    bytes: u64,
    /// What the next part repeats; `None` if there is none.
    in_use: Option<InUse>,
    /// Whether an earlier part has what is noted now.
    is_repeating: bool,
    /// Unix time at the zero of the host's monotonic clock, ns.
    epoch: u64,
}

/// Unix time at the zero of the host's monotonic clock, ns.
pub(super) fn epoch() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let now = now.map_or(0, |now| u64::try_from(now.as_nanos()).unwrap_or(u64::MAX));
    now.saturating_sub(since_boot(monotonic()))
}

pub(super) fn since_boot(time: takt_rt::Nanos) -> u64 {
    u64::try_from(time.0).unwrap_or(0)
}

impl Writer {
    pub(super) fn create(path: &Path) -> Result<Self, Error> {
        let file = File::create(path).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::on(file, path)
    }

    /// Creates the file of a part, which must not exist.
    pub(super) fn create_part(path: &Path, part: &Part) -> Result<Self, Error> {
        let file = File::create_new(path).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::part_on(file, path, Some(part))
    }

    /// Creates a file that must not exist.
    pub(super) fn create_new(path: &Path) -> Result<Self, Error> {
        let file = File::create_new(path).map_err(|source| Error::File {
            path: path.to_owned(),
            source,
        })?;
        Self::on(file, path)
    }
}

impl<W: Write> Sink for Writer<W> {
    fn channel(&mut self, topic: &str, schema: &str, text: &str) -> Result<u16, Error> {
        let none = BTreeMap::new();
        self.try_with(|mcap| {
            let schema = mcap.schema(schema, SCHEMAS, text)?;
            mcap.channel(schema, topic, ENCODING, &none)
        })
    }

    fn message(&mut self, channel_id: u16, data: &[u8], at: Stamp) -> Result<(), Error> {
        self.sequence = self.sequence.wrapping_add(1);
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: at.0,
            publish_time: at.0,
        };
        self.try_with(|mcap| mcap.message(header, data))
    }
}

impl<W: Write> Writer<W> {
    /// Begins the file.
    pub(super) fn on(to: W, path: &Path) -> Result<Self, Error> {
        Self::part_on(to, path, None)
    }

    /// Begins the file of a part of a recording.
    pub(super) fn part_on(to: W, path: &Path, part: Option<&Part>) -> Result<Self, Error> {
        let failed = |error: io::Error| broken(path, 0, &error);
        let mut mcap = McapFile::begin(to, "ros2").map_err(failed)?;
        let mut format = BTreeMap::from([("format".to_owned(), FORMAT.to_owned())]);
        if let Some(Part { recording, number }) = part {
            format.insert("recording".to_owned(), recording.clone());
            format.insert("part".to_owned(), number.to_string());
        }
        let mut schema = |of: &schemas::Schema| {
            let text = of.text();
            mcap.schema(of.name, SCHEMAS, &text)
        };
        let words = schema(&schemas::WORDS).map_err(failed)?;
        let text = schema(&schemas::STRING).map_err(failed)?;
        let mut channels = [0; 4];
        let kinds = [
            (words, CYCLES),
            (text, DEVICES),
            (text, NETS),
            (text, MACHINES),
        ];
        for (channel, (schema, topic)) in channels.iter_mut().zip(kinds) {
            *channel = mcap
                .channel(schema, topic, ENCODING, &format)
                .map_err(failed)?;
        }
        Ok(Self {
            bytes: mcap.bytes(),
            mcap: Some(mcap),
            path: path.to_owned(),
            channels,
            cdr: Cdr::default(),
            encoder: Encoder::default(),
            messages: Messages::default(),
            sequence: 0,
            written: 0,
            in_use: None,
            is_repeating: false,
            epoch: epoch(),
        })
    }

    /// Keeps what the next part repeats.
    pub(super) fn repeats(&mut self) {
        self.in_use = Some(InUse::default());
    }

    /// Goes on after another part: with its time, and all that is in use.
    pub(super) fn after(mut self, before: &mut Self) -> Result<Self, Error> {
        self.epoch = before.epoch;
        self.written = before.written;
        self.messages.continue_after(&mut before.messages);
        self.repeats();
        self.is_repeating = true;
        let in_use = before.in_use.take().unwrap_or_default();
        in_use.into_notes().try_for_each(|note| self.note(&note))?;
        self.is_repeating = false;
        Ok(self)
    }

    /// Executes an operation on the file; after an error the file is not changed.
    fn try_with<T>(
        &mut self,
        act: impl FnOnce(&mut McapFile<W>) -> io::Result<T>,
    ) -> Result<T, Error> {
        let ended = || wrong(&self.path, "the recording has ended before".to_owned());
        let mcap = self.mcap.as_mut().ok_or_else(ended)?;
        let result = act(mcap);
        self.bytes = mcap.bytes();
        result.map_err(|error| {
            self.mcap = None;
            broken(&self.path, self.written, &error)
        })
    }

    /// Unix time at the zero of the host's monotonic clock, ns.
    pub(super) const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Unix time of a reading of the host's monotonic clock.
    pub(super) fn stamp(&self, time: takt_rt::Nanos) -> Stamp {
        Stamp(self.epoch.saturating_add(since_boot(time)))
    }

    /// Ends the chunk and flushes the buffer to the file.
    pub(super) fn flush(&mut self) -> Result<(), Error> {
        self.try_with(McapFile::flush)
    }

    /// Bytes that were written to the disk.
    pub(super) const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Attaches a text.
    pub(super) fn attach(&mut self, name: &str, text: &str) -> Result<(), Error> {
        let at = self.stamp(monotonic()).0;
        self.try_with(|mcap| mcap.attach(name, text, at))
    }

    /// Describes the file by keys and values.
    pub(super) fn describe(&mut self, values: BTreeMap<String, String>) -> Result<(), Error> {
        self.try_with(|mcap| mcap.describe(values))
    }

    /// Changes the messages for viewers, which write to this file.
    pub(super) fn show<T>(
        &mut self,
        act: impl FnOnce(&mut Messages, &mut Self) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let mut messages = std::mem::take(&mut self.messages);
        let result = act(&mut messages, self);
        self.messages = messages;
        result
    }

    /// Writes what a replay needs to know, as TOML.
    fn toml<T: Serialize>(&mut self, channel: u16, value: &T, at: Stamp) -> Result<(), Error> {
        let text = toml::to_string(value).map_err(|e| Error::Recording {
            path: self.path.clone(),
            why: format!("cannot write a note: {e}"),
        })?;
        let mut cdr = std::mem::take(&mut self.cdr);
        let result = self.message(channel, cdr.begin().text(&text).bytes(), at);
        self.cdr = cdr;
        result
    }

    pub(super) fn note(&mut self, note: &Note) -> Result<(), Error> {
        if let Some(in_use) = &mut self.in_use {
            in_use.note(note);
        }
        let is_repeated = self.is_repeating;
        let [_, devices, nets, machines] = self.channels;
        let at = self.stamp(monotonic());
        match note {
            Note::Device {
                number,
                place,
                description,
            } => {
                self.show(|shown, file| {
                    shown.device(file, *number, ShownDevice::of(place, description))
                })?;
                let mut note = DeviceNote::new(*number, place, description);
                note.is_repeated = is_repeated;
                self.toml(devices, &DeviceEvent::Came(note), at)
            }
            Note::Gone(name) => {
                self.show(|shown, file| {
                    shown.device_gone(file, name);
                    Ok(())
                })?;
                let name = name.clone();
                self.toml(devices, &DeviceEvent::Went { name }, at)
            }
            Note::Net {
                id,
                every,
                period,
                text,
                values,
            } => {
                self.show(|shown, file| shown.net(file, (*id, values), at))?;
                let note = NetNote {
                    id: *id,
                    every: *every,
                    period_ns: u64::try_from(period.as_nanos()).unwrap_or(u64::MAX),
                    text: text.as_ref().to_owned(),
                    is_repeated,
                };
                self.toml(nets, &note, at)
            }
            Note::Machine {
                id,
                text,
                files,
                program,
            } => {
                self.messages.machine(*id, program);
                let note = MachineNote {
                    id: *id,
                    text: text.as_ref().to_owned(),
                    files: files.clone(),
                    is_repeated,
                };
                self.toml(machines, &note, at)
            }
            Note::Frames(frames) => self.show(|shown, file| shown.frames(file, frames, at)),
            Note::Log { level, name, text } => {
                self.show(|shown, file| shown.log(file, (*level, name, text), at))
            }
        }
    }

    pub(super) fn cycle(&mut self, words: &[u64]) -> Result<(), Error> {
        let [cycles, ..] = self.channels;
        self.written += 1;
        let at = start(words).map_or_else(monotonic, |moment| takt_rt::Nanos(moment.wall.0));
        let at = self.stamp(at);
        let mut cdr = std::mem::take(&mut self.cdr);
        let bytes = cdr.begin().words(self.encoder.encode(words)).bytes();
        let result = self.message(cycles, bytes, at);
        self.cdr = cdr;
        result?;
        if let Some(in_use) = &mut self.in_use {
            ended(words, in_use);
        }
        self.show(|shown, file| shown.cycle(file, words, at))
    }

    pub(super) fn finish(&mut self) -> Result<(), Error> {
        let ended = || wrong(&self.path, "the recording has ended before".to_owned());
        let finished = self.mcap.take().ok_or_else(ended)?.finish();
        self.bytes = finished.map_err(|error| broken(&self.path, self.written, &error))?;
        Ok(())
    }
}

impl<W: Write> Drop for Writer<W> {
    fn drop(&mut self) {
        // Of a thread that panicked, or failed otherwise than by the file.
        if self.mcap.is_some() {
            let _ = self.finish();
        }
    }
}

/// Removes what ended in a cycle from what is in use.
fn ended(words: &[u64], in_use: &mut InUse) {
    let mut reader = Reader(words);
    while let Ok(Some(entry)) = reader.next() {
        match entry {
            Entry::Ended(net, ..) => in_use.net_ended(net),
            Entry::MachineRemoved(machine) => in_use.machine_removed(machine),
            Entry::Started(_)
            | Entry::Succeeded(_)
            | Entry::Cancelled(_)
            | Entry::Aborted(_)
            | Entry::Stopped(_)
            | Entry::RanAway(_)
            | Entry::Takeover(..)
            | Entry::MachineAdded(_)
            | Entry::Seated(..)
            | Entry::SeatFailed(..)
            | Entry::MachineInput(..)
            | Entry::Inbox(..)
            | Entry::Inputs(_)
            | Entry::Outbox(..)
            | Entry::Outputs(_)
            | Entry::Stepped(..)
            | Entry::Changed(..) => {}
        }
    }
}

/// The error of a failed write, with the cycle and a hint.
fn broken(path: &Path, cycle: u64, error: &io::Error) -> Error {
    use io::ErrorKind as E;
    let is_full = matches!(
        error.kind(),
        E::StorageFull | E::QuotaExceeded | E::FileTooLarge
    );
    let hint = if is_full {
        "\nhint: free space on that disk (`df -h`) and record again; the written part stays readable"
    } else {
        "\nhint: check the disk (`dmesg`); the written part stays readable"
    };
    wrong(
        path,
        format!("the recording ended at cycle {cycle}: {error}{hint}"),
    )
}
