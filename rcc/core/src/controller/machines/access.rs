//! The machines as programs see them, and their ends: by a request, with their session, with the controller.

use std::time::{Duration, Instant};

use takt_machine::machine::Status;
use takt_machine::{Control, PropertyFile};

use super::{Job, Loaded, MachineInfo};
use crate::controller::Controller;
use crate::controller::nets::{Change, Net};
use crate::controller::registry::Registry;
use crate::error::Error;
use crate::executor::machines::MachineInput;
use crate::executor::thread::Command;
use crate::ids::{NetId, NetState, SessionId};

/// Number of requests whose answer is not awaited.
const NO_ANSWER: u64 = 0;

impl Registry {
    /// The name of the machine of which a net is a component.
    pub(in crate::controller) fn machine_of(&self, net: NetId) -> Option<&str> {
        let (machine, _) = self.nets.get(net)?.component_of?;
        Some(self.machines.all.get(&machine)?.program.name())
    }

    /// A net of a component runs: the next one is needed.
    pub(in crate::controller) fn component_started(&mut self, net: NetId) {
        let component = self.nets.get(net).and_then(|net| net.component_of);
        if let Some((machine, component)) = component {
            self.machines
                .jobs
                .push_back(Job::Refill(machine, component));
        }
    }

    /// A net of a component has ended, by itself or for a reason.
    pub(in crate::controller) fn component_ended(&mut self, net: NetId, why: Option<String>) {
        let Some((machine, component)) = self.nets.get(net).and_then(|net| net.component_of) else {
            return;
        };
        self.machines.jobs.push_back(Job::Unload(net));
        if let (Some(loaded), Some(why)) = (self.machines.all.get_mut(&machine), why) {
            loaded.ends.insert(component, format!("{net} ended: {why}"));
        }
    }

    /// Ends the machines to which these nets belong: where they are if it is `at_once`.
    pub(in crate::controller) fn end_machines_of(&mut self, nets: &[NetId], at_once: bool) {
        let machines = nets.iter();
        let machines = machines.filter_map(|net| self.nets.get(*net)?.component_of);
        let mut machines: Vec<u32> = machines.map(|(machine, _)| machine).collect();
        machines.sort_unstable();
        machines.dedup();
        for id in machines {
            // If the queue is full, the next call repeats it.
            if at_once {
                self.remove_machine(id).ok();
            } else {
                self.step_end(id).ok();
            }
        }
    }

    /// Whether the machine of a net is on the way to its final state, as it ends.
    pub(in crate::controller) fn is_stopping(&self, net: NetId) -> bool {
        let machine = self.nets.get(net).and_then(|net| net.component_of);
        let loaded = machine.and_then(|(machine, _)| self.machines.all.get(&machine));
        loaded.is_some_and(|loaded| loaded.stop_by.is_some() && !loaded.is_ending)
    }

    /// Brings a machine nearer to its end, by its final state if its text says so. To be called until it has ended.
    fn step_end(&mut self, id: u32) -> Result<(), Error> {
        let Some(loaded) = self.machines.all.get_mut(&id) else {
            return Ok(());
        };
        let is_active = loaded.status() == Status::Active;
        let limit = loaded.program.stop_on_end().filter(|_| is_active);
        match (limit, loaded.stop_by) {
            (Some(limit), None) => {
                let stop = MachineInput::Control(0, Control::Stop);
                let thread = loaded.thread;
                self.threads
                    .send(thread, Command::MachineInput(id, NO_ANSWER, stop))?;
                if let Some(loaded) = self.machines.all.get_mut(&id) {
                    loaded.stop_by = Some(Instant::now() + limit);
                }
                Ok(())
            }
            (Some(_), Some(by)) if Instant::now() < by => Ok(()),
            (Some(limit), Some(_)) => {
                if !loaded.is_ending {
                    let machine = loaded.program.name();
                    tracing::warn!(
                        machine,
                        "its final state did not end within {limit:?}; it ends where it is"
                    );
                }
                self.remove_machine(id)
            }
            (None, _) => self.remove_machine(id),
        }
    }

    fn remove_machine(&mut self, id: u32) -> Result<(), Error> {
        let Some(loaded) = self.machines.all.get_mut(&id) else {
            return Ok(());
        };
        if loaded.is_ending {
            return Ok(());
        }
        let thread = loaded.thread;
        self.threads.send(thread, Command::RemoveMachine(id))?;
        if let Some(loaded) = self.machines.all.get_mut(&id) {
            loaded.is_ending = true;
        }
        Ok(())
    }

    /// The thread steps a machine no longer; nets that waited for it never run.
    pub(in crate::controller) fn machine_removed(&mut self, id: u32) {
        let of_machine = |net: &Net| net.component_of.is_some_and(|(machine, _)| machine == id);
        let nets = self.nets.iter().filter(|(_, net)| of_machine(net));
        let nets: Vec<_> = nets.map(|(id, net)| (id, net.state())).collect();
        for (net, state) in nets {
            if matches!(state, NetState::Ready | NetState::Scheduled) {
                let why = "its machine ended before it ran".to_owned();
                self.nets.change(net, Change::End(Some(why)));
                self.component_ended(net, None);
            }
        }
        self.nets.free_machine(id);
        if let Some(loaded) = self.machines.remove(id) {
            tracing::info!(machine = loaded.program.name(), "machine ended");
        }
    }
}

impl Controller {
    /// The machines, by name.
    #[must_use]
    pub fn machines(&self) -> Vec<MachineInfo> {
        let mut registry = self.inner.lock();
        let all = registry.machines.all.values_mut();
        all.filter(|loaded| loaded.added == Some(Ok(())))
            .map(Loaded::info)
            .collect()
    }

    /// A machine.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn machine(&self, name: &str) -> Result<MachineInfo, Error> {
        let mut registry = self.inner.lock();
        let (id, _) = registry.machines.find(name)?;
        let loaded = registry.machines.all.get_mut(&id);
        let unknown = || Error::NoSuchMachine {
            name: name.to_owned(),
            known: "others".to_owned(),
        };
        loaded.map(Loaded::info).ok_or_else(unknown)
    }

    /// The values of the properties of a component, as a property file.
    ///
    /// # Errors
    /// If there is no such machine or component.
    pub fn machine_properties(&self, name: &str, component: &str) -> Result<PropertyFile, Error> {
        let mut registry = self.inner.lock();
        let (id, loaded) = registry.machines.find(name)?;
        let mut members = loaded.program.members().iter();
        let number = members.position(|member| member.name == component);
        let number = number.ok_or_else(|| {
            let members = loaded.program.members().iter();
            let names: Vec<&str> = members.map(|member| member.name.as_str()).collect();
            Error::Machine(format!(
                "machine `{name}` has no component `{component}`\nhint: it has {}",
                names.join(", ")
            ))
        })?;
        registry.machines.keep_properties(id, number);
        let (_, loaded) = registry.machines.find(name)?;
        let parts = loaded
            .program
            .members()
            .get(number)
            .zip(loaded.parts.get(number));
        Ok(parts
            .map(|(member, part)| part.configuration.to_file(&member.component))
            .unwrap_or_default())
    }

    /// How long machines may take to end: the longest `stop on end` of those that are active.
    #[must_use]
    pub fn machines_end_within(&self) -> Duration {
        let mut registry = self.inner.lock();
        let all = registry.machines.all.values_mut();
        let active = all.filter_map(|loaded| {
            let limit = loaded.program.stop_on_end()?;
            (loaded.status() == Status::Active).then_some(limit)
        });
        active.max().unwrap_or_default()
    }

    /// The machines of a session.
    pub(in crate::controller) fn session_machines(&self, session: SessionId) -> Vec<String> {
        let registry = self.inner.lock();
        let all = registry.machines.all.values();
        let of_session = all.filter(|loaded| loaded.session == session);
        of_session.map(|it| it.program.name().to_owned()).collect()
    }

    /// Ends a machine, and its components with it: devices brake. It ends where it is, or by its final state if its text says
    /// `stop on end`. Waits until they have ended.
    ///
    /// # Errors
    /// If there is none of that name, or its thread does not answer.
    pub fn end_machine(&self, name: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let (id, loaded) = registry.machines.find(name)?;
        if let Some(limit) = loaded.program.stop_on_end() {
            registry.step_end(id)?;
            let stopped = self.inner.wait_until(registry, limit, |registry| {
                let loaded = registry.machines.all.get_mut(&id);
                let is_active = loaded.is_some_and(|loaded| loaded.status() == Status::Active);
                (!is_active).then_some(())
            });
            // One that is still active ends where it is, which the next step logs.
            drop(stopped);
            registry = self.inner.lock();
        }
        registry.step_end(id)?;
        self.inner.wait_for(registry, |registry| {
            let of_machine = |net: &Net| net.component_of.is_some_and(|(machine, _)| machine == id);
            // A net of it that is being loaded would outlive its session.
            let is_here =
                registry.machines.all.contains_key(&id) || registry.machines.loading == Some(id);
            let mut nets = registry.nets.iter();
            let runs = nets.any(|(_, net)| of_machine(net) && !net.is_over());
            (!is_here && !runs).then_some(())
        })
    }
}
