//! Each rule of succession, one test each.

mod composites;
mod programs;

use std::collections::BTreeSet;

use super::*;

const RESULTS: [&str; 2] = ["completed", "blend"];

fn start(device: &str) -> Start {
    coupled(&[device])
}

fn coupled(devices: &[&str]) -> Start {
    let failures = |device: &&str| {
        [
            Failure::unreachable(device),
            Failure::joints_failed(device),
            Failure::out_of_range(device),
            Failure::conflict(device),
        ]
    };
    Start {
        devices: devices.iter().map(|device| (*device).to_owned()).collect(),
        net: format!("net of {}", devices.join(" and ")),
        loaded: None,
        is_guarded: false,
        results: RESULTS.map(str::to_owned).to_vec(),
        failures: devices.iter().flat_map(failures).collect(),
    }
}

fn begin(engine: &mut Engine, device: &str) -> ActivityId {
    engine.begin(vec![start(device)], When::Follow).unwrap()[0]
}

/// Answers all requests to load and schedule; returns the others.
fn serve(engine: &mut Engine) -> Vec<Action> {
    let mut others = Vec::new();
    loop {
        let actions = engine.take_actions();
        if actions.is_empty() {
            return others;
        }
        for action in actions {
            match action {
                Action::Load {
                    activity: ActivityId(number),
                    ..
                } => {
                    engine.loaded(ActivityId(number), Ok(format!("n{number}")));
                }
                Action::Schedule {
                    group: GroupId(number),
                    ..
                } => {
                    others.push(action);
                    engine.scheduled(GroupId(number), Ok(number.to_string()));
                }
                Action::Unload(ref net) => {
                    engine.net_state(net, "UNLOADED", "");
                    others.push(action);
                }
                Action::Cancel(_) => others.push(action),
            }
        }
    }
}

/// Condition, nets that are stopped, nets that are started, of the only rule.
fn rule(actions: &[Action]) -> (&str, Vec<&str>, Vec<&str>) {
    let rules: Vec<_> = actions
        .iter()
        .filter_map(|action| match action {
            Action::Schedule {
                condition,
                stop,
                start,
                ..
            } => Some((condition.as_str(), texts(stop), texts(start))),
            Action::Load { .. } | Action::Cancel(_) | Action::Unload(_) => None,
        })
        .collect();
    let [rule] = rules.as_slice() else {
        panic!("not one rule: {actions:?}");
    };
    rule.clone()
}

fn texts(nets: &[String]) -> Vec<&str> {
    nets.iter().map(String::as_str).collect()
}

fn net(id: ActivityId) -> String {
    format!("n{}", id.0)
}

/// Ends a net with results that are true.
fn terminate(engine: &mut Engine, id: ActivityId, results: &[&str]) {
    for key in results {
        engine.value(&net(id), key, "true");
    }
    engine.net_state(&net(id), "TERMINATED", "");
}

fn running(engine: &mut Engine, device: &str) -> ActivityId {
    let id = begin(engine, device);
    serve(engine);
    engine.net_state(&net(id), "RUNNING", "");
    assert_eq!(engine.state(id), Some(&State::Running));
    id
}

fn outcome(engine: &Engine, id: ActivityId) -> Result<Outcome, ErrorKind> {
    match engine.state(id) {
        Some(State::Ended(outcome)) => outcome.clone(),
        other => panic!("{id:?} has not ended: {other:?}"),
    }
}

#[test]
fn idle_device_begins_at_once() {
    let mut engine = Engine::default();
    let first = begin(&mut engine, "left");
    let actions = serve(&mut engine);
    assert_eq!(rule(&actions), ("t", vec![], vec![net(first).as_str()]));
    assert_eq!(engine.state(first), Some(&State::Waiting));
    engine.rule_state("1", "FIRED");
    assert_eq!(engine.state(first), Some(&State::Running));
}

fn begin_prepared(engine: &mut Engine, net: &str) -> ActivityId {
    let mut start = start("left");
    start.loaded = Some(net.to_owned());
    start.is_guarded = true;
    start.failures.push(Failure::moved("left"));
    engine.begin(vec![start], When::Follow).unwrap()[0]
}

#[test]
fn prepared_net_is_scheduled_without_load() {
    let mut engine = Engine::default();
    begin_prepared(&mut engine, "p1");
    let actions = engine.take_actions();
    assert_eq!(rule(&actions), ("t", vec![], vec!["p1"]));
    assert_eq!(actions.len(), 1, "{actions:?}");
}

#[test]
fn prepared_net_has_begun_once_it_fits() {
    let mut engine = Engine::default();
    let fits = begin_prepared(&mut engine, "p1");
    serve(&mut engine);
    engine.net_state("p1", "RUNNING", "");
    assert!(!engine.has_begun(fits));
    engine.value("p1", FITS, "true");
    assert!(engine.has_begun(fits));
    engine.value("p1", "completed", "true");
    engine.net_state("p1", "TERMINATED", "");
    let moved = begin_prepared(&mut engine, "p2");
    serve(&mut engine);
    engine.net_state("p2", "RUNNING", "");
    engine.value("p2", "moved_left", "true");
    engine.net_state("p2", "TERMINATED", "");
    assert!(matches!(
        outcome(&engine, moved),
        Err(ErrorKind::Stale { device, .. }) if device == "left"
    ));
}

#[test]
fn successor_waits_for_each_result_of_its_predecessor() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    let actions = serve(&mut engine);
    let (one, two) = (net(first), net(second));
    let condition = format!("({one}.outcompleted|{one}.outblend)");
    assert_eq!(
        rule(&actions),
        (condition.as_str(), vec![one.as_str()], vec![two.as_str()])
    );
}

#[test]
fn third_activity_follows_the_second() {
    let mut engine = Engine::default();
    running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    begin(&mut engine, "left");
    let actions = serve(&mut engine);
    let condition = format!("({0}.outcompleted|{0}.outblend)", net(second));
    assert_eq!(rule(&actions).0, condition);
}

#[test]
fn taken_over_activity_ends_so() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    engine.net_state(&net(second), "RUNNING", "");
    terminate(&mut engine, first, &["blend"]);
    assert_eq!(outcome(&engine, first), Ok(Outcome::TakenOver));
    assert_eq!(engine.state(second), Some(&State::Running));
}

#[test]
fn take_over_is_known_when_the_end_comes_first() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    terminate(&mut engine, first, &["blend"]);
    assert_eq!(outcome(&engine, first), Ok(Outcome::TakenOver));
    engine.net_state(&net(second), "RUNNING", "");
    assert_eq!(engine.state(second), Some(&State::Running));
}

#[test]
fn each_result_has_its_outcome() {
    let failed = |cause: &str| {
        Err(ErrorKind::DeviceFailed {
            device: "left".to_owned(),
            cause: cause.to_owned(),
        })
    };
    let stopped = |name: &str| Ok(Outcome::Stopped(name.to_owned()));
    let table: [(&[&str], Result<Outcome, ErrorKind>); 7] = [
        (&["completed"], Ok(Outcome::Completed)),
        (&["cancelled"], Ok(Outcome::Cancelled)),
        (&["until_touch"], stopped("touch")),
        (&["until_touch", "blend"], stopped("touch")),
        (
            &["failed_left", "blend"],
            failed("a joint does not follow its commands"),
        ),
        (&["illegal_left"], failed("a joint would leave its range")),
        (
            &["concurrent_left"],
            Err(ErrorKind::Conflict {
                device: "left".to_owned(),
                joint: None,
                holder: None,
            }),
        ),
    ];
    for (results, expected) in table {
        let mut engine = Engine::default();
        let id = running(&mut engine, "left");
        terminate(&mut engine, id, results);
        assert_eq!(outcome(&engine, id), expected, "{results:?}");
    }
}

#[test]
fn path_out_of_reach_states_its_place() {
    let mut engine = Engine::default();
    let id = running(&mut engine, "left");
    engine.value(&net(id), "progress", "0.42");
    terminate(&mut engine, id, &["unreachable_left"]);
    let error = outcome(&engine, id).unwrap_err().to_string();
    assert!(error.contains("at 42 % of the motion"), "{error}");
}

#[test]
fn end_without_result_states_the_reason() {
    let mut engine = Engine::default();
    let id = running(&mut engine, "left");
    engine.net_state(&net(id), "TERMINATED", "aborted by a client");
    let error = outcome(&engine, id).unwrap_err().to_string();
    assert!(error.contains("aborted by a client"), "{error}");
}

#[test]
fn successors_of_a_failed_activity_do_not_begin() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    let third = begin(&mut engine, "left");
    serve(&mut engine);
    terminate(&mut engine, first, &["failed_left"]);
    let unloaded = serve(&mut engine);
    for id in [second, third] {
        let error = outcome(&engine, id).unwrap_err();
        assert!(matches!(error, ErrorKind::PredecessorFailed(_)), "{error}");
    }
    for id in [first, second, third] {
        assert!(unloaded.contains(&Action::Unload(net(id))), "{id:?}");
    }
    let next = begin(&mut engine, "left");
    assert_eq!(
        rule(&serve(&mut engine)).2,
        [net(next).as_str()],
        "the device can be used again"
    );
}

#[test]
fn cancelled_activity_takes_its_queue_along() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    engine.cancel(first);
    assert_eq!(serve(&mut engine), [Action::Cancel(net(first))]);
    terminate(&mut engine, first, &["cancelled"]);
    serve(&mut engine);
    assert_eq!(outcome(&engine, second), Ok(Outcome::Cancelled));
}

#[test]
fn cancelled_successor_leaves_its_predecessor_alone() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    engine.cancel(second);
    assert_eq!(serve(&mut engine), [Action::Unload(net(second))]);
    assert_eq!(outcome(&engine, second), Ok(Outcome::Cancelled));
    assert_eq!(engine.state(first), Some(&State::Running));
    assert_eq!(
        engine.latest("left"),
        Some(first),
        "the next one follows the first again"
    );
}

#[test]
fn cancelled_successor_that_begins_all_the_same_takes_over() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    serve(&mut engine);
    engine.cancel(second);
    // Its rule fires before the controller unloads its net; the results of the first one may come later.
    engine.net_state(&net(first), "TERMINATED", "stopped by a rule");
    assert_eq!(outcome(&engine, first), Ok(Outcome::TakenOver));
    engine.net_state(&net(second), "RUNNING", "");
    let actions = serve(&mut engine);
    assert!(
        actions.contains(&Action::Cancel(net(second))),
        "{actions:?}"
    );
}

#[test]
fn activity_stopped_by_rule_of_another_program_has_not_been_taken_over() {
    let mut engine = Engine::default();
    let id = running(&mut engine, "left");
    engine.net_state(&net(id), "TERMINATED", "stopped by a rule");
    assert!(matches!(outcome(&engine, id), Err(ErrorKind::Ended { .. })));
}

#[test]
fn activity_cancelled_while_it_loads_is_unloaded() {
    let mut engine = Engine::default();
    let id = begin(&mut engine, "left");
    engine.take_actions();
    engine.cancel(id);
    engine.loaded(id, Ok("n9".to_owned()));
    assert_eq!(outcome(&engine, id), Ok(Outcome::Cancelled));
    assert_eq!(engine.take_actions(), [Action::Unload("n9".to_owned())]);
}

#[test]
fn rejected_net_ends_its_group() {
    let mut engine = Engine::default();
    let ids = engine
        .begin(vec![start("left"), start("right")], When::Follow)
        .unwrap();
    engine.take_actions();
    engine.loaded(ids[0], Ok("n1".to_owned()));
    let error = ErrorKind::Rejected(vec!["no such robot".to_owned()]);
    engine.loaded(ids[1], Err(error.clone()));
    assert_eq!(outcome(&engine, ids[0]), Err(error.clone()));
    assert_eq!(outcome(&engine, ids[1]), Err(error));
    assert_eq!(engine.take_actions(), [Action::Unload("n1".to_owned())]);
}

#[test]
fn refused_rule_ends_the_activity_and_gives_the_device_back() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    engine.take_actions();
    engine.loaded(second, Ok(net(second)));
    let Some(Action::Schedule { group, .. }) = engine.take_actions().pop() else {
        panic!("no rule");
    };
    engine.scheduled(
        group,
        Err(ErrorKind::Refused("left joint 2 is taken".to_owned())),
    );
    assert_eq!(
        outcome(&engine, second),
        Err(ErrorKind::Refused("left joint 2 is taken".to_owned()))
    );
    assert_eq!(engine.latest("left"), Some(first));
}

#[test]
fn group_waits_for_all_predecessors_and_starts_in_one_rule() {
    let mut engine = Engine::default();
    let (left, right) = (running(&mut engine, "left"), running(&mut engine, "right"));
    let both = engine
        .begin(vec![start("left"), start("right")], When::Follow)
        .unwrap();
    let actions = serve(&mut engine);
    let of = |id| format!("({0}.outcompleted|{0}.outblend)", net(id));
    let (condition, stop, start) = rule(&actions);
    assert_eq!(condition, format!("{}&{}", of(left), of(right)));
    assert_eq!(stop, [net(left), net(right)]);
    assert_eq!(start, [net(both[0]), net(both[1])]);
}

#[test]
fn result_of_a_predecessor_is_kept_until_its_successor_begins() {
    let mut engine = Engine::default();
    let (left, right) = (running(&mut engine, "left"), running(&mut engine, "right"));
    let both = engine
        .begin(vec![start("left"), start("right")], When::Follow)
        .unwrap();
    serve(&mut engine);
    terminate(&mut engine, left, &["completed"]);
    assert_eq!(serve(&mut engine), [], "the rule still reads its result");
    engine.rule_state(&both[0].0.saturating_sub(1).to_string(), "FIRED");
    terminate(&mut engine, right, &["blend"]);
    assert_eq!(outcome(&engine, right), Ok(Outcome::TakenOver));
    let unloaded = serve(&mut engine);
    assert_eq!(unloaded.len(), 2, "{unloaded:?}");
}

#[test]
fn coupled_arms_follow_both_and_keep_both() {
    let mut engine = Engine::default();
    let (left, right) = (running(&mut engine, "left"), running(&mut engine, "right"));
    let both = engine
        .begin(vec![coupled(&["left", "right"])], When::Follow)
        .unwrap()[0];
    let of = |id| format!("({0}.outcompleted|{0}.outblend)", net(id));
    let actions = serve(&mut engine);
    let (condition, stop, start) = rule(&actions);
    assert_eq!(condition, format!("{}&{}", of(left), of(right)));
    assert_eq!(stop, [net(left), net(right)]);
    assert_eq!(start, [net(both)]);
    for device in ["left", "right"] {
        assert_eq!(engine.latest(device), Some(both));
    }
    let next = begin(&mut engine, "right");
    let actions = serve(&mut engine);
    let both = net(both);
    assert_eq!(
        rule(&actions).1,
        [both.as_str()],
        "a successor of one arm ends the net of both"
    );
    engine.cancel_device("left");
    serve(&mut engine);
    assert_eq!(outcome(&engine, next), Ok(Outcome::Cancelled));
}

#[test]
fn coupled_arms_may_not_repeat_a_device() {
    let mut engine = Engine::default();
    for starts in [
        vec![coupled(&["left", "left"])],
        vec![coupled(&["left", "right"]), start("right")],
    ] {
        let error = engine.begin(starts, When::Follow).unwrap_err();
        assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
    }
}

#[test]
fn now_does_not_wait() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = engine.begin(vec![start("left")], When::Now).unwrap()[0];
    let actions = serve(&mut engine);
    assert_eq!(
        rule(&actions),
        ("t", vec![net(first).as_str()], vec![net(second).as_str()])
    );
    terminate(&mut engine, first, &[]);
    assert_eq!(outcome(&engine, first), Ok(Outcome::TakenOver));
}

#[test]
fn one_device_twice_is_refused() {
    let mut engine = Engine::default();
    let error = engine
        .begin(vec![start("left"), start("left")], When::Follow)
        .unwrap_err();
    assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
    assert!(engine.begin(Vec::new(), When::Follow).is_err());
    assert_eq!(engine.take_actions(), []);
}

#[test]
fn lost_connection_ends_everything() {
    let mut engine = Engine::default();
    let first = running(&mut engine, "left");
    let second = begin(&mut engine, "left");
    let lost = ErrorKind::Lost("closed".to_owned());
    engine.lose(&lost);
    for id in [first, second] {
        assert_eq!(outcome(&engine, id), Err(lost.clone()));
    }
    assert_eq!(engine.begin(vec![start("left")], When::Follow), Err(lost));
    assert_eq!(engine.take_actions(), []);
}

#[test]
fn released_activities_are_forgotten_once_ended() {
    let mut engine = Engine::default();
    let mut last = running(&mut engine, "left");
    for _ in 0..1000 {
        let next = begin(&mut engine, "left");
        serve(&mut engine);
        engine.net_state(&net(next), "RUNNING", "");
        terminate(&mut engine, last, &["blend"]);
        engine.release(last);
        serve(&mut engine);
        last = next;
    }
    assert!(
        engine.activities.len() <= 2 && engine.nets.len() <= 2,
        "{}",
        engine.activities.len()
    );
    assert!(
        engine.groups.len() <= 2 && engine.rules.len() <= 2,
        "{}",
        engine.groups.len()
    );
}

/// The rule that was requested last.
fn last_rule(actions: &[Action]) -> String {
    let rule = |action: &Action| match action {
        Action::Schedule { group, .. } => Some(group.0.to_string()),
        Action::Load { .. } | Action::Cancel(_) | Action::Unload(_) => None,
    };
    actions.iter().rev().find_map(rule).unwrap()
}

#[test]
fn blended_chain_of_10_000_stays_small() {
    let mut engine = Engine::default();
    let mut before: Option<ActivityId> = None;
    for _ in 0..10_000 {
        let id = begin(&mut engine, "left");
        let rule = last_rule(&serve(&mut engine));
        assert!(engine.nets().len() <= 2, "one motion ahead");
        if let Some(before) = before {
            engine.value(&net(before), "blend", "true");
        }
        engine.rule_state(&rule, "FIRED");
        assert_eq!(engine.state(id), Some(&State::Running));
        if let Some(before) = before.replace(id) {
            terminate(&mut engine, before, &[]);
            assert_eq!(outcome(&engine, before), Ok(Outcome::TakenOver));
            engine.release(before);
            serve(&mut engine);
        }
        let sizes = [
            engine.activities.len(),
            engine.groups.len(),
            engine.nets.len(),
            engine.rules.len(),
        ];
        assert!(sizes.iter().all(|size| *size <= 2), "{sizes:?}");
    }
}
