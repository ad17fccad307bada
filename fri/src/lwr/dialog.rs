//! The PC's side of a handshake with the KRL program over user data. It commands no motion and sends nothing: its owner
//! copies the user data into the session's answers.

use super::protocol::{Load, Protocol, parameter, strategy_number};
use super::wire::{Control, Krl, Msr, Quality, State};
use super::{AXES, JOINT_NAMES};
use std::time::Duration;

/// Largest distance from the set-point at which tool, load or strategy may change, rad.
const DEVIATION_MAX_RAD: f64 = 0.01;
/// Timeout of one handshake step; moves of the KRL program to the present position take their time.
const STEP_TIMEOUT: Duration = Duration::from_secs(10);

/// Request to the KRL program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request {
    /// friStart, with a control strategy if the protocol carries one.
    Start {
        /// `None` keeps the strategy.
        strategy: Option<Control>,
    },
    /// friStop.
    Stop,
    /// Changes strategy, tool or load; the program leaves command mode for this and enters it again.
    Configure(Settings),
    /// friClose, then friOpen with another period, 1 ms to 100 ms.
    Reopen {
        /// Whole milliseconds.
        period: Duration,
    },
}

/// Settings that [`Request::Configure`] changes; `None` keeps a setting.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Settings {
    /// Control strategy.
    pub strategy: Option<Control>,
    /// `$TOOL`: X, Y, Z in mm, A, B, C in degrees.
    pub tool: Option<[f32; 6]>,
    /// `$LOAD`.
    pub load: Option<Load>,
}

/// Why a request failed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DialogError {
    /// The KRL program has no such function.
    #[error(
        "the KRL program ({protocol}) cannot do that: choose another handshake or change the program"
    )]
    Unsupported {
        /// The convention in use.
        protocol: Protocol,
    },
    /// One request at a time.
    #[error("another request is in progress")]
    Busy,
    /// The drives are off.
    #[error("drives without power: release the brakes at the pendant first")]
    Power,
    /// A joint deviates from its set-point.
    #[error("{} is {delta:.4} rad from its set-point, more than 0.01 rad: relieve the robot first", JOINT_NAMES.get(*joint).copied().unwrap_or("?"))]
    Deviation {
        /// Index of the joint.
        joint: usize,
        /// Measured minus set-point, rad.
        delta: f64,
    },
    /// The KRL program did not respond.
    #[error(
        "no reaction of the KRL program ({protocol}) for 10 s while waiting for {waits_for}: check that it runs and uses these indices"
    )]
    Silent {
        /// The convention in use.
        protocol: Protocol,
        /// Expected reaction.
        waits_for: &'static str,
    },
}

/// Progress of a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// No request.
    Idle,
    /// In progress.
    Running,
    /// Completed; returned once.
    Done,
    /// Failed; returned once.
    Failed(DialogError),
}

/// Steps of a request. [`Protocol::Rcc`]: `Open`, then `Parameter` for each, then `Close`. [`Protocol::Tum`]: `Ask`,
/// then `Release`. All others: `Await`.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    /// Waits for the program to be ready for parameters.
    Open(Settings),
    /// Waits for the echo of a parameter.
    Parameter(Settings, i32),
    /// Waits for the program to have started FRI again.
    Close,
    /// Waits for the program to be busy.
    Ask,
    /// Waits for the program to be no longer busy.
    Release,
    /// Waits for command mode, or for its end.
    Await(State),
}

/// A handshake with a KRL program.
///
/// Per cycle: [`poll`](Self::poll) with the newest measurement and [`Session::krl_mut`](super::Session::krl_mut).
#[derive(Debug, Clone)]
pub struct Dialog {
    protocol: Protocol,
    step: Option<(Step, Duration)>,
}

impl Dialog {
    /// A handshake in a convention; the KRL program must use the same.
    pub fn new(protocol: Protocol) -> Self {
        Self {
            protocol,
            step: None,
        }
    }

    /// The convention.
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// Starts a request. `msr` is the newest measurement, `krl` the user data of the answers.
    pub fn request(
        &mut self,
        request: &Request,
        msr: &Msr,
        krl: &mut Krl,
        now: Duration,
    ) -> Result<(), DialogError> {
        if self.step.is_some() {
            return Err(DialogError::Busy);
        }
        let step = self.begin(request, msr, krl)?;
        self.step = Some((step, now));
        Ok(())
    }

    fn begin(&self, request: &Request, msr: &Msr, krl: &mut Krl) -> Result<Step, DialogError> {
        let protocol = self.protocol;
        match (protocol, request) {
            (Protocol::Rcc, Request::Configure(settings)) => {
                check_at_rest(msr)?;
                krl.int[15] = 0;
                krl.set_bool(15, true);
                return Ok(Step::Open(*settings));
            }
            (Protocol::Tum, Request::Start { strategy: None }) => krl.int[0] = 1,
            (Protocol::Tum, Request::Stop) => krl.int[0] = 2,
            (Protocol::Tum, Request::Reopen { period }) => {
                let ms = i32::try_from(period.as_millis()).unwrap_or(i32::MAX);
                (krl.int[0], krl.int[1]) = (3, ms.clamp(1, 100));
            }
            (
                Protocol::Stanford | Protocol::KukaLwr | Protocol::FirstApp,
                Request::Start { strategy },
            ) => {
                return self.begin_start(*strategy, msr, krl);
            }
            (Protocol::Stanford, Request::Stop) => {
                krl.int[15] = 20;
                return Ok(Step::Await(State::Mon));
            }
            (Protocol::KukaLwr, Request::Stop) => {
                krl.int[1] = 0;
                return Ok(Step::Await(State::Mon));
            }
            (_, Request::Configure(settings)) if only_strategy(settings) => {
                // These programs take a strategy with friStart only.
                return Err(DialogError::Unsupported { protocol });
            }
            (
                Protocol::Rcc
                | Protocol::Stanford
                | Protocol::KukaLwr
                | Protocol::Tum
                | Protocol::FirstApp,
                Request::Start { .. }
                | Request::Stop
                | Request::Configure(_)
                | Request::Reopen { .. },
            ) => return Err(DialogError::Unsupported { protocol }),
        }
        krl.set_bool(0, true);
        Ok(Step::Ask)
    }

    fn begin_start(
        &self,
        strategy: Option<Control>,
        msr: &Msr,
        krl: &mut Krl,
    ) -> Result<Step, DialogError> {
        let protocol = self.protocol;
        if strategy.is_some() {
            check_at_rest(msr)?;
        }
        let present = strategy_number(msr.robot.control).unwrap_or(10);
        let number = strategy.and_then(strategy_number).unwrap_or(present);
        match protocol {
            Protocol::Stanford => (krl.int[14], krl.int[15]) = (number, 10),
            Protocol::KukaLwr => (krl.int[0], krl.int[1]) = (number, 1),
            Protocol::FirstApp if strategy.is_none() => first_app(msr, krl),
            Protocol::FirstApp | Protocol::Rcc | Protocol::Tum => {
                return Err(DialogError::Unsupported { protocol });
            }
        }
        Ok(Step::Await(State::Cmd))
    }

    /// Advances the current request. Clears user data that would start the robot again by itself.
    pub fn poll(&mut self, msr: &Msr, krl: &mut Krl, now: Duration) -> Progress {
        let Some((step, since)) = self.step else {
            return Progress::Idle;
        };
        match self.next(step, msr, krl) {
            Next::Wait(waits_for) if now.saturating_sub(since) >= STEP_TIMEOUT => {
                self.cancel(krl);
                let protocol = self.protocol;
                Progress::Failed(DialogError::Silent {
                    protocol,
                    waits_for,
                })
            }
            Next::Wait(_) => Progress::Running,
            Next::Step(step) => {
                self.step = Some((step, now));
                Progress::Running
            }
            Next::Done => {
                self.end(krl);
                Progress::Done
            }
        }
    }

    fn next(&self, step: Step, msr: &Msr, krl: &mut Krl) -> Next {
        match step {
            Step::Open(settings) if msr.krl.bool(15) => send(settings, 0, krl),
            Step::Open(_) => Next::Wait("TO_BOOL[16]"),
            Step::Parameter(settings, sent) if msr.krl.int[15] == sent => send(settings, sent, krl),
            Step::Parameter(..) => Next::Wait("the echo of a parameter in TO_INT[16]"),
            Step::Close if !msr.krl.bool(15) => Next::Done,
            Step::Close => Next::Wait("the end of TO_BOOL[16]"),
            Step::Ask if msr.krl.bool(0) => {
                krl.set_bool(0, false);
                Next::Step(Step::Release)
            }
            Step::Ask => Next::Wait("TO_BOOL[1]"),
            Step::Release if !msr.krl.bool(0) => Next::Done,
            Step::Release => Next::Wait("the end of TO_BOOL[1]"),
            Step::Await(state) if msr.interface.state == state => Next::Done,
            Step::Await(_) => {
                if self.protocol == Protocol::FirstApp {
                    first_app(msr, krl);
                }
                Next::Wait("command mode, or its end")
            }
        }
    }

    /// The controller fell silent or restarted: a program started now must not start the robot because of an earlier
    /// request. Returns whether a request was in progress; it is cancelled.
    pub fn handle_silence(&mut self, krl: &mut Krl) -> bool {
        let was_busy = self.step.is_some();
        self.cancel(krl);
        was_busy
    }

    /// Withdraws the request, also one expressed by a level.
    fn cancel(&mut self, krl: &mut Krl) {
        self.end(krl);
        match self.protocol {
            Protocol::KukaLwr => krl.int[1] = 0,
            Protocol::FirstApp => krl.int[0] = 1,
            Protocol::Rcc | Protocol::Stanford | Protocol::Tum => {}
        }
    }

    /// Clears user data that requests a start. Levels stay: the program follows them.
    fn end(&mut self, krl: &mut Krl) {
        self.step = None;
        match self.protocol {
            Protocol::Rcc => krl.set_bool(15, false),
            Protocol::Stanford => krl.int[15] = 0,
            Protocol::Tum => krl.set_bool(0, false),
            // FRM_INT[2] = 0 would be friStop, and leaving command mode requires 0 and 1 again. FRM_INT[1] = 10 stays
            // while the program runs.
            Protocol::KukaLwr | Protocol::FirstApp => {}
        }
    }
}

enum Next {
    Wait(&'static str),
    Step(Step),
    Done,
}

fn only_strategy(settings: &Settings) -> bool {
    settings.tool.is_none() && settings.load.is_none()
}

fn first_app(msr: &Msr, krl: &mut Krl) {
    let is_good = msr.interface.quality.code() >= Quality::Ok.code();
    krl.int[0] = if is_good { 10 } else { 1 };
    krl.real[0] = msr.krl.real[1];
}

/// Checks that the drives have power and every joint is at its set-point.
fn check_at_rest(msr: &Msr) -> Result<(), DialogError> {
    if msr.robot.power == 0 {
        return Err(DialogError::Power);
    }
    let set_point: [f64; AXES] = msr.set_point();
    for (joint, (measured, commanded)) in msr.measured_joints.iter().zip(set_point).enumerate() {
        let delta = f64::from(*measured) - commanded;
        if delta.abs() >= DEVIATION_MAX_RAD {
            return Err(DialogError::Deviation { joint, delta });
        }
    }
    Ok(())
}

/// Writes the next parameter after `sent` to the user data; closes when there is none.
fn send(settings: Settings, sent: i32, krl: &mut Krl) -> Next {
    for number in sent + 1..=parameter::LAST {
        if let Some(value) = value(&settings, number) {
            match value {
                Value::Number(value) => krl.int[14] = value,
                Value::Real(value) => krl.real[14] = value,
            }
            krl.int[15] = number;
            return Next::Step(Step::Parameter(settings, number));
        }
    }
    krl.set_bool(15, false);
    Next::Step(Step::Close)
}

enum Value {
    Number(i32),
    Real(f32),
}

fn value(settings: &Settings, number: i32) -> Option<Value> {
    let at = |values: &[f32], first: i32| {
        let index = usize::try_from(number - first).ok()?;
        values.get(index).copied().map(Value::Real)
    };
    match number {
        parameter::STRATEGY => strategy_number(settings.strategy?).map(Value::Number),
        parameter::TOOL..parameter::MASS => at(&settings.tool?, parameter::TOOL),
        parameter::MASS => Some(Value::Real(settings.load?.mass_kg)),
        parameter::CENTRE..parameter::INERTIA => at(&settings.load?.centre, parameter::CENTRE),
        _ => at(&settings.load?.inertia, parameter::INERTIA),
    }
}
