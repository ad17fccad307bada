//! `/machines/` and below: lists, loads, shows, draws and commands state machines.

use std::time::Duration;

use takt_core::Error;
use takt_core::controller::{MachineInfo, MachineRequest};
use takt_core::machine::Control;

use super::super::Response;
use super::super::element::Element;
use super::nets::ms;
use super::{Handler, Outcome};

impl Handler<'_> {
    pub(super) fn machines(&self) -> Response {
        let machines = self.controller.machines();
        let machines = machines
            .iter()
            .map(|info| summary(info).containing(inside(info).skip(1)));
        self.show(&Element::new("machines").containing(machines))
    }

    /// Loads a machine: `text`, `file.NAME` for each component file, `param.NAME` and `properties.COMPONENT`.
    pub(super) fn load_machine(&self) -> Outcome {
        let text = self
            .field("text")
            .ok_or_else(|| Response::bad_request("a machine is required: text=<machine>"))?;
        let named = |prefix: &str| -> Vec<(String, String)> {
            let form = self.request.form.iter();
            let found = form.filter_map(|(key, value)| {
                Some((key.strip_prefix(prefix)?.to_owned(), value.clone()))
            });
            found.collect()
        };
        let request = MachineRequest {
            text: text.to_owned(),
            files: named("file."),
            session: 0,
            parameters: named("param."),
            properties: named("properties."),
        };
        let name = self.controller.load_machine(&request);
        let name = name.map_err(Response::conflict)?;
        Ok(Response::redirect(
            "302 Found",
            &format!("/machines/{name}/"),
        ))
    }

    pub(super) fn machine(&self, name: &str) -> Outcome {
        let info = self.controller.machine(name).map_err(Response::not_found)?;
        let (program, view) = (&info.program, &info.view);
        let members = program.members().iter().zip(&view.phases).zip(&view.nets);
        let members = members.map(|((member, phase), net)| {
            let net = net.map(|net| format!("/nets/{}/", takt_core::NetId(net)));
            let operations = member.component.operations.iter().map(|operation| {
                let arguments = operation.arguments.iter().map(|it| it.name.as_str());
                Element::new("operation")
                    .with("name", &operation.name)
                    .with("arguments", arguments.collect::<Vec<_>>().join(" "))
            });
            Element::new("component")
                .with("name", &member.name)
                .with("phase", phase.word())
                .with("net", net.unwrap_or_default())
                .containing(operations)
        });
        let events = program.events().iter();
        let events = events.map(|name| Element::new("event").with("name", name));
        let variables = program.variables().iter().zip(&view.variables);
        let variables = variables.map(|(variable, value)| {
            Element::new("variable")
                .with("name", &variable.name)
                .value(value.to_string())
        });
        let figures = Element::new("figures")
            .with("steps", view.steps)
            .with("transitions", view.transitions)
            .with(
                "longest",
                ms(Duration::try_from(view.longest).unwrap_or_default()),
            )
            .with("step", ms(info.cost.step))
            .with("components", ms(info.cost.components));
        let element = summary(&info).containing(inside(&info)).containing(members);
        let element = element
            .containing(variables)
            .containing([figures])
            .containing(events);
        Ok(self.show(&element))
    }

    /// The text of a machine, its picture with the present state, or the properties of a component.
    pub(super) fn machine_part(&self, name: &str, part: &[&str]) -> Outcome {
        let info = self.controller.machine(name).map_err(Response::not_found)?;
        match part {
            ["text"] => Ok(Response::text("200 OK", &*info.text)),
            ["graph"] => graph(&info, None),
            ["graph", inside] => graph(&info, Some(inside)),
            ["properties", component] => {
                let file = self.controller.machine_properties(name, component);
                let file = file.map_err(Response::not_found)?;
                Ok(Response::text("200 OK", file.to_toml()))
            }
            _ => Err(Response::not_found(
                "a machine has text, graph, graph/MACHINE and properties/COMPONENT",
            )),
        }
    }

    /// Executes the text commands of `command`, then `action`.
    pub(super) fn control_machine(&self, name: &str) -> Outcome {
        let controller = self.controller;
        controller.machine(name).map_err(Response::not_found)?;
        if let Some(text) = self.field("command") {
            controller
                .command_machine(name, text)
                .map_err(error_response)?;
        }
        let done = match self.field("action") {
            None => Ok(()),
            Some("START") => controller.start_machine(name),
            Some("STOP") => controller.control_machine(name, None, Control::Stop),
            Some("STEP") => controller.control_machine(name, None, Control::Step),
            Some("PAUSE") => controller.control_machine(name, None, Control::Pause),
            Some("END") => controller.end_machine(name),
            Some(_) => {
                let text = "action: START, STOP, STEP, PAUSE or END is expected";
                return Err(Response::bad_request(text));
            }
        };
        done.map_err(error_response)?;
        let location = match controller.machine(name) {
            Ok(_) => format!("/machines/{name}/"),
            Err(_) => "/machines/".to_owned(),
        };
        Ok(Response::redirect("303 See Other", &location))
    }
}

fn summary(info: &MachineInfo) -> Element {
    Element::new("machine")
        .with("uri", format!("/machines/{}/", info.name))
        .with("name", &info.name)
        .with("session", info.session)
        .with("status", info.status().word())
        .with("state", info.state())
        .with("error", info.failure(0).unwrap_or_default())
}

/// The states of the outermost machine and of those inside, in the order of the text.
fn inside(info: &MachineInfo) -> impl Iterator<Item = Element> {
    let program = &info.program;
    let machines = program.machines().zip(&info.view.machines).enumerate();
    machines.map(|(number, (name, state))| {
        let place = state.state.and_then(|it| program.states(number).nth(it));
        // Not called `state`, as is the attribute of the whole machine: JSON has one of a name.
        let element = Element::new("machine")
            .with("name", name)
            .with("status", state.status.word())
            .with("mode", state.mode.word())
            .with("paused", state.is_paused.to_string())
            .with("state", place.unwrap_or_default());
        element.text(info.failure(number).unwrap_or_default())
    })
}

fn graph(info: &MachineInfo, inside: Option<&str>) -> Outcome {
    info.graph(inside)
        .map(|graph| Response::of_kind("image/svg+xml", graph.svg()))
        .ok_or_else(|| Response::not_found("there is no machine of that name inside"))
}

fn error_response(error: Error) -> Response {
    if matches!(error, Error::Machine(_)) {
        Response::bad_request(error)
    } else {
        Response::conflict(error)
    }
}
