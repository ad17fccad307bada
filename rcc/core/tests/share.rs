//! What nets take together: what is refused when those of one thread would cost more than a cycle has, and
//! what the refusal says. That the sums are right is shown beside the executor.

#![expect(
    clippy::unwrap_used,
    reason = "a test may fail anywhere, its helpers too"
)]

use takt_core::controller::{LoadRequest, NETS_TEXT_MAX, NetState, RuleRequest};
use takt_core::{CellConfig, Controller, NetId, SessionId};

/// Never ends, and costs about 50 us a cycle for each of `tracks` by what it declares.
fn costly(tracks: usize) -> String {
    let mut text =
        String::from("{g=Core::DoubleArrayNetcommIn(Key='g',Value='[0,0,0,0,0,0,0,0]'),");
    for number in 0..tracks {
        text += &format!("t{number}=Motion::Track(inGoal=g.outValue),");
    }
    text + "never=Core::BooleanValue(),outTerminate=never.outValue}"
}

fn load(controller: &Controller, text: String) -> Result<NetId, String> {
    let request = LoadRequest {
        text,
        session: SessionId::NONE,
        description: String::new(),
        period: None,
    };
    controller.load(request).map_err(|e| e.to_string())
}

fn ready(controller: &Controller, tracks: usize) -> NetId {
    let net = load(controller, costly(tracks)).unwrap();
    let info = controller.net(net).unwrap();
    assert_eq!(info.state(), NetState::Ready, "{:?}", info.rejection);
    net
}

#[test]
fn a_start_that_overloads_its_thread_is_refused_and_names_the_heaviest() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let [first, second] = [10, 9].map(|tracks| ready(&controller, tracks));
    controller.start_net(first).unwrap();
    let why = controller.start_net(second).unwrap_err().to_string();
    assert!(why.contains(&format!("net {second} costs up to ")), "{why}");
    assert!(why.contains(&format!("taken: net {first} with ")), "{why}");
    assert!(why.contains("of the 800µs"), "{why}");
    // A refusal changes nothing: there is room once the other has ended.
    controller.abort(first).unwrap();
    controller.start_net(second).unwrap();
}

#[test]
fn a_switch_between_two_nets_that_fit_only_one_by_one_is_possible() {
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
        why.contains("stay taken by nets that the rule does not follow"),
        "{why}"
    );
    let instead = rule(format!("{first}.terminated"), vec![first], second);
    controller.schedule(instead).unwrap();
    assert_eq!(controller.net(second).unwrap().state(), NetState::Scheduled);
}

#[test]
fn texts_of_all_nets_together_are_bounded() {
    let controller = Controller::start(&CellConfig::default()).unwrap();
    let large = NETS_TEXT_MAX / 4;
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
        why.contains("bytes of the texts of all nets: at most 67108864"),
        "{why}"
    );
    controller.unload(most).unwrap();
    load(&controller, text(1000)).unwrap();
    // One that is over makes room.
    controller.abort(kept[0]).unwrap();
    load(&controller, text(large)).unwrap();
    assert!(controller.net(kept[0]).is_none());
}
