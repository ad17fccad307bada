//! Jogging from the page in a real browser: hold-to-run. The arm moves while a button is held, and comes to rest when it is released,
//! when the page loses the focus, when the browser stalls, and when the connection is lost; the last two by the controller alone.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

#[path = "common/browser.rs"]
mod browser;
mod common;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use browser::Browser;
use common::{Cell, Process, alone};
use nix::sys::signal::Signal;
use takt_tests::steady;

/// Longer than anything takes on a busy host.
const LATEST: Duration = Duration::from_secs(60);
/// A joint that moves less in [`LOOK`] is at rest, rad.
const REST: f64 = 1e-4;
const LOOK: Duration = Duration::from_millis(400);
/// The range of the second joint ends at 2.09 rad: an arm that rests before this was stopped, not limited.
const STOPPED: f64 = 1.9;
/// The button that moves the second joint.
const BUTTON: &str = "button[data-direction=\"j1+\"]";

/// A jog of an emulated arm that is enabled.
struct Bench {
    browser: Browser,
    cell: Cell,
    _arm: Process,
}

impl Bench {
    /// `None`, and a note, without a browser.
    fn start(test: &str) -> Option<Self> {
        let browser = Browser::start();
        let mut browser = browser.map_err(|why| takt_tests::skip(test, &why)).ok()?;
        let mut cell = Cell::start();
        let arm = cell.arm();
        browser.before_pages(
            "window.sockets = []; const Real = WebSocket; \
             window.WebSocket = class extends Real { constructor(...a) { super(...a); sockets.push(this); } };",
        );
        browser.open(&format!("http://{}/#jog", cell.http));
        browser.wait_for("jog-joints", "J6");
        assert_eq!(
            browser.value("document.getElementById('enable').disabled"),
            true
        );
        browser.click("#control");
        browser.click("#enable");
        browser.wait_for("jog-message", "enabled");
        Some(Self {
            browser,
            cell,
            _arm: arm,
        })
    }

    /// Where the second joint is, rad; requested by this test, not by the page.
    fn joint(&self) -> f64 {
        let mut stream = TcpStream::connect(&self.cell.http).unwrap();
        let request = "GET /devices/left/robotarm?format=json HTTP/1.1\r\nHost: localhost\r\n\r\n";
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let (_, body) = answer.split_once("\r\n\r\n").unwrap();
        let arm: serde_json::Value = serde_json::from_str(body).unwrap();
        arm["joint"][1]["commanded"].as_f64().unwrap()
    }

    /// Whether the joint moves now.
    fn moves(&self) -> bool {
        let before = self.joint();
        std::thread::sleep(LOOK);
        (self.joint() - before).abs() > REST
    }

    /// Holds the button until the joint moves.
    fn hold(&mut self) {
        self.browser.pointer("mousePressed", BUTTON);
        self.wait(true, "a held button moves the arm");
    }

    #[track_caller]
    fn wait(&self, moves: bool, what: &str) {
        let until = Instant::now() + LATEST;
        while self.moves() != moves {
            assert!(Instant::now() < until, "{what}");
        }
        let joint = self.joint();
        assert!(joint.abs() < STOPPED, "{what}: the joint is at {joint} rad");
    }
}

#[test]
fn page_jog_moves_while_held_only() {
    let _alone = alone();
    steady(|| {
        let Some(mut bench) = Bench::start("page_jog_moves_while_held_only") else {
            return;
        };
        assert!(!bench.moves(), "an enabled jog moves nothing");
        let before = bench.joint();
        bench.hold();
        assert!(bench.joint() > before);
        bench.browser.pointer("mouseReleased", BUTTON);
        bench.wait(false, "a released button stops the arm");
        // By keyboard, and back.
        let minus = "document.querySelector('button[data-direction=\"j1-\"]').focus()";
        bench.browser.value(minus);
        let before = bench.joint();
        bench.browser.key("rawKeyDown", " ");
        bench.wait(true, "a held key moves the arm");
        assert!(bench.joint() < before);
        bench.browser.key("keyUp", " ");
        bench.wait(false, "a released key stops the arm");
        assert_eq!(bench.browser.errors, [""; 0]);
    });
}

#[test]
fn page_jog_stops_on_blur_and_switch() {
    let _alone = alone();
    steady(|| {
        let Some(mut bench) = Bench::start("page_jog_stops_on_blur_and_switch") else {
            return;
        };
        bench.hold();
        bench
            .browser
            .value("window.dispatchEvent(new Event('blur'))");
        bench.wait(false, "a page without focus stops the arm");
        bench.browser.wait_for("jog-message", "lost the focus");
        bench.browser.pointer("mouseReleased", BUTTON);
        bench.hold();
        // The switch, while the button is still held.
        bench
            .browser
            .value("document.getElementById('control').click()");
        bench.wait(false, "the control switch stops the arm");
        bench.browser.wait_for("jog-message", "control switch");
    });
}

#[test]
fn page_jog_stalled_browser_stops_arm() {
    let _alone = alone();
    steady(|| {
        let Some(mut bench) = Bench::start("page_jog_stalled_browser_stops_arm") else {
            return;
        };
        bench.hold();
        // Its connection stays open: only the messages stop.
        bench.browser.signal(Signal::SIGSTOP);
        bench.wait(false, "the controller stops an arm whose page is silent");
        bench.browser.signal(Signal::SIGCONT);
        bench.browser.wait_for("jog-message", "stalled");
        assert!(!bench.moves(), "what stalled does not go on by itself");
    });
}

#[test]
fn page_jog_lost_connection_stops_arm() {
    let _alone = alone();
    steady(|| {
        let Some(mut bench) = Bench::start("page_jog_lost_connection_stops_arm") else {
            return;
        };
        bench.hold();
        bench
            .browser
            .value("sockets.forEach(socket => socket.close())");
        bench.wait(false, "a lost connection stops the arm");
        bench.browser.wait_for("jog-message", "connection is lost");
        // Its session ended with it.
        bench
            .browser
            .open(&format!("http://{}/#nets", bench.cell.http));
        bench.browser.wait_for("nets", "no nets");
    });
}

#[test]
fn page_jog_killed_browser_stops_arm() {
    let _alone = alone();
    steady(|| {
        let Some(mut bench) = Bench::start("page_jog_killed_browser_stops_arm") else {
            return;
        };
        bench.hold();
        bench.browser.signal(Signal::SIGKILL);
        bench.wait(false, "the controller stops an arm whose page is dead");
    });
}
