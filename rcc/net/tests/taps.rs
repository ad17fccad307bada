//! Debug taps: the ports they name, the content of a record, and that a tap has no side effect.

mod common;

use common::{Bench, try_load};
use takt_net::taps::{TAPS_MAX, record_time};

const NEVER: &str = "never=Core::BooleanValue(),outTerminate=never.outValue";

fn record(bench: &Bench) -> (i64, Vec<(String, Option<String>)>) {
    let mut words = vec![0; bench.plan.record_words()];
    bench.plan.record(bench.moment.time, &mut words);
    let taps = bench.plan.taps().iter();
    let values = taps
        .map(|tap| (tap.name.clone(), tap.text(&words)))
        .collect();
    (record_time(&words).0, values)
}

fn pairs(values: &[(&str, Option<&str>)]) -> Vec<(String, Option<String>)> {
    let owned = |(name, text): &(&str, Option<&str>)| ((*name).to_owned(), text.map(str::to_owned));
    values.iter().map(owned).collect()
}

#[test]
fn ports_of_primitives_and_fragments_are_recorded() {
    let mut bench = Bench::new(&format!(
        "{{c=Core::Clock(),a=Core::DoubleAdd(inFirst[2.0]=c.outValue,Second='1'),\
         f={{b=Core::DoubleAdd(inFirst[0.5]=parent.inX,Second='1'),\
             v=World::VectorFromXYZ(inX=b.outValue),s=World::VectorScale(inValue[20.0]=v.outValue),\
             outY[1.0]=b.outValue}}(inX[1.0]=a.outValue),\
         o=Core::DoubleNetcommOut(inValue=f.outY,Key='v'),{NEVER}}}"
    ));
    assert_eq!(record(&bench).1.len(), 5);
    assert!(record(&bench).1.iter().all(|(_, text)| text.is_none()));
    bench.cycle();
    let (time, values) = record(&bench);
    assert_eq!(time, 1_000_000);
    let expected = [
        ("a.inFirst", Some("0.001")),
        ("f.inX", Some("1.001")),
        ("f.outY", Some("2.001")),
        ("f.b.inFirst", Some("1.001")),
        ("f.s.inValue", Some("{x:2.001,y:0,z:0}")),
    ];
    let mut expected = pairs(&expected);
    let mut values = values;
    expected.sort();
    values.sort();
    assert_eq!(values, expected);
    let seconds = |name: &str| {
        let tap = bench.plan.taps().iter().find(|tap| tap.name == name);
        tap.map(|tap| tap.seconds)
    };
    assert_eq!(seconds("f.b.inFirst"), Some(0.5));
    assert_eq!(seconds("f.s.inValue"), Some(10.0), "the longest there is");
}

#[test]
fn inactive_ports_are_recorded_as_null() {
    let mut bench = Bench::new(&format!(
        "{{on=Core::BooleanNetcommIn(Key='on'),c=Core::Clock(),\
         f={{a=Core::DoubleAdd(inFirst=parent.inX,Second='1'),b=Core::DoubleAdd(inFirst[1.0]=a.outValue)}}\
         (inActive=on.outValue,inX=c.outValue),{NEVER}}}"
    ));
    bench.cycle();
    assert_eq!(record(&bench).1, pairs(&[("f.b.inFirst", None)]));
    bench.write("on", "true");
    bench.cycle();
    assert_eq!(record(&bench).1, pairs(&[("f.b.inFirst", Some("1.002"))]));
    bench.write("on", "false");
    bench.cycle();
    assert_eq!(record(&bench).1, pairs(&[("f.b.inFirst", None)]));
}

#[test]
fn arrays_are_recorded_whole() {
    let mut bench = Bench::new(&format!(
        "{{a=Core::DoubleArrayNetcommIn(Key='a',Value='[1,2.5]'),\
         o=Core::DoubleArrayNetcommOut(inValue[1.0]=a.outValue,Key='v'),{NEVER}}}"
    ));
    bench.cycle();
    assert_eq!(record(&bench).1, pairs(&[("o.inValue", Some("[1,2.5]"))]));
}

#[test]
fn net_without_taps_has_no_record() {
    let bench = Bench::new(&format!("{{c=Core::Clock(),{NEVER}}}"));
    assert_eq!(bench.plan.record_words(), 0);
}

#[test]
fn taps_are_bounded() {
    let adds = |count: usize| -> String {
        let add = |i| format!("a{i}=Core::DoubleAdd(inFirst[1.0]=c.outValue),");
        let adds: String = (0..count).map(add).collect();
        format!("{{c=Core::Clock(),{adds}{NEVER}}}")
    };
    assert!(try_load(&adds(TAPS_MAX)).is_ok());
    let faults = try_load(&adds(TAPS_MAX + 100)).err().unwrap_or_default();
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert!(
        faults[0].contains("debug taps") && faults[0].contains("1024"),
        "{faults:?}"
    );
}
