//! What a property file holds, apart from its form.

use std::ops::Range;

use crate::diagnostic::Diagnostics;

/// Largest property file, bytes.
pub const BYTES_MAX: usize = 1 << 20;
/// Most properties and structs in a file.
pub const NODES_MAX: usize = 10_000;
/// Deepest nesting of structs.
pub const DEPTH_MAX: usize = 16;

/// A property file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PropertyFile {
    /// The properties, in the order of the file.
    pub nodes: Vec<Node>,
}

/// A property or a struct.
#[derive(Clone, Debug)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// What it is for; may be empty.
    pub description: String,
    /// Its value or members.
    pub body: Body,
    /// The bytes of the file that define it; not compared.
    pub at: Range<usize>,
}

impl PartialEq for Node {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name && self.description == other.description && self.body == other.body
    }
}

/// What a node holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// One value.
    Simple(Simple),
    /// A struct with its type, usually `PropertyBag`; type `array` has members `Element0`, `Element1`, ….
    Struct(String, Vec<Node>),
}

/// The type of a struct without another one.
pub const BAG: &str = "PropertyBag";
/// The type of a struct that is an array.
pub const ARRAY: &str = "array";

/// A value with the type that Orocos gives it.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "the names of the types in .cpf files")]
pub enum Simple {
    Boolean(bool),
    Char(char),
    Uchar(u8),
    Short(i16),
    Ushort(u16),
    Long(i32),
    Ulong(u32),
    Float(f32),
    Double(f64),
    String(String),
}

/// Numbers are compared by their bits, except that all NaN are equal.
impl PartialEq for Simple {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Double(a), Self::Double(b)) => {
                a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
            }
            (Self::Float(a), Self::Float(b)) => {
                a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
            }
            _ => self.word() == other.word() && self.text() == other.text(),
        }
    }
}

impl Simple {
    /// The names of the types.
    pub const WORDS: [&str; 10] = [
        "boolean", "char", "uchar", "short", "ushort", "long", "ulong", "float", "double", "string",
    ];

    /// The name of its type.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Boolean(_) => "boolean",
            Self::Char(_) => "char",
            Self::Uchar(_) => "uchar",
            Self::Short(_) => "short",
            Self::Ushort(_) => "ushort",
            Self::Long(_) => "long",
            Self::Ulong(_) => "ulong",
            Self::Float(_) => "float",
            Self::Double(_) => "double",
            Self::String(_) => "string",
        }
    }

    /// The value as text, exact.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::Boolean(value) => if *value { "1" } else { "0" }.to_owned(),
            Self::Char(value) => value.to_string(),
            Self::Uchar(value) => value.to_string(),
            Self::Short(value) => value.to_string(),
            Self::Ushort(value) => value.to_string(),
            Self::Long(value) => value.to_string(),
            Self::Ulong(value) => value.to_string(),
            Self::Float(value) => format!("{value:?}"),
            Self::Double(value) => format!("{value:?}"),
            Self::String(value) => value.clone(),
        }
    }

    /// Reads a value of the type of that name; the error is a sentence about what is expected.
    pub(super) fn parse(word: &str, text: &str) -> Result<Self, String> {
        fn number<T: std::str::FromStr>(text: &str, expected: &str) -> Result<T, String> {
            text.trim().parse().map_err(|_| expected.to_owned())
        }
        Ok(match word {
            "boolean" => Self::Boolean(match text.trim() {
                "1" | "true" => true,
                "0" | "false" => false,
                _ => return Err("`1` or `0`".to_owned()),
            }),
            "char" => {
                let mut chars = text.chars();
                match (chars.next(), chars.next()) {
                    (Some(value), None) => Self::Char(value),
                    _ => return Err("one character".to_owned()),
                }
            }
            "uchar" => Self::Uchar(number(text, "a whole number, 0 to 255")?),
            "short" => Self::Short(number(text, "a whole number, -32768 to 32767")?),
            "ushort" => Self::Ushort(number(text, "a whole number, 0 to 65535")?),
            "long" => Self::Long(number(text, "a whole number of 32 bits")?),
            "ulong" => Self::Ulong(number(text, "a whole number, 0 to 4294967295")?),
            "float" => {
                let value: f32 = number(text, "a number such as 0.5")?;
                if value.is_infinite() && !text.contains("inf") {
                    return Err("a number that fits into 32 bits".to_owned());
                }
                Self::Float(value)
            }
            "double" => {
                let value: f64 = number(text, "a number such as 0.5")?;
                if value.is_infinite() && !text.contains("inf") {
                    return Err("a number that fits into 64 bits".to_owned());
                }
                Self::Double(value)
            }
            "string" => Self::String(text.to_owned()),
            _ => return Err(format!("one of the types {}", Self::WORDS.join(", "))),
        })
    }
}

/// A text that XML cannot represent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "property `{property}`: XML cannot represent the character U+{:04X}\nhint: remove the character, or \
     write TOML", u32::from(*.character)
)]
pub struct Unwritable {
    /// The property.
    pub property: String,
    /// The character.
    pub character: char,
}

/// Reports a second member of the same name.
pub(super) fn check_twice(nodes: &[Node], node: &Node, found: &mut Diagnostics) {
    if nodes.iter().any(|earlier| earlier.name == node.name) {
        found.error(
            node.at.clone(),
            format!("property `{}` is given twice", node.name),
            "remove one of them",
        );
    }
}

/// Whether a struct is an array that TOML can write as one: plain elements of one type.
pub(super) fn plain_elements(members: &[Node]) -> Option<Vec<&Simple>> {
    let mut elements: Vec<&Simple> = Vec::new();
    for (number, member) in members.iter().enumerate() {
        let Body::Simple(value) = &member.body else {
            return None;
        };
        let is_plain = matches!(
            value,
            Simple::Boolean(_) | Simple::Long(_) | Simple::Double(_) | Simple::String(_)
        );
        let same = elements
            .first()
            .is_none_or(|first| first.word() == value.word());
        let named = member.name == format!("Element{number}");
        if !is_plain || !same || !named || !member.description.is_empty() {
            return None;
        }
        elements.push(value);
    }
    Some(elements)
}
