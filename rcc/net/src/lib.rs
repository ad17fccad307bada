#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod cost;
mod cycle;
pub mod definition;
pub mod device;
pub mod failure;
pub mod fault;
pub mod finding;
pub mod fuzz;
pub mod limits;
mod load;
pub mod netcomm;
pub mod picture;
pub mod plan;
pub mod ports;
pub mod primitives;
pub mod registry;
pub mod set_points;
pub mod slots;
pub mod taps;
pub mod text;
pub mod value;
pub mod xml;

pub use cost::{Cost, CostShare, NetCost};
pub use definition::{Build, Definition, Inputs, NullRule, Outputs, Primitive, function};
pub use device::{ArmBinding, Devices, Image, JointCommand, JointLimits, JointState, NoDevices};
pub use fault::{Fault, FaultKind, Rejection};
pub use finding::{Finding, Severity};
pub use limits::Limits;
pub use load::{LoadContext, Parsed, Sorted, check, load};
pub use plan::{Cycle, Moment, Plan};
pub use registry::Registry;
pub use slots::{ArrayIn, ArrayOut, In, Out};
pub use value::unit::{Dimension, Quantity};
pub use value::{Element, Frame, Nanos, Rotation, Twist, Type, Value, Vector, Wrench};
