//! The way to a standstill: nothing begins any more, nets end, devices come to rest, and only then do threads end.
//! How a device brakes is its driver's business.

use std::time::{Duration, Instant};

use crate::controller::desk::Desk;
use crate::controller::net::Net;
use crate::controller::{Controller, NEVER_RAN, NetId, NetState, SessionId};
use crate::error::Error;
use crate::executor::thread::{Command, NetThread};

/// How long devices get to come to rest before threads and drivers end. Drivers brake by themselves after that.
const REST_WITHIN: Duration = Duration::from_secs(2);
/// How often it is looked whether they have.
const LOOK: Duration = Duration::from_millis(2);

impl Controller {
    /// Refuses to load and to start nets and to install rules from now on. What is under way goes on, rules that
    /// wait too: see [`Self::wind_down`].
    pub fn close(&self) {
        self.inner.lock().closing = true;
    }

    /// Brings nets to their end: those that do not run yet never will, and those that run are asked to cancel. To
    /// be called until it returns that all of them are over, as one may just be on its way.
    #[must_use = "it must be called again until all are over"]
    pub fn wind_down(&self, nets: &[NetId]) -> bool {
        let mut desk = self.inner.lock();
        desk.end_nets(nets, false);
        self.inner.announce(&desk);
        desk.are_over(nets)
    }

    /// Aborts and unloads all nets of a session and closes it.
    ///
    /// # Errors
    /// If there is no such session, or the net thread does not answer.
    pub fn end_session(&self, id: SessionId) -> Result<(), Error> {
        let nets = self
            .session_nets(id)
            .filter(|_| id != SessionId::NONE)
            .ok_or_else(|| Error::NoSuchSession(id.to_string()))?;
        // A net that another client unloaded meanwhile is what is wanted.
        let unless_gone = |result| match result {
            Ok(()) | Err(Error::NoSuchNet(_)) => Ok(()),
            Err(error) => Err(error),
        };
        // First those that wait: the end of one that runs may be what would start them.
        for net in &nets {
            let state = self.net(*net).map(|net| net.state());
            if let Some(NetState::Ready | NetState::Scheduled) = state {
                unless_gone(self.abort(*net))?;
            }
        }
        for net in nets {
            unless_gone(self.abort(net).and_then(|()| self.unload(net)))?;
        }
        self.inner.lock().sessions.remove(&id);
        Ok(())
    }

    /// Whether no device moves, as far as they are in contact.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.inner.lock().is_at_rest()
    }
}

impl Net {
    /// Whether it will never run any more.
    pub(super) fn is_over(&self) -> bool {
        match self.state() {
            NetState::Rejected | NetState::Terminated | NetState::Unloaded => true,
            NetState::Loading
            | NetState::Ready
            | NetState::Scheduled
            | NetState::Running
            | NetState::Cancelling => false,
        }
    }
}

impl Desk {
    /// An error if the controller is stopping.
    pub(super) const fn refuse_if_closing(&self) -> Result<(), Error> {
        if self.closing {
            return Err(Error::Closing);
        }
        Ok(())
    }

    /// An error if the controller is stopped.
    pub(super) fn refuse_if_stopped(&self) -> Result<(), Error> {
        if self.stop.switch().is_stopped() {
            return Err(self.stopped());
        }
        Ok(())
    }

    /// That the controller is stopped, or was, and by whom.
    pub(super) fn stopped(&self) -> Error {
        let by = self.stop.switch().last_stop();
        let by = by.map_or_else(|| "its stop channel".to_owned(), |(by, _)| by.to_string());
        Error::Stopped { by }
    }

    pub(super) fn is_at_rest(&self) -> bool {
        self.devices.all().all(|(_, device)| device.is_at_rest())
    }

    fn are_over(&self, nets: &[NetId]) -> bool {
        let mut known = nets.iter().filter_map(|id| self.nets.get(id));
        known.all(Net::is_over)
    }

    /// Ends nets, those that run by a cancel unless it is to be at once. What a net thread has no room for now is
    /// done the next time.
    fn end_nets(&mut self, nets: &[NetId], at_once: bool) {
        let state = |desk: &Self, id| desk.nets.get(id).map(Net::state);
        // First those that wait: the end of one that runs may be what would start them.
        for id in nets {
            if let Some(NetState::Ready | NetState::Scheduled) = state(self, id) {
                self.give_up(*id).ok();
            }
        }
        for id in nets {
            match state(self, id) {
                Some(NetState::Running) if !at_once => self.command(Command::Cancel(id.0)).ok(),
                Some(NetState::Running | NetState::Cancelling) if at_once => {
                    self.command(Command::Abort(id.0)).ok()
                }
                _ => None,
            };
        }
    }

    /// Ends a net that does not run, unless its thread has it: then it is asked for. Returns whether it is
    /// over.
    pub(super) fn give_up(&mut self, id: NetId) -> Result<bool, Error> {
        self.withdraw(id)?;
        let net = self.net(id)?;
        let is_here = !net.is_away();
        if is_here {
            net.end(NEVER_RAN.to_owned());
        }
        Ok(is_here)
    }

    /// Ends all threads. Nets end and devices come to rest while they still run; drivers go last.
    pub(super) fn stop(&mut self) {
        if self.threads.is_empty() {
            // That was done already.
            return;
        }
        self.closing = true;
        self.rest();
        self.threads.iter().for_each(NetThread::ask_to_stop);
        for thread in self.threads.drain(..) {
            thread.stop();
        }
        self.stop.switch().dismiss();
        self.drivers.iter().for_each(|driver| driver.ask_to_stop());
        for driver in self.drivers.drain(..) {
            drop(driver.stop());
        }
    }

    /// Aborts all nets and waits until no device moves, but not for ever.
    fn rest(&mut self) {
        let nets: Vec<_> = self.nets.keys().copied().collect();
        let until = Instant::now() + REST_WITHIN;
        loop {
            self.take_events();
            self.end_nets(&nets, true);
            // The nets of a thread that is dead never end.
            let over = self.are_over(&nets) || self.threads.iter().any(NetThread::is_dead);
            if over && self.is_at_rest() {
                return;
            }
            if Instant::now() >= until {
                self.tell_restless();
                return;
            }
            std::thread::sleep(LOOK);
        }
    }
}

impl Desk {
    /// Says what nobody waits for any longer.
    fn tell_restless(&self) {
        let moving = self
            .devices
            .all()
            .filter(|(_, device)| !device.is_at_rest());
        for (_, device) in moving {
            let (name, status) = (&device.name, device.status());
            tracing::warn!(device = name, %status, "still moves after {REST_WITHIN:?}; its driver is to brake it");
        }
        let running = self.nets.iter().filter(|(_, net)| !net.is_over());
        for (id, net) in running {
            tracing::warn!(net = %id, state = %net.state(), "did not end within {REST_WITHIN:?}");
        }
    }
}

impl Drop for Desk {
    /// Also a controller that could not be started ends what it did start.
    fn drop(&mut self) {
        self.stop();
    }
}
