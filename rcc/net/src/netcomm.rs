//! Exchange between a running net and programs that are not real time: values out of the net
//! (NetcommOut) and into it (NetcommIn), laid out as words, so that a whole box is handed over by
//! copying. How the words cross threads is the executor's business.

mod inter;

use std::cell::Cell;
use std::sync::Arc;

use crate::value::text::{ValueError, format_words, parse_words};
use crate::value::{Type, Value};
pub(crate) use inter::STATUS as INTER_STATUS;
pub use inter::{Inter, NetBoxes};

/// One value of a box.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The key on the wire: `out` or `in` and the primitive's `Key`.
    pub key: String,
    /// Type of the value.
    pub ty: Type,
    /// Whether clients and synchronization rules may see it.
    pub report: bool,
    /// First word of the entry in its box.
    at: usize,
    /// Words of the value.
    words: usize,
}

/// Words before an entry's value: status and time (out), or number of writes (in).
const HEAD: usize = 2;

/// The layout of the values in a box.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Directory {
    entries: Vec<Entry>,
    words: usize,
}

/// The state of an out value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutStatus {
    /// It has never been non-null.
    Never,
    /// Non-null in the last cycle.
    Current,
    /// Null in the last cycle; the value is the last non-null one.
    Held,
}

impl Directory {
    /// The entries in the order of the first use of their keys.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Length of the box, in words.
    pub const fn words(&self) -> usize {
        self.words
    }

    /// The entry with that key.
    pub fn find(&self, key: &str) -> Option<&Entry> {
        self.entries.iter().find(|e| e.key == key)
    }

    /// Adds an entry and returns the index of its first word.
    pub(crate) fn add(&mut self, key: String, ty: Type, value_words: usize, report: bool) -> usize {
        let at = self.words;
        self.words += HEAD + value_words;
        self.entries.push(Entry {
            key,
            ty,
            report,
            at,
            words: value_words,
        });
        at
    }
}

impl Entry {
    /// The entry's first word in its box.
    pub const fn at(&self) -> usize {
        self.at
    }

    /// Whether it passes between nets only, invisible to programs.
    pub fn is_hidden(&self) -> bool {
        self.key.starts_with(['<', '>'])
    }

    pub(crate) const fn value_words(&self) -> usize {
        self.words
    }

    /// The state of an out value, read from its box.
    pub fn status(&self, words: &[u64]) -> OutStatus {
        match words.get(self.at) {
            Some(1) => OutStatus::Current,
            Some(2) => OutStatus::Held,
            _ => OutStatus::Never,
        }
    }

    /// The value's words in its box.
    pub fn value<'a>(&self, words: &'a [u64]) -> &'a [u64] {
        words
            .get(self.at + HEAD..self.at + HEAD + self.words)
            .unwrap_or_default()
    }

    /// Formats the value in its box.
    pub fn format(&self, words: &[u64], out: &mut String) {
        format_words(self.ty, self.value(words), out);
    }

    /// Parses a value into an in-box, as one more write.
    ///
    /// # Errors
    /// If the text is not a value of the entry's type; the box is then unchanged.
    pub fn write(&self, text: &str, words: &mut [u64]) -> Result<(), ValueError> {
        let mut value = vec![0; self.words];
        parse_words(self.ty, text, &mut value)?;
        let at = self.at + HEAD;
        words[at..at + self.words].copy_from_slice(&value);
        words[self.at] = words[self.at].wrapping_add(1);
        Ok(())
    }
}

/// A box inside a plan.
#[derive(Debug, Default)]
pub struct Mailbox {
    pub(crate) directory: Arc<Directory>,
    pub(crate) words: Box<[Cell<u64>]>,
    pub(crate) changed: Cell<bool>,
    /// Whether a Boolean value that programs see changed.
    pub(crate) results: Cell<bool>,
}

impl Mailbox {
    pub(crate) fn new(directory: Directory, initial: &[u64]) -> Self {
        let words = initial.iter().copied().map(Cell::new).collect();
        Self {
            directory: Arc::new(directory),
            words,
            changed: Cell::new(false),
            results: Cell::new(false),
        }
    }

    /// Stores an out value and returns whether it changed; `time` is the time of its last change. Words are compared
    /// before they are written, so that an unchanged box need not be handed over.
    pub(crate) fn store<T: Value>(&self, at: usize, value: T, time: u64) -> bool {
        let mut changed = self.replace(at, 1);
        value.put(|i, w| changed |= self.replace(at + HEAD + i, w));
        if changed {
            self.words[at + 1].set(time);
            self.changed.set(true);
        }
        changed
    }

    /// Stores one element of an out array; returns whether it changed.
    pub(crate) fn store_element<T: Value>(&self, at: usize, number: usize, value: T) -> bool {
        let mut changed = false;
        value.put(|i, w| changed |= self.replace(at + HEAD + number * T::WORDS + i, w));
        changed
    }

    /// Marks an out array as non-null; `changed` is whether any element changed.
    pub(crate) fn finish_array(&self, at: usize, changed: bool, time: u64) {
        if self.replace(at, 1) || changed {
            self.words[at + 1].set(time);
            self.changed.set(true);
        }
    }

    /// Marks an out value as null; it keeps its last value.
    pub(crate) fn hold(&self, at: usize) {
        if self.words[at].get() == 1 {
            self.words[at].set(2);
            self.changed.set(true);
        }
    }

    /// The time of the last change of a value from another net; `None` while it is null.
    pub(crate) fn inter_time(&self, at: usize) -> Option<u64> {
        (self.words[at + HEAD].get() != 0).then(|| self.words[at + 1].get())
    }

    /// The number of writes of an in value.
    pub(crate) fn writes(&self, at: usize) -> u64 {
        self.words[at].get()
    }

    pub(crate) fn load<T: Value>(&self, at: usize, number: usize) -> T {
        T::take(|i| self.words[at + HEAD + number * T::WORDS + i].get())
    }

    fn replace(&self, at: usize, word: u64) -> bool {
        self.words[at].replace(word) != word
    }

    /// A Boolean out value, if it is non-null now.
    pub(crate) fn current_bool(&self, at: usize) -> Option<bool> {
        let current = self.words.get(at)?.get() == 1;
        let value = self.words.get(at + HEAD)?.get() != 0;
        current.then_some(value)
    }

    /// Writes words of an in value from its word `first` on; returns whether they fit.
    pub(crate) fn write(&self, entry: &Entry, first: usize, words: &[u64]) -> bool {
        let at = entry.at + HEAD;
        let cells = self.words.get(at..at + entry.words);
        let Some(cells) = cells.and_then(|cells| cells.get(first..first + words.len())) else {
            return false;
        };
        for (cell, word) in cells.iter().zip(words) {
            cell.set(*word);
        }
        self.count_write(entry);
        true
    }

    /// A word of an out value that is non-null now.
    pub(crate) fn current_word(&self, entry: &Entry, word: usize) -> Option<u64> {
        let is_current = self.words.get(entry.at)?.get() == 1 && word < entry.words;
        let cell = self.words.get(entry.at + HEAD + word)?;
        is_current.then(|| cell.get())
    }

    /// Copies an out value that is non-null now to an in value of another box; returns whether it was copied.
    pub(crate) fn pass(&self, from: &Entry, other: &Self, to: &Entry) -> bool {
        let is_current = self
            .words
            .get(from.at)
            .is_some_and(|status| status.get() == 1);
        let source = self.words.get(from.at + HEAD..from.at + HEAD + from.words);
        let target = other.words.get(to.at + HEAD..to.at + HEAD + to.words);
        let (true, Some(source), Some(target)) = (is_current, source, target) else {
            return false;
        };
        if source.len() != target.len() {
            return false;
        }
        for (target, source) in target.iter().zip(source) {
            target.set(source.get());
        }
        other.count_write(to);
        true
    }

    fn count_write(&self, entry: &Entry) {
        if let Some(writes) = self.words.get(entry.at) {
            writes.set(writes.get().wrapping_add(1));
        }
    }

    /// Imports a whole box.
    pub(crate) fn import(&self, words: &[u64]) {
        for (cell, word) in self.words.iter().zip(words) {
            cell.set(*word);
        }
    }

    /// Exports the whole box.
    pub(crate) fn export(&self, words: &mut [u64]) {
        for (word, cell) in words.iter_mut().zip(&self.words) {
            *word = cell.get();
        }
    }
}
