//! Tree of elements with attributes, text and children that resources are built from, written as XML or JSON. The
//! meaning of the elements is not defined here.

use quick_xml::escape::escape;
use serde_json::{Map, Value};

/// A named node of a resource.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Element {
    name: &'static str,
    attributes: Vec<(&'static str, String)>,
    text: String,
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
    pub(super) fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.attributes.push((name, value.to_string()));
        self
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
        for (name, value) in &self.attributes {
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
        for (name, value) in &self.attributes {
            object.insert((*name).to_owned(), value.as_str().into());
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
            }
        }
        Value::Object(object)
    }
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
        let json = r#"{"desc":"\"x\" & y","rule":[{"id":"1","text":"a<\u0001b"},{"id":"2","text":"a<\u0001b"}]}"#;
        assert_eq!(net.to_json(), json);
    }
}
