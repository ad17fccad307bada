//! Replays a recording through the same executor and compares every word. No thread, no clock, no
//! device.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use takt_machine::Program;
use takt_net::netcomm::NetBoxes;
use takt_net::{Limits, LoadContext, Registry, load};
use takt_rt::latest::latest;

use crate::device::{DeviceTable, Surroundings};
use crate::error::Error;
use crate::executor::machines::{Hosted, Seat};
use crate::executor::{Executor, Running};
use crate::ids::NetId;
use crate::record::cycles::WORDS_A_CYCLE;
use crate::record::inspect::contents;
use crate::record::notes::{DeviceEvent, MachineNote, NetNote, wrong};
use crate::record::parts::Part;
use crate::record::read::{RecordedNote, Recording};
use crate::record::words::{Entry, Reader, Words};

/// The outcome of a replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Replay {
    /// Cycles compared.
    pub cycles: u64,
    /// Bytes compared.
    pub bytes: u64,
    /// The first cycle, counted from 0, whose words differ.
    pub differs: Option<u64>,
    /// The recording was not finished, because of a full disk or a crash: only its complete cycles are counted.
    pub is_cut: bool,
}

/// Replays a recording: a file, or a directory with all parts of one.
///
/// # Errors
/// If a file cannot be read, a part is missing, or a net in it cannot be loaded.
pub fn replay(path: &Path) -> Result<Replay, Error> {
    let parts = if path.is_dir() {
        parts_in(path)?
    } else {
        vec![path.to_owned()]
    };
    let mut outcome = Replay {
        cycles: 0,
        bytes: 0,
        differs: None,
        is_cut: false,
    };
    let mut stage = Stage::default();
    let mut before: Option<Part> = None;
    for (place, path) in parts.iter().enumerate() {
        let is_last = place + 1 == parts.len();
        let read = Recording::read(path);
        // The last part may have been cut off before anything was in it.
        let recording = match read {
            Err(Error::Recording { .. }) if place > 0 && is_last && is_empty(path) => {
                outcome.is_cut = true;
                break;
            }
            read => read?,
        };
        check_part(
            path,
            before.as_ref(),
            recording.part.as_ref(),
            is_last || !recording.is_cut,
        )?;
        before = recording.part.clone();
        stage.path.clone_from(path);
        stage.learn(&recording)?;
        for recorded in recording.cycles.iter() {
            let replayed = stage.cycle(&recorded)?;
            if replayed != recorded {
                outcome.differs = Some(outcome.cycles);
                return Ok(outcome);
            }
            outcome.cycles += 1;
            outcome.bytes += size_of_val(recorded.as_slice()) as u64;
        }
        outcome.is_cut = recording.is_cut;
    }
    Ok(outcome)
}

/// The files of a directory, in the order of parts.
fn parts_in(directory: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::File {
        path: directory.to_owned(),
        source,
    };
    let entries = std::fs::read_dir(directory).map_err(failed)?;
    let mut parts = Vec::new();
    for entry in entries {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|it| it == "mcap") {
            parts.push(path);
        }
    }
    // Numbers beyond 9999 are longer.
    parts.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    if parts.is_empty() {
        return Err(wrong(directory, "it contains no recording".to_owned()));
    }
    Ok(parts)
}

/// Whether a file holds nothing but the begin of a recording.
fn is_empty(path: &Path) -> bool {
    contents(path).is_ok_and(|found| found.messages() == 0)
}

/// Checks that a part follows the one before it.
fn check_part(
    path: &Path,
    before: Option<&Part>,
    part: Option<&Part>,
    is_whole: bool,
) -> Result<(), Error> {
    let hint = "\nhint: name a directory that contains all parts of one recording, from the first";
    let why = match (before, part) {
        _ if !is_whole => format!("it is cut off, but another part follows{hint}"),
        (None, None) => return Ok(()),
        (None, Some(Part { number: 1, .. })) => return Ok(()),
        (None, Some(Part { number, .. })) => {
            format!("it is part {number} of a recording; a replay begins with the first{hint}")
        }
        (Some(before), Some(part)) if before.recording != part.recording => {
            format!("it is of another recording than the file before it{hint}")
        }
        (Some(before), Some(part)) if before.number + 1 != part.number => format!(
            "it is part {}, but the file before it is part {}{hint}",
            part.number, before.number
        ),
        (Some(_), Some(_)) => return Ok(()),
        (Some(_), None) => format!("it is no part of the recording before it{hint}"),
    };
    Err(wrong(path, why))
}

/// Loads a net of the recording as it was loaded originally.
fn prepare(
    net: &NetNote,
    registry: &Registry,
    (devices, boxes): (&DeviceTable, &HashMap<u32, NetBoxes>),
    path: &Path,
) -> Result<Box<Running>, Error> {
    let boxes = |id: NetId| boxes.get(&id.0).cloned();
    let context = LoadContext {
        registry,
        devices: &Surroundings { devices, boxes },
        period: net.period(),
        limits: Limits::default(),
    };
    let plan = load(&net.text, &context).map_err(|rejection| Error::Recording {
        path: path.to_owned(),
        why: format!("its net {} is rejected: {rejection}", NetId(net.id)),
    })?;
    let words = |n: usize| vec![0; n].into_boxed_slice();
    let (out, _) = latest(1, || words(plan.outbox().words()));
    let (_, inbox) = latest(1, || words(plan.inbox().words()));
    let numbers = plan.devices().iter().filter_map(|d| devices.number(d));
    let numbers = numbers.map(|number| (number, 0)).collect();
    let mut running = Box::new(Running::new(net.id, plan, out, inbox));
    running.devices = numbers;
    running.set_every(net.every);
    Ok(running)
}

struct Stage {
    registry: Registry,
    devices: DeviceTable,
    executor: Executor,
    nets: HashMap<u32, Box<Running>>,
    /// Of all nets so far: others may read those that run.
    boxes: HashMap<u32, NetBoxes>,
    machines: HashMap<u32, Arc<Program>>,
    path: PathBuf,
}

impl Default for Stage {
    fn default() -> Self {
        Self {
            registry: crate::registry(),
            devices: DeviceTable::default(),
            executor: Executor::default(),
            nets: HashMap::new(),
            boxes: HashMap::new(),
            machines: HashMap::new(),
            path: PathBuf::new(),
        }
    }
}

impl Stage {
    /// Learns the devices, nets and machines of a file, but for those that an earlier part had.
    fn learn(&mut self, recording: &Recording) -> Result<(), Error> {
        for note in &recording.notes {
            match note {
                RecordedNote::Device(DeviceEvent::Came(device)) if !device.is_repeated => {
                    let (number, place) = (device.number, device.place());
                    self.executor.set_place(number, &place);
                    let description = device.description();
                    let description = description.map_err(|error| {
                        wrong(&self.path, format!("device {}: {error}", device.name))
                    })?;
                    self.devices.add_at(number, place, description)?;
                }
                RecordedNote::Device(DeviceEvent::Went { name }) => {
                    self.devices.remove(name);
                }
                RecordedNote::Net(net) if !net.is_repeated => {
                    let known = (&self.devices, &self.boxes);
                    let running = prepare(net, &self.registry, known, &self.path)?;
                    let boxes = NetBoxes {
                        inbox: running.plan.inbox().clone(),
                        outbox: running.plan.outbox().clone(),
                    };
                    self.boxes.insert(net.id, boxes);
                    self.nets.insert(net.id, running);
                }
                RecordedNote::Machine(machine) if !machine.is_repeated => {
                    let program = self.compile(machine)?;
                    self.machines.insert(machine.id, Arc::new(program));
                }
                RecordedNote::Device(_) | RecordedNote::Net(_) | RecordedNote::Machine(_) => {}
            }
        }
        Ok(())
    }

    fn compile(&self, machine: &MachineNote) -> Result<Program, Error> {
        let read = |name: &str| {
            let file = machine.files.iter().find(|(known, _)| known == name);
            file.map(|(_, text)| text.clone())
                .ok_or_else(|| format!("the recording has no file {name}"))
        };
        let compiled = Program::compile(&machine.text, &read);
        let (program, _) = compiled.map_err(|found| {
            let found = found.render("machine", &machine.text);
            self.broken(&format!("its machine {} is rejected: {found}", machine.id))
        })?;
        Ok(program)
    }

    fn broken(&self, why: &str) -> Error {
        Error::Recording {
            path: self.path.clone(),
            why: why.to_owned(),
        }
    }

    /// Runs one cycle on its recorded inputs and writes its words again.
    fn cycle(&mut self, recorded: &[u64]) -> Result<Vec<u64>, Error> {
        let mut words = Words::new(Vec::with_capacity(WORDS_A_CYCLE));
        let mut reader = Reader(recorded);
        let mut moment = None;
        // Device states are those of the inputs from the start of a cycle on, also for nets that start.
        let mut ahead = Reader(recorded);
        while let Some(entry) = ahead
            .next()
            .map_err(|()| self.broken("a cycle is cut off"))?
        {
            if let Entry::Inputs(inputs) = entry {
                inputs.apply(&mut self.executor);
            }
        }
        while let Some(entry) = reader
            .next()
            .map_err(|()| self.broken("a cycle is cut off"))?
        {
            if let Entry::Inputs(inputs) = &entry {
                moment = Some(inputs.moment);
            }
            self.enter(entry, &mut words)?;
        }
        let moment = moment.ok_or_else(|| self.broken("a cycle has no inputs"))?;
        words.outputs(moment, &self.executor);
        while self.executor.take_ended(|net, end| {
            words.ended(net.id, end);
            Ok(())
        }) {}
        words
            .finish()
            .map_err(|_| self.broken("a cycle is too large"))
    }

    /// The net that starts now.
    fn net(&mut self, id: u32) -> Result<Box<Running>, Error> {
        let net = self.nets.remove(&id);
        net.ok_or_else(|| self.broken("a net starts that it does not contain"))
    }

    /// The net of a component, with its seat.
    fn seated(&mut self, id: u32, machine: u32, number: usize) -> Result<Box<Running>, Error> {
        let mut net = self.net(id)?;
        let program = self.machines.get(&machine);
        let member = program.and_then(|program| program.members().get(number));
        let (Some(program), Some(member)) = (program, member) else {
            return Err(self.broken("a component of an unknown machine is configured"));
        };
        net.seat = Some(Box::new(Seat::of(
            program,
            (machine, number),
            &member.component,
            &net.plan,
        )));
        Ok(net)
    }

    /// Applies an entry about a machine and writes it again.
    fn enter_machine(&mut self, entry: Entry<'_>, words: &mut Words) -> Result<(), Error> {
        match entry {
            Entry::MachineAdded(id) => {
                let program = self.machines.get(&id).cloned();
                let program = program
                    .ok_or_else(|| self.broken("a machine is added that it does not contain"))?;
                let (hosted, _) = Hosted::new(id, program);
                if self.executor.add_machine(hosted).is_err() {
                    return Err(self.broken("a machine is added twice"));
                }
                words.machine_added(id);
            }
            Entry::MachineRemoved(id) => {
                self.executor.remove_machine(id);
                words.machine_removed(id);
            }
            Entry::Seated(id, (machine, component), fresh) => {
                let net = self.seated(id, machine, component)?;
                words.seated(&net, fresh);
                // One that has no place is not needed.
                drop(self.executor.seat(net, fresh));
            }
            Entry::SeatFailed(machine, component) => {
                self.executor.seat_failed(machine, component);
                words.seat_failed(machine, component);
            }
            Entry::MachineInput(machine, input) => {
                words.machine_input(machine, &input);
                // Refusals were answers to programs.
                let _ = self.executor.machine_input(machine, &input);
            }
            Entry::Started(_)
            | Entry::Succeeded(_)
            | Entry::Cancelled(_)
            | Entry::Aborted(_)
            | Entry::Stopped(_)
            | Entry::RanAway(_)
            | Entry::Takeover(..)
            | Entry::Inbox(..)
            | Entry::Inputs(_)
            | Entry::Outbox(..)
            | Entry::Ended(..)
            | Entry::Outputs(..)
            | Entry::Stepped(..)
            | Entry::Changed(..) => {}
        }
        Ok(())
    }

    /// Applies an entry and writes it again.
    fn enter(&mut self, entry: Entry<'_>, words: &mut Words) -> Result<(), Error> {
        match entry {
            Entry::Started(id) => {
                let net = self.net(id)?;
                self.executor.start_checked(net);
                words.started(id);
            }
            Entry::Succeeded(id) => {
                // A machine of the replay has started its component already.
                if !self.executor.running().iter().any(|net| net.id == id) {
                    let net = self.net(id)?;
                    self.executor.start_by_rule(net);
                }
                words.succeeded(id);
            }
            machine @ (Entry::MachineAdded(_)
            | Entry::MachineRemoved(_)
            | Entry::Seated(..)
            | Entry::SeatFailed(..)
            | Entry::MachineInput(..)) => self.enter_machine(machine, words)?,
            Entry::Cancelled(id) => {
                self.executor.cancel(id);
                words.cancelled(id);
            }
            Entry::Aborted(id) => {
                self.executor.abort(id);
                words.aborted(id);
            }
            Entry::Stopped(id) => {
                self.executor.stop(id);
                words.stopped(id);
            }
            Entry::RanAway(id) => {
                self.executor.end_runaway(id);
                words.ran_away(id);
            }
            Entry::Takeover(id, waits) => {
                self.executor.set_takeover(id, waits);
                words.takeover(id, waits);
            }
            Entry::Inbox(id, values) => {
                if let Some(net) = self.executor.running().iter().find(|n| n.id == id) {
                    net.plan.import(values);
                    words.inbox(net);
                }
            }
            Entry::Inputs(inputs) => {
                words.inputs(inputs.moment, &self.executor);
                self.executor.cycle(inputs.moment);
                self.executor.publish(|net| words.outbox(net));
                let mut clock = || takt_rt::Nanos::ZERO;
                self.executor
                    .step_machines(inputs.moment, &mut clock, |hosted| words.stepped(hosted));
                // What machines request was answered by later entries.
                self.executor.machine_events(|_, _| {});
            }
            // What the thread computed, the replay computes again.
            Entry::Outbox(..)
            | Entry::Ended(..)
            | Entry::Outputs(..)
            | Entry::Stepped(..)
            | Entry::Changed(..) => {}
        }
        Ok(())
    }
}
