//! The `.cpf` form of property files: the XML of Orocos, after its `cpf.dtd`: `properties`, `struct`, `simple`, `description`,
//! `value`, and `sequence` read as a struct. Document types are not loaded, entities of them are not known.

use std::ops::Range;

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::node::{
    BAG, BYTES_MAX, Body, DEPTH_MAX, NODES_MAX, Node, PropertyFile, Simple, check_twice,
};
use crate::diagnostic::{Diagnostics, suggest};

pub(super) fn read(text: &str) -> Result<PropertyFile, Diagnostics> {
    let mut found = Diagnostics::default();
    if text.len() > BYTES_MAX {
        let cause = format!(
            "the file has {} bytes; at most {BYTES_MAX} are allowed",
            text.len()
        );
        found.error(0..0, cause, "split it");
        return Err(found);
    }
    let mut reader = Reader::from_str(text);
    reader.config_mut().expand_empty_elements = true;
    let mut file = File {
        open: Vec::new(),
        done: None,
        nodes: 0,
        found,
    };
    loop {
        let from = position(reader.buffer_position(), text);
        match reader.read_event() {
            Ok(Event::Eof) => break,
            Ok(event) => {
                let at = from..position(reader.buffer_position(), text);
                if file.handle(event, at).is_none() {
                    break;
                }
            }
            Err(error) => {
                let at = position(reader.error_position(), text);
                let hint = "the element before it, or this one, is not closed or not well-formed";
                file.found
                    .error(at..at, format!("malformed XML: {error}"), hint);
                break;
            }
        }
        if file.found.is_full() {
            break;
        }
    }
    if !file.found.has_errors() && (!file.open.is_empty() || file.done.is_none()) {
        let end = text.len();
        let (cause, hint) = match file.open.last() {
            Some(open) => (
                format!("`<{}>` is not closed", open.word()),
                format!("add `</{}>`", open.word()),
            ),
            None => (
                "the file has no `<properties>`".to_owned(),
                "properties stand between `<properties>` and `</properties>`".to_owned(),
            ),
        };
        file.found.error(end..end, cause, hint);
    }
    let nodes = file.done;
    file.found
        .or(nodes.map(|nodes| PropertyFile { nodes }))
        .map(|(file, _)| file)
}

fn position(bytes: u64, text: &str) -> usize {
    usize::try_from(bytes).unwrap_or(text.len()).min(text.len())
}

/// An open element with what was read of it.
enum Open {
    Properties(Vec<Node>),
    Struct {
        node: Head,
        kind: String,
        members: Vec<Node>,
    },
    Simple {
        node: Head,
        kind: String,
        value: Option<String>,
    },
    /// `description` or `value`.
    Leaf {
        is_value: bool,
        text: String,
    },
    /// An element that is not known, already reported.
    Unknown,
}

struct Head {
    name: String,
    description: String,
    at: Range<usize>,
}

impl Open {
    const fn word(&self) -> &'static str {
        match self {
            Self::Properties(_) => "properties",
            Self::Struct { .. } => "struct",
            Self::Simple { .. } => "simple",
            Self::Leaf { is_value: true, .. } => "value",
            Self::Leaf { .. } => "description",
            Self::Unknown => "…",
        }
    }
}

struct File {
    open: Vec<Open>,
    done: Option<Vec<Node>>,
    nodes: usize,
    found: Diagnostics,
}

impl File {
    /// `None` if the rest of the file cannot be read.
    fn handle(&mut self, event: Event<'_>, at: Range<usize>) -> Option<()> {
        match event {
            Event::Start(start) | Event::Empty(start) => self.begin(&start, at)?,
            Event::End(_) => self.end(at),
            Event::Text(text) => self.text(&text.xml10_content(), at),
            Event::CData(text) => self.text(&text.xml10_content(), at),
            Event::GeneralRef(reference) => {
                let content = reference.xml10_content();
                let predefined = quick_xml::escape::resolve_predefined_entity(&content);
                match (reference.resolve_char_ref(), predefined) {
                    (Ok(Some(c)), _) => self.text(&c.to_string(), at),
                    (_, Some(text)) => self.text(text, at),
                    _ => {
                        let cause = format!("there is no entity `&{content};`");
                        self.found.error(at, cause, "write the character itself");
                    }
                }
            }
            Event::DocType(text) if text.contains('[') => {
                let cause = "a document type with definitions is not accepted";
                self.found.error(at, cause, "remove the part in brackets");
                return None;
            }
            Event::DocType(_) | Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::Eof => {}
        }
        Some(())
    }

    fn text(&mut self, more: &str, at: Range<usize>) {
        match self.open.last_mut() {
            Some(Open::Leaf { text, .. }) => text.push_str(more),
            Some(Open::Unknown) => {}
            Some(_) | None if more.trim().is_empty() => {}
            Some(_) | None => {
                let hint = "text stands in `<value>` or `<description>`";
                self.found.error(at, "text outside a value", hint);
            }
        }
    }

    fn begin(&mut self, start: &BytesStart<'_>, at: Range<usize>) -> Option<()> {
        let word = start.local_name().as_ref().to_owned();
        let open = match (self.open.last(), word.as_str()) {
            (Some(Open::Unknown), _) => Open::Unknown,
            (None, "properties") if self.done.is_none() => Open::Properties(Vec::new()),
            (Some(Open::Properties(_) | Open::Struct { .. }), "struct" | "sequence") => {
                let (name, kind) = self.attributes(start, &at);
                Open::Struct {
                    node: self.head(name, "struct", &at)?,
                    kind: kind.unwrap_or_else(|| BAG.to_owned()),
                    members: Vec::new(),
                }
            }
            (Some(Open::Properties(_) | Open::Struct { .. }), "simple") => {
                let (name, kind) = self.attributes(start, &at);
                let kind = kind.unwrap_or_else(|| {
                    let hint = format!("its type is one of {}", Simple::WORDS.join(", "));
                    self.found
                        .error(at.clone(), "`<simple>` has no `type`", hint);
                    "string".to_owned()
                });
                Open::Simple {
                    node: self.head(name, "simple", &at)?,
                    kind,
                    value: None,
                }
            }
            (Some(Open::Simple { .. } | Open::Struct { .. }), "description") => Open::Leaf {
                is_value: false,
                text: String::new(),
            },
            (Some(Open::Simple { .. }), "value") => Open::Leaf {
                is_value: true,
                text: String::new(),
            },
            (inside, _) => {
                let inside = inside.map_or("the document", Open::word);
                let word: String = word.chars().take(40).collect();
                let known = ["properties", "struct", "simple", "description", "value"];
                let cause = format!("`<{word}>` is not allowed inside {inside}");
                self.found.error(at, cause, suggest(&word, known));
                Open::Unknown
            }
        };
        self.open.push(open);
        if self.open.len() > DEPTH_MAX + 2 {
            let (end, cause) = (
                0..0,
                format!("at most {DEPTH_MAX} levels of structs are allowed"),
            );
            self.found.error(end, cause, "use fewer levels");
            return None;
        }
        Some(())
    }

    fn head(&mut self, name: Option<String>, word: &str, at: &Range<usize>) -> Option<Head> {
        self.nodes += 1;
        if self.nodes > NODES_MAX {
            let cause = format!("at most {NODES_MAX} properties are allowed");
            self.found.error(at.clone(), cause, "split the file");
            return None;
        }
        let name = name.unwrap_or_else(|| {
            let cause = format!("`<{word}>` has no `name`");
            let hint = format!("write `<{word} name=\"gain\" …>`");
            self.found.error(at.clone(), cause, hint);
            String::new()
        });
        if name.starts_with('@') {
            let cause = format!("`{name}`: a name does not begin with `@`");
            self.found.error(at.clone(), cause, "choose another name");
        }
        Some(Head {
            name,
            description: String::new(),
            at: at.clone(),
        })
    }

    fn attributes(
        &mut self,
        start: &BytesStart<'_>,
        at: &Range<usize>,
    ) -> (Option<String>, Option<String>) {
        let (mut name, mut kind) = (None, None);
        for attribute in start.attributes() {
            let read = attribute.map_err(|error| error.to_string()).and_then(|a| {
                let value = a.normalized_value(XmlVersion::Implicit1_0);
                let value = value.map_err(|error| error.to_string())?;
                Ok((a.key.as_ref().to_owned(), value.into_owned()))
            });
            match read {
                Ok((key, value)) if key == "name" => name = Some(value),
                Ok((key, value)) if key == "type" => kind = Some(value),
                Ok((key, _)) => {
                    let cause = format!("there is no attribute `{key}`");
                    self.found
                        .error(at.clone(), cause, suggest(&key, ["name", "type"]));
                }
                Err(cause) => {
                    let hint = "an attribute is `name=\"value\"`, once";
                    self.found.error(at.clone(), cause, hint);
                    break;
                }
            }
        }
        (name, kind)
    }

    fn end(&mut self, at: Range<usize>) {
        let node = match self.open.pop() {
            Some(Open::Properties(nodes)) => {
                self.done = Some(nodes);
                return;
            }
            Some(Open::Leaf { is_value, text }) => {
                self.leaf(is_value, text, at);
                return;
            }
            Some(Open::Struct {
                node,
                kind,
                members,
            }) => {
                let at = node.at.start..at.end;
                built(node, Body::Struct(kind, members), at)
            }
            Some(Open::Simple { node, kind, value }) => {
                let text = value.unwrap_or_else(|| {
                    let hint = "add `<value>…</value>`";
                    self.found
                        .error(node.at.clone(), "this property has no value", hint);
                    String::new()
                });
                match Simple::parse(&kind, &text) {
                    Ok(simple) => {
                        let at = node.at.start..at.end;
                        built(node, Body::Simple(simple), at)
                    }
                    Err(expected) => {
                        let text: String = text.chars().take(40).collect();
                        let cause = format!("`{text}` is not a value of type `{kind}`");
                        self.found
                            .error(node.at.start..at.end, cause, format!("write {expected}"));
                        return;
                    }
                }
            }
            Some(Open::Unknown) | None => return,
        };
        if let Some(Open::Properties(nodes) | Open::Struct { members: nodes, .. }) =
            self.open.last_mut()
        {
            check_twice(nodes, &node, &mut self.found);
            nodes.push(node);
        }
    }

    fn leaf(&mut self, is_value: bool, text: String, at: Range<usize>) {
        match (self.open.last_mut(), is_value) {
            (Some(Open::Simple { value, .. }), true) if value.is_none() => *value = Some(text),
            (Some(Open::Simple { .. }), true) => {
                self.found
                    .error(at, "a second `<value>`", "remove one of them");
            }
            (Some(Open::Simple { node, .. } | Open::Struct { node, .. }), false) => {
                node.description = text;
            }
            _ => {}
        }
    }
}

fn built(head: Head, body: Body, at: Range<usize>) -> Node {
    Node {
        name: head.name,
        description: head.description,
        body,
        at,
    }
}
