//! The values of a plan that pass between nets. When they are copied is the executor's business.

use super::Plan;
use crate::netcomm::Inter;

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

    /// Imports those values of an in-box that a program wrote since `seen`, the previous in-box.
    pub fn import_changes(&self, words: &[u64], seen: &mut [u64]) {
        self.inbox.import_changes(words, seen);
    }
}
