//! Replays a recording through the same executor and compares every word. No thread, no clock, no
//! device.

use std::collections::HashMap;
use std::path::Path;
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
use crate::record::WORDS_A_CYCLE;
use crate::record::notes::{DeviceEvent, NetNote};
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

/// Replays a recording.
///
/// # Errors
/// If the file cannot be read or a net in it cannot be loaded.
pub fn replay(path: &Path) -> Result<Replay, Error> {
    let recording = Recording::read(path)?;
    let mut stage = Stage::new(&recording, path)?;
    let mut outcome = Replay {
        cycles: 0,
        bytes: 0,
        differs: None,
        is_cut: recording.is_cut,
    };
    for recorded in &recording.cycles {
        let replayed = stage.cycle(recorded)?;
        if replayed != *recorded {
            outcome.differs = Some(outcome.cycles);
            return Ok(outcome);
        }
        outcome.cycles += 1;
        outcome.bytes += size_of_val(recorded.as_slice()) as u64;
    }
    Ok(outcome)
}

/// Loads a net of the recording as it was loaded originally.
fn prepare(
    net: &NetNote,
    registry: &Registry,
    (devices, nets): (&DeviceTable, &HashMap<u32, Box<Running>>),
    path: &Path,
) -> Result<Box<Running>, Error> {
    let boxes = |id: NetId| {
        let plan = &nets.get(&id.0)?.plan;
        Some(NetBoxes {
            inbox: plan.inbox().clone(),
            outbox: plan.outbox().clone(),
        })
    };
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

struct Stage<'r> {
    executor: Executor,
    nets: HashMap<u32, Box<Running>>,
    machines: HashMap<u32, Arc<Program>>,
    path: &'r Path,
}

impl<'r> Stage<'r> {
    fn new(recording: &Recording, path: &'r Path) -> Result<Self, Error> {
        let mut devices = DeviceTable::default();
        let registry = crate::registry();
        let mut nets = HashMap::new();
        let mut machines = HashMap::new();
        let mut executor = Executor::default();
        for note in &recording.notes {
            match note {
                RecordedNote::Device(DeviceEvent::Came(device)) => {
                    let (number, place) = (device.number, device.place());
                    executor.set_place(number, &place);
                    devices.add_at(number, place, device.description())?;
                }
                RecordedNote::Device(DeviceEvent::Went { name }) => {
                    devices.remove(name);
                }
                RecordedNote::Net(net) => {
                    let known = (&devices, &nets);
                    let running = prepare(net, &registry, known, path)?;
                    nets.insert(net.id, running);
                }
                RecordedNote::Machine(machine) => {
                    let read = |name: &str| {
                        let file = machine.files.iter().find(|(known, _)| known == name);
                        file.map(|(_, text)| text.clone())
                            .ok_or_else(|| format!("the recording has no file {name}"))
                    };
                    let compiled = Program::compile(&machine.text, &read);
                    let (program, _) = compiled.map_err(|found| Error::Recording {
                        path: path.to_owned(),
                        why: format!(
                            "its machine {} is rejected: {}",
                            machine.id,
                            found.render("machine", &machine.text)
                        ),
                    })?;
                    machines.insert(machine.id, Arc::new(program));
                }
            }
        }
        Ok(Self {
            executor,
            nets,
            machines,
            path,
        })
    }

    fn broken(&self, why: &str) -> Error {
        Error::Recording {
            path: self.path.to_owned(),
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
            | Entry::Stepped(..) => {}
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
            Entry::Outbox(..) | Entry::Ended(..) | Entry::Outputs(..) | Entry::Stepped(..) => {}
        }
        Ok(())
    }
}
