//! Recordings of a net thread: all its inputs and outputs, cycle by cycle, as MCAP with messages of ROS 2, and their replay.
//! A replay runs the same [`Executor`] on the recorded inputs and must give the same words.

mod cycles;
mod file;
pub(crate) mod flight;
mod flight_log;
mod fuzz;
mod inspect;
pub(crate) mod journal;
mod live;
mod mcap_file;
mod notes;
mod parts;
mod read;
mod replay;
mod ros2;
#[cfg(test)]
mod tests;
pub(crate) mod utc;
mod values;
mod words;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use takt_machine::Program;
use takt_net::Moment;
use takt_net::netcomm::Directory;
use takt_rt::ring::{Consumer, Producer, ring};

use crate::cell::CellFrames;
use crate::device::{DeviceDescription, Place};
use crate::error::Error;
use crate::executor::machines::{Hosted, MachineInput};
use crate::executor::{End, Executor, Running};
use crate::ids::NetId;
use cycles::WORDS_A_CYCLE;
use file::Writer;
use notes::{LEVEL_WARN, Note};
use parts::Parts;
use words::Words;

pub use flight_log::FlightLog;
#[doc(hidden)]
pub use fuzz::{files, fuzz};
pub use inspect::{Contents, Topic, about, contents, recover};
pub use journal::Journal;
pub use live::LiveStream;
pub use parts::{PART_BYTES_MIN, Rotation};
pub use replay::{Replay, replay};
pub use ros2::{Cdr, Sink, Stamp};
pub use values::numbers;

/// Buffers between the net thread and the file; each holds one cycle.
const BUFFERS: usize = 512;
/// Shortest and longest pause of the writing thread: waking for a few cycles would cost more than writing them.
const PAUSE: [Duration; 2] = [Duration::from_millis(5), Duration::from_millis(100)];

/// The next pause, after one in which so many cycles came: for an eighth to a quarter of the buffers. Before the first cycle, their period
/// is not known, and the pause stays.
fn pause_after(pause: Duration, cycles: usize) -> Duration {
    let [shortest, longest] = PAUSE;
    if cycles > BUFFERS / 4 {
        (pause / 2).max(shortest)
    } else if (1..BUFFERS / 8).contains(&cycles) {
        (pause * 2).min(longest)
    } else {
        pause
    }
}

/// Time between two flushes: a crash loses at most this much.
const FLUSH_PERIOD: Duration = Duration::from_secs(1);

/// The net thread's endpoint of a recording. It never waits: a cycle for which no buffer is free, or
/// that does not fit one, is counted as lost.
#[derive(Debug)]
pub struct Tap {
    free: Consumer<Vec<u64>>,
    full: Producer<Vec<u64>>,
    current: Option<Words>,
    /// No buffer was free when the cycle began: a buffer freed later must not hold half a cycle.
    skips: bool,
    lost: Arc<AtomicU64>,
}

impl Tap {
    fn words(&mut self) -> Option<&mut Words> {
        if self.current.is_none() && !self.skips {
            self.current = self.free.pop().map(Words::new);
            self.skips = self.current.is_none();
        }
        self.current.as_mut()
    }

    /// A net runs from this cycle on.
    pub fn started(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.started(id);
        }
    }

    /// A rule starts a net from the next cycle on, in place of those that end.
    pub fn succeeded(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.succeeded(id);
        }
    }

    /// A net receives a cancel.
    pub fn cancelled(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.cancelled(id);
        }
    }

    /// A net is ended.
    pub fn aborted(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.aborted(id);
        }
    }

    /// A rule ends a net.
    pub fn stopped(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.stopped(id);
        }
    }

    /// A net exceeded its time too often.
    pub fn ran_away(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.ran_away(id);
        }
    }

    /// Whether a successor waits for a net has changed.
    pub fn takeover(&mut self, id: u32, waits: bool) {
        if let Some(words) = self.words() {
            words.takeover(id, waits);
        }
    }

    /// Programs wrote values of a net.
    pub fn inbox(&mut self, net: &Running) {
        if let Some(words) = self.words() {
            words.inbox(net);
        }
    }

    /// A machine is stepped from this cycle on.
    pub fn machine_added(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.machine_added(id);
        }
    }

    /// A machine is no longer stepped.
    pub fn machine_removed(&mut self, id: u32) {
        if let Some(words) = self.words() {
            words.machine_removed(id);
        }
    }

    /// A net waits for the next start of a component.
    pub fn seated(&mut self, net: &Running, fresh: bool) {
        if let Some(words) = self.words() {
            words.seated(net, fresh);
        }
    }

    /// The net of a component could not be loaded.
    pub fn seat_failed(&mut self, machine: u32, component: usize) {
        if let Some(words) = self.words() {
            words.seat_failed(machine, component);
        }
    }

    /// A program requests something of a machine.
    pub fn machine_input(&mut self, machine: u32, input: &MachineInput) {
        if let Some(words) = self.words() {
            words.machine_input(machine, input);
        }
    }

    /// A machine was stepped.
    pub fn stepped(&mut self, hosted: &Hosted) {
        if let Some(words) = self.words() {
            words.stepped(hosted);
        }
    }

    /// Inputs of the cycle.
    pub fn inputs(&mut self, moment: Moment, executor: &Executor) {
        if let Some(words) = self.words() {
            words.inputs(moment, executor);
        }
    }

    /// A net's values for programs changed.
    pub fn outbox(&mut self, net: &Running) {
        if let Some(words) = self.words() {
            words.outbox(net);
        }
    }

    /// A net ended.
    pub fn ended(&mut self, id: u32, end: End) {
        if let Some(words) = self.words() {
            words.ended(id, end);
        }
    }

    /// Commands of the cycle.
    pub fn outputs(&mut self, moment: Moment, executor: &Executor) {
        if let Some(words) = self.words() {
            words.outputs(moment, executor);
        }
    }

    /// Ends the cycle's entry.
    pub fn finish(&mut self) {
        self.skips = false;
        // A buffer is never dropped here: freeing it would not be real time.
        let spare = match self.current.take().map(Words::finish) {
            Some(Ok(whole)) => match self.full.push(whole) {
                Ok(()) => return,
                Err(buffer) => Some(buffer),
            },
            Some(Err(buffer)) => Some(buffer),
            None => None,
        };
        self.lost.fetch_add(1, Ordering::Relaxed);
        self.current = spare.map(|mut buffer| {
            buffer.clear();
            Words::new(buffer)
        });
    }
}

/// Maximum number of lines of the log that wait for the file.
const LINES_MAX: usize = 4096;

/// A level as `rcl_interfaces/msg/Log` numbers it.
fn level_number(level: tracing::Level) -> u8 {
    match level {
        tracing::Level::ERROR => 40,
        tracing::Level::WARN => LEVEL_WARN,
        tracing::Level::INFO => 20,
        _ => 10,
    }
}

/// Lines of the log on their way to the file.
#[derive(Debug, Default)]
struct Lines {
    waiting: AtomicUsize,
    /// Lines for which there was no room, not reported yet.
    lost: AtomicU64,
}

/// The log of a recording. Lines after its end are dropped; those that a slow disk leaves no room for are counted in it.
#[derive(Clone, Debug)]
pub struct RecordedLog {
    notes: mpsc::Sender<Note>,
    lines: Arc<Lines>,
}

impl RecordedLog {
    /// Records a line of that part of the program.
    pub fn line(&self, level: tracing::Level, part: &str, text: &str) {
        if self.lines.waiting.fetch_add(1, Ordering::Relaxed) >= LINES_MAX {
            self.lines.waiting.fetch_sub(1, Ordering::Relaxed);
            self.lines.lost.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let _ = self.notes.send(Note::Log {
            level: level_number(level),
            name: part.to_owned(),
            text: text.to_owned(),
        });
    }
}

/// Event of a running recording, reported once per onset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum RecordingEvent {
    /// It ended with an error; the controller continues.
    Failed(String),
    /// Number of cycles missing so far.
    CyclesLost(u64),
}

/// Lost cycles after this long without loss are a new onset.
const LOSS_QUIET: Duration = Duration::from_secs(10);

/// A running recording; dropping it finishes it.
#[derive(Debug)]
pub struct Recorder {
    notes: mpsc::Sender<Note>,
    lines: Arc<Lines>,
    stop: Arc<AtomicBool>,
    lost: Arc<AtomicU64>,
    failures: mpsc::Receiver<String>,
    has_failed: bool,
    /// Lost cycles at the last poll, and time of the last increase.
    seen_lost: (u64, Option<Instant>),
    thread: Option<std::thread::JoinHandle<Result<u64, Error>>>,
    path: PathBuf,
    /// Unix time at the zero of the host's monotonic clock, ns.
    epoch: u64,
}

impl Recorder {
    /// Starts a recording of a thread of that period to a new file.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn start(path: &Path) -> Result<(Self, Tap), Error> {
        Self::begin((Writer::create(path)?, None), path)
    }

    /// As [`Self::start`], to files of a bounded size beside that path: `run.mcap` gives `run-<time>-0001.mcap` and so on.
    ///
    /// # Errors
    /// If the first file cannot be created, or the size is too small.
    pub fn start_rotating(path: &Path, rotation: Rotation) -> Result<(Self, Tap), Error> {
        if rotation.bytes < PART_BYTES_MIN {
            let why = format!(
                "files of {} bytes are too small\nhint: at least {} MiB",
                rotation.bytes,
                PART_BYTES_MIN >> 20
            );
            let path = path.to_owned();
            return Err(Error::Recording { path, why });
        }
        let (parts, first) = Parts::beside(path, rotation)?;
        Self::begin((first, Some(parts)), path)
    }

    /// Starts the thread that writes.
    fn begin<W: Write + Send + 'static>(
        (writer, parts): (Writer<W>, Option<Parts<W>>),
        path: &Path,
    ) -> Result<(Self, Tap), Error> {
        let epoch = writer.epoch();
        let (failed, failures) = mpsc::channel();
        let (free_in, free) = ring(BUFFERS);
        let (full, full_out) = ring(BUFFERS);
        let (notes, notes_out) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let lost = Arc::new(AtomicU64::new(0));
        let mut file_thread = FileThread {
            writer,
            parts,
            free: free_in,
            full: full_out,
            notes: notes_out,
            lines: Arc::default(),
            stop: Arc::clone(&stop),
        };
        let lines = Arc::clone(&file_thread.lines);
        for _ in 0..BUFFERS {
            // The ring has capacity for all of them.
            let _ = file_thread.free.push(Vec::with_capacity(WORDS_A_CYCLE));
        }
        let thread = std::thread::Builder::new()
            .name("takt-record".to_owned())
            .spawn(move || {
                let result = file_thread.run();
                if let Err(error) = &result {
                    let _ = failed.send(error.to_string());
                }
                result
            })
            .map_err(|source| Error::Thread {
                name: "takt-record".to_owned(),
                source,
            })?;
        let tap = Tap {
            free,
            full,
            current: None,
            skips: false,
            lost: Arc::clone(&lost),
        };
        let path = path.to_owned();
        Ok((
            Self {
                notes,
                lines,
                stop,
                lost,
                failures,
                has_failed: false,
                seen_lost: (0, None),
                thread: Some(thread),
                path,
                epoch,
            },
            tap,
        ))
    }

    /// Unix time at the zero of the host's monotonic clock, ns: what the times of its messages refer to.
    pub(crate) const fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Records a new device and its slots in the image.
    pub fn device(&self, number: usize, place: &Place, description: &DeviceDescription) {
        // The receiver is gone only if the file failed, which `finish` reports.
        let _ = self.notes.send(Note::Device {
            number,
            place: place.clone(),
            description: description.clone(),
        });
    }

    /// Records the removal of a device.
    pub fn device_gone(&self, name: &str) {
        let _ = self.notes.send(Note::Gone(name.to_owned()));
    }

    /// Records a loaded net.
    pub(crate) fn net(
        &self,
        id: NetId,
        (every, period): (u64, Duration),
        text: &Arc<str>,
        values: &Arc<Directory>,
    ) {
        let _ = self.notes.send(Note::Net {
            id: id.0,
            every,
            period,
            text: Arc::clone(text),
            values: Arc::clone(values),
        });
    }

    /// Records where things are in the cell.
    pub(crate) fn frames(&self, frames: &CellFrames) {
        let _ = self.notes.send(Note::Frames(frames.clone()));
    }

    /// Where lines of the log are recorded too.
    #[must_use]
    pub fn log(&self) -> RecordedLog {
        RecordedLog {
            notes: self.notes.clone(),
            lines: Arc::clone(&self.lines),
        }
    }

    /// Records a loaded machine with the files of its components.
    pub fn machine(
        &self,
        (id, program): (u32, &Arc<Program>),
        text: &Arc<str>,
        files: &[(String, String)],
    ) {
        let _ = self.notes.send(Note::Machine {
            id,
            text: Arc::clone(text),
            files: files.to_vec(),
            program: Arc::clone(program),
        });
    }

    /// Events since the last call.
    pub(crate) fn poll_event(&mut self, now: Instant) -> Option<RecordingEvent> {
        if let Ok(what) = self.failures.try_recv() {
            self.has_failed = true;
            return Some(RecordingEvent::Failed(what));
        }
        let (before, grew) = self.seen_lost;
        let lost = self.lost.load(Ordering::Relaxed);
        // After a failure all cycles are missing.
        if lost == before || self.has_failed {
            return None;
        }
        self.seen_lost = (lost, Some(now));
        let is_onset = grew.is_none_or(|grew| now.saturating_duration_since(grew) >= LOSS_QUIET);
        is_onset.then_some(RecordingEvent::CyclesLost(lost))
    }

    /// Ends the recording; returns the number of its cycles.
    ///
    /// # Errors
    /// If the file could not be written, or cycles were lost.
    pub fn finish(mut self) -> Result<u64, Error> {
        self.stop.store(true, Ordering::Relaxed);
        let broken = |why: String| Error::Recording {
            path: self.path.clone(),
            why,
        };
        let cycles = match self.thread.take().map(std::thread::JoinHandle::join) {
            Some(Ok(written)) => written?,
            _ => return Err(broken("the recording thread panicked".to_owned())),
        };
        match self.lost.load(Ordering::Relaxed) {
            0 => Ok(cycles),
            lost => Err(broken(format!(
                "{lost} cycles are missing: the disk was too slow or a cycle too large"
            ))),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && let Ok(Err(error)) = thread.join()
        {
            tracing::error!(%error, "recording failed");
        }
    }
}

/// Between the net thread and the file.
struct FileThread<W: Write> {
    writer: Writer<W>,
    parts: Option<Parts<W>>,
    free: Producer<Vec<u64>>,
    full: Consumer<Vec<u64>>,
    notes: mpsc::Receiver<Note>,
    lines: Arc<Lines>,
    stop: Arc<AtomicBool>,
}

impl<W: Write> FileThread<W> {
    /// Writes the notes that wait.
    fn notes(&mut self) -> Result<(), Error> {
        while let Ok(note) = self.notes.try_recv() {
            self.writer.note(&note)?;
            if matches!(note, Note::Log { .. }) {
                self.lines.waiting.fetch_sub(1, Ordering::Relaxed);
            }
        }
        match self.lines.lost.swap(0, Ordering::Relaxed) {
            0 => Ok(()),
            lost => self.writer.note(&Note::Log {
                level: LEVEL_WARN,
                name: "takt_core::record".to_owned(),
                text: format!(
                    "{lost} lines of the log are missing before this one: the disk was too slow"
                ),
            }),
        }
    }

    fn run(&mut self) -> Result<u64, Error> {
        let mut cycles = 0;
        let mut flushed = Instant::now();
        let [mut pause, _] = PAUSE;
        loop {
            // Read first, so that records from before the stop are still written.
            let stop = self.stop.load(Ordering::Relaxed);
            self.notes()?;
            let mut waited = 0;
            while let Some(mut buffer) = self.full.pop() {
                waited += 1;
                // Those before the cycle, however many cycles wait.
                self.notes()?;
                self.writer.cycle(&buffer)?;
                cycles += 1;
                if let Some(parts) = &mut self.parts {
                    parts.rotate(&mut self.writer)?;
                }
                buffer.clear();
                let _ = self.free.push(buffer);
            }
            if stop {
                // Nets that the last cycles may have started.
                self.notes()?;
                self.writer.finish()?;
                return Ok(cycles);
            }
            if flushed.elapsed() >= FLUSH_PERIOD {
                self.writer.flush()?;
                flushed = Instant::now();
            }
            pause = pause_after(pause, waited);
            // In simulated time, the time waits for this thread too. Fails never but by a system call filter.
            if takt_rt::sleep_until(takt_rt::monotonic() + pause.into()).is_err() {
                std::thread::sleep(pause);
            }
        }
    }
}
