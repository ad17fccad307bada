//! Runs along a path that is fixed at load time: from its start to its end, slower on demand, and
//! to a stop on the path. Its owner knows the path.

use takt_net::definition::{Port, port};
use takt_net::{Build, Cycle, Definition, Fault, In, Out};

use super::profile::{Bounds, Profile};

/// Override below which a motion holds.
const HOLD_BELOW: f64 = 0.001;

const OVERRIDE: Port = port(
    "inOverride",
    "part of the velocity limit to run at, 0 to 1; below 0.001, null or not a number: holds",
)
.or("Override", "1");

/// The target of the profile.
#[derive(Clone, Copy, PartialEq)]
enum Aim {
    /// The end of the path, at this part of the velocity limit.
    End(f64),
    /// Standstill, to continue later.
    Hold,
    /// Standstill for good.
    Stop,
}

/// The state on the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Progress {
    /// Part of the path, 0 to 1.
    pub(super) part: f64,
    /// Its rate, 1/s.
    pub(super) rate: f64,
    /// Whether the motion is over.
    pub(super) is_done: bool,
}

/// A motion along a path.
pub(super) struct Runner {
    profile: Profile,
    length: f64,
    aim: Aim,
    has_started: bool,
    is_stopped: bool,
    speed: In<f64>,
    stop: In<bool>,
    reset: In<bool>,
    progress: Out<f64>,
    done: Out<bool>,
}

/// Adds the ports common to all motions.
pub(super) fn with_ports(definition: Definition) -> Definition {
    // A changed override or a stop is planned for within the cycle in which it arrives.
    definition
        .cost_ns(15_000)
        .stateful()
        .input::<f64>(OVERRIDE)
        .input::<bool>(port(
            "inStop",
            "true ends the motion: it brakes on its path and stays at rest until inReset",
        ))
        .output::<f64>("outProgress", "completed part of the path, 0 to 1")
        .output::<bool>("outDone", "at rest at the end, or stopped")
}

impl Runner {
    /// A runner on a path of that length (in the unit of the bounds, at most the largest of the
    /// lengths from which the bounds are derived).
    pub(super) fn new(b: &mut Build<'_, '_>, length: f64, bounds: Bounds) -> Result<Self, Fault> {
        let mut profile = Profile::new(0.0, bounds, b.period_s()).forward_only();
        if !profile.go_to(length, 1.0) {
            let why = "no motion keeps these limits: their magnitudes differ too much".to_owned();
            return Err(b.parameter_fault(super::VELOCITY, why));
        }
        Ok(Self {
            profile,
            length,
            aim: Aim::End(1.0),
            has_started: false,
            is_stopped: false,
            speed: b.input("inOverride")?,
            stop: b.input("inStop")?,
            reset: b.input("inReset")?,
            progress: b.output("outProgress"),
            done: b.output("outDone"),
        })
    }

    /// One cycle: reads the inputs and writes the outputs common to all motions.
    pub(super) fn step(&mut self, cycle: &Cycle<'_>) -> Progress {
        if self.reset.get(cycle) == Some(true) {
            self.restart();
        }
        self.is_stopped |= self.stop.get(cycle) == Some(true);
        let speed = self.speed.get(cycle).unwrap_or(0.0);
        self.aim_at(speed);
        if self.has_started {
            self.profile.advance();
        }
        self.has_started = true;
        let progress = self.progress();
        self.progress.set(cycle, progress.part);
        self.done.set(cycle, progress.is_done);
        progress
    }

    fn restart(&mut self) {
        self.profile.reset(0.0);
        self.aim = Aim::Hold;
        self.has_started = false;
        self.is_stopped = false;
    }

    /// Replans if the target has changed.
    fn aim_at(&mut self, speed: f64) {
        let wanted = if self.is_stopped {
            Aim::Stop
        } else if speed >= HOLD_BELOW {
            Aim::End(speed.min(1.0))
        } else {
            Aim::Hold
        };
        if wanted == self.aim || self.is_at_end() {
            return;
        }
        let is_planned = match wanted {
            Aim::End(speed) => self.profile.go_to(self.length, speed),
            Aim::Hold | Aim::Stop => self.profile.is_at_rest() || self.profile.brake(),
        };
        if is_planned {
            self.aim = wanted;
        }
    }

    fn is_at_end(&self) -> bool {
        self.profile.is_at_rest() && self.profile.now().position >= self.length
    }

    fn progress(&self) -> Progress {
        let now = self.profile.now();
        let is_over = self.is_at_end() || self.aim == Aim::Stop;
        // A path without length is completed as soon as it begins.
        let (part, rate) = if self.length > 0.0 {
            // Rounding must not lead beyond the ends.
            let part = (now.position / self.length).clamp(0.0, 1.0);
            (part, now.velocity / self.length)
        } else {
            (1.0, 0.0)
        };
        Progress {
            part,
            rate,
            is_done: is_over && self.profile.is_at_rest(),
        }
    }
}
