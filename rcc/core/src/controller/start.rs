//! What happens when a net starts, up to its thread and back. The checks here, under the registry's lock: the
//! net waits for its start ([`nets`](super::nets)), nothing is stopped, and the thread has cycle time for it. Then
//! the net is sent to its thread (`executor::thread`), which has the last word (`executor::start`): resources and
//! devices. The caller waits for its answer, which arrives as an event.

use crate::controller::Controller;
use crate::controller::admission::overload;
use crate::controller::nets::{Change, HandOver};
use crate::controller::registry::Registry;
use crate::controller::rules::RuleId;
use crate::controller::threads::busy;
use crate::error::Error;
use crate::executor::rules::RuleState;
use crate::executor::thread::Command;
use crate::executor::{RUNNING_MAX, Running, StartError};
use crate::ids::NetId;

impl Controller {
    /// Starts a net and waits until it runs.
    ///
    /// # Errors
    /// If it is not ready, a resource is in use, or a device that it commands is not operational.
    pub fn start_net(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let rule = registry.start(id)?;
        let started = |registry: &mut Registry| match registry.nets.get_mut(id) {
            None => Some(Err(Error::NoSuchNet(id))),
            Some(net) => net.started(),
        };
        let outcome = self.inner.wait_for(registry, started)?;
        let state = match outcome {
            Ok(()) => RuleState::Fired,
            Err(_) => RuleState::FireFailed,
        };
        self.inner.lock().rules.decide(rule, state);
        outcome
    }
}

impl Registry {
    /// Sends a net to its thread to run. The start counts as a rule, whose number is returned.
    pub(super) fn start(&mut self, id: NetId) -> Result<RuleId, Error> {
        self.permission.check_start()?;
        self.nets.find(id)?.check_start(id)?;
        let thread = self.nets.thread_of(id.0);
        let budget = self.threads.budget(thread);
        self.admission
            .check_start(&self.nets, &self.rules, budget, id)?;
        self.threads.check_capacity_of(thread)?;
        let rule = self.rules.next_id();
        let hand_over = self.nets.find(id)?.start();
        self.send_start(id, hand_over)?;
        Ok(rule)
    }

    fn send_start(&mut self, id: NetId, hand_over: Option<HandOver>) -> Result<(), Error> {
        let command = match hand_over {
            Some(HandOver::Start(mut running)) => {
                running.requested = self.permission.generation();
                Command::Start(running)
            }
            Some(HandOver::StartScheduled) => Command::StartScheduled(id.0),
            Some(HandOver::Schedule(_)) | None => return Ok(()),
        };
        self.command(command)
    }

    /// The thread runs a net, started by a request or by a rule.
    pub(super) fn started(&mut self, id: NetId) {
        self.nets.change(id, Change::Run);
        self.component_started(id);
    }

    /// The thread rejected the start of a net.
    pub(super) fn start_rejected(&mut self, running: Box<Running>, why: StartError) {
        let net = NetId(running.id);
        let error = match why {
            StartError::Halted => self.permission.stopped(),
            StartError::TooMany => Error::TooMany {
                item: "running nets",
                bound: RUNNING_MAX,
            },
            StartError::ResourceKept(number) => Error::ResourceKept {
                net,
                resource: self.nets.resource_name(number),
                holder: self.nets.holder_text(number, &[net]),
            },
            StartError::ResourceInUse(number) => Error::ResourceInUse {
                net,
                resource: self.nets.resource_name(number),
                holder: self.nets.holder_text(number, &[net]),
            },
            StartError::DeviceNotReady(number) => Error::DeviceNotReady {
                net,
                device: self.devices.name(number),
                status: self.permission.status_text(self.devices.status(number)),
            },
            StartError::Overload { running, budget } => {
                let [running, budget] =
                    [running, budget].map(|time| time.try_into().unwrap_or_default());
                overload(&self.nets, net, running, budget)
            }
        };
        if let Some(net) = self.nets.get_mut(net) {
            net.reject_start(running, error);
        }
    }

    /// Rules no longer hold a net: the thread returned it. If a start was requested besides, it is sent again.
    pub(super) fn unscheduled(&mut self, running: Box<Running>) {
        let id = NetId(running.id);
        if self
            .nets
            .get(id)
            .is_some_and(|net| net.component_of.is_some())
        {
            self.nets.change(id, Change::Return(running));
            self.nets
                .change(id, Change::GiveUp("its machine needs it no longer"));
            self.component_ended(id, None);
            return;
        }
        let thread = self.nets.thread_of(id.0);
        let has_capacity = self.threads.check_capacity_of(thread).is_ok();
        let Some(net) = self.nets.get_mut(id) else {
            return;
        };
        if net.is_starting() && !has_capacity {
            net.reject_start(running, busy());
            return;
        }
        if let Some(HandOver::Start(running)) = net.change(Change::Return(running)) {
            self.command(Command::Start(running)).ok();
        }
    }
}
