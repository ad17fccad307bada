//! Ports of a motion along a path that is fixed at load time: its controls and its progress.

use takt_net::definition::{Port, port};
use takt_net::{Build, Cycle, Definition, Fault, In, Out};

use super::bounds::Bounds;
use super::course::{Course, Progress};
use super::with_speed;

pub(super) const OVERRIDE: Port = port(
    "inOverride",
    "part of the velocity limit to run at, 0 to 1; below 0.001, null or not a number: holds",
)
.or("Override", "1");

/// Cost of the first cycle of a motion that begins in motion, in array elements: it tries several speeds.
const BEGINNING: usize = 4_500;

/// A motion along a path.
pub(super) struct Runner {
    pub(super) course: Course,
    speed: In<f64>,
    stop: In<bool>,
    reset: In<bool>,
    progress: Out<f64>,
    done: Out<bool>,
    on_path: Out<bool>,
}

/// Adds the ports common to all motions.
pub(super) fn with_ports(definition: Definition) -> Definition {
    // A changed override or a stop is planned for within the cycle in which it arrives.
    with_speed(definition)
        .cost_ns(15_000)
        .stateful()
        .input::<f64>(OVERRIDE)
        .input::<bool>(port(
            "inStop",
            "true ends the motion: it brakes on its path and stays at rest until inReset",
        ))
        .output::<f64>("outProgress", "completed part of the path, 0 to 1")
        .output::<bool>("outDone", "at rest at the end, or stopped")
        .output::<bool>(
            "outOnPath",
            "on the path; false while a motion that begins beside it, or not along it, joins it",
        )
}

impl Runner {
    /// A runner on a path with that length and these bounds along it, at a part of the speed; with `axes`, it may begin beside
    /// the path.
    pub(super) fn new(
        b: &mut Build<'_, '_>,
        along: (f64, Bounds),
        speed: f64,
        axes: Option<usize>,
    ) -> Result<Self, Fault> {
        let period_s = b.period_s();
        let Some(course) = Course::new(along, speed, period_s) else {
            let why = "no motion keeps these limits: their magnitudes differ too much".to_owned();
            return Err(b.parameter_fault(super::VELOCITY, why));
        };
        let course = match axes {
            Some(axes) => {
                b.adds_elements(BEGINNING);
                course.with_lead(axes, period_s)
            }
            None => course,
        };
        Ok(Self {
            course,
            speed: b.input("inOverride")?,
            stop: b.input("inStop")?,
            reset: b.input("inReset")?,
            progress: b.output("outProgress"),
            done: b.output("outDone"),
            on_path: b.output("outOnPath"),
        })
    }

    /// The override of this cycle, and whether the motion begins in it.
    pub(super) fn begins(&mut self, cycle: &Cycle<'_>) -> Option<f64> {
        if self.reset.get(cycle) == Some(true) {
            self.course.restart();
        }
        let speed = self.speed.get(cycle).unwrap_or(0.0);
        (!self.course.has_started()).then_some(speed)
    }

    /// A cycle without a motion: it has not begun.
    pub(super) fn wait(&self, cycle: &Cycle<'_>) {
        self.progress.set(cycle, None);
        self.done.set(cycle, false);
        self.on_path.set(cycle, false);
    }

    /// One cycle: reads the inputs and writes the outputs common to all motions.
    pub(super) fn step(&mut self, cycle: &Cycle<'_>) -> Progress {
        let stop = self.stop.get(cycle) == Some(true);
        let progress = self.course.step(self.speed.get(cycle).unwrap_or(0.0), stop);
        self.progress.set(cycle, progress.part.clamp(0.0, 1.0));
        self.done.set(cycle, progress.is_done);
        self.on_path.set(cycle, self.course.is_on_path());
        progress
    }
}
