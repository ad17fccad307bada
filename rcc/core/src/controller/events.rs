//! Applies the events of net threads to the registry, in the order of each thread.

use crate::controller::nets::Change;
use crate::controller::registry::Registry;
use crate::executor::thread::Event;
use crate::ids::NetId;

impl Registry {
    /// Applies the events of all net threads; returns whether there were any.
    pub(super) fn take_events(&mut self) -> bool {
        let mut any = false;
        for thread in 0..self.threads.len() {
            while let Some(event) = self.threads.next_event(thread) {
                any = true;
                self.handle(event);
            }
        }
        any
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Started(id) => self.started(NetId(id)),
            Event::Cancelling(id) => {
                self.nets.change(NetId(id), Change::Cancel);
            }
            Event::StartRejected(running, why) => self.start_rejected(running, why),
            Event::DeviceRemoved(end) => drop(end),
            Event::RuleAdded(id) => self.rule_added(id),
            Event::RuleRejected(rule, why) => self.rule_rejected(&rule, why),
            Event::RuleDone(rule) => self.rule_done(&rule),
            Event::Unscheduled(running) => self.unscheduled(running),
            Event::Ended(running, end) => self.ended(&running, end),
            Event::MachineAdded(id) => self.machines.added(id, Ok(())),
            Event::MachineRejected(hosted, why) => self.machines.added(hosted.id, Err(why)),
            Event::MachineAnswered(id, number, result) => {
                self.machines.answered(id, number, result);
            }
            Event::Configure(id, component) => self.machines.configure(id, component),
            Event::MachineStatus(id, status) => self.machines.report_status(id, status),
            Event::MachineRemoved(hosted) => self.machine_removed(hosted.id),
        }
    }
}
