//! Properties that hold for any text or bytes from outside, as functions that a fuzzer can call with any input and that
//! panic if a property is violated. Inputs are generated elsewhere.

use std::sync::Arc;
use std::time::Duration;

use crate::machine::Control;
use crate::{Machine, Program, System, compile};

const SYSTEM: &str = include_str!("../../../examples/irl/two.spc");

/// Cycles that an accepted program runs.
const CYCLES: usize = 20;

fn run(program: Program) {
    let Ok(mut machine) = Machine::new(Arc::new(program), &[], Duration::from_millis(4), 2_000)
    else {
        return;
    };
    for cycle in 0..CYCLES {
        machine.cycle(Control {
            resume: cycle % 2 == 0,
            ..Control::default()
        });
    }
    for robot in 0..2 {
        assert!(machine.positions(robot).iter().all(|q| q.is_finite()));
    }
}

/// A source text is either rejected with errors that can be rendered, or its object code reads back as it is, and runs.
///
/// # Panics
/// If not.
#[expect(clippy::expect_used, reason = "a property that is violated panics")]
pub fn source(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let system = System::parse(SYSTEM).expect("the system of the examples is valid");
    match compile(&text, &system, SYSTEM) {
        Ok(compiled) => {
            let code = compiled.program.encode();
            let read = Program::decode(&code).expect("object code reads back");
            assert_eq!(read.encode(), code);
            run(read);
        }
        Err(rejection) => {
            assert!(!rejection.diagnostics.is_empty());
            assert!(!rejection.render("fuzz", &text).is_empty());
        }
    }
}

/// Object code is either refused, or runs; a correct sum is put into it so that more of it is reached.
///
/// # Panics
/// If reading or running panics.
pub fn code(data: &[u8]) {
    drop(Program::decode(data));
    let mut data = data.to_vec();
    let sum = crc32fast::hash(data.get(10..).unwrap_or_default());
    if let Some(field) = data.get_mut(6..10) {
        field.copy_from_slice(&sum.to_le_bytes());
    }
    if let Ok(program) = Program::decode(&data) {
        drop(program.listing());
        run(program);
    }
}

/// A system specification is either refused with a text, or valid.
///
/// # Panics
/// If reading panics, or the error has no text.
pub fn specification(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    if let Err(error) = System::parse(&text) {
        assert!(!error.to_string().is_empty());
    }
}
