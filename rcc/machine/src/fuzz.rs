//! Properties that hold for any file from outside, as functions that a fuzzer can call with any bytes and that panic if a
//! property is violated. Inputs are generated elsewhere.

use crate::component::{Component, Configuration};
use crate::diagnostic::Diagnostics;
use crate::lifecycle::{Phase, Request};
use crate::machine::{Control, Machine, Peers, Program, Refused, Ticket};
use crate::properties::PropertyFile;
use crate::value::Value;

fn show(found: &Diagnostics, text: &str) {
    assert!(!found.all().is_empty());
    for diagnostic in found.all() {
        assert!(diagnostic.at.end <= text.len(), "{diagnostic:?}");
        assert!(!diagnostic.text.is_empty() && !diagnostic.hint.is_empty());
    }
    let _ = found.render("file", text);
}

/// A property file is rejected with diagnostics, or both forms of it can be read again with the same result.
///
/// # Panics
/// If it is not.
pub fn properties(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    for read in [PropertyFile::from_toml, PropertyFile::from_cpf] {
        let file = match read(&text) {
            Ok(file) => file,
            Err(found) => {
                show(&found, &text);
                continue;
            }
        };
        let toml = file.to_toml();
        assert_eq!(PropertyFile::from_toml(&toml).as_ref(), Ok(&file), "{toml}");
        if let Ok(cpf) = file.to_cpf() {
            assert_eq!(PropertyFile::from_cpf(&cpf).as_ref(), Ok(&file), "{cpf}");
        }
    }
}

/// A component file is rejected with diagnostics, or its net can be filled with its properties.
///
/// # Panics
/// If it is not.
pub fn component(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    match Component::parse(&text) {
        Ok((component, _)) => {
            let _ = component.net_text(&Configuration::of(&component));
        }
        Err(found) => show(&found, &text),
    }
}

/// A machine is rejected with diagnostics, or each step of it is bounded by its worst one, whatever its components answer.
///
/// # Panics
/// If it is not.
pub fn machine(data: &[u8]) {
    const COMPONENT: &str = "component C { property gain: int default 1 live; in x: int; out flag: bool; out level: double[2]; \
        operation work(n: double) done flag; } { g=Core::IntNetcommIn(Key='gain'), x=Core::IntNetcommIn(Key='x'), \
        w=Core::IntNetcommIn(Key='work'), n=Core::DoubleNetcommIn(Key='work_n'), b=Core::BooleanValue(), \
        f=Core::BooleanNetcommOut(inValue=b.outValue, Key='flag'), l=Core::DoubleArray(Size='2'), \
        o=Core::DoubleArrayNetcommOut(inValue=l.outArray, Key='level'), outTerminate=b.outValue }";
    let text = String::from_utf8_lossy(data);
    let library = |_: &str| Ok(COMPONENT.to_owned());
    let program = match Program::compile(&text, &library) {
        Ok((program, _)) => program,
        Err(found) => return show(&found, &text),
    };
    for machine in 0..program.machines().count() {
        let _ = program
            .graph(machine, Some(0))
            .map(|graph| graph.dot() + &graph.svg());
    }
    let worst = program.worst_step();
    let mut machine = Machine::new(std::sync::Arc::new(program));
    let mut peer = Anything(1);
    for cycle in 0..50 {
        if machine.control(0, Control::Activate).is_ok() {
            let _ = machine.control(0, Control::Start);
        }
        let outcome = machine.step(&mut peer, cycle * 1_000_000);
        assert!(outcome.operations <= worst, "{outcome:?} of {worst}");
        if cycle % 7 == 3 {
            machine.raise(1);
        }
    }
}

/// Components with pseudo-random answers.
struct Anything(u64);

impl Anything {
    fn below(&self, bound: u64) -> u64 {
        (self.0 >> 33) % bound
    }

    fn change(&mut self) -> Result<(), Refused> {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        if self.below(9) == 0 {
            return Err(Refused::NotRunning);
        }
        Ok(())
    }
}

impl Peers for Anything {
    fn phase(&self, component: usize) -> Phase {
        let number = usize::try_from(self.below(5)).unwrap_or(0) + component;
        Phase::ALL.into_iter().nth(number % 5).unwrap_or_default()
    }

    fn read(&self, _: usize, port: usize, _: usize) -> Option<Value> {
        let value = [
            Value::Int(3),
            Value::Bool(self.below(2) == 0),
            Value::Double(0.5),
        ];
        value.get(port).copied().filter(|_| self.below(4) > 0)
    }

    fn write(&mut self, _: usize, _: usize, _: Value) -> Result<(), Refused> {
        self.change()
    }

    fn set(&mut self, _: usize, _: &[(usize, Value)]) -> Result<(), Refused> {
        self.change()
    }

    fn request(&mut self, _: usize, _: Request) -> Result<(), Refused> {
        self.change()
    }

    fn is_settled(&self, _: usize) -> Result<bool, Refused> {
        Ok(self.below(3) == 0)
    }

    fn call(&mut self, component: usize, operation: usize, _: &[Value]) -> Result<Ticket, Refused> {
        self.change()?;
        Ok(Ticket {
            component,
            operation,
            number: 0,
        })
    }

    fn is_done(&self, _: Ticket) -> Result<bool, Refused> {
        Ok(self.below(3) == 0)
    }
}
