//! The screen as golden text, of resources as a controller sends them.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::KeyModifiers;
use serde_json::{Value, json};

use super::super::report::Rest;
use super::super::text::page;
use super::*;

fn status(missed: u64) -> Value {
    let times = |p99: f64, max: f64| json!([{ "p50": 0.01, "p99": p99, "max": max, "count": 9 }]);
    json!({
        "version": "0.1.0", "allocations": 0,
        "count": [{ "name": "nets", "used": 1000, "bound": 1024 }, { "name": "clients", "used": 2, "bound": 64 }],
        "thread": [
            { "name": "nets", "period": 1.0, "cycles": 90_000, "missed": missed,
              "latency": times(0.043, 1.25), "execution": times(0.2, 0.31),
              "phaseerror": [{ "p99": 0.012, "max": 0.2, "device": "left", "state": "holdover" }] },
            { "name": "nets-2ms", "period": 2.0, "cycles": 45_000, "missed": 0,
              "latency": times(0.05, 0.3), "execution": times(0.01, 0.02) },
        ],
    })
}

fn rest() -> Rest {
    Rest {
        stop: json!({ "stopped": false }),
        devices: json!({ "device": [
            { "name": "left", "type": "kuka_lwr_fri", "state": "op", "age": 1.2, "faults": 1, "event": [
                { "severity": "info", "ago": 90_000.0, "times": 1, "cause": "operational" },
                { "severity": "warning", "ago": 12_000.0, "times": 3, "cause": "quality of the connection is BAD",
                  "hint": "see `takt fri stat`" },
            ] },
            { "name": "table", "type": "staubli_tx90_ethercat", "state": "off", "faults": 2, "event": [
                { "severity": "error", "ago": 3_000.0, "times": 1, "cause": "slave 2 is lost from the segment",
                  "hint": "check its supply and the cable before it" },
            ] },
            { "name": "lamp\u{1b}[31m", "type": "io_sim", "state": "op", "age": 0.8, "faults": 0 },
        ] }),
        nets: json!({ "net": [
            { "uri": "/nets/rpinet9/", "status": "TERMINATED", "desc": "approach", "end": "left had a fault\nhint: see its log" },
            { "uri": "/nets/rpinet10/", "status": "RUNNING", "desc": "swing left" },
            { "uri": "/nets/rpinet2/", "status": "READY", "desc": "home", "rejected": [
                { "device": "left", "part": "joint 3", "cause": "set-points of rpinet2 for joint 3 of left are rejected",
                  "hint": "begin at the measured position" },
            ] },
        ] }),
        stats: json!({ "net": [
            { "uri": "/nets/rpinet10/", "stats": [{ "cost": 0.09, "budget": 0.6, "overruns": 2, "overbudget": 0,
              "exec": [{ "min": 0.01, "max": 0.12 }] }] },
        ] }),
        machines: json!({ "machine": [
            { "name": "station", "status": "active", "state": "MoveRobot", "error": "" },
            { "name": "feeder", "status": "failed", "state": "Fill", "error": "12:4: timeout" },
        ] }),
    }
}

fn report() -> Report {
    let before = Report::of(&status(7), &rest(), None);
    Report::of(&status(10), &rest(), Some(&before))
}

fn view() -> View {
    let mut view = View::new("robot:8080");
    view.handle_reading(Ok(report()), Instant::now());
    view
}

/// The screen, line by line without blanks at the ends.
fn screen(view: &mut View, width: u16, height: u16, now: Instant) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| view.draw(frame, now)).unwrap();
    let buffer = terminal.backend().buffer();
    let row = |row: u16| {
        let cells = (0..width).map(|column| buffer[(column, row)].symbol());
        cells.collect::<String>().trim_end().to_owned() + "\n"
    };
    (0..height).map(row).collect()
}

fn press(view: &mut View, code: KeyCode) {
    view.handle_key(&KeyEvent::new(code, KeyModifiers::NONE));
}

#[test]
fn top_screen_of_80x24_shows_each_table() {
    let text = screen(&mut view(), 80, 24, Instant::now());
    let expected = "\
takt 0.1.0 at robot:8080: 4 FAIL, 4 WARN
FINDINGS
FAIL  thread nets misses cycles: 3 since the last reading
      hint: see `takt doctor`; the nets below with the highest cost; `takt
      jitter`
FAIL  table is offline: slave 2 is lost from the segment
      hint: check its supply and the cable before it
FAIL  machine feeder failed in state Fill: 12:4: timeout
      … 12 more lines: Tab
THREADS      period  late p99       max  exec p99       max  missed  clock
nets         1.0 ms   43.0 us    1.2 ms    200 us    310 us      10  left holdov
nets-2ms     2.0 ms   50.0 us    300 us   10.0 us   20.0 us       0  host
DEVICES      type               state       age faults  last event
table        staubli_tx90_ethe… off           -      2  3 s ago: slave 2 is lost
left         kuka_lwr_fri       op       1.2 ms      1  12 s ago: quality of the
lamp[31m     io_sim             op       800 us      0
NETS         state          cost  longest overruns  over rejected  description
rpinet2      READY                                              1  home
rpinet9      TERMINATED                                         0  approach
rpinet10     RUNNING     90.0 us   120 us        2     0        0  swing left
MACHINES         status     state                  error
feeder           failed     Fill                   12:4: timeout
station          active     MoveRobot
q end  s order  Tab table  Space pause  ? help    worst first
";
    assert_eq!(text, expected);
}

#[test]
fn top_table_alone_has_whole_screen_and_scrolls() {
    let (mut view, now) = (view(), Instant::now());
    press(&mut view, KeyCode::Tab);
    let text = screen(&mut view, 80, 24, now);
    assert!(text.contains("1000 of 1024 nets are in use\n"), "{text}");
    assert!(!text.contains("THREADS"), "{text}");
    let small = screen(&mut view, 80, 8, now);
    assert!(small.contains("\n      … 14 more lines: Tab\n"), "{small}");
    press(&mut view, KeyCode::PageDown);
    press(&mut view, KeyCode::PageDown);
    let end = screen(&mut view, 80, 8, now);
    let rows: Vec<&str> = end.lines().collect();
    assert_eq!(rows[1], "FINDINGS");
    assert_eq!(rows[6], "      hint: end nets that are no longer needed");
    // The last is before the first.
    for _ in 0..4 {
        press(&mut view, KeyCode::Tab);
    }
    let text = screen(&mut view, 80, 24, now);
    assert!(
        text.contains("\nMACHINES ") && !text.contains("NETS "),
        "{text}"
    );
    press(&mut view, KeyCode::Tab);
    assert!(screen(&mut view, 80, 24, now).contains("\nNETS "));
}

#[test]
fn top_order_changes_by_key() {
    let (mut view, now) = (view(), Instant::now());
    let nets = |view: &mut View| {
        let text = screen(view, 80, 40, now);
        let lines = text.lines().filter(|line| line.starts_with("rpinet"));
        let names = lines.filter_map(|line| line.split(' ').next().map(str::to_owned));
        names.collect::<Vec<_>>()
    };
    assert_eq!(nets(&mut view), ["rpinet2", "rpinet9", "rpinet10"]);
    press(&mut view, KeyCode::Char('s'));
    assert_eq!(nets(&mut view), ["rpinet10", "rpinet2", "rpinet9"]);
    press(&mut view, KeyCode::Char('s'));
    assert_eq!(nets(&mut view), ["rpinet2", "rpinet9", "rpinet10"]);
    assert!(screen(&mut view, 80, 24, now).contains("by name"));
    press(&mut view, KeyCode::Char('?'));
    assert!(screen(&mut view, 80, 24, now).contains("pause and go on"));
}

#[test]
fn top_lost_connection_is_shown_until_it_returns() {
    let (mut view, begin) = (view(), Instant::now());
    let why = "robot:8080: the controller has not answered within 3s\nhint: see its log";
    view.handle_reading(Err(why.to_owned()), begin);
    let later = begin + Duration::from_secs(5);
    view.handle_reading(Err(why.to_owned()), later);
    let text = screen(&mut view, 80, 24, later);
    let head = "connection lost 5 s ago, retrying: robot:8080: the controller has not answered w\n";
    assert!(text.starts_with(head), "{text}");
    // What was known last remains.
    assert!(text.contains("rpinet10     RUNNING"), "{text}");
    view.handle_reading(Ok(report()), later);
    let text = screen(&mut view, 80, 24, later);
    assert!(text.starts_with("takt 0.1.0 at robot:8080"), "{text}");
    // Before the first report, cause and hint have the screen.
    let mut new = View::new("robot:8080");
    new.handle_reading(Err(why.to_owned()), begin);
    assert!(screen(&mut new, 80, 24, later).contains("\nhint: see its log\n"));
}

#[test]
fn top_paused_keeps_its_report() {
    let (mut view, now) = (view(), Instant::now());
    press(&mut view, KeyCode::Char(' '));
    let mut other = report();
    other.nets.clear();
    view.handle_reading(Ok(other.clone()), now);
    let text = screen(&mut view, 80, 24, now);
    assert!(
        text.contains("WARN  PAUSED\n") && text.contains("rpinet10"),
        "{text}"
    );
    press(&mut view, KeyCode::Char('p'));
    view.handle_reading(Ok(other), now);
    assert!(!screen(&mut view, 80, 24, now).contains("rpinet10  "));
}

#[test]
fn top_screen_of_any_size_does_not_fail() {
    for (width, height) in [(1, 1), (10, 4), (80, 2), (300, 3), (200, 80)] {
        let mut view = view();
        for key in [KeyCode::Tab, KeyCode::PageDown, KeyCode::Char('?')] {
            screen(&mut view, width, height, Instant::now());
            press(&mut view, key);
        }
        screen(&mut View::new("x:1"), width, height, Instant::now());
    }
}

#[test]
fn top_plain_page_has_whole_texts_without_escapes() {
    let report = report();
    let text = page(
        &head(&report, "robot:8080"),
        &sections(&report, Order::Worst, 80),
    );
    for part in [
        "takt 0.1.0 at robot:8080: 4 FAIL, 4 WARN\n\nFINDINGS\nFAIL  thread nets misses",
        "\nWARN  left: quality of the connection is BAD, 12 s ago\n      hint: see `takt fri stat`\n",
        "\nWARN  rpinet9 ended: left had a fault\n      hint: see its log\n",
        "\nFAIL  set-points of rpinet2 for joint 3 of left are rejected\n      hint: begin at the measured position\n",
        " 310 us      10  left holdover 12.0 us\n",
        " 1  12 s ago: quality of the connection is BAD, 3 times\n",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    assert!(!text.contains('\u{1b}'), "{text:?}");
}

#[test]
fn top_of_empty_or_foreign_resources_is_empty() {
    let report = Report::of(&json!([1]), &Rest::default(), None);
    assert!(!report.fails());
    let text = page(&head(&report, "x:1"), &sections(&report, Order::Worst, 80));
    assert_eq!(text, "takt  at x:1: good\n\nFINDINGS\nnone\n");
}

#[test]
fn top_lists_buses_and_reports_full_ones() {
    let mut rest = rest();
    rest.devices["bus"] = json!([
        { "name": "can0", "bitrate": 1_000_000, "bits": 923_000, "bitsmax": 950_000, "load": 0.923, "loadmax": 0.95 },
        { "name": "can1", "bitrate": 500_000, "bits": 325_000, "bitsmax": 330_000, "load": 0.65, "loadmax": 0.66 },
        { "name": "vcan0", "bits": 12_345, "bitsmax": 20_000 },
    ]);
    let report = Report::of(&status(7), &rest, None);
    let found: Vec<_> = report
        .findings
        .iter()
        .map(|it| (it.grade, it.cause.as_str()))
        .collect();
    let full = "can0: frames are on the bus for 92 % of its time";
    let busy = "can1: frames are on the bus for 65 % of its time";
    assert!(found.contains(&(Grade::Fail, full)), "{found:?}");
    assert!(found.contains(&(Grade::Warn, busy)), "{found:?}");
    let sections = sections(&report, Order::Worst, 80);
    let buses = sections
        .iter()
        .find(|it| it.head.starts_with("BUSES"))
        .unwrap();
    let lines: Vec<_> = buses.lines.iter().map(|it| it.text.as_str()).collect();
    assert_eq!(
        lines,
        [
            "can0                     1000   92.3 %   95.0 %      923.0        950.0",
            "can1                      500   65.0 %   66.0 %      325.0        330.0",
            "vcan0                       -        -        -       12.3         20.0",
        ]
    );
}
