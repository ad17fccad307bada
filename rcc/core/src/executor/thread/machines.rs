//! The machines of a net thread: their commands, their steps, and what they report.

use takt_net::Moment;

use super::{Command, Cycle, Event};
use crate::executor::StartError;
use crate::executor::machines::{InputError, MachineEvent, MachineInput};

impl Cycle {
    pub(super) fn handle_machine_command(&mut self, command: Command) {
        match command {
            Command::AddMachine(hosted) => {
                let id = hosted.id;
                if !self.served.stop().permits(hosted.requested) {
                    return self.report(Event::MachineRejected(hosted, StartError::Halted));
                }
                match self.executor.add_machine(hosted) {
                    Ok(()) => {
                        self.journal.machine_added(id);
                        self.report(Event::MachineAdded(id));
                    }
                    Err((hosted, why)) => self.report(Event::MachineRejected(hosted, why)),
                }
            }
            Command::Seat(net, fresh) => {
                self.journal.seated(&net, fresh);
                if let Err(net) = self.executor.seat(net, fresh) {
                    self.report(Event::Unscheduled(net));
                }
            }
            Command::SeatFailed(machine, component) => {
                self.journal.seat_failed(machine, component);
                self.executor.seat_failed(machine, component);
            }
            Command::MachineInput(machine, number, input) => {
                let result = self.machine_input(machine, &input);
                self.report(Event::MachineAnswered(machine, number, result));
            }
            Command::RemoveMachine(id) => {
                if let Some(hosted) = self.executor.remove_machine(id) {
                    self.journal.machine_removed(id);
                    self.report(Event::MachineRemoved(hosted));
                }
            }
            Command::Start(_)
            | Command::StartScheduled(_)
            | Command::Cancel(_)
            | Command::Abort(_)
            | Command::Schedule(_)
            | Command::AddRule(_)
            | Command::Answer(_)
            | Command::Unschedule { .. }
            | Command::Forget(_)
            | Command::AddDevice(_)
            | Command::RemoveDevice(_) => {}
        }
    }

    fn machine_input(&mut self, machine: u32, input: &MachineInput) -> Result<(), InputError> {
        let loaded = self.executor.machine_generation(machine);
        let loaded = loaded.ok_or(InputError::Unknown)?;
        if !self.served.stop().permits(loaded) {
            return Err(InputError::Halted);
        }
        self.journal.machine_input(machine, input);
        self.executor.machine_input(machine, input)
    }

    /// One step of each machine, after the nets of this cycle.
    pub(super) fn step_machines(&mut self, moment: Moment) {
        let Self {
            executor,
            journal,
            clock,
            ..
        } = self;
        executor.step_machines(moment, clock, |hosted| journal.stepped(hosted));
    }

    /// Reports what machines request, return and changed.
    pub(super) fn report_machines(&mut self) {
        let Self {
            executor, events, ..
        } = self;
        executor.machine_events(|id, event| {
            let event = match event {
                MachineEvent::Configure(component) => Event::Configure(id, component),
                MachineEvent::Returned(net) => Event::Unscheduled(net),
                MachineEvent::Status(status) => Event::MachineStatus(id, status),
            };
            let pushed = events.push(event);
            debug_assert!(pushed.is_ok(), "more events than requests");
        });
    }
}
