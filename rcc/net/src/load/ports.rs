//! The names of all ports of a net, and the slots in which their values are.

use std::collections::HashMap;

use super::origin::{Origin, number};
use super::parts::Parts;
use super::resolved::Resolved;
use crate::ports::{Port, Ports};

/// The out ports of all primitives, and their in ports that are linked.
pub(super) fn ports(parts: &mut Parts, resolved: &Resolved<'_>) -> Ports {
    let mut ports = Vec::new();
    // A primitive that is written at a port has that port's name, which others may have too.
    let mut known: HashMap<String, u32> = HashMap::new();
    for (at, node) in resolved.nodes.iter().enumerate() {
        let mut names = vec![node.name];
        let mut next = Some(node.scope);
        while let Some((name, parent)) = next.and_then(|it| resolved.scopes.get(it as usize)) {
            names.push(name);
            next = *parent;
        }
        names.retain(|name| !name.is_empty());
        names.reverse();
        let mut path = names.join(".");
        let times = known.entry(path.clone()).or_insert(0);
        *times += 1;
        if *times > 1 {
            path = format!("{path}~{times}");
        }
        let mut add = |name: &str, is_in: bool, origin: Origin| {
            let from = resolved.nodes.get(origin.node as usize);
            let Some(from) = from else { return };
            let definition = from.definition.outputs.get(origin.port as usize);
            let (Some(definition), Some(slot)) = (definition, *parts.output(origin)) else {
                return;
            };
            ports.push(Port {
                name: format!("{path}.{name}").into(),
                ty: definition.ty,
                quantity: definition.quantity,
                is_in,
                slot,
                guard: from.guard,
            });
        };
        let ins = node.definition.inputs.iter().zip(&node.links);
        for (input, link) in ins {
            if let Some(origin) = link {
                add(input.name, true, *origin);
            }
        }
        for (port, output) in node.definition.outputs.iter().enumerate() {
            let (node, port) = (number(at), number(port));
            add(output.name, false, Origin { node, port });
        }
    }
    let guards = resolved.guards.iter().map(|guard| guard.parent);
    Ports::new(ports, guards.collect())
}
