//! What watchers of a controller are notified of, so that a watcher of results alone need not compare states.

/// What changed in a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Changed {
    /// States of nets, sessions, rules or devices, and possibly Boolean out values.
    States,
    /// Boolean out values of running nets only.
    Results,
}
