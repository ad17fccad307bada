//! What machines cause outside of their threads: a thread that loads nets for the next starts of components, configures
//! components, and unloads nets that ended. It blocks no machine; only a `configure` is awaited.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use takt_machine::Configuration;
use takt_machine::machine::Member;

use super::{Job, Loaded, Machines};
use crate::controller::load::LoadRequest;
use crate::controller::nets::{Change, HandOver};
use crate::controller::registry::Registry;
use crate::controller::shared::Shared;
use crate::controller::threads::Wanted;
use crate::error::Error;
use crate::executor::machines::{SPARES, Seat};
use crate::executor::thread::Command;
use crate::ids::{NetId, SessionId};

/// Longest time until a request of a machine is noticed; the supervisor wakes this thread earlier.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Executes the jobs of all machines until the controller ends.
pub(in crate::controller) fn work(inner: &Shared) {
    while !inner.stop.load(Ordering::Relaxed) {
        let mut registry = inner.lock();
        let Some(job) = registry.machines.jobs.pop_front() else {
            let waited = inner.changed.wait_timeout(registry, POLL_INTERVAL);
            drop(waited.unwrap_or_else(PoisonError::into_inner));
            continue;
        };
        match job {
            Job::Unload(net) => {
                let unloaded = registry.unload_component(net);
                inner.announce(&registry);
                drop(registry);
                // A large net is freed without the lock.
                drop(unloaded);
            }
            Job::Refill(machine, component) => {
                registry.machines.loading = Some(machine);
                drop(registry);
                if let Err(error) = inner.refill(machine, component) {
                    inner.log_failed(machine, component, &error);
                }
            }
            Job::Configure(machine, component) => {
                registry.machines.keep_properties(machine, component);
                registry.machines.loading = Some(machine);
                drop(registry);
                if let Err(error) = inner.configure(machine, component) {
                    inner.log_failed(machine, component, &error);
                    inner.lock().seat_failed(machine, component);
                }
            }
        }
        let mut registry = inner.lock();
        if registry.machines.loading.take().is_some() {
            inner.announce(&registry);
        }
    }
}

impl Machines {
    /// Keeps the values of properties that were set at run time.
    pub(super) fn keep_properties(&mut self, machine: u32, component: usize) {
        let Some(loaded) = self.all.get_mut(&machine) else {
            return;
        };
        let Loaded {
            program,
            parts,
            view,
            ..
        } = loaded;
        let (Some(member), Some(part)) =
            (program.members().get(component), parts.get_mut(component))
        else {
            return;
        };
        let values = view.read_with(|view| view.properties.get(component).cloned());
        let properties = member.component.properties.iter();
        let pairs = properties.zip(values.iter().flatten());
        let changes = pairs.filter_map(|(property, value)| {
            Some((property.declared.name.clone(), (*value)?.into()))
        });
        let phase = takt_machine::Phase::Stopped;
        let kept = part.configuration.set(&member.component, phase, changes);
        // They were checked when they were set.
        debug_assert!(kept.is_ok(), "{kept:?}");
    }

    /// What is needed to load a net of a component.
    fn part(&self, machine: u32, component: usize) -> Option<(&Loaded, &Member, &Configuration)> {
        let loaded = self.all.get(&machine).filter(|loaded| !loaded.is_ending)?;
        let member = loaded.program.members().get(component)?;
        Some((loaded, member, &loaded.parts.get(component)?.configuration))
    }
}

impl Registry {
    /// Unloads an ended net of a component.
    fn unload_component(&mut self, net: NetId) -> Option<crate::controller::nets::Net> {
        let is_over = self.nets.get(net)?.is_over();
        if !is_over {
            return None;
        }
        self.command(Command::Forget(net.0)).ok();
        self.nets.unload(net)
    }

    /// Hands a net to its machine for the next start of a component.
    pub(super) fn seat(&mut self, net: NetId, fresh: bool) -> Result<(), Error> {
        let thread = self.nets.thread_of(net.0);
        self.threads.check_capacity_of(thread)?;
        let Some((machine, component)) = self.nets.find(net)?.component_of else {
            return Ok(());
        };
        let Some(loaded) = self.machines.all.get(&machine) else {
            return Ok(());
        };
        let program = Arc::clone(&loaded.program);
        let Some(member) = program.members().get(component) else {
            return Ok(());
        };
        if let Some(HandOver::Schedule(mut running)) = self.nets.change(net, Change::HandToRules) {
            let seat = Seat::of(
                &program,
                (machine, component),
                &member.component,
                &running.plan,
            );
            running.seat = Some(Box::new(seat));
            running.requested = self.permission.generation();
            self.threads.send(thread, Command::Seat(running, fresh))?;
            self.nets.change(net, Change::Schedule);
        }
        Ok(())
    }

    fn seat_failed(&mut self, machine: u32, component: usize) {
        if let Some(loaded) = self.machines.all.get(&machine) {
            let command = Command::SeatFailed(machine, component);
            self.threads.send(loaded.thread, command).ok();
        }
    }
}

impl Shared {
    fn log_failed(&self, machine: u32, component: usize, error: &Error) {
        let registry = self.lock();
        if let Some((loaded, member, _)) = registry.machines.part(machine, component) {
            tracing::warn!(
                machine = loaded.program.name(),
                component = member.name,
                "the component cannot be configured: {error}"
            );
        }
    }

    /// Loads one more net for the next starts of a component.
    pub(super) fn refill(&self, machine: u32, component: usize) -> Result<(), Error> {
        let known = self.lock();
        let Some((loaded, member, configuration)) = known.machines.part(machine, component) else {
            return Ok(());
        };
        let (member, configuration) = (member.clone(), configuration.clone());
        let (session, thread) = (loaded.session, loaded.thread);
        let owner = (loaded.program.name().to_owned(), machine, component);
        drop(known);
        let net = self.load_component(&owner, &member, &configuration, (session, thread))?;
        let mut registry = self.lock();
        registry.check_part(net)?;
        registry.seat(net, false)
    }

    /// Loads the nets of a component with the present values of its properties.
    fn configure(&self, machine: u32, component: usize) -> Result<(), Error> {
        for number in 0..SPARES {
            let known = self.lock();
            let Some((loaded, member, configuration)) = known.machines.part(machine, component)
            else {
                return Ok(());
            };
            let (member, configuration) = (member.clone(), configuration.clone());
            let (session, thread) = (loaded.session, loaded.thread);
            let owner = (loaded.program.name().to_owned(), machine, component);
            drop(known);
            let net = self.load_component(&owner, &member, &configuration, (session, thread))?;
            let mut registry = self.lock();
            registry.check_part(net)?;
            registry.seat(net, number == 0)?;
        }
        Ok(())
    }

    /// Loads a net of a component.
    pub(super) fn load_component(
        &self,
        (machine, id, component): &(String, u32, usize),
        member: &Member,
        configuration: &Configuration,
        (session, thread): (SessionId, usize),
    ) -> Result<NetId, Error> {
        let complete = configuration.check_complete(&member.component);
        complete.map_err(|why| Error::Machine(format!("component {}: {why}", member.name)))?;
        let request = LoadRequest {
            text: member.component.net_text(configuration),
            session,
            description: format!("{machine}.{}", member.name),
            period: None,
        };
        let net = self.load(request, Wanted::Cycles(member.component.every, thread))?;
        let mut registry = self.lock();
        let rejection = registry.nets.get_mut(net).and_then(|loaded| {
            loaded.component_of = Some((*id, *component));
            loaded.info(net).rejection
        });
        if let Some(rejection) = rejection {
            registry.nets.remove(net);
            drop(registry);
            let found = member.component.locate(configuration, (*rejection).clone());
            let text: Vec<String> = found
                .all()
                .iter()
                .map(|one| format!("{}: {}\nhint: {}", member.file, one.text, one.hint))
                .collect();
            return Err(Error::Machine(text.join("\n")));
        }
        Ok(net)
    }
}

impl Registry {
    /// Checks that a net of a component needs no more than was reserved when the machine was loaded; else it is
    /// unloaded.
    fn check_part(&mut self, net: NetId) -> Result<(), Error> {
        let Some(loaded) = self.nets.get(net) else {
            return Err(Error::NoSuchNet(net));
        };
        let known = loaded.component_of.zip(loaded.counted());
        let Some(((machine, component), counted)) = known else {
            return Ok(());
        };
        let owner = self.machines.all.get(&machine);
        let Some(part) = owner.and_then(|owner| owner.parts.get(component)) else {
            // Its machine has ended meanwhile.
            self.nets
                .change(net, Change::GiveUp("its machine ended before it ran"));
            self.nets.unload(net);
            return Err(Error::NoSuchNet(net));
        };
        let mut beyond = counted.resources;
        beyond.remove(&part.resources);
        let (cost, reserved) = (counted.cost, part.cost);
        let is_elsewhere = owner.is_some_and(|owner| owner.thread != loaded.thread());
        if cost <= reserved && beyond == Default::default() && !is_elsewhere {
            return Ok(());
        }
        self.nets.change(
            net,
            Change::GiveUp("its machine did not reserve enough for it"),
        );
        self.nets.unload(net);
        Err(Error::Machine(format!(
            "with these properties its net costs {cost:?} of the {reserved:?} that were reserved, or commands other \
             devices\nhint: set the properties when the machine is loaded"
        )))
    }
}
