//! The components as the machine sees them in one step: their nets among the running ones. Nothing here blocks,
//! allocates or frees; nets that are not needed any more are collected for the controller.

use takt_machine::lifecycle::{Phase, Request};
use takt_machine::machine::{Machine, Refused, Ticket};
use takt_machine::{Component, Peers, Program, Value};

use super::hosted::{Asked, Slot};
use crate::executor::life::{Change, End, Life, StartReport};
use crate::executor::{DeviceView, Running};

/// The components of one machine.
pub(super) struct Components<'e> {
    pub(super) program: &'e Program,
    pub(super) slots: &'e mut [Slot],
    pub(super) running: &'e mut [Box<Running>],
    pub(super) devices: &'e [DeviceView],
    pub(super) asked: &'e mut Vec<Asked>,
    #[expect(clippy::vec_box, reason = "nets move as boxes")]
    pub(super) returned: &'e mut Vec<Box<Running>>,
    /// Nets that can still be started.
    pub(super) free: usize,
}

impl Components<'_> {
    fn declared(&self, component: usize) -> Result<&Component, Refused> {
        let member = self.program.members().get(component);
        Ok(&member.ok_or(Refused::Unknown)?.component)
    }

    fn slot(&mut self, component: usize) -> Result<&mut Slot, Refused> {
        self.slots.get_mut(component).ok_or(Refused::Unknown)
    }

    /// The net of a component that runs.
    fn net(&self, component: usize) -> Option<&Running> {
        let slot = self.slots.get(component)?;
        if let Some(starting) = &slot.starting {
            return Some(starting);
        }
        let (id, at) = slot.net?;
        let net = self.running.get(at).filter(|net| net.id == id)?;
        net.is_going_on().then_some(net)
    }

    /// Components whose nets ended since the last step: by themselves, or with an error.
    pub(super) fn observe(&mut self, machine: &mut Machine) {
        for component in 0..self.slots.len() {
            let net = self.slots.get(component).and_then(|slot| slot.net);
            let Some((id, at)) = net else {
                continue;
            };
            let net = self.running.get(at).filter(|net| net.id == id);
            let end = net.map_or(Some(End::Aborted), |net| net.life.end());
            let Some(end) = end else {
                continue;
            };
            self.retire(component, at, id);
            let has_failed = end != End::Terminated;
            if let Some(slot) = self.slots.get_mut(component) {
                let request = if has_failed {
                    Request::Error
                } else {
                    Request::Stop
                };
                slot.phase = slot.phase.after(request).unwrap_or(slot.phase);
            }
            if has_failed {
                machine.component_failed(component);
            }
        }
    }

    /// Stops all components: their machine has failed.
    pub(super) fn stop_all(&mut self) {
        for component in 0..self.slots.len() {
            // One with an error has no net, and its state stays visible.
            if self.phase(component) == Phase::Running {
                let _ = self.request(component, Request::Stop);
            }
        }
    }

    /// Keeps the last out values of a net that no longer runs.
    fn retire(&mut self, component: usize, at: usize, id: u32) {
        let net = self.running.get_mut(at).filter(|net| net.id == id);
        if let (Some(net), Some(slot)) = (net, self.slots.get_mut(component)) {
            let Running { seat, plan, .. } = &mut **net;
            // The net carries the earlier seat to the controller, which frees it.
            std::mem::swap(seat, &mut slot.retired);
            if let Some(seat) = &mut slot.retired {
                seat.keep(plan);
            }
        }
        if let Some(slot) = self.slots.get_mut(component) {
            slot.net = None;
        }
    }

    fn begin(&mut self, component: usize) -> Result<(), Refused> {
        if self.free == 0 {
            return Err(Refused::NotReady);
        }
        let slot = self.slots.get(component).ok_or(Refused::Unknown)?;
        let ready = slot.ready.iter().flatten().next();
        let ready = ready.ok_or(Refused::NotReady)?;
        let (resources, devices) = (ready.resources, &ready.devices);
        let is_ready = |number: usize| self.devices.get(number).is_some_and(DeviceView::is_ready);
        if !devices.iter().all(|(number, _)| is_ready(*number)) {
            return Err(Refused::Device);
        }
        for other in (0..self.slots.len()).filter(|other| *other != component) {
            let held = self.net(other).map(|net| &net.resources);
            if held.is_some_and(|held| held.common(&resources).is_some()) {
                return Err(Refused::InUse);
            }
        }
        let slot = self.slots.get_mut(component).ok_or(Refused::Unknown)?;
        let net = slot.ready.iter_mut().find_map(Option::take);
        let mut net = net.ok_or(Refused::NotReady)?;
        for device in &mut net.devices {
            device.1 = self.devices.get(device.0).map_or(0, |view| view.faults);
        }
        net.life = Life::Succeeding;
        net.start_report = StartReport::Due;
        if let Some(seat) = &net.seat {
            for (number, value) in slot.values.iter().enumerate() {
                if let (Some(entry), Some(value)) = (seat.property(number), value) {
                    net.plan.write_in(entry, 0, &[value.word()]);
                }
            }
        }
        slot.calls.fill((0, 0));
        slot.net = Some((net.id, usize::MAX));
        slot.starting = Some(net);
        self.free -= 1;
        Ok(())
    }

    fn end(&mut self, component: usize) -> Result<(), Refused> {
        let slot = self.slot(component)?;
        if let Some(net) = slot.starting.take() {
            // It was never evaluated; a value that was written to it stays until it starts.
            slot.net = None;
            match slot.ready.iter_mut().find(|place| place.is_none()) {
                Some(place) => *place = Some(net),
                None => self.returned.push(net),
            }
            self.free += 1;
            return Ok(());
        }
        let Some((id, at)) = slot.net else {
            return Ok(());
        };
        if let Some(net) = self.running.get_mut(at).filter(|net| net.id == id) {
            net.change(Change::End(End::Stopped));
        }
        self.retire(component, at, id);
        Ok(())
    }
}

impl Peers for Components<'_> {
    fn phase(&self, component: usize) -> Phase {
        self.slots
            .get(component)
            .map_or(Phase::PreOperational, |slot| slot.phase)
    }

    fn read(&self, component: usize, port: usize, element: usize) -> Option<Value> {
        let declared = &self.program.members().get(component)?.component;
        let kind = declared.ports.get(port)?.declared.shape.kind;
        let word = match self.net(component) {
            Some(net) => {
                let entry = net.seat.as_ref()?.port(port)?;
                net.plan.out_word(entry, element)?
            }
            None => {
                let slot = self.slots.get(component)?;
                slot.retired.as_ref()?.last_word(port, element)?
            }
        };
        Value::of_word(kind, word)
    }

    fn write(&mut self, component: usize, port: usize, value: Value) -> Result<(), Refused> {
        let ports = &self.declared(component)?.ports;
        let declared = &ports.get(port).ok_or(Refused::Unknown)?.declared;
        let value = declared.accepted(value).ok_or(Refused::Value)?;
        let net = self.net(component).ok_or(Refused::NotRunning)?;
        let entry = net.seat.as_ref().and_then(|seat| seat.port(port));
        let entry = entry.ok_or(Refused::Unknown)?;
        if net.plan.write_in(entry, 0, &[value.word()]) {
            Ok(())
        } else {
            Err(Refused::Unknown)
        }
    }

    fn set(&mut self, component: usize, values: &[(usize, Value)]) -> Result<(), Refused> {
        let is_at_rest = matches!(
            self.phase(component),
            Phase::PreOperational | Phase::Stopped
        );
        let properties = &self.declared(component)?.properties;
        for (number, value) in values {
            let property = properties.get(*number).ok_or(Refused::Unknown)?;
            property.declared.accepted(*value).ok_or(Refused::Value)?;
            if !property.live && !is_at_rest {
                return Err(Refused::NotLive);
            }
        }
        for (number, value) in values {
            let properties = &self.declared(component)?.properties;
            let property = properties.get(*number).ok_or(Refused::Unknown)?;
            let value = property.declared.accepted(*value).ok_or(Refused::Value)?;
            if let Some(slot) = self.slot(component)?.values.get_mut(*number) {
                *slot = Some(value);
            }
            if let Some(net) = self.net(component)
                && let Some(entry) = net.seat.as_ref().and_then(|seat| seat.property(*number))
            {
                net.plan.write_in(entry, 0, &[value.word()]);
            }
        }
        Ok(())
    }

    fn request(&mut self, component: usize, request: Request) -> Result<(), Refused> {
        let phase = self.phase(component);
        let after = phase.after(request)?;
        match request {
            Request::Start | Request::Recover => self.begin(component)?,
            Request::Stop => self.end(component)?,
            Request::Configure => {
                let slot = self.slot(component)?;
                if slot.is_settled == Some(false) {
                    // It is under way.
                    return Ok(());
                }
                slot.is_settled = Some(false);
                // Its capacity is more than one request for each component.
                if self.asked.len() < self.asked.capacity() {
                    self.asked.push((component, request));
                }
                return Ok(());
            }
            Request::Cleanup => {
                let Self {
                    slots, returned, ..
                } = self;
                let slot = slots.get_mut(component).ok_or(Refused::Unknown)?;
                slot.is_settled = Some(true);
                returned.extend(slot.ready.iter_mut().filter_map(Option::take));
            }
            // Only nets report them.
            Request::Error | Request::Fatal => return Err(Refused::Unknown),
        }
        self.slot(component)?.phase = after;
        Ok(())
    }

    fn is_settled(&self, component: usize) -> Result<bool, Refused> {
        let slot = self.slots.get(component).ok_or(Refused::Unknown)?;
        slot.is_settled.ok_or(Refused::NotConfigured)
    }

    fn call(
        &mut self,
        component: usize,
        operation: usize,
        arguments: &[Value],
    ) -> Result<Ticket, Refused> {
        let operations = &self.declared(component)?.operations;
        let declared = operations.get(operation).ok_or(Refused::Unknown)?;
        if declared.arguments.len() != arguments.len() {
            return Err(Refused::Unknown);
        }
        for (declared, value) in declared.arguments.iter().zip(arguments) {
            declared.accepted(*value).ok_or(Refused::Value)?;
        }
        let slot = self.slots.get(component).ok_or(Refused::Unknown)?;
        let (number, _) = slot.calls.get(operation).ok_or(Refused::Unknown)?;
        let number = number.wrapping_add(1);
        let net = self.net(component).ok_or(Refused::NotRunning)?;
        let seat = net.seat.as_ref().ok_or(Refused::Unknown)?;
        let entries = seat.operation(operation).ok_or(Refused::Unknown)?;
        let pairs = entries.arguments.iter().zip(&declared.arguments);
        for ((entry, declared), value) in pairs.zip(arguments) {
            if let (Some(entry), Some(value)) = (entry, declared.accepted(*value)) {
                net.plan.write_in(entry, 0, &[value.word()]);
            }
        }
        let calls = entries.calls.as_ref().ok_or(Refused::Unknown)?;
        net.plan
            .write_in(calls, 0, &[Value::Int(number.cast_signed()).word()]);
        let evaluations = net.plan.evaluations();
        if let Some(call) = self.slot(component)?.calls.get_mut(operation) {
            *call = (number, evaluations);
        }
        Ok(Ticket {
            component,
            operation,
            number,
        })
    }

    fn is_done(&self, ticket: Ticket) -> Result<bool, Refused> {
        let declared = self.declared(ticket.component)?;
        let operation = declared.operations.get(ticket.operation);
        let operation = operation.ok_or(Refused::Unknown)?;
        let net = self.net(ticket.component).ok_or(Refused::NotRunning)?;
        let Some(done) = &operation.done else {
            return Ok(true);
        };
        let mut ports = declared.ports.iter();
        let port = ports.position(|port| port.declared.name == *done);
        let slot = self.slots.get(ticket.component).ok_or(Refused::Unknown)?;
        let call = slot.calls.get(ticket.operation).ok_or(Refused::Unknown)?;
        let is_later = net.plan.evaluations() > call.1;
        let value = port.and_then(|port| self.read(ticket.component, port, 0));
        Ok(is_later && value == Some(Value::Bool(true)))
    }
}
