//! XML of an ESI file as a tree of elements with their lines, bounded in size and depth. It knows no schema: vendors deviate from it.

use anyhow::{Context as _, bail, ensure};
use quick_xml::escape::resolve_xml_entity;
use quick_xml::events::Event;
use quick_xml::{Reader, XmlVersion};

/// Most elements of a file, and deepest nesting.
const NODES_MAX: usize = 4_000_000;
const DEPTH_MAX: usize = 64;

/// An element with what is inside.
#[derive(Debug, Default)]
pub(super) struct Node {
    pub(super) name: String,
    /// Line of its start tag, from 1.
    pub(super) line: u32,
    pub(super) attributes: Vec<(String, String)>,
    pub(super) text: String,
    pub(super) children: Vec<Node>,
}

impl Node {
    pub(super) fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    pub(super) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The elements at the end of a path.
    pub(super) fn path(&self, path: &[&str]) -> Vec<&Self> {
        let Some((first, rest)) = path.split_first() else {
            return vec![self];
        };
        let inside = self.children.iter().filter(|child| child.name == *first);
        inside.flat_map(|child| child.path(rest)).collect()
    }

    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|(key, _)| key == name);
        found.map(|(_, value)| value.as_str())
    }

    pub(super) fn is_set(&self, name: &str) -> bool {
        matches!(self.attribute(name), Some("1" | "true"))
    }

    pub(super) fn text_of(&self, name: &str) -> String {
        let child = self.child(name);
        child.map_or_else(String::new, |child| child.text.trim().to_owned())
    }

    /// The English one of several texts, or the first.
    pub(super) fn english(&self, name: &str) -> String {
        let english = self
            .all(name)
            .find(|it| it.attribute("LcId") == Some("1033"));
        let found = english.or_else(|| self.child(name));
        found.map_or_else(String::new, |it| it.text.trim().to_owned())
    }

    /// The number in an element; 0 without the element.
    pub(super) fn number_of<T: TryFrom<u64> + Default>(&self, name: &str) -> anyhow::Result<T> {
        let Some(child) = self.child(name) else {
            return Ok(T::default());
        };
        let (text, bytes) = (child.text.trim(), size_of::<T>());
        let value = number(text).and_then(|value| T::try_from(value).ok());
        value.with_context(|| {
            format!(
                "line {}: {name} in {}: `{text}` is no number of {bytes} bytes",
                child.line, self.name
            )
        })
    }
}

/// A number of an ESI file: `#x1A00` or decimal.
pub(super) fn number(text: &str) -> Option<u64> {
    let text = text.trim();
    let prefixes = ["#x", "#X", "0x", "0X"];
    let hex = prefixes.iter().find_map(|it| text.strip_prefix(it));
    hex.map_or_else(
        || text.parse().ok(),
        |hex| u64::from_str_radix(hex, 16).ok(),
    )
}

pub(super) fn tree(text: &str) -> anyhow::Result<Node> {
    let mut reader = Reader::from_str(text);
    let mut stack = vec![Node::default()];
    let mut nodes = 0;
    let (mut line, mut counted) = (1, 0);
    loop {
        let at = usize::try_from(reader.buffer_position()).unwrap_or(usize::MAX);
        let passed = text.as_bytes().get(counted..at).unwrap_or_default();
        line += u32::try_from(passed.iter().filter(|byte| **byte == b'\n').count())?;
        counted = at;
        let event = reader
            .read_event()
            .with_context(|| format!("line {line}, at byte {}", reader.error_position()))?;
        match event {
            Event::Start(start) | Event::Empty(start) if stack.len() > DEPTH_MAX => {
                let name = start.name();
                bail!("{} is nested too deeply", name.as_ref())
            }
            Event::Start(start) => {
                nodes += 1;
                stack.push(node(&start, line)?);
            }
            Event::Empty(start) => {
                nodes += 1;
                if let Some(parent) = stack.last_mut() {
                    parent.children.push(node(&start, line)?);
                }
            }
            Event::End(_) => {
                let done = stack.pop().unwrap_or_default();
                let parent = stack
                    .last_mut()
                    .context("an element ends that never began")?;
                parent.children.push(done);
            }
            Event::Text(text) => {
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::CData(text) => {
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::Eof => break,
            Event::GeneralRef(entity) => {
                let named = || resolve_xml_entity(&entity).map(str::to_owned);
                let text = entity.resolve_char_ref()?.map(String::from).or_else(named);
                let text = text.with_context(|| format!("unknown entity &{};", &*entity))?;
                if let Some(node) = stack.last_mut() {
                    node.text.push_str(&text);
                }
            }
            Event::Comment(_) | Event::Decl(_) | Event::PI(_) | Event::DocType(_) => {}
        }
        ensure!(nodes <= NODES_MAX, "more than {NODES_MAX} elements");
    }
    ensure!(stack.len() == 1, "the file ends within an element");
    Ok(stack.pop().unwrap_or_default())
}

fn node(start: &quick_xml::events::BytesStart<'_>, line: u32) -> anyhow::Result<Node> {
    let mut attributes = Vec::new();
    for attribute in start.attributes().take(64) {
        let attribute = attribute?;
        let key = attribute.key.as_ref().to_owned();
        let value = attribute.normalized_value(XmlVersion::Implicit1_0)?;
        attributes.push((key, value.into_owned()));
    }
    Ok(Node {
        name: start.name().as_ref().to_owned(),
        line,
        attributes,
        ..Node::default()
    })
}
