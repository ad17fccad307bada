//! The report of a demo: the figures of the cycle, of each robot, and the verdict.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use serde::Serialize;
use takt_core::Controller;
use takt_core::controller::FaultCounts;
use takt_core::device::driver::DeviceDriver as _;
use takt_devices::ethercat::Ethercat;
use takt_devices::fri::Lwr;
use takt_devices::fri::emulator::Robot;
use takt_rt::host::Host;
use takt_rt::stats::Summary;

use super::cell::Arm;
use super::recovery::Outcome;
use super::{time_line, time_waited_ms};
use crate::output::time;

/// Quantiles of a time, ns.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Quantiles {
    p50: i64,
    p99: i64,
    p999: i64,
    max: i64,
}

impl fmt::Display for Quantiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [p50, p99, p999, max] = [self.p50, self.p99, self.p999, self.max].map(time);
        write!(f, "p50 {p50}  p99 {p99}  p99.9 {p999}  max {max}")
    }
}

impl From<Summary> for Quantiles {
    fn from(s: Summary) -> Self {
        Self {
            p50: s.p50.0,
            p99: s.p99.0,
            p999: s.p999.0,
            max: s.max.0,
        }
    }
}

/// A robot in the report.
#[derive(Debug, Serialize)]
struct RobotReport {
    name: String,
    protocol: &'static str,
    period_ns: u64,
    /// Kind of robot.
    make: &'static str,
    /// How far the farthest joint moved, or the wheel that turned most, rad.
    moved_rad_max: f64,
    /// Distance that a base moved, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_m: Option<f64>,
    #[serde(flatten)]
    wire: WireReport,
}

/// Figures of the wire of a robot.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum WireReport {
    Fri {
        /// Measurements received.
        datagrams: u64,
        /// Measurements lost, and cycles in which the robot had no answer in time.
        lost: u64,
        quality: String,
        tracking_error_rad_max: f64,
        /// From the arrival of a measurement to the sending of its answer.
        answer_ns: Quantiles,
        /// From the logical time of a set-point to its sending.
        set_point_age_ns: Quantiles,
    },
    Ethercat {
        /// Frames with process data.
        frames: u64,
        /// Frames not answered within their cycle.
        lost: u64,
        /// Deviation of cycle starts from their phase before SYNC0; `None` without SYNC0.
        sync0_error_ns: Option<Quantiles>,
    },
}

impl WireReport {
    fn of_lwr(arm: &Lwr, missed: u64) -> (u64, Self) {
        let figures = arm.figures();
        let wire = Self::Fri {
            datagrams: figures.datagrams,
            lost: figures.lost + missed,
            quality: format!("{:?}", figures.quality).to_uppercase(),
            tracking_error_rad_max: figures.tracking_error_rad_max,
            answer_ns: arm.answer_time.read().summary().into(),
            set_point_age_ns: arm.set_point_age.read().summary().into(),
        };
        (nanoseconds(figures.period.unwrap_or_default()), wire)
    }

    fn of_segment(segment: &Ethercat) -> (u64, Self) {
        let figures = segment.figures();
        let phase = segment.stats.snapshot().phase_error;
        let wire = Self::Ethercat {
            frames: figures.cycles,
            lost: figures.lost,
            sync0_error_ns: (phase.count > 0).then(|| phase.into()),
        };
        (nanoseconds(figures.period), wire)
    }

    const fn protocol(&self) -> &'static str {
        match self {
            Self::Fri { .. } => "fri1",
            Self::Ethercat { .. } => "ethercat",
        }
    }

    /// As one or two lines of text.
    fn text(&self) -> (String, String) {
        match self {
            Self::Fri {
                datagrams,
                lost,
                quality,
                tracking_error_rad_max: error,
                answer_ns,
                ..
            } => (
                format!("{datagrams} datagrams, {lost} lost, quality {quality}"),
                format!(
                    ", tracking error at most {error:.4} rad\n           answer     {answer_ns}"
                ),
            ),
            Self::Ethercat {
                frames,
                lost,
                sync0_error_ns,
            } => (
                format!("{frames} frames, {lost} lost"),
                sync0_error_ns.map_or_else(String::new, |error| {
                    format!("\n           to SYNC0   {error}")
                }),
            ),
        }
    }
}

impl RobotReport {
    /// Figures of the driver of that arm; `None` without one.
    fn new(
        controller: &Controller,
        krcs: &[(String, Robot)],
        arm: Arm,
        moved: f64,
    ) -> Option<Self> {
        let name = arm.name;
        let krc = krcs.iter().find(|(of, _)| of == name);
        let missed = krc.map_or(0, |(_, robot)| u64::from(robot.status().missed()));
        let of_lwr = |arm: &Lwr| arm.drives(name).then(|| WireReport::of_lwr(arm, missed));
        let of_segment = |segment: &Ethercat| {
            segment
                .drives(name)
                .then(|| WireReport::of_segment(segment))
        };
        let found = controller.with_drivers(of_lwr).into_iter();
        let found = found
            .chain(controller.with_drivers(of_segment))
            .flatten()
            .next();
        found.map(|(period_ns, wire)| Self {
            name: name.to_owned(),
            make: arm.make,
            protocol: wire.protocol(),
            period_ns,
            moved_rad_max: moved,
            moved_m: arm.wheel.map(|radius| radius * moved),
            wire,
        })
    }

    /// For people.
    fn text(&self) -> String {
        let period = time(self.period_ns.cast_signed());
        let (first, more) = self.wire.text();
        let moved = match self.moved_m {
            Some(distance) => format!("went {distance:.2} m"),
            None => format!("moved {:.2} rad", self.moved_rad_max),
        };
        format!(
            "{:<10} {}, {} every {period}, {first}\n           {moved}{more}\n",
            self.name, self.make, self.protocol
        )
    }
}

fn nanoseconds(span: Duration) -> u64 {
    u64::try_from(span.as_nanos()).unwrap_or(u64::MAX)
}

/// Counts before the motion began.
#[derive(Debug)]
pub(super) struct Baseline {
    faults: BTreeMap<String, FaultCounts>,
    /// Falls from command mode, by arm.
    exits: BTreeMap<String, u64>,
    memory_kib: Option<u64>,
}

impl Baseline {
    pub(super) fn take(controller: &Controller, krcs: &[(String, Robot)]) -> Self {
        // Faults first, so that a fall between the two readings is not counted as unexplained.
        let faults = controller.fault_counts();
        let exits = krcs.iter();
        let exits = exits.map(|(name, robot)| (name.clone(), robot.status().exits()));
        Self {
            faults,
            exits: exits.collect(),
            memory_kib: resident_kib(),
        }
    }
}

/// Faults of a device while the motion lasted.
#[derive(Debug, Serialize)]
struct DeviceReport {
    name: String,
    /// How often it stopped following commands.
    faults: u64,
    /// After how many of these it followed again.
    recovered: u64,
    /// Faults without a stall of this host before them.
    without_stall: u64,
    /// The longest time until it followed again, s.
    recovered_after_s_max: Option<f64>,
}

impl DeviceReport {
    fn new(name: String, now: FaultCounts, before: FaultCounts) -> Self {
        Self {
            name,
            faults: now.faults.saturating_sub(before.faults),
            // Faults are recovered in their order.
            recovered: now.recovered.saturating_sub(before.faults),
            without_stall: now.without_stall.saturating_sub(before.without_stall),
            recovered_after_s_max: now.recovered_after_max.map(|after| after.as_secs_f64()),
        }
    }

    /// For people.
    fn text(&self) -> String {
        let Self {
            name,
            faults,
            recovered,
            without_stall,
            ..
        } = self;
        let took = self.recovered_after_s_max.unwrap_or_default();
        let without = if *without_stall > 0 {
            format!("; before {without_stall} of them this host did not stall")
        } else {
            String::new()
        };
        format!(
            "recovery   {name}: {faults} faults, {recovered} recovered, within {took:.1} s{without}\n"
        )
    }
}

/// Resident memory of this process, KiB; `None` if the system does not report it.
fn resident_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The report.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) ok: bool,
    /// Reasons why it is not good.
    faults: Vec<String>,
    /// Faults of devices while the motion lasted; those that recovered are no reason why it is not.
    devices: Vec<DeviceReport>,
    /// How often the motion of a part of the cell ended before its time, and how often it was requested again.
    interrupted: u64,
    requested_again: u64,
    /// How often threads of the controller stalled for four of their cycles, and the longest stall, since their start.
    stalls: u64,
    longest_stall_ns: u64,
    /// The thread of the longest stall.
    longest_stall_thread: String,
    /// Resident memory when the motion began and when it ended.
    memory_start_kib: Option<u64>,
    memory_end_kib: Option<u64>,
    /// How long simulated time waited for threads that the host ran late; `None` in real time.
    time_waited_ms: Option<f64>,
    cycles: u64,
    overruns: u64,
    latency_ns: Quantiles,
    execution_ns: Quantiles,
    /// Device whose clock the cycles of nets follow.
    followed: String,
    /// Deviation of cycle starts from the grid of that clock, while it was known.
    phase_error_ns: Quantiles,
    /// Number of cycles in which it was known.
    phase_known: u64,
    rt_allocations: u64,
    rt_page_faults: u64,
    /// Whether memory stays resident: only then is a page fault a fault.
    memory_locked: bool,
    /// Whether the threads have real-time priority and locked memory.
    realtime: bool,
    /// Whether the kernel bounds how late they may be.
    preempt_rt: bool,
    robots: Vec<RobotReport>,
    /// States of the machine, and seconds from its start to each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    states: Vec<(String, f64)>,
    /// Longest time between handing the set-points of one cycle to the first and to the last arm.
    sync_error_ns_max: i64,
}

impl Report {
    pub(super) fn collect(
        controller: &Controller,
        host: &Host,
        krcs: &[(String, Robot)],
        moved: &[(Arm, f64)],
        followed: &str,
        (before, outcome): (&Baseline, Outcome),
    ) -> Self {
        let devices = devices(controller, before);
        let mut faults = unrecovered(controller, &devices, outcome.failures, outcome.more);
        let stats = controller.stats();
        let stalls = controller.stalls();
        let rt_allocations = takt_rt::alloc::real_time_allocations();
        let report = |(arm, moved): &(Arm, f64)| RobotReport::new(controller, krcs, *arm, *moved);
        let robots: Vec<_> = moved.iter().filter_map(report).collect();
        if rt_allocations > 0 {
            faults.push(format!("{rt_allocations} allocations in real-time threads"));
        }
        let rt_page_faults = controller.real_time_page_faults().all();
        let memory_locked = is_memory_locked(host);
        if memory_locked && rt_page_faults > 0 {
            faults.push(format!("{rt_page_faults} page faults in real-time threads"));
        }
        for (name, robot) in krcs {
            // An exit that the controller observed is a fault of the device.
            let exits = robot.status().exits() - before.exits.get(name).copied().unwrap_or(0);
            let mut seen = devices.iter().filter(|device| device.name == *name);
            let seen = seen.next().map_or(0, |device| device.faults);
            if let (true, Some(why)) = (exits > seen, robot.status().last_exit()) {
                faults.push(format!(
                    "{name} left command mode {exits} times, of which the controller saw {seen}: {why}"
                ));
            }
        }
        for (arm, _) in moved.iter().filter(|(_, moved)| *moved < 0.01) {
            faults.push(format!("{} did not move", arm.name));
        }
        Self {
            ok: faults.is_empty(),
            faults,
            devices,
            interrupted: outcome.interrupted,
            requested_again: outcome.requested_again,
            stalls: stalls.count,
            longest_stall_ns: nanoseconds(stalls.longest),
            longest_stall_thread: stalls.thread,
            memory_start_kib: before.memory_kib,
            memory_end_kib: resident_kib(),
            time_waited_ms: time_waited_ms(),
            cycles: stats.cycles,
            overruns: stats.overruns,
            latency_ns: stats.latency.into(),
            execution_ns: stats.execution.into(),
            followed: followed.to_owned(),
            phase_error_ns: stats.phase_error.into(),
            phase_known: stats.phase_error.count,
            rt_allocations,
            rt_page_faults,
            memory_locked,
            realtime: is_real_time(controller, host),
            preempt_rt: host.is_preempt_rt(),
            robots,
            states: Vec::new(),
            sync_error_ns_max: controller.hand_over().max.0,
        }
    }

    /// Adds the states of a machine.
    pub(super) fn set_states<'s>(&mut self, states: impl Iterator<Item = (&'s str, f64)>) {
        self.states = states.map(|(name, at_s)| (name.to_owned(), at_s)).collect();
    }

    /// The report for people.
    pub(super) fn text(&self) -> String {
        let kind = match (self.realtime, self.preempt_rt) {
            _ if self.time_waited_ms.is_some() => "figures of simulated time",
            (true, true) => "real-time priority on a PREEMPT_RT kernel",
            (true, false) => "real-time priority, but not a PREEMPT_RT kernel",
            (false, _) => {
                "NOT real time: see the warnings; figures are those of an ordinary process"
            }
        };
        let mut text = time_line(self.time_waited_ms);
        text += &format!(
            "cycle      1 ms, {} cycles, {} overruns; {kind}\nlatency    {}\nexecution  {}\n",
            self.cycles, self.overruns, self.latency_ns, self.execution_ns,
        );
        if !self.followed.is_empty() {
            text += &format!(
                "phase      {}; on {}'s clock in {} cycles\n",
                self.phase_error_ns, self.followed, self.phase_known
            );
        }
        text.extend(self.robots.iter().map(RobotReport::text));
        text += &format!(
            "sync       all arms had each set-point within {}\nallocations in real-time threads: {}\n",
            time(self.sync_error_ns_max),
            self.rt_allocations
        );
        text += &self.long_run();
        for fault in &self.faults {
            text += &format!("FAULT      {fault}\n");
        }
        text + if self.ok { "OK\n" } else { "FAILED\n" }
    }
}

impl Report {
    /// Figures of a long run, as text.
    fn long_run(&self) -> String {
        let mib = |kib: Option<u64>| {
            kib.map_or_else(|| "unknown".to_owned(), |kib| format!("{} MiB", kib / 1024))
        };
        let (start, end) = (mib(self.memory_start_kib), mib(self.memory_end_kib));
        let mut text = format!("memory     {start} at the start of the motion, {end} at its end\n");
        if self.stalls > 0 {
            let longest = time(self.longest_stall_ns.cast_signed());
            let thread = &self.longest_stall_thread;
            text += &format!(
                "stalls     {} of the controller's threads, the longest {longest} ({thread})\n",
                self.stalls
            );
        }
        text.extend(
            self.devices
                .iter()
                .filter(|it| it.faults > 0)
                .map(DeviceReport::text),
        );
        if self.interrupted > 0 {
            text += &format!(
                "motion     {} times interrupted, {} times requested again\n",
                self.interrupted, self.requested_again
            );
        }
        text
    }
}

/// Faults of each device since the motion began.
fn devices(controller: &Controller, before: &Baseline) -> Vec<DeviceReport> {
    let counts = controller.fault_counts();
    let of = |counts: &BTreeMap<String, FaultCounts>, name: &str| {
        counts.get(name).copied().unwrap_or_default()
    };
    let names = controller.devices().into_iter().map(|device| device.name);
    names
        .map(|name| {
            let (now, before) = (of(&counts, &name), of(&before.faults, &name));
            DeviceReport::new(name, now, before)
        })
        .collect()
}

/// Devices and motion that did not recover: reasons why a run is not good.
fn unrecovered(
    controller: &Controller,
    devices: &[DeviceReport],
    failures: Vec<String>,
    more: u64,
) -> Vec<String> {
    let mut faults = failures;
    if more > 0 {
        faults.push(format!("{more} more of these"));
    }
    let last = controller.faults();
    for device in devices.iter().filter(|it| it.recovered < it.faults) {
        let DeviceReport {
            name,
            faults: count,
            recovered,
            ..
        } = device;
        let mut of_device = last.iter().rev().filter(|fault| fault.device == *name);
        let why = of_device
            .next()
            .map_or_else(String::new, ToString::to_string);
        faults.push(format!(
            "{name} recovered from {recovered} of {count} faults: {why}"
        ));
    }
    faults
}

/// Whether the host granted that memory is locked.
fn is_memory_locked(host: &Host) -> bool {
    let mut grants = host.grants().iter();
    grants.any(|grant| grant.item == takt_rt::host::MEMORY && !grant.is_refused())
}

/// Whether all real-time permissions were granted. The kernel is reported separately.
fn is_real_time(controller: &Controller, host: &Host) -> bool {
    let threads = controller.grants();
    let kernel = |grant: &&takt_rt::Grant| grant.item == takt_rt::host::KERNEL;
    let refused = host.grants().iter().filter(|grant| !kernel(grant));
    !refused
        .chain(threads.iter().map(|(_, grant)| grant))
        .any(takt_rt::Grant::is_refused)
}
