#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]
#![allow(
    clippy::wildcard_enum_match_arm,
    clippy::match_wildcard_for_single_variants,
    reason = "the compiler rejects, and the interpreter faults on, everything that an arm does not name"
)]

mod builtin;
mod code;
mod compile;
mod diagnostic;
pub mod fuzz;
mod machine;
mod parse;
mod primitive;
mod spec;
mod token;
mod tree;
mod types;

pub use code::{CodeError, Location, Program, Scalar, VERSION, Variable};
pub use compile::{Compiled, compile, specification_of};
pub use diagnostic::{Code, Diagnostic, Rejection};
pub use machine::{Control, Fault, FaultKind, Machine, MachineError, Phase, STEP_COST_NS};
pub use primitive::all;
pub use spec::{Direction, Joint, Robot, Signal, SignalKind, SpecError, System};

#[cfg(test)]
mod tests;
