//! A net in the registry: its life from text to end, and the program's endpoints of its values. The registry
//! and the net threads decide which nets exist and which may start.

use std::sync::Arc;
use std::time::Duration;

use takt_net::Rejection;
use takt_net::netcomm::{Directory, Entry, NetBoxes, OutStatus};
use takt_rt::latest::{LatestReader, LatestWriter};

use crate::controller::links::{NetLinks, TapRecording};
use crate::controller::quota::memory;
use crate::controller::{NetId, NetInfo, NetState, SessionId};
use crate::error::Error;
use crate::executor::figures::NetCounters;
use crate::executor::thread::Command;
use crate::executor::{ResourceSet, Running};
use crate::stop_channel::Generation;

/// A net that is ready, with the program's endpoints of its values.
#[derive(Debug)]
pub(super) struct Prepared {
    /// The number of its thread.
    pub(super) thread: usize,
    pub(super) running: Box<Running>,
    pub(super) links: NetLinks,
    pub(super) out_directory: Arc<Directory>,
    pub(super) out_reader: LatestReader<Box<[u64]>>,
    pub(super) in_directory: Arc<Directory>,
    pub(super) in_writer: LatestWriter<Box<[u64]>>,
    pub(super) in_words: Box<[u64]>,
}

#[derive(Debug)]
struct Values {
    links: NetLinks,
    out_directory: Arc<Directory>,
    out_reader: LatestReader<Box<[u64]>>,
    in_directory: Arc<Directory>,
    in_writer: LatestWriter<Box<[u64]>>,
    in_words: Box<[u64]>,
}

/// A net.
#[derive(Debug)]
pub(super) struct Net {
    pub(super) session: SessionId,
    description: String,
    text: Arc<str>,
    states: Vec<NetState>,
    rejection: Option<Arc<Rejection>>,
    end: Option<String>,
    /// The net, unless the net thread holds it.
    running: Option<Box<Running>>,
    /// Set while a start is pending, then its outcome until the caller takes it.
    starting: Option<Option<Result<(), Error>>>,
    /// Whether the net thread holds it for rules to start.
    with_rules: bool,
    /// Bytes reserved for it while it is loaded.
    pub(super) reserved: usize,
    values: Option<Values>,
    /// Devices that the net reads or commands.
    devices: Vec<String>,
    /// The number of its thread, 0 until it is known.
    pub(super) thread: usize,
    counted: Option<Counted>,
}

/// Data on a net's evaluation.
#[derive(Debug)]
pub(super) struct Counted {
    pub(super) counters: Arc<NetCounters>,
    pub(super) period: Duration,
    pub(super) primitives: usize,
    pub(super) cost: Duration,
    /// Bytes that it takes while it can run.
    pub(super) memory: usize,
    pub(super) resources: ResourceSet,
}

impl Net {
    pub(super) fn new(session: SessionId, description: String, text: Arc<str>) -> Self {
        Self {
            session,
            description,
            text,
            states: vec![NetState::Loading],
            rejection: None,
            end: None,
            running: None,
            starting: None,
            with_rules: false,
            reserved: 0,
            values: None,
            devices: Vec::new(),
            thread: 0,
            counted: None,
        }
    }

    pub(super) fn state(&self) -> NetState {
        self.states.last().copied().unwrap_or(NetState::Loading)
    }

    pub(super) fn enter(&mut self, state: NetState) {
        self.states.push(state);
    }

    pub(super) fn make_ready(&mut self, prepared: Prepared) {
        let Prepared {
            thread,
            running,
            links,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        } = prepared;
        self.thread = thread;
        self.devices = running.plan.uses().to_vec();
        self.counted = Some(Counted {
            counters: Arc::clone(running.counters()),
            period: running.plan.period(),
            primitives: running.plan.primitives(),
            cost: running.plan.cost().total,
            memory: memory(&running.plan),
            resources: running.resources,
        });
        self.running = Some(running);
        self.values = Some(Values {
            links,
            out_directory,
            out_reader,
            in_directory,
            in_writer,
            in_words,
        });
        self.enter(NetState::Ready);
    }

    pub(super) fn reject(&mut self, rejection: Rejection) {
        self.rejection = Some(Arc::new(rejection));
        self.enter(NetState::Rejected);
    }

    /// Checks that the net can be handed over to be started.
    pub(super) fn check_begin(&self, id: NetId) -> Result<(), Error> {
        let state = self.state();
        let is_held = self.running.is_some() || self.with_rules;
        let waits = matches!(state, NetState::Ready | NetState::Scheduled);
        if waits && is_held && !self.is_to_start() {
            return Ok(());
        }
        Err(Error::WrongState {
            net: id,
            state,
            what: "only a net that is READY can be started; load it again",
        })
    }

    /// Hands the net over to be started.
    pub(super) fn begin(&mut self, id: NetId, requested: Generation) -> Command {
        // An outcome that was never taken belongs to an earlier start.
        self.starting = Some(None);
        let running = self.running.take().map(|mut running| {
            running.requested = requested;
            running
        });
        running.map_or(Command::StartScheduled(id.0), Command::Start)
    }

    /// The outcome of its start, once it is known.
    pub(super) fn begun(&mut self) -> Option<Result<(), Error>> {
        match self.starting.take() {
            Some(None) => {
                self.starting = Some(None);
                None
            }
            Some(Some(outcome)) => Some(outcome),
            None => Some(Ok(())),
        }
    }

    /// Clears the outcome: no start is pending.
    pub(super) fn forget_start(&mut self) {
        self.starting = None;
    }

    /// Whether the net thread holds it for rules to start.
    pub(super) const fn is_with_rules(&self) -> bool {
        self.with_rules
    }

    /// It runs.
    pub(super) fn started(&mut self) {
        self.with_rules = false;
        self.starting = self.starting.take().map(|_| Some(Ok(())));
        self.enter(NetState::Running);
    }

    /// It ran and has ended.
    pub(super) fn ended(&mut self, why: Option<String>) {
        self.end = why;
        self.enter(NetState::Terminated);
    }

    /// It was returned without having run; `why` if it could not be started.
    pub(super) fn take_back(&mut self, running: Box<Running>, why: Option<Error>) {
        self.with_rules = false;
        self.running = Some(running);
        self.starting = why.map(|error| Some(Err(error)));
    }

    /// Rules no longer hold it.
    pub(super) const fn leave_rules(&mut self) {
        self.with_rules = false;
    }

    /// Whether the net thread holds it, or will, before it runs.
    pub(super) const fn is_away(&self) -> bool {
        self.with_rules || self.is_to_start()
    }

    /// Whether a start is requested and not answered.
    pub(super) const fn is_to_start(&self) -> bool {
        matches!(self.starting, Some(None))
    }

    /// Data on its evaluation; `None` if it was never ready.
    pub(super) const fn counted(&self) -> Option<&Counted> {
        self.counted.as_ref()
    }

    /// Ends a net that never ran.
    pub(super) fn end(&mut self, why: String) {
        self.end = Some(why);
        self.running = None;
        self.enter(NetState::Terminated);
    }

    /// Its text.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Whether the net reads or commands the device of that name.
    pub(super) fn uses(&self, device: &str) -> bool {
        self.devices.iter().any(|name| name == device)
    }

    /// Hands the net over for rules to start, unless they hold it already.
    pub(super) fn hand_to_rules(&mut self, requested: Generation) -> Option<Box<Running>> {
        let mut running = self.running.take()?;
        running.requested = requested;
        self.with_rules = true;
        Some(running)
    }

    pub(super) fn become_scheduled(&mut self) {
        if self.state() == NetState::Ready {
            self.enter(NetState::Scheduled);
        }
    }

    /// Whether it terminated by itself.
    pub(super) fn ended_by_itself(&self) -> bool {
        self.state() == NetState::Terminated && self.end.is_none()
    }

    /// Location of an out value.
    pub(super) fn out_entry(&self, key: &str) -> Option<Entry> {
        self.values.as_ref()?.out_directory.find(key).cloned()
    }

    /// Its values for exchange with other nets.
    pub(super) fn boxes(&self) -> Option<NetBoxes> {
        let values = self.values.as_ref()?;
        Some(NetBoxes {
            inbox: Arc::clone(&values.in_directory),
            outbox: Arc::clone(&values.out_directory),
        })
    }

    /// Reads its last out values.
    pub(super) fn with_out_words<T>(&mut self, read: impl FnOnce(&[u64]) -> T) -> Option<T> {
        let values = self.values.as_mut()?;
        Some(values.out_reader.read_with(|words| read(words)))
    }

    pub(super) fn links_mut(&mut self) -> Option<&mut NetLinks> {
        Some(&mut self.values.as_mut()?.links)
    }

    pub(super) fn tap_recording_mut(&mut self) -> Option<&mut TapRecording> {
        self.links_mut()?.tap_recording.as_mut()
    }

    /// Adds a reader of its out values; `None` if the limit is reached.
    pub(super) fn another_out_reader(&self) -> Option<LatestReader<Box<[u64]>>> {
        self.values.as_ref()?.out_reader.another()
    }

    /// A Boolean out value, if it is non-null.
    pub(super) fn out_bool(&mut self, entry: &Entry) -> Option<bool> {
        let reader = &mut self.values.as_mut()?.out_reader;
        reader.read_with(|words| {
            let current = entry.status(words) == OutStatus::Current;
            let value = entry.value(words).first().copied()?;
            current.then_some(value != 0)
        })
    }

    pub(super) fn info(&self, id: NetId) -> NetInfo {
        NetInfo {
            id,
            description: self.description.clone(),
            session: self.session,
            text: Arc::clone(&self.text),
            states: self.states.clone(),
            rejection: self.rejection.clone(),
            end: self.end.clone(),
        }
    }

    pub(super) fn out_values(&mut self) -> Vec<(String, String)> {
        let Some(values) = &mut self.values else {
            return Vec::new();
        };
        let directory = &values.out_directory;
        values.out_reader.read_with(|words| {
            let seen = directory
                .entries()
                .iter()
                .filter(|entry| entry.report && entry.status(words) != OutStatus::Never);
            seen.map(|entry| {
                let mut text = String::new();
                entry.format(words, &mut text);
                (entry.key.clone(), text)
            })
            .collect()
        })
    }

    pub(super) fn in_values(&self) -> Vec<(String, String)> {
        let Some(values) = &self.values else {
            return Vec::new();
        };
        let entries = values.in_directory.entries().iter();
        let entries = entries.filter(|entry| !entry.is_hidden());
        let text = |entry: &Entry| {
            let mut text = String::new();
            entry.format(&values.in_words, &mut text);
            (entry.key.clone(), text)
        };
        entries.map(text).collect()
    }

    pub(super) fn write_in(&mut self, id: NetId, key: &str, text: &str) -> Result<bool, Error> {
        let Some(values) = &mut self.values else {
            return Ok(false);
        };
        let entry = values.in_directory.find(key);
        let Some(entry) = entry.filter(|entry| !entry.is_hidden()) else {
            return Ok(false);
        };
        let written = entry.write(text, &mut values.in_words);
        written.map_err(|e| Error::Value {
            net: id,
            key: key.to_owned(),
            what: e.message,
        })?;
        let words = &values.in_words;
        values
            .in_writer
            .write_with(|slot| slot.copy_from_slice(words));
        Ok(true)
    }
}

#[cfg(test)]
mod tests;
