//! `takt ecat sii`: the EEPROM of one slave: read and decoded, kept in a file, written back, given an alias. What a
//! slave makes of it at its next power-on is its own affair.

mod decode;

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use takt_ethercat::AlState;
use takt_ethercat::master::{JobError, JobKind};
use takt_ethercat::sii::{self, Identity};

use super::session::{Session, Wire};
use super::{ASKING, Target};
use crate::output::{complain, say, span};
use crate::{Verdict, confirm};

pub(super) use decode::text;

/// Read, decode and write what a slave says of itself: its SII, the EEPROM.
///
/// Slaves are brought to PRE-OP if they can; one with an empty or broken EEPROM is reached all the same. A file that
/// is written must fit the slave: right checksum, same vendor and product, not larger than its EEPROM. Exit
/// status: 0 done; 1 the slave refuses, or what was read back differs; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat sii enp2s0 3
  takt ecat sii enp2s0 3 --raw > slave3.bin
  takt ecat sii --from slave3.bin
  takt ecat sii enp2s0 3 --write slave3.bin --yes
  takt ecat sii enp2s0 3 --alias 12 --yes")]
pub(crate) struct Sii {
    /// The network interface, as `ip link` names it.
    #[arg(value_name = "IFACE", required_unless_present = "from")]
    interface: Option<String>,
    /// The slave: its position from 0, or its name or order code if no other has it.
    #[arg(value_name = "SLAVE", required_unless_present = "from")]
    slave: Option<String>,
    /// Decode this file instead of a slave.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["interface", "slave", "write", "alias", "raw"])]
    from: Option<PathBuf>,
    /// Give the bytes as they are, all of the EEPROM, on standard output.
    #[arg(long, conflicts_with_all = ["write", "alias"])]
    raw: bool,
    /// Write this file into the EEPROM, and read it back.
    #[arg(long, value_name = "FILE", conflicts_with = "alias")]
    write: Option<PathBuf>,
    /// Set the station alias, 0 to 65535, and the checksum with it.
    #[arg(long, value_name = "N")]
    alias: Option<u16>,
    /// Do not ask whether the EEPROM may be changed.
    #[arg(long)]
    yes: bool,
    /// How long slaves may take to their state.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
    patience: Duration,
}

impl Sii {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if let Some(path) = &self.from {
            let name = path.display().to_string();
            let bytes = file(path)?;
            say(text(&name, &bytes).trim_end())?;
            return Ok(judged(&bytes));
        }
        let target = Target {
            interface: self.interface.unwrap_or_default(),
            second: None,
            patience: self.patience,
        };
        let change = match (&self.write, self.alias) {
            (Some(path), _) => Some(Change::Image(file(path)?)),
            (None, Some(alias)) => Some(Change::Alias(alias)),
            (None, None) => None,
        };
        let mut session = target.bring_up(AlState::PreOp, ASKING)?;
        let slave = session.find(&self.slave.unwrap_or_default())?;
        let Some(change) = change else {
            return show(&mut session, slave, self.raw);
        };
        match read(&mut session, slave)? {
            Ok(present) => {
                let changes = change.words(&present)?;
                if changes.is_empty() {
                    say(&format!("slave {slave} has that already"))?;
                    return Ok(Verdict::Good);
                }
                let what = format!("{} words of the EEPROM of slave {slave}", changes.len());
                confirm::change(&format!("this overwrites {what}"), self.yes)?;
                told(slave, write(&mut session, slave, &changes)?)
            }
            Err(error) => told(slave, Err(error.to_string())),
        }
    }
}

fn file(path: &Path) -> anyhow::Result<Vec<u8>> {
    takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
        .with_context(|| format!("cannot read {}", path.display()))
}

/// A checksum that is wrong is a fault of the slave.
fn judged(bytes: &[u8]) -> Verdict {
    if sii::Sii::new(bytes).is_checked() {
        Verdict::Good
    } else {
        Verdict::Failed
    }
}

fn show<W: Wire>(session: &mut Session<W>, slave: usize, raw: bool) -> anyhow::Result<Verdict> {
    let bytes = match read(session, slave)? {
        Ok(bytes) => bytes,
        Err(error) => return told(slave, Err(error.to_string())),
    };
    if raw {
        let mut out = std::io::stdout().lock();
        out.write_all(&bytes)?;
        out.flush()?;
    } else {
        let name = format!("{} slave {slave}", session.interface());
        say(text(&name, &bytes).trim_end())?;
    }
    Ok(judged(&bytes))
}

fn told(slave: usize, what: Result<String, String>) -> anyhow::Result<Verdict> {
    match what {
        Ok(text) => {
            say(&text)?;
            Ok(Verdict::Good)
        }
        Err(text) => {
            complain(&format!("takt: slave {slave}: {text}"));
            Ok(Verdict::Failed)
        }
    }
}

/// Words that are read by one job.
const CHUNK: u16 = 64;

/// The whole EEPROM, as far as word 3Eh says that it goes; 2 KiB where that cannot be.
pub(super) fn read<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
) -> anyhow::Result<Result<Vec<u8>, JobError>> {
    let mut bytes = Vec::new();
    loop {
        let size = sii::Sii::new(&bytes).size().unwrap_or(2048);
        let Ok(word) = u16::try_from(bytes.len() / 2) else {
            return Ok(Ok(bytes));
        };
        if bytes.len() >= size.max(128) {
            return Ok(Ok(bytes));
        }
        let words = JobKind::ReadSii { word, words: CHUNK };
        match asked(session, slave, words, &[])? {
            Ok(more) if !more.is_empty() => bytes.extend(more),
            Ok(_) => return Ok(Ok(bytes)),
            Err(error) => return Ok(Err(error)),
        }
    }
}

fn asked<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    kind: JobKind,
    data: &[u8],
) -> anyhow::Result<Result<Vec<u8>, JobError>> {
    let mut memory = Vec::with_capacity(2 * usize::from(CHUNK));
    memory.extend_from_slice(data);
    session.ask(slave, kind, memory)
}

/// What is to become of an EEPROM.
#[derive(Clone, Debug)]
pub(super) enum Change {
    /// These bytes from its beginning.
    Image(Vec<u8>),
    /// Another alias.
    Alias(u16),
}

/// A word and what it is to be.
pub(super) type Word = (u16, [u8; 2]);

impl Change {
    /// The words that differ from what is there.
    pub(super) fn words(&self, present: &[u8]) -> anyhow::Result<Vec<Word>> {
        let image = match self {
            Self::Image(image) => {
                check(image, present)?;
                image.clone()
            }
            Self::Alias(alias) => aliased(present, *alias)?,
        };
        let pair = |bytes: &[u8]| bytes.first_chunk().copied().unwrap_or([0xFF; 2]);
        let differ = (0..)
            .zip(image.chunks(2).zip(present.chunks(2)))
            .filter(|(_, (new, old))| pair(new) != pair(old))
            .map(|(word, (new, _))| (word, pair(new)));
        // What the controller loads comes last, its checksum at the very end: a slave that loses its power meanwhile
        // keeps a configuration that it either knows or refuses.
        let mut words: Vec<Word> = differ.collect();
        words.sort_by_key(|(word, _)| (*word < 8, *word));
        Ok(words)
    }
}

/// Whether an image is one that this slave can take.
fn check(image: &[u8], present: &[u8]) -> anyhow::Result<()> {
    let new = sii::Sii::new(image);
    ensure!(
        image.len() >= 128 && image.len().is_multiple_of(2),
        "the file has {} bytes; an SII has 128 or more, in words of two",
        image.len()
    );
    ensure!(
        image.len() <= present.len(),
        "the file has {} bytes, the EEPROM {}",
        image.len(),
        present.len()
    );
    let right = image.get(..14).map_or(0, sii::checksum);
    ensure!(
        new.is_checked(),
        "the checksum in word 7 of the file is {:02X}h, {right:02X}h is right; the slave would not load it",
        image.get(14).copied().unwrap_or(0)
    );
    let (Some(new), Some(old)) = (new.identity(), sii::Sii::new(present).identity()) else {
        bail!("the slave tells no identity");
    };
    ensure!(
        is_blank(old) || (new.vendor, new.product) == (old.vendor, old.product),
        "the file is of {new}, the slave has {old}; another slave's EEPROM would make it useless"
    );
    Ok(())
}

/// An EEPROM that was never written, or erased.
const fn is_blank(identity: Identity) -> bool {
    matches!(identity.vendor, 0 | 0xFFFF_FFFF)
}

/// The same image with another alias.
fn aliased(present: &[u8], alias: u16) -> anyhow::Result<Vec<u8>> {
    ensure!(
        sii::Sii::new(present).is_checked(),
        "the checksum of its SII is wrong; write a whole image first (--write)"
    );
    let mut image = present.to_vec();
    if let Some(place) = image.get_mut(8..10) {
        place.copy_from_slice(&alias.to_le_bytes());
    }
    let sum = image.get(..14).map_or(0, sii::checksum);
    if let Some(place) = image.get_mut(14) {
        *place = sum;
    }
    Ok(image)
}

/// Writes words and reads them back.
pub(super) fn write<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    words: &[Word],
) -> anyhow::Result<Result<String, String>> {
    for (done, (word, bytes)) in words.iter().enumerate() {
        let kind = JobKind::WriteSii { word: *word };
        if let Err(error) = asked(session, slave, kind, bytes)? {
            return Ok(Err(format!(
                "word {word:04X}h cannot be written after {done} of {} words: {error}; write again before its power \
                 goes off",
                words.len()
            )));
        }
    }
    for (word, bytes) in words {
        let kind = JobKind::ReadSii {
            word: *word,
            words: 1,
        };
        match asked(session, slave, kind, &[])? {
            Ok(found) if found == bytes => {}
            Ok(found) => {
                return Ok(Err(format!(
                    "word {word:04X}h was written as {:02X}{:02X}h and reads as {found:02X?}; the EEPROM is \
                     protected or worn out",
                    bytes[1], bytes[0]
                )));
            }
            Err(error) => {
                return Ok(Err(format!(
                    "word {word:04X}h cannot be read back: {error}"
                )));
            }
        }
    }
    Ok(Ok(format!(
        "slave {slave}: {} words written and read back; it takes them at its next power-on",
        words.len()
    )))
}

#[cfg(test)]
mod tests;
