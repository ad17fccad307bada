//! Homing of an axis by a proximity switch and the index pulse of its encoder: which way to move in each cycle, and every way in
//! which that fails. It reads no terminal; positions are increments of the axis, before its zero is known.
//!
//! ```text
//!  (1) on the switch        (2)                    (3)                  (4)              (5)            (6)
//! ┌──▶ Leave ─────────▶ Seek ────────▶ Touched ─────────▶ Off ──────────▶ Index ─────────▶ Start ─────────▶ Done
//! Begin     off the switch    switch on        may leave      off the switch     pulse latched     at its start
//! ```
//! Transitions 1 to 6 are in [`Homing::advance`]; Touched is left out by an axis that may leave at once, and each step but Done may
//! end in Failed. The switch is approached in one direction and
//! the index searched in the other, so that play of gear and switch does not count.

use std::fmt;
use std::time::Duration;

/// Why a homing failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingError {
    /// The whole way was moved without touching the switch.
    SensorNotFound,
    /// The switch stays on, however far the axis moves off it.
    SwitchStuck,
    /// The encoder gave no index pulse within two turns.
    IndexNotFound,
    /// The axis moves against its command.
    WrongDirection,
    /// The axis does not follow its command.
    NotMoving,
    /// It took too long.
    Timeout,
    /// The axis lost its power meanwhile.
    PowerLost,
}

impl HomingError {
    /// All, in the order of their numbers from 1.
    pub const ALL: [Self; 7] = [
        Self::SensorNotFound,
        Self::SwitchStuck,
        Self::IndexNotFound,
        Self::WrongDirection,
        Self::NotMoving,
        Self::Timeout,
        Self::PowerLost,
    ];

    /// Its number, from 1, as nets see it.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8 + 1
    }
}

impl fmt::Display for HomingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SensorNotFound => {
                "the proximity switch was not found on the whole way\nhint: check the switch and its input, the sign of \
                 `homing.velocity`, and `homing.travel_max`"
            }
            Self::SwitchStuck => {
                "the proximity switch stays on, although the axis moved off it\nhint: check the switch for metal, and its wire \
                 for a short circuit"
            }
            Self::IndexNotFound => {
                "the encoder gave no index pulse within two turns\nhint: check the wires of track C and `homing.index_every`"
            }
            Self::WrongDirection => {
                "the axis moves against its command\nhint: exchange the wires of the motor or of a track of the encoder, or \
                 change the sign of `velocity_10v`"
            }
            Self::NotMoving => {
                "the axis does not follow its command\nhint: check that the brake opens, the amplifier has power, the encoder is \
                 connected, and `velocity_10v`"
            }
            Self::Timeout => "homing took too long\nhint: see `homing.timeout` and `homing.velocity`",
            Self::PowerLost => {
                "the axis lost its power, or does not get it\nhint: see the events of the axis before"
            }
        })
    }
}

/// How to home, in increments and seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingMotion {
    /// Velocity towards the switch, with its sign.
    pub velocity: f64,
    /// Speed when the index is searched.
    pub index_speed: f64,
    /// Acceleration.
    pub acceleration: f64,
    /// Longest way to the switch, and off it.
    pub travel_max: f64,
    /// Distance between two index pulses.
    pub index_every: f64,
    /// Largest distance between target and axis.
    pub following_max: f64,
    /// Position that the axis has at the index pulse.
    pub index_position: f64,
    /// Where it moves in the end.
    pub start: Option<f64>,
    /// Time for all, but for the rest on the switch.
    pub timeout: Duration,
}

/// Where homing is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HomingStep {
    /// Off the switch, on which it began.
    Leave,
    /// Towards the switch.
    Seek,
    /// At rest on the switch, until it may leave.
    Touched,
    /// Back off the switch.
    Off,
    /// On to the index pulse.
    Index,
    /// To its start.
    Start,
    /// At rest; the zero is known.
    Done,
    /// Braking or at rest; the zero is not known.
    Failed(HomingError),
    /// Braking or at rest, as its owner does not want it any more.
    Cancelled,
}

impl HomingStep {
    /// Its number, as nets see it; 0 is a homing that has not begun.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Leave => 1,
            Self::Seek => 2,
            Self::Touched => 3,
            Self::Off => 4,
            Self::Index => 5,
            Self::Start => 6,
            Self::Done => 7,
            Self::Failed(_) | Self::Cancelled => 8,
        }
    }
}

/// What the axis shows in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingInput {
    /// Increments.
    pub position: f64,
    /// The switch.
    pub proximity: bool,
    /// Whether it may leave the switch; several axes so wait for each other.
    pub may_leave: bool,
    /// Position at the index pulse, once it is latched.
    pub latched: Option<f64>,
    /// Time since the last cycle, s.
    pub dt_s: f64,
    /// Now, since any start.
    pub now: Duration,
}

/// What to do in a cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingOutput {
    /// Increments.
    pub target: f64,
    /// Whether to arm the latch.
    pub arm: bool,
}

/// A homing.
#[derive(Clone, Copy, Debug)]
pub struct Homing {
    motion: HomingMotion,
    step: HomingStep,
    begun: Duration,
    /// Where the step began.
    from: f64,
    target: f64,
    velocity: f64,
    /// Position at the index pulse.
    index: Option<f64>,
}

impl Homing {
    /// Begins at rest, where the axis is.
    #[must_use]
    pub const fn new(motion: HomingMotion, input: &HomingInput) -> Self {
        let step = if input.proximity {
            HomingStep::Leave
        } else {
            HomingStep::Seek
        };
        Self {
            motion,
            step,
            begun: input.now,
            from: input.position,
            target: input.position,
            velocity: 0.0,
            index: None,
        }
    }

    /// Where it is.
    #[must_use]
    pub const fn step(&self) -> HomingStep {
        self.step
    }

    /// Whether it is done, failed or cancelled.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        matches!(
            self.step,
            HomingStep::Done | HomingStep::Failed(_) | HomingStep::Cancelled
        )
    }

    /// What to add to increments, once it is done, so that they count from zero of the axis.
    #[must_use]
    pub fn shift(&self) -> Option<f64> {
        let done = self.step == HomingStep::Done;
        self.index
            .filter(|_| done)
            .map(|index| self.motion.index_position - index)
    }

    /// Whether its target rests.
    #[must_use]
    pub const fn is_at_rest(&self) -> bool {
        self.velocity == 0.0
    }

    /// Ends it with this failure, unless it has ended.
    pub const fn fail(&mut self, error: HomingError) {
        self.end(HomingStep::Failed(error));
    }

    /// Ends it, unless it has ended.
    pub const fn cancel(&mut self) {
        self.end(HomingStep::Cancelled);
    }

    const fn end(&mut self, step: HomingStep) {
        if !self.has_ended() {
            self.step = step;
        }
    }

    /// One cycle.
    pub fn advance(&mut self, input: &HomingInput) -> HomingOutput {
        self.watch(input);
        let away = -self.motion.velocity.signum();
        let leave = away * self.motion.velocity.abs();
        let moved = (input.position - self.from).abs();
        let too_far = moved > self.motion.travel_max;
        let mut wanted = 0.0;
        match self.step {
            HomingStep::Leave if !input.proximity => self.enter(HomingStep::Seek, input),
            HomingStep::Off if !input.proximity => self.enter(HomingStep::Index, input),
            HomingStep::Leave | HomingStep::Off if too_far => self.fail(HomingError::SwitchStuck),
            HomingStep::Leave => wanted = leave,
            HomingStep::Off => wanted = away * self.motion.index_speed,
            HomingStep::Seek if input.proximity && !input.may_leave => {
                self.enter(HomingStep::Touched, input);
            }
            HomingStep::Seek if input.proximity => self.enter(HomingStep::Off, input),
            HomingStep::Touched if input.may_leave => self.enter(HomingStep::Off, input),
            HomingStep::Touched => self.begun += Duration::from_secs_f64(input.dt_s.max(0.0)),
            HomingStep::Seek if too_far => self.fail(HomingError::SensorNotFound),
            HomingStep::Seek => wanted = self.motion.velocity,
            HomingStep::Index => match input.latched {
                Some(index) => {
                    self.index = Some(index);
                    self.enter(HomingStep::Start, input);
                }
                None if moved > 2.0 * self.motion.index_every => {
                    self.fail(HomingError::IndexNotFound);
                }
                None => wanted = away * self.motion.index_speed,
            },
            HomingStep::Start => wanted = self.velocity_to_start(),
            HomingStep::Done | HomingStep::Failed(_) | HomingStep::Cancelled => {}
        }
        self.ramp(wanted, input.dt_s);
        if self.step == HomingStep::Start && wanted == 0.0 && self.velocity == 0.0 {
            self.step = HomingStep::Done;
        }
        HomingOutput {
            target: self.target,
            arm: self.step == HomingStep::Index,
        }
    }

    /// Velocity to the start, from which it comes to rest there; zero at the start, or without one.
    fn velocity_to_start(&self) -> f64 {
        let (Some(index), Some(start)) = (self.index, self.motion.start) else {
            return 0.0;
        };
        let left = start - self.motion.index_position + index - self.target;
        let speed = (2.0 * 0.8 * self.motion.acceleration * left.abs()).sqrt();
        if left.abs() < 1.0 {
            return 0.0;
        }
        left.signum() * speed.min(self.motion.velocity.abs())
    }

    const fn enter(&mut self, step: HomingStep, input: &HomingInput) {
        self.step = step;
        self.from = input.position;
    }

    /// Failures that any step may have.
    fn watch(&mut self, input: &HomingInput) {
        let lag = self.target - input.position;
        if lag.abs() > self.motion.following_max {
            // Against the command by a part of what it lags: more than a load or play of the gear does.
            let moved = input.position - self.from;
            let against = moved * lag < 0.0 && moved.abs() > 0.2 * lag.abs();
            self.fail(if against {
                HomingError::WrongDirection
            } else {
                HomingError::NotMoving
            });
        } else if input.now.saturating_sub(self.begun) > self.motion.timeout {
            self.fail(HomingError::Timeout);
        }
    }

    fn ramp(&mut self, wanted: f64, dt_s: f64) {
        let most = self.motion.acceleration * dt_s;
        self.velocity += (wanted - self.velocity).clamp(-most, most);
        self.target += self.velocity * dt_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOTION: HomingMotion = HomingMotion {
        velocity: -1000.0,
        index_speed: 200.0,
        acceleration: 10_000.0,
        travel_max: 5000.0,
        index_every: 200.0,
        following_max: 100.0,
        index_position: -4000.0,
        start: Some(-3000.0),
        timeout: Duration::from_secs(20),
    };

    /// An axis that follows as `moves` says: from its place and the target to its next place.
    struct Axis {
        position: f64,
        /// The switch, by position.
        switch: fn(f64) -> bool,
        /// The index pulse that lies between two positions.
        index: Option<f64>,
        /// From when on it may leave the switch.
        leaves: Duration,
        moves: fn(f64, f64) -> f64,
    }

    const GOOD: Axis = Axis {
        position: 0.0,
        switch: |at| at < -2000.0,
        index: Some(-1950.0),
        leaves: Duration::ZERO,
        moves: |_, target| target,
    };

    fn home(motion: HomingMotion, mut axis: Axis) -> (Homing, Vec<HomingStep>, f64) {
        let mut latched = None;
        let mut now = Duration::ZERO;
        let input = |axis: &Axis, latched, now| HomingInput {
            position: axis.position,
            proximity: (axis.switch)(axis.position),
            may_leave: now >= axis.leaves,
            latched,
            dt_s: 1e-3,
            now,
        };
        let mut homing = Homing::new(motion, &input(&axis, None, now));
        let mut steps = vec![homing.step()];
        for _ in 0..60_000 {
            now += Duration::from_millis(1);
            let output = homing.advance(&input(&axis, latched, now));
            if steps.last() != Some(&homing.step()) {
                steps.push(homing.step());
            }
            let before = axis.position;
            axis.position = (axis.moves)(before, output.target);
            let passed = |at: &f64| (before < *at) != (axis.position < *at);
            latched = latched
                .or_else(|| axis.index.filter(passed))
                .filter(|_| output.arm);
        }
        (homing, steps, axis.position)
    }

    #[test]
    fn homing_finds_switch_then_index_then_start() {
        use HomingStep::{Done, Index, Leave, Off, Seek, Start};
        let (homing, steps, at) = home(MOTION, GOOD);
        assert_eq!(steps, [Seek, Off, Index, Start, Done]);
        let shift = homing.shift().unwrap();
        assert!((shift + 2050.0).abs() < 1e-9, "{shift}");
        assert!((at + shift + 3000.0).abs() < 2.0, "{at}");
        // From the switch, the axis first moves off it.
        let on = Axis {
            position: -2500.0,
            ..GOOD
        };
        let (again, steps, _) = home(MOTION, on);
        assert_eq!(steps, [Leave, Seek, Off, Index, Start, Done]);
        assert_eq!(again.shift(), homing.shift());
        let (_, _, at) = home(
            HomingMotion {
                start: None,
                ..MOTION
            },
            GOOD,
        );
        assert!((at + 1950.0).abs() < 10.0, "{at}");
    }

    #[test]
    fn homing_rests_on_switch_until_it_may_leave() {
        use HomingStep::{Done, Index, Off, Seek, Start, Touched};
        let (at_once, ..) = home(MOTION, GOOD);
        // Longer than its time: rest on the switch does not count.
        let waits = Axis {
            leaves: Duration::from_secs(30),
            ..GOOD
        };
        let (homing, steps, _) = home(MOTION, waits);
        assert_eq!(steps, [Seek, Touched, Off, Index, Start, Done]);
        assert_eq!(homing.shift(), at_once.shift());
        let never = Axis {
            leaves: Duration::MAX,
            ..GOOD
        };
        let (homing, steps, at) = home(MOTION, never);
        assert_eq!(steps, [Seek, Touched]);
        assert!(homing.is_at_rest() && (at + 2050.0).abs() < 10.0, "{at}");
    }

    #[test]
    fn homing_names_each_failure() {
        let slow = HomingMotion {
            timeout: Duration::from_secs(1),
            ..MOTION
        };
        for (motion, axis, error) in [
            (
                MOTION,
                Axis {
                    switch: |_| false,
                    ..GOOD
                },
                HomingError::SensorNotFound,
            ),
            (
                MOTION,
                Axis {
                    switch: |_| true,
                    ..GOOD
                },
                HomingError::SwitchStuck,
            ),
            (
                MOTION,
                Axis {
                    index: None,
                    ..GOOD
                },
                HomingError::IndexNotFound,
            ),
            (
                MOTION,
                Axis {
                    moves: |_, target| -target,
                    ..GOOD
                },
                HomingError::WrongDirection,
            ),
            (
                MOTION,
                Axis {
                    moves: |at, _| at,
                    ..GOOD
                },
                HomingError::NotMoving,
            ),
            (slow, GOOD, HomingError::Timeout),
        ] {
            let (homing, _, _) = home(motion, axis);
            assert_eq!(homing.step(), HomingStep::Failed(error));
            assert_eq!(homing.shift(), None, "{error:?}");
            let text = error.to_string();
            assert!(text.contains("\nhint: "), "{text}");
        }
        for (number, error) in (1..).zip(HomingError::ALL) {
            assert_eq!(error.number(), number);
        }
    }
}
