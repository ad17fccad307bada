//! Machines as viewers see them: a message for each change of a state or a status, of a machine and of those inside.

use std::sync::Arc;

use takt_machine::Program;

use super::{Messages, Sink, Stamp, schemas};
use crate::error::Error;
use crate::record::words::machine_state;

/// A machine with those inside.
#[derive(Debug)]
pub(super) struct MachineTopic {
    program: Arc<Program>,
    /// The last words of their states.
    shown: Vec<u64>,
}

impl Messages {
    /// A machine was loaded.
    pub(in crate::record) fn machine(&mut self, id: u32, program: &Arc<Program>) {
        let shown = vec![0; program.machines().count()];
        let program = Arc::clone(program);
        self.machines.insert(id, MachineTopic { program, shown });
    }

    /// A machine is unloaded.
    pub(in crate::record) fn machine_gone(&mut self, id: u32) {
        self.machines.remove(&id);
    }

    /// The outermost machine was added to its thread, or removed from it.
    pub(super) fn machine_event(
        &mut self,
        to: &mut impl Sink,
        (cycle, machine): (u64, u32),
        event: &str,
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(topic) = self.machines.get(&machine) else {
            return Ok(());
        };
        let name = topic.program.name().to_owned();
        if event == "removed" {
            self.machines.remove(&machine);
        }
        self.write_machine(to, (cycle, &name), [event, "", "inactive"], at)
    }

    /// The state of a machine, or of one inside, has changed.
    pub(super) fn changed(
        &mut self,
        to: &mut impl Sink,
        (cycle, machine): (u64, u32),
        (number, word): (usize, u64),
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(topic) = self.machines.get(&machine) else {
            return Ok(());
        };
        let program = Arc::clone(&topic.program);
        let Some(name) = program.machines().nth(number) else {
            return Ok(());
        };
        self.write_change(to, (cycle, name), (&program, number, word), at)
    }

    fn write_change(
        &mut self,
        to: &mut impl Sink,
        machine: (u64, &str),
        (program, number, word): (&Program, usize, u64),
        at: Stamp,
    ) -> Result<(), Error> {
        let (status, state) = machine_state(word);
        let state = state.and_then(|state| program.states(number).nth(state));
        let texts = ["changed", state.unwrap_or_default(), status.word()];
        self.write_machine(to, machine, texts, at)
    }

    /// A machine was stepped.
    pub(super) fn stepped(
        &mut self,
        to: &mut impl Sink,
        (cycle, machine): (u64, u32),
        states: &[u64],
        at: Stamp,
    ) -> Result<(), Error> {
        let Some(mut topic) = self.machines.remove(&machine) else {
            return Ok(());
        };
        let MachineTopic { program, shown } = &mut topic;
        let mut names = program.machines().zip(shown).zip(states).enumerate();
        let result = names.try_for_each(|(number, ((name, shown), word))| {
            if std::mem::replace(shown, *word) == *word {
                return Ok(());
            }
            self.write_change(to, (cycle, name), (program, number, *word), at)
        });
        drop(names);
        self.machines.insert(machine, topic);
        result
    }

    fn write_machine(
        &mut self,
        to: &mut impl Sink,
        (cycle, machine): (u64, &str),
        texts: [&str; 3],
        at: Stamp,
    ) -> Result<(), Error> {
        let topic = "/takt/machine_events";
        let channel = self.topics.channel(to, topic, &schemas::MACHINE_EVENT)?;
        if !to.wants(channel) {
            return Ok(());
        }
        let cdr = at.write(self.topics.cdr.begin()).u64(cycle).text(machine);
        texts.iter().fold(cdr, |cdr, text| cdr.text(text));
        to.message(channel, self.topics.cdr.bytes(), at)
    }
}
