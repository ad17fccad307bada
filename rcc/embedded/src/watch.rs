//! Watches the world of an assembly while a program works in it: samples over time, and figures from the truth. It changes
//! nothing in the world.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use takt_core::Controller;
use takt_core::probe::{Scope, ScopeError, ScopeEvent, ScopeRequest};
use takt_world::{EventKind, Truth, World};

use crate::faults::carried;

/// Between two samples of the truth.
const EVERY: Duration = Duration::from_millis(20);
/// An arm brakes below this part of its speed at contact: more than the curvature of a path changes it.
const BRAKES: f64 = 0.97;
/// For as many cycles.
const BRAKING: usize = 3;
/// Joints of the arm whose set-points are watched.
const JOINTS: usize = 7;
/// Most samples of each kind; an assembly takes a third of that.
const SAMPLES_MAX: usize = 100_000;
/// A carried body is at rest below this speed, m/s.
const RESTS: f64 = 0.002;
/// A peg is at its hole this near to the axis, m.
pub(crate) const AT_HOLE: f64 = 0.005;
/// Height of the middle of a box above which it is in motion, m.
pub(crate) const CARRIED: f64 = 0.16;

/// A moment of an assembly.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moment {
    /// On the clock of the world, s.
    pub at_s: f64,
    /// Forces at the flanges of both arms, N.
    pub flanges_n: [f64; 2],
    /// Internal force of the box that two hands hold, N.
    pub internal_n: f64,
    /// Deviation of the distance of the hands from that at their grasp, mm; NaN unless both hold one box.
    pub grasp_mm: f64,
    /// Force on the peg out of its hole, N.
    pub peg_n: f64,
    /// Of the peg in its hole, mm; NaN outside of it.
    pub depth_mm: f64,
    /// Torque of the screw, Nm.
    pub torque_nm: f64,
}

/// What was seen.
#[derive(Debug, Default)]
pub struct Record {
    /// Over time.
    pub moments: Vec<Moment>,
    /// Set-points of the inserting arm in the cycles of the controller: begin of the cycle, s, and joints, rad.
    set_points: Vec<(f64, [f64; JOINTS])>,
    /// Times at which a box stood still in the air, s.
    pub stops: Vec<f64>,
    distance: Option<f64>,
    moved: bool,
}

/// Figures of an assembly, from the truth of its world.
#[derive(Clone, Debug, PartialEq)]
pub struct Figures {
    /// Largest internal force of a box, N.
    pub internal_n: f64,
    /// Largest change of the distance of the hands while they held a box, mm.
    pub grasp_mm: f64,
    /// From the peg's first touch of the bottom to the controller's first set-point that brakes its arm, ms; `None` if it did not brake.
    pub detected_ms: Option<f64>,
    /// Largest force on the peg, N.
    pub insertion_n: f64,
    /// Depth of the peg in its hole, mm.
    pub depth_mm: f64,
    /// Largest torque of the screw, Nm.
    pub torque_nm: f64,
    /// Whether the screw is seated.
    pub is_screwed: bool,
    /// Boxes that stood still in the air.
    pub stops: usize,
    /// Largest force at the flange of an arm, N.
    pub flange_n: f64,
    /// Bodies that fell or slid out of fingers.
    pub dropped: usize,
}

/// A scope over the set-points of an arm, for [`watch`].
///
/// # Errors
/// If the controller has no such arm.
pub fn set_points(controller: &Controller, arm: &str) -> Result<Scope, ScopeError> {
    let probes: [String; JOINTS] =
        std::array::from_fn(|joint| format!("{arm}.joint.{joint}.set_point"));
    let probes = probes.to_vec();
    controller.scope(&ScopeRequest {
        probes,
        ..ScopeRequest::default()
    })
}

/// Runs `work`, and watches the world and the set-points of the arm that inserts meanwhile; `each` receives every truth.
pub fn watch<T>(
    world: &World,
    mut inserts: Scope,
    work: impl FnOnce() -> T,
    mut each: impl FnMut(&Truth) + Send,
) -> (T, Record) {
    let ends = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            let mut record = Record::default();
            while !ends.load(Ordering::Relaxed) {
                record.take_set_points(&mut inserts);
                let truth = world.truth();
                record.take(&truth);
                each(&truth);
                std::thread::sleep(EVERY);
            }
            record
        });
        let done = work();
        ends.store(true, Ordering::Relaxed);
        (done, watcher.join().unwrap_or_default())
    })
}

impl Record {
    fn take_set_points(&mut self, scope: &mut Scope) {
        scope.read(takt_rt::monotonic().try_into().unwrap_or_default());
        while let Some(event) = scope.poll_event() {
            let ScopeEvent::Frame(frame) = event else {
                continue;
            };
            let epoch = scope.epoch(frame.group).unwrap_or_default().as_secs_f64();
            let room = SAMPLES_MAX.saturating_sub(self.set_points.len());
            let rows = frame.iter().filter_map(|(at, joints)| {
                let joints: [f64; JOINTS] = joints.try_into().ok()?;
                joints
                    .iter()
                    .all(|it| it.is_finite())
                    .then_some((epoch + at, joints))
            });
            self.set_points.extend(rows.take(room));
        }
    }

    fn take(&mut self, truth: &Truth) {
        let Some(at) = truth.at.filter(|_| self.moments.len() < SAMPLES_MAX) else {
            return;
        };
        let carried = carried(truth);
        let place = |hand: &str| {
            let hand = truth.hand(hand)?;
            Some(hand.flange?.translation.vector)
        };
        let distance = place("left")
            .zip(place("right"))
            .map(|(a, b)| (a - b).norm());
        let distance = distance.filter(|_| carried.is_some());
        let first = distance.map(|now| *self.distance.get_or_insert(now));
        if carried.is_none() {
            (self.distance, self.moved) = (None, false);
        }
        let at_s = at.as_secs_f64();
        if let Some(body) = carried.filter(|body| body.pose.translation.z > CARRIED) {
            let rests = body.twist.linear.norm() < RESTS;
            if rests && self.moved {
                self.stops.push(at_s);
            }
            self.moved = !rests;
        }
        let peg = truth.pegs.first();
        let force = |hand: &str| truth.hand(hand).map(|hand| hand.wrench.force);
        let at_right = force("right").zip(force("driver")).map(|(a, b)| a + b);
        let forces = [force("left"), at_right];
        self.moments.push(Moment {
            at_s,
            flanges_n: forces.map(|force| force.map_or(0.0, |force| force.norm())),
            internal_n: carried.map_or(0.0, |body| body.internal_force_n),
            grasp_mm: distance
                .zip(first)
                .map_or(f64::NAN, |(now, first)| (now - first) * 1e3),
            peg_n: peg.map_or(0.0, |peg| peg.force_n),
            depth_mm: peg.map_or(f64::NAN, |peg| {
                if peg.depth_m > 0.0 && peg.offset_m < AT_HOLE {
                    peg.depth_m * 1e3
                } else {
                    f64::NAN
                }
            }),
            torque_nm: truth.screws.first().map_or(0.0, |screw| screw.torque_nm),
        });
    }

    /// Figures, with the truth at the end.
    pub fn figures(&self, truth: &Truth) -> Figures {
        let held = truth.bodies.iter().filter_map(|body| body.grasp_distance_m);
        let fell =
            |kind: &EventKind| matches!(kind, EventKind::Dropped { .. } | EventKind::Lost { .. });
        let (peg, screw) = (truth.pegs.first(), truth.screws.first());
        Figures {
            internal_n: truth
                .bodies
                .iter()
                .fold(0.0, |most, body| body.internal_force_max_n.max(most)),
            grasp_mm: held.fold(0.0, |most: f64, [least, greatest]| {
                most.max((greatest - least) * 1e3)
            }),
            detected_ms: self.detected(truth),
            insertion_n: peg.map_or(0.0, |peg| peg.force_max_n),
            depth_mm: peg
                .filter(|peg| peg.offset_m < AT_HOLE)
                .map_or(0.0, |peg| peg.depth_m * 1e3),
            torque_nm: screw.map_or(0.0, |screw| screw.torque_max_nm),
            is_screwed: screw.is_some_and(|screw| screw.is_seated && !screw.is_cross_threaded),
            stops: self.stops.len(),
            flange_n: truth
                .hands
                .iter()
                .fold(0.0, |most, hand| hand.force_max_n.max(most)),
            dropped: truth
                .events
                .iter()
                .filter(|event| fell(&event.kind))
                .count(),
        }
    }

    /// From the first touch of the bottom to the first set-point that brakes, ms.
    fn detected(&self, truth: &Truth) -> Option<f64> {
        let seated = truth.first(|event| matches!(event.kind, EventKind::Seated { .. }))?;
        let seated = seated.at.as_secs_f64();
        let speeds = self.set_points.array_windows().map(|[(from, a), (to, b)]| {
            let way = a
                .iter()
                .zip(b)
                .map(|(a, b)| (a - b).powi(2))
                .sum::<f64>()
                .sqrt();
            (*to, way / (to - from).max(1e-6))
        });
        let speeds: Vec<_> = speeds.collect();
        let before = speeds.iter().rev().find(|(at, _)| *at < seated)?.1;
        let brakes = speeds.windows(BRAKING).find(|window| {
            let slow = |(at, speed): &(f64, f64)| *at >= seated && *speed < before * BRAKES;
            window.iter().all(slow)
        })?;
        Some((brakes.first()?.0 - seated) * 1e3)
    }
}
