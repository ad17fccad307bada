//! Shutdown: nothing starts any more, nets end, devices stop moving, and only then do threads end.
//! Drivers brake their devices.

use std::time::{Duration, Instant};

use crate::controller::Controller;
use crate::controller::nets::Net;
use crate::controller::registry::Registry;
use crate::executor::thread::{Command, NetThread};
use crate::ids::{NetId, NetState};

/// Grace period for devices to stop moving before threads and drivers end. Drivers brake by themselves after it.
const REST_TIMEOUT: Duration = Duration::from_secs(2);
/// Interval at which this is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

impl Controller {
    /// Rejects loading and starting of nets and new rules from now on. Running nets and waiting rules
    /// continue: see [`Self::wind_down`].
    pub fn close(&self) {
        self.inner.lock().permission.close();
    }

    /// Ends nets: those that do not run yet never will, running ones are requested to cancel. To
    /// be called until it returns that all of them have ended, as a net may be in transfer to its thread.
    #[must_use = "it must be called again until all have ended"]
    pub fn wind_down(&self, nets: &[NetId]) -> bool {
        let mut registry = self.inner.lock();
        registry.end_machines_of(nets, false);
        // Components of a machine on the way to its final state are that machine's.
        let others = nets.iter().filter(|net| !registry.is_stopping(**net));
        let others: Vec<NetId> = others.copied().collect();
        registry.end_nets(&others, false);
        self.inner.announce(&registry);
        registry.nets.are_over(nets)
    }

    /// Whether no reachable device moves.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.inner.lock().is_at_rest()
    }
}

impl Registry {
    fn is_at_rest(&self) -> bool {
        self.devices.moving().next().is_none()
    }

    /// Ends nets, running ones by a cancel unless `at_once`. What does not fit in a net thread's queue is
    /// sent at the next call.
    fn end_nets(&mut self, nets: &[NetId], at_once: bool) {
        let state = |registry: &Self, id: NetId| registry.nets.get(id).map(Net::state);
        // Waiting nets first: the end of a running net could start them.
        for id in nets {
            if let Some(NetState::Ready | NetState::Scheduled) = state(self, *id) {
                self.give_up(*id).ok();
            }
        }
        for id in nets {
            match state(self, *id) {
                Some(NetState::Running) if !at_once => self.command(Command::Cancel(id.0)).ok(),
                Some(NetState::Running | NetState::Cancelling) if at_once => {
                    self.command(Command::Abort(id.0)).ok()
                }
                _ => None,
            };
        }
    }

    /// Ends all threads. Nets end and devices stop moving while threads still run; drivers end last.
    pub(super) fn stop(&mut self) {
        if self.threads.len() == 0 {
            // Already stopped.
            return;
        }
        self.permission.close();
        self.rest();
        self.threads.stop();
        self.permission.switch().unregister_all();
        self.devices.stop();
    }

    /// Aborts all nets and waits until no device moves, at most [`REST_TIMEOUT`].
    fn rest(&mut self) {
        let nets: Vec<_> = self.nets.iter().map(|(id, _)| id).collect();
        let until = Instant::now() + REST_TIMEOUT;
        self.end_machines_of(&nets, true);
        loop {
            self.take_events();
            self.end_nets(&nets, true);
            // The nets of a dead thread never end.
            let over = self.nets.are_over(&nets) || self.threads.iter().any(NetThread::is_dead);
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

    /// Logs devices that still move and nets that still run when the timeout expires.
    fn log_unfinished(&self) {
        for device in self.devices.moving() {
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
