//! Which key of a terminal is held: hold-to-run with keys. It reads no terminal.
//!
//! Most terminals report no release of a key: while it is held they repeat it, after a delay of about half a second. There a
//! key is held from its first repetition on, and until repetitions stop coming, so that a tap moves nothing and a stalled
//! terminal releases the key. Terminals with the keyboard protocol of kitty report presses, repetitions and releases.

use std::time::Duration;

/// Longest delay before a terminal repeats a key.
const DELAY: Duration = Duration::from_millis(1000);

/// Longest time between two repetitions: keyboards repeat 10 times a second or more.
const REPEAT: Duration = Duration::from_millis(200);

/// What a terminal reports of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeyEvent<K> {
    /// Pressed, or repeated by a terminal that does not say which.
    Down(K),
    /// Repeated.
    Repeat(K),
    /// Released.
    Up(K),
}

/// A key that is down.
#[derive(Clone, Copy, Debug)]
struct Down<K> {
    key: K,
    /// When it was last reported.
    at: Duration,
    /// Whether it was repeated.
    is_repeated: bool,
}

/// The key that is held.
#[derive(Debug)]
pub(super) struct Held<K> {
    /// Whether the terminal reports releases.
    has_releases: bool,
    down: Option<Down<K>>,
}

impl<K: Copy + PartialEq> Held<K> {
    /// Without a key, at a terminal that reports releases or not.
    pub(super) const fn new(has_releases: bool) -> Self {
        Self {
            has_releases,
            down: None,
        }
    }

    /// The terminal reports a key. The last one that was pressed counts.
    pub(super) fn handle(&mut self, event: KeyEvent<K>, now: Duration) {
        let down = |key, is_repeated| {
            Some(Down {
                key,
                at: now,
                is_repeated,
            })
        };
        let before = self.down.filter(|down| !self.is_over(down, now));
        self.down = match event {
            KeyEvent::Down(key) => {
                let is_same = before.is_some_and(|before| before.key == key);
                down(key, is_same && !self.has_releases)
            }
            KeyEvent::Repeat(key) => match before {
                Some(before) if before.key == key => down(key, true),
                // Of a key that was pressed before, or whose repetitions were late.
                before => before,
            },
            KeyEvent::Up(key) => before.filter(|before| before.key != key),
        };
    }

    /// The key that is held.
    pub(super) fn key(&self, now: Duration) -> Option<K> {
        let down = self.down.filter(|down| !self.is_over(down, now))?;
        (self.has_releases || down.is_repeated).then_some(down.key)
    }

    /// Whether its next report is overdue: it was released, or the terminal stalls.
    fn is_over(&self, down: &Down<K>, now: Duration) -> bool {
        let next = if down.is_repeated { REPEAT } else { DELAY };
        now.saturating_sub(down.at) > next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn held(has_releases: bool, events: &[(u32, KeyEvent<char>)], now: u32) -> Option<char> {
        let mut held = Held::new(has_releases);
        for (at, event) in events {
            held.handle(*event, *at * MS);
        }
        held.key(now * MS)
    }

    #[test]
    fn key_without_releases_is_held_while_repeated() {
        use KeyEvent::Down;
        let tap = [(0, Down('x'))];
        assert_eq!(held(false, &tap, 10), None, "a tap moves nothing");
        let repeated = [(0, Down('x')), (500, Down('x')), (530, Down('x'))];
        assert_eq!(held(false, &repeated, 560), Some('x'));
        assert_eq!(held(false, &repeated, 730), Some('x'));
        assert_eq!(held(false, &repeated, 731), None, "released or stalled");
        let slow_taps = [(0, Down('x')), (1001, Down('x'))];
        assert_eq!(held(false, &slow_taps, 1010), None);
        // A repetition that comes after the release is a press again.
        let again = [&repeated[..], &[(900, Down('x'))]].concat();
        assert_eq!(held(false, &again, 910), None);
        let other = [&repeated[..], &[(540, Down('y'))]].concat();
        assert_eq!(held(false, &other, 545), None);
    }

    #[test]
    fn key_with_releases_is_held_until_release() {
        use KeyEvent::{Down, Repeat, Up};
        let down = [(0, Down('x'))];
        assert_eq!(held(true, &down, 1), Some('x'));
        assert_eq!(held(true, &[(0, Down('x')), (5, Up('x'))], 6), None);
        assert_eq!(held(true, &[(0, Down('x')), (5, Up('y'))], 6), Some('x'));
        assert_eq!(held(true, &down, 1001), None, "the terminal stalls");
        let repeated = [(0, Down('x')), (500, Repeat('x'))];
        assert_eq!(held(true, &repeated, 600), Some('x'));
        assert_eq!(held(true, &repeated, 701), None, "the terminal stalls");
        let late = [&repeated[..], &[(900, Repeat('x'))]].concat();
        assert_eq!(held(true, &late, 901), None, "only a press begins");
        let other = [&repeated[..], &[(510, Down('y')), (520, Repeat('x'))]].concat();
        assert_eq!(held(true, &other, 530), Some('y'));
    }
}
