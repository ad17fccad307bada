//! Faults of devices: counted, reported once per onset with the stall of this host that caused them, and again when the
//! device follows commands again. It starts nothing: drivers bring devices back, programs request their motion.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::time::Duration;

use takt_rt::Nanos;
use takt_rt::stats::{Stall, StallReader};

use crate::device::DeviceStatus;

/// Maximum time between the end of a stall and the fault that it caused: a drive's watchdog, its master's reaction and
/// a few cycles take far less.
const CAUSE_WITHIN: Nanos = Nanos::from_millis(1000);
/// Maximum number of faults kept; the oldest are dropped first.
const FAULTS_KEPT: usize = 64;
/// The stall of this host that ended shortly before a device had a fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StallCause {
    /// Longest stall of a thread.
    pub length: Duration,
    /// That thread: a device, a bus, or `nets of` with their period.
    pub thread: String,
    /// The processor on which it continued; `None` if unknown.
    pub cpu: Option<usize>,
    /// Threads that stalled at least half as long, including it.
    pub threads: usize,
    /// Threads whose stalls are measured.
    pub measured: usize,
}

impl fmt::Display for StallCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = self.length.as_secs_f64() * 1e3;
        let Self {
            thread,
            threads,
            measured,
            ..
        } = self;
        write!(f, "this host stalled for {ms:.0} ms: thread {thread}")?;
        if let Some(cpu) = self.cpu {
            write!(f, " on processor {cpu}")?;
        }
        write!(f, ", {threads} of {measured} threads stalled")
    }
}

/// A fault of a device: it stopped following commands.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceFault {
    /// Number of the fault over all devices, from 1.
    pub number: u64,
    /// The device.
    pub device: String,
    /// Its status when the fault was detected.
    pub status: DeviceStatus,
    /// When the fault was detected, on `CLOCK_MONOTONIC`.
    pub at: Nanos,
    /// The stall that caused it; `None` if this host did not stall.
    pub cause: Option<StallCause>,
    /// Time until it followed commands again; `None` if it does not yet.
    pub recovered_after: Option<Duration>,
}

impl fmt::Display for DeviceFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { device, status, .. } = self;
        write!(f, "{device} stopped following commands")?;
        match status {
            DeviceStatus::Operational => f.write_str(" for a moment: ")?,
            DeviceStatus::Offline | DeviceStatus::SafeOperational => {
                write!(f, " and is {status}: ")?;
            }
        }
        match &self.cause {
            Some(cause) => cause.fmt(f),
            None => f.write_str("no stall of this host was measured; see the device's own state"),
        }
    }
}

/// Counters of a device's faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultCounts {
    /// How often it stopped following commands.
    pub faults: u64,
    /// Faults after which it followed commands again.
    pub recovered: u64,
    /// Faults without a measured stall of this host.
    pub without_stall: u64,
    /// Longest time until it followed commands again.
    pub recovered_after_max: Option<Duration>,
}

/// Number and duration of thread stalls.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StallFigures {
    /// Stalls of all threads: a stall of the host counts once per delayed thread.
    pub count: u64,
    /// Longest stall.
    pub longest: Duration,
    /// The thread of the longest stall; empty if there was none.
    pub thread: String,
}

/// Detected faults.
#[derive(Debug, Default)]
pub(super) struct Faults {
    recent: VecDeque<DeviceFault>,
    counts: BTreeMap<String, FaultCounts>,
    total: u64,
}

impl Faults {
    /// Updates the fault count of a device; returns a new fault.
    pub(super) fn note(
        &mut self,
        device: &str,
        faults: u64,
        status: DeviceStatus,
        at: Nanos,
        cause: impl FnOnce() -> Option<StallCause>,
    ) -> Option<DeviceFault> {
        let known = self.counts.get(device).map_or(0, |counts| counts.faults);
        if faults < known {
            // Another device of that name.
            self.forget(device);
        }
        if faults == 0 || faults == known {
            return None;
        }
        let counts = self.counts.entry(device.to_owned()).or_default();
        let onsets = faults - counts.faults;
        let cause = cause();
        counts.faults = faults;
        // Between two of several faults it followed commands.
        counts.recovered = counts.recovered.max(faults - 1);
        counts.without_stall += if cause.is_some() { 0 } else { onsets };
        self.total += onsets;
        let fault = DeviceFault {
            number: self.total,
            device: device.to_owned(),
            status,
            at,
            cause,
            recovered_after: None,
        };
        self.recent.push_back(fault.clone());
        if self.recent.len() > FAULTS_KEPT {
            self.recent.pop_front();
        }
        Some(fault)
    }

    /// Records that a device follows commands; returns the duration of the fault that this ends, if any.
    pub(super) fn note_following(&mut self, device: &str, at: Nanos) -> Option<Duration> {
        let counts = self.counts.get_mut(device)?;
        if counts.recovered == counts.faults {
            return None;
        }
        counts.recovered = counts.faults;
        let mut open = self.recent.iter_mut().filter(|fault| {
            let is_open = fault.recovered_after.is_none();
            is_open && fault.device == device
        });
        let mut took = None;
        for fault in &mut open {
            let after = Duration::try_from(at - fault.at).unwrap_or_default();
            fault.recovered_after = Some(after);
            counts.recovered_after_max = counts.recovered_after_max.max(Some(after));
            took = Some(after);
        }
        Some(took.unwrap_or_default())
    }

    fn forget(&mut self, device: &str) {
        self.counts.remove(device);
    }

    /// Forgets the devices that were removed.
    pub(super) fn retain(&mut self, is_known: impl Fn(&str) -> bool) {
        self.counts.retain(|name, _| is_known(name));
    }

    /// Counters by device name; only of devices that had faults.
    pub(super) fn counts(&self) -> &BTreeMap<String, FaultCounts> {
        &self.counts
    }

    /// The last faults, oldest first.
    pub(super) fn recent(&self) -> impl Iterator<Item = &DeviceFault> {
        self.recent.iter()
    }
}

/// The stall among those of these threads, by name, that caused what was seen at that instant.
pub(super) fn cause<'t>(
    threads: impl Iterator<Item = (String, &'t StallReader)>,
    at: Nanos,
) -> Option<StallCause> {
    let mut measured = 0;
    let stalls: Vec<(String, Stall)> = threads
        .inspect(|_| measured += 1)
        .filter_map(|(name, stalls)| Some((name, stalls.longest_between(at - CAUSE_WITHIN, at)?)))
        .collect();
    let (thread, longest) = stalls.iter().max_by_key(|(_, stall)| stall.length)?;
    let as_long = |(_, stall): &&(String, Stall)| stall.length * 2 >= longest.length;
    Some(StallCause {
        length: longest.length,
        thread: thread.clone(),
        cpu: longest.cpu,
        threads: stalls.iter().filter(as_long).count(),
        measured,
    })
}

#[cfg(test)]
mod tests {
    use takt_rt::stats::stalls;

    use super::*;

    const OFFLINE: DeviceStatus = DeviceStatus::Offline;

    #[test]
    fn fault_is_reported_once_per_onset_with_its_stall() {
        let (mut writer, reader) = stalls();
        let (mut other, silent) = stalls();
        let ms = Nanos::from_millis;
        writer.note(ms(5000), ms(152));
        other.note(ms(5001), ms(90));
        let (_, quiet) = stalls();
        let threads = || {
            let names = ["nets of 1ms", "left", "segment"].map(str::to_owned);
            names.into_iter().zip([&reader, &silent, &quiet])
        };
        let mut faults = Faults::default();
        assert_eq!(faults.note("arm", 0, OFFLINE, ms(1), || None), None);
        let found = faults.note("arm", 1, OFFLINE, ms(5100), || cause(threads(), ms(5100)));
        let text = found.unwrap().to_string();
        assert!(
            text.starts_with(
                "arm stopped following commands and is offline: this host stalled for 152 ms: thread nets of 1ms"
            ),
            "{text}"
        );
        assert!(text.ends_with("2 of 3 threads stalled"), "{text}");
        let again = faults.note("arm", 1, OFFLINE, ms(5102), || cause(threads(), ms(5102)));
        assert_eq!(again, None, "one line per onset");
        // A stall of long ago, or one that is still to come, is no cause.
        for at in [4999, 6100] {
            assert_eq!(cause(threads(), ms(at)), None, "{at}");
        }
    }

    #[test]
    fn faults_are_counted_recovered_and_unexplained() {
        let ms = Nanos::from_millis;
        let mut faults = Faults::default();
        assert_eq!(faults.note_following("arm", ms(0)), None, "it had no fault");
        faults.note("arm", 1, OFFLINE, ms(1000), || None).unwrap();
        let counts = |faults: &Faults| faults.counts["arm"];
        assert_eq!(counts(&faults).recovered, 0);
        let took = faults.note_following("arm", ms(2500));
        assert_eq!(took, Some(Duration::from_millis(1500)));
        assert_eq!(faults.note_following("arm", ms(2502)), None, "once");
        // Two faults between two polls: it followed commands between them.
        let two = faults.note("arm", 3, OFFLINE, ms(3000), || None);
        assert_eq!(two.unwrap().number, 3);
        let expected = FaultCounts {
            faults: 3,
            recovered: 2,
            without_stall: 3,
            recovered_after_max: Some(Duration::from_millis(1500)),
        };
        assert_eq!(counts(&faults), expected);
        // Another device of that name begins at zero.
        assert_eq!(faults.note("arm", 0, OFFLINE, ms(4000), || None), None);
        assert!(faults.counts.is_empty());
    }

    #[test]
    fn faults_kept_are_bounded() {
        let mut faults = Faults::default();
        for number in 1..=10_000 {
            let at = Nanos::from_millis(number);
            let count = number.unsigned_abs();
            faults.note("arm", count, OFFLINE, at, || None).unwrap();
            faults.note_following("arm", at);
        }
        assert_eq!(faults.recent.len(), FAULTS_KEPT);
        let counts = faults.counts["arm"];
        assert_eq!((counts.faults, counts.recovered), (10_000, 10_000));
    }
}
