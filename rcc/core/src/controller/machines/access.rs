//! The machines as programs see them, and their ends: by a request, with their session, with the controller.

use takt_machine::PropertyFile;

use super::{Job, Loaded, MachineInfo};
use crate::controller::Controller;
use crate::controller::nets::{Change, Net};
use crate::controller::registry::Registry;
use crate::error::Error;
use crate::executor::thread::Command;
use crate::ids::{NetId, NetState, SessionId};

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

    /// A net of a component has ended.
    pub(in crate::controller) fn component_ended(&mut self, net: NetId) {
        if self
            .nets
            .get(net)
            .is_some_and(|net| net.component_of.is_some())
        {
            self.machines.jobs.push_back(Job::Unload(net));
        }
    }

    /// Ends the machines to which these nets belong.
    pub(in crate::controller) fn end_machines_of(&mut self, nets: &[NetId]) {
        let machines = nets.iter();
        let machines = machines.filter_map(|net| self.nets.get(*net)?.component_of);
        let mut machines: Vec<u32> = machines.map(|(machine, _)| machine).collect();
        machines.sort_unstable();
        machines.dedup();
        for id in machines {
            // If the queue is full, the next call repeats it.
            self.remove_machine(id).ok();
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
                self.component_ended(net);
            }
        }
        self.nets.free_machine(id);
        if let Some(loaded) = self.machines.all.remove(&id) {
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

    /// The machines of a session.
    pub(in crate::controller) fn session_machines(&self, session: SessionId) -> Vec<String> {
        let registry = self.inner.lock();
        let all = registry.machines.all.values();
        let of_session = all.filter(|loaded| loaded.session == session);
        of_session.map(|it| it.program.name().to_owned()).collect()
    }

    /// Ends a machine where it is, and its components with it: devices brake. Waits until they have ended.
    ///
    /// # Errors
    /// If there is none of that name, or its thread does not answer.
    pub fn end_machine(&self, name: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let (id, _) = registry.machines.find(name)?;
        registry.remove_machine(id)?;
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
