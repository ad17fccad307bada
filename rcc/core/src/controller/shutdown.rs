//! Shutdown: nothing starts any more, nets end, devices stop moving, and only then do threads end.
//! Drivers brake their devices.

use std::time::{Duration, Instant};

use crate::controller::net::Net;
use crate::controller::registry::Registry;
use crate::controller::{Controller, NEVER_RAN, NetId, NetState, SessionId};
use crate::error::Error;
use crate::executor::thread::{Command, NetThread};

/// Grace period for devices to stop moving before threads and drivers end. Drivers brake by themselves after it.
const REST_TIMEOUT: Duration = Duration::from_secs(2);
/// Interval at which this is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

impl Controller {
    /// Rejects loading and starting of nets and new rules from now on. Running nets and waiting rules
    /// continue: see [`Self::wind_down`].
    pub fn close(&self) {
        self.inner.lock().closing = true;
    }

    /// Ends nets: those that do not run yet never will, running ones are requested to cancel. To
    /// be called until it returns that all of them have ended, as a net may be in transfer to its thread.
    #[must_use = "it must be called again until all have ended"]
    pub fn wind_down(&self, nets: &[NetId]) -> bool {
        let mut registry = self.inner.lock();
        registry.end_nets(nets, false);
        self.inner.announce(&registry);
        registry.are_over(nets)
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
        self.inner.lock().sessions.remove(&id);
        Ok(())
    }

    /// Whether no reachable device moves.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.inner.lock().is_at_rest()
    }
}

impl Net {
    /// Whether it has ended for good.
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

impl Registry {
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

    /// The error that the controller is or was stopped, with the source of the stop.
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

    /// Ends nets, running ones by a cancel unless `at_once`. What does not fit in a net thread's queue is
    /// sent at the next call.
    fn end_nets(&mut self, nets: &[NetId], at_once: bool) {
        let state = |registry: &Self, id| registry.nets.get(id).map(Net::state);
        // Waiting nets first: the end of a running net could start them.
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

    /// Ends a net that does not run, unless its thread holds it: then it is requested back. Returns whether it has
    /// ended.
    pub(super) fn give_up(&mut self, id: NetId) -> Result<bool, Error> {
        self.withdraw(id)?;
        let net = self.net(id)?;
        let is_here = !net.is_away();
        if is_here {
            net.end(NEVER_RAN.to_owned());
        }
        Ok(is_here)
    }

    /// Ends all threads. Nets end and devices stop moving while threads still run; drivers end last.
    pub(super) fn stop(&mut self) {
        if self.threads.is_empty() {
            // Already stopped.
            return;
        }
        self.closing = true;
        self.rest();
        self.threads.iter().for_each(NetThread::request_stop);
        for thread in self.threads.drain(..) {
            thread.stop();
        }
        self.stop.switch().unregister_all();
        self.drivers.iter().for_each(|driver| driver.ask_to_stop());
        for driver in self.drivers.drain(..) {
            drop(driver.stop());
        }
    }

    /// Aborts all nets and waits until no device moves, at most [`REST_TIMEOUT`].
    fn rest(&mut self) {
        let nets: Vec<_> = self.nets.keys().copied().collect();
        let until = Instant::now() + REST_TIMEOUT;
        loop {
            self.take_events();
            self.end_nets(&nets, true);
            // The nets of a dead thread never end.
            let over = self.are_over(&nets) || self.threads.iter().any(NetThread::is_dead);
            if over && self.is_at_rest() {
                return;
            }
            if Instant::now() >= until {
                self.log_unfinished();
                return;
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }
}

impl Registry {
    /// Logs devices that still move and nets that still run when the timeout expires.
    fn log_unfinished(&self) {
        let moving = self
            .devices
            .all()
            .filter(|(_, device)| !device.is_at_rest());
        for (_, device) in moving {
            let (name, status) = (&device.name, device.status());
            tracing::warn!(device = name, %status, "still moves after {REST_TIMEOUT:?}; its driver brakes it");
        }
        let running = self.nets.iter().filter(|(_, net)| !net.is_over());
        for (id, net) in running {
            tracing::warn!(net = %id, state = %net.state(), "did not end within {REST_TIMEOUT:?}");
        }
    }
}

impl Drop for Registry {
    /// Also stops what a controller had started whose start failed.
    fn drop(&mut self) {
        self.stop();
    }
}
