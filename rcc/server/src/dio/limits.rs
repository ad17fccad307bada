//! Limits of one connection, which its parser checks and its errors state.

use std::time::Duration;

/// Most subscriptions of one connection: nets, sessions, rules and devices together.
pub(crate) const SUBSCRIPTIONS_MAX: usize = 4096;

/// Polling interval for the values of running nets. A client's refresh interval below this one has
/// no effect.
pub(crate) const VALUES_INTERVAL: Duration = Duration::from_millis(10);

/// Most bytes of the description of a session or a net.
pub(crate) const DESCRIPTION_BYTES_MAX: usize = 4096;

/// Most sessions open by one connection.
pub(crate) const SESSIONS_PER_CONNECTION: usize = 64;
