//! Clocks of a recording: the differences as they were read, the reference against the clock of the recording host, and
//! the phase of the frames to SYNC0. Values that were not read stay unknown.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::json;
use takt_ethercat::dc::{PhaseFigures, phase_ns};

use super::Recording;
use super::report::Report;
use crate::ecat::finding::{Finding, nanos};
use crate::output::time;

/// The slave with the reference clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Source {
    /// By station address (FRMW).
    Station(u16),
    /// By position (ARMW), if the number of slaves is known.
    Position(Option<u16>),
}

/// The reference clock as frames read it.
#[derive(Clone, Debug, Default)]
pub(super) struct Reference {
    source: Option<Source>,
    /// Bytes read: 8, or 4 of a 32 bit clock.
    bytes: usize,
    /// Time stamp of a frame, and the system time that it returned with, ns.
    samples: Vec<(Duration, u64)>,
}

impl Reference {
    pub(super) fn take(&mut self, at: Duration, source: Source, counter: u16, data: &[u8]) {
        if counter == 0 {
            return;
        }
        let bytes = if data.len() >= 8 { 8 } else { 4 };
        if (self.source, self.bytes) != (Some(source), bytes) {
            (self.source, self.bytes, self.samples) = (Some(source), bytes, Vec::new());
        }
        let four = || data.first_chunk().map(|four| u32::from_le_bytes(*four));
        let eight = data.first_chunk().map(|eight| u64::from_le_bytes(*eight));
        if let Some(time) = eight.or_else(|| Some(self.unwrapped(at, four()?))) {
            self.samples.push((at, time));
        }
    }

    /// Extends a 32 bit time, which wraps every 4.295 s: the value nearest to the expectation from the host's clock.
    fn unwrapped(&self, at: Duration, raw: u32) -> u64 {
        let Some((then, last)) = self.samples.last() else {
            return raw.into();
        };
        let host = u64::try_from(at.saturating_sub(*then).as_nanos()).unwrap_or(u64::MAX);
        let expected = last.wrapping_add(host);
        let low = u32::try_from(expected & u64::from(u32::MAX)).unwrap_or(0);
        let ahead = raw.wrapping_sub(low).cast_signed();
        expected.wrapping_add_signed(ahead.into())
    }

    /// Whether this is the clock of a slave.
    fn is_of(&self, number: usize, station: u16) -> bool {
        match self.source {
            Some(Source::Station(source)) => source == station,
            Some(Source::Position(source)) => source.map(usize::from) == Some(number),
            None => false,
        }
    }

    /// Drift against the clock of the recording host, ppm, positive if the reference is faster. It is taken between the
    /// means of the first and the last tenth, so that single late frames have little effect.
    #[expect(
        clippy::cast_precision_loss,
        reason = "differences of some seconds in ns"
    )]
    fn drift_ppm(&self) -> Option<f64> {
        let (origin, zero) = *self.samples.first()?;
        let count = (self.samples.len() / 10).max(1);
        let mean = |samples: &[(Duration, u64)]| {
            let each = samples.iter().map(|(at, system)| {
                let host = at.saturating_sub(origin).as_nanos() as f64;
                (host, system.wrapping_sub(zero).cast_signed() as f64)
            });
            let (host, system) = each.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
            let count = samples.len() as f64;
            (host / count, system / count)
        };
        let first = mean(self.samples.get(..count)?);
        let last = mean(self.samples.get(self.samples.len() - count..)?);
        let host = last.0 - first.0;
        (host > 1e6).then(|| (last.1 - first.1 - host) / host * 1e6)
    }

    /// Distances of the frames from the middle between two SYNC0.
    fn phase(&self, start_ns: u64, cycle_ns: u32) -> PhaseFigures {
        let cycle = Duration::from_nanos(cycle_ns.into());
        let half = i64::from(cycle_ns / 2);
        let mut figures = PhaseFigures::default();
        for (_, system) in self
            .samples
            .iter()
            .filter(|(_, system)| *system >= start_ns)
        {
            let phase = phase_ns(system - start_ns, cycle, 0);
            figures.add(i64::try_from(phase).unwrap_or(0) - half);
        }
        figures
    }
}

/// The lines before the table, and its header.
fn head(recording: &Recording) -> String {
    let (clock, drift) = (&recording.clock, recording.clock.drift_ppm());
    let mut text = format!(
        "{}: {} slaves, {}\n",
        recording.name,
        recording.slave_count(),
        time(nanos(recording.end.saturating_sub(recording.begin)))
    );
    if clock.source.is_some() {
        let (count, bits) = (clock.samples.len(), 8 * clock.bytes);
        let _ = writeln!(text, "{count} frames carry the reference time, {bits} bits");
    }
    if let Some(ppm) = drift {
        let _ = writeln!(
            text,
            "the reference runs {ppm:+.1} ppm against the clock of the recording host"
        );
    }
    text.push_str("\n slave  station  clock      delay ns  difference ns: min      max     last\n");
    text
}

/// The clock report of a recording; differences outside the window fail.
pub(in crate::ecat) fn dc(recording: &Recording, window: Duration) -> Report {
    let ring = recording.ring();
    let clock = &recording.clock;
    let drift = clock.drift_ppm();
    let mut findings: Vec<Finding> = recording.notes.iter().cloned().map(Finding::Note).collect();
    if clock.source.is_none() {
        let text = "no frame distributes the system time (FRMW or ARMW 0910h): its master runs without distributed clocks, \
                    or the recording ends before";
        findings.push(Finding::Failure(text.to_owned()));
    }
    let mut text = head(recording);
    let mut slaves = Vec::new();
    for (number, (station, slave)) in ring.iter().enumerate() {
        let is_reference = clock.is_of(number, *station);
        let range = slave.difference.filter(|_| !is_reference);
        let kind = match (is_reference, range) {
            (true, _) => "reference",
            (false, Some(_)) => "follows",
            (false, None) => "?",
        };
        let delay = slave
            .delay_ns
            .map_or_else(|| "?".to_owned(), |delay| delay.to_string());
        let _ = write!(text, "{number:>6}   {station:04X}h   {kind:<9}  {delay:>8}");
        if let Some(range) = range {
            let (least, most, last) = (range.least, range.most, range.last);
            let _ = write!(text, "  {least:>17} {most:>8} {last:>8}");
            let furthest = least.unsigned_abs().max(most.unsigned_abs());
            if u128::from(furthest) > window.as_nanos() {
                findings.push(Finding::Failure(format!(
                    "slave {number}: its clock was up to {furthest} ns from the reference, {} ns are allowed\nhint: \
                     frames may be late or lost (`takt ecat stat --from`), or the clock had not settled yet",
                    window.as_nanos()
                )));
            }
        }
        text.push('\n');
        slaves.push(json!({
            "slave": number,
            "station": station,
            "clock": kind,
            "delay_ns": slave.delay_ns,
            "range_ns": range.map(|range| [range.least, range.most]),
            "last_ns": range.map(|range| range.last),
        }));
    }
    let phases = phases(recording, &mut text);
    Report {
        name: recording.name.clone(),
        object: json!({
            "version": 1,
            "recording": recording.name,
            "drift_ppm": drift,
            "time_frames": clock.samples.len(),
            "slaves": slaves,
            "sync0": phases,
        }),
        table: text,
        findings,
    }
}

/// The phase of the frames to SYNC0, for each slave that has it.
fn phases(recording: &Recording, text: &mut String) -> Vec<serde_json::Value> {
    let mut all = Vec::new();
    for (number, (_, slave)) in recording.ring().iter().enumerate() {
        let (Some(start), Some(cycle)) = (slave.sync0_start_ns, slave.sync0_cycle_ns) else {
            continue;
        };
        let figures = recording.clock.phase(start, cycle);
        let Some((least, most)) = figures.range_ns() else {
            continue;
        };
        let half = i64::from(cycle / 2);
        let [least, mean, most] = [least, rounded(figures.mean_ns()), most].map(|ns| ns + half);
        let _ = writeln!(
            text,
            "slave {number}: SYNC0 every {}; frames pass {} after it ({} to {})",
            time(cycle.into()),
            time(mean),
            time(least),
            time(most)
        );
        all.push(json!({
            "slave": number,
            "cycle_ns": cycle,
            "mean_ns": mean,
            "min_ns": least,
            "max_ns": most,
            "rms_ns": figures.rms_ns(),
        }));
    }
    all
}

#[expect(clippy::cast_possible_truncation, reason = "less than a period")]
fn rounded(ns: f64) -> i64 {
    ns.round() as i64
}
