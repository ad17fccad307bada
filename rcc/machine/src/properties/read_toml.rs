//! The TOML form of property files: a plain value is a `boolean`, `long`, `double` or `string`, an array is a struct of type
//! `array`, a table is a struct. A table with `"@value"` is a value with `"@type"` or `"@description"`.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::node::{ARRAY, BAG, BYTES_MAX, Body, DEPTH_MAX, NODES_MAX, Node, PropertyFile, Simple};
use crate::diagnostic::Diagnostics;

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
    let (table, errors) = DeTable::parse_recoverable(text);
    for error in errors {
        let at = error.span().unwrap_or(0..0);
        let hint = "the format is described on https://toml.io";
        found.error(at, error.message().trim_end().to_owned(), hint);
    }
    if found.has_errors() {
        return Err(found);
    }
    let mut reader = Reader { found, nodes: 0 };
    let nodes = reader.members(table.get_ref(), 0);
    reader
        .found
        .or(Some(PropertyFile { nodes }))
        .map(|(file, _)| file)
}

struct Reader {
    found: Diagnostics,
    nodes: usize,
}

impl Reader {
    /// The members of a table, in the order of the text.
    fn members(&mut self, table: &DeTable<'_>, depth: usize) -> Vec<Node> {
        let mut entries: Vec<_> = table.iter().collect();
        entries.sort_by_key(|(key, _)| key.span().start);
        let mut nodes = Vec::new();
        for (key, value) in entries {
            let name = key.get_ref().as_ref();
            if name.starts_with('@') {
                if depth == 0 || !matches!(name, "@type" | "@description") {
                    let hint = "a property `p` is `p = 1`, or `p = { \"@type\" = \"short\", \"@value\" = 1 }`";
                    self.found
                        .error(key.span(), format!("`{name}` is not allowed here"), hint);
                }
                continue;
            }
            if let Some(node) = self.node(name, key.span(), value, depth + 1) {
                nodes.push(node);
            }
        }
        nodes
    }

    fn node(
        &mut self,
        name: &str,
        at: Range<usize>,
        value: &Spanned<DeValue<'_>>,
        depth: usize,
    ) -> Option<Node> {
        self.nodes += 1;
        if self.nodes > NODES_MAX || depth > DEPTH_MAX {
            let cause = format!("at most {NODES_MAX} properties in {DEPTH_MAX} levels are allowed");
            self.found.error(at, cause, "split the file");
            return None;
        }
        let mut description = String::new();
        let body = match value.get_ref() {
            DeValue::Table(table) => {
                description = self.text(table, "@description").unwrap_or_default();
                let kind = self.text(table, "@type");
                match entry(table, "@value") {
                    Some(inner) => self.typed(table, kind.as_deref(), inner)?,
                    None => {
                        let kind = kind.unwrap_or_else(|| BAG.to_owned());
                        Body::Struct(kind, self.members(table, depth))
                    }
                }
            }
            DeValue::Array(elements) => {
                let elements = elements.iter().enumerate();
                let nodes = elements.filter_map(|(number, element)| {
                    self.node(
                        &format!("Element{number}"),
                        element.span(),
                        element,
                        depth + 1,
                    )
                });
                Body::Struct(ARRAY.to_owned(), nodes.collect())
            }
            DeValue::String(_)
            | DeValue::Integer(_)
            | DeValue::Float(_)
            | DeValue::Boolean(_)
            | DeValue::Datetime(_) => Body::Simple(self.plain(value)?),
        };
        Some(Node {
            name: name.to_owned(),
            description,
            body,
            at,
        })
    }

    fn plain(&mut self, value: &Spanned<DeValue<'_>>) -> Option<Simple> {
        let word = match value.get_ref() {
            DeValue::Boolean(_) => "boolean",
            DeValue::Integer(_) => "long",
            DeValue::Float(_) => "double",
            DeValue::String(_) => "string",
            DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => {
                let cause = "a property has no such type".to_owned();
                self.found
                    .error(value.span(), cause, "write it as a text in quotes");
                return None;
            }
        };
        self.simple(word, value)
    }

    fn simple(&mut self, word: &str, value: &Spanned<DeValue<'_>>) -> Option<Simple> {
        match Simple::parse(word, &text_of(value.get_ref())) {
            Ok(simple) => Some(simple),
            Err(expected) => {
                let cause = format!("this is not a value of type {word}");
                self.found
                    .error(value.span(), cause, format!("write {expected}"));
                None
            }
        }
    }

    /// A table with `"@value"`.
    fn typed(
        &mut self,
        table: &DeTable<'_>,
        kind: Option<&str>,
        value: &Spanned<DeValue<'_>>,
    ) -> Option<Body> {
        for (key, _) in table.iter() {
            let name = key.get_ref().as_ref();
            if !matches!(name, "@value" | "@type" | "@description") {
                let cause = format!("`{name}` stands beside `\"@value\"`");
                let hint = "a value has no members; a struct has no `\"@value\"`";
                self.found.error(key.span(), cause, hint);
            }
        }
        let simple = match (kind, value.get_ref()) {
            (Some("string" | "char"), DeValue::String(_))
            | (Some("boolean"), DeValue::Boolean(_))
            | (Some("float" | "double"), DeValue::Float(_))
            | (
                Some("uchar" | "short" | "ushort" | "long" | "ulong" | "float" | "double"),
                DeValue::Integer(_),
            ) => self.simple(kind?, value)?,
            (Some(kind), _) => {
                let (cause, hint) = if Simple::WORDS.contains(&kind) {
                    (
                        format!("this is not a value of type {kind}"),
                        "write a value of that type".to_owned(),
                    )
                } else {
                    (
                        format!("there is no type `{kind}`"),
                        crate::diagnostic::suggest(kind, Simple::WORDS),
                    )
                };
                self.found.error(value.span(), cause, hint);
                return None;
            }
            (None, _) => self.plain(value)?,
        };
        Some(Body::Simple(simple))
    }

    fn text(&mut self, table: &DeTable<'_>, key: &str) -> Option<String> {
        let value = entry(table, key)?;
        if let DeValue::String(text) = value.get_ref() {
            return Some(text.to_string());
        }
        self.found.error(
            value.span(),
            format!("`{key}` is a text"),
            "put it in quotes",
        );
        None
    }
}

fn entry<'t, 'a>(table: &'t DeTable<'a>, key: &str) -> Option<&'t Spanned<DeValue<'a>>> {
    let mut entries = table.iter();
    entries.find_map(|(name, value)| (name.get_ref() == key).then_some(value))
}

/// A plain value as the text of the other form. Numbers with another base are converted.
fn text_of(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Boolean(value) => value.to_string(),
        DeValue::Integer(value) => match i64::from_str_radix(value.as_str(), value.radix()) {
            Ok(value) => value.to_string(),
            Err(_) => value.as_str().to_owned(),
        },
        DeValue::Float(value) => value.as_str().to_owned(),
        DeValue::String(value) => value.to_string(),
        DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => String::new(),
    }
}
