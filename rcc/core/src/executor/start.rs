//! Starts of nets in their thread: by a request, which is checked here, or by a rule or a recording, which were
//! checked before. The file before this one on the path of a start is [`super::thread`].

use takt_rt::Nanos;

use super::life::Life;
use super::{BUCKETS, Executor, RUNNING_MAX, ResourceSet, Running, StartError};

impl Executor {
    /// Starts a net. It is evaluated from the next [`Self::cycle`] on.
    ///
    /// # Errors
    /// If it cannot run now; the net comes back with the reason.
    pub fn start(&mut self, mut net: Box<Running>) -> Result<(), (Box<Running>, StartError)> {
        if !self.has_capacity(self.going_on().count(), 1) {
            return Err((net, StartError::TooMany));
        }
        if let Some(error) = self.blocked(&net) {
            return Err((net, error));
        }
        for i in 0..net.devices.len() {
            let number = net.devices[i].0;
            let view = self.devices.get(number).copied().unwrap_or_default();
            if !view.is_ready() {
                return Err((net, StartError::DeviceNotReady(number)));
            }
            net.devices[i].1 = view.faults;
        }
        self.running.push(net);
        Ok(())
    }

    /// Whether `RUNNING_MAX` permits so many more nets beside so many.
    pub(super) fn has_capacity(&self, going_on: usize, more: usize) -> bool {
        going_on + more <= RUNNING_MAX && self.running.len() + more <= BUCKETS
    }

    /// Resources held by running nets.
    pub(super) fn held(&self) -> ResourceSet {
        let mut held = ResourceSet::default();
        for net in &self.running {
            held.add(&net.resources);
        }
        self.hosted().for_each(|hosted| held.add(&hosted.resources));
        held
    }

    /// Starts a net that was admitted before. Until its first cycle it keeps the commands of nets
    /// that end as it starts.
    pub fn start_by_rule(&mut self, mut net: Box<Running>) {
        net.life = Life::Succeeding;
        self.start_checked(net);
    }

    /// Starts a net that was admitted before, without takeover.
    pub fn start_checked(&mut self, mut net: Box<Running>) {
        for device in &mut net.devices {
            device.1 = self.devices.get(device.0).map_or(0, |view| view.faults);
        }
        self.running.push(net);
    }

    /// Why a net cannot start now beside running and scheduled nets.
    fn blocked(&mut self, net: &Running) -> Option<StartError> {
        let held = self.held();
        if let Some(resource) = net.resources.common(&held) {
            return Some(StartError::ResourceInUse(resource));
        }
        let (running, budget) = (self.load(), self.budget);
        if running + net.cost > budget {
            return Some(StartError::Overload { running, budget });
        }
        let kept = self.rules.kept_from(net, &self.running);
        kept.map(StartError::ResourceKept)
    }

    /// Cost of all running nets in a cycle in which each is evaluated.
    pub(super) fn load(&self) -> Nanos {
        let nets = self.going_on().filter(|net| net.seat.is_none());
        let machines = self.hosted().map(|hosted| hosted.cost);
        nets.map(|net| net.cost)
            .chain(machines)
            .fold(Nanos::ZERO, |sum, cost| sum + cost)
    }
}
