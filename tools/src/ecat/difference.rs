//! The range in which the clock of a slave differs from the reference, as read live or from a recording.

/// Differences of one clock, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Range {
    pub(super) least: i32,
    pub(super) most: i32,
    pub(super) last: i32,
}
