//! The keys of a terminal while an arm is jogged. Which key is held is decided in `keys`, what it does in `jogging`.

use std::io::Write as _;
use std::time::{Duration, Instant};

use ratatui::crossterm::event::{
    self, Event, KeyCode, KeyEvent as Key, KeyEventKind, KeyModifiers, KeyboardEnhancementFlags,
    PopKeyboardEnhancementFlags, PushKeyboardEnhancementFlags,
};
use ratatui::crossterm::{execute, terminal};

use super::direction::{Axis, Direction};
use super::failure::hinted;
use super::jogging::{Jogging, TICK, known};
use super::keys::{Held, KeyEvent};
use crate::signal::Stop;

/// How often the line with the positions is written.
const REFRESH: Duration = Duration::from_millis(200);

/// Most reports of keys between two velocities: a paste is no jog.
const EVENTS_MAX: usize = 64;

/// Keys with their directions in the base.
const KEYS: [(char, Axis, bool); 12] = [
    ('w', Axis::Along(0), true),
    ('s', Axis::Along(0), false),
    ('a', Axis::Along(1), true),
    ('d', Axis::Along(1), false),
    ('r', Axis::Along(2), true),
    ('f', Axis::Along(2), false),
    ('u', Axis::About(0), true),
    ('j', Axis::About(0), false),
    ('i', Axis::About(1), true),
    ('k', Axis::About(1), false),
    ('o', Axis::About(2), true),
    ('l', Axis::About(2), false),
];

/// The terminal, which reports each key at once until this is dropped.
#[derive(Debug)]
struct Terminal {
    has_releases: bool,
}

impl Terminal {
    fn open() -> std::io::Result<Self> {
        terminal::enable_raw_mode()?;
        let has_releases = terminal::supports_keyboard_enhancement().unwrap_or(false);
        let this = Self { has_releases };
        if has_releases {
            let flags = KeyboardEnhancementFlags::REPORT_EVENT_TYPES;
            execute!(std::io::stderr(), PushKeyboardEnhancementFlags(flags))?;
        }
        Ok(this)
    }

    /// Replaces the line; a failure of that ends nothing.
    fn show(line: &str) {
        let mut out = std::io::stderr().lock();
        let _ = write!(out, "\r\x1b[2K{line}").and_then(|()| out.flush());
    }

    /// Writes a text that remains.
    fn report(text: &str) {
        Self::show(&format!("{}\r\n", text.replace('\n', "\r\n")));
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if self.has_releases {
            let _ = execute!(std::io::stderr(), PopKeyboardEnhancementFlags);
        }
        let _ = terminal::disable_raw_mode();
        let _ = writeln!(std::io::stderr());
    }
}

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meaning {
    Move(Direction),
    Select(usize),
    End,
    Nothing,
}

/// What a key does while a joint is selected.
fn meaning(key: Key, joint: usize) -> Meaning {
    let selected = |is_positive| {
        Meaning::Move(Direction {
            axis: Axis::Joint(joint),
            is_positive,
        })
    };
    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
    #[expect(
        clippy::wildcard_enum_match_arm,
        reason = "some 20 other keys, which do nothing"
    )]
    match key.code {
        KeyCode::Char('c') if is_control => Meaning::End,
        _ if is_control || key.modifiers.contains(KeyModifiers::ALT) => Meaning::Nothing,
        KeyCode::Char('q') | KeyCode::Esc => Meaning::End,
        KeyCode::Char('+') | KeyCode::Up => selected(true),
        KeyCode::Char('-') | KeyCode::Down => selected(false),
        KeyCode::Char(letter) => {
            if let Some(number) = letter.to_digit(10) {
                return Meaning::Select(number as usize);
            }
            let known = KEYS.iter().find(|(key, ..)| *key == letter);
            known.map_or(Meaning::Nothing, |(_, axis, is_positive)| {
                Meaning::Move(Direction {
                    axis: *axis,
                    is_positive: *is_positive,
                })
            })
        }
        _ => Meaning::Nothing,
    }
}

/// Jogs by keys until the user ends it.
pub(super) fn run(jogging: &mut Jogging<'_>, stop: &Stop) -> anyhow::Result<bool> {
    let terminal = Terminal::open()?;
    let when = if terminal.has_releases {
        "it moves while the key is down"
    } else {
        "it moves while the key repeats"
    };
    let name = &jogging.arm.description().name;
    Terminal::report(&format!(
        "{name}: hold a key, {when}. w s x, a d y, r f z, u j about x, i k about y, o l about z; \
         0-9 select a joint, + - move it; q ends"
    ));
    let mut keys = Keys {
        held: Held::new(terminal.has_releases),
        joint: 0,
        is_rejected: false,
    };
    let (begin, mut shown) = (Instant::now(), None);
    while !stop.is_requested() {
        if keys.read(begin)? {
            break;
        }
        keys.apply(jogging, begin.elapsed());
        if shown.is_none_or(|shown: Instant| shown.elapsed() > REFRESH) {
            shown = Some(Instant::now());
            let at = jogging.arm.commanded().map_err(hinted)?;
            let at = super::report::degrees(&at);
            Terminal::show(&format!("joint {}: {at} deg", keys.joint));
        }
    }
    Ok(true)
}

/// The keys of a jog.
#[derive(Debug)]
struct Keys {
    held: Held<Option<Direction>>,
    /// The joint that + and - move.
    joint: usize,
    /// Whether what is held was rejected: it is not requested again until it is released.
    is_rejected: bool,
}

impl Keys {
    /// Takes what the terminal reports in one tick; true if the user ends the jog.
    fn read(&mut self, begin: Instant) -> anyhow::Result<bool> {
        let mut wait = TICK;
        for _ in 0..EVENTS_MAX {
            if !event::poll(std::mem::take(&mut wait))? {
                break;
            }
            if let Event::Key(key) = event::read()?
                && self.handle(key, begin.elapsed())
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Takes a key; true if it ends the jog.
    fn handle(&mut self, key: Key, now: Duration) -> bool {
        let meaning = meaning(key, self.joint);
        let direction = match meaning {
            Meaning::Move(direction) => Some(direction),
            Meaning::Select(_) | Meaning::Nothing | Meaning::End => None,
        };
        let event = match key.kind {
            KeyEventKind::Press => KeyEvent::Down(direction),
            KeyEventKind::Repeat => KeyEvent::Repeat(direction),
            KeyEventKind::Release => KeyEvent::Up(direction),
        };
        self.held.handle(event, now);
        if key.kind == KeyEventKind::Press
            && let Meaning::Select(joint) = meaning
        {
            self.joint = joint;
        }
        meaning == Meaning::End
    }

    /// Moves the arm as long as a key is held.
    fn apply(&mut self, jogging: &mut Jogging<'_>, now: Duration) {
        let done = match self.held.key(now).flatten() {
            None => {
                self.is_rejected = false;
                jogging.release()
            }
            Some(_) if self.is_rejected => Ok(()),
            Some(direction) => match known(direction, jogging.arm) {
                Ok(()) => jogging.send(direction),
                Err(error) => {
                    self.is_rejected = true;
                    return Terminal::report(&error.to_string());
                }
            },
        };
        if let Err(error) = done {
            self.is_rejected = true;
            Terminal::report(&hinted(error).to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn press(code: KeyCode) -> Key {
        Key::new(code, KeyModifiers::NONE)
    }

    #[test]
    fn keys_move_select_and_end() {
        let moves = |key, text: &str| {
            let Meaning::Move(direction) = meaning(press(key), 3) else {
                panic!("{key:?}");
            };
            assert_eq!(direction.to_string(), text);
        };
        moves(KeyCode::Char('w'), "x+");
        moves(KeyCode::Char('l'), "rz-");
        moves(KeyCode::Char('+'), "j3+");
        moves(KeyCode::Down, "j3-");
        assert_eq!(meaning(press(KeyCode::Char('6')), 0), Meaning::Select(6));
        assert_eq!(meaning(press(KeyCode::Char('z')), 0), Meaning::Nothing);
        assert_eq!(meaning(press(KeyCode::Esc), 0), Meaning::End);
        let control = Key::new(KeyCode::Char('w'), KeyModifiers::CONTROL);
        assert_eq!(meaning(control, 0), Meaning::Nothing);
        let interrupt = Key::new(KeyCode::Char('c'), KeyModifiers::CONTROL);
        assert_eq!(meaning(interrupt, 0), Meaning::End);
    }

    #[test]
    fn other_key_releases_what_is_held() {
        let mut keys = Keys {
            held: Held::new(false),
            joint: 0,
            is_rejected: false,
        };
        let at = Duration::from_millis;
        for time in [0, 500, 530] {
            assert!(!keys.handle(press(KeyCode::Char('w')), at(time)));
        }
        assert!(keys.held.key(at(540)).flatten().is_some());
        assert!(!keys.handle(press(KeyCode::Char('4')), at(545)));
        assert_eq!(keys.held.key(at(550)).flatten(), None);
        assert_eq!(keys.joint, 4);
    }
}
