//! The views of the page in a real browser: each loads without errors and shows what the controller has; nothing acts without the
//! control switch; the keyboard reaches everything; it is legible at 1280 and at 390 px. Pictures of all views, light and dark,
//! are in `page` of the target directory.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on ends")]

#[path = "common/browser.rs"]
mod browser;
mod common;

use std::time::{Duration, Instant};

use browser::Browser;
use common::{Cell, Folder, Process, alone, expect_status, run};
use takt_client::{Client, Value};
use takt_tests::steady;

const VIEWS: [&str; 12] = [
    "overview", "cell", "plots", "nets", "machines", "devices", "jog", "buses", "threads", "fleet",
    "flights", "log",
];

const NET: &str = "{a=Core::Clock(),g=Core::DoubleNetcommIn(Key='gain',Value='2'),\
    p=Core::DoubleMultiply(inFirst=a.outValue,inSecond=g.outValue),\
    o=Core::DoubleNetcommOut(inValue=p.outValue,Key='product'),x=Cancel(),\
    d=Core::BooleanNetcommOut(inValue=x.outCancel,Key='done'),outTerminate=x.outCancel}";

const COMPONENT: &str = "component Counter {
  out count: int;
  operation clear(to: int range 0 .. 100);
}
{ calls=Core::IntNetcommIn(Key='clear'), to=Core::IntNetcommIn(Key='clear_to'),
  sum=Core::IntAdd(inFirst=calls.outValue, inSecond=to.outValue),
  count=Core::IntNetcommOut(inValue=sum.outValue, Key='count'),
  cancel=Cancel(), outTerminate=cancel.outCancel }
";

const MACHINE: &str = "machine M {
  component c from \"c.component\" started;
  event go;
  initial state A { transition on go to B; transition if false to Z; }
  state B { transition on go to A; transition if false to Z; }
  final state Z { entry { stop c; } }
}
";

/// A browser; notes the skip of `test` without one.
fn browser(test: &str) -> Option<Browser> {
    Browser::start()
        .map_err(|why| takt_tests::skip(test, &why))
        .ok()
}

/// A controller with an arm, a running net and a running machine.
struct Bench {
    cell: Cell,
    net: String,
    _arm: Process,
    _folder: Folder,
}

impl Bench {
    fn start() -> Self {
        let mut cell = Cell::start();
        let arm = cell.arm();
        let net = cell.load(NET);
        expect_status(&cell.net(&["start", &net]), 0);
        let folder = Folder::new();
        folder.write("c.component", COMPONENT);
        let file = folder.write("m.machine", MACHINE);
        let load = ["machine", "load", &file, "--start", "--connect", &cell.tcp];
        expect_status(&run(&load), 0);
        Self {
            cell,
            net,
            _arm: arm,
            _folder: folder,
        }
    }

    /// Two rules: when the running net ends, one net is started, and when that ends, a third one.
    fn rules(&self) {
        let client = Client::connect(&self.cell.tcp).unwrap();
        let [second, third] = [1, 2].map(|_| self.cell.load(NET));
        for (watched, started) in [(&self.net, &second), (&second, &third)] {
            let none = || Value::from(Vec::new());
            let start = Value::from(vec![started.as_str().into()]);
            let condition = Value::from(format!("{watched}.outdone"));
            client
                .call(
                    "nesc",
                    [condition, none(), none(), start, "in a row".into()],
                )
                .unwrap();
        }
    }

    /// Cancels its net.
    fn end(&self) {
        expect_status(&self.cell.net(&["cancel", &self.net]), 0);
    }

    fn open(&self, browser: &mut Browser, view: &str) {
        browser.open("about:blank");
        browser.open(&format!("http://{}/#{view}", self.cell.http));
        browser.wait_for("live", "live");
    }
}

#[test]
fn page_views_show_contents_without_errors() {
    let _alone = alone();
    steady(|| {
        let Some(mut browser) = browser("page_views_show_contents_without_errors") else {
            return;
        };
        let bench = Bench::start();
        let net = format!("nets/{}", bench.net);
        let shown = [
            (net.as_str(), "net", "product"),
            ("machines", "machine", "transitions"),
            ("devices", "device", "measured rad"),
            ("jog", "jog-joints", "J6"),
            ("buses", "drivers", "quality"),
            ("threads", "threads", "Latency"),
            ("threads", "host", " skip"),
            ("flights", "flights", "no flight recordings"),
            ("log", "log", "operational"),
        ];
        for (view, id, part) in shown {
            bench.open(&mut browser, view);
            browser.wait_for(id, part);
        }
        bench.open(&mut browser, &net);
        browser.wait_for("net", "RUNNING");
        let boxes = "document.querySelectorAll('#net g.primitive').length";
        let until = Instant::now() + Duration::from_secs(30);
        // Six primitives and the output of the net.
        while browser.value(boxes) != 7 {
            assert!(Instant::now() < until, "{}", browser.value(boxes));
        }
        // Its values are live: a clock changes, and every port has a number.
        browser.wait_for("net", "live");
        let active = "document.querySelectorAll('#net g.primitive.is-active').length > 0";
        while browser.value(active) != true {
            assert!(Instant::now() < until, "no value changes");
        }
        bench.open(&mut browser, "machines");
        browser.wait_for("machine", "transitions");
        let current = "document.querySelector('#machine svg [fill=\"#fdf1dc\"]')?.nextElementSibling?.textContent";
        assert_eq!(browser.value(current), "A");
        assert_eq!(browser.errors, [""; 0]);
    });
}

#[test]
fn page_is_legible_at_both_sizes_and_colours() {
    let _alone = alone();
    let Some(mut browser) = browser("page_is_legible_at_both_sizes_and_colours") else {
        return;
    };
    let bench = Bench::start();
    bench.rules();
    let flight = ["record", "flight", "--connect", &bench.cell.http];
    expect_status(&run(&flight), 0);
    for (width, height) in [(1280, 800), (390, 844)] {
        for (colours, is_dark) in [("light", false), ("dark", true)] {
            browser.resize(width, height, is_dark);
            for view in VIEWS {
                bench.open(&mut browser, view);
                std::thread::sleep(Duration::from_millis(700));
                let overflow = browser.value("document.documentElement.scrollWidth - innerWidth");
                assert!(
                    overflow.as_i64().unwrap() <= 0,
                    "{view} at {width}: {overflow} px too wide"
                );
                // Tables that a hand is to press or read whole do not scroll in their cards.
                let hidden = browser.value(
                    "Math.max(0, ...[...document.querySelectorAll('#flights, #host')].map(it => it.scrollWidth - it.clientWidth))",
                );
                assert_eq!(hidden, 0, "{view} at {width} scrolls in its card");
                let stop = "(() => { const r = document.getElementById('stop').getBoundingClientRect(); \
                    return r.left >= 0 && r.right <= innerWidth && r.top >= 0 && r.bottom <= innerHeight; })()";
                assert_eq!(
                    browser.value(stop),
                    true,
                    "STOP of {view} at {width} is in reach"
                );
                let back = browser.value("getComputedStyle(document.body).backgroundColor");
                let first = back
                    .as_str()
                    .unwrap()
                    .trim_start_matches("rgb(")
                    .split(',')
                    .next();
                let is_shown_dark = first.unwrap().parse::<u32>().unwrap() < 128;
                assert_eq!(is_shown_dark, is_dark, "{back}");
                browser.picture(&format!("{view}-{width}-{colours}"));
            }
        }
    }
}

#[test]
fn page_without_control_switch_only_reads() {
    let _alone = alone();
    let Some(mut browser) = browser("page_without_control_switch_only_reads") else {
        return;
    };
    let bench = Bench::start();
    let net = &bench.net;
    bench.open(&mut browser, &format!("nets/{net}"));
    browser.wait_for("net", "RUNNING");
    let enabled = "[...document.querySelectorAll('#view button, #view input')].filter(e => !e.disabled && !e.closest('.row')?.querySelector('select')).length";
    assert_eq!(browser.value(enabled), 0, "no action is enabled");
    browser.value("document.querySelectorAll('#net .actions button')[1].click()");
    std::thread::sleep(Duration::from_millis(300));
    assert!(browser.text("net").contains("RUNNING"));
    // A value, then the end of the net.
    browser.click("#control");
    browser.value("document.querySelector('#net form input').value = '7.5'");
    browser.click("#net form button");
    browser.wait_for("net", "7.5");
    browser.click("#net .actions button:nth-child(2)");
    browser.wait_for("net", "TERMINATED");
    browser.click("#net .actions button:nth-child(4)");
    browser.wait_for("net", "not loaded any more");
}

#[test]
fn page_rules_are_drawn_between_nets() {
    let _alone = alone();
    let Some(mut browser) = browser("page_rules_are_drawn_between_nets") else {
        return;
    };
    let bench = Bench::start();
    bench.open(&mut browser, "nets");
    browser.wait_for("net", "RUNNING");
    assert_eq!(browser.text("rule-graph"), "", "there are no rules yet");
    bench.rules();
    let shown = browser.wait_for("rule-graph", "ACTIVE");
    assert!(
        shown.contains(&bench.net) && shown.contains("starts"),
        "{shown}"
    );
    let boxes = "[document.querySelectorAll('#rule-graph g.net').length, document.querySelectorAll('#rule-graph g.rule').length, \
        document.querySelectorAll('#rule-graph path.edge').length].join()";
    assert_eq!(browser.value(boxes), "3,2,4");
    // A net of the picture opens by the keyboard.
    browser.value("document.querySelectorAll('#rule-graph a')[2].focus()");
    browser.key("rawKeyDown", "Enter");
    browser.key("keyUp", "Enter");
    browser.wait_for("net", "SCHEDULED");
    // What it starts is shown when it has.
    bench.end();
    browser.wait_for("rule-graph", "FIRED");
    assert_eq!(browser.errors, [""; 0]);
}

#[test]
fn page_flight_recording_is_requested_and_saved() {
    let _alone = alone();
    let Some(mut browser) = browser("page_flight_recording_is_requested_and_saved") else {
        return;
    };
    let bench = Bench::start();
    let folder = Folder::new();
    bench.open(&mut browser, "flights");
    browser.wait_for("flights", "no flight recordings");
    let disabled = "document.querySelector('#flights button').disabled";
    assert_eq!(browser.value(disabled), true, "the control switch is off");
    browser.click("#control");
    browser.value("document.querySelector('#flights input').value = 'the part slipped'");
    browser.click("#flights button");
    let shown = browser.wait_for("flights", "the part slipped");
    assert!(
        shown.contains("-request.mcap") && shown.contains("B"),
        "{shown}"
    );
    // A host that stalls leaves recordings of overruns beside it.
    let requested = "#flights td a[download*=-request]";
    let name = browser.value(&format!(
        "document.querySelector(\"{requested}\").textContent"
    ));
    let name = name.as_str().unwrap();
    let directory = folder.file("");
    browser.save_to(&directory);
    browser.click(requested);
    let size = browser.value(&format!(
        "fetch('/flights/{name}', {{ method: 'HEAD' }}).then(it => Number(it.headers.get('Content-Length')))"
    ));
    let until = Instant::now() + Duration::from_secs(60);
    let saved = loop {
        match std::fs::read(folder.file(name)) {
            Ok(bytes) if size == bytes.len() => {
                break bytes;
            }
            _ => assert!(Instant::now() < until, "{name} is not saved"),
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    assert!(saved.starts_with(b"\x89MCAP0\r\n") && saved.ends_with(b"\x89MCAP0\r\n"));
    assert_eq!(browser.errors, [""; 0]);
}

#[test]
fn page_machine_events_are_raised_by_buttons() {
    let _alone = alone();
    let Some(mut browser) = browser("page_machine_events_are_raised_by_buttons") else {
        return;
    };
    let bench = Bench::start();
    bench.open(&mut browser, "machines/M");
    let state = "document.querySelector('#machine tbody b')?.textContent";
    browser.wait_for("machine", "go");
    assert_eq!(browser.value(state), "A");
    browser.click("#control");
    let go = "[...document.querySelectorAll('#machine button')].find(b => b.textContent === 'go').id = 'go'";
    browser.value(go);
    browser.click("#go");
    let until = Instant::now() + Duration::from_secs(30);
    while browser.value(state) != "B" {
        assert!(Instant::now() < until, "the machine stays in A");
        std::thread::sleep(Duration::from_millis(50));
    }
    // What the controller rejects is shown with its cause.
    browser.value("document.querySelector('#machine form input').value = 'nonsense'");
    browser.click("#machine form button");
    browser.wait_for("notice", "nonsense");
}

#[test]
fn page_is_reachable_by_keyboard() {
    let _alone = alone();
    let Some(mut browser) = browser("page_is_reachable_by_keyboard") else {
        return;
    };
    let bench = Bench::start();
    bench.open(&mut browser, "nets");
    browser.wait_for("net", "RUNNING");
    let mut reached = Vec::new();
    for _ in 0..30 {
        browser.key("rawKeyDown", "Tab");
        browser.key("keyUp", "Tab");
        let now = "document.activeElement.id || document.activeElement.className || document.activeElement.textContent";
        reached.push(browser.value(now).as_str().unwrap_or_default().to_owned());
    }
    for wanted in ["control", "stop", "Machines", "pick picked"] {
        assert!(
            reached.iter().any(|it| it == wanted),
            "{wanted}: {reached:?}"
        );
    }
    // The focus is visible at each stop, within what is shown.
    bench.open(&mut browser, "devices");
    browser.wait_for("device", "measured rad");
    let seen = "(() => { const e = document.activeElement, s = getComputedStyle(e), r = e.getBoundingClientRect(); \
        return [e.id || e.textContent.trim().slice(0, 20), e.matches(':focus-visible') && s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 2, \
        r.bottom > 0 && r.top < innerHeight && r.right > 0 && r.left < innerWidth]; })()";
    let mut order = Vec::new();
    for _ in 0..16 {
        browser.key("rawKeyDown", "Tab");
        browser.key("keyUp", "Tab");
        let stop = browser.value(seen);
        assert_eq!((&stop[1], &stop[2]), (&true.into(), &true.into()), "{stop}");
        order.push(stop[0].as_str().unwrap().to_owned());
    }
    // From the top: STOP comes before all views, these in their order, then the contents.
    let place = |name: &str| {
        let found = order.iter().position(|it| it == name);
        found.unwrap_or_else(|| panic!("{name} is not in {order:?}"))
    };
    let wanted = [
        "Skip to content",
        "control",
        "stop",
        "Overview",
        "Plots",
        "Nets",
        "Flights",
        "Log",
    ];
    assert!(wanted.map(place).is_sorted(), "{order:?}");
    assert!(place("Log") < 15, "contents follow: {order:?}");
    // Views open by Enter.
    browser.value("document.querySelector('#views a[href=\"#log\"]').focus()");
    browser.key("rawKeyDown", "Enter");
    let press = "document.activeElement.click()";
    browser.value(press);
    browser.wait_for("log", "operational");
    assert_eq!(browser.value("document.title"), "Log · Takt");
}
