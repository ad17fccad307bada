//! Both forms of property files: goldens, random files, errors with their locations.

use proptest::prelude::*;

use super::{ARRAY, BAG, Body, Node, PropertyFile, Simple};

const CPF: &str = include_str!("../../tests/properties/servo.cpf");
const TOML: &str = include_str!("../../tests/properties/servo.toml");

#[test]
fn cpf_and_toml_goldens_convert_both_ways() {
    let (cpf, toml) = (
        PropertyFile::from_cpf(CPF).unwrap(),
        PropertyFile::from_toml(TOML).unwrap(),
    );
    assert_eq!(cpf, toml);
    assert_eq!(cpf.to_toml(), TOML);
    assert_eq!(toml.to_cpf().unwrap(), CPF);
}

#[test]
fn cpf_of_orocos_deployer_is_read() {
    let text = "<?xml version=\"1.0\"?>\n<!DOCTYPE properties SYSTEM \"cpf.dtd\">\n<properties>\n\
        <simple name=\"Speed\" type=\"double\"><description/><value>0.10</value></simple>\n\
        <!-- a comment --><struct name=\"PID\" type=\"PropertyBag\">\
        <simple name=\"P\" type=\"float\"><value>1e-3</value></simple></struct>\n\
        <simple name=\"On\" type=\"boolean\"><description>a &lt; b &#38; c</description><value>true</value></simple>\n\
        </properties>";
    let file = PropertyFile::from_cpf(text).unwrap();
    assert_eq!(
        file.to_toml(),
        "Speed = 0.1\nPID = { P = { \"@type\" = \"float\", \"@value\" = 0.001 } }\n\
         On = { \"@description\" = \"a < b & c\", \"@value\" = true }\n"
    );
}

fn errors(result: Result<PropertyFile, crate::Diagnostics>, text: &str) -> Vec<String> {
    let found = result.expect_err(text);
    let line = |d: &crate::Diagnostic| {
        let (line, column) = d.location(text);
        assert!(!d.hint.is_empty());
        format!("{line}:{column} {}", d.text)
    };
    found.all().iter().map(line).collect()
}

#[test]
fn cpf_errors_have_location_and_cause() {
    for (text, expected) in [
        ("", vec!["1:1 the file has no `<properties>`"]),
        ("<properties>", vec!["1:13 `<properties>` is not closed"]),
        (
            "<properties>\n<simple name='a' type='dubble'><value>1</value></simple>\n\
             <simple name='b' type='short'><value>40000</value></simple>\n<sample/>x</properties>",
            vec![
                "2:1 `1` is not a value of type `dubble`",
                "3:1 `40000` is not a value of type `short`",
                "4:1 `<sample>` is not allowed inside properties",
                "4:10 text outside a value",
            ],
        ),
        (
            "<properties><simple name='a' type='long'/><simple type='char'><value>xy</value></simple></properties>",
            vec![
                "1:13 this property has no value",
                "1:13 `` is not a value of type `long`",
                "1:43 `<simple>` has no `name`",
                "1:43 `xy` is not a value of type `char`",
            ],
        ),
        (
            "<!DOCTYPE properties [<!ENTITY a 'b'>]><properties/>",
            vec!["1:1 a document type with definitions is not accepted"],
        ),
        (
            "<properties><simple name='a' type='string'><value>&a;</value></simple></properties>",
            vec!["1:51 there is no entity `&a;`"],
        ),
        (
            "<properties><simple name='a' type='long'><value>1</value></simple>\
             <simple name='a' type='long'><value>1</value></simple></properties>",
            vec!["1:67 property `a` is given twice"],
        ),
    ] {
        assert_eq!(
            errors(PropertyFile::from_cpf(text), text),
            expected,
            "{text}"
        );
    }
    let deep = "<struct name='a' type='b'>".repeat(100);
    let text = format!("<properties>{deep}");
    assert_eq!(
        errors(PropertyFile::from_cpf(&text), &text),
        ["1:1 at most 16 levels of structs are allowed"]
    );
}

#[test]
fn toml_errors_have_location_and_cause() {
    for (text, expected) in [
        (
            "a = 1\nb = 2000-01-01",
            vec!["2:5 a property has no such type"],
        ),
        (
            "a = 3000000000",
            vec!["1:5 this is not a value of type long"],
        ),
        (
            "a = { \"@type\" = \"shrot\", \"@value\" = 1 }\n\"@b\" = 1",
            vec![
                "1:37 there is no type `shrot`",
                "2:1 `@b` is not allowed here",
            ],
        ),
        (
            "a = { \"@value\" = 1, b = 2 }",
            vec!["1:21 `b` stands beside `\"@value\"`"],
        ),
        (
            "a = { \"@type\" = \"short\", \"@value\" = \"1\" }",
            vec!["1:37 this is not a value of type short"],
        ),
    ] {
        assert_eq!(
            errors(PropertyFile::from_toml(text), text),
            expected,
            "{text}"
        );
    }
    assert!(PropertyFile::from_toml("a = \na = 1").is_err());
}

#[test]
fn cpf_character_without_xml_form_is_refused() {
    let file = PropertyFile::from_toml("a = \"\\u0001\"").unwrap();
    let text = file.to_cpf().unwrap_err().to_string();
    assert!(
        text.starts_with("property `a`: XML cannot represent the character U+0001\nhint: "),
        "{text}"
    );
}

fn simple() -> impl Strategy<Value = Simple> {
    prop_oneof![
        any::<bool>().prop_map(Simple::Boolean),
        any::<char>().prop_map(Simple::Char),
        any::<u8>().prop_map(Simple::Uchar),
        any::<i16>().prop_map(Simple::Short),
        any::<u16>().prop_map(Simple::Ushort),
        any::<i32>().prop_map(Simple::Long),
        any::<u32>().prop_map(Simple::Ulong),
        any::<f32>().prop_map(Simple::Float),
        any::<f64>().prop_map(Simple::Double),
        any::<String>().prop_map(Simple::String),
    ]
}

fn node(name: usize, description: String, body: Body) -> Node {
    // Names with blanks, quotes and other scripts, each once.
    let name = format!("{}{name}", ["p", "ä b", "\"q'", "<&>", "Element"][name % 5]);
    Node {
        name,
        description,
        body,
        at: 0..0,
    }
}

fn members(depth: u32) -> BoxedStrategy<Vec<Node>> {
    let body = if depth == 0 {
        simple().prop_map(Body::Simple).boxed()
    } else {
        let kinds = prop_oneof![Just(BAG), Just(ARRAY), Just("short"), Just("KDL.Frame")];
        let nested = (kinds, members(depth - 1));
        let nested = nested.prop_map(|(kind, members)| Body::Struct(kind.to_owned(), members));
        prop_oneof![3 => simple().prop_map(Body::Simple), 1 => nested].boxed()
    };
    let described = prop_oneof![Just(String::new()), any::<String>()];
    let parts = prop::collection::vec((described, body), 0..5);
    parts
        .prop_map(|parts| {
            let parts = parts.into_iter().enumerate();
            parts.map(|(i, (text, body))| node(i, text, body)).collect()
        })
        .boxed()
}

proptest! {
    #[test]
    fn property_file_random_survives_both_forms(nodes in members(3)) {
        let file = PropertyFile { nodes };
        let toml = file.to_toml();
        prop_assert_eq!(&PropertyFile::from_toml(&toml).map_err(|e| e.render("f", &toml)), &Ok(file.clone()), "{}", toml);
        if let Ok(cpf) = file.to_cpf() {
            prop_assert_eq!(&PropertyFile::from_cpf(&cpf).map_err(|e| e.render("f", &cpf)), &Ok(file), "{}", cpf);
        }
    }
}
