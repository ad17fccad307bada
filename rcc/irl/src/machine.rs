//! The interpreter: executes object code in cycles of a real-time thread. Each cycle does bounded work, whatever the
//! program is; a program that does more in a cycle goes on in the next one. After [`Machine::new`], nothing allocates.
//! What the joints do with set-points is not known here.

mod robot;
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "an instruction that an arm does not name is a fault of the program"
)]
mod step;

use std::sync::Arc;
use std::time::Duration;

use takt_motion::plan::{PlanError, State};
use takt_net::device::Kinematics;

use crate::builtin;
use crate::code::{Location, Program, Scalar};
use robot::Robot;

/// Words of the record of a robot in memory.
pub(crate) const RECORD_WORDS: u32 = 35;
/// Word of `r_joint_act` in it.
const JOINT_ACT: usize = 21;
/// Word of `r_pose_act` in it.
const POSE_ACT: usize = 28;
/// Joints in a record.
pub(crate) const MAIN_JOINTS: usize = 7;

/// Most breakpoints of a program.
pub const BREAKPOINTS_MAX: usize = 16;

/// Upper bound on the cost of one step, ns, on a present-day host; heavier instructions count as several steps.
pub const STEP_COST_NS: u32 = 50;

/// Why a program failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[repr(i32)]
pub enum FaultKind {
    /// `div`, `mod` or `/` by 0.
    #[error("division by zero")]
    DivisionByZero = 1,
    /// A whole number beyond ±2147483647.
    #[error("a whole number is beyond its range")]
    Overflow = 2,
    /// A real number that is not finite, or a function outside its domain.
    #[error(
        "the result is not a number: the function is not defined there, or an axis was not given"
    )]
    NotANumber = 3,
    /// An index outside its array.
    #[error("an index is outside its array")]
    Index = 4,
    /// A function reached its end without `return`.
    #[error("the function ended without `return`")]
    NoResult = 5,
    /// An attribute out of its range.
    #[error("an attribute of the motion is out of its range")]
    Attribute = 6,
    /// A target with too few or too many joints.
    #[error("the target does not have as many joints as the robot")]
    JointCount = 7,
    /// A joint beyond its limits.
    #[error("the target is beyond a joint limit")]
    JointLimit = 8,
    /// A frame that the robot cannot reach.
    #[error("the robot cannot reach a point of the path")]
    Unreachable = 9,
    /// An arc through points on one line.
    #[error("no path leads through these points: they are on one line, or two of them are one")]
    NoPath = 10,
    /// A joint would be faster than its limit on this path.
    #[error("a joint would exceed its speed on this path: it is too near a singularity")]
    JointSpeed = 11,
    /// Two branches that move one robot.
    #[error("another branch of `par` moves this robot")]
    SharedRobot = 12,
    /// An input without a value.
    #[error("the input has no value: its device does not report it")]
    NoInput = 13,
    /// The object code contradicts itself.
    #[error("the object code is invalid")]
    BadCode = 14,
    /// A whole number that the bits of a binary output cannot show.
    #[error("the value does not fit the bits of the output")]
    SignalRange = 15,
}

impl FaultKind {
    /// All of them; the position of each is its number less one.
    pub const ALL: [Self; 15] = [
        Self::DivisionByZero,
        Self::Overflow,
        Self::NotANumber,
        Self::Index,
        Self::NoResult,
        Self::Attribute,
        Self::JointCount,
        Self::JointLimit,
        Self::Unreachable,
        Self::NoPath,
        Self::JointSpeed,
        Self::SharedRobot,
        Self::NoInput,
        Self::BadCode,
        Self::SignalRange,
    ];

    /// What to do about it.
    #[must_use]
    pub const fn hint(self) -> &'static str {
        match self {
            Self::DivisionByZero => "compare the divisor with 0 before",
            Self::Overflow => "use real numbers, or limit the operands",
            Self::NotANumber => "check the operands, and that the target gives all joints",
            Self::Index => "compare the index with the bounds of the array before",
            Self::NoResult => "end each path of the function with `return`",
            Self::Attribute => "docs/irl.md has the range of each attribute",
            Self::JointCount => "give as many joints as the robot has",
            Self::JointLimit => {
                "move the target into the ranges of the system specification and of the device"
            }
            Self::Unreachable => "move the target nearer, or go there with `ptp`",
            Self::NoPath => "choose an auxiliary point beside the line of start and end",
            Self::JointSpeed => "lower `speed`, go around the singularity, or use `ptp`",
            Self::SharedRobot => "move the robot in one branch only, or let the others wait for it",
            Self::NoInput => "check the device of the signal, and that the signal is bound",
            Self::BadCode => "compile the source again",
            Self::SignalRange => {
                "limit the value, or give the signal more `bits` in the specification"
            }
        }
    }
}

/// Why and where a program failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The cause.
    pub kind: FaultKind,
    /// Where in the source text.
    pub at: Location,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}: {}", self.at.line, self.at.column, self.kind)
    }
}

/// What a program is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Phase {
    /// It runs.
    Running = 1,
    /// It waits at a `pause` statement, at a breakpoint or behind a step for permission to continue.
    Paused = 2,
    /// It has ended, and a robot still brakes.
    Ending = 3,
    /// It has ended, and all robots are at rest.
    Ended = 4,
    /// It has failed; robots brake or are at rest.
    Failed = 5,
}

/// Why there is no interpreter for a program.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MachineError {
    /// The robots are not those of the program.
    #[error("robot `{name}`: {why}")]
    Robot {
        /// The robot.
        name: String,
        /// The difference.
        why: String,
    },
    /// No motion is possible.
    #[error(transparent)]
    Motion(#[from] PlanError),
}

/// A branch of the program.
#[derive(Clone, Copy, Debug, Default)]
struct Thread {
    is_alive: bool,
    parent: usize,
    pc: u32,
    fp: usize,
    sp: usize,
    base: usize,
    calls: usize,
    /// When a wait ends, s.
    until: Option<f64>,
    /// Robots that it has moved, by bit.
    moved: u8,
    timed_out: bool,
    /// The line that it executes; 0 before the first one.
    line: u32,
}

/// Where a call returns to.
#[derive(Clone, Copy, Debug, Default)]
struct Return {
    pc: u32,
    fp: usize,
    line: u32,
}

/// Inputs of a cycle.
#[derive(Clone, Copy, Debug)]
pub struct Control {
    /// Part of the speed of motions, 0 to 1.
    pub speed: f64,
    /// Holds motions and the program.
    pub pause: bool,
    /// Goes on behind a `pause` statement, a breakpoint or a step.
    pub resume: bool,
    /// Goes on, and waits again before the next line of any branch.
    pub step: bool,
    /// Ends the program; robots brake on their paths.
    pub stop: bool,
}

impl Default for Control {
    fn default() -> Self {
        Self {
            speed: 1.0,
            pause: false,
            resume: false,
            step: false,
            stop: false,
        }
    }
}

/// A program that is being executed.
#[derive(Debug)]
pub struct Machine {
    program: Arc<Program>,
    memory: Box<[u64]>,
    threads: Box<[Thread]>,
    returns: Box<[Return]>,
    robots: Box<[Robot]>,
    inputs: Box<[Option<u64>]>,
    outputs: Box<[Option<u64>]>,
    steps: u32,
    period_s: f64,
    cycles: u64,
    phase: Phase,
    fault: Option<Fault>,
    location: Location,
    /// Lines before which it waits; 0 for none.
    breakpoints: [u32; BREAKPOINTS_MAX],
    /// Whether it waits before the next line.
    is_stepping: bool,
    /// The thread that is executed first in the next cycle.
    first: usize,
}

impl Machine {
    /// An interpreter for cycles of `period`, with at most `steps` steps in each; `arms` are the kinematics of the robots
    /// with the limits of their devices. Without one, that of the model is used.
    ///
    /// # Errors
    /// If a robot has other joints, or its model is not known.
    pub fn new(
        program: Arc<Program>,
        arms: &[Option<Arc<dyn Kinematics>>],
        period: Duration,
        steps: u32,
    ) -> Result<Self, MachineError> {
        let specified = program.system.robots.iter().enumerate();
        let robots = specified
            .map(|(i, robot)| {
                let arm = arms.get(i).cloned().flatten();
                Robot::new(robot, arm, period)
            })
            .collect::<Result<Box<[Robot]>, MachineError>>()?;
        let threads = program.threads as usize;
        let stack = program.stack as usize;
        let globals = program.globals as usize;
        let mut machine = Self {
            memory: vec![0; globals + stack * threads].into(),
            threads: vec![Thread::default(); threads].into(),
            returns: vec![Return::default(); threads * program.calls as usize].into(),
            robots,
            inputs: vec![None; program.system.signals.len()].into(),
            outputs: vec![None; program.system.signals.len()].into(),
            steps: steps.max(16),
            period_s: period.as_secs_f64(),
            cycles: 0,
            phase: Phase::Running,
            fault: None,
            location: Location::default(),
            breakpoints: [0; BREAKPOINTS_MAX],
            is_stepping: false,
            first: 0,
            program,
        };
        machine.restart();
        Ok(machine)
    }

    /// Puts the program to its beginning; robots stay where they are.
    pub fn restart(&mut self) {
        self.memory.fill(0);
        let globals = self.program.globals as usize;
        let stack = self.program.stack as usize;
        for (i, thread) in self.threads.iter_mut().enumerate() {
            let base = globals + i * stack;
            *thread = Thread {
                is_alive: i == 0,
                base,
                fp: base,
                sp: base,
                ..Thread::default()
            };
        }
        self.outputs.fill(None);
        self.phase = Phase::Running;
        self.fault = None;
        self.is_stepping = false;
        self.first = 0;
        self.cycles = 0;
    }

    /// Sets the lines, from 1, before which the program waits in place of those before; 0 is none, and of more than
    /// [`BREAKPOINTS_MAX`] the first count.
    pub fn set_breakpoints(&mut self, lines: impl IntoIterator<Item = u32>) {
        let mut lines = lines.into_iter();
        self.breakpoints.fill_with(|| lines.next().unwrap_or(0));
    }

    /// Sets where a robot is, at rest, rad; before the first cycle.
    pub fn place(&mut self, robot: usize, positions: &[f64]) {
        if let Some(robot) = self.robots.get_mut(robot) {
            robot.place(positions);
        }
    }

    /// The program.
    #[must_use]
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// What it is doing.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Why it failed.
    #[must_use]
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The statement that is executed, or was executed last.
    #[must_use]
    pub const fn location(&self) -> Location {
        self.location
    }

    /// Positions of a robot's joints after this cycle, rad.
    #[must_use]
    pub fn positions(&self, robot: usize) -> &[f64] {
        self.robots.get(robot).map_or(&[], Robot::positions)
    }

    /// Sets an input: true is 1, a real number its bits.
    pub fn set_input(&mut self, signal: usize, value: Option<u64>) {
        if let Some(input) = self.inputs.get_mut(signal) {
            *input = value;
        }
    }

    /// An output, in the form of inputs; `None` until the program has written it.
    #[must_use]
    pub fn output(&self, signal: usize) -> Option<u64> {
        self.outputs.get(signal).copied().flatten()
    }

    /// The value of a variable of the program, as a number.
    #[must_use]
    pub fn variable(&self, variable: usize) -> Option<f64> {
        let variable = self.program.variables.get(variable)?;
        let word = *self.memory.get(variable.at as usize)?;
        Some(match variable.scalar {
            Scalar::Real => f64::from_bits(word),
            Scalar::Int | Scalar::Bool => word.cast_signed() as f64,
        })
    }

    /// One cycle: motions go on, then the program.
    pub fn cycle(&mut self, control: Control) -> Phase {
        let has_ended = matches!(self.phase, Phase::Ending | Phase::Ended | Phase::Failed);
        let stop = control.stop || has_ended;
        let speed = if control.pause { 0.0 } else { control.speed };
        let speed = if speed.is_finite() {
            speed.clamp(0.0, 1.0)
        } else {
            0.0
        };
        for robot in &mut self.robots {
            if let Err(fault) = robot.cycle(speed, stop)
                && self.fault.is_none()
            {
                self.fault = Some(fault);
                self.phase = Phase::Failed;
            }
        }
        if control.stop && !has_ended {
            self.halt();
        }
        if control.resume || control.step {
            self.is_stepping = control.step;
            if self.phase == Phase::Paused {
                self.phase = Phase::Running;
            }
        }
        if self.phase == Phase::Running && !control.pause {
            self.write_records();
            self.execute();
            self.cycles += 1;
        }
        if self.phase == Phase::Ending && self.robots.iter().all(Robot::is_idle) {
            self.phase = Phase::Ended;
        }
        self.phase
    }

    /// Whether all robots are at rest.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.robots.iter().all(Robot::is_idle)
    }

    fn halt(&mut self) {
        self.threads.iter_mut().for_each(|t| t.is_alive = false);
        if self.phase != Phase::Failed {
            self.phase = Phase::Ending;
        }
    }

    fn now(&self) -> f64 {
        // Whole cycles, so that nothing drifts.
        #[expect(clippy::cast_precision_loss, reason = "exact up to 2^53 cycles")]
        let cycles = self.cycles as f64;
        cycles * self.period_s
    }

    /// Lets the program read where its robots are.
    fn write_records(&mut self) {
        let records = self.program.robot_records.iter();
        for (record, robot) in records.zip(&self.robots) {
            let first = *record as usize;
            let Some(words) = self.memory.get_mut(first..first + RECORD_WORDS as usize) else {
                continue;
            };
            for i in 0..MAIN_JOINTS {
                let angle = robot.positions().get(i).copied();
                let angle = angle.map_or(f64::NAN, f64::to_degrees);
                if let Some(word) = words.get_mut(JOINT_ACT + i) {
                    *word = angle.to_bits();
                }
            }
            let pose = robot
                .tool_centre()
                .and_then(|frame| builtin::of_frame(&frame));
            if let (Some(pose), Some(words)) = (pose, words.get_mut(POSE_ACT..)) {
                words.copy_from_slice(&pose);
            }
        }
    }

    /// Executes all threads; each gets its part of the steps.
    fn execute(&mut self) {
        let count = self.threads.len();
        let alive = self.threads.iter().filter(|t| t.is_alive).count().max(1);
        let share = self.steps / u32::try_from(alive).unwrap_or(1);
        for i in 0..count {
            let number = (self.first + i) % count;
            if let Err(kind) = self.run_thread(number, share.max(1)) {
                let pc = self.threads.get(number).map_or(0, |t| t.pc);
                let at = self.program.locations.get(pc as usize).copied();
                self.fault = Some(Fault {
                    kind,
                    at: at.unwrap_or_default(),
                });
                self.threads.iter_mut().for_each(|t| t.is_alive = false);
                self.phase = Phase::Failed;
                return;
            }
            if self.phase != Phase::Running {
                return;
            }
        }
        self.first = (self.first + 1) % count.max(1);
    }
}

/// At rest there.
fn at_rest(position: f64) -> State {
    State::at_rest(position)
}
