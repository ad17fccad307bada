//! The report of a demo: the figures of the cycle, of each robot, and the verdict.

use std::fmt;
use std::time::Duration;

use serde::Serialize;
use takt_core::Controller;
use takt_core::device::driver::DeviceDriver as _;
use takt_core::device::ethercat::Ethercat;
use takt_core::device::lwr::Lwr;
use takt_rt::host::Host;
use takt_rt::stats::Summary;

use super::cell::Arm;
use crate::emulate::Robot;
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
    /// What it is.
    make: &'static str,
    /// How far the farthest joint moved, or the wheel that turned most, rad.
    moved_rad_max: f64,
    /// How far that brought a base, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved_m: Option<f64>,
    #[serde(flatten)]
    wire: WireReport,
}

/// What is told of the wire of a robot.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum WireReport {
    Fri {
        /// Measurements received.
        datagrams: u64,
        /// Measurements that never came and cycles in which the robot had no answer in time.
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
        /// Those whose answer did not come in their cycle.
        lost: u64,
        /// How far cycles began from their place before SYNC0; `None` without SYNC0.
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

    /// A line or two for people.
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
    /// What the driver of that arm tells; nothing if there is none.
    fn new(
        controller: &Controller,
        krcs: &[(String, Robot)],
        arm: Arm,
        moved: f64,
    ) -> Option<Self> {
        let name = arm.name;
        let krc = krcs.iter().find(|(of, _)| of == name);
        let missed = krc.map_or(0, |(_, robot)| u64::from(robot.status.missed()));
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
            Some(way) => format!("went {way:.2} m"),
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

/// The report.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) ok: bool,
    /// Why it is not.
    faults: Vec<String>,
    cycles: u64,
    overruns: u64,
    latency_ns: Quantiles,
    execution_ns: Quantiles,
    /// Device whose clock the cycles of nets follow.
    followed: String,
    /// How far they began from their places on that clock, while it was known.
    phase_error_ns: Quantiles,
    /// In how many cycles it was.
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
        mut faults: Vec<String>,
    ) -> Self {
        let stats = controller.stats();
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
            if let Some(why) = robot.status.last_exit() {
                faults.push(format!("{name} left command mode: {why}"));
            }
        }
        for (arm, _) in moved.iter().filter(|(_, moved)| *moved < 0.01) {
            faults.push(format!("{} did not move", arm.name));
        }
        Self {
            ok: faults.is_empty(),
            faults,
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
            sync_error_ns_max: controller.hand_over().max.0,
        }
    }

    /// The report for people.
    pub(super) fn text(&self) -> String {
        let kind = match (self.realtime, self.preempt_rt) {
            (true, true) => "real-time priority on a PREEMPT_RT kernel",
            (true, false) => "real-time priority, but not a PREEMPT_RT kernel",
            (false, _) => {
                "NOT real time: see the warnings; figures are those of an ordinary process"
            }
        };
        let mut text = format!(
            "cycle      1 ms, {} cycles, {} overruns; {kind}\nlatency    {}\nexecution  {}\n\
             phase      {}; on {}'s clock in {} cycles\n",
            self.cycles,
            self.overruns,
            self.latency_ns,
            self.execution_ns,
            self.phase_error_ns,
            self.followed,
            self.phase_known
        );
        text.extend(self.robots.iter().map(RobotReport::text));
        text += &format!(
            "sync       all arms had each set-point within {}\nallocations in real-time threads: {}\n",
            time(self.sync_error_ns_max),
            self.rt_allocations
        );
        for fault in &self.faults {
            text += &format!("FAULT      {fault}\n");
        }
        text + if self.ok { "OK\n" } else { "FAILED\n" }
    }
}

/// Whether the host granted that memory is locked.
fn is_memory_locked(host: &Host) -> bool {
    let mut grants = host.grants().iter();
    grants.any(|grant| grant.item == takt_rt::host::MEMORY && !grant.is_refused())
}

/// Whether nothing was refused that real-time threads ask for. The kernel is told apart.
fn is_real_time(controller: &Controller, host: &Host) -> bool {
    let threads = controller.grants();
    let kernel = |grant: &&takt_rt::Grant| grant.item == takt_rt::host::KERNEL;
    let refused = host.grants().iter().filter(|grant| !kernel(grant));
    !refused
        .chain(threads.iter().map(|(_, grant)| grant))
        .any(takt_rt::Grant::is_refused)
}
