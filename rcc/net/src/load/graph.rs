//! The units of a resolved net that are to be ordered, one for each step and each activation, and
//! the edges between them. The order itself is computed elsewhere.

use crate::fault::{Fault, FaultKind};
use crate::load::origin::{Origin, number};
use crate::load::resolved::{Node, Resolved};
use crate::load::sort::Graph;

/// The kind of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unit {
    /// The step of a primitive.
    Main(u32),
    /// The early step of a primitive: it writes outputs that do not depend on its inputs.
    Early(u32),
    /// The point in the order from which a guard's activation is known; not a step.
    Gate(u32),
}

impl<'t> Resolved<'t> {
    /// The kind of unit `unit` of [`Self::graph`].
    pub(super) fn unit(&self, unit: u32) -> Unit {
        let nodes = number(self.nodes.len());
        match unit.checked_sub(nodes) {
            None => Unit::Main(unit),
            Some(early) if early < nodes => Unit::Early(early),
            Some(gate) => Unit::Gate(gate - nodes),
        }
    }

    /// Units: the steps of all primitives, their early steps (those without a purpose have no
    /// edges), and one gate for each guard.
    pub(super) fn graph(&self) -> Graph {
        let nodes = number(self.nodes.len());
        let gate = |guard: u32| 2 * nodes + guard;
        let mut guard_of: Vec<u32> = self.nodes.iter().map(|n| n.guard).collect();
        guard_of.extend_from_within(..);
        guard_of.extend(self.guards.iter().map(|g| g.parent));
        let mut edges = Vec::with_capacity(2 * self.nodes.len());
        let unit_of = |origin: Origin| {
            let early = self.nodes[origin.node as usize].definition.early.is_some();
            origin.node + if early { nodes } else { 0 }
        };
        for (i, node) in self.nodes.iter().enumerate() {
            let unit = number(i);
            edges.extend(
                node.links
                    .iter()
                    .flatten()
                    .map(|origin| (unit_of(*origin), unit)),
            );
            if node.definition.early.is_some() {
                edges.push((unit + nodes, unit));
            }
            if node.guard != 0 {
                edges.push((gate(node.guard), unit));
                edges.push((gate(node.guard), unit + nodes));
            }
        }
        for (i, guard) in self.guards.iter().enumerate().skip(1) {
            let unit = gate(number(i));
            edges.extend(guard.active.map(|origin| (unit_of(origin), unit)));
            if guard.parent != 0 {
                edges.push((gate(guard.parent), unit));
            }
        }
        Graph {
            guard_of,
            parent: self.guards.iter().map(|g| g.parent).collect(),
            edges,
        }
    }

    /// The fault that reports a cycle.
    pub(super) fn cycle_fault(&self, cycle: &[u32]) -> Fault {
        let mut nodes: Vec<&Node<'t>> = cycle
            .iter()
            .filter_map(|unit| match self.unit(*unit) {
                Unit::Main(node) | Unit::Early(node) => Some(&self.nodes[node as usize]),
                Unit::Gate(_) => None,
            })
            .collect();
        // Starts with the first in the text, so that the lines come in text order.
        let starts = nodes.iter().map(|n| n.at.start).enumerate();
        let first = starts.min_by_key(|(_, start)| *start).map_or(0, |(i, _)| i);
        nodes.rotate_left(first);
        let mut names: Vec<String> = nodes.iter().take(16).map(|n| n.name.to_owned()).collect();
        names.push(if nodes.len() > 16 {
            "…".to_owned()
        } else {
            names[0].clone()
        });
        let mut fault = Fault::new(
            FaultKind::Cycle {
                path: names.join(" → "),
            },
            nodes.first().map_or(0..0, |n| n.at.clone()),
        );
        let rest = nodes.iter().skip(1).take(8);
        fault.also = rest
            .map(|n| (n.at.clone(), format!("`{}` is part of it", n.name)))
            .collect();
        fault
    }
}
