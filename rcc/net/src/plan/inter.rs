//! The values of a plan that pass between nets. When they are copied is the executor's business.

use super::Plan;
use crate::netcomm::{Entry, Inter};

impl Plan {
    /// Values that the net reads from other nets.
    pub fn inter_ins(&self) -> &[Inter] {
        &self.inter_ins
    }

    /// Values that the net writes to other nets.
    pub fn inter_outs(&self) -> &[Inter] {
        &self.inter_outs
    }

    /// Imports one of [`Self::inter_ins`] from the out-box of the other net; `None` if that net no
    /// longer exists, which makes the value null. Returns whether anything changed.
    pub fn import_inter(&self, inter: &Inter, given: Option<&[u64]>) -> bool {
        self.inbox.copy_inter(inter, given)
    }

    /// Imports a value that another net writes to this net, one of its [`Self::inter_outs`], from
    /// its out-box; `seen` holds the time of the last import. Returns whether anything changed.
    pub fn import_given(&self, inter: &Inter, given: &[u64], seen: &mut Option<u64>) -> bool {
        self.inbox.copy_given(inter, given, seen)
    }

    /// Writes the first words of an in value, from its word `first` on, as one more write. Returns whether they fit.
    pub fn write_in(&self, entry: &Entry, first: usize, words: &[u64]) -> bool {
        self.inbox.write(entry, first, words)
    }

    /// A word of an out value that is non-null now.
    #[must_use]
    pub fn out_word(&self, entry: &Entry, word: usize) -> Option<u64> {
        self.outbox.current_word(entry, word)
    }

    /// Copies an out value that is non-null now to an in value of another net, as one more write. Returns whether it
    /// was copied.
    pub fn pass(&self, from: &Entry, to_plan: &Self, to: &Entry) -> bool {
        self.outbox.pass(from, &to_plan.inbox, to)
    }

    /// Number of evaluations.
    #[must_use]
    pub const fn evaluations(&self) -> i64 {
        self.count
    }

    /// Imports those values of an in-box that a program wrote since `seen`, the previous in-box.
    pub fn import_changes(&self, words: &[u64], seen: &mut [u64]) {
        self.inbox.import_changes(words, seen);
    }
}
