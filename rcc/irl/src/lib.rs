#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod builtin;
mod code;
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the compiler rejects every form that an arm does not name"
)]
mod compile;
mod diagnostic;
pub mod fuzz;
mod machine;
pub mod net;
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "a word that an arm does not name is an error of syntax"
)]
mod parse;
mod primitive;
mod spec;
mod token;
mod tree;
mod types;

pub use code::{CodeError, Location, Program, Scalar, VERSION, Variable};
pub use compile::{Compiled, compile, specification_of};
pub use diagnostic::{Code, Diagnostic, Rejection};
pub use machine::{
    BREAKPOINTS_MAX, Control, Fault, FaultKind, Machine, MachineError, Phase, STEP_COST_NS,
};
pub use primitive::all;
pub use spec::{Channel, Direction, Joint, Robot, Signal, SignalKind, SpecError, System};

#[cfg(test)]
mod tests;
