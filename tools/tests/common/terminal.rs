//! A pseudo-terminal for commands that have the whole screen: what they write is kept as the characters that a person sees.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::io::{Read as _, Write as _};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// After this time a test gives up.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A command in a terminal, killed when this is dropped.
pub(crate) struct Terminal {
    master: std::fs::File,
    child: Child,
    screen: Arc<Mutex<Screen>>,
}

impl Terminal {
    pub(crate) fn start(mut command: Command, columns: u16, rows: u16) -> Self {
        let size = nix::pty::Winsize {
            ws_row: rows,
            ws_col: columns,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        let pair = nix::pty::openpty(Some(&size), None).unwrap();
        let end = || Stdio::from(pair.slave.try_clone().unwrap());
        let command = command.stdin(end()).stdout(end()).stderr(end());
        let child = command.env("TERM", "xterm").spawn().unwrap();
        let screen = Arc::new(Mutex::new(Screen::new(columns.into(), rows.into())));
        let mut shown = std::fs::File::from(pair.master.try_clone().unwrap());
        let kept = Arc::clone(&screen);
        std::thread::spawn(move || {
            let mut part = [0; 4096];
            while let Ok(count @ 1..) = shown.read(&mut part) {
                kept.lock().unwrap().write(&part[..count]);
            }
        });
        Self {
            master: pair.master.into(),
            child,
            screen,
        }
    }

    /// Presses keys.
    pub(crate) fn key(&mut self, keys: &str) {
        self.master.write_all(keys.as_bytes()).unwrap();
    }

    /// What is on the screen, line by line.
    pub(crate) fn text(&self) -> String {
        self.screen.lock().unwrap().text()
    }

    /// Waits until a text is on the screen.
    #[track_caller]
    pub(crate) fn wait_for(&self, what: &str) -> String {
        let until = Instant::now() + TIMEOUT;
        loop {
            let text = self.text();
            if text.contains(what) {
                return text;
            }
            assert!(
                Instant::now() < until,
                "`{what}` did not come; the screen:\n{text}"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// The exit status, once it has ended.
    pub(crate) fn end(mut self, within: Duration) -> Option<i32> {
        let until = Instant::now() + within;
        while Instant::now() < until {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        None
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The characters of a screen: places of the cursor and erasures are followed, colours are not.
struct Screen {
    columns: usize,
    cells: Vec<char>,
    at: usize,
    /// Bytes of a sequence or character that is not complete.
    rest: Vec<u8>,
}

impl Screen {
    fn new(columns: usize, rows: usize) -> Self {
        Self {
            columns,
            cells: vec![' '; columns * rows],
            at: 0,
            rest: Vec::new(),
        }
    }

    fn text(&self) -> String {
        let rows = self.cells.chunks(self.columns);
        let rows = rows.map(|row| row.iter().collect::<String>().trim_end().to_owned() + "\n");
        rows.collect()
    }

    fn write(&mut self, bytes: &[u8]) {
        let mut all = std::mem::take(&mut self.rest);
        all.extend_from_slice(bytes);
        let whole = match std::str::from_utf8(&all) {
            Ok(_) => all.len(),
            Err(error) => error.valid_up_to(),
        };
        let text = String::from_utf8(all[..whole].to_vec()).unwrap();
        let mut rest = text.as_str();
        while let Some(first) = rest.chars().next() {
            if let Some(sequence) = rest.strip_prefix("\u{1b}[") {
                let Some(end) = sequence.find(|c: char| c.is_ascii_alphabetic()) else {
                    break;
                };
                self.apply(&sequence[..end], sequence.as_bytes()[end]);
                rest = &sequence[end + 1..];
                continue;
            }
            if first == '\u{1b}' && rest.len() < 2 {
                break;
            }
            if !first.is_control() {
                if let Some(cell) = self.cells.get_mut(self.at) {
                    *cell = first;
                }
                self.at += 1;
            }
            rest = &rest[first.len_utf8()..];
        }
        self.rest = [rest.as_bytes(), &all[whole..]].concat();
    }

    fn apply(&mut self, arguments: &str, kind: u8) {
        match kind {
            b'H' => {
                let mut numbers = arguments.split(';').map(|it| it.parse().unwrap_or(1_usize));
                let (row, column) = (numbers.next().unwrap_or(1), numbers.next().unwrap_or(1));
                self.at = (row - 1) * self.columns + column - 1;
            }
            b'J' => self.cells.fill(' '),
            _ => {}
        }
    }
}
