//! The report of an assembly: its steps, figures from the truth of the world, and the verdict.

use serde::Serialize;
use std::fmt::Write as _;
use takt_core::Controller;
use takt_embedded::world::Truth;
use takt_embedded::{Fault, Figures, Record};

use super::Log;
use super::program::Step;
use super::supervisor::{States, Supervised};
use crate::Verdict;
use crate::demo::{time_line, time_waited_ms};

/// Largest internal force of a box, N; and where an arm or a process is lost while both arms carry it.
const INTERNAL: f64 = 15.0;
const INTERNAL_LOST: f64 = 48.0;
/// Largest change of the distance of the hands, mm.
const GRASP: f64 = 0.2;
/// Largest force on the peg, N.
const PEG: f64 = 25.0;
/// Largest force at the flange of an arm, N: more than a box, a screw and their acceleration take.
const FLANGE: f64 = 60.0;
/// Least torque of the screw, Nm.
const TORQUE: f64 = 1.5;
/// From contact to the first set-point that brakes, ms.
const BRAKES_WITHIN: f64 = 20.0;
/// A held body is at rest below this speed, m/s.
const RESTS: f64 = 0.002;

/// The report.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    ok: bool,
    /// What speaks against it.
    faults: Vec<String>,
    seed: u64,
    /// Faults that were switched on.
    injected: Vec<String>,
    /// Why the program did not come to its end.
    error: Option<String>,
    /// What went wrong, and what was done about it.
    notes: Vec<&'static str>,
    /// Names of the steps, and how long each took, s.
    steps: Vec<(&'static str, f64)>,
    /// States of the machine that supervises it, and when each began, s.
    states: States,
    cycle_s: f64,
    internal_force_n_max: f64,
    grasp_distance_mm_max: f64,
    peg_force_n_max: f64,
    peg_depth_mm: f64,
    flange_force_n_max: f64,
    /// From contact of the peg with the bottom to the first set-point that brakes.
    contact_to_braking_ms: Option<f64>,
    screw_torque_nm_max: f64,
    screw_is_seated: bool,
    /// Boxes that stood still in the air.
    stops: usize,
    dropped: usize,
    /// Bodies in hands at the end.
    held: Vec<String>,
    /// How long simulated time waited for threads that the host ran late; `None` in real time.
    time_waited_ms: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    controller: Option<Cycles>,
}

/// Figures of the controller.
#[derive(Debug, Serialize)]
pub(super) struct Cycles {
    cycles: u64,
    overruns: u64,
    /// Longest time from the begin of a cycle until its net thread was woken: the host stalled so long.
    woken_late_ns_max: i64,
    rt_allocations: u64,
    /// Longest time between handing the set-points of one cycle to the first and to the last arm.
    sync_error_ns_max: i64,
}

impl Cycles {
    pub(super) fn of(controller: &Controller) -> Self {
        let stats = controller.stats();
        Self {
            cycles: stats.cycles,
            overruns: stats.overruns,
            woken_late_ns_max: stats.latency.max.0,
            rt_allocations: takt_rt::alloc::real_time_allocations(),
            sync_error_ns_max: controller.hand_over().max.0,
        }
    }
}

impl Report {
    pub(super) fn new(
        (seed, is_stopping): (u64, bool),
        injected: &[Fault],
        (ended, log): (Supervised, &Log),
        seen: &Record,
        truth: &Truth,
    ) -> Self {
        let figures = seen.figures(truth);
        let Supervised {
            steps,
            states,
            error,
        } = ended;
        let mut faults = judge(injected, error.as_deref(), &log.notes, &figures, truth);
        // Without blending, boxes stop in the air; so they do where a fault ends the assembly.
        if !is_stopping && error.is_none() && figures.stops > 0 {
            let stops = figures.stops;
            faults.push(format!("boxes stood still in the air {stops} times"));
        }
        let held = truth.bodies.iter().filter(|body| !body.held_by.is_empty());
        let seconds = |(number, step): (usize, &Step)| (step.name, log.took_s(number, step));
        let steps: Vec<_> = steps.iter().enumerate().map(seconds).collect();
        Self {
            ok: faults.is_empty(),
            faults,
            seed,
            injected: injected.iter().map(ToString::to_string).collect(),
            error,
            notes: log.notes.clone(),
            states,
            cycle_s: steps.iter().fold(0.0, |sum, (_, duration)| sum + duration),
            steps,
            internal_force_n_max: figures.internal_n,
            grasp_distance_mm_max: figures.grasp_mm,
            peg_force_n_max: figures.insertion_n,
            peg_depth_mm: figures.depth_mm,
            flange_force_n_max: figures.flange_n,
            contact_to_braking_ms: figures.detected_ms,
            screw_torque_nm_max: figures.torque_nm,
            screw_is_seated: figures.is_screwed,
            stops: figures.stops,
            dropped: figures.dropped,
            held: held.map(|body| body.name.clone()).collect(),
            time_waited_ms: time_waited_ms(),
            controller: None,
        }
    }

    /// Adds the figures of the controller.
    pub(super) fn take_controller(&mut self, cycles: Cycles) {
        let allocations = cycles.rt_allocations;
        if allocations > 0 {
            self.fail(format!("{allocations} allocations in real-time threads"));
        }
        self.controller = Some(cycles);
    }

    /// Adds what speaks against it.
    pub(super) fn fail(&mut self, fault: String) {
        self.faults.push(fault);
        self.ok = false;
    }

    pub(super) const fn verdict(&self) -> Verdict {
        if self.ok {
            Verdict::Good
        } else {
            Verdict::Failed
        }
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        if let Some(error) = &self.error {
            let error = error.replace('\n', "\n           ");
            let _ = writeln!(text, "ended      {error}");
        }
        if !self.states.is_empty() {
            let states = self.states.iter();
            let states: Vec<_> = states
                .map(|(name, at_s)| format!("{name} {at_s:.1} s"))
                .collect();
            let _ = writeln!(text, "states     {}", states.join(", "));
        }
        if self.error.is_none() {
            let _ = writeln!(text, "cycle time {:.1} s", self.cycle_s);
        }
        let _ = writeln!(
            text,
            "arms       force at a flange at most {:.1} N\nboxes      internal force at most {:.1} N, distance of the hands within {:.2} mm, {} \
             stops in the air",
            self.flange_force_n_max,
            self.internal_force_n_max,
            self.grasp_distance_mm_max,
            self.stops
        );
        if self.peg_force_n_max > 0.0 {
            let braking = self.contact_to_braking_ms;
            let braking = braking.map_or_else(String::new, |ms| {
                format!(", the arm brakes {ms:.0} ms after contact with the bottom")
            });
            let _ = writeln!(
                text,
                "peg        {:.1} mm deep, force at most {:.1} N{braking}",
                self.peg_depth_mm, self.peg_force_n_max
            );
        }
        if self.screw_torque_nm_max > 0.0 {
            let seated = if self.screw_is_seated {
                "seated"
            } else {
                "not seated"
            };
            let torque = self.screw_torque_nm_max;
            let _ = writeln!(text, "screw      {seated}, torque at most {torque:.2} Nm");
        }
        let held = if self.held.is_empty() {
            String::new()
        } else {
            format!("; the hands hold {}", self.held.join(", "))
        };
        let _ = writeln!(text, "parts      {} dropped{held}", self.dropped);
        text += &time_line(self.time_waited_ms);
        if let Some(controller) = &self.controller {
            let _ = writeln!(
                text,
                "cycle      2 ms, {} cycles, {} overruns, woken at most {} late; both arms had each set-point within {}\nallocations \
                 in real-time threads: {}",
                controller.cycles,
                controller.overruns,
                crate::output::time(controller.woken_late_ns_max),
                crate::output::time(controller.sync_error_ns_max),
                controller.rt_allocations
            );
        }
        for fault in &self.faults {
            let fault = fault.replace('\n', "\n           ");
            let _ = writeln!(text, "FAULT      {fault}");
        }
        text + if self.ok { "OK\n" } else { "FAILED\n" }
    }
}

/// Forces and losses, which no fault excuses.
fn judge_handling(is_outside: bool, figures: &Figures, check: &mut impl FnMut(bool, String)) {
    let most = if is_outside { INTERNAL_LOST } else { INTERNAL };
    check(
        figures.internal_n <= most,
        format!(
            "internal force of {:.1} N, more than {most} N",
            figures.internal_n
        ),
    );
    check(
        is_outside || figures.flange_n <= FLANGE,
        format!(
            "{:.1} N at the flange of an arm, more than {FLANGE} N",
            figures.flange_n
        ),
    );
    check(
        figures.dropped == 0,
        format!("{} parts dropped", figures.dropped),
    );
}

/// What is not as it is to be.
fn judge(
    injected: &[Fault],
    error: Option<&str>,
    notes: &[&str],
    figures: &Figures,
    truth: &Truth,
) -> Vec<String> {
    let mut faults = Vec::new();
    let mut check = |is_good: bool, text: String| {
        if !is_good {
            faults.push(text);
        }
    };
    let ends_it = injected.iter().find(|fault| !fault.is_overcome());
    let is_outside = injected.iter().any(|fault| fault.is_outside());
    judge_handling(is_outside, figures, &mut check);
    if is_outside {
        let mut boxes = truth.bodies.iter().filter(|body| body.held_by.len() == 2);
        let rests = boxes.any(|body| body.twist.linear.norm() < RESTS);
        check(rests, "no box is held at rest by both hands".to_owned());
    }
    if let Some(fault) = ends_it {
        let is_named = error.is_some_and(|error| error.contains(fault.named_by()));
        let ended = error.map_or("it ended well", |error| error);
        check(
            is_named,
            format!("`{fault}` was switched on, and the program did not name it: {ended}"),
        );
        return faults;
    }
    if let Some(error) = error {
        check(false, error.to_owned());
        return faults;
    }
    let fewer = injected.len().saturating_sub(notes.len());
    check(
        fewer == 0,
        format!("{fewer} faults were switched on and not noticed"),
    );
    check(
        figures.grasp_mm <= GRASP,
        format!(
            "the distance of the hands changed by {:.2} mm, more than {GRASP} mm",
            figures.grasp_mm
        ),
    );
    check(
        figures.insertion_n <= PEG,
        format!("{:.1} N on the peg, more than {PEG} N", figures.insertion_n),
    );
    check(
        figures.detected_ms.is_some_and(|ms| ms <= BRAKES_WITHIN),
        format!("the arm did not brake within {BRAKES_WITHIN} ms of contact"),
    );
    check(
        figures.is_screwed && figures.torque_nm >= TORQUE,
        format!(
            "the screw is not seated with {TORQUE} Nm: {:.2} Nm",
            figures.torque_nm
        ),
    );
    faults
}
