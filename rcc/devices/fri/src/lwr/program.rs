//! Orders that only the KRL program can execute: control strategy, tool and load. They are passed over user data, by
//! the handshake that the cell configures. Impedances need no program.

use std::time::Duration;

use takt_fri::lwr::wire::{Control, Krl, Msr};
use takt_fri::lwr::{Dialog, DialogError, Load, Phase, Progress, Protocol, Request, Settings};
use takt_net::device::{Answer, Given, Interfaces, Order, Tool};
use takt_net::value::Frame;

use crate::fri::Orders;
use crate::fri::orders::{answer, error};

/// The handshake with the KRL program, and answers to its orders.
#[derive(Debug)]
pub(super) struct Program {
    /// `None` if no handshake is configured: then nothing is requested of the program.
    dialog: Option<Dialog>,
    job: Option<Job>,
    strategy: Option<Answer>,
    tool: Option<Answer>,
}

/// An order in progress.
#[derive(Clone, Copy, Debug)]
struct Job {
    goal: Goal,
    /// The order to answer.
    order: u64,
    /// The next request to the program.
    then: Option<Request>,
}

/// The content of an order.
#[derive(Clone, Copy, Debug)]
enum Goal {
    Strategy(Control),
    /// Waits to leave command mode.
    Stop,
    Tool(Tool),
}

impl Program {
    pub(super) fn new(protocol: Option<Protocol>) -> Self {
        Self {
            dialog: protocol.map(Dialog::new),
            job: None,
            strategy: None,
            tool: None,
        }
    }

    /// Whether the handshake uses the digital signal of that index, from 0.
    pub(super) fn owns_bool(&self, index: usize) -> bool {
        match self.dialog.as_ref().map(Dialog::protocol) {
            Some(Protocol::Rcc) => index == 15,
            Some(Protocol::Tum) => index == 0,
            Some(Protocol::Stanford | Protocol::KukaLwr | Protocol::FirstApp) | None => false,
        }
    }

    /// Whether the handshake uses the number of that index, from 0.
    pub(super) fn owns_real(&self, index: usize) -> bool {
        match self.dialog.as_ref().map(Dialog::protocol) {
            Some(Protocol::Rcc) => index == 14,
            Some(Protocol::FirstApp) => index == 0,
            Some(Protocol::Stanford | Protocol::KukaLwr | Protocol::Tum) | None => false,
        }
    }

    /// One step: continues the order in progress, or starts the next.
    pub(super) fn turn(
        &mut self,
        has: &Interfaces,
        orders: &Orders<'_>,
        (phase, msr): (Phase, Option<&Msr>),
        krl: &mut Krl,
    ) {
        match (self.job, msr) {
            (Some(job), Some(msr)) => self.go_on(job, phase, msr, krl, orders.now),
            (Some(_), None) => {}
            (None, msr) => self.begin(has, orders, (phase, msr), krl),
        }
    }

    /// The robot was lost or restarted: requests to the program are dropped, also those that it has not seen yet.
    pub(super) fn handle_silence(&mut self, krl: &mut Krl) {
        if let Some(dialog) = &mut self.dialog {
            dialog.handle_silence(krl);
        }
        if let Some(job) = self.job.take() {
            self.end(&job, error::NOT_THERE);
        }
    }

    fn begin(
        &mut self,
        has: &Interfaces,
        orders: &Orders<'_>,
        (phase, msr): (Phase, Option<&Msr>),
        krl: &mut Krl,
    ) {
        let strategy = newer(has.strategy.as_ref(), orders, self.strategy);
        let tool = newer(has.tool.as_ref(), orders, self.tool);
        let (order, goal) = match (strategy, tool) {
            (Some(given), _) => match goal(given.value) {
                Some(goal) => (given.cycle, goal),
                None => {
                    self.strategy = answer(given.cycle, error::RANGE);
                    return;
                }
            },
            (None, Some(given)) => (given.cycle, Goal::Tool(given.value)),
            (None, None) => return,
        };
        let job = Job {
            goal,
            order,
            then: None,
        };
        match msr.filter(|_| phase != Phase::Offline) {
            None => self.end(&job, error::NOT_THERE),
            Some(_) if orders.moves && !matches!(goal, Goal::Stop) => {
                self.end(&job, error::MOVES);
            }
            Some(msr) => self.ask(job, phase, msr, krl, orders.now),
        }
    }

    /// Sends the request to the program, unless there is nothing to do.
    fn ask(&mut self, job: Job, phase: Phase, msr: &Msr, krl: &mut Krl, now: Duration) {
        let Some(dialog) = &mut self.dialog else {
            let is_so = match job.goal {
                Goal::Strategy(wanted) => wanted == msr.robot.control,
                Goal::Stop => phase != Phase::Command,
                Goal::Tool(_) => false,
            };
            let error = if is_so {
                error::NONE
            } else {
                error::IMPOSSIBLE
            };
            return self.end(&job, error);
        };
        let steps = steps(dialog.protocol(), &job.goal, phase, msr);
        let Some((first, then)) = steps else {
            return self.end(&job, error::NONE);
        };
        match dialog.request(&first, msr, krl, now) {
            Ok(()) => self.job = Some(Job { then, ..job }),
            Err(refused) => self.end(&job, code(&refused)),
        }
    }

    fn go_on(&mut self, job: Job, phase: Phase, msr: &Msr, krl: &mut Krl, now: Duration) {
        let Some(dialog) = &mut self.dialog else {
            return;
        };
        match (dialog.poll(msr, krl, now), job.then) {
            (Progress::Running, _) => {}
            (Progress::Done, Some(next)) if phase != Phase::Offline => {
                let job = Job { then: None, ..job };
                match dialog.request(&next, msr, krl, now) {
                    Ok(()) => self.job = Some(job),
                    Err(refused) => self.end(&job, code(&refused)),
                }
            }
            (Progress::Done | Progress::Idle, _) => {
                let is_done = match job.goal {
                    Goal::Strategy(wanted) => msr.robot.control == wanted,
                    Goal::Stop => phase != Phase::Command,
                    Goal::Tool(_) => true,
                };
                let error = if is_done {
                    error::NONE
                } else {
                    error::NO_REACTION
                };
                self.end(&job, error);
            }
            (Progress::Failed(why), _) => self.end(&job, code(&why)),
        }
    }

    fn end(&mut self, job: &Job, error: i32) {
        self.job = None;
        match job.goal {
            Goal::Strategy(_) | Goal::Stop => self.strategy = answer(job.order, error),
            Goal::Tool(_) => self.tool = answer(job.order, error),
        }
    }

    pub(super) fn report(&self, has: &Interfaces, signals: &mut [u64]) {
        if let Some(order) = &has.strategy {
            order.answer.report(signals, self.strategy);
        }
        if let Some(order) = &has.tool {
            order.answer.report(signals, self.tool);
        }
    }
}

/// The order, unless it is answered, or its net ended before it was started.
fn newer<T: takt_net::device::Words>(
    order: Option<&Order<T>>,
    orders: &Orders<'_>,
    last: Option<Answer>,
) -> Option<Given<T>> {
    let given = order?.command.read(orders.words)?;
    if given.is_withdrawn() {
        return None;
    }
    last.is_none_or(|last| last.order != given.cycle)
        .then_some(given)
}

/// Numbers of strategies for nets; 0 is none.
fn goal(number: i32) -> Option<Goal> {
    match number {
        0 => Some(Goal::Stop),
        1 => Some(Goal::Strategy(Control::Position)),
        2 => Some(Goal::Strategy(Control::CartesianImpedance)),
        3 => Some(Goal::Strategy(Control::JointImpedance)),
        _ => None,
    }
}

/// Requests to the program, in order; empty if everything is as ordered. Only RCC's program applies changes by
/// itself: others apply the strategy with friStart.
fn steps(
    protocol: Protocol,
    goal: &Goal,
    phase: Phase,
    msr: &Msr,
) -> Option<(Request, Option<Request>)> {
    let configure = |settings| Some((Request::Configure(settings), None));
    match (protocol, *goal) {
        (_, Goal::Strategy(control)) if control == msr.robot.control && phase == Phase::Command => {
            None
        }
        (Protocol::Rcc, Goal::Strategy(control)) if control == msr.robot.control => None,
        (_, Goal::Stop) if phase != Phase::Command => None,
        (_, Goal::Stop) => Some((Request::Stop, None)),
        (Protocol::Tum | Protocol::FirstApp, Goal::Strategy(control))
            if control == msr.robot.control =>
        {
            Some((Request::Start { strategy: None }, None))
        }
        (Protocol::Rcc, Goal::Strategy(control)) => configure(Settings {
            strategy: Some(control),
            ..Settings::default()
        }),
        (Protocol::Stanford | Protocol::KukaLwr, Goal::Strategy(control)) => {
            let start = Request::Start {
                strategy: Some(control),
            };
            Some(if phase == Phase::Command {
                (Request::Stop, Some(start))
            } else {
                (start, None)
            })
        }
        (Protocol::Tum | Protocol::FirstApp, Goal::Strategy(control)) => configure(Settings {
            strategy: Some(control),
            ..Settings::default()
        }),
        (_, Goal::Tool(tool)) => configure(Settings {
            tool: Some(pose(&tool.tcp)),
            load: Some(load(&tool)),
            ..Settings::default()
        }),
    }
}

/// X, Y, Z in mm, then A, B, C in degrees: about z, the new y, the new x.
fn pose(frame: &Frame) -> [f32; 6] {
    let [x, y, z] = frame.translation.vector.into();
    let (c, b, a) = frame.rotation.euler_angles();
    let [a, b, c] = [a, b, c].map(f64::to_degrees);
    [x * 1e3, y * 1e3, z * 1e3, a, b, c].map(super::to_f32)
}

fn load(tool: &Tool) -> Load {
    let inertia: [f64; 3] = tool.moi.into();
    Load {
        mass_kg: super::to_f32(tool.mass),
        centre: pose(&tool.com),
        inertia: inertia.map(super::to_f32),
    }
}

fn code(why: &DialogError) -> i32 {
    match why {
        DialogError::Power => error::NOT_THERE,
        DialogError::Deviation { .. } => error::MOVES,
        DialogError::Unsupported { .. } => error::IMPOSSIBLE,
        DialogError::Silent { .. } => error::NO_REACTION,
        // Cannot be busy: orders are passed one at a time.
        DialogError::Busy | _ => error::NOT_NOW,
    }
}
