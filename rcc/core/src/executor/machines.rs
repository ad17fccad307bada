//! Machines in the thread that evaluates the nets of their components. A machine is stepped once a period, after the nets
//! and before the rules: what it starts is evaluated from the next cycle on, in the order of its components, and what it
//! stops ends with this cycle. It loads nothing: nets of components are seated here before they are started.

mod components;
mod hosted;
mod input;
mod seat;
mod view;

use std::sync::Arc;

use takt_machine::lifecycle::{Phase, Request};
use takt_machine::machine::{Cause, Machine, Status};
use takt_net::Moment;
use takt_rt::Nanos;

use super::life::{Change, End};
use super::{BUCKETS, Executor, Running, StartError};
use crate::stop_channel::Generation;
use components::Components;

pub use hosted::{Asked, Hosted, MACHINES_MAX, SPARES};
pub use input::{InputError, InputWords, MachineInput, SETTINGS_MAX, Settings};
pub use seat::Seat;
pub use view::{MachineState, MachineView};

/// The word of the state of a machine, or of the one of that number inside, without the state: that number plus 1 is in the
/// lowest 16 bits, and 0 while the machine is inactive.
#[must_use]
pub const fn state_word(id: u32, number: usize) -> u64 {
    ((id as u64 + 1) << 32) | ((number as u64 & 0xFFFF) << 16)
}

/// An event of a machine.
#[derive(Debug)]
pub enum MachineEvent {
    /// It requests a `configure` of this component.
    Configure(usize),
    /// A net that no longer waits for a start.
    Returned(Box<Running>),
    /// Its status has changed.
    Status(Status),
}

impl Executor {
    /// Adds a machine. Its components are seated afterwards.
    ///
    /// # Errors
    /// If there is no place, a resource of it is held or reserved, or its cost exceeds the budget.
    pub fn add_machine(&mut self, hosted: Box<Hosted>) -> Result<(), (Box<Hosted>, StartError)> {
        if self.machines.len() >= MACHINES_MAX {
            return Err((hosted, StartError::TooMany));
        }
        if let Some(resource) = hosted.resources.common(&self.held()) {
            return Err((hosted, StartError::ResourceInUse(resource)));
        }
        if let Some(resource) = self.rules.reserved(&hosted.resources) {
            return Err((hosted, StartError::ResourceKept(resource)));
        }
        let (running, budget) = (self.load(), self.budget);
        if running + hosted.cost > budget {
            return Err((hosted, StartError::Overload { running, budget }));
        }
        self.machines.push(hosted);
        Ok(())
    }

    /// Ends a machine where it is: its components end before the next cycle.
    pub fn remove_machine(&mut self, id: u32) -> Option<Box<Hosted>> {
        let at = self.machines.iter().position(|hosted| hosted.id == id)?;
        let hosted = self.machines.remove(at);
        for net in &mut self.running {
            if net.seat.as_ref().is_some_and(|seat| seat.machine == id) {
                net.change(Change::End(End::Stopped));
            }
        }
        Some(hosted)
    }

    /// Seats a net for the next start of a component; a `fresh` one replaces those that wait and makes the component
    /// configured. Returns the net if there is no such component, or no place.
    ///
    /// # Errors
    /// With the net, to be returned to the controller.
    pub fn seat(&mut self, net: Box<Running>, fresh: bool) -> Result<(), Box<Running>> {
        let Some((machine, component)) = net.seat.as_ref().map(|s| (s.machine, s.component)) else {
            return Err(net);
        };
        let hosted = self.machines.iter_mut().find(|hosted| hosted.id == machine);
        let Some(hosted) = hosted else {
            return Err(net);
        };
        let Hosted {
            slots, returned, ..
        } = &mut **hosted;
        let Some(slot) = slots.get_mut(component) else {
            return Err(net);
        };
        if fresh {
            slot.is_settled = Some(true);
            slot.phase = slot.phase.after(Request::Configure).unwrap_or(slot.phase);
            returned.extend(slot.ready.iter_mut().filter_map(Option::take));
        } else if slot.phase == Phase::PreOperational {
            return Err(net);
        }
        match slot.ready.iter_mut().find(|place| place.is_none()) {
            Some(place) => *place = Some(net),
            None => return Err(net),
        }
        Ok(())
    }

    /// The net of a component could not be loaded.
    pub fn seat_failed(&mut self, machine: u32, component: usize) {
        let hosted = self.machines.iter_mut().find(|hosted| hosted.id == machine);
        if let Some(slot) = hosted.and_then(|hosted| hosted.slots.get_mut(component)) {
            slot.is_settled = None;
        }
    }

    /// Takes back a net that waits for the start of a component.
    pub(super) fn take_seated(&mut self, id: u32) -> Option<Box<Running>> {
        let slots = self
            .machines
            .iter_mut()
            .flat_map(|hosted| &mut hosted.slots);
        let mut places = slots.flat_map(|slot| &mut slot.ready);
        places
            .find(|place| place.as_ref().is_some_and(|net| net.id == id))?
            .take()
    }

    /// Executes a request of a program. What it starts is evaluated in the next cycle.
    ///
    /// # Errors
    /// If the machine or a component refuses it.
    pub fn machine_input(&mut self, machine: u32, input: &MachineInput) -> Result<(), InputError> {
        let at = self.machines.iter().position(|hosted| hosted.id == machine);
        let at = at.ok_or(InputError::Unknown)?;
        let result = self.with_machine(at, |machine, components| input.apply(machine, components));
        self.publish_machine(at);
        result.0
    }

    /// The states of all machines, first those of the outermost ones, as [`state_word`] has them.
    pub(super) fn machine_states(&self) -> impl Iterator<Item = u64> {
        let of = |hosted: &Hosted, number: usize| {
            let state = hosted.view.machines.get(number)?.state;
            Some(state_word(hosted.id, number) | state.map_or(0, |state| state as u64 + 1))
        };
        let outermost = self.machines.iter().filter_map(move |it| of(it, 0));
        let inside = self.machines.iter().flat_map(move |it| {
            let numbers = 1..it.view.machines.len();
            numbers.filter_map(move |number| of(it, number))
        });
        outermost.chain(inside)
    }

    /// Stop generation under which a machine was loaded.
    #[must_use]
    pub fn machine_generation(&self, machine: u32) -> Option<Generation> {
        let hosted = self.machines.iter().find(|hosted| hosted.id == machine)?;
        Some(hosted.requested)
    }

    /// One step of each machine; calls `stepped` with each.
    pub fn step_machines(
        &mut self,
        moment: Moment,
        clock: &mut impl FnMut() -> Nanos,
        mut stepped: impl FnMut(&mut Hosted),
    ) {
        for at in 0..self.machines.len() {
            let before = clock();
            let outcome = self.with_machine(at, |machine, components| {
                let was_active = machine.status(0) == Status::Active;
                components.observe(machine);
                let outcome = machine.step(components, moment.time.0);
                if was_active && machine.status(0) == Status::Failed {
                    components.stop_all();
                }
                outcome
            });
            let took = clock() - before;
            if let Some(hosted) = self.machines.get_mut(at) {
                hosted.view.stepped(outcome, took);
            }
            self.publish_machine(at);
            if let Some(hosted) = self.machines.get_mut(at) {
                stepped(hosted);
            }
        }
    }

    /// Reports what machines cannot do here, and changes of their status.
    pub fn machine_events(&mut self, mut report: impl FnMut(u32, MachineEvent)) {
        for hosted in &mut self.machines {
            for (component, request) in hosted.asked.drain(..) {
                if request == Request::Configure {
                    report(hosted.id, MachineEvent::Configure(component));
                }
            }
            for net in hosted.returned.drain(..) {
                report(hosted.id, MachineEvent::Returned(net));
            }
            let status = hosted.machine.status(0);
            if std::mem::replace(&mut hosted.reported, status) != status {
                report(hosted.id, MachineEvent::Status(status));
            }
        }
    }

    /// The controller is stopped: machines fail where they are.
    pub(super) fn halt_machines(&mut self) {
        for hosted in &mut self.machines {
            hosted.machine.halt(Cause::Halted);
        }
    }

    /// Cost and resources of the machines, which nets of their components do not take besides.
    pub(super) fn hosted(&self) -> impl Iterator<Item = &Hosted> {
        self.machines.iter().map(|hosted| &**hosted)
    }

    /// Finds the nets of all machines; before nets are evaluated.
    pub(super) fn locate_components(&mut self) {
        for hosted in &mut self.machines {
            hosted.locate(&self.running);
        }
    }

    /// Passes what the net at that place wrote to the components that are connected.
    pub(super) fn pass_values(&self, at: usize) {
        let Some(net) = self.running.get(at).filter(|net| net.life.is_evaluated()) else {
            return;
        };
        let Some(seat) = &net.seat else {
            return;
        };
        let hosted = self
            .machines
            .iter()
            .find(|hosted| hosted.id == seat.machine);
        if let Some(hosted) = hosted {
            hosted.pass(net, seat, &self.running);
        }
    }

    fn publish_machine(&mut self, at: usize) {
        if let Some(hosted) = self.machines.get_mut(at) {
            let Hosted {
                machine,
                slots,
                view,
                published,
                ..
            } = &mut **hosted;
            let slots = slots.iter();
            let slots = slots.map(|slot| (slot.phase, slot.net.map(|net| net.0), &slot.values));
            view.copy(machine, slots);
            published.write_with(|slot| slot.copy_from(view));
        }
    }

    /// Gives a machine access to its components; what it starts is then among the running nets.
    fn with_machine<T>(
        &mut self,
        at: usize,
        act: impl FnOnce(&mut Machine, &mut Components<'_>) -> T,
    ) -> T
    where
        T: Default,
    {
        let Self {
            machines,
            running,
            devices,
            ..
        } = self;
        let Some(hosted) = machines.get_mut(at) else {
            return T::default();
        };
        hosted.locate(running);
        let program = Arc::clone(hosted.machine.program());
        let Hosted {
            machine,
            slots,
            asked,
            returned,
            ..
        } = &mut **hosted;
        let free = BUCKETS.saturating_sub(running.len());
        let mut components = Components {
            program: &program,
            slots,
            running,
            devices,
            asked,
            returned,
            free,
        };
        let result = act(machine, &mut components);
        for component in program.order() {
            let slot = hosted.slots.get_mut(*component);
            let Some(net) = slot.and_then(|slot| slot.starting.take()) else {
                continue;
            };
            hosted.locate(running);
            hosted.fill(&net, *component, running);
            let at = seat::place_of(&net, running);
            running.insert(at, net);
        }
        result
    }
}
