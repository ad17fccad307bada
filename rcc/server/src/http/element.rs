//! Tree of elements with attributes, text and children that resources are built from, written as XML or JSON. The
//! meaning of the elements is not defined here.

use std::fmt;
use std::time::Duration;

use quick_xml::escape::escape;
use serde_json::{Map, Value};
use takt_core::controller::{NetState, RuleId};
use takt_core::net::Type;
use takt_core::net::value::text::to_json;
use takt_core::stop_channel::Origin;
use takt_core::{NetId, SessionId};

/// A named node of a resource.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, String, bool)>,
    text: String,
    /// Whether the text is a value of a net.
    is_value: bool,
    children: Vec<Self>,
}

impl Element {
    pub(super) fn new(name: &'static str) -> Self {
        Self {
            name,
            ..Self::default()
        }
    }

    /// Adds an attribute.
    pub(super) fn with<A: Attribute>(mut self, name: &'static str, value: A) -> Self {
        self.attributes.push((name, value.to_string(), A::IS_VALUE));
        self
    }

    /// Sets the text to a value of a net, which JSON also has as `value`: numbers are numbers there.
    pub(super) fn value(self, text: impl Into<String>) -> Self {
        Self {
            is_value: true,
            ..self.text(text)
        }
    }

    /// Sets the text.
    pub(super) fn text(mut self, text: impl Into<String>) -> Self {
        self.text = text.into();
        self
    }

    /// Adds children.
    pub(super) fn containing(mut self, children: impl IntoIterator<Item = Self>) -> Self {
        self.children.extend(children);
        self
    }

    pub(super) fn to_xml(&self) -> String {
        let mut out = "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n".to_owned();
        self.write_xml(&mut out, 0);
        out
    }

    fn write_xml(&self, out: &mut String, depth: usize) {
        let (indent, name) = ("  ".repeat(depth), self.name);
        out.push_str(&format!("{indent}<{name}"));
        for (name, value, _) in &self.attributes {
            out.push_str(&format!(" {name}=\"{}\"", escaped(value)));
        }
        if self.text.is_empty() && self.children.is_empty() {
            out.push_str("/>\n");
            return;
        }
        out.push_str(&format!(">{}", escaped(&self.text)));
        if !self.children.is_empty() {
            out.push('\n');
            self.children
                .iter()
                .for_each(|c| c.write_xml(out, depth + 1));
            out.push_str(&indent);
        }
        out.push_str(&format!("</{name}>\n"));
    }

    /// An object of the attributes, `text`, and a list for each name of children.
    pub(super) fn to_json(&self) -> String {
        self.json().to_string()
    }

    fn json(&self) -> Value {
        let mut object = Map::new();
        for (name, text, is_value) in &self.attributes {
            let value = if *is_value {
                of_value(text)
            } else {
                text.as_str().into()
            };
            object.insert((*name).to_owned(), value);
        }
        if self.is_value {
            object.insert("value".to_owned(), of_value(&self.text));
        }
        if !self.text.is_empty() {
            object.insert("text".to_owned(), self.text.as_str().into());
        }
        for child in &self.children {
            let list = object
                .entry(child.name)
                .or_insert_with(|| Value::Array(Vec::new()));
            if let Value::Array(list) = list {
                list.push(child.json());
            } else {
                // The attribute would hide the children.
                debug_assert!(false, "`{}` is an attribute and a child", child.name);
            }
        }
        Value::Object(object)
    }
}

/// What an attribute can be.
pub(super) trait Attribute: fmt::Display {
    /// Whether JSON has it as a number, Boolean, list or object rather than as text.
    const IS_VALUE: bool = false;
}

impl<A: Attribute + ?Sized> Attribute for &A {
    const IS_VALUE: bool = A::IS_VALUE;
}

/// Implements it for types.
macro_rules! attributes {
    ($is_value:literal: $($kind:ty),+) => {
        $(impl Attribute for $kind {
            const IS_VALUE: bool = $is_value;
        })+
    };
}

attributes!(false: str, String, NetId, NetState, Origin, SessionId, Type);
attributes!(true: bool, u8, u16, u32, i32, u64, usize, f64, Millis, NetValue, RuleId);

/// A time, in ms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Millis(pub(super) Duration);

impl fmt::Display for Millis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6}", self.0.as_secs_f64() * 1e3)
    }
}

/// The text of a value of a net.
#[derive(Clone, Debug)]
pub(super) struct NetValue(pub(super) String);

impl fmt::Display for NetValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The JSON of a value's text.
pub(super) fn of_value(text: &str) -> Value {
    let json = to_json(text).and_then(|json| serde_json::from_str(&json).ok());
    json.unwrap_or_else(|| text.into())
}

/// The text escaped for XML, without the characters that XML cannot represent.
fn escaped(text: &str) -> String {
    let allowed = |c: &char| !c.is_control() || matches!(c, '\n' | '\r' | '\t');
    escape(text.chars().filter(allowed).collect::<String>()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn xml_and_json_hold_the_same() {
        let rule = |id: u32| Element::new("rule").with("id", id).text("a<\u{1}b");
        let net = Element::new("net")
            .with("desc", "\"x\" & y")
            .containing([rule(1), rule(2)]);
        let xml = "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n\
            <net desc=\"&quot;x&quot; &amp; y\">\n  <rule id=\"1\">a&lt;b</rule>\n  \
            <rule id=\"2\">a&lt;b</rule>\n</net>\n";
        assert_eq!(net.to_xml(), xml);
        let json = r#"{"desc":"\"x\" & y","rule":[{"id":1,"text":"a<\u0001b"},{"id":2,"text":"a<\u0001b"}]}"#;
        assert_eq!(net.to_json(), json);
    }

    #[test]
    fn json_numbers_are_numbers() {
        let element = Element::new("net")
            .with("name", "5")
            .with("cycles", 7_u64)
            .with("max", Millis(Duration::from_micros(1)))
            .with("needed", true)
            .with("at", NetValue("{x:1}".to_owned()))
            .value("[1,nan]");
        let json = r#"{"at":{"x":1},"cycles":7,"max":0.001,"name":"5","needed":true,"text":"[1,nan]","value":[1,"nan"]}"#;
        assert_eq!(element.to_json(), json);
    }
}
