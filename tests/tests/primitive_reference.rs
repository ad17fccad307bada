//! `docs/primitives.md` is generated from the registry: this test fails when it is stale.
//! `TAKT_BLESS=1` writes it.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use takt_net::definition::ParameterType;
use takt_net::{Definition, Element, Quantity, Type};

/// The types of generic families, with the prefixes of their names.
const TYPES: [(&str, Element); 9] = [
    ("Core::Boolean", Element::Bool),
    ("Core::Int", Element::Int),
    ("Core::Double", Element::Double),
    ("Core::Time", Element::Nanos),
    ("World::Vector", Element::Vector),
    ("World::Rotation", Element::Rotation),
    ("World::Frame", Element::Frame),
    ("World::Twist", Element::Twist),
    ("World::Wrench", Element::Wrench),
];

const HEAD: &str = "# Primitives

Generated from the registry by `TAKT_BLESS=1 cargo test -p takt-tests --test primitive_reference`; do not edit.

Names, ports, parameters and defaults of all primitives, by family; `takt net primitives NAME` prints the same for one of them. A
port with a parameter reads it while it is not connected. *T* is the type of the family's member. Units are SI;
parameters also take others of the same quantity, such as `30deg` ([units](../rcc/net/README.md)). *any* takes the unit that
its net gives it; 1 has none.

";

/// The family of a name and the type of its member, if others share its suffix and description.
fn member(name: &str) -> Option<(&'static str, Element, &str)> {
    let fits = |(prefix, element): (&'static str, Element)| {
        Some((prefix, element, name.strip_prefix(prefix)?))
    };
    TYPES.into_iter().find_map(fits)
}

/// Definitions that differ only in their type, by family and suffix.
fn groups(all: &[Definition]) -> BTreeMap<(String, String), Vec<&Definition>> {
    let mut groups: BTreeMap<(String, String), Vec<&Definition>> = BTreeMap::new();
    for definition in all {
        let suffix = member(&definition.name).map_or(definition.name.as_str(), |(_, _, s)| s);
        let shape = |d: &Definition| format!("{}{}", d.doc, d.inputs.len());
        let key = (suffix.to_owned(), shape(definition));
        groups.entry(key).or_default().push(definition);
    }
    groups
}

fn type_name(ty: Type, own: Option<Element>) -> String {
    let array = if ty.array { "[]" } else { "" };
    if own == Some(ty.element) {
        return format!("*T*{array}");
    }
    let name = ty.element.name();
    format!("{}{array}", name.rsplit(':').next().unwrap_or(name))
}

fn unit(ty: Type, quantity: Quantity) -> String {
    let is_measured = [Element::Double, Element::Vector].contains(&ty.element);
    if is_measured {
        quantity.to_string()
    } else {
        String::new()
    }
}

fn section(definitions: &[&Definition]) -> String {
    let first = definitions[0];
    let own = match definitions {
        [_] => None,
        [..] => member(&first.name).map(|(_, element, _)| element),
    };
    let names: Vec<_> = definitions
        .iter()
        .map(|d| format!("`{}`", d.name))
        .collect();
    let mut text = format!(
        "### {}\n\n{}\n\n*Null:* {}\n\n",
        names.join(", "),
        first.doc,
        first.null.text()
    );
    let mut rows = String::new();
    for port in &first.inputs {
        let need = match port.parameter {
            Some(parameter) => format!("or `{parameter}`"),
            None if port.required => "must be connected".to_owned(),
            None => String::new(),
        };
        let (ty, unit) = (type_name(port.ty, own), unit(port.ty, port.quantity));
        writeln!(
            rows,
            "| in `{}` | {ty} | {unit} | {need} | {} |",
            port.name, port.doc
        )
        .unwrap();
    }
    for parameter in &first.parameters {
        let (ty, unit) = match parameter.ty {
            ParameterType::Text => ("text".to_owned(), String::new()),
            ParameterType::Value(ty) => (type_name(ty, own), unit(ty, parameter.quantity)),
        };
        let default = match own {
            Some(_) if ty == "*T*" => "its zero".to_owned(),
            _ => format!("`'{}'`", parameter.default),
        };
        writeln!(
            rows,
            "| `{}` | {ty} | {unit} | {default} | {} |",
            parameter.name, parameter.doc
        )
        .unwrap();
    }
    for port in &first.outputs {
        let (ty, unit) = (type_name(port.ty, own), unit(port.ty, port.quantity));
        writeln!(
            rows,
            "| out `{}` | {ty} | {unit} | | {} |",
            port.name, port.doc
        )
        .unwrap();
    }
    if !rows.is_empty() {
        writeln!(text, "| port or parameter | type | unit | source or default | meaning |\n|---|---|---|---|---|\n{rows}").unwrap();
    }
    text
}

/// The chapter of a primitive: what is before the last `::` of its name.
fn chapter(definition: &Definition) -> &str {
    definition
        .name
        .rsplit_once("::")
        .map_or("Control", |(chapter, _)| chapter)
}

fn reference() -> String {
    let registry = takt_core::registry();
    let mut chapters: BTreeMap<&str, BTreeMap<&str, String>> = BTreeMap::new();
    for group in groups(registry.definitions()).values() {
        let sections = chapters.entry(chapter(group[0])).or_default();
        sections.insert(&group[0].name, section(group));
    }
    let mut text = HEAD.to_owned();
    for (chapter, sections) in chapters {
        write!(
            text,
            "## {chapter}\n\n{}",
            sections.into_values().collect::<String>()
        )
        .unwrap();
    }
    text.trim_end().to_owned() + "\n"
}

#[test]
fn primitive_reference_matches_registry() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/primitives.md");
    let expected = reference();
    for name in [
        "`Motion::Ptp`",
        "`RobotArm::JointPosition`",
        "`Core::DoublePID`",
    ] {
        assert!(expected.contains(name), "{name} is missing");
    }
    if std::env::var_os("TAKT_BLESS").is_some() {
        std::fs::write(&path, &expected).unwrap();
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    let differs = found
        .lines()
        .zip(expected.lines())
        .position(|(a, b)| a != b);
    assert!(
        found == expected,
        "docs/primitives.md is stale from line {}; TAKT_BLESS=1 writes it",
        differs.unwrap_or_default() + 1
    );
}
