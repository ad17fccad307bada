//! `/metrics`: metrics in the Prometheus text format 0.0.4. The number of lines is bounded by threads and devices;
//! single nets have none.

use std::fmt::{self, Write as _};
use std::time::Duration;

use takt_core::controller::{ClockInfo, FaultCounts, LimitedInfo, NetState, RuleState};
use takt_core::device::driver::{BusLoad, Severity};
use takt_core::{Controller, Snapshot, Summary};

use super::super::Response;
use super::Handler;
use super::status::{BOUNDS_NS, cumulative};
use crate::dio::all_devices;
use crate::site::Counters;

/// Device states.
const DEVICE_STATES: [&str; 3] = ["op", "safeop", "off"];

/// States of the clock that net threads follow.
const CLOCK_STATES: [&str; 5] = ["unlocked", "jump", "locked", "stable", "holdover"];

/// A net thread with its name.
pub(super) struct Thread {
    pub(super) name: String,
    pub(super) period: Duration,
    pub(super) stats: Snapshot,
    /// `None` if it runs on the host's clock.
    pub(super) clock: Option<ClockInfo>,
}

/// The net threads.
pub(super) fn threads(controller: &Controller) -> Vec<Thread> {
    let threads = controller.threads().into_iter().enumerate();
    let name = |number, period| match number {
        0 => "nets".to_owned(),
        _ => format!("nets-{period:?}"),
    };
    threads
        .map(|(number, t)| Thread {
            name: name(number, t.period),
            period: t.period,
            stats: t.stats,
            clock: t.clock,
        })
        .collect()
}

/// A text of samples, family by family.
#[derive(Default)]
struct Exposition(String);

impl Exposition {
    /// Starts a family of samples.
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        self.line(format_args!("# HELP {name} {help}"));
        self.line(format_args!("# TYPE {name} {kind}"));
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: impl fmt::Display) {
        let mut text = String::new();
        for (label, value) in labels {
            let separator = if text.is_empty() { "{" } else { "," };
            let value = escaped(value);
            // Writing to a String cannot fail.
            let _ = write!(text, "{separator}{label}=\"{value}\"");
        }
        if !text.is_empty() {
            text.push('}');
        }
        self.line(format_args!("{name}{text} {value}"));
    }

    /// A family of one sample.
    fn single(&mut self, name: &str, kind: &str, help: &str, value: impl fmt::Display) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }

    fn histogram(
        &mut self,
        name: &str,
        thread: &str,
        summary: &Summary,
        buckets: impl Iterator<Item = (i64, u64)>,
    ) {
        let bucket = format!("{name}_bucket");
        let counts = cumulative(buckets);
        for (bound, count) in BOUNDS_NS.iter().zip(counts) {
            let le = seconds(u128::from(*bound));
            // A snapshot during an update may include a cycle in the buckets and not yet in the count.
            let count = count.min(summary.count);
            self.sample(&bucket, &[("thread", thread), ("le", &le)], count);
        }
        self.sample(
            &bucket,
            &[("thread", thread), ("le", "+Inf")],
            summary.count,
        );
        let sum = seconds(u128::try_from(summary.sum.0).unwrap_or(0));
        self.sample(&format!("{name}_sum"), &[("thread", thread)], sum);
        self.sample(
            &format!("{name}_count"),
            &[("thread", thread)],
            summary.count,
        );
    }

    fn line(&mut self, line: fmt::Arguments<'_>) {
        let _ = writeln!(self.0, "{line}");
    }
}

/// A label value, escaped for quotation marks.
fn escaped(value: &str) -> String {
    let escaped = value.replace('\\', "\\\\").replace('"', "\\\"");
    escaped.replace('\n', "\\n")
}

/// Nanoseconds as seconds, exactly and without trailing zeros.
fn seconds(ns: u128) -> String {
    let text = format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

impl Handler<'_> {
    pub(super) fn metrics(&self) -> Response {
        let mut out = Exposition::default();
        let version = [("version", env!("CARGO_PKG_VERSION"))];
        out.family("takt_info", "gauge", "Version of the controller.");
        out.sample("takt_info", &version, 1);
        self.write_threads(&mut out);
        self.write_nets(&mut out);
        self.write_rules(&mut out);
        out.single(
            "takt_emergency_stop",
            "gauge",
            "1 while the emergency stop is on and no device follows commands.",
            u8::from(self.controller.is_stopped()),
        );
        self.write_devices(&mut out);
        self.write_server(&mut out);
        Response::of_kind("text/plain; version=0.0.4; charset=utf-8", out.0)
    }

    fn write_threads(&self, out: &mut Exposition) {
        let threads = threads(self.controller);
        let mut counter = |name: &str, help: &str, of: fn(&Snapshot) -> u64| {
            out.family(name, "counter", help);
            for thread in &threads {
                out.sample(name, &[("thread", &thread.name)], of(&thread.stats));
            }
        };
        counter("takt_cycles_total", "Cycles that a net thread ran.", |s| {
            s.cycles
        });
        counter(
            "takt_cycles_missed_total",
            "Cycles that a net thread skipped because it was late.",
            |s| s.overruns,
        );
        let name = "takt_cycle_period_seconds";
        out.family(
            name,
            "gauge",
            "Time from one cycle of a net thread to the next.",
        );
        for thread in &threads {
            let labels = [("thread", thread.name.as_str())];
            out.sample(name, &labels, seconds(thread.period.as_nanos()));
        }
        let name = "takt_cycle_latency_seconds";
        let help = "Time from when a cycle was due to when its thread started it.";
        out.family(name, "histogram", help);
        for Thread {
            name: thread,
            stats,
            ..
        } in &threads
        {
            let buckets = stats.latency_buckets().map(|(bound, n)| (bound.0, n));
            out.histogram(name, thread, &stats.latency, buckets);
        }
        let name = "takt_cycle_duration_seconds";
        out.family(
            name,
            "histogram",
            "Time from the start of a cycle's work to its end.",
        );
        for Thread {
            name: thread,
            stats,
            ..
        } in &threads
        {
            let buckets = stats.execution_buckets().map(|(bound, n)| (bound.0, n));
            out.histogram(name, thread, &stats.execution, buckets);
        }
        Self::write_clocks(&threads, out);
        out.single(
            "takt_real_time_allocations_total",
            "counter",
            "Allocations made by real-time threads; anything but 0 is a fault.",
            self.controller.real_time_allocations(),
        );
        let faults = self.controller.real_time_page_faults();
        let name = "takt_real_time_page_faults_total";
        let help = "Page faults of real-time threads since their first cycle, by kind; 0 where memory \
                    can be locked.";
        out.family(name, "counter", help);
        out.sample(name, &[("kind", "minor")], faults.minor);
        out.sample(name, &[("kind", "major")], faults.major);
    }

    /// Metrics of threads in phase with a device's clock; none if there are no such threads.
    fn write_clocks(threads: &[Thread], out: &mut Exposition) {
        let followers = threads.iter().filter_map(|t| Some((t, t.clock.as_ref()?)));
        let followers: Vec<_> = followers.collect();
        if followers.is_empty() {
            return;
        }
        let name = "takt_cycle_phase_error_seconds";
        let help = "Distance of a cycle's start from its phase on the followed clock.";
        out.family(name, "histogram", help);
        for (thread, _) in &followers {
            let stats = &thread.stats;
            let buckets = stats.phase_error_buckets().map(|(bound, n)| (bound.0, n));
            out.histogram(name, &thread.name, &stats.phase_error, buckets);
        }
        let name = "takt_clock_state";
        let help = "1 for the state of the clock that a net thread follows; it is followed in locked, stable and \
        holdover.";
        out.family(name, "gauge", help);
        for (thread, clock) in &followers {
            for state in CLOCK_STATES {
                let labels = [
                    ("thread", thread.name.as_str()),
                    ("device", &clock.device),
                    ("state", state),
                ];
                out.sample(name, &labels, u8::from(clock.state.as_str() == state));
            }
        }
    }

    fn write_nets(&self, out: &mut Exposition) {
        use NetState::{
            Cancelling, Loading, Ready, Rejected, Running, Scheduled, Terminated, Unloaded,
        };
        let states = [
            Loading, Rejected, Ready, Scheduled, Running, Cancelling, Terminated, Unloaded,
        ];
        let nets = self.controller.nets().into_iter();
        let present: Vec<_> = nets
            .filter_map(|net| Some(self.controller.net(net)?.state()))
            .collect();
        let name = "takt_nets";
        out.family(name, "gauge", "Loaded nets, by state.");
        for state in states {
            let count = present.iter().filter(|s| **s == state).count();
            let word = state.to_string().to_ascii_lowercase();
            out.sample(name, &[("state", &word)], count);
        }
        let sessions = self.controller.sessions().len();
        out.single("takt_sessions", "gauge", "Open sessions.", sessions);
    }

    fn write_rules(&self, out: &mut Exposition) {
        let rules = self.controller.rule_states();
        let name = "takt_rules";
        let help =
            "Pending synchronization rules and the last of those that are decided, by state.";
        out.family(name, "gauge", help);
        for state in [
            RuleState::Active,
            RuleState::Fired,
            RuleState::FireFailed,
            RuleState::Inactive,
        ] {
            let count = rules.iter().filter(|s| **s == state).count();
            let word = state.word().to_ascii_lowercase();
            out.sample(name, &[("state", &word)], count);
        }
    }

    fn write_devices(&self, out: &mut Exposition) {
        let name = "takt_device_state";
        let help =
            "1 for the state a device is in: op, safeop (in contact, follows no commands) or off.";
        out.family(name, "gauge", help);
        for device in all_devices(self.controller) {
            for state in DEVICE_STATES {
                let labels = [
                    ("device", device.name.as_str()),
                    ("type", device.kind.as_str()),
                    ("state", state),
                ];
                let is = u8::from(device.status.word() == state);
                out.sample(name, &labels, is);
            }
        }
        self.write_buses(out);
        self.write_events(out);
        self.write_rejected(out);
        self.write_faults(out);
        self.write_last_stages(out);
    }

    /// Loads of buses; none as long as none is measured.
    fn write_buses(&self, out: &mut Exposition) {
        write_buses(&self.controller.bus_loads(), out);
    }

    /// Events of drivers and devices; none as long as there were none.
    fn write_events(&self, out: &mut Exposition) {
        let counts = self.controller.event_counts();
        if counts.is_empty() {
            return;
        }
        let name = "takt_device_events_total";
        let help = "Events that a device or its bus reported, by severity.";
        out.family(name, "counter", help);
        for (device, counts) in &counts {
            for (severity, count) in Severity::ALL.iter().zip(counts) {
                let labels = [("device", device.as_str()), ("severity", severity.word())];
                out.sample(name, &labels, count);
            }
        }
    }

    /// Rejected set-points; none as long as none were rejected.
    fn write_rejected(&self, out: &mut Exposition) {
        let counts = self.controller.rejected_counts();
        if counts.is_empty() {
            return;
        }
        let name = "takt_set_points_rejected_total";
        let help =
            "Times that set-points of nets for a part of a device began to be rejected, by reason.";
        out.family(name, "counter", help);
        for ((device, part, reason), count) in &counts {
            let labels = [
                ("device", device.as_str()),
                ("part", part.as_str()),
                ("reason", reason.word()),
            ];
            out.sample(name, &labels, count);
        }
    }

    /// Device faults; none as long as no device had one.
    fn write_faults(&self, out: &mut Exposition) {
        let counts = self.controller.fault_counts();
        if counts.is_empty() {
            return;
        }
        let mut family = |name: &str, help: &str, value: fn(&FaultCounts) -> u64| {
            out.family(name, "counter", help);
            for (device, counts) in &counts {
                out.sample(name, &[("device", device.as_str())], value(counts));
            }
        };
        family(
            "takt_device_faults_total",
            "Times that a device ceased to follow commands.",
            |counts| counts.faults,
        );
        family(
            "takt_device_recoveries_total",
            "Faults after which a device followed commands again.",
            |counts| counts.recovered,
        );
    }

    /// Commands that the last stage limited; none if no device has one.
    fn write_last_stages(&self, out: &mut Exposition) {
        let devices = self.controller.devices().into_iter();
        let limited: Vec<_> = devices
            .flat_map(|device| {
                let parts = self.controller.limited(&device.name).into_iter();
                parts.map(move |part| (device.name.clone(), part))
            })
            .collect();
        if limited.is_empty() {
            return;
        }
        let mut family = |name: &str, help: &str, value: fn(&LimitedInfo) -> u64| {
            out.family(name, "counter", help);
            for (device, info) in &limited {
                let labels = [("device", device.as_str()), ("part", info.part.as_str())];
                out.sample(name, &labels, value(info));
            }
        };
        family(
            "takt_device_limited_total",
            "Times that commands for a part of a device began to exceed its limits and were limited.",
            |info| info.limited.onsets,
        );
        family(
            "takt_device_limited_cycles_total",
            "Cycles of a device's driver in which the command for a part of it was limited.",
            |info| info.limited.cycles,
        );
    }

    /// What observers lost, and what became of flight files: none of that delays the controller.
    fn write_losses(&self, out: &mut Exposition) {
        let (counters, read) = (&self.site.counters, Counters::read);
        let mut counter = |name: &str, help: &str, value: u64| {
            out.single(name, "counter", help, value);
        };
        counter(
            "takt_live_messages_dropped_total",
            "Messages that slow clients of live data lost.",
            read(&counters.live_dropped),
        );
        counter(
            "takt_live_rows_lost_total",
            "Rows that were overwritten before they were read for live data: the host stalled.",
            read(&counters.live_lost),
        );
        counter(
            "takt_live_datagrams_failed_total",
            "Datagrams of samples that could not be sent.",
            read(&counters.datagrams_failed),
        );
        counter(
            "takt_live_samples_lost_total",
            "Samples that are missing in datagrams: the host stalled.",
            read(&counters.datagrams_lost),
        );
        counter(
            "takt_scope_samples_lost_total",
            "Samples that clients of the scope lost because they read too slowly.",
            read(&counters.scope_lost),
        );
        let Some(flights) = self.controller.flight_counts() else {
            return;
        };
        let name = "takt_flight_files_total";
        let help = "Flight files by what became of them: written, failed (such as on a full disk), or limited (none \
                    was written because there were too many within a short time).";
        out.family(name, "counter", help);
        let of = [
            ("written", flights.written),
            ("failed", flights.failed),
            ("limited", flights.limited),
        ];
        for (outcome, count) in of {
            out.sample(name, &[("outcome", outcome)], count);
        }
    }

    fn write_server(&self, out: &mut Exposition) {
        let counters = &self.site.counters;
        let clients = Counters::read(&counters.clients);
        out.single("takt_clients", "gauge", "Open connections.", clients);
        let mut counter = |name: &str, help: &str, value: u64| {
            out.single(name, "counter", help, value);
        };
        let read = Counters::read;
        counter(
            "takt_connections_total",
            "Connections accepted.",
            read(&counters.connections),
        );
        counter(
            "takt_connections_refused_total",
            "Connections rejected because all slots were in use, or evicted.",
            read(&counters.refused),
        );
        counter(
            "takt_tokens_denied_total",
            "Clients rejected for a wrong token, host, origin or first line.",
            read(&counters.denied),
        );
        counter(
            "takt_http_requests_total",
            "HTTP requests.",
            read(&counters.requests),
        );
        let name = "takt_messages_total";
        out.family(name, "counter", "DirectIO messages, by direction.");
        out.sample(name, &[("direction", "received")], read(&counters.received));
        out.sample(name, &[("direction", "sent")], read(&counters.sent));
        self.write_losses(out);
    }
}

fn write_buses(loads: &[BusLoad], out: &mut Exposition) {
    if loads.is_empty() {
        return;
    }
    let name = "takt_bus_bits_per_second";
    let help = "Bits of frames on a bus within the last second, stuff bits included.";
    out.family(name, "gauge", help);
    for load in loads {
        out.sample(name, &[("bus", load.bus.as_str())], load.bits_per_s);
    }
    let known = || loads.iter().filter_map(|it| Some((&it.bus, it.load()?)));
    if known().next().is_none() {
        return;
    }
    let name = "takt_bus_load_ratio";
    let help =
        "Part of the last second in which frames were on a bus whose bit rate is known, 0 to 1.";
    out.family(name, "gauge", help);
    for (bus, load) in known() {
        out.sample(name, &[("bus", bus.as_str())], load);
    }
}

#[cfg(test)]
mod tests {
    use takt_core::Nanos;

    use super::*;

    #[test]
    fn bus_load_without_bit_rate_has_bits_only() {
        let load = |bus: &str, bit_rate| BusLoad {
            bus: bus.to_owned(),
            bit_rate,
            bits_per_s: 125_000,
            bits_per_s_max: 250_000,
        };
        let mut out = Exposition::default();
        write_buses(&[], &mut out);
        assert_eq!(out.0, "");
        write_buses(&[load("vcan0", None)], &mut out);
        assert!(
            out.0
                .contains("takt_bus_bits_per_second{bus=\"vcan0\"} 125000\n")
        );
        assert!(!out.0.contains("takt_bus_load_ratio"), "{}", out.0);
        write_buses(&[load("can0", Some(500_000))], &mut out);
        assert!(
            out.0.contains("takt_bus_load_ratio{bus=\"can0\"} 0.25\n"),
            "{}",
            out.0
        );
    }

    #[test]
    fn histogram_sum_equals_sample_sum() {
        let summary = Summary {
            count: 3,
            sum: Nanos(20),
            mean: Nanos(6),
            ..Summary::default()
        };
        let mut out = Exposition::default();
        out.histogram("x", "nets", &summary, std::iter::empty());
        assert!(
            out.0.contains("x_sum{thread=\"nets\"} 0.00000002\n"),
            "{}",
            out.0
        );
    }
}
