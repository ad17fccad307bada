//! Commands about state machines: `mane` loads, `maco` commands, `main` describes, `magr` draws, `maen` ends one. Not part
//! of the original protocol.

use std::collections::BTreeMap;

use takt_client::wire::Value;
use takt_core::SessionId;
use takt_core::controller::{MachineInfo, MachineRequest};

use super::Connection;
use super::args::Args;
use super::commands::Outcome;
use super::error::CommandError;

impl Connection {
    /// `mane(text, files, session, parameters, properties)`: loads a machine; the reply is its name.
    pub(super) fn load_machine(&self, args: Args<'_>) -> Outcome {
        let texts = |number: usize| -> Result<Vec<(String, String)>, CommandError> {
            let map = args.optional(number, Args::map)?;
            let pairs = map.into_iter().flatten();
            let text = |(key, value): (&String, &Value)| {
                let value = value.as_str().ok_or(CommandError::ParameterType)?;
                Ok((key.clone(), value.to_owned()))
            };
            pairs.map(text).collect()
        };
        let session = match args.optional(2, Args::text)? {
            None => SessionId::NONE,
            Some(name) => self
                .known_session(name)
                .ok_or(CommandError::InvalidSession)?,
        };
        let request = MachineRequest {
            text: args.text(0)?.to_owned(),
            files: texts(1)?,
            session: session.0,
            parameters: texts(3)?,
            properties: texts(4)?,
        };
        Ok(vec![self.controller.load_machine(&request)?.into()])
    }

    /// `maco(machine, commands)`: executes text commands; `start` alone activates a machine and starts it.
    pub(super) fn command_machine(&self, args: Args<'_>) -> Outcome {
        let (name, text) = (args.text(0)?, args.text(1)?);
        if text == "start" {
            self.controller.start_machine(name)?;
        } else {
            self.controller.command_machine(name, text)?;
        }
        Ok(Vec::new())
    }

    /// `main([machine])`: a map by machine.
    pub(super) fn describe_machines(&self, args: Args<'_>) -> Outcome {
        let infos = match args.optional(0, Args::text)? {
            Some(name) => vec![self.controller.machine(name)?],
            None => self.controller.machines(),
        };
        let machines = infos.iter().map(|info| (info.name.clone(), describe(info)));
        Ok(vec![Value::map_of(machines)])
    }

    /// `magr(machine[, machine inside])`: its SVG with the present state.
    pub(super) fn draw_machine(&self, args: Args<'_>) -> Outcome {
        let info = self.controller.machine(args.text(0)?)?;
        let inside = args.optional(1, Args::text)?;
        let graph = info.graph(inside).ok_or(CommandError::InvalidMachine)?;
        Ok(vec![graph.svg().into()])
    }

    /// `maen(machine)`: ends a machine where it is, with its components.
    pub(super) fn end_machine(&self, args: Args<'_>) -> Outcome {
        self.controller.end_machine(args.text(0)?)?;
        Ok(Vec::new())
    }
}

fn describe(info: &MachineInfo) -> Value {
    let (program, view) = (&info.program, &info.view);
    let micros = |time: std::time::Duration| format!("{}", time.as_secs_f64() * 1e6);
    let inside = program.machines().zip(&view.machines).enumerate();
    let inside = inside.map(|(number, (name, state))| {
        let place = state.state.and_then(|it| program.states(number).nth(it));
        let values = [
            ("status", state.status.word().to_owned()),
            ("mode", state.mode.word().to_owned()),
            ("paused", state.is_paused.to_string()),
            ("state", place.unwrap_or("-").to_owned()),
            ("error", info.failure(number).unwrap_or_default()),
        ];
        (name.to_owned(), Value::map_of(values))
    });
    let members = program.members().iter().zip(&view.phases).zip(&view.nets);
    let members = members.map(|((member, phase), net)| {
        let net = net.map(|net| takt_core::NetId(net).to_string());
        let values = [
            ("phase", phase.word().to_owned()),
            ("net", net.unwrap_or_default()),
        ];
        (member.name.clone(), Value::map_of(values))
    });
    let variables = program.variables().iter().zip(&view.variables);
    let variables = variables.map(|(variable, value)| (variable.name.clone(), value.to_string()));
    let texts = [
        ("status", info.status().word().to_owned()),
        ("state", info.state().to_owned()),
        ("session", info.session.to_string()),
        ("error", info.failure(0).unwrap_or_default()),
        ("steps", view.steps.to_string()),
        ("transitions", view.transitions.to_string()),
        (
            "longest_step_us",
            micros(view.longest.try_into().unwrap_or_default()),
        ),
        ("step_cost_us", micros(info.cost.step)),
        ("components_cost_us", micros(info.cost.components)),
    ];
    let mut all: BTreeMap<String, Value> = texts
        .into_iter()
        .map(|(key, text)| (key.to_owned(), text.into()))
        .collect();
    all.insert("machines".to_owned(), Value::map_of(inside));
    all.insert("components".to_owned(), Value::map_of(members));
    all.insert("variables".to_owned(), Value::map_of(variables));
    Value::Map(all)
}
