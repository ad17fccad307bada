//! `takt net` against a running controller: the tutorial of docs/nets.md, and nets that do not exist. What nets compute is
//! tested elsewhere.

mod common;

use common::{Cell, alone, complaint, expect_status};

/// The nets of the tutorial, in its order.
fn tutorial() -> Vec<&'static str> {
    let text = include_str!("../../docs/nets.md");
    let blocks = text.split("```net\n").skip(1);
    blocks.filter_map(|rest| rest.split("```").next()).collect()
}

#[test]
fn tutorial_nets_run_and_take_values() {
    let _alone = alone();
    let cell = Cell::start();
    let nets = tutorial();
    let clock = cell.load(nets[0]);
    expect_status(&cell.net(&["start", &clock]), 0);
    let mut watch = cell.watch(&clock);
    watch.wait_for("RUNNING");
    watch.wait_for("time 0.");
    let wave = cell.load(nets[1]);
    expect_status(&cell.net(&["start", &wave]), 0);
    expect_status(&cell.net(&["set", &wave, "amplitude=0"]), 0);
    let mut zero = cell.watch(&wave);
    zero.wait_for("wave 0");
    let unknown = cell.net(&["set", &wave, "amplitud=0"]);
    expect_status(&unknown, 1);
    assert!(
        complaint(&unknown).contains("it takes amplitude"),
        "{}",
        complaint(&unknown)
    );
    let wrong = cell.net(&["set", &wave, "amplitude=much"]);
    expect_status(&wrong, 1);
    expect_status(&cell.net(&["cancel", &clock]), 0);
    let (lines, status) = watch.end();
    assert_eq!(status, Some(0), "{lines:#?}");
}

#[test]
fn tap_prints_each_cycle_until_duration() {
    let _alone = alone();
    let cell = Cell::start();
    let net = tutorial()[1].replace("inFirst=wave", "inFirst[10]=wave");
    let id = cell.load(&net);
    expect_status(&cell.net(&["start", &id]), 0);
    let taps = expect_status(&cell.net(&["tap", &id, "--duration", "1s", "--json"]), 0);
    let numbers = taps.lines().map(|line| {
        let record: serde_json::Value = serde_json::from_str(line).unwrap();
        (
            record["time_ns"].as_i64().unwrap(),
            record["product.inFirst"].as_f64().unwrap(),
        )
    });
    let numbers: Vec<_> = numbers.collect();
    assert!(
        numbers.len() > 10 && numbers.is_sorted_by(|a, b| a.0 < b.0),
        "{taps}"
    );
    let missing = cell.net(&["tap", &id, "product.inSecond"]);
    expect_status(&missing, 1);
    assert!(complaint(&missing).contains("it has product.inFirst"));
}

#[test]
fn takeover_is_good_end_of_predecessor() {
    let _alone = alone();
    let cell = Cell::start();
    let [first, second] = [0, 1].map(|net| cell.load(tutorial()[net]));
    expect_status(&cell.net(&["start", &first]), 0);
    let watch = cell.watch(&first);
    let schedule = ["schedule", &second, "--after", &first, "--when", "t"];
    expect_status(&cell.net(&schedule), 0);
    let (lines, status) = watch.end();
    assert_eq!(status, Some(0), "{lines:#?}");
    assert_eq!(lines.last(), Some(&format!("taken over by {second}")));
}

#[test]
fn net_that_does_not_exist_is_named() {
    let _alone = alone();
    let cell = Cell::start();
    let there = cell.load(tutorial()[0]);
    for args in [
        &["start", "rpinet9"][..],
        &["cancel", "rpinet9"],
        &["abort", "rpinet9"],
        &["unload", "rpinet9"],
        &["watch", "rpinet9"],
        &["stats", "rpinet9"],
        &["set", "rpinet9", "a=1"],
        &["tap", "rpinet9"],
        &["schedule", "rpinet9", "--after", &there],
        &["schedule", &there, "--after", "rpinet9"],
        &["schedule", &there, "--after", "rpinet9", "--when", "t"],
    ] {
        let output = cell.net(args);
        expect_status(&output, 1);
        let text = complaint(&output);
        assert!(
            text.contains("there is no net rpinet9\nhint: `takt net list`"),
            "{args:?}: {text}"
        );
    }
}
