//! A recording in several files of bounded size, its parts. Each is complete: it repeats the devices, nets and machines that are
//! in use when it begins, so that viewers open it alone. A replay needs all parts from the first.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::cell::CellFrames;
use crate::error::Error;
use crate::record::file::Writer;
use crate::record::notes::Note;
use crate::record::utc;

/// Least bytes of a part: those of a few chunks.
pub const PART_BYTES_MIN: u64 = 4 << 20;
/// Maximum number and bytes of nets that a part repeats; the oldest are left out.
const NETS_MAX: usize = 1024;
const NET_BYTES_MAX: usize = 16 << 20;

/// When a recording goes on in another file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    /// Bytes of a file, at least [`PART_BYTES_MIN`]; it ends with the chunk that exceeds them.
    pub bytes: u64,
    /// Number of files that are kept, this and earlier recordings of that name together; `None` for all.
    pub keep: Option<usize>,
}

/// The place of a file in its recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// When the recording began, as text: the same in all its parts.
    pub(super) recording: String,
    /// From 1.
    pub(super) number: u32,
}

/// Opens the next file.
type Open<W> = Box<dyn FnMut(&Part) -> Result<Writer<W>, Error> + Send>;

/// The parts of a recording.
pub(super) struct Parts<W: Write> {
    bytes: u64,
    part: Part,
    open: Open<W>,
}

impl Parts<File> {
    /// Parts beside that path: `run.mcap` gives `run-<time>-0001.mcap` and so on. Returns the first as well.
    ///
    /// # Errors
    /// If the size is too small, or the first file cannot be created.
    pub(super) fn beside(path: &Path, rotation: Rotation) -> Result<(Self, Writer), Error> {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH);
        let recording = utc::text(unix.unwrap_or_default());
        let path = path.to_owned();
        let open = move |part: &Part| {
            let (path, stem) = (path_of(&path, part), stem_of(&path));
            if let Some(keep) = rotation.keep {
                for deleted in prune(&path, &stem, keep.max(1)) {
                    tracing::info!("recording: deleted {}, the oldest", deleted.display());
                }
            }
            Writer::create_part(&path, part)
        };
        Self::new(rotation.bytes, recording, Box::new(open))
    }
}

impl<W: Write> Parts<W> {
    pub(super) fn new(
        bytes: u64,
        recording: String,
        mut open: Open<W>,
    ) -> Result<(Self, Writer<W>), Error> {
        let part = Part {
            recording,
            number: 1,
        };
        let mut first = open(&part)?;
        first.repeats();
        Ok((Self { bytes, part, open }, first))
    }

    /// Goes on in the next file if this one has its size.
    ///
    /// # Errors
    /// If this one cannot be ended, or the next one cannot be created.
    pub(super) fn rotate(&mut self, writer: &mut Writer<W>) -> Result<(), Error> {
        if writer.bytes() < self.bytes {
            return Ok(());
        }
        writer.finish()?;
        self.part.number += 1;
        let next = (self.open)(&self.part)?;
        *writer = next.after(writer)?;
        Ok(())
    }
}

fn stem_of(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn path_of(path: &Path, part: &Part) -> PathBuf {
    let Part { recording, number } = part;
    path.with_file_name(format!("{}-{recording}-{number:04}.mcap", stem_of(path)))
}

/// Deletes the oldest parts of all recordings of that name beside a new one until it is one of `keep`. Returns them.
fn prune(new: &Path, stem: &str, keep: usize) -> Vec<PathBuf> {
    let directory = new.parent().filter(|it| !it.as_os_str().is_empty());
    let entries = std::fs::read_dir(directory.unwrap_or_else(|| Path::new(".")));
    let names = entries.into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let mut parts: Vec<_> = names.filter(|name| is_part(name, stem)).collect();
    // Numbers beyond 9999 are longer.
    parts.sort_by_key(|name| {
        let (recording, number) = name.rsplit_once('-').unwrap_or_default();
        (recording.to_owned(), number.len(), number.to_owned())
    });
    let excess = (parts.len() + 1).saturating_sub(keep);
    let oldest = parts.into_iter().take(excess);
    let paths = oldest.map(|name| new.with_file_name(name));
    paths
        .filter(|path| std::fs::remove_file(path).is_ok())
        .collect()
}

/// Whether a file is a part of a recording of that name: `<stem>-<time>-<number>.mcap`.
fn is_part(name: &str, stem: &str) -> bool {
    let rest = name.strip_prefix(stem).and_then(|it| it.strip_prefix('-'));
    let parts = rest.and_then(|it| it.strip_suffix(".mcap")?.split_once('-'));
    parts.is_some_and(|(time, number)| {
        let digits = |text: &str| text.bytes().all(|it| it.is_ascii_digit());
        utc::is_text(time) && number.len() >= 4 && digits(number)
    })
}

/// What a part repeats: devices, nets and machines in use, and where things are.
#[derive(Debug, Default)]
pub(super) struct InUse {
    devices: BTreeMap<usize, Note>,
    nets: BTreeMap<u32, Note>,
    net_bytes: usize,
    machines: BTreeMap<u32, Note>,
    frames: Option<CellFrames>,
}

impl InUse {
    pub(super) fn note(&mut self, note: &Note) {
        match note {
            Note::Device { number, .. } => {
                self.devices.insert(*number, note.clone());
            }
            Note::Gone(name) => self.devices.retain(|_, device| {
                !matches!(device, Note::Device { description, .. } if description.name == *name)
            }),
            Note::Net { id, text, .. } => {
                self.nets.insert(*id, note.clone());
                self.net_bytes += text.len();
                while self.nets.len() > NETS_MAX || self.net_bytes > NET_BYTES_MAX {
                    let Some(oldest) = self.nets.keys().next().copied() else {
                        break;
                    };
                    self.net_ended(oldest);
                }
            }
            Note::Machine { id, .. } => {
                self.machines.insert(*id, note.clone());
            }
            Note::Frames(frames) => self.frames = Some(frames.clone()),
            Note::Log { .. } => {}
        }
    }

    pub(super) fn net_ended(&mut self, id: u32) {
        if let Some(Note::Net { text, .. }) = self.nets.remove(&id) {
            self.net_bytes -= text.len();
        }
    }

    pub(super) fn machine_removed(&mut self, id: u32) {
        self.machines.remove(&id);
    }

    /// All of it as notes for another file.
    pub(super) fn into_notes(self) -> impl Iterator<Item = Note> {
        let frames = self.frames.map(Note::Frames);
        let nets = self.nets.into_values();
        let machines = self.machines.into_values();
        let devices = self.devices.into_values();
        frames
            .into_iter()
            .chain(devices)
            .chain(nets)
            .chain(machines)
    }
}
