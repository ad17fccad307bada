//! Emulated arms that note what they receive in each of their cycles: how much of their limits it takes, and whether
//! they rest. A test switches their faults.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use serde::Deserialize;
use takt_core::CellConfig;
use takt_core::Error;
use takt_core::cell::{DriverKind, Section};
use takt_core::device::driver::{DeviceDriver, DriverConfig, DriverEnds, DriverThread};
use takt_core::device::endpoint::Endpoint;
use takt_core::device::setpoint::Joint;
use takt_core::device::{ArmDescription, DeviceDescription, DeviceStatus};
use takt_net::JointLimits;
use takt_rt::cycle::Cycles;
use takt_rt::stats;

const DRIVERS: &[DriverKind] = &[DriverKind::new::<Config>(Section::Bus("watched"))];
const CYCLE: Duration = Duration::from_millis(1);
const JOINTS: usize = 7;

/// Narrow, so that motions of a tenth of a radian reach them.
const LIMITS: JointLimits = JointLimits {
    position_min: -2.9,
    position_max: 2.9,
    velocity_max: 0.5,
    acceleration_max: 8.0,
};

/// A joint slower than this is at rest, rad/s.
const RESTING: f64 = 1e-6;
/// An arm with a joint faster than this moves, rad/s: more than the first set-point of a motion, a few nanoradians away, which is
/// held until its time.
const MOVING: f64 = 1e-3;

/// The arms of all cells of this process, by the names of their drivers.
static ALL: Mutex<BTreeMap<String, Arc<[Watched]>>> = Mutex::new(BTreeMap::new());

/// What an arm received.
#[derive(Debug, Default)]
pub(crate) struct Watched {
    is_faulty: AtomicBool,
    is_resting: AtomicBool,
    /// The largest share of the limits, in millionths.
    velocity: AtomicU64,
    acceleration: AtomicU64,
    cycles: AtomicU64,
    /// How often it came to rest after it had moved.
    rests: AtomicU64,
}

impl Watched {
    /// Switches a fault on or off: the arm brakes by itself and follows no commands.
    pub(crate) fn set_faulty(&self, is_faulty: bool) {
        self.is_faulty.store(is_faulty, Ordering::Relaxed);
    }

    pub(crate) fn is_resting(&self) -> bool {
        self.is_resting.load(Ordering::Acquire)
    }

    /// The largest shares of the limits of velocity and acceleration in what it received so far.
    pub(crate) fn shares(&self) -> [f64; 2] {
        [&self.velocity, &self.acceleration]
            .map(|share| share.load(Ordering::Relaxed) as f64 * 1e-6)
    }

    /// How often it came to rest after it had moved.
    pub(crate) fn rests(&self) -> u64 {
        self.rests.load(Ordering::Relaxed)
    }

    /// How many cycles it received.
    pub(crate) fn cycles(&self) -> u64 {
        self.cycles.load(Ordering::Relaxed)
    }
}

/// A cell with so many of them, named `arm0`, `arm1`, …, and what they note.
pub(crate) fn cell(arms: usize) -> (CellConfig, Arc<[Watched]>) {
    let mut all = ALL.lock().unwrap_or_else(PoisonError::into_inner);
    let name = format!("watched{}", all.len());
    let watched: Arc<[Watched]> = (0..arms).map(|_| Watched::default()).collect();
    all.insert(name.clone(), Arc::clone(&watched));
    let text = format!("[[watched]]\nname = '{name}'\narms = {arms}\n");
    (CellConfig::parse(&text, DRIVERS).unwrap(), watched)
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    name: String,
    arms: usize,
}

/// One arm in its driver.
struct Arm {
    end: Endpoint,
    joints: [Joint; JOINTS],
    before: [[f64; 2]; JOINTS],
    /// Since its last rest.
    has_moved: bool,
}

impl Arm {
    /// One cycle: what the arm receives.
    fn cycle(&mut self, now: takt_rt::Nanos, watched: &Watched, is_stopping: bool) {
        self.end.take();
        let is_faulty = watched.is_faulty.load(Ordering::Relaxed);
        let fresh = !is_stopping && !is_faulty && self.end.is_fresh(now, CYCLE.into());
        let mut positions = [0.0; JOINTS];
        for (number, (joint, position)) in self.joints.iter_mut().zip(&mut positions).enumerate() {
            let set_points = &self.end.taken.joints[number];
            let play = now - joint.delay(set_points);
            *position = joint.sample(set_points, fresh, play, CYCLE.as_secs_f64());
        }
        self.note(&positions, watched);
        let status = if is_faulty {
            DeviceStatus::SafeOperational
        } else {
            DeviceStatus::Operational
        };
        self.end.reported.enter(status, now);
        let measured = positions.map(|position| [Some(position), None, None]);
        self.end.report_joints(self.joints.iter().zip(measured));
        self.end.publish();
    }

    /// Velocity and acceleration by differences of what it received.
    fn note(&mut self, positions: &[f64; JOINTS], watched: &Watched) {
        let cycle_s = CYCLE.as_secs_f64();
        let mut is_resting = true;
        for (before, position) in self.before.iter_mut().zip(positions) {
            let velocity = (position - before[0]) / cycle_s;
            let acceleration = (velocity - before[1]) / cycle_s;
            *before = [*position, velocity];
            is_resting &= velocity.abs() < RESTING;
            self.has_moved |= velocity.abs() > MOVING;
            raise(&watched.velocity, velocity / LIMITS.velocity_max);
            raise(
                &watched.acceleration,
                acceleration / LIMITS.acceleration_max,
            );
        }
        // Who sees it at rest sees that rest counted.
        if is_resting && std::mem::take(&mut self.has_moved) {
            watched.rests.fetch_add(1, Ordering::Relaxed);
        }
        watched.is_resting.store(is_resting, Ordering::Release);
        watched.cycles.fetch_add(1, Ordering::Relaxed);
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share in millionths, without sign"
)]
fn raise(highest: &AtomicU64, share: f64) {
    highest.fetch_max((share.abs() * 1e6) as u64, Ordering::Relaxed);
}

impl DriverConfig for Config {
    fn name(&self) -> &str {
        &self.name
    }

    fn priority(&self) -> Option<u8> {
        Some(85)
    }

    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    fn devices(&self) -> Vec<DeviceDescription> {
        let arm = |number| ArmDescription {
            name: format!("arm{number}"),
            kind: "watched",
            limits: vec![LIMITS; JOINTS],
            model: "kuka_lwr4".into(),
        };
        (0..self.arms).map(|number| arm(number).with(&[])).collect()
    }

    fn start(&self, ends: DriverEnds) -> Result<Box<dyn DeviceDriver>, Error> {
        let all = ALL.lock().unwrap_or_else(PoisonError::into_inner);
        let watched = Arc::clone(&all[&self.name]);
        drop(all);
        let arm = |end| Arm {
            end: Endpoint::new(end, &[], JOINTS),
            joints: [Joint::new(LIMITS); JOINTS],
            before: [[0.0; 2]; JOINTS],
            has_moved: false,
        };
        let mut arms: Vec<_> = ends.devices.into_iter().map(arm).collect();
        let clock = ends.clock;
        let (mut recorder, _) = stats::pair();
        let thread = DriverThread::start(&self.name, self.priority(), &[], move |stopping| {
            Cycles::every(CYCLE).run(&mut recorder, |tick| {
                let is_stopping = stopping.load(Ordering::Relaxed);
                for (arm, watched) in arms.iter_mut().zip(&*watched) {
                    arm.cycle(tick.scheduled, watched, is_stopping);
                }
                if is_stopping && watched.iter().all(Watched::is_resting) {
                    return ControlFlow::Break(());
                }
                ControlFlow::Continue(())
            });
            clock
        })?;
        Ok(Box::new(thread))
    }
}
