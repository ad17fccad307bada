//! Latest values of a listener, between the thread that receives and the one that calls the program. It keeps one of each
//! value, however slow the program is.

use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::error::ErrorKind;

/// What the receiver writes and the thread of the callback reads.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    slot: Mutex<Slot>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Slot {
    /// The latest out values of the net, by key.
    values: BTreeMap<String, String>,
    /// Whether they changed since the thread took them.
    is_new: bool,
    /// Values that were replaced before a callback saw them.
    missed: u64,
    is_closed: bool,
    error: Option<ErrorKind>,
}

impl Shared {
    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The net has new values.
    pub(crate) fn update(&self, values: impl Iterator<Item = (String, String)>) {
        let mut slot = self.slot();
        slot.values.extend(values);
        slot.missed += u64::from(slot.is_new);
        slot.is_new = true;
        drop(slot);
        self.changed.notify_all();
    }

    /// The net has ended; it does not end by itself.
    pub(crate) fn end(&self, reason: &str) {
        let reason = if reason.is_empty() {
            "its net was ended on the controller"
        } else {
            reason
        };
        self.fail(&ErrorKind::Ended {
            device: "listener".to_owned(),
            reason: reason.to_owned(),
        });
    }

    /// It ends with an error, unless it has ended.
    pub(crate) fn fail(&self, error: &ErrorKind) {
        let mut slot = self.slot();
        if !slot.is_closed {
            slot.is_closed = true;
            slot.error = Some(error.clone());
        }
        drop(slot);
        self.changed.notify_all();
    }

    pub(crate) fn close(&self) {
        self.slot().is_closed = true;
        self.changed.notify_all();
    }

    /// Waits for new values; `None` at the end.
    pub(crate) fn next(&self) -> Option<BTreeMap<String, String>> {
        let slot = self.slot();
        let is_idle = |slot: &mut Slot| !slot.is_new && !slot.is_closed;
        let waited = self.changed.wait_while(slot, is_idle);
        let mut slot = waited.unwrap_or_else(PoisonError::into_inner);
        if slot.is_closed {
            return None;
        }
        slot.is_new = false;
        Some(slot.values.clone())
    }

    /// How many values were replaced by later ones before they were taken.
    pub(crate) fn missed(&self) -> u64 {
        self.slot().missed
    }

    /// Why it has ended by itself.
    pub(crate) fn error(&self) -> Option<ErrorKind> {
        self.slot().error.clone()
    }

    /// Whether there are values that were not taken.
    #[cfg(test)]
    pub(crate) fn is_new(&self) -> bool {
        self.slot().is_new
    }
}
