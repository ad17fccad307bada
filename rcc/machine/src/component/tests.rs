//! Component files: what fits together is accepted and loads, everything else is an error with its location; values change
//! whole or not at all.

use std::time::Duration;

use takt_net::{Limits, LoadContext, NoDevices, Registry};

use super::{Component, Configuration, Data};
use crate::lifecycle::Phase;
use crate::properties::PropertyFile;

const SERVO: &str = include_str!("../../tests/components/servo.component");

fn parse(text: &str) -> Component {
    let (component, found) = Component::parse(text)
        .map_err(|e| e.render("c", text))
        .unwrap();
    assert!(found.all().is_empty(), "{}", found.render("c", text));
    component
}

/// Location and cause of each error or warning.
fn findings(text: &str) -> Vec<String> {
    let found = match Component::parse(text) {
        Ok((_, found)) | Err(found) => found,
    };
    let line = |d: &crate::Diagnostic| {
        let (line, column) = d.location(text);
        assert!(!d.hint.is_empty());
        format!("{line}:{column} {}", d.text)
    };
    found.all().iter().map(line).collect()
}

fn load(component: &Component, configuration: &Configuration) -> Result<f64, String> {
    let registry = Registry::core();
    let context = LoadContext {
        registry: &registry,
        devices: &NoDevices,
        period: Duration::from_millis(1),
        limits: Limits::default(),
    };
    let mut plan = component
        .load(configuration, &context)
        .map_err(|found| found.render("servo.component", SERVO))?;
    plan.evaluate(&takt_net::Image::default(), takt_net::Moment::default());
    let words: Vec<u64> = plan.outbox_words().collect();
    let speed = plan.outbox().find("outspeed").unwrap();
    Ok(f64::from_bits(speed.value(&words)[0]))
}

#[test]
fn component_loads_with_values_of_properties() {
    let servo = parse(SERVO);
    let mut configuration = Configuration::of(&servo);
    assert_eq!(load(&servo, &configuration), Ok(20.0 * 0.5));
    let file = PropertyFile::from_toml("gain = 4.0\nstart = \"90deg\"").unwrap();
    configuration.apply(&servo, Phase::Stopped, &file).unwrap();
    let expected = 4.0 * std::f64::consts::FRAC_PI_2;
    assert_eq!(load(&servo, &configuration), Ok(expected));
    let written = configuration.to_file(&servo);
    let mut again = Configuration::of(&servo);
    again
        .apply(&servo, Phase::PreOperational, &written)
        .unwrap();
    assert_eq!(again, configuration);
}

#[test]
fn component_net_fault_is_at_its_location() {
    let text = SERVO.replace("start.outValue", "strat.outValue");
    let servo = parse(&text);
    let fault = load(&servo, &Configuration::of(&servo)).unwrap_err();
    let line = 1 + text[..text.find("strat").unwrap()].matches('\n').count();
    assert!(
        fault.contains(&format!("servo.component:{line}:")),
        "{fault}"
    );
}

#[test]
fn component_errors_are_reported_at_once() {
    let text = "component C {\n property a: dubble;\n property b: double unit \"deg\" range 2 .. 1;\n\
        porperty c: int;\n in d: int[0];\n every 0;\n property e: bool default 1;\n}\n{}";
    assert_eq!(
        findings(text),
        [
            "2:14 a type is expected here, not `dubble`",
            "3:26 `deg` is not an SI unit",
            "3:38 this range is empty",
            "4:1 a declaration is expected here, not `porperty`",
            "5:12 this is not a size of an array",
            "6:8 a component is evaluated every 1 to 100000 cycles",
            "7:27 default of `e`: this is an int, but a bool is expected",
        ]
    );
    assert_eq!(
        findings("{}"),
        ["1:1 `component` is expected here, not `{`"]
    );
    assert_eq!(
        findings("component C {"),
        ["1:14 `}` is expected here, not the end of the file"]
    );
}

#[test]
fn component_declaration_without_net_value_is_error() {
    let net = "{a=Core::IntNetcommIn(Key='p'), b=Core::DoubleNetcommIn(Key='loose'), \
               c=Core::DoubleValue(Value='$nothing'), t=Cancel(), outTerminate=t.outCancel}";
    let text = format!(
        "component C {{\n property unused: double;\n in p: double;\n out q: bool;\n operation go(x: int) done q2;\n\
         in p: double;\n in is: int;\n}}\n{net}"
    );
    let found = findings(&text);
    for expected in [
        "2:11 property `unused` is not used by the net",
        "9:4 value `p` of the net is not a double, as declared",
        "4:6 port `q`",
        "5:12 operation `go`: the net has no value `go`",
        "5:15 argument `x`: the net has no value `go_x`",
        "5:12 operation `go`: there is no out port `q2` of type bool",
        "6:4 `p` is declared twice",
        "7:5 `is` is a word of the machine language",
        "9:35 value `loose` of the net is not declared",
        "9:97 there is no property `nothing`",
    ] {
        let expected = expected.replace("port `q`", "out `q`: the net has no value `q`");
        assert!(found.contains(&expected), "{expected}: {found:#?}");
    }
}

#[test]
fn configuration_change_is_whole_or_refused() {
    let servo = parse(SERVO);
    let mut configuration = Configuration::of(&servo);
    let before = configuration.clone();
    let file = PropertyFile::from_toml(
        "gain = 5.0\nstart = \"2m\"\nspeed_max = 99.0\nlabel = 3\noffsets = [1.0]\ngian = 1.0\n[pid]\np = 1.0",
    )
    .unwrap();
    let refusal = configuration
        .apply(&servo, Phase::Stopped, &file)
        .unwrap_err();
    let text = refusal.to_string();
    for expected in [
        "property `start`: `2m` is a length, but an angle is expected",
        "property `speed_max`: 99 is not in the range 0 to 10 rad/s",
        "property `label`: this is an int, but a string is expected",
        "property `offsets`: the array has 1 elements, but 2 are expected",
        "property `gian`: the component has no such property\nhint: did you mean `gain`?",
        "property `pid`: the component has no such property",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    assert_eq!(refusal.reasons.len(), 6);
    assert_eq!(configuration, before);
    let not_finite = [("gain".to_owned(), Data::Double(f64::NAN))];
    assert!(
        configuration
            .set(&servo, Phase::Stopped, not_finite)
            .is_err()
    );
    assert_eq!(configuration, before);
}

#[test]
fn configuration_running_accepts_live_properties_only() {
    let servo = parse(SERVO);
    let mut configuration = Configuration::of(&servo);
    let gain = ("gain".to_owned(), Data::Double(3.0));
    let start = ("start".to_owned(), Data::Double(1.0));
    for phase in Phase::ALL {
        let both = [gain.clone(), start.clone()];
        let allowed = matches!(phase, Phase::PreOperational | Phase::Stopped);
        assert_eq!(
            Configuration::of(&servo).set(&servo, phase, both).is_ok(),
            allowed,
            "{phase}"
        );
    }
    configuration.set(&servo, Phase::Running, [gain]).unwrap();
    let refusal = configuration
        .set(&servo, Phase::Running, [start])
        .unwrap_err();
    assert_eq!(
        refusal.to_string(),
        "property `start`: it cannot change while the component is running\n\
         hint: stop the component first, or declare the property `live`"
    );
    assert_eq!(configuration.values()[0], Some(Data::Double(3.0)));
}

#[test]
fn configuration_without_value_is_incomplete() {
    let text = SERVO.replace(" default \"bench\"", "");
    let servo = parse(&text);
    let refusal = Configuration::of(&servo)
        .check_complete(&servo)
        .unwrap_err();
    assert!(
        refusal
            .to_string()
            .starts_with("property `label`: it has neither a value nor a default")
    );
    assert_eq!(
        Configuration::of(&parse(SERVO)).check_complete(&parse(SERVO)),
        Ok(())
    );
}

#[test]
fn component_live_array_or_text_is_error() {
    let live = |kind: &str, default: &str, family: &str| {
        let net = format!(
            "{{a=Core::{family}NetcommIn(Key='a', Value='$a'), t=Cancel(), outTerminate=t.outCancel}}"
        );
        findings(&format!(
            "component C {{ property a: {kind} default {default} live; }} {net}"
        ))
    };
    assert_eq!(
        live("double[3]", "[0, 0, 0]", "DoubleArray"),
        ["1:24 property `a`: an array cannot be live"]
    );
    assert_eq!(
        live("string", "'x'", "String"),
        ["1:24 property `a`: a string cannot be live"]
    );
    assert_eq!(live("double", "0", "Double"), [""; 0]);
}
