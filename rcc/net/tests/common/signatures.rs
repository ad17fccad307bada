//! Compares the primitives that existing clients know with those of a registry: ports, parameters
//! and defaults. Their behaviour is tested elsewhere.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "shared by test files of more than one crate"
)]

use std::collections::{BTreeMap, BTreeSet};

use takt_net::definition::ParameterType;
use takt_net::{Definition, Element, Quantity, Registry};

const SIGNATURES: &str = include_str!("../signatures.txt");

/// The primitives of this crate that clients of the original do not know.
const TAKT: &[&str] = &[
    "Core::BooleanDebounce",
    "Core::DoubleAbs",
    "Core::DoubleClamp",
    "Core::DoubleDeadBand",
    "Core::DoubleDerivative",
    "Core::DoubleGreaterEqual",
    "Core::DoubleIntegrator",
    "Core::DoubleLess",
    "Core::DoubleLessEqual",
    "Core::DoubleLowPass",
    "Core::DoubleLowPass2",
    "Core::DoubleMax",
    "Core::DoubleMin",
    "Core::DoubleNegate",
    "Core::DoublePID",
    "Core::DoubleRateLimiter",
    "Core::DoubleSign",
    "Core::DoubleSubtract",
    "Core::DoubleTable",
    "Core::IntAbs",
    "Core::IntClamp",
    "Core::IntGreaterEqual",
    "Core::IntLess",
    "Core::IntLessEqual",
    "Core::IntMax",
    "Core::IntMin",
    "Core::IntNegate",
    "Core::IntSign",
    "Core::IntSubtract",
    "Core::Ramp",
    "Core::SawtoothWave",
    "Core::SquareWave",
    "Core::TriangleWave",
    "World::FrameLowPass",
    "World::FrameRateLimiter",
    "World::RotationLowPass",
    "World::RotationRateLimiter",
    "World::TwistLowPass",
    "World::TwistLowPass2",
    "World::TwistNegate",
    "World::TwistRateLimiter",
    "World::TwistScale",
    "World::TwistSubtract",
    "World::VectorClamp",
    "World::VectorDeadBand",
    "World::VectorDerivative",
    "World::VectorIntegrator",
    "World::VectorLength",
    "World::VectorLowPass",
    "World::VectorLowPass2",
    "World::VectorNegate",
    "World::VectorRateLimiter",
    "World::VectorSubtract",
    "World::WrenchAdd",
    "World::WrenchLowPass",
    "World::WrenchLowPass2",
    "World::WrenchNegate",
    "World::WrenchScale",
    "World::WrenchSubtract",
];

/// Prefix of a generic family's names, and the type's name in the list.
const TYPES: &[(&str, &str)] = &[
    ("Core::Boolean", "bool"),
    ("Core::Int", "int"),
    ("Core::Double", "double"),
    ("World::Vector", "Vector"),
    ("World::Rotation", "Rotation"),
    ("World::Frame", "Frame"),
    ("World::Twist", "Twist"),
    ("World::Wrench", "Wrench"),
];

/// The compared data: names with types, and defaults if there are any.
#[derive(Debug, PartialEq, Eq)]
struct Signature {
    inputs: BTreeSet<String>,
    outputs: BTreeSet<String>,
    parameters: BTreeSet<String>,
}

fn ports(list: &str) -> BTreeSet<String> {
    let typed = |port: &str| match port.split_once(':') {
        Some((name, ty)) => format!("{name}:{ty}"),
        None => format!("{port}:double"),
    };
    list.split(", ")
        .filter(|p| !p.is_empty())
        .map(typed)
        .collect()
}

fn parameters(list: &str) -> BTreeSet<String> {
    let one = |parameter: &str| {
        let (name, default) = parameter.split_once('=').expect("a default");
        let typed = ports(name).into_iter().next().expect("a name");
        format!("{typed}={}", default.trim_matches('\''))
    };
    list.split(", ")
        .filter(|p| !p.is_empty())
        .map(one)
        .collect()
}

/// Reads `name(inputs) -> outputs [parameters]`.
fn read(line: &str) -> (String, Signature) {
    let (name, rest) = line.split_once('(').expect("`(`");
    let (inputs, rest) = rest.split_once(')').expect("`)`");
    // The brackets of an array type are not preceded by a space.
    let (outputs, list) = rest.split_once(" [").unwrap_or((rest, ""));
    let outputs = outputs.trim_start_matches(" -> ");
    let signature = Signature {
        inputs: ports(inputs),
        outputs: ports(outputs),
        parameters: parameters(list.strip_suffix(']').unwrap_or(list)),
    };
    (name.to_owned(), signature)
}

fn expected() -> BTreeMap<String, Signature> {
    let mut expected = BTreeMap::new();
    for line in SIGNATURES.lines().filter(|l| !l.starts_with('#')) {
        if !line.contains("<T>") {
            expected.extend([read(line)]);
            continue;
        }
        for (prefix, ty) in TYPES {
            let zero = match *ty {
                "bool" => "=false",
                "int" | "double" => "=0",
                _ => "={}",
            };
            let line = line
                .replace(":T", &format!(":{ty}"))
                .replace("<T>", prefix)
                .replace("=zero", zero);
            expected.extend([read(&line)]);
        }
    }
    expected
}

fn short(ty: &str) -> &str {
    ty.trim_start_matches("Core::")
        .trim_start_matches("World::")
}

/// The signature of a definition, without the out ports that Takt added.
fn actual(definition: &Definition, added: &[(&str, &str)]) -> Signature {
    let parameter = |p: &takt_net::definition::Parameter| {
        let ty = match p.ty {
            ParameterType::Text => "string".to_owned(),
            ParameterType::Value(ty) => short(&ty.to_string()).to_owned(),
        };
        format!("{}:{ty}={}", p.name, p.default)
    };
    let port = |name: &str, ty: takt_net::Type| format!("{name}:{}", short(&ty.to_string()));
    let is_added = |port: &String| added.contains(&(definition.name.as_str(), port));
    Signature {
        inputs: definition
            .inputs
            .iter()
            .map(|p| port(p.name, p.ty))
            .collect(),
        outputs: definition
            .outputs
            .iter()
            .map(|p| port(p.name, p.ty))
            .filter(|port| !is_added(port))
            .collect(),
        parameters: definition.parameters.iter().map(parameter).collect(),
    }
}

/// Checks a whole registry: all known primitives except those of `elsewhere` exist with their known
/// signature, and no others except those of `own`. Out ports in `added` are Takt's.
pub fn are_known(
    registry: &Registry,
    elsewhere: impl Fn(&str) -> bool,
    own: &[&str],
    added: &[(&str, &str)],
) {
    let expected = expected();
    // Those that the original lists with its usual extensions, and one of its iiwa.
    assert_eq!(expected.len(), 303 + 1, "the list is complete");
    let mut wrong = Vec::new();
    for (name, signature) in &expected {
        match registry.find(name) {
            None if elsewhere(name) => {}
            None => wrong.push(format!("{name} is missing")),
            Some(definition) => {
                let actual = actual(definition, added);
                if actual != *signature {
                    wrong.push(format!("{name}: {signature:?}\n    is {actual:?}"));
                }
            }
        }
    }
    let has_prefix = |name: &str| own.iter().any(|prefix| name.starts_with(prefix));
    let is_own = |name: &str| has_prefix(name) || TAKT.contains(&name);
    for definition in registry.definitions() {
        let name = definition.name.as_str();
        if !expected.contains_key(name) && !is_own(name) {
            wrong.push(format!("{name} is not in the list"));
        }
    }
    let missing = TAKT.iter().filter(|name| registry.find(name).is_none());
    wrong.extend(missing.map(|name| format!("{name} is missing")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Checks that every primitive, port and parameter has a doc, and every primitive a cost and a source.
pub fn are_explained(registry: &Registry) {
    for definition in registry.definitions() {
        let name = &definition.name;
        assert!(definition.doc.ends_with('.'), "{name}: {}", definition.doc);
        assert!(!definition.null.text().is_empty(), "{name}");
        assert!(definition.cost.ns > 0.0, "{name}: it costs nothing");
        let is_of_a_crate = definition.source.contains("src/");
        let is_helper = definition.source.ends_with("definition.rs");
        assert!(is_of_a_crate && !is_helper, "{name}: {}", definition.source);
        let ports = definition.inputs.iter().map(|p| p.doc);
        let ports = ports.chain(definition.outputs.iter().map(|p| p.doc));
        for doc in ports.chain(definition.parameters.iter().map(|p| p.doc)) {
            assert!(doc.len() > 3, "{name}: a port or parameter without doc");
        }
    }
}

/// Checks that each double parameter of a family of primitives declares what it measures. Those named
/// in `any` measure what their net makes of them.
pub fn have_quantities(registry: &Registry, families: &[&str], any: &[&str]) {
    let mut checked = 0;
    let mut wrong = Vec::new();
    for definition in registry.definitions() {
        if !families
            .iter()
            .any(|family| definition.name.starts_with(family))
        {
            continue;
        }
        for parameter in &definition.parameters {
            let is_number = matches!(
                parameter.ty,
                ParameterType::Value(ty) if [Element::Double, Element::Vector].contains(&ty.element)
            );
            let name = format!("{}.{}", definition.name, parameter.name);
            let is_any = parameter.quantity == Quantity::Any;
            if is_number && is_any != any.contains(&name.as_str()) {
                wrong.push(format!("{name}: {}: {}", parameter.quantity, parameter.doc));
            }
            checked += usize::from(is_number);
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(checked > 10, "only {checked} parameters");
}
