//! Programs that are compiled for the two arms of the examples, and run in cycles of 1 ms.
#![allow(
    dead_code,
    unreachable_pub,
    missing_debug_implementations,
    reason = "each test file uses a part"
)]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests and their helpers fail by panicking"
)]
#![allow(
    clippy::wrong_self_convention,
    reason = "a run is used up by running it"
)]

use std::sync::Arc;
use std::time::Duration;

use takt_irl::{Control, Fault, Machine, Phase, System, compile};

pub const TWO: &str = include_str!("../../../../examples/irl/two.spc");

/// A program in execution, or after it.
pub struct Run {
    pub machine: Machine,
    pub phase: Phase,
    pub fault: Option<Fault>,
    /// Positions of all joints of both arms, rad, by cycle.
    pub path: Vec<Vec<f64>>,
}

/// Code, location and text of each error, and its hint.
pub fn errors(text: &str) -> Vec<String> {
    let system = System::parse(TWO).unwrap();
    let Err(rejection) = compile(text, &system, TWO) else {
        return Vec::new();
    };
    let line = |d: &takt_irl::Diagnostic| {
        let (line, column) = d.location(text);
        format!("{} {line}:{column} {} {}", d.code.text(), d.text, d.hint)
    };
    rejection.diagnostics.iter().map(line).collect()
}

impl Run {
    pub fn new(text: &str) -> Self {
        let system = System::parse(TWO).unwrap();
        let compiled = compile(text, &system, TWO);
        let compiled = compiled.unwrap_or_else(|e| panic!("{}", e.render("test", text)));
        let code = compiled.program.encode();
        let program = takt_irl::Program::decode(&code).unwrap();
        let homes: Vec<Vec<f64>> = system.robots.iter().map(|r| r.home.clone()).collect();
        let mut machine =
            Machine::new(Arc::new(program), &[], Duration::from_millis(1), 1_000).unwrap();
        for (robot, home) in homes.iter().enumerate() {
            let home: Vec<f64> = home.iter().map(|q| q.to_radians()).collect();
            machine.place(robot, &home);
        }
        machine.set_input(0, Some(1));
        Self {
            machine,
            phase: Phase::Running,
            fault: None,
            path: Vec::new(),
        }
    }

    /// Runs until all is at rest.
    pub fn to_end(mut self, control: impl Fn(usize) -> Control) -> Self {
        for cycle in 0..200_000 {
            self.phase = self.machine.cycle(control(cycle));
            let arms = (0..2).flat_map(|robot| self.machine.positions(robot));
            self.path.push(arms.copied().collect());
            let is_over = matches!(self.phase, Phase::Ended | Phase::Failed);
            if is_over && self.machine.is_at_rest() {
                self.fault = self.machine.fault();
                return self;
            }
        }
        panic!("the program does not end");
    }

    pub fn value(&self, name: &str) -> f64 {
        let variables = &self.machine.program().variables;
        let number = variables.iter().position(|v| v.name == name).unwrap();
        self.machine.variable(number).unwrap()
    }
}

/// Runs a program to its end, without waiting at `pause`.
pub fn run(text: &str) -> Run {
    Run::new(text).to_end(|_| Control {
        resume: true,
        ..Control::default()
    })
}
