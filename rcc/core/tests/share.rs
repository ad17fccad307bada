//! Admission control: nets of one thread that would exceed its cycle are rejected, with a useful error. The sums are
//! tested in the executor.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use std::time::Duration;

use takt_core::controller::{LoadRequest, NetState, RuleRequest, RuleState};
use takt_core::{CellConfig, Controller, NetId, SessionId};

/// Never ends; its declared cost is about 50 us per cycle for each of `tracks`.
fn costly(tracks: usize) -> String {
    let mut text =
        String::from("{g=Core::DoubleArrayNetcommIn(Key='g',Value='[0,0,0,0,0,0,0,0]'),");
    for number in 0..tracks {
        text += &format!("t{number}=Motion::Track(inGoal=g.outValue),");
    }
    text + "never=Core::BooleanValue(),outTerminate=never.outValue}"
}

fn request(text: String) -> LoadRequest {
    LoadRequest {
        text,
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    }
}

fn load(controller: &Controller, text: String) -> Result<NetId, String> {
    controller.load(request(text)).map_err(|e| e.to_string())
}

fn ready(controller: &Controller, tracks: usize) -> NetId {
    let net = load(controller, costly(tracks)).unwrap();
    let info = controller.net(net).unwrap();
    assert_eq!(info.state(), NetState::Ready, "{:?}", info.rejection);
    net
}

#[test]
fn overloading_start_is_rejected_naming_heaviest() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let [first, second] = [10, 9].map(|tracks| ready(&controller, tracks));
    controller.start_net(first).unwrap();
    let why = controller.start_net(second).unwrap_err().to_string();
    assert!(why.contains(&format!("net {second} costs up to ")), "{why}");
    assert!(why.contains(&format!("taken: net {first} with ")), "{why}");
    assert!(why.contains("of the 800µs"), "{why}");
    // A rejection changes nothing: the net is accepted once the other has ended.
    controller.abort(first).unwrap();
    controller.start_net(second).unwrap();
}

#[test]
fn slow_net_must_fit_one_thread_cycle() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let every_tenth = |tracks: usize| {
        let request = LoadRequest {
            period: Some(Duration::from_millis(10)),
            ..request(costly(tracks))
        };
        let net = controller.load(request).unwrap();
        controller.net(net).unwrap()
    };
    let rejected = every_tenth(20);
    assert_eq!(rejected.state(), NetState::Rejected);
    let why = rejected.rejection.unwrap().to_string();
    for part in [
        "may cost 800µs",
        "net thread of 1ms",
        "one of 10",
        "net thread of 10ms",
    ] {
        assert!(why.contains(part), "{why}");
    }
    controller.start_net(every_tenth(10).id).unwrap();
}

#[test]
fn switch_between_nets_filling_budget_works() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let [first, second, third, fourth] = [10, 9, 8, 1].map(|tracks| ready(&controller, tracks));
    controller.start_net(first).unwrap();
    let rule = |condition: String, stop: Vec<NetId>, start: NetId| RuleRequest {
        condition,
        stop,
        start: vec![start],
        ..RuleRequest::default()
    };
    let beside = rule(format!("{fourth}.terminated"), vec![], third);
    let why = controller.schedule(beside).unwrap_err().to_string();
    assert!(
        why.contains(&format!("Running beside them: net {first} with ")),
        "{why}"
    );
    let instead = rule(format!("{first}.terminated"), vec![first], second);
    controller.schedule(instead).unwrap();
    assert_eq!(controller.net(second).unwrap().state(), NetState::Scheduled);
}

/// A controller with a net memory quota in MiB, a sixteenth of it for texts.
fn narrow(mib: u32) -> Controller {
    let mut cell = CellConfig::default();
    cell.controller.nets_memory_mib = mib;
    Controller::start(&cell).unwrap()
}

#[test]
fn net_text_quota_is_enforced() {
    let controller = narrow(16);
    let large = (1 << 20) / 4;
    let text = |bytes: usize| {
        let net = costly(1);
        format!("{net}{}", " ".repeat(bytes - net.len()))
    };
    let kept: Vec<_> = (0..3)
        .map(|_| load(&controller, text(large)).unwrap())
        .collect();
    let most = load(&controller, text(large)).unwrap();
    let why = load(&controller, text(1000)).unwrap_err();
    assert!(
        why.contains("bytes of the texts of all nets: at most 1048576"),
        "{why}"
    );
    controller.unload(most).unwrap();
    load(&controller, text(1000)).unwrap();
    // An ended net is unloaded for a new one, but only if that one then fits.
    controller.abort(kept[0]).unwrap();
    load(&controller, text(2 * large + 1)).unwrap_err();
    assert!(controller.net(kept[0]).is_some());
    load(&controller, text(large)).unwrap();
    assert!(controller.net(kept[0]).is_none());
}

/// Remembers 50 s of a value: 400 kB.
const MINDFUL: &str =
    "{clock=Core::Clock(),mean=Core::DoubleAverage(inValue=clock.outValue,Duration='50'),
    never=Core::BooleanValue(),outTerminate=never.outValue}";

#[test]
fn net_memory_quota_is_enforced() {
    let controller = narrow(1);
    let state = |net| controller.net(net).unwrap().state();
    let [first, second, third] = [(); 3].map(|()| load(&controller, MINDFUL.to_owned()).unwrap());
    assert_eq!([state(first), state(second)], [NetState::Ready; 2]);
    assert_eq!(state(third), NetState::Rejected);
    let why = controller.net(third).unwrap().rejection.unwrap();
    assert!(
        why.to_string().contains("bytes of arrays and histories"),
        "{why}"
    );
    // An ended or rejected net takes no memory.
    controller.abort(first).unwrap();
    let again = load(&controller, MINDFUL.to_owned()).unwrap();
    assert_eq!(state(again), NetState::Ready);
}

#[test]
fn concurrent_loads_respect_memory_quota() {
    let controller = narrow(1);
    let loads: Vec<_> = (0..8)
        .map(|_| {
            let controller = controller.clone();
            std::thread::spawn(move || load(&controller, MINDFUL.to_owned()).unwrap())
        })
        .collect();
    let nets: Vec<_> = loads.into_iter().map(|load| load.join().unwrap()).collect();
    let ready = |net: &&NetId| controller.net(**net).unwrap().state() == NetState::Ready;
    assert_eq!(nets.iter().filter(ready).count(), 2);
}

/// Ends when its input `end` is true.
fn ends_by_input(tracks: usize) -> String {
    costly(tracks).replace("never=Core::BooleanValue()", "never=Core::BooleanNetcommIn(Key='end'),
        good=Core::BooleanNetcommIn(Key='in'),out=Core::BooleanNetcommOut(inValue=good.outValue,Key='good')")
}

#[test]
fn second_rule_exceeding_budget_is_rejected() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let first = load(&controller, ends_by_input(8)).unwrap();
    let [second, third] = [10, 9].map(|tracks| ready(&controller, tracks));
    controller.start_net(first).unwrap();
    let rule = |condition: String, start: NetId| {
        let request = RuleRequest {
            condition,
            start: vec![start],
            ..RuleRequest::default()
        };
        controller.schedule(request).map_err(|e| e.to_string())
    };
    rule(format!("{first}.terminated & {first}.outgood"), second).unwrap();
    let why = rule(format!("{first}.terminated"), third).unwrap_err();
    for part in [
        "the nets to be started cost up to ",
        "would come to ",
        "may cost 800µs",
    ] {
        assert!(why.contains(part), "{why}");
    }
    assert!(
        why.contains(&format!("waiting for rules: net {second} with ")),
        "{why}"
    );
    assert!(!why.contains(&format!("net {first}")), "it ends: {why}");
    assert_eq!(controller.net(third).unwrap().state(), NetState::Ready);
    // Only one of the two may run.
    rule(format!("{first}.terminated & !{first}.outgood"), third).unwrap();
}

#[test]
fn cycle_time_is_reserved_for_scheduled_nets() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let [first, second, small, beside] = [8, 10, 2, 5].map(|tracks| ready(&controller, tracks));
    controller.start_net(first).unwrap();
    let follow = RuleRequest {
        condition: format!("{first}.terminated"),
        start: vec![second],
        ..RuleRequest::default()
    };
    let rule = controller.schedule(follow).unwrap();
    controller.start_net(small).unwrap();
    // It fits beside the running nets, but not beside the successor.
    let why = controller.start_net(beside).unwrap_err().to_string();
    assert!(why.contains("with what rules may start beside it"), "{why}");
    assert!(why.contains(&format!("net {second} with ")), "{why}");
    // After an abort nothing is reserved any more.
    controller.abort(first).unwrap();
    while controller.rule(rule).unwrap().state == RuleState::Active {
        std::thread::sleep(Duration::from_millis(1));
    }
    controller.start_net(beside).unwrap();
}
