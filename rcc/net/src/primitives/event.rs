//! Primitives that remember an event: latches and edges.

use crate::definition::{Build, Definition, Primitive, port};
use crate::fault::Fault;
use crate::plan::Cycle;
use crate::slots::{In, Out};

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Waiting,
    On,
    Done,
}

/// Waiting → On when switched on → Done when switched off; a reset leads back to Waiting.
struct Trigger {
    on: In<bool>,
    off: In<bool>,
    reset: In<bool>,
    active: Out<bool>,
    state: State,
}

impl Trigger {
    fn switch(&mut self, on: bool, off: bool) -> bool {
        if self.state == State::Waiting && on {
            self.state = State::On;
        }
        if self.state == State::On && off {
            self.state = State::Done;
        }
        self.state == State::On
    }
}

impl Primitive for Trigger {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.state = State::Waiting;
        }
        let switches = self.on.get(cycle).zip(self.off.get(cycle));
        self.active
            .set(cycle, switches.map(|(on, off)| self.switch(on, off)));
    }
}

struct Edge {
    value: In<bool>,
    reset: In<bool>,
    out: Out<bool>,
    direction: bool,
    before: bool,
}

impl Primitive for Edge {
    fn step(&mut self, cycle: &Cycle<'_>) {
        if self.reset.get(cycle) == Some(true) {
            self.before = !self.direction;
        }
        let value = self.value.get(cycle);
        let edge = value.map(|v| v != self.before && v == self.direction);
        self.before = value.unwrap_or(self.before);
        self.out.set(cycle, edge);
    }
}

pub(super) fn table() -> Vec<Definition> {
    let trigger = |b: &mut Build<'_, '_>| -> Result<Trigger, Fault> {
        Ok(Trigger {
            on: b.input("inOn")?,
            off: b.input("inOff")?,
            reset: b.input("inReset")?,
            active: b.output("outActive"),
            state: State::Waiting,
        })
    };
    let edge = |b: &mut Build<'_, '_>| -> Result<Edge, Fault> {
        let direction: bool = b.value("Direction")?;
        Ok(Edge {
            value: b.input("inValue")?,
            reset: b.input("inReset")?,
            out: b.output("outValue"),
            direction,
            before: !direction,
        })
    };
    vec![
        Definition::new(
            "Core::Trigger",
            "True from the cycle in which On is true until the one in which Off is; then false \
             until a reset. Off has no effect before On, and wins in the same cycle.",
            trigger,
        )
        .stateful()
        .input::<bool>(port("inOn", "switches on").or("On", "false"))
        .input::<bool>(port("inOff", "switches off").or("Off", "false"))
        .output::<bool>("outActive", "whether it is on"),
        Definition::new(
            "Core::EdgeDetection",
            "True in the cycle in which the input changes in the given direction. A value that \
             has that state from the start counts as a change; cycles of null are passed over.",
            edge,
        )
        .stateful()
        .input::<bool>(port("inValue", "observed value").required())
        .parameter::<bool>(
            "Direction",
            "true",
            "true for rising, false for falling edges",
        )
        .output::<bool>("outValue", "whether it just changed"),
    ]
}
