//! Probes: every value of a running controller that changes with its cycles, by name, and a scope over some of them. Net threads
//! write rows in each cycle; here they are read, aligned and searched for a trigger, with no lock and off the real-time path.
//!
//! | name | value |
//! |---|---|
//! | `<device>.joint.<n>.measured` and the like | columns of the device's ring |
//! | `net:<name>/<primitive>.<port>` | a port of a net, by a sampler |
//! | `net:<name>.state`, `machine:<name>.state`, `machine:<name>.<inside>.state` | number of a state, with its name |
//! | `thread:<name>.latency` and the like | timing of a net thread |

mod columns;
mod group;
mod request;
mod scope;
mod trigger;

#[cfg(test)]
mod tests;

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

pub(crate) use columns::{
    device_columns, machine_column, net_state_column, port_columns, thread_columns,
};
pub(crate) use group::{Group, Source};
pub(crate) use scope::Member;

pub use request::{Mode, ScopeRequest, TriggerKind, TriggerRequest};
pub use scope::{Frame, GroupInfo, Scope, ScopeEvent};
pub use trigger::{Capture, CaptureRows, Condition, Engine, GroupSize, Settings, Triggered, Watch};

/// Maximum number of probes of one scope, the one of its trigger not counted.
pub const PROBES_MAX: usize = 64;
/// Maximum number of characters of a probe's name.
pub const NAME_CHARS_MAX: usize = 256;
/// Longest time before and after a trigger, s.
pub const WINDOW_S_MAX: f64 = 60.0;
/// Maximum number of bytes that one scope keeps for its captures.
pub const CAPTURE_BYTES_MAX: usize = 32 << 20;
/// Maximum number of frames per second.
pub const RATE_HZ_MAX: f64 = 100.0;
/// Maximum divisor of samples.
pub const EVERY_MAX: u64 = 1_000_000;
/// Maximum number of probes of one list.
pub const LISTED_MAX: usize = 20_000;

/// A probe, as listed.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Its name, by which a scope finds it.
    pub name: String,
    /// SI unit; empty if it has none.
    pub unit: String,
    /// The net thread that samples it.
    pub thread: String,
    /// Time between two samples.
    pub period: Duration,
    /// The device, net, machine or thread that it is of.
    pub source: String,
    /// For states: their names, by number.
    pub states: Arc<[String]>,
}

/// The probes of a controller.
#[derive(Clone, Debug, Default)]
pub struct Probes {
    /// At most [`LISTED_MAX`].
    pub probes: Vec<Probe>,
    /// Number of probes that are not listed.
    pub left_off: usize,
}

/// A function of the words of a row; not a number if the value is not, with the bits of [`NULL`](takt_net::ports::NULL) if it is null.
pub(crate) type Pick = Arc<dyn Fn(&[u64]) -> f64 + Send + Sync>;

/// A column of rows.
#[derive(Clone)]
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) unit: String,
    pub(crate) states: Arc<[String]>,
    pub(crate) pick: Pick,
}

impl fmt::Debug for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Column").field(&self.name).finish()
    }
}

/// Why a scope is refused as a whole.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScopeError {
    /// A number of the request is out of range.
    #[error("{field} is {value}\nhint: it may be {from} to {to}")]
    Range {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// The smallest value.
        from: String,
        /// The largest value.
        to: String,
    },
    /// A trigger needs a field that is missing.
    #[error("a trigger on `{on}` needs `{field}`\nhint: {hint}")]
    Missing {
        /// The kind of trigger.
        on: &'static str,
        /// The field.
        field: &'static str,
        /// What to give.
        hint: &'static str,
    },
    /// A trigger that is no edge has a hysteresis.
    #[error("a trigger on `{on}` has no hysteresis\nhint: `rising` and `falling` have one")]
    Hysteresis {
        /// The kind of trigger.
        on: &'static str,
    },
    /// The probe of the trigger cannot be sampled.
    #[error("the trigger: {0}")]
    Trigger(ProbeError),
    /// The probe of the trigger has no such state.
    #[error("the trigger: `{probe}` has no state `{state}`\nhint: its states are {known}")]
    State {
        /// The probe.
        probe: String,
        /// The state.
        state: String,
        /// The names of its states.
        known: String,
    },
    /// The captures would take too much memory.
    #[error(
        "captures of {probes} probes with pre_s {pre_s} and post_s {post_s} take {bytes} bytes, and a scope keeps at most \
         {CAPTURE_BYTES_MAX}\nhint: choose shorter times, fewer probes, or a larger `every`"
    )]
    Memory {
        /// Number of probes.
        probes: usize,
        /// Time before the trigger, s.
        pre_s: f64,
        /// Time after it, s.
        post_s: f64,
        /// Bytes that they would take.
        bytes: usize,
    },
}

/// Why a probe cannot be sampled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{probe}`: {cause}\nhint: {hint}")]
pub struct ProbeError {
    /// The probe as requested.
    pub probe: String,
    /// The cause.
    pub cause: String,
    /// The remedy.
    pub hint: String,
}
