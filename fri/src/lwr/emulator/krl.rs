//! The KRL programs of an emulated KRC: their actions in one cycle, given the user data of the client. They do not move
//! the robot.

use crate::lwr::protocol::{Load, Protocol, parameter, strategy_of};
use crate::lwr::wire::{Control, Krl, State};
use std::time::Duration;

/// An action of the program on the controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Call {
    /// friStart(1.0), repeated until it succeeds.
    Start,
    /// friStop.
    Stop,
    /// `$STIFFNESS.STRATEGY`, committed.
    Strategy(Control),
    /// `$TOOL`, mm and degrees.
    Tool([f32; 6]),
    /// `$LOAD`.
    Load(Load),
    /// friClose and friOpen.
    Reopen(Duration),
}

/// Maximum number of calls per cycle.
const CALLS_MAX: usize = 4;
pub(super) type Calls = [Option<Call>; CALLS_MAX];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Before the first friStart.
    Boot,
    /// Waits for the client.
    Wait,
    /// Receives parameters.
    Parameters,
    /// Has called friStart; waits for command mode.
    Starting,
}

/// A running program.
#[derive(Debug, Clone)]
pub(super) struct Program {
    protocol: Protocol,
    phase: Phase,
    applied: i32,
    strategy: Option<Control>,
    tool: [f32; 6],
    load: Load,
}

/// Request that closes the interface in Stanford's program, as it announces it.
const STANFORD_CLOSE: i32 = 30;
/// Delay of RCC's program after friOpen.
const RCC_BOOT: Duration = Duration::from_secs(2);

impl Program {
    pub(super) fn new(protocol: Protocol) -> Self {
        Self {
            protocol,
            phase: Phase::Boot,
            applied: 0,
            strategy: None,
            tool: [0.0; 6],
            load: Load::default(),
        }
    }

    /// One iteration of the program's loop; `is_ok` is whether `$FRIQUALITY` is OK or better.
    pub(super) fn step(
        &mut self,
        from: &Krl,
        to: &mut Krl,
        (state, is_ok): (State, bool),
        time: Duration,
    ) -> Calls {
        match self.protocol {
            Protocol::Rcc => self.rcc(from, to, state, time),
            Protocol::Stanford => self.stanford(from, to, (state, is_ok)),
            Protocol::KukaLwr => self.kuka_lwr(from, to, state),
            Protocol::Tum => self.tum(from, to, state),
            Protocol::FirstApp => self.first_app(from, to, state, time),
        }
    }

    fn rcc(&mut self, from: &Krl, to: &mut Krl, state: State, time: Duration) -> Calls {
        let mut calls = Calls::default();
        match self.phase {
            Phase::Boot if time < RCC_BOOT => {}
            Phase::Boot | Phase::Starting if state != State::Cmd => {
                calls[0] = Some(Call::Start);
                self.phase = Phase::Starting;
            }
            Phase::Boot | Phase::Starting => {
                to.set_bool(15, false);
                self.phase = Phase::Wait;
            }
            Phase::Wait if from.bool(15) => {
                calls[0] = Some(Call::Stop);
                to.int[15] = -1;
                to.set_bool(15, true);
                self.applied = 0;
                self.phase = Phase::Parameters;
            }
            Phase::Wait => {}
            Phase::Parameters if from.bool(15) => self.rcc_parameter(from, to),
            Phase::Parameters => {
                calls = [
                    self.strategy.take().map(Call::Strategy),
                    Some(Call::Tool(self.tool)),
                    Some(Call::Load(self.load)),
                    Some(Call::Start),
                ];
                self.phase = Phase::Starting;
            }
        }
        calls
    }

    fn rcc_parameter(&mut self, from: &Krl, to: &mut Krl) {
        let number = from.int[15];
        if number == self.applied || number <= 0 {
            return;
        }
        let value = from.real[14];
        let set = |values: &mut [f32], first: i32| {
            let index = usize::try_from(number - first).unwrap_or(usize::MAX);
            if let Some(slot) = values.get_mut(index) {
                *slot = value;
            }
        };
        match number {
            parameter::STRATEGY => self.strategy = strategy_of(from.int[14]),
            parameter::TOOL..parameter::MASS => set(&mut self.tool, parameter::TOOL),
            parameter::MASS => self.load.mass_kg = value,
            parameter::CENTRE..parameter::INERTIA => set(&mut self.load.centre, parameter::CENTRE),
            parameter::INERTIA..=parameter::LAST => set(&mut self.load.inertia, parameter::INERTIA),
            _ => {}
        }
        self.applied = number;
        to.int[15] = number;
    }

    /// Strategy and friStart, unless command mode is on.
    fn start(state: State, strategy: i32) -> Calls {
        let mut calls = Calls::default();
        if state != State::Cmd {
            calls[0] = strategy_of(strategy).map(Call::Strategy);
            calls[1] = Some(Call::Start);
        }
        calls
    }

    fn stop(state: State) -> Calls {
        let mut calls = Calls::default();
        calls[0] = (state == State::Cmd).then_some(Call::Stop);
        calls
    }

    /// FRM_INT\[16\] requests; TO_INT\[15\] holds the request that closes, which clients copy there.
    fn stanford(&mut self, from: &Krl, to: &mut Krl, (state, is_ok): (State, bool)) -> Calls {
        let closed = self.phase == Phase::Parameters;
        to.int[14] = STANFORD_CLOSE;
        to.int[15] = match state {
            _ if closed => 30,
            State::Cmd => 20,
            State::Off | State::Mon | State::Other(_) => 10,
        };
        match from.int[15] {
            _ if closed => Calls::default(),
            10 if is_ok => Self::start(state, from.int[14]),
            20 => Self::stop(state),
            30 | 40 => {
                // friClose ends the program; the emulator keeps sending measurements so that the client sees the end.
                self.phase = Phase::Parameters;
                Self::stop(state)
            }
            _ => Calls::default(),
        }
    }

    fn kuka_lwr(&mut self, from: &Krl, to: &mut Krl, state: State) -> Calls {
        if self.phase == Phase::Boot {
            to.int[1] = 10;
            self.phase = Phase::Wait;
        }
        let wanted = from.int[1];
        match wanted {
            1 if self.phase == Phase::Starting && state == State::Cmd => {
                self.phase = Phase::Wait;
                to.int[1] = 1;
                Calls::default()
            }
            1 if to.int[1] != 1 => {
                self.phase = Phase::Starting;
                Self::start(state, from.int[0])
            }
            0 if to.int[1] != 0 => {
                self.phase = Phase::Wait;
                to.int[1] = 0;
                Self::stop(state)
            }
            _ => Calls::default(),
        }
    }

    fn tum(&mut self, from: &Krl, to: &mut Krl, state: State) -> Calls {
        if !from.bool(0) {
            if self.phase != Phase::Starting {
                to.set_bool(0, false);
            }
        } else if !to.bool(0) {
            to.set_bool(0, true);
            return self.tum_call(from, state);
        }
        if self.phase == Phase::Starting {
            if state == State::Cmd {
                self.phase = Phase::Wait;
            }
            return Self::start(state, 0);
        }
        Calls::default()
    }

    fn tum_call(&mut self, from: &Krl, state: State) -> Calls {
        let mut calls = Calls::default();
        match from.int[0] {
            1 => self.phase = Phase::Starting,
            2 => return Self::stop(state),
            3 => {
                let ms = u64::try_from(from.int[1].clamp(1, 100)).unwrap_or(1);
                calls[0] = Some(Call::Stop);
                calls[1] = Some(Call::Reopen(Duration::from_millis(ms)));
            }
            _ => {}
        }
        calls
    }

    fn first_app(&mut self, from: &Krl, to: &mut Krl, state: State, time: Duration) -> Calls {
        to.real[1] = time.as_secs_f32();
        match self.phase {
            Phase::Boot | Phase::Wait if from.int[0] == 10 => {
                self.phase = Phase::Starting;
                Self::start(state, 0)
            }
            Phase::Starting if state == State::Cmd => {
                self.phase = Phase::Parameters;
                Calls::default()
            }
            Phase::Starting if from.int[0] != 10 => {
                self.phase = Phase::Wait;
                Calls::default()
            }
            Phase::Starting => Self::start(state, 0),
            Phase::Parameters if state != State::Cmd => {
                // Any end of command mode ends the program.
                to.int[0] = -1;
                Calls::default()
            }
            Phase::Boot | Phase::Wait | Phase::Parameters => Calls::default(),
        }
    }
}
