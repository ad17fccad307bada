//! `takt top` against a running controller with an emulated arm: as text, as JSON, live in a terminal, and when the controller
//! does not answer.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

mod common;
#[path = "common/terminal.rs"]
mod terminal;

use std::time::Duration;

use common::{Cell, alone, complaint, expect_status, run, takt};
use serde_json::Value;
use takt_tests::steady;
use terminal::Terminal;

const ENDLESS: &str = "{x=Cancel(),outTerminate=x.outCancel}";

#[test]
fn top_once_and_json_show_devices_nets_and_findings() {
    let _alone = alone();
    steady(|| {
        let mut cell = Cell::start();
        let http = cell.http.clone();
        let once = ["top", "--once", "--connect", &http];
        // A robot that is missing fails, with its remedy.
        let text = expect_status(&run(&once), 1);
        for part in [
            " FAIL",
            "\nFAIL  left is offline",
            "\n      hint: ",
            "\nTHREADS ",
            "\nnets  ",
            "\nDEVICES ",
            "\nleft         kuka_lwr_fri       off ",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        assert!(!text.contains('\u{1b}') && !text.contains("NETS"), "{text}");

        let _arm = cell.arm();
        let net = cell.load(ENDLESS);
        expect_status(&cell.net(&["start", &net]), 0);
        let json = run(&["top", "--json", "--connect", &cell.http]);
        let text = String::from_utf8(json.stdout).unwrap();
        let json: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["schema"], "takt-top/1");
        let device = &json["devices"][0];
        assert_eq!(device["name"], "left");
        assert_eq!(device["state"], "op");
        assert!(device["age_ns"].as_i64().unwrap() > 0, "{device}");
        assert!(!device["quality"].as_str().unwrap().is_empty(), "{device}");
        assert_eq!(json["nets"][0]["name"], net.as_str());
        assert_eq!(json["nets"][0]["state"], "RUNNING");
        assert!(json["nets"][0]["figures"]["cost_ns"].as_i64().unwrap() > 0);
        let thread = &json["threads"][0];
        assert!(thread["cycles"].as_u64().unwrap() > 0, "{thread}");
        assert_eq!(thread["period_ns"], 1_000_000);
        assert!(thread["execution"]["max_ns"].as_i64().unwrap() > 0);

        expect_status(&run(&["stop", "--socket", &cell.stop]), 0);
        let text = expect_status(&run(&once), 1);
        assert!(
            text.contains("FAIL  everything is stopped, by process "),
            "{text}"
        );
    });
}

#[test]
fn top_without_answer_or_token_is_status_2() {
    let _alone = alone();
    let cell = Cell::start();
    let top = |address: &str| run(&["top", "--once", "--connect", address]);
    cell.process.signal("STOP");
    let silent = top(&cell.http);
    cell.process.signal("CONT");
    expect_status(&silent, 2);
    let why = complaint(&silent);
    assert!(
        why.contains("the controller has not answered within 3s") && why.contains("\nhint: "),
        "{why}"
    );
    let none = top("127.0.0.1:1");
    expect_status(&none, 2);
    assert!(
        complaint(&none).contains("no controller answers there\nhint: see `websocket`"),
        "{}",
        complaint(&none)
    );
    let output = top("nonsense");
    expect_status(&output, 2);
    assert!(complaint(&output).contains("hint: write HOST:PORT"));
    // The port of lines is none of HTTP.
    expect_status(&top(&cell.tcp), 2);
}

#[test]
fn top_live_shows_lost_connection_and_return() {
    let _alone = alone();
    let cell = Cell::start();
    let top = ["top", "--interval", "100ms", "--connect", &cell.http];
    let mut terminal = Terminal::start(takt(&top), 80, 24);
    terminal.wait_for("left         kuka_lwr_fri       off");
    terminal.wait_for("q end  s order");
    cell.process.signal("STOP");
    terminal.wait_for("connection lost");
    cell.process.signal("CONT");
    terminal.wait_for("takt 0.1.0 at");
    terminal.key("?");
    terminal.wait_for("pause and go on");
    terminal.key("q");
    assert_eq!(terminal.end(Duration::from_secs(20)), Some(0));
}
