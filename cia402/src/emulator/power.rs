//! The drive's side of the state machine: which transition a controlword, a fault or the end of a stop causes, as the
//! option codes select it. The table of transitions is in [`crate::transition()`]; how the motor stops is for the
//! modes.

use crate::{Command, ControlWord, State, Trigger, transition};

use super::quirks::Quirks;

/// How the motor is brought to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    /// The power stage is switched off at once; friction or the brake stops the motor.
    Coast,
    /// By the profile deceleration 6084h.
    Ramp,
    /// By the quick stop deceleration 6085h.
    QuickRamp,
    /// By the largest deceleration 60C6h, within the torque limits.
    Limit,
}

impl Stop {
    /// From the common values of 605Ah to 605Eh; 5 to 8 of 605Ah are 1 to 4.
    pub(super) const fn from_option(option: i16) -> Self {
        match option {
            1 | 5 => Self::Ramp,
            2 | 6 => Self::QuickRamp,
            3 | 4 | 7 | 8 => Self::Limit,
            _ => Self::Coast,
        }
    }
}

/// The commanded motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    /// Nothing: the power stage is off and the brake closed.
    Off,
    /// The brake opens; the motor holds its position.
    Opening,
    /// Follow the mode of operation.
    Follow,
    /// Stop and hold.
    Stopping(Stop),
}

/// Option codes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Options {
    pub(super) quick_stop: i16,
    pub(super) shutdown: i16,
    pub(super) disable: i16,
    pub(super) fault: i16,
}

/// Status of the drive.
#[derive(Clone, Copy, Debug)]
pub(super) struct PowerInput {
    /// The motor has stopped.
    pub(super) at_rest: bool,
    /// A new fault was detected.
    pub(super) fault: bool,
    /// The cause of a fault is still present.
    pub(super) cause: bool,
    /// The DC link voltage is present.
    pub(super) voltage: bool,
    /// Time since the last step, s.
    pub(super) dt: f64,
}

/// The state machine.
#[derive(Clone, Debug)]
pub(super) struct Power {
    pub(super) state: State,
    previous: ControlWord,
    /// The transition out of Operation enabled that waits for the motor to stop, and how it stops.
    leaving: Option<(State, Stop)>,
    /// How the motor stops in Quick stop active and Fault reaction active.
    stop: Stop,
    /// Time until the brake is open, s; `None` while it is not opening.
    opening: Option<f64>,
    brake_release: f64,
}

impl Power {
    /// A drive in its self test, whose brake takes `opening` s to open.
    pub(super) const fn new(brake_release: f64) -> Self {
        Self {
            state: State::NotReadyToSwitchOn,
            previous: ControlWord::DISABLE_VOLTAGE,
            leaving: None,
            stop: Stop::Coast,
            opening: None,
            brake_release,
        }
    }

    /// One step with the present controlword. At most one transition is made, so that each state is visible; only a
    /// quick stop without a ramp (605Ah = 0) makes two.
    pub(super) fn step(
        &mut self,
        word: ControlWord,
        input: &PowerInput,
        options: &Options,
        quirks: &Quirks,
    ) -> Motion {
        let before = self.state;
        if input.fault && !matches!(before, State::FaultReactionActive | State::Fault) {
            self.stop = Stop::from_option(options.fault);
            self.go(State::FaultReactionActive);
        } else if !self.finish(input, options) {
            self.apply_command(word, input, options, quirks);
        }
        self.previous = word;
        self.motion(before)
    }

    fn go(&mut self, state: State) {
        self.state = state;
        self.leaving = None;
        self.opening = None;
    }

    /// Makes transitions that need no command; returns whether there was one.
    fn finish(&mut self, input: &PowerInput, options: &Options) -> bool {
        if let Some((to, _)) = self.leaving.filter(|_| input.at_rest) {
            self.go(to);
            return true;
        }
        if let Some(left) = &mut self.opening {
            *left -= input.dt;
            if *left <= 0.0 {
                self.go(State::OperationEnabled);
                return true;
            }
        }
        let done = match self.state {
            State::NotReadyToSwitchOn => true,
            State::QuickStopActive => input.at_rest && options.quick_stop < 5,
            State::FaultReactionActive => input.at_rest || self.stop == Stop::Coast,
            State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::OperationEnabled
            | State::Fault => false,
        };
        if let Some(arrow) = transition(self.state, Trigger::Done).filter(|_| done) {
            self.go(arrow.to);
        }
        done
    }

    fn apply_command(
        &mut self,
        word: ControlWord,
        input: &PowerInput,
        options: &Options,
        quirks: &Quirks,
    ) {
        let word = if quirks.no_quick_stop {
            ControlWord::new(word.raw() | 0x0004)
        } else {
            word
        };
        let previous = if quirks.fault_reset_by_level {
            ControlWord::DISABLE_VOLTAGE
        } else {
            self.previous
        };
        let Some(command) = word.command(previous) else {
            return;
        };
        if command == Command::EnableOperation && self.state == State::OperationEnabled {
            self.leaving = None;
            return;
        }
        let Some(arrow) = transition(self.state, Trigger::Command(command)) else {
            return;
        };
        match arrow.number {
            3 if !input.voltage => {}
            4 => self.opening = self.opening.or(Some(self.brake_release)),
            5 if options.disable != 0 => self.leaving = Some((arrow.to, Stop::Ramp)),
            8 if options.shutdown != 0 => self.leaving = Some((arrow.to, Stop::Ramp)),
            11 => {
                self.stop = Stop::from_option(options.quick_stop);
                let stays = self.stop != Stop::Coast;
                self.go(if stays {
                    arrow.to
                } else {
                    State::SwitchOnDisabled
                });
            }
            15 if input.cause => {}
            16 if !quirks.transition_16 || !(5..=8).contains(&options.quick_stop) => {}
            _ => self.go(arrow.to),
        }
    }

    /// The present motion; a fault in a state without power has nothing to stop.
    fn motion(&mut self, before: State) -> Motion {
        match self.state {
            State::OperationEnabled => match self.leaving {
                Some((_, stop)) => Motion::Stopping(stop),
                None => Motion::Follow,
            },
            State::SwitchedOn if self.opening.is_some() => Motion::Opening,
            State::QuickStopActive => Motion::Stopping(self.stop),
            State::FaultReactionActive => {
                let powered = matches!(
                    before,
                    State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
                );
                if !powered {
                    self.stop = Stop::Coast;
                }
                if self.stop == Stop::Coast {
                    Motion::Off
                } else {
                    Motion::Stopping(self.stop)
                }
            }
            State::NotReadyToSwitchOn
            | State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::SwitchedOn
            | State::Fault => Motion::Off,
        }
    }
}
