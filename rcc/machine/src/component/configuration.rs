//! Values of the properties of a component, and their transactional change: a change is made whole, or refused with all
//! reasons and nothing changed.

use std::fmt;

use takt_net::Quantity;
use takt_net::value::text::TextValue as _;

use super::declaration::{Component, Declared};
use crate::diagnostic::suggest;
use crate::lifecycle::Phase;
use crate::properties::{ARRAY, BAG, Body, Node, PropertyFile, Simple};
use crate::value::{Kind, Shape, Value};

/// The value of a property.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// `true` or `false`.
    Bool(bool),
    /// A whole number.
    Int(i32),
    /// A number, SI.
    Double(f64),
    /// A text; for a number, one with a unit.
    Text(String),
    /// The elements of an array.
    List(Vec<Data>),
}

impl Data {
    /// As a value that machines compute with; none for texts and arrays.
    #[must_use]
    pub const fn value(&self) -> Option<Value> {
        match self {
            Self::Bool(value) => Some(Value::Bool(*value)),
            Self::Int(value) => Some(Value::Int(*value)),
            Self::Double(value) => Some(Value::Double(*value)),
            Self::Text(_) | Self::List(_) => None,
        }
    }

    /// As a parameter of a net.
    pub(super) fn net_text(&self) -> String {
        match self {
            Self::Bool(value) => value.to_string(),
            Self::Int(value) => value.to_string(),
            Self::Double(value) => format!("{value:?}"),
            Self::Text(text) => text.replace('\\', "\\\\").replace('\'', "\\'"),
            Self::List(elements) => {
                let elements: Vec<String> = elements.iter().map(Self::net_text).collect();
                format!("[{}]", elements.join(","))
            }
        }
    }

    /// The value as one of the declared type, if it is finite and in the declared range. A text may be a number with
    /// a unit.
    ///
    /// # Errors
    /// If the value does not fit.
    pub fn fitting(self, declared: &Declared) -> Result<Self, RefusalReason> {
        let shape = declared.shape;
        let Some(len) = shape.len else {
            return self.single(declared);
        };
        match self {
            Self::List(elements) if elements.len() == len as usize => {
                let elements = elements.into_iter().map(|element| element.single(declared));
                Ok(Self::List(elements.collect::<Result<_, _>>()?))
            }
            Self::List(elements) => Err(RefusalReason::Length(elements.len(), len)),
            other @ (Self::Bool(_) | Self::Int(_) | Self::Double(_) | Self::Text(_)) => {
                Err(RefusalReason::Type(other.word(), shape))
            }
        }
    }

    fn single(self, declared: &Declared) -> Result<Self, RefusalReason> {
        let kind = declared.shape.kind;
        let fitted = match (kind, self) {
            (Kind::Bool, Self::Bool(value)) => Self::Bool(value),
            (Kind::Int, Self::Int(value)) => Self::Int(value),
            (Kind::Double, Self::Int(value)) => Self::Double(f64::from(value)),
            (Kind::Double, Self::Double(value)) => Self::Double(value),
            (Kind::Text, Self::Text(text)) => Self::Text(text),
            (Kind::Double, Self::Text(text)) => {
                let value = f64::parse_as(&text, declared.quantity);
                Self::Double(value.map_err(|e| RefusalReason::Unit(e.message))?)
            }
            (_, other) => {
                let expected = Shape { kind, len: None };
                return Err(RefusalReason::Type(other.word(), expected));
            }
        };
        let number = match fitted {
            Self::Int(value) => Some(f64::from(value)),
            Self::Double(value) => Some(value),
            Self::Bool(_) | Self::Text(_) | Self::List(_) => None,
        };
        match (number, declared.range) {
            (Some(value), _) if !value.is_finite() => Err(RefusalReason::NotFinite),
            (Some(value), Some((low, high))) if !(low..=high).contains(&value) => {
                Err(RefusalReason::Range {
                    value,
                    low,
                    high,
                    quantity: declared.quantity,
                })
            }
            _ => Ok(fitted),
        }
    }

    const fn word(&self) -> &'static str {
        match self {
            Self::Bool(_) => "a bool",
            Self::Int(_) => "an int",
            Self::Double(_) => "a double",
            Self::Text(_) => "a text",
            Self::List(_) => "an array",
        }
    }

    /// The value of a node in a property file.
    fn of_node(node: &Node) -> Result<Self, RefusalReason> {
        match &node.body {
            Body::Simple(simple) => Self::of_simple(simple),
            Body::Struct(kind, members) if kind == ARRAY => Ok(Self::List(
                members
                    .iter()
                    .map(Self::of_node)
                    .collect::<Result<_, _>>()?,
            )),
            Body::Struct(..) => Err(RefusalReason::Struct),
        }
    }

    fn of_simple(simple: &Simple) -> Result<Self, RefusalReason> {
        Ok(match simple {
            Simple::Boolean(value) => Self::Bool(*value),
            Simple::Char(value) => Self::Text(value.to_string()),
            Simple::Uchar(value) => Self::Int(i32::from(*value)),
            Simple::Short(value) => Self::Int(i32::from(*value)),
            Simple::Ushort(value) => Self::Int(i32::from(*value)),
            Simple::Long(value) => Self::Int(*value),
            Simple::Ulong(value) => {
                Self::Int(i32::try_from(*value).map_err(|_| RefusalReason::TooLarge(*value))?)
            }
            Simple::Float(value) => Self::Double(f64::from(*value)),
            Simple::Double(value) => Self::Double(*value),
            Simple::String(value) => Self::Text(value.clone()),
        })
    }

    fn to_body(&self) -> Body {
        match self {
            Self::Bool(value) => Body::Simple(Simple::Boolean(*value)),
            Self::Int(value) => Body::Simple(Simple::Long(*value)),
            Self::Double(value) => Body::Simple(Simple::Double(*value)),
            Self::Text(value) => Body::Simple(Simple::String(value.clone())),
            Self::List(elements) => {
                let elements = elements.iter().enumerate();
                let nodes = elements.map(|(number, element)| Node {
                    name: format!("Element{number}"),
                    description: String::new(),
                    body: element.to_body(),
                    at: 0..0,
                });
                Body::Struct(ARRAY.to_owned(), nodes.collect())
            }
        }
    }
}

impl From<Value> for Data {
    fn from(value: Value) -> Self {
        match value {
            Value::Bool(value) => Self::Bool(value),
            Value::Int(value) => Self::Int(value),
            Value::Double(value) => Self::Double(value),
        }
    }
}

/// Why a value is not accepted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RefusalReason {
    /// The component has no such property; what it has.
    #[error("the component has no such property")]
    Unknown(String),
    /// It has another type.
    #[error("this is {0}, but a {1} is expected")]
    Type(&'static str, Shape),
    /// The array has another length.
    #[error("the array has {0} elements, but {1} are expected")]
    Length(usize, u32),
    /// The text is no number, or has another unit.
    #[error("{0}")]
    Unit(String),
    /// NaN or infinite.
    #[error("the value is not finite")]
    NotFinite,
    /// Out of its range.
    #[error("{value} is not in the range {low} to {high}{}", suffix(.quantity))]
    #[expect(missing_docs, reason = "named in the text")]
    Range {
        value: f64,
        low: f64,
        high: f64,
        quantity: Quantity,
    },
    /// More than 32 bits with sign.
    #[error("{0} does not fit into an int")]
    TooLarge(u32),
    /// A struct where a value is expected.
    #[error("this is a struct, but a value is expected")]
    Struct,
    /// It cannot change in this state.
    #[error("it cannot change while the component is {0}")]
    NotLive(Phase),
    /// It has no value.
    #[error("it has neither a value nor a default")]
    Missing,
}

fn suffix(quantity: &Quantity) -> String {
    match quantity {
        Quantity::Of(dimension) => format!(" {dimension}"),
        Quantity::Any | Quantity::Number => String::new(),
    }
}

impl RefusalReason {
    /// What to do.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Unknown(hint) => hint.clone(),
            Self::Type(_, shape) => match (shape.len, shape.kind) {
                (Some(_), _) => "write an array such as `[1, 2, 3]`".to_owned(),
                (None, Kind::Bool) => "write `true` or `false`".to_owned(),
                (None, Kind::Int) => "write a whole number without unit".to_owned(),
                (None, Kind::Double) => "write a number such as `0.5`".to_owned(),
                (None, Kind::Text) => "write a text in quotes".to_owned(),
            },
            Self::Length(..) => "write one value for each element".to_owned(),
            Self::Unit(_) => {
                "write a number such as `0.5`, or one with a unit such as `'30deg'`".to_owned()
            }
            Self::NotFinite => "write a finite number".to_owned(),
            Self::Range { .. } => "write a value of that range".to_owned(),
            Self::TooLarge(_) => "the largest int is 2147483647".to_owned(),
            Self::Struct => "write the value itself".to_owned(),
            Self::NotLive(_) => {
                "stop the component first, or declare the property `live`".to_owned()
            }
            Self::Missing => "set it, or declare a `default`".to_owned(),
        }
    }
}

/// A refused change: every property and why. Nothing was changed.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// Property and reason, in the order of the request.
    pub reasons: Vec<(String, RefusalReason)>,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (property, reason)) in self.reasons.iter().enumerate() {
            if i > 0 {
                f.write_str("\n")?;
            }
            write!(
                f,
                "property `{property}`: {reason}\nhint: {}",
                reason.hint()
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for Refusal {}

/// The values of all properties of a component, in the order of their declaration. A property without default has none
/// until it is set.
#[derive(Clone, Debug, PartialEq)]
pub struct Configuration {
    values: Vec<Option<Data>>,
}

impl Configuration {
    /// The defaults of a component.
    #[must_use]
    pub fn of(component: &Component) -> Self {
        let values = component.properties.iter().map(|p| p.default.clone());
        Self {
            values: values.collect(),
        }
    }

    /// The values, in the order of declaration.
    #[must_use]
    pub fn values(&self) -> &[Option<Data>] {
        &self.values
    }

    /// Sets several properties: all of them, or none. Unless the component is stopped or not loaded, only live properties
    /// may change; a value that stays the same is no change.
    ///
    /// # Errors
    /// If one of them is refused; nothing is changed then.
    pub fn set(
        &mut self,
        component: &Component,
        phase: Phase,
        changes: impl IntoIterator<Item = (String, Data)>,
    ) -> Result<(), Refusal> {
        let changes = changes.into_iter().map(|(name, data)| (name, Ok(data)));
        self.set_all(component, phase, changes)
    }

    /// Sets the properties of a file: all of them, or none. See [`Self::set`].
    ///
    /// # Errors
    /// If one of them is refused; nothing is changed then.
    pub fn apply(
        &mut self,
        component: &Component,
        phase: Phase,
        file: &PropertyFile,
    ) -> Result<(), Refusal> {
        let changes = file.nodes.iter();
        let changes = changes.map(|node| (node.name.clone(), Data::of_node(node)));
        self.set_all(component, phase, changes)
    }

    fn set_all(
        &mut self,
        component: &Component,
        phase: Phase,
        changes: impl Iterator<Item = (String, Result<Data, RefusalReason>)>,
    ) -> Result<(), Refusal> {
        let mut values = self.values.clone();
        let mut reasons = Vec::new();
        for (name, data) in changes {
            let properties = &component.properties;
            let Some(index) = properties.iter().position(|p| p.declared.name == name) else {
                let known = properties.iter().map(|p| p.declared.name.as_str());
                let reason = RefusalReason::Unknown(suggest(&name, known));
                reasons.push((name, reason));
                continue;
            };
            let (Some(property), Some(value)) = (properties.get(index), values.get_mut(index))
            else {
                continue;
            };
            match data.and_then(|data| data.fitting(&property.declared)) {
                Ok(data) if value.as_ref() == Some(&data) => {}
                Ok(_)
                    if !property.live
                        && !matches!(phase, Phase::PreOperational | Phase::Stopped) =>
                {
                    reasons.push((name, RefusalReason::NotLive(phase)));
                }
                Ok(data) => *value = Some(data),
                Err(reason) => reasons.push((name, reason)),
            }
        }
        if !reasons.is_empty() {
            return Err(Refusal { reasons });
        }
        self.values = values;
        Ok(())
    }

    /// Checks that every property has a value, which `configure` requires.
    ///
    /// # Errors
    /// The properties without value.
    pub fn check_complete(&self, component: &Component) -> Result<(), Refusal> {
        let missing = component.properties.iter().zip(&self.values);
        let missing = missing.filter(|(_, value)| value.is_none());
        let reasons: Vec<_> = missing
            .map(|(property, _)| (property.declared.name.clone(), RefusalReason::Missing))
            .collect();
        if reasons.is_empty() {
            return Ok(());
        }
        Err(Refusal { reasons })
    }

    /// As a property file, with the descriptions of the properties.
    #[must_use]
    pub fn to_file(&self, component: &Component) -> PropertyFile {
        let values = component.properties.iter().zip(&self.values);
        let nodes = values.filter_map(|(property, value)| {
            Some(Node {
                name: property.declared.name.clone(),
                description: property.declared.doc.clone(),
                body: value.as_ref()?.to_body(),
                at: 0..0,
            })
        });
        let mut file = PropertyFile {
            nodes: nodes.collect(),
        };
        file.nodes
            .retain(|node| !matches!(&node.body, Body::Struct(kind, _) if kind == BAG));
        file
    }
}
