//! The screen as golden text.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::KeyModifiers;

use super::super::store::tests::setup;
use super::super::wire::{self, Triggered};
use super::*;

const PROBES: [(&str, &str); 3] = [
    ("left.joint.6.commanded", "rad"),
    ("left.joint.6.measured", "rad"),
    ("left.force.z", "N"),
];

/// A second of a ramp, its delayed measurement and a force that is null at first.
fn frame(begin: f64) -> Event {
    let mut frame = wire::Frame::of(0, 3, &[]);
    for number in 0..=200 {
        let time = f64::from(number) * 5e-3;
        let force = if number < 100 { f64::NAN } else { 10.0 };
        let row = [begin + time, time, (time - 0.2).max(0.0), force];
        frame.values.extend(row);
    }
    Event::Frame(frame)
}

fn view() -> View {
    let mut view = View::new("robot:8080");
    view.handle_event(Event::Setup(setup(&[&PROBES])));
    view
}

fn screen(view: &mut View, width: u16, height: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| view.draw(frame)).unwrap();
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
fn scope_screen_of_80x24_draws_capture() {
    let mut view = view();
    let (time_s, cause) = (2.5, "left.joint.6.commanded above 0.5".to_owned());
    view.handle_event(Event::Triggered(Triggered { time_s, cause }));
    view.handle_event(frame(2.0));
    let expected = "\
robot:8080  capture 1 at 2.500000 s: left.joint.6.commanded above 0.5
rad   left.joint.6.commanded 1.000000  left.joint.6.measured 0.800000
1.050000 │                                   ⡇                            ⢀⣀⣀⠤⠤⠔
         │                                   ⡇                  ⢀⣀⣀⠤⠤⠔⠒⠒⠋⠉⠉   ⢀⣀
         │                                   ⡇         ⣀⣀⡠⠤⠴⠒⠒⠋⠉⠁   ⢀⣀⣀⡤⠤⠔⠒⠒⠉⠉⠁
         │                                   ⣀⣀⡠⠤⠤⠒⠒⠊⠉⠉    ⣀⣀⡠⠤⠤⠒⠒⠊⠉⠉
         │                         ⣀⣀⡠⠤⠤⠒⠒⠊⠉⠉⠁   ⣀⣀⡠⠤⠤⠒⠒⠋⠉⠉
         │               ⢀⣀⣠⠤⠤⠖⠒⠊⠉⠉    ⣀⣀⣠⠤⠤⠒⠒⠊⠉⠉
         │     ⣀⣀⣠⠤⠤⠔⠒⠒⠉⠉⠁   ⣀⣀⡠⠤⠤⠔⠒⠒⠉⠉⠁     ⡇
-0.050000│⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠤⠖⠒⠚⠉⠉⠁               ⡇
         └──────────────────────────────────────────────────────────────────────
  -0.500 s                                                              +0.500 s
N     left.force.z 10.000000
10.500000│                                   ⡇
         │                                   ⡇
         │                                   ⡇
         │                                   ⡇
         │                                   ⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉⠉
         │                                   ⡇
         │                                   ⡇
9.500000 │                                   ⡇
         └──────────────────────────────────────────────────────────────────────
  -0.500 s                                                              +0.500 s
q end  Space pause  +- window  ? help  window 1.000000 s
";
    assert_eq!(screen(&mut view, 80, 24), expected);
}

#[test]
fn scope_keys_change_window_scales_and_plots() {
    let mut view = view();
    view.handle_event(frame(0.0));
    assert!(screen(&mut view, 80, 24).contains("window 10.000000 s"));
    for _ in 0..3 {
        press(&mut view, KeyCode::Char('+'));
    }
    let text = screen(&mut view, 80, 24);
    assert!(
        text.contains("window 1.250000 s") && text.contains("1.050000"),
        "{text}"
    );
    // Held scales stay when the values leave them.
    press(&mut view, KeyCode::Char('a'));
    view.handle_event(Event::Frame(wire::Frame::of(
        0,
        3,
        &[1.001, 99.0, 0.0, 0.0],
    )));
    let text = screen(&mut view, 80, 24);
    assert!(
        text.contains("1.050000") && text.contains("scales held"),
        "{text}"
    );
    press(&mut view, KeyCode::Char('a'));
    assert!(screen(&mut view, 80, 24).contains("103.950"));
    // A plot for each probe; one of them has no room.
    press(&mut view, KeyCode::Char('g'));
    let text = screen(&mut view, 80, 18);
    assert!(
        text.contains("left.joint.6.measured") && !text.contains("left.force.z"),
        "{text}"
    );
    press(&mut view, KeyCode::Down);
    assert!(screen(&mut view, 80, 18).contains("left.force.z"));
    press(&mut view, KeyCode::Char('?'));
    assert!(screen(&mut view, 80, 24).contains("this help"));
}

#[test]
fn scope_cursor_shows_values_at_its_time() {
    let mut view = view();
    view.handle_event(frame(0.0));
    for _ in 0..3 {
        press(&mut view, KeyCode::Char('+'));
    }
    assert!(screen(&mut view, 80, 24).contains("left.joint.6.commanded 1.000000"));
    for _ in 0..10 {
        press(&mut view, KeyCode::Right);
    }
    // At 0.6 of the window from -0.25 s to 1 s.
    let text = screen(&mut view, 80, 24);
    for part in [
        "cursor 0.500000 s",
        "commanded 0.500000",
        "measured 0.300000",
        "force.z 10.000000",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    press(&mut view, KeyCode::Left);
    press(&mut view, KeyCode::Left);
    assert!(
        screen(&mut view, 80, 24).contains("left.force.z -"),
        "null has no value"
    );
    press(&mut view, KeyCode::Char('c'));
    assert!(!screen(&mut view, 80, 24).contains("cursor"));
}

#[test]
fn scope_pause_keeps_stream_and_capture() {
    let mut view = view();
    view.handle_event(frame(0.0));
    press(&mut view, KeyCode::Char(' '));
    view.handle_event(frame(1.005));
    let text = screen(&mut view, 100, 24);
    let end = |view: &View| format!("{:.3}", view.window().1);
    assert!(text.contains("PAUSED") && end(&view) == "1.000", "{text}");
    press(&mut view, KeyCode::Char(' '));
    assert_eq!(end(&view), "2.005");
    let trigger = |time_s: f64| {
        let cause = "above".to_owned();
        Event::Triggered(Triggered { time_s, cause })
    };
    for event in [trigger(3.5), frame(3.0)] {
        view.handle_event(event);
    }
    press(&mut view, KeyCode::Char('p'));
    for event in [trigger(5.5), frame(5.0), trigger(7.5), frame(7.0)] {
        view.handle_event(event);
    }
    assert!(screen(&mut view, 100, 24).contains("capture 1 at 3.500000 s: above"));
    press(&mut view, KeyCode::Char('p'));
    assert!(screen(&mut view, 100, 24).contains("at 7.500000 s: above"));
}

#[test]
fn scope_losses_and_lost_connection_are_shown() {
    let mut view = View::new("robot:8080");
    assert!(screen(&mut view, 80, 24).starts_with("connecting to robot:8080\n"));
    view.handle_event(Event::Setup(setup(&[&PROBES])));
    let (group, samples) = (0, 41);
    view.handle_event(Event::Lost { group, samples });
    view.handle_event(frame(0.0));
    assert!(screen(&mut view, 80, 24).starts_with("robot:8080  41 SAMPLES LOST\n"));
    view.handle_event(Event::Closed(
        "the controller has not answered within 5s".to_owned(),
    ));
    let text = screen(&mut view, 80, 24);
    assert!(
        text.starts_with("robot:8080: lost: the controller has not answered within 5s"),
        "{text}"
    );
    assert!(
        text.contains("left.force.z"),
        "what was there remains: {text}"
    );
    assert_eq!(view.verdict(), Verdict::Failed);
    view.handle_event(Event::Setup(setup(&[&PROBES])));
    assert!(screen(&mut view, 80, 24).starts_with("robot:8080  41 SAMPLES LOST\n"));
    assert_eq!(view.verdict(), Verdict::Good);
}

#[test]
fn scope_states_are_shown_by_name() {
    let mut view = View::new("robot:8080");
    let mut setup = setup(&[&[("net:swing.state", "")]]);
    setup.groups[0].probes[0].states = vec!["READY".to_owned(), "RUNNING".to_owned()];
    view.handle_event(Event::Setup(setup));
    view.handle_event(Event::Frame(wire::Frame::of(0, 1, &[0.0, 1.0])));
    assert!(screen(&mut view, 80, 24).contains("net:swing.state RUNNING"));
    view.handle_event(Event::Frame(wire::Frame::of(0, 1, &[0.1, 7.0])));
    assert!(screen(&mut view, 80, 24).contains("net:swing.state 7.000000"));
}

#[test]
fn scope_screen_of_any_size_does_not_fail() {
    for (width, height) in [(1, 1), (10, 4), (80, 2), (300, 3), (200, 80)] {
        let mut view = view();
        screen(&mut view, width, height);
        view.handle_event(frame(0.0));
        for key in ['g', 'a', '?', ' '] {
            press(&mut view, KeyCode::Char(key));
            screen(&mut view, width, height);
        }
    }
}
