//! Loading a machine: its text is compiled, the nets of all its components are loaded once, so that cost, devices and
//! resources are known, and it is added to the thread that serves its devices. Nothing moves before it is activated.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use takt_machine::machine::Member;
use takt_machine::{Configuration, Phase, Program, PropertyFile, Request, command};

use super::{Loaded, MachineCost, MachineRequest, Part};
use crate::controller::Controller;
use crate::controller::admission::check_machine;
use crate::controller::nets::Change;
use crate::controller::shared::Shared;
use crate::error::Error;
use crate::executor::StartError;
use crate::executor::machines::{Hosted, MachineInput, SETTINGS_MAX, SPARES};
use crate::executor::thread::Command;
use crate::ids::{NetId, SessionId};

impl Controller {
    /// Loads a machine, configures and starts the components that its text says, and returns its name. It is not
    /// activated.
    ///
    /// # Errors
    /// All errors of its text, of its components and of their properties; a machine of that name; a resource that is
    /// held; too little cycle time.
    pub fn load_machine(&self, request: &MachineRequest) -> Result<String, Error> {
        let compiled = Program::compile(&request.text, &library(request));
        let (program, _) = compiled.map_err(|found| {
            Error::Machine(found.render("machine", &request.text).trim_end().to_owned())
        })?;
        let program = Arc::new(program);
        let parameters = parameters(&program, request)?;
        let configurations = configurations(&program, request)?;
        let (id, nets) = self.admit(request, &program, configurations)?;
        let prepared = self.prepare_components(id, &program, nets, &parameters);
        let name = program.name().to_owned();
        if let Err(error) = prepared {
            // The cause is reported; what was loaded ends.
            self.end_machine(&name).ok();
            return Err(error);
        }
        Ok(name)
    }

    /// Loads one net of each component and adds the machine to its thread. Returns its number and the nets.
    fn admit(
        &self,
        request: &MachineRequest,
        program: &Arc<Program>,
        configurations: Vec<Configuration>,
    ) -> Result<(u32, Vec<NetId>), Error> {
        let name = program.name();
        let session = SessionId(request.session);
        let id = {
            let mut registry = self.inner.lock();
            registry.permission.check_load()?;
            registry.permission.check_start()?;
            if !registry.sessions.is_valid(session) {
                return Err(Error::NoSuchSession(session.to_string()));
            }
            if registry.machines.find(name).is_ok() {
                return Err(Error::MachineTwice(name.to_owned()));
            }
            registry.machines.last += 1;
            registry.machines.last
        };
        let (thread, nets) = self.inner.load_all(id, program, &configurations, session)?;
        let added = self.add(id, request, program, configurations, (thread, &nets));
        if let Err(error) = added {
            self.inner.discard(&nets);
            self.inner.lock().nets.free_machine(id);
            self.inner.lock().machines.all.remove(&id);
            return Err(error);
        }
        Ok((id, nets))
    }

    fn add(
        &self,
        id: u32,
        request: &MachineRequest,
        program: &Arc<Program>,
        configurations: Vec<Configuration>,
        (thread, nets): (usize, &[NetId]),
    ) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let name = program.name();
        if registry.machines.find(name).is_ok() {
            return Err(Error::MachineTwice(name.to_owned()));
        }
        let (mut hosted, view) = Hosted::new(id, Arc::clone(program));
        let mut parts = Vec::new();
        for (net, configuration) in nets.iter().zip(configurations) {
            let counted = registry.nets.get(*net).and_then(|net| net.counted());
            let (cost, resources) =
                counted.map_or_else(Default::default, |it| (it.cost, it.resources));
            hosted.resources.add(&resources);
            parts.push(Part {
                configuration,
                cost,
                resources,
            });
        }
        let cost = MachineCost {
            step: program.worst_time(),
            components: parts.iter().map(|part| part.cost).sum(),
        };
        let total = cost.step + cost.components;
        let budget = registry.threads.budget(thread);
        let of_thread = (thread, budget);
        check_machine(&registry.nets, &registry.rules, of_thread, (name, total))?;
        hosted.cost = total.into();
        hosted.requested = registry.permission.generation();
        let text: Arc<str> = request.text.as_str().into();
        if let (Some(recorder), 0) = (&registry.recorder, thread) {
            recorder.machine((id, program), &text, &request.files);
        }
        registry.threads.check_capacity_of(thread)?;
        registry.nets.reserve_for_machine(id, thread, total);
        let loaded = Loaded {
            program: Arc::clone(program),
            text,
            session: SessionId(request.session),
            thread,
            parts,
            cost,
            view,
            added: None,
            stop_by: None,
            is_ending: false,
            ends: BTreeMap::new(),
        };
        registry.machines.all.insert(id, loaded);
        registry.threads.send(thread, Command::AddMachine(hosted))?;
        let answer = self.inner.wait_for(registry, |registry| {
            registry
                .machines
                .all
                .get(&id)
                .and_then(|loaded| loaded.added)
        })?;
        answer.map_err(|why| self.machine_rejected(name, total, budget, why))
    }

    fn machine_rejected(
        &self,
        name: &str,
        cost: Duration,
        budget: Duration,
        why: StartError,
    ) -> Error {
        let registry = self.inner.lock();
        let text = match why {
            StartError::Halted => return registry.permission.stopped(),
            StartError::ResourceInUse(number) | StartError::ResourceKept(number) => format!(
                "needs {}, which another net or machine holds or is reserved for a scheduled net\n\
                 hint: end that one first",
                registry.nets.resource_name(number)
            ),
            StartError::DeviceNotReady(number) => {
                format!(
                    "commands {}, which is not ready",
                    registry.devices.name(number)
                )
            }
            StartError::Overload { .. } => format!(
                "costs up to {cost:?} a cycle, which does not fit into the {budget:?} of its thread beside what runs\n\
                 hint: end other nets, or make the components smaller"
            ),
            StartError::TooMany => {
                "is one too many for its thread\nhint: end another first".to_owned()
            }
        };
        Error::Machine(format!("machine `{name}` {text}"))
    }

    /// Seats the components that are configured, sets values, and starts those that are started.
    fn prepare_components(
        &self,
        id: u32,
        program: &Arc<Program>,
        nets: Vec<NetId>,
        parameters: &[MachineInput],
    ) -> Result<(), Error> {
        let members = program.members();
        let mut unused = Vec::new();
        for (component, (member, net)) in members.iter().zip(nets).enumerate() {
            self.set_initial(id, component, member)?;
            if !member.is_configured && !member.is_started {
                unused.push(net);
                continue;
            }
            self.inner.lock().seat(net, true)?;
            for _ in 1..SPARES {
                self.inner.refill(id, component)?;
            }
        }
        self.inner.discard(&unused);
        for input in parameters {
            self.input(id, *input, "the parameter")?;
        }
        for (component, member) in members.iter().enumerate() {
            if member.is_started {
                let input = MachineInput::Request(component, Request::Start);
                self.input(id, input, &format!("{}.start()", member.name))?;
            }
        }
        Ok(())
    }

    /// Sets single values of properties that differ from their defaults.
    fn set_initial(&self, id: u32, component: usize, member: &Member) -> Result<(), Error> {
        let registry = self.inner.lock();
        let loaded = registry.machines.all.get(&id);
        let part = loaded.and_then(|loaded| loaded.parts.get(component));
        let Some(part) = part else {
            return Ok(());
        };
        let properties = member.component.properties.iter().enumerate();
        let values = properties.zip(part.configuration.values());
        let changed = values.filter(|((_, property), value)| property.default != **value);
        let changed =
            changed.filter_map(|((number, _), value)| Some((number, value.as_ref()?.value()?)));
        let changed: Vec<_> = changed.collect();
        drop(registry);
        for some in changed.chunks(SETTINGS_MAX) {
            let input = super::command::settings(component, some);
            self.input(id, input, &format!("the properties of {}", member.name))?;
        }
        Ok(())
    }
}

impl Shared {
    /// Loads one net of each component, in the thread that serves the devices of the machine.
    fn load_all(
        &self,
        id: u32,
        program: &Program,
        configurations: &[Configuration],
        session: SessionId,
    ) -> Result<(usize, Vec<NetId>), Error> {
        let mut thread = 0;
        loop {
            let nets = self.load_each(id, program, configurations, (session, thread))?;
            let registry = self.lock();
            let threads: Vec<_> = nets
                .iter()
                .map(|net| registry.nets.thread_of(net.0))
                .collect();
            drop(registry);
            let Some(other) = threads.iter().find(|one| **one != thread) else {
                return Ok((thread, nets));
            };
            self.discard(&nets);
            if thread != 0 {
                return Err(Error::Machine(format!(
                    "the components of machine `{}` command devices of several net threads\n\
                     hint: give these devices the same `thread` in the cell's configuration",
                    program.name()
                )));
            }
            thread = *other;
        }
    }

    fn load_each(
        &self,
        id: u32,
        program: &Program,
        configurations: &[Configuration],
        place: (SessionId, usize),
    ) -> Result<Vec<NetId>, Error> {
        let mut nets = Vec::new();
        let mut errors = Vec::new();
        for (component, (member, configuration)) in
            program.members().iter().zip(configurations).enumerate()
        {
            let owner = (program.name().to_owned(), id, component);
            match self.load_component(&owner, member, configuration, place) {
                Ok(net) => nets.push(net),
                Err(error) => errors.push(error.to_string()),
            }
        }
        if errors.is_empty() {
            return Ok(nets);
        }
        self.discard(&nets);
        Err(Error::Machine(errors.join("\n")))
    }

    /// Unloads nets that were never handed to a thread.
    fn discard(&self, nets: &[NetId]) {
        let mut registry = self.lock();
        let mut unloaded = Vec::new();
        for net in nets {
            registry
                .nets
                .change(*net, Change::GiveUp("its component is not configured"));
            if registry.nets.get(*net).is_some_and(|net| net.is_over()) {
                unloaded.extend(registry.nets.unload(*net));
            }
        }
        self.announce(&registry);
        drop(registry);
        drop(unloaded);
    }
}

/// The component files of a request.
fn library(request: &MachineRequest) -> impl Fn(&str) -> Result<String, String> {
    |name: &str| {
        let file = request.files.iter().find(|(known, _)| known == name);
        let missing = || format!("the file {name} was not sent with the machine");
        file.map(|(_, text)| text.clone()).ok_or_else(missing)
    }
}

/// Parameters of a request as inputs.
fn parameters(program: &Program, request: &MachineRequest) -> Result<Vec<MachineInput>, Error> {
    let one = |(name, text): &(String, String)| {
        let variables = program.variables();
        let known = |v: &takt_machine::machine::Variable| v.is_parameter && v.name == *name;
        let index = variables.iter().position(known);
        let variable = index.and_then(|index| Some((index, variables.get(index)?)));
        let (index, variable) = variable.ok_or_else(|| {
            let names = variables.iter().filter(|v| v.is_parameter);
            let names: Vec<&str> = names.map(|v| v.name.as_str()).collect();
            Error::Machine(format!(
                "the machine has no parameter `{name}`\nhint: it has {}",
                if names.is_empty() {
                    "none".to_owned()
                } else {
                    names.join(", ")
                }
            ))
        })?;
        let value = command::parameter(variable.kind, text);
        let value = value.map_err(|why| {
            Error::Machine(format!(
                "parameter `{name}`: {why}\nhint: write a value of that type"
            ))
        })?;
        Ok(MachineInput::Parameter(index, value))
    };
    request.parameters.iter().map(one).collect()
}

/// Values of the properties of all components.
fn configurations(
    program: &Program,
    request: &MachineRequest,
) -> Result<Vec<Configuration>, Error> {
    let members = program.members();
    let all = members
        .iter()
        .map(|member| Configuration::of(&member.component));
    let mut all: Vec<Configuration> = all.collect();
    for (name, text) in &request.properties {
        let found = members
            .iter()
            .zip(&mut all)
            .find(|(member, _)| member.name == *name);
        let Some((member, configuration)) = found else {
            let names: Vec<&str> = members.iter().map(|member| member.name.as_str()).collect();
            return Err(Error::Machine(format!(
                "properties of `{name}`: there is no such component\nhint: there are {}",
                names.join(", ")
            )));
        };
        let is_xml = text.trim_start().starts_with('<');
        let file = if is_xml {
            PropertyFile::from_cpf(text)
        } else {
            PropertyFile::from_toml(text)
        };
        let file = file.map_err(|found| {
            Error::Machine(
                found
                    .render(&format!("properties of {name}"), text)
                    .trim_end()
                    .to_owned(),
            )
        })?;
        let applied = configuration.apply(&member.component, Phase::PreOperational, &file);
        applied.map_err(|why| Error::Machine(format!("component {name}: {why}")))?;
    }
    Ok(all)
}
