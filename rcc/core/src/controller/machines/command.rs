//! Requests to machines: text commands are parsed and checked whole, then sent to the thread one after the other, which
//! answers each. A property that its thread does not hold, a text or an array, is set here.

use takt_machine::command::{self, Command as Text};
use takt_machine::component::Data;
use takt_machine::machine::Status;
use takt_machine::{Control, Value};

use crate::controller::Controller;
use crate::error::Error;
use crate::executor::machines::{MachineInput, SETTINGS_MAX};
use crate::executor::thread::Command;

/// Properties by number and value as one input.
pub(super) fn settings(component: usize, values: &[(usize, Value)]) -> MachineInput {
    let mut all = [(0, Value::Bool(false)); SETTINGS_MAX];
    for (slot, value) in all.iter_mut().zip(values) {
        *slot = *value;
    }
    MachineInput::Set(component, values.len().min(SETTINGS_MAX), all)
}

impl Controller {
    /// Changes the mode of a machine, or of one inside if `inner` names it.
    ///
    /// # Errors
    /// If there is no such machine, or its status does not allow it.
    pub fn control_machine(
        &self,
        name: &str,
        inner: Option<&str>,
        control: Control,
    ) -> Result<(), Error> {
        let target = inner.unwrap_or(name);
        self.command_machine(name, &format!("{target}.{}()", control.word()))
    }

    /// Activates a machine, unless it is active, and changes it to automatic mode.
    ///
    /// # Errors
    /// If there is no such machine, or its thread refuses.
    pub fn start_machine(&self, name: &str) -> Result<(), Error> {
        if self.machine(name)?.status() != Status::Active {
            self.control_machine(name, None, Control::Activate)?;
        }
        self.control_machine(name, None, Control::Start)
    }

    /// Executes text commands, such as `servo.gain := 2; generator.start()`, one after the other. All are checked before
    /// the first is executed; the first that is refused ends them.
    ///
    /// # Errors
    /// All errors of the text, or the command that was refused, with the cause.
    pub fn command_machine(&self, name: &str, text: &str) -> Result<(), Error> {
        let info = self.machine(name)?;
        let parsed = command::parse(text, &info.program);
        let commands = parsed
            .map_err(|found| Error::Machine(found.render("command", text).trim_end().to_owned()))?;
        for placed in commands {
            let request = text.get(placed.at).unwrap_or_default();
            self.execute(name, placed.command, request)?;
        }
        Ok(())
    }

    fn execute(&self, name: &str, command: Text, request: &str) -> Result<(), Error> {
        let input = match command {
            Text::Control(machine, control) => MachineInput::Control(machine, control),
            Text::Raise(event) => MachineInput::Raise(event),
            Text::Enter(machine, state) => MachineInput::Enter(machine, state),
            Text::Request(component, change) => MachineInput::Request(component, change),
            Text::Write(component, port, value) => MachineInput::Write(component, port, value),
            Text::Call(component, operation, values) => {
                if values.len() > SETTINGS_MAX {
                    return Err(too_many(request, "arguments"));
                }
                let mut all = [Value::Bool(false); SETTINGS_MAX];
                for (slot, value) in all.iter_mut().zip(&values) {
                    *slot = *value;
                }
                MachineInput::Call(component, operation, values.len(), all)
            }
            Text::Set(component, changes) => return self.set(name, component, changes, request),
        };
        let (id, _) = self.inner.lock().machines.find(name).map(|it| (it.0, ()))?;
        self.input(id, input, request)
    }

    /// Sets properties: all of them, or none.
    fn set(
        &self,
        name: &str,
        component: usize,
        changes: Vec<(String, Data)>,
        request: &str,
    ) -> Result<(), Error> {
        let refused = |why: String| Error::MachineRefused {
            request: request.to_owned(),
            why,
        };
        let mut registry = self.inner.lock();
        let (id, _) = registry.machines.find(name)?;
        registry.machines.keep_properties(id, component);
        let Some(loaded) = registry.machines.all.get_mut(&id) else {
            return Ok(());
        };
        let program = std::sync::Arc::clone(&loaded.program);
        let phase = loaded
            .view
            .read_with(|view| view.phases.get(component).copied());
        let member = program.members().get(component);
        let (Some(member), Some(phase)) = (member, phase) else {
            return Ok(());
        };
        let Some(part) = loaded.parts.get_mut(component) else {
            return Ok(());
        };
        let before = part.configuration.clone();
        let mut after = before.clone();
        let names: Vec<String> = changes.iter().map(|(name, _)| name.clone()).collect();
        let set = after.set(&member.component, phase, changes);
        set.map_err(|why| refused(why.to_string()))?;
        let properties = member.component.properties.iter().enumerate();
        let values = properties.zip(after.values());
        let values = values.filter(|((_, p), _)| names.contains(&p.declared.name));
        let single =
            values.filter_map(|((number, _), value)| Some((number, value.as_ref()?.value()?)));
        let single: Vec<_> = single.collect();
        if single.len() > SETTINGS_MAX {
            return Err(too_many(request, "properties"));
        }
        if single.len() < names.len() && !single.is_empty() && phase == takt_machine::Phase::Running
        {
            return Err(refused(
                "texts and arrays cannot change together with single values while the component runs\nhint: set \
                 them one after the other"
                    .to_owned(),
            ));
        }
        part.configuration = after;
        drop(registry);
        if single.is_empty() {
            return Ok(());
        }
        let done = self.input(id, settings(component, &single), request);
        if done.is_err() {
            // The state has changed meanwhile: nothing is set.
            let mut registry = self.inner.lock();
            let loaded = registry.machines.all.get_mut(&id);
            if let Some(part) = loaded.and_then(|loaded| loaded.parts.get_mut(component)) {
                part.configuration = before;
            }
        }
        done
    }

    /// Sends an input to the thread of a machine and waits for the answer.
    pub(super) fn input(&self, id: u32, input: MachineInput, request: &str) -> Result<(), Error> {
        let mut registry = self.inner.lock();
        let Some(thread) = registry.machines.all.get(&id).map(|loaded| loaded.thread) else {
            return Err(Error::MachineRefused {
                request: request.to_owned(),
                why: "the machine has ended\nhint: load it again".to_owned(),
            });
        };
        registry.machines.requests += 1;
        let number = registry.machines.requests;
        let command = Command::MachineInput(id, number, input);
        registry.threads.send(thread, command)?;
        registry.machines.answers.insert(number, None);
        let answer = self.inner.wait_for(registry, |registry| {
            *registry.machines.answers.get(&number)?
        });
        self.inner.lock().machines.answers.remove(&number);
        answer?.map_err(|why| Error::MachineRefused {
            request: request.to_owned(),
            why: why.to_string(),
        })
    }
}

fn too_many(request: &str, item: &str) -> Error {
    Error::MachineRefused {
        request: request.to_owned(),
        why: format!("it has more than {SETTINGS_MAX} {item}\nhint: use several commands"),
    }
}
