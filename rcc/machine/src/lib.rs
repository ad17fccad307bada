#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod command;
pub mod component;
pub mod diagnostic;
pub mod fuzz;
pub mod lifecycle;
pub mod machine;
pub mod properties;
mod syntax;
pub mod value;

pub use component::{Component, Configuration};
pub use diagnostic::{Diagnostic, Diagnostics, Level};
pub use lifecycle::{Phase, Request, Unsuitable};
pub use machine::{Control, Library, Machine, Mode, Peers, Program, Status};
pub use properties::PropertyFile;
pub use value::{Kind, Shape, Value};
