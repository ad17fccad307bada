//! Ends of nets: by a request of a program, with their session, and as their thread reports them. How nets end with
//! the controller is in [`shutdown`](super::shutdown).

use std::sync::Arc;

use crate::controller::Controller;
use crate::controller::flight_recorder::Trigger;
use crate::controller::last_values::LastValues;
use crate::controller::nets::{Change, Net};
use crate::controller::registry::Registry;
use crate::error::Error;
use crate::executor::figures::RUNAWAY_AFTER;
use crate::executor::thread::Command;
use crate::executor::{End, Running};
use crate::ids::{NetId, NetState, SessionId};

/// Reason reported for a net that a rule stopped.
pub const STOPPED_BY_RULE: &str = "stopped by a rule";

/// Reason reported for a net that was aborted before it started.
const NEVER_RAN: &str = "aborted before it ran";

impl Controller {
    /// Requests a running net to end by itself; other nets are not affected.
    ///
    /// # Errors
    /// If there is no such net.
    pub fn cancel(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        if registry.nets.find(id)?.state() == NetState::Running {
            registry.command(Command::Cancel(id.0))?;
        }
        Ok(())
    }

    /// Ends a net immediately and waits until it has ended.
    ///
    /// # Errors
    /// If there is no such net or the net thread does not answer.
    pub fn abort(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        registry.nets.find(id)?.check_free(id)?;
        match registry.nets.find(id)?.state() {
            NetState::Loading | NetState::Rejected | NetState::Terminated | NetState::Unloaded => {
                return Ok(());
            }
            NetState::Ready | NetState::Scheduled => {
                if registry.give_up(id)? {
                    self.inner.announce(&registry);
                    return Ok(());
                }
            }
            NetState::Running | NetState::Cancelling => {}
        }
        // A net held by its thread may have started meanwhile.
        registry.command(Command::Abort(id.0))?;
        let mut seen_running = false;
        self.inner.wait_for(registry, |registry| {
            let Some(net) = registry.nets.get_mut(id) else {
                // Another client unloaded it meanwhile.
                return Some(());
            };
            match net.state() {
                NetState::Running | NetState::Cancelling => {
                    // It may have started only now: a start that raced with a rule is sent again.
                    if !std::mem::replace(&mut seen_running, true) {
                        registry.command(Command::Abort(id.0)).ok();
                    }
                    None
                }
                NetState::Ready | NetState::Scheduled if net.is_away() => None,
                NetState::Ready | NetState::Scheduled => {
                    net.change(Change::GiveUp(NEVER_RAN));
                    Some(())
                }
                NetState::Loading
                | NetState::Rejected
                | NetState::Terminated
                | NetState::Unloaded => Some(()),
            }
        })
    }

    /// Unloads a net that does not run; a running net is not affected.
    ///
    /// # Errors
    /// If there is no such net, or its cancel is still pending.
    pub fn unload(&self, id: NetId) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        registry.nets.find(id)?.check_free(id)?;
        match registry.nets.find(id)?.state() {
            NetState::Running => return Ok(()),
            state @ (NetState::Cancelling | NetState::Loading) => {
                let hint = "wait until it has ended, or abort it";
                return Err(Error::WrongState {
                    net: id,
                    state,
                    hint,
                });
            }
            NetState::Rejected
            | NetState::Ready
            | NetState::Scheduled
            | NetState::Terminated
            | NetState::Unloaded => {}
        }
        if registry.nets.find(id)?.is_away() {
            // Otherwise it would run unknown to all clients.
            drop(registry);
            self.abort(id)?;
            registry = self.inner.lock();
        }
        registry.withdraw(id)?;
        let net = registry.nets.unload(id);
        self.inner.announce(&registry);
        drop(registry);
        // Freeing a large net takes long; do it without the lock.
        drop(net);
        Ok(())
    }

    /// Ends the machines of a session. Before its nets: machines would take the end of a component for an error.
    ///
    /// # Errors
    /// If a net thread does not answer.
    pub fn end_session_machines(&self, id: SessionId) -> Result<(), Error> {
        for name in self.session_machines(id) {
            match self.end_machine(&name) {
                Ok(()) | Err(Error::NoSuchMachine { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Ends the machines of a session, aborts and unloads all its nets and closes it.
    ///
    /// # Errors
    /// If there is no such session, or the net thread does not answer.
    pub fn end_session(&self, id: SessionId) -> Result<(), Error> {
        if id == SessionId::NONE || self.session_nets(id).is_none() {
            return Err(Error::NoSuchSession(id.to_string()));
        }
        self.end_session_machines(id)?;
        let nets = self.session_nets(id).unwrap_or_default();
        // A net that another client unloaded meanwhile is already done.
        let unless_gone = |result| match result {
            Ok(()) | Err(Error::NoSuchNet(_)) => Ok(()),
            Err(error) => Err(error),
        };
        // Waiting nets first: the end of a running net could start them.
        for net in &nets {
            let state = self.net(*net).map(|net| net.state());
            if let Some(NetState::Ready | NetState::Scheduled) = state {
                unless_gone(self.abort(*net))?;
            }
        }
        for net in nets {
            unless_gone(self.abort(net).and_then(|()| self.unload(net)))?;
        }
        self.inner.lock().sessions.close(id);
        Ok(())
    }
}

impl Registry {
    /// Withdraws a net that does not run from rules that wait to start it or wait for it.
    fn withdraw(&mut self, id: NetId) -> Result<(), Error> {
        if self.nets.find(id)?.is_with_rules() {
            self.command(Command::Unschedule {
                net: id.0,
                always: true,
            })?;
        }
        self.command(Command::Forget(id.0))
    }

    /// Ends a net that does not run, unless its thread holds it: then it is requested back. Returns whether it has
    /// ended.
    pub(super) fn give_up(&mut self, id: NetId) -> Result<bool, Error> {
        self.withdraw(id)?;
        let net = self.nets.find(id)?;
        let is_here = !net.is_away();
        if is_here {
            net.change(Change::GiveUp(NEVER_RAN));
        }
        Ok(is_here)
    }

    /// Unloads the oldest ended net, if there is one: known clients never unload nets.
    pub(super) fn unload_oldest(&mut self) -> Option<Net> {
        let id = self.nets.oldest_over()?;
        self.withdraw(id).ok()?;
        self.nets.unload(id)
    }

    /// Aborts nets whose set-points were rejected for too long.
    pub(super) fn end_rejected(&mut self) {
        for (id, why) in self.rejections.overdue() {
            let Some(net) = self.nets.get_mut(id).filter(|net| net.runs()) else {
                continue;
            };
            net.abort_because(why);
            // If the queue is full, the next poll repeats it.
            self.command(Command::Abort(id.0)).ok();
        }
    }

    /// The thread ended a net that ran.
    pub(super) fn ended(&mut self, running: &Running, end: End) {
        let id = NetId(running.id);
        let why = self.end_text(running, end);
        let failed = match end {
            End::DeviceFault(_) | End::Runaway => true,
            End::Aborted => self
                .nets
                .get(id)
                .is_some_and(|net| net.abort_reason().is_some()),
            End::Terminated => why.is_some(),
            End::Halted | End::Stopped => false,
        };
        if let (true, Some(why)) = (failed, &why) {
            let table = self.keep_last_values(running).table();
            let written = self.flights.as_ref().map(|flights| {
                let cause = format!("net {id} ended: {why}");
                // The net may be the first to notice that its device has failed.
                let device = match end {
                    End::DeviceFault(number) => self.devices.table.get(number),
                    End::Runaway | End::Aborted | End::Terminated | End::Halted | End::Stopped => {
                        None
                    }
                };
                let subject = device.map_or_else(|| id.to_string(), |it| it.name.clone());
                flights.trigger(Trigger::Fault, &subject, &cause).line()
            });
            let written = written.unwrap_or_default();
            tracing::warn!(net = %id, "net ended: {why}{written}\nlast values, all at /nets/{id}/last:\n{table}");
        }
        self.nets.change(id, Change::End(why.clone()));
        self.answer_rules(id);
        self.component_ended(id, why);
    }

    /// Keeps the last values of a net that failed and of the devices that it commanded.
    fn keep_last_values(&mut self, running: &Running) -> Arc<LastValues> {
        let devices = running.plan.devices().iter();
        let devices = devices.filter_map(|name| self.devices.table.find(name).cloned());
        let mut values = LastValues::of_devices(devices);
        let id = NetId(running.id);
        let thread = self.threads.get(self.nets.thread_of(running.id));
        if let Some(thread) = thread {
            values = values.with_net(id, running.plan.outbox(), &thread.flight);
        }
        self.monitor.flights_mut().keep_net(id, values)
    }

    /// The reason why a net ended, unless it terminated by itself and none of its primitives failed.
    fn end_text(&self, net: &Running, end: End) -> Option<String> {
        match end {
            End::Terminated => net.plan.failure(),
            End::Aborted => {
                let why = self.nets.get(NetId(net.id)).and_then(Net::abort_reason);
                Some(why.unwrap_or("aborted").to_owned())
            }
            End::Halted => {
                let by = self.permission.switch().last_stop();
                let by = by.map(|(by, _)| format!(" by {by}"));
                Some(format!("stopped{}: takt stop", by.unwrap_or_default()))
            }
            End::Stopped => Some(match self.machine_of(NetId(net.id)) {
                Some(machine) => format!("stopped by its machine {machine}, or by a rule"),
                None => STOPPED_BY_RULE.to_owned(),
            }),
            End::Runaway => {
                let longest = net.counters().read().max;
                let period = self.threads.period(self.nets.thread_of(net.id));
                let period = period.unwrap_or_else(|| net.plan.period());
                Some(format!(
                    "took longer than the {period:?} between two cycles of its thread, {RUNAWAY_AFTER} times \
                     in a row, up to {longest:?}; make it smaller or load it for a slower net thread"
                ))
            }
            End::DeviceFault(number) => {
                let device = self.devices.table.get(number);
                let name = device.map_or("?", |device| device.name.as_str());
                let status = self.permission.status_text(self.devices.status(number));
                Some(format!(
                    "device {name} stopped following commands and is {status}"
                ))
            }
        }
    }
}
