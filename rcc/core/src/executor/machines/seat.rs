//! The net of a component: where the declared ports, properties and operations are in its boxes. Found once while it is
//! loaded, so that a machine in its thread searches no names.

use takt_machine::{Component, Program};
use takt_net::Plan;
use takt_net::netcomm::{Entry, OutStatus};

use crate::executor::Running;

/// A component's place in its machine, and its values in the boxes of its net.
#[derive(Debug)]
pub struct Seat {
    /// The number of the machine.
    pub machine: u32,
    /// The number of the component.
    pub component: usize,
    /// Its place in the order of evaluation.
    rank: usize,
    ports: Box<[Option<Entry>]>,
    properties: Box<[Option<Entry>]>,
    operations: Box<[OperationEntries]>,
    /// The out-box when the net was stopped.
    last: Box<[u64]>,
}

/// Where an operation is in the in-box.
#[derive(Debug)]
pub(super) struct OperationEntries {
    pub(super) calls: Option<Entry>,
    pub(super) arguments: Box<[Option<Entry>]>,
}

impl Seat {
    /// The seat of a component: the numbers of its machine and of itself, and its net.
    #[must_use]
    pub fn of(
        program: &Program,
        (machine, component): (u32, usize),
        declared: &Component,
        plan: &Plan,
    ) -> Self {
        let mut order = program.order().iter();
        let rank = order.position(|one| *one == component).unwrap_or(0);
        let read = |name: &str| plan.inbox().find(&format!("in{name}")).cloned();
        let written = |name: &str| plan.outbox().find(&format!("out{name}")).cloned();
        let ports = declared.ports.iter().map(|port| {
            let name = &port.declared.name;
            if port.is_output {
                written(name)
            } else {
                read(name)
            }
        });
        let properties = declared.properties.iter();
        let properties = properties.map(|p| p.live.then(|| read(&p.declared.name)).flatten());
        let operations = declared.operations.iter().map(|operation| {
            let name = &operation.name;
            let arguments = operation.arguments.iter();
            OperationEntries {
                calls: read(name),
                arguments: arguments
                    .map(|argument| read(&format!("{name}_{}", argument.name)))
                    .collect(),
            }
        });
        Self {
            machine,
            component,
            rank,
            ports: ports.collect(),
            properties: properties.collect(),
            operations: operations.collect(),
            last: vec![0; plan.outbox().words()].into(),
        }
    }

    pub(super) fn port(&self, port: usize) -> Option<&Entry> {
        self.ports.get(port)?.as_ref()
    }

    pub(super) fn property(&self, property: usize) -> Option<&Entry> {
        self.properties.get(property)?.as_ref()
    }

    pub(super) fn operation(&self, operation: usize) -> Option<&OperationEntries> {
        self.operations.get(operation)
    }

    /// Keeps the out values of its net, which ends.
    pub(super) fn keep(&mut self, plan: &Plan) {
        plan.export(&mut self.last);
    }

    /// A word of an out port when its net ended.
    pub(super) fn last_word(&self, port: usize, word: usize) -> Option<u64> {
        let entry = self.port(port)?;
        let is_current = entry.status(&self.last) == OutStatus::Current;
        entry
            .value(&self.last)
            .get(word)
            .copied()
            .filter(|_| is_current)
    }

    /// Passes the last value of an out port to an in port of another net.
    pub(super) fn pass_last(&self, port: usize, to: &Running, to_port: usize) {
        let target = to.seat.as_ref().and_then(|seat| seat.port(to_port));
        if let (Some(entry), Some(target)) = (self.port(port), target)
            && entry.status(&self.last) == OutStatus::Current
        {
            to.plan.write_in(target, 0, entry.value(&self.last));
        }
    }
}

/// Passes the value of an out port of one net to an in port of another.
pub(super) fn pass(from: &Running, port: usize, to: &Running, to_port: usize) {
    let (Some(source), Some(target)) = (&from.seat, &to.seat) else {
        return;
    };
    if let (Some(source), Some(target)) = (source.port(port), target.port(to_port)) {
        from.plan.pass(source, &to.plan, target);
    }
}

/// Where a net is to be evaluated: before the first running component of its machine that is later in the order.
pub(super) fn place_of(net: &Running, running: &[Box<Running>]) -> usize {
    let Some(seat) = &net.seat else {
        return running.len();
    };
    let is_later = |other: &Running| {
        let other = other.seat.as_ref();
        other.is_some_and(|other| other.machine == seat.machine && other.rank > seat.rank)
    };
    let later = running.iter().position(|other| is_later(other));
    later.unwrap_or(running.len())
}
