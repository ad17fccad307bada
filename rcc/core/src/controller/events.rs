//! Applies the events of net threads to the registry, in the order of each thread.

use crate::controller::net::Net;
use crate::controller::registry::Registry;
use crate::controller::threads::busy;
use crate::device::{Device, DeviceStatus};
use crate::error::Error;
use crate::executor::figures::RUNAWAY_AFTER;
use crate::executor::thread::{Command, Event};
use crate::executor::{End, Refusal, Running};
use crate::ids::{NetId, NetState};

impl Registry {
    /// Applies the events of all net threads; returns whether there were any.
    pub(super) fn take_events(&mut self) -> bool {
        let mut any = false;
        for thread in 0..self.threads.len() {
            while let Some(event) = self.threads[thread].events.pop() {
                any = true;
                self.handle(event);
            }
        }
        any
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Started(id) => self.with(id, Net::started),
            Event::Cancelling(id) => self.with(id, |net| {
                if net.state() == NetState::Running {
                    net.enter(NetState::Cancelling);
                }
            }),
            Event::Refused(running, refusal) => self.refused(running, refusal),
            Event::DeviceRemoved(end) => drop(end),
            Event::RuleAdded(id) => self.rule_added(id),
            Event::RuleRefused(rule, why) => self.rule_refused(&rule, why),
            Event::RuleDone(rule) => self.rule_done(&rule),
            Event::Unscheduled(running) => self.unscheduled(running),
            Event::Ended(running, end) => self.ended(&running, end),
        }
    }

    fn with(&mut self, id: u32, change: impl FnOnce(&mut Net)) {
        if let Some(net) = self.nets.get_mut(&NetId(id)) {
            change(net);
        }
    }

    fn ended(&mut self, running: &Running, end: End) {
        let why = self.end_text(running, end);
        if let (Some(why), End::DeviceFault(_) | End::Runaway) = (&why, end) {
            tracing::warn!(net = %NetId(running.id), why, "net ended");
        }
        self.with(running.id, |net| net.ended(why));
        self.answer_rules(NetId(running.id));
    }

    /// A net was returned by the rules. If a direct start is pending, the net is sent again.
    fn unscheduled(&mut self, running: Box<Running>) {
        let id = running.id;
        let Some(net) = self.nets.get_mut(&NetId(id)) else {
            return;
        };
        if !net.is_to_start() {
            net.take_back(running, None);
            return;
        }
        net.leave_rules();
        let thread = net.thread;
        if let Err(Command::Start(running)) = self.send(thread, Command::Start(running)) {
            self.with(id, |net| net.take_back(running, Some(busy())));
        }
    }

    fn refused(&mut self, running: Box<Running>, refusal: Refusal) {
        let net = NetId(running.id);
        let error = match refusal {
            Refusal::Halted => self.stopped(),
            Refusal::TooMany => Error::TooMany {
                what: "running nets",
                bound: crate::executor::RUNNING_MAX,
            },
            Refusal::ResourceKept(number) => Error::ResourceKept {
                net,
                resource: self.resource_name(number),
            },
            Refusal::ResourceInUse(number) => Error::ResourceInUse {
                net,
                resource: self.resource_name(number),
            },
            Refusal::DeviceNotReady(number) => {
                let arm = self.devices.get(number);
                Error::DeviceNotReady {
                    net,
                    device: arm.map_or_else(|| format!("device {number}"), |a| a.name.clone()),
                    status: self.status_text(arm.map(|arm| &**arm)),
                }
            }
            Refusal::Overload { running, budget } => {
                let [running, budget] =
                    [running, budget].map(|time| time.try_into().unwrap_or_default());
                self.overload(net, running, budget)
            }
        };
        self.with(running.id, |net| net.take_back(running, Some(error)));
    }

    /// The reason why a net ended, unless it terminated by itself.
    fn end_text(&self, net: &Running, end: End) -> Option<String> {
        match end {
            End::Terminated => None,
            End::Aborted => Some("aborted".to_owned()),
            End::Halted => {
                let by = self.stop.switch().last_stop();
                let by = by.map(|(by, _)| format!(" by {by}"));
                Some(format!("stopped{}: takt stop", by.unwrap_or_default()))
            }
            End::Stopped => Some("stopped by a rule".to_owned()),
            End::Runaway => {
                let longest = net.counters().read().max;
                let thread = self.threads.get(self.thread_of(net.id));
                let period = thread.map_or_else(|| net.plan.period(), |thread| thread.period);
                Some(format!(
                    "took longer than the {period:?} between two cycles of its thread, {RUNAWAY_AFTER} times \
                     in a row, up to {longest:?}; make it smaller or load it for a slower net thread"
                ))
            }
            End::DeviceFault(number) => {
                let arm = self.devices.get(number);
                let name = arm.map_or("?", |a| a.name.as_str());
                let status = self.status_text(arm.map(|arm| &**arm));
                Some(format!(
                    "device {name} stopped following commands and is {status}"
                ))
            }
        }
    }

    fn status_text(&self, device: Option<&Device>) -> String {
        let status = device.map_or(DeviceStatus::Offline, Device::status);
        if self.stop.is_on(takt_rt::monotonic()) {
            let status = status.under(true);
            if self.stop.switch().is_stopped() {
                return format!("{status}: {}", self.stopped());
            }
            format!("{status}: the emergency stop is on")
        } else {
            status.to_string()
        }
    }
}
