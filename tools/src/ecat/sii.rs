//! `takt ecat sii`: the EEPROM of one slave: reads and decodes it, saves it to a file, writes it back, sets the alias.
//! The slave loads it at its next power-on.

mod decode;

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use takt_ethercat::AlState;
use takt_ethercat::master::{JobError, JobKind};
use takt_ethercat::sii::{self, Identity};

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target};
use crate::output::{complain, say, span};
use crate::signal::Stop;
use crate::{Verdict, confirm};

pub(super) use decode::text;

/// Read, decode and write the slave information (SII) in the EEPROM of a slave.
///
/// Slaves are brought to PRE-OP if possible; a slave with an empty or invalid EEPROM is accessible too. A file to write
/// must fit the slave: correct checksum, same vendor and product, not larger than its EEPROM. Exit status: 0 done; 1 the
/// slave refuses, or the value read back differs; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat sii enp2s0 3
  takt ecat sii enp2s0 3 --raw > slave3.bin
  takt ecat sii --from slave3.bin
  takt ecat sii enp2s0 3 --write slave3.bin --yes
  takt ecat sii enp2s0 3 --alias 12 --yes")]
pub(crate) struct Sii {
    /// The network interface, as `ip link` lists it.
    #[arg(value_name = "IFACE", required_unless_present = "from")]
    interface: Option<String>,
    /// The slave: its position from 0, or its name or order code if it is unique.
    #[arg(value_name = "SLAVE", required_unless_present = "from")]
    slave: Option<String>,
    /// Decode this file instead of a slave.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["interface", "slave", "write", "alias", "raw"])]
    from: Option<PathBuf>,
    /// Write the bytes of the EEPROM to standard output.
    #[arg(long, conflicts_with_all = ["write", "alias"])]
    raw: bool,
    /// Write this file to the EEPROM, and read it back.
    #[arg(long, value_name = "FILE", conflicts_with = "alias")]
    write: Option<PathBuf>,
    /// Set the station alias, 0 to 65535, and the checksum.
    #[arg(long, value_name = "N")]
    alias: Option<u16>,
    /// Change the EEPROM without asking.
    #[arg(long)]
    yes: bool,
    /// How long slaves may take to reach their state.
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = span)]
    timeout: Duration,
}

impl Sii {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        if let Some(path) = &self.from {
            let name = path.display().to_string();
            let bytes = file(path)?;
            say(text(&name, &bytes).trim_end())?;
            return Ok(verdict(&bytes));
        }
        let target = Target {
            interface: self.interface.unwrap_or_default(),
            second: None,
            timeout: self.timeout,
        };
        let change = match (&self.write, self.alias) {
            (Some(path), _) => Some(Change::Image(file(path)?)),
            (None, Some(alias)) => Some(Change::Alias(alias)),
            (None, None) => None,
        };
        let mut session = target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let slave = session.find(&self.slave.unwrap_or_default())?;
        let Some(change) = change else {
            return show(&mut session, slave, self.raw);
        };
        match read(&mut session, slave)? {
            Ok(present) => {
                let changes = change.words(&present)?;
                if changes.is_empty() {
                    say(&format!("slave {slave} has these values already"))?;
                    return Ok(Verdict::Good);
                }
                let count = changes.len();
                let change =
                    format!("this overwrites {count} words of the EEPROM of slave {slave}");
                confirm::change(&change, self.yes)?;
                // Ctrl-C does not interrupt the write.
                let _stop = Stop::listen()?;
                print(slave, write(&mut session, slave, &changes, &present)?)
            }
            Err(error) => print(slave, Err(error.to_string())),
        }
    }
}

fn file(path: &Path) -> anyhow::Result<Vec<u8>> {
    takt_core::files::read(path, takt_core::files::TEXT_BYTES_MAX)
        .with_context(|| format!("cannot read {}", path.display()))
}

/// A wrong checksum is a fault of the slave.
fn verdict(bytes: &[u8]) -> Verdict {
    if sii::Sii::new(bytes).is_checked() {
        Verdict::Good
    } else {
        Verdict::Failed
    }
}

fn show<W: Wire>(session: &mut Session<W>, slave: usize, raw: bool) -> anyhow::Result<Verdict> {
    let bytes = match read(session, slave)? {
        Ok(bytes) => bytes,
        Err(error) => return print(slave, Err(error.to_string())),
    };
    if raw {
        crate::output::print(&bytes)?;
    } else {
        let name = format!("{} slave {slave}", session.interface());
        say(text(&name, &bytes).trim_end())?;
    }
    Ok(verdict(&bytes))
}

fn print(slave: usize, result: Result<String, String>) -> anyhow::Result<Verdict> {
    match result {
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

/// Words that one job reads.
const WORDS_PER_JOB: u16 = 64;

/// The whole EEPROM: its size is in word 3Eh, or 2 KiB if that is invalid.
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
        let words = JobKind::ReadSii {
            word,
            words: WORDS_PER_JOB,
        };
        match submit(session, slave, words, &[])? {
            Ok(more) if !more.is_empty() => bytes.extend(more),
            Ok(_) => return Ok(Ok(bytes)),
            Err(error) => return Ok(Err(error)),
        }
    }
}

fn submit<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    kind: JobKind,
    data: &[u8],
) -> anyhow::Result<Result<Vec<u8>, JobError>> {
    let mut memory = Vec::with_capacity(2 * usize::from(WORDS_PER_JOB));
    memory.extend_from_slice(data);
    session.request(slave, kind, memory)
}

/// A change of an EEPROM.
#[derive(Clone, Debug)]
pub(super) enum Change {
    /// These bytes from its start.
    Image(Vec<u8>),
    /// The alias.
    Alias(u16),
}

/// A word address and its new value.
pub(super) type Word = (u16, [u8; 2]);

impl Change {
    /// The words that differ from the present content.
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
        // The words that the slave controller loads are written last, the checksum at the end: a slave that loses power
        // during the write has either the old configuration or one with a wrong checksum.
        let mut words: Vec<Word> = differ.collect();
        words.sort_by_key(|(word, _)| (*word < 8, *word));
        Ok(words)
    }
}

/// Checks that an image fits the slave.
fn check(image: &[u8], present: &[u8]) -> anyhow::Result<()> {
    let new = sii::Sii::new(image);
    ensure!(
        image.len() >= 128 && image.len().is_multiple_of(2),
        "the file has {} bytes; an SII has at least 128 bytes, in 16-bit words",
        image.len()
    );
    ensure!(
        image.len() <= present.len(),
        "the file has {} bytes, the EEPROM only {}",
        image.len(),
        present.len()
    );
    let expected = image.get(..14).map_or(0, sii::checksum);
    ensure!(
        new.is_checked(),
        "the checksum in word 7 of the file is {:02X}h instead of {expected:02X}h; the slave would not load it",
        image.get(14).copied().unwrap_or(0)
    );
    let (Some(new), Some(old)) = (new.identity(), sii::Sii::new(present).identity()) else {
        bail!("the slave has no identity");
    };
    ensure!(
        is_blank(old) || (new.vendor, new.product) == (old.vendor, old.product),
        "the file is of {new}, the slave is {old}; the EEPROM of another slave would make it unusable"
    );
    Ok(())
}

/// The identity of an erased EEPROM, or of one that was never written.
const fn is_blank(identity: Identity) -> bool {
    matches!(identity.vendor, 0 | 0xFFFF_FFFF)
}

/// The image with another alias.
fn aliased(present: &[u8], alias: u16) -> anyhow::Result<Vec<u8>> {
    ensure!(
        sii::Sii::new(present).is_checked(),
        "the checksum of its SII is wrong\nhint: write a whole image first (--write)"
    );
    let mut image = present.to_vec();
    if let Some(bytes) = image.get_mut(8..10) {
        bytes.copy_from_slice(&alias.to_le_bytes());
    }
    let sum = image.get(..14).map_or(0, sii::checksum);
    if let Some(checksum) = image.get_mut(14) {
        *checksum = sum;
    }
    Ok(image)
}

/// Attempts for each word; each lasts as long as the master repeats commands that the EEPROM does not acknowledge.
const ATTEMPTS: usize = 5;

/// Writes words and reads them back. If that fails, the words written so far get their present values again: a slave with
/// half of a change would not load its configuration.
pub(super) fn write<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    words: &[Word],
    present: &[u8],
) -> anyhow::Result<Result<String, String>> {
    for (done, word) in words.iter().enumerate() {
        let Err(why) = put(session, slave, *word)? else {
            continue;
        };
        // The word that failed may be stored nevertheless.
        let touched = words.get(..=done).unwrap_or_default();
        let count = words.len();
        return Ok(Err(match restore(session, slave, touched, present)? {
            Ok(()) => format!("{why}\nits EEPROM has its former content again"),
            Err(error) => format!(
                "{why}\nits EEPROM holds {done} of {count} new words, and the former ones cannot be restored: {error}\n\
                 hint: repeat the command before the slave is switched off; else it does not load its configuration"
            ),
        }));
    }
    Ok(Ok(format!(
        "slave {slave}: {} words written and verified; it loads them at its next power-on",
        words.len()
    )))
}

/// Writes the present values of these words again, the last written first.
fn restore<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    words: &[Word],
    present: &[u8],
) -> anyhow::Result<Result<(), String>> {
    for (word, _) in words.iter().rev() {
        let at = 2 * usize::from(*word);
        let former = present.get(at..).and_then(|rest| rest.first_chunk());
        let former = former.copied().unwrap_or([0xFF; 2]);
        if let Err(why) = put(session, slave, (*word, former))? {
            return Ok(Err(why));
        }
    }
    Ok(Ok(()))
}

/// Writes a word until it reads as written.
fn put<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    (word, bytes): Word,
) -> anyhow::Result<Result<(), String>> {
    let mut why = String::new();
    for _ in 0..ATTEMPTS {
        let written = submit(session, slave, JobKind::WriteSii { word }, &bytes)?;
        if let Err(error) = written {
            why = format!("cannot write word {word:04X}h: {error}");
            continue;
        }
        let kind = JobKind::ReadSii { word, words: 1 };
        why = match submit(session, slave, kind, &[])? {
            Ok(found) if found == bytes => return Ok(Ok(())),
            Ok(found) => format!(
                "word {word:04X}h was written as {:02X}{:02X}h but reads as {found:02X?}; the EEPROM is write-protected or \
                 worn out",
                bytes[1], bytes[0]
            ),
            Err(error) => format!("cannot read word {word:04X}h back: {error}"),
        };
    }
    Ok(Err(why))
}

#[cfg(test)]
mod tests;
