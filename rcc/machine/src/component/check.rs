//! Whether declarations and net fit together: each name once, each live property, port and argument a value of the net
//! of its type, each other property read by the net.

use std::collections::BTreeMap;
use std::ops::Range;

use takt_net::Limits;
use takt_net::text::{Arg, ArgValue, Body, Fragment, Node, SourceOf, parse};

use super::declaration::{Component, Declared};
use crate::diagnostic::{Diagnostics, suggest};
use crate::value::{Kind, Shape};

/// Words that a machine uses otherwise.
const RESERVED: [&str; 8] = ["true", "false", "not", "and", "or", "is", "has", "state"];

/// A value that a net exchanges: its location, type and whether the net writes it.
struct Exchanged {
    at: Range<usize>,
    kind: Option<Kind>,
    is_array: bool,
}

#[derive(Default)]
struct Net {
    ins: BTreeMap<String, Exchanged>,
    outs: BTreeMap<String, Exchanged>,
    references: Vec<(Range<usize>, String)>,
}

/// The texts `'$name'` of a net, with their quotes, in text order.
pub(super) fn references(net: &str) -> Vec<(Range<usize>, String)> {
    let tree = parse(net, &Limits::default(), &mut Vec::new());
    let mut found = Net::default();
    found.fragment(&tree);
    found.references.sort_by_key(|(at, _)| at.start);
    found.references
}

pub(super) fn check(component: &Component, found: &mut Diagnostics) {
    let mut faults = Vec::new();
    let tree = parse(&component.net, &Limits::default(), &mut faults);
    for fault in &faults {
        let at = fault.at.start + component.net_start..fault.at.end + component.net_start;
        let hint = "the net follows the declaration: `{ child=Primitive(…), outTerminate=… }`";
        found.error(at, fault.kind.to_string(), hint);
    }
    names(component, found);
    if !faults.is_empty() {
        return;
    }
    let mut net = Net::default();
    net.fragment(&tree);
    properties(component, &net, found);
    for port in &component.ports {
        let (values, word, primitive) = if port.is_output {
            (&net.outs, "out", "NetcommOut")
        } else {
            (&net.ins, "in", "NetcommIn")
        };
        matches(
            &port.declared.name,
            &port.declared,
            values,
            (word, primitive),
            component,
            found,
        );
    }
    for operation in &component.operations {
        let calls = Declared {
            shape: Shape {
                kind: Kind::Int,
                len: None,
            },
            name: operation.name.clone(),
            at: operation.at.clone(),
            quantity: takt_net::Quantity::Number,
            range: None,
            doc: String::new(),
        };
        let ins = ("operation", "NetcommIn");
        matches(&operation.name, &calls, &net.ins, ins, component, found);
        for argument in &operation.arguments {
            let key = format!("{}_{}", operation.name, argument.name);
            matches(
                &key,
                argument,
                &net.ins,
                ("argument", "NetcommIn"),
                component,
                found,
            );
        }
        let Some(done) = &operation.done else {
            continue;
        };
        let is_flag = |shape: Shape| shape.kind == Kind::Bool && shape.len.is_none();
        let port = component.port(done);
        if !port.is_some_and(|port| port.is_output && is_flag(port.declared.shape)) {
            let cause = format!(
                "operation `{}`: there is no out port `{done}` of type bool",
                operation.name
            );
            let hint = format!("declare it: `out {done}: bool;`");
            found.error(operation.at.clone(), cause, hint);
        }
    }
    undeclared(component, &net, found);
}

fn names(component: &Component, found: &mut Diagnostics) {
    let properties = component.properties.iter().map(|p| &p.declared);
    let ports = component.ports.iter().map(|p| &p.declared);
    let declared = properties.chain(ports).map(|d| (d.name.as_str(), &d.at));
    let operations = component
        .operations
        .iter()
        .map(|o| (o.name.as_str(), &o.at));
    let mut seen: Vec<&str> = Vec::new();
    for (name, at) in declared.chain(operations) {
        if seen.contains(&name) {
            let cause = format!("`{name}` is declared twice");
            found.error(at.clone(), cause, "rename one of them");
        } else if RESERVED.contains(&name) {
            let cause = format!("`{name}` is a word of the machine language");
            found.error(at.clone(), cause, "choose another name");
        }
        seen.push(name);
    }
    for port in &component.ports {
        if port.declared.shape.kind == Kind::Text {
            let cause = format!("port `{}`: a port carries no string", port.declared.name);
            found.error(port.declared.at.clone(), cause, "use bool, int or double");
        }
    }
}

fn properties(component: &Component, net: &Net, found: &mut Diagnostics) {
    for property in &component.properties {
        let declared = &property.declared;
        let name = &declared.name;
        if property.live {
            let held = match (declared.shape.kind, declared.shape.len) {
                (Kind::Text, _) => Some("a string"),
                (_, Some(_)) => Some("an array"),
                (Kind::Bool | Kind::Int | Kind::Double, None) => None,
            };
            if let Some(held) = held {
                let cause = format!("property `{name}`: {held} cannot be live");
                let hint = "remove `live`: its value counts from the next `configure` on; what changes at run time is an in port, or single \
                            values";
                found.error(declared.at.clone(), cause, hint);
                continue;
            }
            let live = ("live property", "NetcommIn");
            matches(name, declared, &net.ins, live, component, found);
        } else if !net
            .references
            .iter()
            .any(|(_, reference)| reference == name)
        {
            let cause = format!("property `{name}` is not used by the net");
            let hint =
                format!("write `'${name}'` as the text of a parameter, or declare it `live`");
            found.error(declared.at.clone(), cause, hint);
        }
    }
    for (at, name) in &net.references {
        let Some(property) = component.property(name) else {
            let known = component
                .properties
                .iter()
                .map(|p| p.declared.name.as_str());
            let at = at.start + component.net_start..at.end + component.net_start;
            found.error(
                at,
                format!("there is no property `{name}`"),
                suggest(name, known),
            );
            continue;
        };
        if property.live && property.default.is_none() {
            let cause = format!("live property `{name}` has no default");
            found.error(property.declared.at.clone(), cause, "declare a `default`");
        }
    }
}

/// Checks that the net exchanges a value of that key and type.
fn matches(
    key: &str,
    declared: &Declared,
    values: &BTreeMap<String, Exchanged>,
    (what, primitive): (&str, &str),
    component: &Component,
    found: &mut Diagnostics,
) {
    let shape = declared.shape;
    let prefix = match shape.kind {
        Kind::Bool => "Boolean",
        Kind::Int => "Int",
        Kind::Double | Kind::Text => "Double",
    };
    let array = if shape.len.is_some() { "Array" } else { "" };
    let wanted = format!("Core::{prefix}{array}{primitive}(Key='{key}', …)");
    let Some(value) = values.get(key) else {
        let cause = format!("{what} `{}`: the net has no value `{key}`", declared.name);
        found.error(declared.at.clone(), cause, format!("add `{wanted}`"));
        return;
    };
    if value.kind != Some(shape.kind) || value.is_array != shape.len.is_some() {
        let cause = format!("value `{key}` of the net is not a {shape}, as declared");
        let at = value.at.start + component.net_start..value.at.end + component.net_start;
        found.error(at, cause, format!("use `{wanted}`"));
    }
}

/// Values that the net exchanges without a declaration are not visible to machines.
fn undeclared(component: &Component, net: &Net, found: &mut Diagnostics) {
    let is_argument = |key: &str| {
        component.operations.iter().any(|operation| {
            key == operation.name
                || operation
                    .arguments
                    .iter()
                    .any(|argument| key == format!("{}_{}", operation.name, argument.name))
        })
    };
    for (values, word) in [(&net.ins, "in"), (&net.outs, "out")] {
        for (key, value) in values {
            let declared = component.port(key).is_some()
                || component.property(key).is_some()
                || key.starts_with('$')
                || is_argument(key);
            if !declared {
                let at = value.at.start + component.net_start..value.at.end + component.net_start;
                let cause = format!("value `{key}` of the net is not declared");
                let kind = value.kind.map_or("double", Kind::word);
                found.warning(at, cause, format!("declare it: `{word} {key}: {kind};`"));
            }
        }
    }
}

impl Net {
    fn fragment(&mut self, fragment: &Fragment<'_>) {
        for child in &fragment.children {
            self.node(&child.node);
        }
        self.args(&fragment.outs);
    }

    fn node(&mut self, node: &Node<'_>) {
        match &node.body {
            Body::Fragment(fragment) => self.fragment(fragment),
            Body::Primitive(name) => {
                let key = node.args.iter().find_map(|arg| match &arg.value {
                    ArgValue::Text(text, _) if arg.name.text == "Key" => Some(text.to_string()),
                    ArgValue::Text(..) | ArgValue::Link(_) => None,
                });
                self.exchanged(name.text, node.at.clone(), key);
            }
        }
        self.args(&node.args);
    }

    fn exchanged(&mut self, primitive: &str, at: Range<usize>, key: Option<String>) {
        let Some(key) = key else {
            return;
        };
        let (values, rest) = if let Some(rest) = primitive.strip_suffix("NetcommIn") {
            (&mut self.ins, rest)
        } else if let Some(rest) = primitive.strip_suffix("NetcommOut") {
            (&mut self.outs, rest)
        } else {
            return;
        };
        if rest.ends_with("Inter") {
            return;
        }
        let (rest, is_array) = match rest.strip_suffix("Array") {
            Some(rest) => (rest, true),
            None => (rest, false),
        };
        let kind = match rest {
            "Core::Boolean" => Some(Kind::Bool),
            "Core::Int" => Some(Kind::Int),
            "Core::Double" => Some(Kind::Double),
            _ => None,
        };
        values.insert(key, Exchanged { at, kind, is_array });
    }

    fn args(&mut self, args: &[Arg<'_>]) {
        for arg in args {
            match &arg.value {
                ArgValue::Text(text, start) => {
                    if let Some(name) = text.strip_prefix('$') {
                        let at = start.saturating_sub(1)..start + text.len() + 1;
                        self.references.push((at, name.to_owned()));
                    }
                }
                ArgValue::Link(source) => {
                    if let SourceOf::Inline(node) = &source.of {
                        self.node(node);
                    }
                }
            }
        }
    }
}
