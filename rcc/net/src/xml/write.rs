//! Net text to XML. Inline primitives become named children.

use std::collections::HashSet;

use quick_xml::escape::escape;

use super::ROOT;
use crate::fault::Rejection;
use crate::limits::Limits;
use crate::text::{self, Arg, ArgValue, Body, Fragment, Node, SourceOf};

/// Converts a net text to its XML form.
pub fn to_xml(text: &str, limits: &Limits) -> Result<String, Rejection> {
    let mut faults = Vec::new();
    let root = text::parse(text, limits, &mut faults);
    if !faults.is_empty() {
        return Err(Rejection { faults });
    }
    let mut out = "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<rpinet>\n".to_owned();
    Scope::new(&root, ROOT).fragment(&root, &mut out);
    out.push_str("</rpinet>\n");
    Ok(out)
}

/// Longest name that becomes part of the name of an inline primitive.
const NAME_BYTES_MAX: usize = 200;

/// The content of one fragment: its name, and the names of its children.
struct Scope<'a> {
    id: &'a str,
    taken: HashSet<String>,
    /// Number of previous uses of a name.
    clashes: usize,
}

impl<'a> Scope<'a> {
    fn new(fragment: &Fragment<'_>, id: &'a str) -> Self {
        let children = fragment.children.iter();
        let taken = children.map(|c| c.name.text.to_owned()).collect();
        Self {
            id,
            taken,
            clashes: 0,
        }
    }

    fn fragment(&mut self, fragment: &Fragment<'_>, out: &mut String) {
        for child in &fragment.children {
            let name = self.child(child.name.text);
            self.node(&name, &child.node, out);
        }
        for port in &fragment.outs {
            self.arg("outport", port.name.text, port, out);
        }
    }

    /// A child with the name of its fragment would be ambiguous.
    fn child(&mut self, name: &str) -> String {
        if name == self.id {
            format!("{name}.child")
        } else {
            name.to_owned()
        }
    }

    /// Writes a primitive or fragment, preceded by the inline primitives of its arguments.
    fn node(&mut self, id: &str, node: &Node<'_>, out: &mut String) {
        let mut args = String::new();
        let (element, port) = match &node.body {
            Body::Primitive(_) => ("module", "port"),
            Body::Fragment(_) => ("fragment", "inport"),
        };
        let mut before = String::new();
        for arg in &node.args {
            let inline_name = inline_name(id, arg.name.text);
            self.arg_to(port, &inline_name, arg, &mut args, &mut before);
        }
        out.push_str(&before);
        out.push_str(&format!("<{element}{}", attribute("id", id)));
        match &node.body {
            Body::Primitive(ty) => {
                out.push_str(&format!("{}>\n", attribute("type", ty.text)));
            }
            Body::Fragment(fragment) => {
                out.push_str(">\n");
                Scope::new(fragment, id).fragment(fragment, out);
            }
        }
        out.push_str(&format!("{args}</{element}>\n"));
    }

    fn arg(&mut self, element: &str, inline_name: &str, arg: &Arg<'_>, out: &mut String) {
        let (mut args, mut before) = (String::new(), String::new());
        self.arg_to(element, inline_name, arg, &mut args, &mut before);
        out.push_str(&before);
        out.push_str(&args);
    }

    /// Writes an argument to `out` and its inline primitives to `before`.
    fn arg_to(
        &mut self,
        element: &str,
        inline_name: &str,
        arg: &Arg<'_>,
        out: &mut String,
        before: &mut String,
    ) {
        let name = attribute("name", arg.name.text);
        let source = match &arg.value {
            ArgValue::Text(value, _) => {
                let value = attribute("value", value);
                out.push_str(&format!("<parameter{name}{value}/>\n"));
                return;
            }
            ArgValue::Link(source) => source,
        };
        let from = match &source.of {
            SourceOf::Child(child) if child.text == "parent" => self.id.to_owned(),
            SourceOf::Child(child) => self.child(child.text),
            SourceOf::Inline(node) => {
                let id = self.unused(format!("{inline_name}.source"));
                self.node(&id, node, before);
                id
            }
        };
        let (from, port) = (
            attribute("frommodule", &from),
            attribute("fromport", source.port.text),
        );
        let debug = arg.debug_s.map(|s| attribute("debug", &s.to_string()));
        let debug = debug.unwrap_or_default();
        out.push_str(&format!("<{element}{name}{from}{port}{debug}/>\n"));
    }

    /// A name that no sibling has, even with its dots replaced by underscores.
    fn unused(&mut self, name: String) -> String {
        let mut unused = name.clone();
        while !self.taken.insert(unused.replace('.', "_")) {
            let number = match self.clashes {
                0 => String::new(),
                clashes => clashes.to_string(),
            };
            self.clashes += 1;
            unused = format!("{name}_{number}");
        }
        unused
    }
}

/// A name for an inline primitive of an argument; its length is bounded whatever the depth and the
/// length of names.
fn inline_name(id: &str, arg: &str) -> String {
    match (id.len() > NAME_BYTES_MAX, arg.len() > NAME_BYTES_MAX) {
        (false, false) => format!("{id}.{arg}"),
        (true, false) => format!("inline.{arg}"),
        (_, true) => "inline".to_owned(),
    }
}

/// An attribute whose value reads back unchanged: whitespace that XML would normalise is kept.
fn attribute(name: &str, value: &str) -> String {
    let value = escape(value);
    let value = value.replace('\n', "&#10;").replace('\r', "&#13;");
    format!(" {name}=\"{}\"", value.replace('\t', "&#9;"))
}
