//! Parts of one call: sequences, alternatives, and activities that start by results of others.

use super::*;

fn part(device: &str) -> Part {
    Part::new(vec![start(device)], When::Follow)
}

fn trigger(part: usize, key: &str) -> Option<Trigger> {
    let keys = vec![key.to_owned()];
    Some(Trigger { part, keys })
}

fn begin_all(engine: &mut Engine, parts: Vec<Part>) -> Vec<ActivityId> {
    let begun = engine.begin_all(parts).unwrap();
    begun.into_iter().flatten().collect()
}

/// Conditions of all rules, in their order.
fn conditions(actions: &[Action]) -> Vec<&str> {
    let conditions = actions.iter().filter_map(|action| match action {
        Action::Schedule { condition, .. } => Some(condition.as_str()),
        Action::Load { .. } | Action::Cancel(_) | Action::Unload(_) => None,
    });
    conditions.collect()
}

fn open(id: ActivityId) -> String {
    format!("({0}.outcompleted|{0}.outblend)", net(id))
}

#[test]
fn sequence_is_scheduled_before_its_first_activity() {
    let mut engine = Engine::default();
    let second = Part {
        after: vec![vec![0]],
        ..part("left")
    };
    let third = Part {
        after: vec![vec![1]],
        ..part("right")
    };
    let ids = begin_all(&mut engine, vec![part("left"), second, third]);
    let actions = serve(&mut engine);
    let conditions = conditions(&actions);
    // Another device does not take over: it waits for the end.
    let ended = format!("({}.outcompleted)", net(ids[1]));
    assert_eq!(conditions, [open(ids[0]).as_str(), &ended, "t"]);
}

#[test]
fn sequence_with_a_rejected_net_does_not_begin() {
    let mut engine = Engine::default();
    let second = Part {
        after: vec![vec![0]],
        ..part("left")
    };
    let ids = begin_all(&mut engine, vec![part("left"), second]);
    engine.take_actions();
    engine.loaded(ids[0], Ok(net(ids[0])));
    let error = ErrorKind::Rejected(vec!["wrong".to_owned()]);
    engine.loaded(ids[1], Err(error.clone()));
    for id in ids {
        assert_eq!(outcome(&engine, id), Err(error.clone()));
    }
    assert_eq!(conditions(&serve(&mut engine)), [] as [&str; 0]);
}

#[test]
fn result_starts_its_successor_and_the_others_are_skipped() {
    let touched = Part {
        trigger: trigger(0, "until_touch"),
        ..part("left")
    };
    let arrived = Part {
        trigger: trigger(0, "completed"),
        ..part("left")
    };
    let mut engine = Engine::default();
    let ids = begin_all(&mut engine, vec![part("left"), touched, arrived]);
    let actions = serve(&mut engine);
    let of = |key: &str| format!("({}.out{key})", net(ids[0]));
    assert_eq!(
        conditions(&actions),
        [of("until_touch").as_str(), &of("completed"), "t"]
    );
    engine.net_state(&net(ids[0]), "RUNNING", "");
    // What comes next follows whichever of them runs.
    let next = begin(&mut engine, "left");
    let actions = serve(&mut engine);
    let (one, two, three) = (net(ids[0]), net(ids[1]), net(ids[2]));
    let expected =
        format!("({two}.outcompleted|{two}.outblend|{three}.outcompleted|{three}.outblend)");
    assert_eq!(rule(&actions).0, expected);
    assert_eq!(rule(&actions).1, [&one, &two, &three]);
    engine.net_state(&two, "RUNNING", "");
    terminate(&mut engine, ids[0], &["until_touch"]);
    serve(&mut engine);
    assert!(outcome(&engine, ids[0]).unwrap().is_stopped_by("touch"));
    assert_eq!(outcome(&engine, ids[2]), Ok(Outcome::Skipped));
    assert_eq!(engine.state(next), Some(&State::Waiting));
}

#[test]
fn progress_starts_another_device_and_stops_nothing() {
    let mut engine = Engine::default();
    let tool = running(&mut engine, "tool");
    let half = Part {
        trigger: trigger(0, "mark_0"),
        ..part("tool")
    };
    let ids = begin_all(&mut engine, vec![part("left"), half]);
    let actions = serve(&mut engine);
    let Some(Action::Schedule {
        condition, stop, ..
    }) = actions.first()
    else {
        panic!("no rule");
    };
    assert_eq!(
        *condition,
        format!("({}.outmark_0)&{}", net(ids[0]), open(tool))
    );
    assert_eq!(texts(stop), [net(tool)]);
}

#[test]
fn trigger_that_does_not_occur_skips_its_part() {
    let mut engine = Engine::default();
    let half = Part {
        trigger: trigger(0, "mark_0"),
        ..part("tool")
    };
    let ids = begin_all(&mut engine, vec![part("left"), half]);
    serve(&mut engine);
    engine.net_state(&net(ids[0]), "RUNNING", "");
    terminate(&mut engine, ids[0], &["failed_left"]);
    serve(&mut engine);
    assert_eq!(outcome(&engine, ids[1]), Ok(Outcome::Skipped));
    let next = begin(&mut engine, "tool");
    assert_eq!(rule(&serve(&mut engine)).2, [net(next)]);
}

#[test]
fn alternative_begins_if_the_first_is_rejected() {
    let mut engine = Engine::default();
    let other = Part {
        instead_of: Some(0),
        ..part("right")
    };
    let ids = begin_all(&mut engine, vec![part("left"), other]);
    let loads = engine.take_actions();
    assert_eq!(loads.len(), 1, "the alternative is not loaded: {loads:?}");
    engine.loaded(ids[0], Err(ErrorKind::Rejected(Vec::new())));
    let actions = serve(&mut engine);
    assert_eq!(rule(&actions), ("t", vec![], vec![net(ids[1]).as_str()]));
    assert_eq!(engine.state(ids[1]), Some(&State::Waiting));
}

#[test]
fn alternative_begins_if_the_rule_is_refused() {
    let mut engine = Engine::default();
    let other = Part {
        instead_of: Some(0),
        ..part("right")
    };
    let ids = begin_all(&mut engine, vec![part("left"), other]);
    engine.take_actions();
    engine.loaded(ids[0], Ok(net(ids[0])));
    let Some(Action::Schedule { group, .. }) = engine.take_actions().pop() else {
        panic!("no rule");
    };
    engine.scheduled(group, Err(ErrorKind::Refused("taken".to_owned())));
    let actions = serve(&mut engine);
    assert_eq!(rule(&actions).2, [net(ids[1])]);
}

#[test]
fn alternative_is_skipped_once_the_first_runs() {
    let mut engine = Engine::default();
    let other = Part {
        instead_of: Some(0),
        ..part("right")
    };
    let ids = begin_all(&mut engine, vec![part("left"), other]);
    serve(&mut engine);
    engine.net_state(&net(ids[0]), "RUNNING", "");
    assert_eq!(outcome(&engine, ids[1]), Ok(Outcome::Skipped));
    assert_eq!(engine.latest("right"), None);
}

#[test]
fn cancelled_alternatives_do_not_begin() {
    let mut engine = Engine::default();
    let other = Part {
        instead_of: Some(0),
        ..part("left")
    };
    let ids = begin_all(&mut engine, vec![part("left"), other]);
    engine.cancel(ids[0]);
    serve(&mut engine);
    for id in ids {
        assert_eq!(outcome(&engine, id), Ok(Outcome::Cancelled));
    }
}

#[test]
fn after_failure_follows_every_end() {
    for end in ["failed_left", "cancelled", "completed", ""] {
        let mut engine = Engine::default();
        let first = running(&mut engine, "left");
        let recovery = Part {
            after_failure: true,
            ..part("left")
        };
        let ids = begin_all(&mut engine, vec![recovery]);
        let actions = serve(&mut engine);
        let condition = rule(&actions).0;
        assert!(condition.contains("outfailed_left"), "{condition}");
        assert!(condition.contains("outcancelled"), "{condition}");
        let results: Vec<_> = Some(end)
            .filter(|end| !end.is_empty())
            .into_iter()
            .collect();
        terminate(&mut engine, first, &results);
        if end.is_empty() {
            let Some(Action::Schedule { group, .. }) = actions.first() else {
                panic!("no rule");
            };
            engine.rule_state(&group.0.to_string(), "INACTIVE");
            assert_eq!(rule(&serve(&mut engine)).0, "t", "scheduled again");
        }
        assert_eq!(engine.state(ids[0]), Some(&State::Waiting), "{end}");
    }
}

#[test]
fn maintained_goal_is_open_to_a_successor_and_ends_completed() {
    let mut engine = Engine::default();
    let mut press = start("left");
    press.results.push("maintaining".to_owned());
    let id = engine.begin(vec![press], When::Follow).unwrap()[0];
    serve(&mut engine);
    engine.net_state(&net(id), "RUNNING", "");
    assert!(!engine.is_maintaining(id));
    engine.value(&net(id), "maintaining", "true");
    assert!(engine.is_maintaining(id));
    let next = begin(&mut engine, "left");
    let actions = serve(&mut engine);
    assert!(rule(&actions).0.contains("outmaintaining"));
    engine.cancel(next);
    serve(&mut engine);
    engine.cancel(id);
    engine.value(&net(id), "maintaining", "false");
    terminate(&mut engine, id, &["cancelled"]);
    assert_eq!(outcome(&engine, id), Ok(Outcome::Completed));
}

#[test]
fn part_before_itself_is_refused() {
    let mut engine = Engine::default();
    let parts = [
        Part {
            after: vec![vec![0]],
            ..part("left")
        },
        Part {
            trigger: trigger(1, "completed"),
            ..part("left")
        },
        Part {
            instead_of: Some(7),
            ..part("left")
        },
    ];
    for part in parts {
        let error = engine.begin_all(vec![part]).unwrap_err();
        assert!(matches!(error, ErrorKind::Invalid(_)), "{error}");
    }
    assert!(engine.begin_all(Vec::new()).is_err());
    assert_eq!(engine.take_actions(), []);
}
