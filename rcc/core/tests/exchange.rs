//! Values between nets of a running controller: the reader has the writer's value in the next cycle, until
//! the writer is unloaded.

#![expect(clippy::unwrap_used, reason = "tests fail by panicking")]

use std::time::{Duration, Instant};

use takt_core::controller::{LoadRequest, NetState};
use takt_core::executor::links::{OUT_READERS, WIRES_MAX};
use takt_core::{CellConfig, Controller, NetId, SessionId};

/// Far longer than anything here takes; expires only if a test fails.
const TIMEOUT: Duration = Duration::from_secs(20);

const END: &str = "x=Cancel(),outTerminate=x.outCancel";

fn controller() -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.priority = None;
    Controller::start(&cell).unwrap()
}

fn load(controller: &Controller, text: String) -> NetId {
    let request = LoadRequest {
        text,
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    controller.load(request).unwrap()
}

fn run(controller: &Controller, text: String) -> NetId {
    let net = load(controller, text);
    let info = controller.net(net).unwrap();
    assert!(info.rejection.is_none(), "{:?}", info.rejection);
    controller.start_net(net).unwrap();
    net
}

fn value(controller: &Controller, net: NetId, key: &str) -> Option<f64> {
    let values = controller.out_values(net);
    let (_, text) = values.into_iter().find(|(k, _)| k == key)?;
    text.parse().ok()
}

fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let until = Instant::now() + TIMEOUT;
    while !done() {
        assert!(Instant::now() < until, "{what} does not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn clock(controller: &Controller) -> NetId {
    let clock = "c=Core::Clock(),o=Core::DoubleNetcommOut(inValue=c.outValue,Key='t')";
    load(controller, format!("{{{clock},{END}}}"))
}

/// Reports by how much its own clock, begun in the same cycle or later, differs from the other's.
fn reader(of: NetId) -> String {
    format!(
        "{{i=Core::DoubleInterNetcommIn(RemoteNet='{of}',RemoteKey='t'),\
         l=Core::DoublePre(inValue=i.outValue),\
         m=Core::DoubleMultiply(inFirst=l.outValue,Second='-1'),\
         d=Core::DoubleAdd(inFirst=i.outValue,inSecond=m.outValue),\
         o=Core::DoubleNetcommOut(inValue=i.outValue,Key='t'),\
         s=Core::DoubleNetcommOut(inValue=d.outValue,Key='step'),\
         z=Core::DoubleIsNull(inValue=i.outValue),\
         n=Core::BooleanNetcommOut(inValue=z.outValue,Key='null'),{END}}}"
    )
}

#[test]
fn remote_value_is_null_after_unload() {
    let controller = controller();
    let giver = clock(&controller);
    let taker = run(&controller, reader(giver));
    let null = |controller: &Controller| {
        let values = controller.out_values(taker);
        values
            .into_iter()
            .find(|(k, _)| k == "outnull")
            .map(|(_, v)| v)
    };
    wait_until("null", || null(&controller).as_deref() == Some("true"));
    assert_eq!(value(&controller, taker, "outt"), None);
    controller.start_net(giver).unwrap();
    wait_until("a value", || value(&controller, taker, "outstep").is_some());
    // The clock advances by one cycle in each cycle: none is lost or repeated.
    for _ in 0..50 {
        let step = value(&controller, taker, "outstep").unwrap();
        assert!((step - 0.001).abs() < 1e-9, "{step}");
    }
    controller.abort(giver).unwrap();
    // The last value of an ended net remains.
    assert_eq!(null(&controller).as_deref(), Some("false"));
    controller.unload(giver).unwrap();
    wait_until("null", || null(&controller).as_deref() == Some("true"));
    assert_eq!(controller.net(taker).unwrap().state(), NetState::Running);
}

#[test]
fn net_and_program_write_same_net() {
    let controller = controller();
    let echo = |key: &str| {
        format!(
            "i{key}=Core::DoubleNetcommIn(Key='{key}'),\
             o{key}=Core::DoubleNetcommOut(inValue=i{key}.outValue,Key='{key}')"
        )
    };
    let taker = run(
        &controller,
        format!("{{{},{},{END}}}", echo("a"), echo("b")),
    );
    let giver = run(
        &controller,
        format!(
            "{{g=Core::DoubleNetcommIn(Key='g',Value='3'),\
             w=Core::DoubleInterNetcommOut(inValue=g.outValue,RemoteNet='{taker}',RemoteKey='a'),{END}}}"
        ),
    );
    let both = |a: f64, b: f64| {
        let is = |key: &str, wanted: f64| {
            value(&controller, taker, key).is_some_and(|v| (v - wanted).abs() < 1e-12)
        };
        is("outa", a) && is("outb", b)
    };
    wait_until("the net's value", || both(3.0, 0.0));
    controller.write_in(taker, "inb", "5").unwrap();
    wait_until("the program's value", || both(3.0, 5.0));
    controller.write_in(giver, "ing", "4").unwrap();
    wait_until("the net's next value", || both(4.0, 5.0));
    // Links are not values for programs.
    let keys = |values: Vec<(String, String)>| values.into_iter().map(|(k, _)| k);
    assert_eq!(
        keys(controller.out_values(giver)).collect::<Vec<_>>(),
        [""; 0]
    );
    assert_eq!(
        keys(controller.in_values(taker)).collect::<Vec<_>>(),
        ["ina", "inb"]
    );
    // A net that is loaded and unloaded leaves no link.
    for number in 0..2 * WIRES_MAX {
        let text = format!(
            "{{v=Core::DoubleValue(Value='{number}'),w=Core::DoubleInterNetcommOut(inValue=v.outValue,\
             RemoteNet='{taker}',RemoteKey='b'),{END}}}"
        );
        let next = run(&controller, text);
        wait_until("the next value", || {
            let seen = value(&controller, taker, "outb");
            seen.is_some_and(|v| (v - f64::from(u32::try_from(number).unwrap())).abs() < 1e-12)
        });
        controller.abort(next).unwrap();
        controller.unload(next).unwrap();
    }
}

#[test]
fn net_links_are_bounded() {
    let controller = controller();
    let giver = clock(&controller);
    let loaded: Vec<_> = (0..OUT_READERS + 1)
        .map(|_| load(&controller, reader(giver)))
        .collect();
    let rejections: Vec<_> = loaded
        .iter()
        .filter_map(|net| controller.net(*net).unwrap().rejection)
        .collect();
    assert_eq!(rejections.len(), 2);
    let text = rejections[0].to_string();
    assert!(
        text.contains("nets that read one net") && text.contains('7'),
        "{text}"
    );
    controller.unload(loaded[0]).unwrap();
    let again = load(&controller, reader(giver));
    assert!(controller.net(again).unwrap().rejection.is_none());
}

#[test]
fn evaluation_reads_values_of_nets() {
    let controller = controller();
    let giver = clock(&controller);
    controller.start_net(giver).unwrap();
    wait_until("a value", || value(&controller, giver, "outt").is_some());
    let text = format!(
        "{{i=Core::DoubleInterNetcommIn(RemoteNet='{giver}',RemoteKey='t'),outT=i.outValue,\
         f=Core::BooleanValue(),outTerminate=f.outValue}}"
    );
    let values = controller.evaluate(&text).unwrap();
    assert_eq!(values[0].0, "outT");
    assert!(values[0].1.parse::<f64>().unwrap() > 0.0, "{values:?}");
}
