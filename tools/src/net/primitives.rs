//! `takt net primitives`: what the registry knows of primitives. Those that a controller of another
//! version knows are not asked for.

use clap::Args;
use serde_json::json;
use takt_net::definition::{InPort, Parameter, ParameterType};
use takt_net::{Definition, Element, Quantity, Registry, Type};

use crate::Verdict;
use crate::output::{complain, say};

/// Show primitives.
#[derive(Debug, Args)]
pub(crate) struct Primitives {
    /// Full name of one, such as Core::DoubleAdd, or a part of the names of several.
    name: Option<String>,
    /// Print one JSON array, with all ports and parameters.
    #[arg(long)]
    json: bool,
}

impl Primitives {
    pub(super) fn run(self) -> anyhow::Result<Verdict> {
        let registry = takt_core::registry();
        let name = self.name.as_deref().unwrap_or_default();
        let found = find(&registry, name);
        if self.json {
            let found: Vec<_> = found.iter().map(|d| as_json(d)).collect();
            say(&serde_json::Value::from(found).to_string())?;
        } else if let [one] = *found {
            say(text(one).trim_end())?;
        } else {
            let names = found.iter().map(|definition| definition.name.len());
            let width = names.max().unwrap_or_default();
            for definition in &found {
                say(&line(definition, width))?;
            }
        }
        if !found.is_empty() {
            return Ok(Verdict::Good);
        }
        let similar = registry.similar(name);
        let hint = similar.map_or_else(String::new, |s| format!("; did you mean {s}?"));
        complain(&format!("no primitive is called `{name}`{hint}"));
        Ok(Verdict::Failed)
    }
}

/// The one of that name, or all whose name contains it, by name.
fn find<'r>(registry: &'r Registry, name: &str) -> Vec<&'r Definition> {
    if let Some(definition) = registry.find(name) {
        return vec![definition];
    }
    let lower = name.to_lowercase();
    let all = registry.definitions().iter();
    let mut found: Vec<_> = all
        .filter(|d| d.name.to_lowercase().contains(&lower))
        .collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

fn type_name(ty: ParameterType) -> String {
    match ty {
        ParameterType::Text => "text".to_owned(),
        ParameterType::Value(ty) => ty.to_string(),
    }
}

/// The unit of the numbers of a port or parameter: `1` has none, `any` takes what the net says.
fn unit(ty: Type, quantity: Quantity) -> Option<String> {
    match ty.element {
        Element::Double | Element::Vector => Some(quantity.to_string()),
        Element::Rotation => Some("rad".to_owned()),
        Element::Frame => Some("m, rad".to_owned()),
        Element::Twist => Some("m/s, rad/s".to_owned()),
        Element::Wrench => Some("any".to_owned()),
        Element::Bool | Element::Int | Element::Nanos => None,
    }
}

fn parameter_unit(parameter: &Parameter) -> Option<String> {
    match parameter.ty {
        ParameterType::Text => None,
        ParameterType::Value(ty) => unit(ty, parameter.quantity),
    }
}

fn as_json(definition: &Definition) -> serde_json::Value {
    let inputs = definition.inputs.iter().map(|port| {
        json!({
            "name": port.name, "type": port.ty.to_string(), "unit": unit(port.ty, port.quantity),
            "doc": port.doc, "required": port.required, "parameter": port.parameter,
        })
    });
    let outputs = definition.outputs.iter().map(|port| {
        json!({
            "name": port.name, "type": port.ty.to_string(), "unit": unit(port.ty, port.quantity),
            "doc": port.doc,
        })
    });
    let parameters = definition.parameters.iter().map(|parameter| {
        json!({
            "name": parameter.name, "type": type_name(parameter.ty),
            "unit": parameter_unit(parameter),
            "default": parameter.default, "doc": parameter.doc,
        })
    });
    json!({
        "name": definition.name, "doc": definition.doc, "null": definition.null.text(),
        "source": definition.source,
        "cost": {
            "first_ns": definition.cost.first_ns, "ns": definition.cost.ns,
            "element_ns": definition.cost.element_ns,
        },
        "inputs": inputs.collect::<Vec<_>>(),
        "outputs": outputs.collect::<Vec<_>>(),
        "parameters": parameters.collect::<Vec<_>>(),
    })
}

/// A primitive among many, whose names are up to so wide.
fn line(definition: &Definition, width: usize) -> String {
    let sentence = definition.doc.split_inclusive(". ").next();
    let sentence = sentence.unwrap_or_default().trim_end();
    format!("{:<width$} {sentence}", definition.name)
}

/// All that is known of a primitive, for people.
fn text(definition: &Definition) -> String {
    let Definition {
        name,
        doc,
        null,
        cost,
        source,
        ..
    } = definition;
    let mut text = format!(
        "{name}\n  {doc}\n  null: {}\n  cost: at most {} ns, the first of a net {} ns more, each array \
         element {} ns; as declared\n  source: {source}\n",
        null.text(),
        cost.ns,
        cost.first_ns,
        cost.element_ns
    );
    let mut section = |title: &str, rows: Vec<String>| {
        if !rows.is_empty() {
            text += &format!("{title}\n{}", rows.concat());
        }
    };
    let inputs = definition
        .inputs
        .iter()
        .map(|port| in_row(definition, port));
    section("in ports", inputs.collect());
    let parameters = definition.parameters.iter().filter(|parameter| {
        let mut ports = definition.inputs.iter();
        !ports.any(|port| port.parameter == Some(parameter.name))
    });
    section("parameters", parameters.map(parameter_row).collect());
    let outputs = definition.outputs.iter();
    let outputs = outputs.map(|port| {
        let unit = unit(port.ty, port.quantity);
        row(port.name, &port.ty.to_string(), unit, port.doc)
    });
    section("out ports", outputs.collect());
    text
}

fn row(name: &str, ty: &str, unit: Option<String>, doc: &str) -> String {
    let unit = unit.unwrap_or_default();
    format!("  {name:<24} {ty:<15} {unit:<10} {doc}\n")
}

fn in_row(definition: &Definition, port: &InPort) -> String {
    let stands_in = port.parameter.and_then(|name| {
        let mut parameters = definition.parameters.iter();
        parameters.find(|parameter| parameter.name == name)
    });
    let doc = match stands_in {
        Some(parameter) => format!(
            "{}; if not connected, parameter {} (default '{}')",
            port.doc, parameter.name, parameter.default
        ),
        None if port.required => format!("{}; must be connected", port.doc),
        None => port.doc.to_owned(),
    };
    let unit = unit(port.ty, port.quantity);
    row(port.name, &port.ty.to_string(), unit, &doc)
}

fn parameter_row(parameter: &Parameter) -> String {
    let doc = format!("{} (default '{}')", parameter.doc, parameter.default);
    let unit = parameter_unit(parameter);
    row(parameter.name, &type_name(parameter.ty), unit, &doc)
}
