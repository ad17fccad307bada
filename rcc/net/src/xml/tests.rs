//! XML and text are two forms of the same nets.

use std::time::Duration;

use proptest::prelude::*;

use super::*;
use crate::limits::Limits;
use crate::{LoadContext, NoDevices, Plan, Registry, Rejection, load};

fn text_of(xml: &str) -> Result<String, String> {
    from_xml(xml, &Limits::default()).map_err(|fault| fault.to_string())
}

fn xml_of(text: &str) -> String {
    to_xml(text, &Limits::default()).unwrap()
}

fn loaded(text: &str) -> Result<Plan, Rejection> {
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    load(text, &context)
}

#[test]
fn documented_example_is_read() {
    let xml = r#"<?xml version="1.0"?><RpiNet>
        <module id="c" type="Core::Clock"><parameter name="Increment" value="1"/></module>
        <Fragment id="f">
          <module id="a" type="Core::DoubleAdd">
            <port name="inFirst" fromModule="f" fromport="inX"/></module>
          <inport name="inX" frommodule="c" fromport="outValue" debug="2.0"/>
          <outport name="outY" frommodule="a" fromport="outValue"/>
        </Fragment><!-- over -->
        <outport name="outTerminate" frommodule="f" fromport="outZ"/></RpiNet>"#;
    let text = "{c=Core::Clock(Increment='1'),\
        f={a=Core::DoubleAdd(inFirst=parent.inX),outY=a.outValue}(inX[2.0]=c.outValue),\
        outTerminate=f.outZ}";
    assert_eq!(text_of(xml).as_deref(), Ok(text));
    assert_eq!(
        text_of(&xml_of(text)).as_deref(),
        Ok(text.replace("[2.0]", "[2]").as_str())
    );
}

#[test]
fn inline_primitives_get_names_in_xml() {
    let text = "{g=Core::DoubleGreater(inFirst=Core::DoubleAdd(inFirst=Core::Clock().outValue,\
        Second='1').outValue,inSecond=f.outV,Second='2'),\
        f={outV=Core::DoubleAdd(inFirst=parent.inA).outValue}(inA=Core::Clock().outValue),\
        g_inFirst_source=Core::Clock(),outTerminate=g.outValue}";
    let again = text_of(&xml_of(text)).unwrap();
    assert!(
        again.contains("g_inFirst_source_=Core::DoubleAdd("),
        "{again}"
    );
    assert!(
        again.contains("g_inFirst_source__inFirst_source=Core::Clock()"),
        "{again}"
    );
    let (one, other) = (loaded(text).unwrap(), loaded(&again).unwrap());
    assert_eq!(one.primitives(), other.primitives());
}

#[test]
fn child_named_like_its_fragment_stays_distinct() {
    let text = "{f={f=Core::DoubleAdd(inFirst=parent.inX),outY=f.outValue}(inX=ROOT.outValue),\
        ROOT=Core::Clock(),g=Core::DoubleGreater(inFirst=f.outY),outTerminate=g.outValue}";
    let again = text_of(&xml_of(text)).unwrap();
    assert!(
        again.contains("f={f_child=Core::DoubleAdd(inFirst=parent.inX),outY=f_child."),
        "{again}"
    );
    assert_eq!(loaded(&again).unwrap().primitives(), 3);
}

#[test]
fn invalid_xml_is_rejected_with_line() {
    let net = |inside: &str| format!("<rpinet>\n{inside}</rpinet>");
    for (xml, fault) in [
        ("", "line 1: there is no `<rpinet>`, or it does not end"),
        (
            "<rpinet>\n<module id='a' type='b'>",
            "line 2: there is no `<rpinet>`",
        ),
        ("<a/>", "line 1: `<a>` is not allowed in the document"),
        (
            &net("<port/>"),
            "line 2: `<port>` is not allowed in `<rpinet>`",
        ),
        (
            &net("<module id='a'/>"),
            "line 2: `<module>` needs the attribute `type`",
        ),
        (
            &net("<module id='a b' type='c'/>"),
            "line 2: id=\"a b\": a name of",
        ),
        (
            &net("<module id='a' type='c(),x=d'/>"),
            "line 2: type=\"c(),x=d\": a name of",
        ),
        (
            &net("<module id='' type='c'/>"),
            "line 2: id=\"\": a name of",
        ),
        (&net("<module id='a' type='&nope;'/>"), "line 2: "),
        (&net("<module id='a' id='b'/>"), "line 2: "),
        (&net("</module>"), "line 2: "),
        (
            &net("<outport name='a' frommodule='b' fromport='c' debug='2s'/>"),
            "line 2: debug=\"2s\": a number of seconds",
        ),
        (
            "<!DOCTYPE a [<!ENTITY b 'c'>]><rpinet/>",
            "line 1: a document type is not allowed",
        ),
        ("<rpinet/><rpinet/>", "line 1: `<rpinet>` is not allowed"),
    ] {
        let error = text_of(xml).unwrap_err();
        assert!(error.starts_with(fault), "{xml}: {error}");
    }
}

#[test]
fn depth_attributes_and_length_are_bounded() {
    let deep = format!("<rpinet>{}", "<fragment id='a'>".repeat(100_000));
    assert!(
        text_of(&deep)
            .unwrap_err()
            .contains("65 fragments inside one another")
    );
    let many: String = (0..100_000).map(|i| format!(" a{i}='1'")).collect();
    assert!(
        text_of(&format!("<rpinet{many}/>"))
            .unwrap_err()
            .contains("at most 16 are allowed")
    );
    let limits = Limits {
        text_bytes: 10,
        ..Limits::default()
    };
    let long = from_xml("<rpinet></rpinet>", &limits)
        .unwrap_err()
        .to_string();
    assert_eq!(long, "line 1: 17 bytes of XML; at most 10 are allowed");
}

#[test]
fn to_xml_faults_are_parser_faults() {
    let rejection = to_xml("{a=b", &Limits::default()).unwrap_err();
    assert_eq!(rejection.faults[0].kind.minor(), 12);
}

/// Children, parameters, links and nested fragments, written as [`from_xml`] writes them.
fn nets() -> impl Strategy<Value = String> {
    let link = "[a-d]\\.out[XY]";
    let value = r#"[ -&(-\[\]-~äß\n\r\t]{0,8}"#;
    let arg = prop_oneof![
        (Just(()), "in[A-C]", link).prop_map(|((), n, l)| format!("{n}={l}")),
        ("in[A-C]", 1..9_u8, link).prop_map(|(n, s, l)| format!("{n}[{s}]={l}")),
        ("[P-R]", value).prop_map(|(n, v)| format!("{n}='{v}'")),
        ("[P-R]", value).prop_map(|(n, v)| format!(r"{n}='\\{v}\''")),
    ];
    let args = prop::collection::vec(arg, 0..4).prop_map(|a| a.join(","));
    let module = ("[a-d]", "[A-Z]:[a-z]", args).prop_map(|(n, t, a)| format!("{n}={t}({a})"));
    let inner = |inside: BoxedStrategy<String>| {
        let items = prop::collection::vec(inside, 0..4).prop_map(|i| i.join(","));
        let ports = prop::collection::vec("in[A-C]=[e-h]\\.out[XY]", 0..3);
        let outs = prop::collection::vec("out[A-C]=(parent\\.in[A-C]|[a-d]\\.outX)", 0..3);
        ("[A-D]", items, outs, ports).prop_map(|(name, items, outs, ports)| {
            let mut inside: Vec<_> = (!items.is_empty()).then_some(items).into_iter().collect();
            inside.extend(outs);
            format!("{name}={{{}}}({})", inside.join(","), ports.join(","))
        })
    };
    let children = module.prop_recursive(3, 24, 4, move |inside| inner(inside.boxed()));
    prop::collection::vec(children, 0..5).prop_map(|c| format!("{{{}}}", c.join(",")))
}

/// The XML of a net with random damage.
fn damaged() -> impl Strategy<Value = String> {
    let word = "(<|>|/|</|\"|'|&|&lt;|&#0;|=|\\]\\]>|<!--|<\\?|<!DOCTYPE|<!\\[CDATA\\[|\
        <module |<fragment |id=|type='a'|rpinet|parent|ROOT|\u{0}|ä)";
    let edits = prop::collection::vec((any::<prop::sample::Index>(), 0..6_usize, word), 0..6);
    (nets(), edits).prop_map(|(net, edits)| {
        let mut xml: Vec<char> = xml_of(&net).chars().collect();
        for (at, remove, word) in edits {
            let at = at.index(xml.len() + 1);
            let end = (at + remove).min(xml.len());
            xml.splice(at..end, word.chars());
        }
        xml.into_iter().collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn text_round_trips_through_xml(text in nets()) {
        let xml = xml_of(&text);
        let again = text_of(&xml).unwrap();
        // A child with the name of its fragment gets another name, once.
        prop_assert!(again == text || again.contains("_child"), "{}", again);
        prop_assert_eq!(text_of(&xml_of(&again)).unwrap(), again);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    /// The parser accepts the resulting net text.
    #[test]
    fn damaged_xml_is_rejected_or_valid(xml in damaged()) {
        if let Ok(text) = text_of(&xml) {
            prop_assert!(to_xml(&text, &Limits::default()).is_ok(), "{}", text);
            prop_assert!(text.len() <= 2 * xml.len() + 2);
        }
    }
}
