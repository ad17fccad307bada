//! Debug taps of a plan: the ports whose values a net's text asks to record, and the layout of one
//! cycle of all of them in words. Whether a client reads them, and how the words leave the
//! evaluating thread, is the executor's business. A plan without taps has no cost for them.

use std::sync::Arc;

use crate::plan::Plan;
use crate::slots::SlotRef;
use crate::value::text::format_words;
use crate::value::{Nanos, Type};

/// Upper bound on the debug taps of one net.
pub const TAPS_MAX: usize = 1024;

/// Upper bound on the words of one record.
pub(crate) const RECORD_WORDS_MAX: usize = 4096;

/// Longest time that a tap keeps values, s; longer times in a text are truncated to it.
pub(crate) const TAP_SECONDS_MAX: f64 = 10.0;

/// A tapped port.
#[derive(Clone, Debug, PartialEq)]
pub struct Tap {
    /// Names of its fragments, of its primitive, and its own, joined by dots.
    pub name: String,
    /// Type of its values.
    pub ty: Type,
    /// How long its values are kept, s.
    pub seconds: f64,
    /// Its first word in a record: 1 if the value is non-null; the value follows.
    at: usize,
    words: usize,
}

impl Tap {
    /// The text of the port's value in a record; `None` if it was null.
    pub fn text(&self, record: &[u64]) -> Option<String> {
        if record.get(self.at) != Some(&1) {
            return None;
        }
        let words = record.get(self.at + 1..self.at + 1 + self.words)?;
        let mut text = String::new();
        format_words(self.ty, words, &mut text);
        Some(text)
    }
}

/// The logical time of a record.
pub fn record_time(record: &[u64]) -> Nanos {
    Nanos(record.first().map_or(0, |word| word.cast_signed()))
}

/// The source of a tap.
#[derive(Debug)]
struct Source {
    slot: SlotRef,
    /// Guards that must be active for the slot to hold a value of the present cycle.
    guards: Box<[u32]>,
}

/// The taps of a plan.
#[derive(Debug, Default)]
pub(crate) struct Taps {
    taps: Arc<[Tap]>,
    sources: Box<[Source]>,
    words: usize,
}

impl Taps {
    /// Lays out taps given by name, type, seconds, slot and guards. Taps that would exceed the
    /// bound on a record are left out.
    pub(crate) fn new(found: Vec<(String, Type, f64, SlotRef, Vec<u32>)>) -> Self {
        let (mut taps, mut sources, mut at) = (Vec::new(), Vec::new(), 1);
        for (name, ty, seconds, slot, guards) in found {
            let words = slot.words();
            if at + 1 + words > RECORD_WORDS_MAX {
                continue;
            }
            taps.push(Tap {
                name,
                ty,
                seconds,
                at,
                words,
            });
            let guards = guards.into_boxed_slice();
            sources.push(Source { slot, guards });
            at += 1 + words;
        }
        Self {
            words: if taps.is_empty() { 0 } else { at },
            taps: taps.into(),
            sources: sources.into_boxed_slice(),
        }
    }
}

impl Plan {
    /// The tapped ports.
    pub const fn taps(&self) -> &Arc<[Tap]> {
        &self.taps.taps
    }

    /// Number of words of one record of all taps; 0 without taps.
    pub const fn record_words(&self) -> usize {
        self.taps.words
    }

    /// Writes the record of the last evaluated cycle, of logical time `time`.
    pub fn record(&self, time: Nanos, record: &mut [u64]) {
        if let Some(first) = record.first_mut() {
            *first = time.0.cast_unsigned();
        }
        for (tap, source) in self.taps.taps.iter().zip(&self.taps.sources) {
            let Some(words) = record.get_mut(tap.at..=tap.at + tap.words) else {
                return;
            };
            let active = |guard: &u32| self.guards[*guard as usize].was_active;
            let active = source.guards.iter().all(active);
            if let Some((status, value)) = words.split_first_mut() {
                *status = (active && source.slot.put(&self.slots, value)).into();
            }
        }
    }
}
