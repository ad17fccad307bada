//! The whole terminal as a screen: opened if standard output is one, restored when it is dropped, also after an error. What is
//! drawn, and what keys mean, is decided elsewhere.

use std::io::IsTerminal as _;
use std::time::Duration;

use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::{DefaultTerminal, Frame};

/// Most keys that are handled between two pictures: a paste is no command.
const KEYS_MAX: usize = 64;

/// The whole terminal.
#[derive(Debug)]
pub(crate) struct Screen(Box<DefaultTerminal>);

impl Screen {
    /// The terminal, if standard output is one and it is wanted.
    pub(crate) fn open(is_wanted: bool) -> Option<Self> {
        if !is_wanted || !std::io::stdout().is_terminal() {
            return None;
        }
        ratatui::try_init()
            .ok()
            .map(|terminal| Self(Box::new(terminal)))
    }

    pub(crate) fn draw(&mut self, picture: impl FnOnce(&mut Frame<'_>)) -> anyhow::Result<()> {
        self.0.draw(picture)?;
        Ok(())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

/// The keys that were pressed, oldest first; waits at most so long for the first.
pub(crate) fn keys(wait: Duration) -> anyhow::Result<Vec<KeyEvent>> {
    let mut keys = Vec::new();
    let mut wait = wait;
    while keys.len() < KEYS_MAX && event::poll(wait)? {
        wait = Duration::ZERO;
        let event = event::read()?;
        if let Event::Key(key) = event {
            keys.extend((key.kind != KeyEventKind::Release).then_some(key));
        } else if matches!(event, Event::Resize(..)) {
            // The picture is to be drawn again.
            break;
        }
    }
    Ok(keys)
}

/// Whether a key ends the command. On a screen Ctrl-C is a key, and no signal.
pub(crate) fn is_end(key: &KeyEvent) -> bool {
    let is_interrupt =
        key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
    is_interrupt || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc)
}

/// Whether a key that was pressed ends the command.
pub(crate) fn is_end_wanted() -> anyhow::Result<bool> {
    Ok(keys(Duration::ZERO)?.iter().any(is_end))
}
