//! Values that pass from one net to another of the same controller, as copies between their boxes:
//! a net that reads another one has a hidden in value, one that writes another one has a hidden out
//! value. Which nets exist, and how words cross threads, is the executor's business.

use std::sync::Arc;

use super::{Directory, Entry, HEAD, Mailbox, OutStatus};

/// The in and out values of another net, as found during loading.
#[derive(Clone, Debug, Default)]
pub struct NetBoxes {
    /// Values that can be written to it.
    pub inbox: Arc<Directory>,
    /// Values that it publishes.
    pub outbox: Arc<Directory>,
}

/// One value that passes from one net to another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inter {
    /// The other net.
    pub net: String,
    /// Where the value is in the out-box of the net that publishes it.
    pub from: Entry,
    /// Where the value is in the in-box of the net that reads it.
    pub to: Entry,
}

/// Words of a hidden in value before the value itself: whether it is non-null. The second word of
/// its head holds the time of its last change.
pub(crate) const STATUS: usize = 1;

impl Mailbox {
    /// Copies the last value published by another net; `None` if that net no longer exists. Returns
    /// whether anything changed.
    pub(crate) fn copy_inter(&self, inter: &Inter, given: Option<&[u64]>) -> bool {
        let to = inter.to.at;
        let Some(given) = given else {
            return self.replace(to + HEAD, 0);
        };
        let current = inter.from.status(given) == OutStatus::Current;
        let mut changed = self.replace(to + HEAD, current.into());
        let time = given.get(inter.from.at + 1).copied().unwrap_or(0);
        changed |= self.replace(to + 1, time);
        for (i, word) in inter.from.value(given).iter().enumerate() {
            changed |= self.replace(to + HEAD + STATUS + i, *word);
        }
        changed
    }

    /// Imports a value from another net, as one more write, if it is non-null and changed since
    /// `seen`. Returns whether it was imported.
    pub(crate) fn copy_given(&self, inter: &Inter, given: &[u64], seen: &mut Option<u64>) -> bool {
        let time = given.get(inter.from.at + 1).copied();
        let current = inter.from.status(given) == OutStatus::Current;
        if !current || *seen == time {
            return false;
        }
        *seen = time;
        let to = inter.to.at;
        for (i, word) in inter.from.value(given).iter().enumerate() {
            self.words[to + HEAD + i].set(*word);
        }
        self.words[to].set(self.words[to].get().wrapping_add(1));
        true
    }

    /// Imports the values of a program's box that were written since `seen`, a box of the same
    /// layout; other nets may have written the rest meanwhile.
    pub(crate) fn import_changes(&self, words: &[u64], seen: &mut [u64]) {
        for entry in self.directory.entries() {
            let at = entry.at;
            let (Some(writes), Some(seen)) = (words.get(at), seen.get_mut(at)) else {
                continue;
            };
            if std::mem::replace(seen, *writes) == *writes {
                continue;
            }
            for (i, word) in entry.value(words).iter().enumerate() {
                self.words[at + HEAD + i].set(*word);
            }
            self.words[at].set(self.words[at].get().wrapping_add(1));
        }
    }
}
