//! `takt ecat foe`: reads files of a slave, and updates its firmware in BOOT.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, ensure};
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use takt_ethercat::AlState;
use takt_ethercat::config::Timeouts;
use takt_ethercat::foe::FileName;
use takt_ethercat::master::{JobError, JobKind};
use takt_ethercat::sii::Identity;

use super::session::{Session, Wire};
use super::{REQUEST_CYCLE, Target, scan, state};
use crate::output::{complain, say, span};
use crate::signal::Stop;
use crate::{Verdict, confirm};

/// Read files of a slave and update its firmware (FoE).
///
/// All other slaves are brought to PRE-OP. Ctrl-C ends a read; an update it ends only if pressed twice. An update that fails says
/// in which state the slave is left. Exit status: 0 done; 1 the slave refuses, with its reason; 2 it could not be tried.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  takt ecat foe enp2s0 3 read log.txt --to log.txt
  takt ecat foe enp2s0 3 write firmware.efw --yes
  takt ecat foe enp2s0 3 write drive.bin --name FW --password 0x1234 --yes")]
pub(crate) struct Foe {
    #[command(flatten)]
    target: Target,
    /// The slave: its position from 0, or its name or order code if it is unique.
    slave: String,
    /// How long one answer may take; slaves erase flash memory meanwhile.
    #[arg(long, value_name = "TIME", default_value = "30s", value_parser = span)]
    answer: Duration,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Read a file of the slave, in PRE-OP.
    Read {
        /// Its name on the slave.
        name: String,
        /// Where to store it.
        #[arg(long, value_name = "FILE")]
        to: PathBuf,
        /// A number that the slave demands.
        #[arg(long, value_name = "N", default_value = "0", value_parser = number)]
        password: u32,
    },
    /// Write a file to the slave: its firmware, in BOOT. Then the slave starts with it.
    Write {
        /// The file.
        file: PathBuf,
        /// Its name on the slave; default: that of the file without its extension.
        #[arg(long)]
        name: Option<String>,
        /// A number that the slave demands.
        #[arg(long, value_name = "N", default_value = "0", value_parser = number)]
        password: u32,
        /// Write in PRE-OP, as slaves without BOOT demand.
        #[arg(long)]
        pre_op: bool,
        /// Overwrite the firmware without asking.
        #[arg(long)]
        yes: bool,
    },
}

/// Longest file, bytes.
const FILE_MAX: usize = 16 << 20;

fn number(text: &str) -> Result<u32, String> {
    let digits = text.strip_prefix("0x");
    let number = digits.map_or_else(|| text.parse(), |hex| u32::from_str_radix(hex, 16));
    number.map_err(|_| format!("`{text}` is not a number such as 4660 or 0x1234"))
}

impl Foe {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let work = Work::of(&self.action)?;
        let mut session = self.target.bring_up(AlState::PreOp, REQUEST_CYCLE)?;
        let slave = session.find(&self.slave)?;
        if let Action::Write { file, yes, .. } = &self.action {
            let what = format!(
                "this overwrites the firmware of slave {slave} by {}",
                file.display()
            );
            confirm::change(&what, *yes)?;
        }
        let stop = Stop::listen()?;
        let (bar, timeout) = (bar(work.content.len()), self.target.timeout);
        let (times, writes) = ((self.answer, timeout), work.writes());
        let mut interrupts = Interrupts::new(writes);
        let done = transfer(&mut session, slave, work, times, |bytes| {
            bar.set_position(u64::try_from(bytes).unwrap_or(u64::MAX));
            interrupts.goes_on(stop.requests(), |line| bar.suspend(|| complain(line)))
        })?;
        bar.finish_and_clear();
        let content = match done {
            Ok(content) => content,
            Err(why) => {
                complain(&format!("takt: slave {slave}: {why}"));
                return Ok(Verdict::Failed);
            }
        };
        if let Action::Read { name, to, .. } = &self.action {
            std::fs::write(to, &content)
                .with_context(|| format!("cannot write {}", to.display()))?;
            let (len, to) = (content.len(), to.display());
            say(&format!(
                "slave {slave}: {name}, {len} bytes, stored in {to}"
            ))?;
            return Ok(Verdict::Good);
        }
        say(&format!("slave {slave}: {} bytes written", content.len()))?;
        started(&mut session, slave, timeout)
    }
}

/// A file to transfer, in which state.
#[derive(Debug)]
pub(super) struct Work {
    pub(super) state: AlState,
    pub(super) kind: JobKind,
    /// What is written, or the buffer for what is read.
    pub(super) content: Vec<u8>,
}

impl Work {
    const fn writes(&self) -> bool {
        matches!(self.kind, JobKind::WriteFile { .. })
    }

    fn of(action: &Action) -> anyhow::Result<Self> {
        let named = |name: &str| {
            FileName::new(name).with_context(|| {
                format!("`{name}` is no file name on a slave\nhint: write 1 to 48 bytes by --name")
            })
        };
        Ok(match action {
            Action::Read { name, password, .. } => Self {
                state: AlState::PreOp,
                kind: JobKind::ReadFile {
                    name: named(name)?,
                    password: *password,
                },
                content: Vec::with_capacity(FILE_MAX),
            },
            Action::Write {
                file,
                name,
                password,
                pre_op,
                ..
            } => {
                let content = read(file)?;
                let stem = file.file_stem().unwrap_or_default().to_string_lossy();
                let name = named(name.as_deref().unwrap_or(&stem))?;
                let password = *password;
                Self {
                    state: if *pre_op {
                        AlState::PreOp
                    } else {
                        AlState::Boot
                    },
                    kind: JobKind::WriteFile { name, password },
                    content,
                }
            }
        })
    }
}

fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    let content = takt_core::files::read(file, u64::try_from(FILE_MAX).unwrap_or(u64::MAX))
        .with_context(|| format!("cannot read {}", file.display()))?;
    ensure!(!content.is_empty(), "{} is empty", file.display());
    Ok(content)
}

fn bar(len: usize) -> ProgressBar {
    let bar = ProgressBar::new(u64::try_from(len).unwrap_or(u64::MAX));
    let template = "{bar:40} {bytes}/{total_bytes} {bytes_per_sec} {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// How many requests to stop end a transfer: a slave whose update is interrupted has no firmware, so that the first one is
/// answered by a warning.
#[derive(Debug)]
struct Interrupts {
    enough: u32,
    warned: bool,
}

impl Interrupts {
    const fn new(writes: bool) -> Self {
        Self {
            enough: if writes { 2 } else { 1 },
            warned: false,
        }
    }

    /// Whether the transfer continues after this number of requests.
    fn goes_on(&mut self, requests: u32, mut warn: impl FnMut(&str)) -> bool {
        if requests > 0 && requests < self.enough && !self.warned {
            self.warned = true;
            warn(
                "takt: the update continues: interrupted, it leaves the slave without a whole firmware\n\
             hint: Ctrl-C again ends it nevertheless",
            );
        }
        requests < self.enough
    }
}

/// What a transfer that failed leaves behind, after this number of bytes.
fn left<W: Wire>(session: &Session<W>, slave: usize, writes: bool, done: usize) -> String {
    let state = session.master().slave(slave).map(scan::state);
    let state = state.unwrap_or_default();
    if !writes {
        return format!("it is left in {state}");
    }
    if done == 0 {
        return format!(
            "no byte of the file was accepted, and it is left in {state}\n\
             hint: `takt ecat scan` brings it back to PRE-OP if its firmware is whole"
        );
    }
    format!(
        "its firmware is incomplete, and it is left in {state}\n\
             hint: write the file again; until then do not switch it off, and start no controller, which leaves BOOT"
    )
}

/// Transfers a file while `goes_on` returns true for the number of bytes transferred; the inner error is the reason of the
/// slave and what is left.
pub(super) fn transfer<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    work: Work,
    (answer, timeout): (Duration, Duration),
    mut goes_on: impl FnMut(usize) -> bool,
) -> anyhow::Result<Result<Vec<u8>, String>> {
    let timeouts = Timeouts {
        mailbox: answer,
        ..Timeouts::default()
    };
    session.hold(slave, work.state, Some(timeouts), timeout)?;
    let fault = session
        .master()
        .slave(slave)
        .and_then(|slave| slave.fault());
    if let Some(fault) = fault {
        return Ok(Err(fault.to_string()));
    }
    let (writes, len, mut done) = (work.writes(), work.content.len(), 0);
    let ended = session.transfer(slave, work.kind, work.content, |bytes| {
        done = done.max(bytes);
        goes_on(bytes)
    })?;
    let Some((result, data)) = ended else {
        let all = if writes {
            format!(" of {len}")
        } else {
            String::new()
        };
        let left = left(session, slave, writes, done);
        return Ok(Err(format!("interrupted after {done}{all} bytes; {left}")));
    };
    Ok(match result {
        Ok(()) => Ok(data),
        Err(error) => {
            let left = left(session, slave, writes, done);
            let said = String::from_utf8_lossy(&data);
            let said = said.trim_matches(|c: char| c == '\0' || c.is_whitespace());
            let is_text = matches!(error, JobError::File(_)) && !said.is_empty();
            let said = if is_text {
                format!(": \"{said}\"")
            } else {
                String::new()
            };
            Err(format!("{error}{said}; {left}"))
        }
    })
}

/// Starts the slave with its new firmware and shows its identity.
fn started<W: Wire>(
    session: &mut Session<W>,
    slave: usize,
    timeout: Duration,
) -> anyhow::Result<Verdict> {
    let identity = |session: &Session<W>| -> Option<Identity> {
        session
            .master()
            .slave(slave)
            .map(|slave| slave.info().identity)
    };
    let before = identity(session);
    let init = state::request(session, slave, AlState::Init, timeout)?;
    let shown = match init {
        Ok(()) => state::request(session, slave, AlState::PreOp, timeout)?,
        Err(why) => Err(why),
    };
    match shown {
        Ok(()) => {
            let after = identity(session);
            let (Some(before), Some(after)) = (before, after) else {
                return Ok(Verdict::Good);
            };
            say(&format!(
                "slave {slave}: PRE-OP with its new firmware, revision {:08X}h, before {:08X}h",
                after.revision, before.revision
            ))?;
            Ok(Verdict::Good)
        }
        Err(why) => {
            complain(&format!(
                "takt: slave {slave} does not start after the update: {why}\nhint: switch it off and on; in BOOT it may still \
                 take a firmware"
            ));
            Ok(Verdict::Failed)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ecat::tests::up;
    use takt_ethercat::emulator::{Coupler, Segment, ServoConfig, ServoDrive};

    const TIMES: (Duration, Duration) = (Duration::from_secs(5), Duration::from_secs(10));

    fn work(state: AlState, writes: bool, content: Vec<u8>) -> Work {
        let (name, password) = (FileName::new("fw").unwrap(), 0);
        let kind = if writes {
            JobKind::WriteFile { name, password }
        } else {
            JobKind::ReadFile { name, password }
        };
        Work {
            state,
            kind,
            content,
        }
    }

    #[test]
    fn foe_update_passes_boot_and_ends_in_pre_op() {
        let drive = ServoDrive::slave(ServoConfig::default()).unwrap().0;
        let segment = Segment::line([Coupler::slave(), drive.with_files()]);
        let mut session = up(segment, AlState::PreOp);
        let files = session.wire().segment.slave(1).unwrap().files().unwrap();
        files.lock().busy = 2;
        let firmware: Vec<u8> = (0..10_000_u32).flat_map(u32::to_le_bytes).collect();
        let refused = work(AlState::PreOp, true, firmware.clone());
        let refused = transfer(&mut session, 1, refused, TIMES, |_| true).unwrap();
        let text = refused.unwrap_err();
        let start = "the slave refuses the file: in BOOT only (FoE 8008h): \"emulated\"; no byte of the file was accepted, \
                     and it is left in PRE-OP\nhint: ";
        assert!(text.starts_with(start), "{text}");
        let mut seen = Vec::new();
        let write = work(AlState::Boot, true, firmware.clone());
        let written = transfer(&mut session, 1, write, TIMES, |done| {
            seen.push(done);
            true
        });
        let written = written.unwrap();
        assert_eq!(written.as_ref(), Ok(&firmware));
        assert!(seen.len() > 100 && seen.is_sorted(), "{seen:?}");
        assert_eq!(files.lock().files[&b"fw"[..]], firmware);
        let verdict = started(&mut session, 1, TIMES.1).unwrap();
        assert_eq!(verdict, Verdict::Good);
        let state = session.master().slave(1).unwrap().al().0.state;
        assert_eq!(state, AlState::PreOp);
        let read = work(AlState::PreOp, false, Vec::with_capacity(1 << 20));
        let read = transfer(&mut session, 1, read, TIMES, |_| true).unwrap();
        assert_eq!(read, Ok(firmware));
    }

    #[test]
    fn foe_update_interrupted_names_state_left() {
        let drive = ServoDrive::slave(ServoConfig::default()).unwrap().0;
        let segment = Segment::line([Coupler::slave(), drive.with_files()]);
        let mut session = up(segment, AlState::PreOp);
        let firmware = vec![7; 40_000];
        // As on the command line: two requests to stop, one early and one late.
        let (mut interrupts, mut warnings) = (Interrupts::new(true), Vec::new());
        let write = work(AlState::Boot, true, firmware.clone());
        let ended = transfer(&mut session, 1, write, TIMES, |done| {
            let requests = u32::from(done > 1000) + u32::from(done > 20_000);
            interrupts.goes_on(requests, |line| warnings.push(line.to_owned()))
        });
        let text = ended.unwrap().unwrap_err();
        assert!(text.starts_with("interrupted after 2"), "{text}");
        let left = "of 40000 bytes; its firmware is incomplete, and it is left in BOOT\nhint: ";
        assert!(text.contains(left), "{text}");
        assert!(
            matches!(&warnings[..], [one] if one.contains("Ctrl-C again")),
            "{warnings:?}"
        );
        let shown = session.wire().segment.slave(1).unwrap().state();
        assert_eq!(shown, AlState::Boot);
        // As said: it does not start, and takes the file again.
        assert_eq!(started(&mut session, 1, TIMES.1).unwrap(), Verdict::Failed);
        let again = work(AlState::Boot, true, firmware.clone());
        let again = transfer(&mut session, 1, again, TIMES, |_| true).unwrap();
        assert_eq!(again, Ok(firmware));
        assert_eq!(started(&mut session, 1, TIMES.1).unwrap(), Verdict::Good);
        // A read ends at the first request, and leaves nothing behind.
        let mut interrupts = Interrupts::new(false);
        let read = work(AlState::PreOp, false, Vec::with_capacity(1 << 20));
        let ended = transfer(&mut session, 1, read, TIMES, |done| {
            interrupts.goes_on(u32::from(done > 1000), |_| panic!("no warning"))
        });
        let text = ended.unwrap().unwrap_err();
        assert!(text.ends_with("bytes; it is left in PRE-OP"), "{text}");
    }
}
