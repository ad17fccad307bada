//! The report of a demo: the figures of the cycle, of each robot, and the verdict.

use serde::Serialize;
use takt_core::Controller;
use takt_rt::host::Host;
use takt_rt::stats::Summary;

use crate::demo::ROBOTS;
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
    /// How far the farthest joint moved, rad.
    moved_rad_max: f64,
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
    /// How far cycles of nets began from their places on the first robot's clock, while it was known.
    phase_error_ns: Quantiles,
    /// In how many cycles it was.
    phase_known: u64,
    rt_allocations: u64,
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
        robots: &[Robot],
        moved: &[f64],
        end: Option<String>,
    ) -> Self {
        let stats = controller.stats();
        let rt_allocations = takt_rt::alloc::real_time_allocations();
        let drivers = controller.with_arms(|arm| {
            (
                arm.figures(),
                arm.answer_time.read().summary(),
                arm.set_point_age.read().summary(),
            )
        });
        let mut reports = Vec::new();
        for (i, (figures, answer, age)) in drivers.into_iter().enumerate() {
            let missed = robots
                .get(i)
                .map_or(0, |robot| u64::from(robot.status.missed()));
            reports.push(RobotReport {
                name: ROBOTS[i].to_owned(),
                protocol: "fri1",
                period_ns: figures
                    .period
                    .map_or(0, |p| p.as_nanos().try_into().unwrap_or(0)),
                datagrams: figures.datagrams,
                lost: figures.lost + missed,
                quality: format!("{:?}", figures.quality).to_uppercase(),
                tracking_error_rad_max: figures.tracking_error_rad_max,
                answer_ns: answer.into(),
                set_point_age_ns: age.into(),
                moved_rad_max: moved.get(i).copied().unwrap_or(0.0),
            });
        }
        let mut faults: Vec<String> = end.into_iter().collect();
        if rt_allocations > 0 {
            faults.push(format!("{rt_allocations} allocations in real-time threads"));
        }
        for (robot, name) in robots.iter().zip(ROBOTS) {
            if let Some(why) = robot.status.last_fall() {
                faults.push(format!("{name} left command mode: {why}"));
            }
        }
        for robot in reports.iter().filter(|r| r.moved_rad_max < 0.01) {
            faults.push(format!("{} did not move", robot.name));
        }
        Self {
            ok: faults.is_empty(),
            faults,
            cycles: stats.cycles,
            overruns: stats.overruns,
            latency_ns: stats.latency.into(),
            execution_ns: stats.execution.into(),
            phase_error_ns: stats.phase_error.into(),
            phase_known: stats.phase_error.count,
            rt_allocations,
            realtime: is_real_time(controller, host),
            preempt_rt: host.is_preempt_rt(),
            robots: reports,
            sync_error_ns_max: controller.hand_over().max.0,
        }
    }

    /// The report for people.
    pub(super) fn text(&self) -> String {
        let q = |q: Quantiles| {
            let [p50, p99, p999, max] = [q.p50, q.p99, q.p999, q.max].map(time);
            format!("p50 {p50}  p99 {p99}  p99.9 {p999}  max {max}")
        };
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
            q(self.latency_ns),
            q(self.execution_ns),
            q(self.phase_error_ns),
            ROBOTS[0],
            self.phase_known
        );
        for robot in &self.robots {
            text += &format!(
                "{:<10} {} every {}, {} datagrams, {} lost, quality {}\n           \
                 moved {:.2} rad, tracking error at most {:.4} rad\n           \
                 answer     {}\n",
                robot.name,
                robot.protocol,
                time(robot.period_ns.cast_signed()),
                robot.datagrams,
                robot.lost,
                robot.quality,
                robot.moved_rad_max,
                robot.tracking_error_rad_max,
                q(robot.answer_ns),
            );
        }
        text += &format!(
            "sync       both arms had each set-point within {}\nallocations in real-time threads: {}\n",
            time(self.sync_error_ns_max),
            self.rt_allocations
        );
        for fault in &self.faults {
            text += &format!("FAULT      {fault}\n");
        }
        text + if self.ok { "OK\n" } else { "FAILED\n" }
    }
}

/// Whether nothing was refused that real-time threads ask for. The kernel is told apart.
fn is_real_time(controller: &Controller, host: &Host) -> bool {
    let threads = controller.grants();
    let kernel = |grant: &&takt_rt::Grant| grant.what == takt_rt::host::KERNEL;
    let refused = host.grants().iter().filter(|grant| !kernel(grant));
    !refused
        .chain(threads.iter().map(|(_, grant)| grant))
        .any(takt_rt::Grant::is_refused)
}
