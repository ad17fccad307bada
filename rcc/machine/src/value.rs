//! Values of properties, ports and variables, their types, ranges and units. Values are SI; units are converted where a
//! text is read.

use std::fmt;

use takt_net::Element;

/// The kind of a single value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// `true` or `false`.
    Bool,
    /// A whole number of 32 bits.
    Int,
    /// A number of 64 bits.
    Double,
    /// A text; properties only.
    Text,
}

impl Kind {
    /// The name in files.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Int => "int",
            Self::Double => "double",
            Self::Text => "string",
        }
    }

    /// The kind of that name.
    #[must_use]
    pub fn of(word: &str) -> Option<Self> {
        [Self::Bool, Self::Int, Self::Double, Self::Text]
            .into_iter()
            .find(|kind| kind.word() == word)
    }

    /// The type of a value in a net.
    #[must_use]
    pub const fn element(self) -> Option<Element> {
        match self {
            Self::Bool => Some(Element::Bool),
            Self::Int => Some(Element::Int),
            Self::Double => Some(Element::Double),
            Self::Text => None,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A kind, or a fixed array of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Shape {
    /// The kind of each element.
    pub kind: Kind,
    /// Elements of an array.
    pub len: Option<u32>,
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.len {
            Some(len) => write!(f, "{}[{len}]", self.kind),
            None => write!(f, "{}", self.kind),
        }
    }
}

/// A single value that a machine computes with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// `true` or `false`.
    Bool(bool),
    /// A whole number.
    Int(i32),
    /// A number, SI.
    Double(f64),
}

impl Value {
    /// Its kind.
    #[must_use]
    pub const fn kind(self) -> Kind {
        match self {
            Self::Bool(_) => Kind::Bool,
            Self::Int(_) => Kind::Int,
            Self::Double(_) => Kind::Double,
        }
    }

    /// The first value of a kind: false or 0; null for texts.
    #[must_use]
    pub const fn zero(kind: Kind) -> Option<Self> {
        match kind {
            Kind::Bool => Some(Self::Bool(false)),
            Kind::Int => Some(Self::Int(0)),
            Kind::Double => Some(Self::Double(0.0)),
            Kind::Text => None,
        }
    }

    /// As a word of a net's in-box.
    #[must_use]
    pub const fn word(self) -> u64 {
        match self {
            Self::Bool(value) => value as u64,
            Self::Int(value) => value.cast_unsigned() as u64,
            Self::Double(value) => value.to_bits(),
        }
    }

    /// The value in a word of a net's out-box; none for texts.
    #[must_use]
    pub const fn of_word(kind: Kind, word: u64) -> Option<Self> {
        match kind {
            Kind::Bool => Some(Self::Bool(word != 0)),
            #[expect(
                clippy::cast_possible_truncation,
                reason = "an int is stored as its 32 bits"
            )]
            Kind::Int => Some(Self::Int((word as u32).cast_signed())),
            Kind::Double => Some(Self::Double(f64::from_bits(word))),
            Kind::Text => None,
        }
    }

    /// As a number.
    #[must_use]
    pub fn number(self) -> Option<f64> {
        match self {
            Self::Bool(_) => None,
            Self::Int(value) => Some(f64::from(value)),
            Self::Double(value) => Some(value),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(value) => value.fmt(f),
            Self::Int(value) => value.fmt(f),
            Self::Double(value) => write!(f, "{value:?}"),
        }
    }
}
