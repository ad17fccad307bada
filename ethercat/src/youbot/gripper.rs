//! The gripper behind the last joint: two bars moved by stepper motors without position feedback, reached through the
//! mailbox of that joint. Their positions are known once they were opened to their stops; this is a motion, done only
//! when permitted.
//!
//! ```text
//!          1 start       2           3 not calibrated, may move         4 open     5 closed
//! Idle ------------> Setup --> Query --------------------------> Origin --> Open --> Close --> Preset
//!   ^                  ^       | 7 calibrated                                                    | 6
//!   | 11 forget,       |       v          8 order          9 both there                          v
//!   |    from any      |     Ready <-------------------> Order ---13 too long---> Short         Mark --> Ready
//!                      |                                   ^---------8 order--------+
//!                      +-- 12 lost, 2 s later -- Failed(why) <--10 refused, or too long on the way to the stops-- any
//! ```
//! An order that is stopped in motion leads from Order through Stop, bar by bar, to Ready ([`Gripper::stop`]). 1 and 12
//! in [`Gripper::start`], 8 in [`Gripper::order`], 11 in [`Gripper::forget`], the others in [`Gripper::cycle`]. Bars
//! that did not reach their stops are not sent there again automatically: a hand may block them.

use std::time::Duration;

use super::mailbox::{CallError, Mailbox};
use super::parameters::GRIPPER_CALIBRATED;
use super::tmcl::Request;

/// Timeout of a bar motion.
const MOVE_MAX: Duration = Duration::from_secs(8);
/// Retry delay after a mailbox error.
const AGAIN: Duration = Duration::from_secs(2);
/// Start-up parameters: bar, parameter, value (stallGuard).
const SETUP: [(u8, u8, i32); 4] = [(0, 174, 50), (1, 174, 50), (0, 173, 1), (1, 173, 1)];

/// A bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarConfig {
    /// Stroke, steps; it counts down when it opens.
    pub steps: i32,
    /// Stroke, m.
    pub stroke: f64,
}

impl Default for BarConfig {
    fn default() -> Self {
        Self {
            steps: 67_000,
            stroke: 0.0115,
        }
    }
}

/// State of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GripperState {
    /// Not begun.
    Idle,
    /// Parameters are written.
    Setup(u8),
    /// Queries whether it was calibrated since power-on.
    Query,
    /// The counter of a bar is read.
    Origin(u8),
    /// It opens to its stops.
    Open,
    /// It closes by as much.
    Close,
    /// The counter of a bar is set to 0.
    Preset(u8),
    /// The drive is marked as calibrated.
    Mark,
    /// It is at its commanded position.
    Ready,
    /// It moves to its commanded position.
    Order,
    /// It is blocked: it presses before its commanded position.
    Short,
    /// A bar is being stopped.
    Stop(u8),
    /// It cannot be used, since this time.
    Failed(GripperError, Duration),
}

/// Why the gripper cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GripperError {
    /// A bar did not reach its stop.
    #[error(
        "a finger did not reach its stop within 8 s; remove the obstruction, then power-cycle the arm"
    )]
    Late,
    /// The drive refused, or did not answer.
    #[error("{0}")]
    Call(CallError),
}

/// A motion of the bars.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    targets: [i32; 2],
    step: u8,
    reached: bool,
    since: Duration,
}

/// The gripper.
#[derive(Debug)]
pub struct Gripper {
    config: BarConfig,
    state: GripperState,
    motion: Motion,
    origin: [i32; 2],
    /// Counters of the bars as last read, steps.
    counts: [Option<i32>; 2],
}

impl Gripper {
    /// Not begun.
    pub fn new(config: BarConfig) -> Self {
        Self {
            config,
            state: GripperState::Idle,
            motion: Motion::default(),
            origin: [0; 2],
            counts: [None; 2],
        }
    }

    /// Its state.
    pub const fn state(&self) -> GripperState {
        self.state
    }

    /// Whether it accepts orders.
    pub const fn is_ready(&self) -> bool {
        match self.state {
            GripperState::Ready
            | GripperState::Order
            | GripperState::Short
            | GripperState::Stop(_) => true,
            GripperState::Idle
            | GripperState::Setup(_)
            | GripperState::Query
            | GripperState::Origin(_)
            | GripperState::Open
            | GripperState::Close
            | GripperState::Preset(_)
            | GripperState::Mark
            | GripperState::Failed(..) => false,
        }
    }

    /// Largest distance between the fingers, m.
    pub fn distance_max(&self) -> f64 {
        2.0 * self.config.stroke
    }

    /// Distance between the fingers, m; `None` while it is not known.
    pub fn distance(&self) -> Option<f64> {
        let [one, other] = self.counts;
        let steps = -(f64::from(one?) + f64::from(other?));
        self.is_ready()
            .then(|| steps / f64::from(self.config.steps) * self.config.stroke)
    }

    #[cfg(test)]
    pub(super) const fn force(&mut self, state: GripperState, counts: [Option<i32>; 2]) {
        (self.state, self.counts) = (state, counts);
    }

    /// Starts, unless already started; retries two seconds after a mailbox error. Other errors persist until
    /// [`Self::forget`].
    pub fn start(&mut self, now: Duration) {
        match self.state {
            GripperState::Idle => self.state = GripperState::Setup(0),
            GripperState::Failed(GripperError::Call(CallError::Lost(_)), since)
                if now.saturating_sub(since) >= AGAIN =>
            {
                self.state = GripperState::Setup(0);
            }
            GripperState::Failed(..)
            | GripperState::Setup(_)
            | GripperState::Query
            | GripperState::Origin(_)
            | GripperState::Open
            | GripperState::Close
            | GripperState::Preset(_)
            | GripperState::Mark
            | GripperState::Ready
            | GripperState::Order
            | GripperState::Short
            | GripperState::Stop(_) => {}
        }
    }

    /// Its drive was offline: its state is unknown. The bars stop at their last targets.
    pub fn forget(&mut self) {
        self.state = GripperState::Idle;
        self.counts = [None; 2];
    }

    /// Moves the fingers to a distance, m, from now on. False if it does not accept orders, or not this one.
    pub fn order(&mut self, distance: f64, now: Duration) -> bool {
        if !self.is_ready() || !(0.0..=self.distance_max()).contains(&distance) {
            return false;
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "within the stroke of a bar"
        )]
        let steps = (distance / self.distance_max() * f64::from(self.config.steps)).round() as i32;
        self.go([-steps; 2], GripperState::Order, now);
        true
    }

    /// Stops the fingers where they are, if an order moves them.
    pub fn stop(&mut self) {
        if self.state == GripperState::Order {
            self.state = GripperState::Stop(0);
        }
    }

    fn go(&mut self, targets: [i32; 2], state: GripperState, now: Duration) {
        self.motion = Motion {
            targets,
            step: 0,
            reached: false,
            since: now,
        };
        self.state = state;
    }

    /// One cycle while its drive answers. It is calibrated only if it `may_move`.
    pub fn cycle(&mut self, mailbox: &mut Mailbox, may_move: bool, now: Duration) {
        let (bank, number) = GRIPPER_CALIBRATED;
        match self.state {
            GripperState::Idle | GripperState::Failed(..) => {}
            GripperState::Ready | GripperState::Short => self.read_positions(mailbox, now),
            GripperState::Setup(step) => {
                let next = SETUP.get(usize::from(step));
                let Some((bar, parameter, value)) = next.copied() else {
                    self.state = GripperState::Query;
                    return;
                };
                if self
                    .call(mailbox, Request::set_bar(bar, parameter, value), now)
                    .is_some()
                {
                    self.state = GripperState::Setup(step + 1);
                }
            }
            GripperState::Query => match self.call(mailbox, Request::get_global(bank, number), now)
            {
                Some(1) => self.state = GripperState::Ready,
                Some(_) if may_move => self.state = GripperState::Origin(0),
                Some(_) | None => {}
            },
            GripperState::Origin(bar) => {
                if let Some(count) = self.call(mailbox, Request::get_bar(bar, 1), now) {
                    if let Some(origin) = self.origin.get_mut(usize::from(bar)) {
                        *origin = count;
                        self.state = GripperState::Origin(bar + 1);
                    }
                    if bar == 1 {
                        let open = self.origin.map(|at| at.saturating_sub(self.config.steps));
                        self.go(open, GripperState::Open, now);
                    }
                }
            }
            GripperState::Open => {
                if self.travel(mailbox, now) {
                    self.go(self.origin, GripperState::Close, now);
                }
            }
            GripperState::Close => {
                if self.travel(mailbox, now) {
                    self.state = GripperState::Preset(0);
                }
            }
            GripperState::Preset(step) => self.preset(mailbox, step, now),
            GripperState::Mark => {
                if self
                    .call(mailbox, Request::set_global(bank, number, 1), now)
                    .is_some()
                {
                    self.state = GripperState::Ready;
                }
            }
            GripperState::Order => {
                if self.travel(mailbox, now) {
                    self.state = GripperState::Ready;
                }
            }
            GripperState::Stop(bar) => {
                if self.call(mailbox, Request::stop_bar(bar), now).is_some() {
                    // Their final positions are read again.
                    self.counts = [None; 2];
                    self.state = if bar == 0 {
                        GripperState::Stop(1)
                    } else {
                        GripperState::Ready
                    };
                }
            }
        }
    }

    /// Each bar's counter to 0, then its target too, so that it does not move to the previous zero.
    fn preset(&mut self, mailbox: &mut Mailbox, step: u8, now: Duration) {
        let bar = step / 2;
        let request = if step.is_multiple_of(2) {
            Request::set_bar(bar, 1, 0)
        } else {
            Request::move_bar(bar, 0)
        };
        if self.call(mailbox, request, now).is_some() {
            self.state = if step < 3 {
                GripperState::Preset(step + 1)
            } else {
                GripperState::Mark
            };
        }
    }

    /// Reads the positions of the bars, in turn.
    fn read_positions(&mut self, mailbox: &mut Mailbox, now: Duration) {
        let bar = u8::from(self.counts[0].is_some());
        if self.counts[usize::from(bar)].is_some() {
            return;
        }
        if let Some(count) = self.call(mailbox, Request::get_bar(bar, 1), now) {
            self.counts[usize::from(bar)] = Some(count);
        }
    }

    /// Sends both bars, then queries in turn their positions and whether they have arrived; true when both have.
    fn travel(&mut self, mailbox: &mut Mailbox, now: Duration) -> bool {
        let Motion { targets, step, .. } = self.motion;
        let request = match step {
            0 => Request::move_bar(0, targets[0]),
            1 => Request::move_bar(1, targets[1]),
            2 => Request::get_bar(0, 8),
            3 => Request::get_bar(1, 8),
            4 => Request::get_bar(0, 1),
            _ => Request::get_bar(1, 1),
        };
        if let Some(value) = self.call(mailbox, request, now) {
            self.motion.step = if step >= 5 { 2 } else { step + 1 };
            match step {
                2 => self.motion.reached = value == 1,
                3 => self.motion.reached &= value == 1,
                4 => self.counts[0] = Some(value),
                5 => {
                    self.counts[1] = Some(value);
                    return self.motion.reached;
                }
                _ => {}
            }
        }
        if now.saturating_sub(self.motion.since) > MOVE_MAX {
            self.state = if self.state == GripperState::Order {
                GripperState::Short
            } else {
                GripperState::Failed(GripperError::Late, now)
            };
        }
        false
    }

    fn call(&mut self, mailbox: &mut Mailbox, request: Request, now: Duration) -> Option<i32> {
        match mailbox.call(request)? {
            Ok(answer) => answer.value(),
            Err(error) => {
                self.state = GripperState::Failed(GripperError::Call(error), now);
                None
            }
        }
    }
}
