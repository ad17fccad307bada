//! What a component declares.

use std::ops::Range;

use takt_net::Quantity;

use super::configuration::Data;
use crate::value::{Kind, Shape, Value};

/// Most declarations of one kind in a component.
pub const DECLARATIONS_MAX: usize = 500;
/// Longest array of a property or port.
pub const ARRAY_MAX: u32 = 1000;
/// Most cycles of its thread after which a component is evaluated.
pub const EVERY_MAX: u32 = 100_000;

/// A component file.
#[derive(Clone, Debug)]
pub struct Component {
    /// Its type name.
    pub name: String,
    /// What it is for.
    pub doc: String,
    /// It is evaluated every so many cycles of its thread, at least 1.
    pub every: u32,
    /// Properties, in the order of the file.
    pub properties: Vec<Property>,
    /// Data ports, in the order of the file.
    pub ports: Vec<Port>,
    /// Operations, in the order of the file.
    pub operations: Vec<Operation>,
    /// The text of its net, with `'$name'` where a property is read while loading.
    pub net: String,
    /// First byte of the net in the file.
    pub net_start: usize,
}

/// A declared value: a property, a port or an argument.
#[derive(Clone, Debug, PartialEq)]
pub struct Declared {
    /// Its name.
    pub name: String,
    /// Its type.
    pub shape: Shape,
    /// What it measures.
    pub quantity: Quantity,
    /// The smallest and the largest value, SI.
    pub range: Option<(f64, f64)>,
    /// What it is for.
    pub doc: String,
    /// The name in the file.
    pub at: Range<usize>,
}

impl Declared {
    /// The value as one of the declared type, if this is a single value, it is finite and in the declared range.
    #[must_use]
    pub fn accepted(&self, value: Value) -> Option<Value> {
        let value = match (self.shape.kind, value) {
            (Kind::Double, Value::Int(value)) => Value::Double(f64::from(value)),
            (kind, value) if kind == value.kind() => value,
            (Kind::Bool | Kind::Int | Kind::Double | Kind::Text, _) => return None,
        };
        let is_in_range = value.number().is_none_or(|number| {
            let (low, high) = self.range.unwrap_or((f64::MIN, f64::MAX));
            number.is_finite() && (low..=high).contains(&number)
        });
        (self.shape.len.is_none() && is_in_range).then_some(value)
    }
}

/// A property.
#[derive(Clone, Debug, PartialEq)]
pub struct Property {
    /// Name, type, quantity and range.
    pub declared: Declared,
    /// Its value until another one is set.
    pub default: Option<Data>,
    /// Whether it may be written while the component runs.
    pub live: bool,
}

/// A data port.
#[derive(Clone, Debug, PartialEq)]
pub struct Port {
    /// Name, type and quantity.
    pub declared: Declared,
    /// Whether the component writes it.
    pub is_output: bool,
}

/// An operation: its arguments are in values `operation_argument` of the net, the number of calls is the in value
/// `operation`.
#[derive(Clone, Debug, PartialEq)]
pub struct Operation {
    /// Its name.
    pub name: String,
    /// Its arguments.
    pub arguments: Vec<Declared>,
    /// The Boolean out port that is true once the operation is complete; without it, it is complete at once.
    pub done: Option<String>,
    /// What it is for.
    pub doc: String,
    /// The name in the file.
    pub at: Range<usize>,
}

impl Component {
    /// The property of that name.
    #[must_use]
    pub fn property(&self, name: &str) -> Option<&Property> {
        self.properties.iter().find(|p| p.declared.name == name)
    }

    /// The port of that name.
    #[must_use]
    pub fn port(&self, name: &str) -> Option<&Port> {
        self.ports.iter().find(|port| port.declared.name == name)
    }

    /// The operation of that name.
    #[must_use]
    pub fn operation(&self, name: &str) -> Option<&Operation> {
        self.operations
            .iter()
            .find(|operation| operation.name == name)
    }
}
