//! Property files to text. Whatever is written can be read again with the same result.

use std::fmt::Write as _;

use quick_xml::escape::escape;

use super::node::{ARRAY, BAG, Body, Node, PropertyFile, Simple, Unwritable, plain_elements};

pub(super) fn toml(file: &PropertyFile) -> String {
    let mut out = String::new();
    // A value after a section would belong to the section, so only the structs at the end become sections.
    let is_section = |node: &Node| is_bag(node) && !node.name.is_empty();
    let sections = file
        .nodes
        .iter()
        .rev()
        .take_while(|n| is_section(n))
        .count();
    let (values, sections) = file.nodes.split_at(file.nodes.len() - sections);
    for node in values {
        let _ = writeln!(out, "{} = {}", key(&node.name), value(node));
    }
    for node in sections {
        if !out.is_empty() {
            out.push('\n');
        }
        let _ = writeln!(out, "[{}]", key(&node.name));
        if let Body::Struct(_, members) = &node.body {
            for member in members {
                let _ = writeln!(out, "{} = {}", key(&member.name), value(member));
            }
        }
    }
    out
}

fn is_bag(node: &Node) -> bool {
    matches!(&node.body, Body::Struct(kind, _) if kind == BAG) && node.description.is_empty()
}

fn key(name: &str) -> String {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.is_empty() && name.chars().all(is_bare) {
        return name.to_owned();
    }
    quoted(name)
}

fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            '\n' => out.push_str("\\n"),
            '\t' => out.push_str("\\t"),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04X}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

fn value(node: &Node) -> String {
    let description = &node.description;
    let mut parts = Vec::new();
    match &node.body {
        Body::Simple(simple) => {
            if is_native(simple) && description.is_empty() {
                return scalar(simple);
            }
            if !is_native(simple) {
                parts.push(format!("\"@type\" = \"{}\"", simple.word()));
            }
            parts.push(format!("\"@value\" = {}", scalar(simple)));
        }
        Body::Struct(kind, members) => {
            if let (ARRAY, Some(elements), true) = (
                kind.as_str(),
                plain_elements(members),
                description.is_empty(),
            ) {
                let elements: Vec<String> = elements.into_iter().map(scalar).collect();
                return format!("[{}]", elements.join(", "));
            }
            if kind != BAG {
                parts.push(format!("\"@type\" = {}", quoted(kind)));
            }
            let members = members.iter();
            parts
                .extend(members.map(|member| format!("{} = {}", key(&member.name), value(member))));
        }
    }
    if !description.is_empty() {
        parts.insert(0, format!("\"@description\" = {}", quoted(description)));
    }
    if parts.is_empty() {
        return "{}".to_owned();
    }
    format!("{{ {} }}", parts.join(", "))
}

/// Whether a TOML value alone stands for that type.
const fn is_native(simple: &Simple) -> bool {
    matches!(
        simple,
        Simple::Boolean(_) | Simple::Long(_) | Simple::Double(_) | Simple::String(_)
    )
}

fn scalar(simple: &Simple) -> String {
    match simple {
        Simple::Boolean(value) => value.to_string(),
        Simple::Char(value) => quoted(&value.to_string()),
        Simple::String(value) => quoted(value),
        Simple::Double(value) if value.is_nan() => "nan".to_owned(),
        Simple::Float(value) if value.is_nan() => "nan".to_owned(),
        Simple::Uchar(_)
        | Simple::Short(_)
        | Simple::Ushort(_)
        | Simple::Long(_)
        | Simple::Ulong(_)
        | Simple::Float(_)
        | Simple::Double(_) => simple.text(),
    }
}

pub(super) fn cpf(file: &PropertyFile) -> Result<String, Unwritable> {
    let mut out = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!DOCTYPE properties SYSTEM \"cpf.dtd\">\n<properties>\n",
    );
    for node in &file.nodes {
        element(node, 1, &mut out)?;
    }
    out.push_str("</properties>\n");
    Ok(out)
}

fn element(node: &Node, depth: usize, out: &mut String) -> Result<(), Unwritable> {
    let indent = "  ".repeat(depth);
    let name = xml(node, &node.name)?;
    let description = || -> Result<String, Unwritable> {
        if node.description.is_empty() {
            return Ok(String::new());
        }
        let text = xml(node, &node.description)?;
        Ok(format!("<description>{text}</description>"))
    };
    match &node.body {
        Body::Simple(simple) => {
            let (word, value) = (simple.word(), xml(node, &simple.text())?);
            let _ = writeln!(
                out,
                "{indent}<simple name=\"{name}\" type=\"{word}\">{}<value>{value}</value></simple>",
                description()?
            );
        }
        Body::Struct(kind, members) => {
            let kind = xml(node, kind)?;
            let _ = writeln!(out, "{indent}<struct name=\"{name}\" type=\"{kind}\">");
            if !node.description.is_empty() {
                let _ = writeln!(out, "{indent}  {}", description()?);
            }
            for member in members {
                element(member, depth + 1, out)?;
            }
            let _ = writeln!(out, "{indent}</struct>");
        }
    }
    Ok(())
}

/// A text in XML 1.0. Line ends and tabs are references, as a reader would change them in attributes.
fn xml(node: &Node, text: &str) -> Result<String, Unwritable> {
    let is_bad = |c: char| {
        (c < ' ' && !matches!(c, '\t' | '\n' | '\r')) || matches!(c, '\u{fffe}' | '\u{ffff}')
    };
    if let Some(character) = text.chars().find(|c| is_bad(*c)) {
        let property = node.name.clone();
        return Err(Unwritable {
            property,
            character,
        });
    }
    let mut out = escape(text).into_owned();
    for (plain, reference) in [("\r", "&#13;"), ("\n", "&#10;"), ("\t", "&#9;")] {
        out = out.replace(plain, reference);
    }
    Ok(out)
}
