//! Reasons why a measurement is of limited value, and what to try next.
//!
//! No warning changes the verdict.

use serde::{Deserialize, Serialize};

use crate::output::time;

/// Below this share of busy time, percent, nothing much ran beside the measurement.
const BUSY_ENOUGH: f64 = 50.0;
/// Runs shorter than this are not significant for the longest latency, ns.
const LONG_ENOUGH_NS: u64 = 600_000_000_000;

/// Why a measurement may be worthless.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Warning {
    /// An ordinary thread was measured; the reason, unless it was asked for.
    NoFifo { refusal: Option<String> },
    /// The kernel does not bound latencies.
    NoRealTimeKernel,
    /// Another request of the controller to the host was refused.
    Refused { grant: String },
    /// A hypervisor decides when processors run.
    VirtualMachine { name: String },
    /// The machine had nothing else to do.
    NoLoad { busy_percent: f64 },
    /// The load did not last as long as the measurement.
    LoadEnded,
    /// Rare events had no time to happen.
    ShortRun { duration_ns: u64 },
    /// Cycles that are not in the histogram read.
    BeyondHistogram { cycles: u64 },
    /// A measurement of another tool, whose file does not record the conditions.
    Imported { tool: String },
}

/// A warning as an entry of reports.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// For programs, as in `no-load`.
    pub(crate) id: String,
    /// For people: the cause, and what to do next.
    pub(crate) text: String,
}

impl Warning {
    /// A machine this idle shows its best case.
    pub(crate) fn of_load(busy_percent: f64) -> Option<Self> {
        (busy_percent < BUSY_ENOUGH).then_some(Self::NoLoad { busy_percent })
    }

    /// A run this short has seen no rare event.
    pub(crate) fn of_duration(duration_ns: u64) -> Option<Self> {
        (duration_ns < LONG_ENOUGH_NS).then_some(Self::ShortRun { duration_ns })
    }

    /// For programs.
    fn id(&self) -> &'static str {
        match self {
            Self::NoFifo { .. } => "no-fifo",
            Self::NoRealTimeKernel => "no-real-time-kernel",
            Self::Refused { .. } => "refused",
            Self::VirtualMachine { .. } => "virtual-machine",
            Self::NoLoad { .. } => "no-load",
            Self::LoadEnded => "load-ended",
            Self::ShortRun { .. } => "short-run",
            Self::BeyondHistogram { .. } => "beyond-histogram",
            Self::Imported { .. } => "imported",
        }
    }

    fn text(&self) -> String {
        match self {
            Self::NoFifo { refusal: None } => {
                "an ordinary thread was measured, and any other may keep it waiting: --priority 80"
                    .into()
            }
            Self::NoFifo {
                refusal: Some(grant),
            } => format!("an ordinary thread was measured: {grant}"),
            Self::NoRealTimeKernel => {
                "this kernel is not PREEMPT_RT and bounds no latency: boot one, see `takt doctor`"
                    .into()
            }
            Self::Refused { grant } => grant.clone(),
            Self::VirtualMachine { name } => format!(
                "a virtual machine ({name}): its host stops it at will, so the longest latencies are \
                 the host's; measure on the machine itself"
            ),
            Self::NoLoad { busy_percent } => format!(
                "no load: the machine was {busy_percent} % busy, so this is its best case; --load 4, \
                 or run the real application beside it"
            ),
            Self::LoadEnded => {
                "the load ended before the measurement: see what it wrote to standard error, free \
                 some space in the temporary folder"
                    .into()
            }
            Self::ShortRun { duration_ns } => format!(
                "a short run: {} have seen no rare event; --duration 1h before trusting the longest \
                 latency",
                time(i64::try_from(*duration_ns).unwrap_or(i64::MAX))
            ),
            Self::BeyondHistogram { cycles } => format!(
                "{cycles} cycles lie beyond the histogram, only their longest is known: measure with \
                 a larger -h"
            ),
            Self::Imported { tool } => format!(
                "{tool} does not say what load ran, and counts no missed cycles: measure with \
                 `takt jitter`"
            ),
        }
    }

    /// As an entry of reports.
    pub(crate) fn entry(&self) -> Entry {
        Entry {
            id: self.id().to_owned(),
            text: self.text(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn idle_and_short_runs_are_warned_about() {
        assert_eq!(Warning::of_load(50.0), None);
        assert!(Warning::of_load(49.9).is_some());
        assert_eq!(Warning::of_duration(600_000_000_000), None);
        let short = Warning::of_duration(10_000_000_000).unwrap().entry();
        assert_eq!(short.id, "short-run");
        assert!(short.text.contains("10.0 s") && short.text.contains("--duration"));
    }
}
