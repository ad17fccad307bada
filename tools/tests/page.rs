//! The page in a real browser, from a controller with an emulated arm: it loads without errors, shows what happens, and keeps to
//! the rule of the token.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

#[path = "common/browser.rs"]
mod browser;
mod common;

use std::collections::BTreeSet;

use browser::Browser;
use common::{Cell, Folder, Process, alone, expect_status, run};
use takt_tests::steady;

/// A browser; notes the skip of `test` without one.
fn browser(test: &str) -> Option<Browser> {
    Browser::start()
        .map_err(|why| takt_tests::skip(test, &why))
        .ok()
}

#[test]
fn page_shows_devices_and_motion_without_errors() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("page_shows_devices_and_motion_without_errors") else {
            return;
        };
        let mut cell = Cell::start();
        browser.open(&format!("http://{}/", cell.http));
        browser.wait_for("live", "live");
        assert!(browser.text("").contains(&cell.http));
        let shown = browser.wait_for("devices", "left");
        assert!(shown.contains("kuka_lwr_fri\toff\t—"), "{shown}");
        let _arm = cell.arm();
        let shown = browser.wait_for("devices", "kuka_lwr_fri\top\t");
        assert!(!shown.contains('—') && shown.contains("rad"), "{shown}");

        let goal = ["0", "30deg", "0", "-70deg", "0", "45deg", "0"];
        let end = ["--yes", "--speed", "0.02", "--connect", &cell.tcp];
        let moving = Process::start(&[&["move", "left", "ptp"][..], &goal, &end].concat());
        browser.wait_for("nets", "RUNNING");
        let mut seen = BTreeSet::new();
        while seen.len() < 3 {
            let shown = browser.text("devices");
            assert!(shown.contains("\top\t"), "{shown}");
            seen.insert(shown);
        }
        // The channel of a stop has a port of its own, which the browser must let the page use.
        browser.value("document.getElementById('stop').click()");
        browser.wait_for("stopped", "stopped by");
        let (lines, status) = moving.end();
        assert_ne!(status, Some(0), "the stop ends the motion: {lines:?}");
        browser.value("document.getElementById('release').click()");
        browser.wait_for("nets", "no nets");
        assert_eq!(browser.text("stopped"), "");
        assert_eq!(browser.errors, [""; 0]);
    });
}

#[test]
fn page_with_token_asks_once_and_hides_it() {
    let Some(mut browser) = browser("page_with_token_asks_once_and_hides_it") else {
        return;
    };
    let folder = Folder::new();
    let token = folder.write("token", "0123456789abcdef");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(&token, mode).unwrap();
    let config = format!(
        "[controller]\nwebsocket = \"127.0.0.1:0\"\ntcp = \"127.0.0.1:0\"\ntoken_file = \"{token}\"\n\
         stop_socket = \"{}\"\n",
        folder.file("stop.sock")
    );
    let config = folder.write("cell.toml", &config);
    let mut controller = Process::start(&["run", "--config", &config]);
    let line = controller.wait_for("DirectIO at ws");
    let (_, http) = line.split_once("ws://").unwrap();
    let http = http.trim_end_matches("/DirectIO/");

    browser.open(&format!("http://{http}/"));
    browser.wait_for("", "A token is required");
    let link = run(&["page", "--connect", http, "--token-file", &token]);
    let link = expect_status(&link, 0);
    browser.open(link.trim());
    browser.wait_for("live", "live");
    // Neither the address, which histories keep, nor scripts have it.
    assert_eq!(browser.value("location.href"), format!("http://{http}/"));
    assert_eq!(browser.value("document.cookie"), "");
    browser.open(&format!("http://{http}/"));
    browser.wait_for("live", "live");
    // The rejected page and the icon that a browser wants beside it.
    let errors = browser.errors.iter();
    let others: Vec<_> = errors
        .filter(|it| !it.contains("401 (Unauthorized)"))
        .collect();
    assert_eq!(others, [""; 0]);
}

#[test]
fn demo_open_serves_page_of_moving_robots() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("demo_open_serves_page_of_moving_robots") else {
            return;
        };
        let mut command = common::takt(&["demo", "--open", "--duration", "5s"]);
        // Without a program that opens addresses, it says so and goes on.
        command.env("PATH", "/nonexistent");
        let mut demo = Process::spawn(command);
        let line = demo.wait_for("http://127.0.0.1:");
        demo.wait_for("hint: open the address above");
        browser.open(line.rsplit(' ').next().unwrap());
        browser.wait_for("nets", "demo: moves left and right");
        let mut seen = BTreeSet::new();
        while seen.len() < 3 {
            seen.insert(browser.text("devices"));
        }
        assert_eq!(browser.errors, [""; 0]);
        // A net that ended before its time is not started again by the demo.
        browser.open("about:blank");
        browser.open(&format!("{}#nets", line.rsplit(' ').next().unwrap()));
        browser.wait_for("net", "RUNNING");
        browser.click("#control");
        browser.click("#net .actions button:nth-child(3)");
        demo.wait_for("it rests until");
        browser.wait_for("nets", "READY");
    });
}
