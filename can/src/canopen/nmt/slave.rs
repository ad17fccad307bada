//! NMT slave: states, boot-up message, heartbeat producer and node guarding responses. The owner
//! resets the objects.

use std::time::Duration;

use crate::Frame;
use crate::canopen::message::{HEARTBEAT, frame};
use crate::canopen::{NmtCommand, NmtState, NodeId};

/// NMT state of a slave.
///
/// ```text
///              0 boot-up            1 start
/// Initialising --------> PreOperational <----------> Operational
///      ^                      ^   |     2 enter pre-op    ^ |
///      |                      |   v 3 stop                | | 3
///      |                      +- Stopped -----------------+ |
///      |                      2     ^        1 start        |
///      |                            +-----------------------+
///      +--- 4 reset node, 5 reset communication: from each but Initialising
/// ```
///
/// All arrows are arms of [`step`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Setting up objects; accepts no commands.
    Initialising,
    /// SDO, SYNC, TIME and EMCY are active.
    PreOperational,
    /// PDOs are active too.
    Operational,
    /// Only network management and error control are active.
    Stopped,
}

impl State {
    /// All states.
    pub const ALL: [Self; 4] = [
        Self::Initialising,
        Self::PreOperational,
        Self::Operational,
        Self::Stopped,
    ];

    /// The state as in heartbeats.
    pub(crate) const fn nmt_state(self) -> NmtState {
        match self {
            Self::Initialising => NmtState::BootUp,
            Self::PreOperational => NmtState::PreOperational,
            Self::Operational => NmtState::Operational,
            Self::Stopped => NmtState::Stopped,
        }
    }

    /// Whether SDO, SYNC, TIME and EMCY are active.
    pub(crate) const fn communicates(self) -> bool {
        matches!(self, Self::PreOperational | Self::Operational)
    }
}

/// Reaction of a slave to heartbeat loss, guarding loss or bus-off (1029h:01).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorBehaviour {
    /// 0: from Operational to Pre-operational.
    PreOperational,
    /// 1: nothing.
    Stay,
    /// 2: to Stopped.
    Stop,
}

impl ErrorBehaviour {
    /// Decodes the value; unknown values are the default of the standard.
    pub const fn from_raw(raw: u8) -> Self {
        match raw {
            1 => Self::Stay,
            2 => Self::Stop,
            _ => Self::PreOperational,
        }
    }
}

/// Input of the state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The objects are set up.
    Initialised,
    /// NMT command of the master.
    Command(NmtCommand),
    /// Communication error.
    Error(ErrorBehaviour),
}

/// What to reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// All objects.
    Node,
    /// The objects 1000h to 1FFFh.
    Communication,
}

/// Next state after an input, and what to reset.
pub const fn step(state: State, input: Input) -> (State, Option<Reset>) {
    match (state, input) {
        (State::Initialising, Input::Initialised) => (State::PreOperational, None),
        (State::Initialising, Input::Command(_) | Input::Error(_))
        | (_, Input::Initialised | Input::Error(ErrorBehaviour::Stay)) => (state, None),
        (_, Input::Command(command)) => match command {
            NmtCommand::Start => (State::Operational, None),
            NmtCommand::Stop => (State::Stopped, None),
            NmtCommand::EnterPreOperational => (State::PreOperational, None),
            NmtCommand::ResetNode => (State::Initialising, Some(Reset::Node)),
            NmtCommand::ResetCommunication => (State::Initialising, Some(Reset::Communication)),
            NmtCommand::Other(_) => (state, None),
        },
        (_, Input::Error(ErrorBehaviour::Stop)) => (State::Stopped, None),
        (State::Operational, Input::Error(ErrorBehaviour::PreOperational)) => {
            (State::PreOperational, None)
        }
        (_, Input::Error(ErrorBehaviour::PreOperational)) => (state, None),
    }
}

/// NMT slave of one node.
#[derive(Clone, Debug)]
pub struct Slave {
    id: NodeId,
    state: State,
    boot_up_due: bool,
    /// Producer heartbeat time 1017h; zero: off.
    heartbeat: Duration,
    beat_due: Option<Duration>,
    toggle: bool,
    /// Life time, 100Ch times 100Dh; zero: off.
    life_time: Duration,
    /// Time of the master's last request; life guarding starts with the first one.
    guarded: Option<Duration>,
}

impl Slave {
    /// A slave that is initialising.
    pub const fn new(id: NodeId) -> Self {
        Self {
            id,
            state: State::Initialising,
            boot_up_due: false,
            heartbeat: Duration::ZERO,
            beat_due: None,
            toggle: false,
            life_time: Duration::ZERO,
            guarded: None,
        }
    }

    /// Its node number.
    pub const fn id(&self) -> NodeId {
        self.id
    }

    /// Its state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Handles an input; returns what the owner has to reset. After a reset the owner sets the
    /// objects up and then sends [`Input::Initialised`].
    pub fn handle(&mut self, input: Input) -> Option<Reset> {
        let (state, reset) = step(self.state, input);
        if self.state == State::Initialising && state != self.state {
            (self.boot_up_due, self.toggle) = (true, false);
            self.guarded = None;
        }
        self.state = state;
        reset
    }

    /// Sets the producer heartbeat time, 1017h; zero: off. The first heartbeat is sent at once.
    pub(crate) fn set_heartbeat(&mut self, period: Duration, now: Duration) {
        self.heartbeat = period;
        self.beat_due = (!period.is_zero()).then_some(now);
    }

    /// Sets the life time, 100Ch times 100Dh; zero: off.
    pub(crate) const fn set_life_time(&mut self, life_time: Duration) {
        self.life_time = life_time;
    }

    /// Answers a guarding request. A slave with heartbeat does not, because both use the same
    /// identifier.
    pub(crate) fn handle_guard(&mut self, now: Duration) -> Option<Frame> {
        if !self.heartbeat.is_zero() || self.state == State::Initialising {
            return None;
        }
        self.guarded = Some(now);
        let toggle = u8::from(self.toggle) << 7;
        self.toggle = !self.toggle;
        let state = self.state.nmt_state().raw() | toggle;
        Some(frame(self.id.cob(HEARTBEAT), &[state]))
    }

    /// Whether life guarding has just timed out; returned once.
    pub(crate) fn poll_life(&mut self, now: Duration) -> bool {
        let lost = self.life_due().is_some_and(|due| now >= due);
        if lost {
            self.guarded = None;
        }
        lost
    }

    fn life_due(&self) -> Option<Duration> {
        let guarded = self.guarded.filter(|_| !self.life_time.is_zero())?;
        Some(guarded + self.life_time)
    }

    /// The boot-up message or a heartbeat, if one is due.
    pub fn poll_transmit(&mut self, now: Duration) -> Option<Frame> {
        if self.state == State::Initialising {
            return None;
        }
        if std::mem::take(&mut self.boot_up_due) {
            // The boot-up message replaces the first heartbeat.
            self.beat_due = self.beat_due.map(|_| now + self.heartbeat);
            return Some(self.beat(NmtState::BootUp));
        }
        let due = self.beat_due.filter(|due| now >= *due)?;
        // On the grid; only one after a pause.
        let next = due + self.heartbeat;
        self.beat_due = Some(if next > now {
            next
        } else {
            now + self.heartbeat
        });
        Some(self.beat(self.state.nmt_state()))
    }

    fn beat(&self, state: NmtState) -> Frame {
        frame(self.id.cob(HEARTBEAT), &[state.raw()])
    }

    /// Time of the next poll.
    pub fn poll_timeout(&self) -> Option<Duration> {
        if self.boot_up_due {
            return Some(Duration::ZERO);
        }
        let life = self.life_due();
        [self.beat_due, life].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use State::{Initialising, Operational, PreOperational, Stopped};

    const MS: Duration = Duration::from_millis(1);

    fn slave(state: State) -> Slave {
        let mut slave = Slave::new(NodeId::new(5).unwrap());
        slave.state = state;
        slave
    }

    /// Every state with every input: the table of CiA 301, figure of the NMT slave.
    #[test]
    fn nmt_slave_every_state_with_every_input() {
        use NmtCommand as C;
        let command = Input::Command;
        let both = |reset| (Initialising, Some(reset));
        for (input, [initialising, pre_operational, operational, stopped]) in [
            (
                Input::Initialised,
                [PreOperational, PreOperational, Operational, Stopped].map(|s| (s, None)),
            ),
            (
                command(C::Start),
                [Initialising, Operational, Operational, Operational].map(|s| (s, None)),
            ),
            (
                command(C::Stop),
                [Initialising, Stopped, Stopped, Stopped].map(|s| (s, None)),
            ),
            (
                command(C::EnterPreOperational),
                [Initialising, PreOperational, PreOperational, PreOperational].map(|s| (s, None)),
            ),
            (
                command(C::ResetNode),
                [
                    (Initialising, None),
                    both(Reset::Node),
                    both(Reset::Node),
                    both(Reset::Node),
                ],
            ),
            (
                command(C::ResetCommunication),
                [
                    (Initialising, None),
                    both(Reset::Communication),
                    both(Reset::Communication),
                    both(Reset::Communication),
                ],
            ),
            (command(C::Other(77)), State::ALL.map(|s| (s, None))),
            (
                Input::Error(ErrorBehaviour::PreOperational),
                [Initialising, PreOperational, PreOperational, Stopped].map(|s| (s, None)),
            ),
            (
                Input::Error(ErrorBehaviour::Stay),
                State::ALL.map(|s| (s, None)),
            ),
            (
                Input::Error(ErrorBehaviour::Stop),
                [Initialising, Stopped, Stopped, Stopped].map(|s| (s, None)),
            ),
        ] {
            assert_eq!(
                step(Initialising, input),
                initialising,
                "initialising, {input:?}"
            );
            assert_eq!(
                step(PreOperational, input),
                pre_operational,
                "pre-operational, {input:?}"
            );
            assert_eq!(
                step(Operational, input),
                operational,
                "operational, {input:?}"
            );
            assert_eq!(step(Stopped, input), stopped, "stopped, {input:?}");
        }
    }

    #[test]
    fn nmt_slave_boot_up_precedes_heartbeats() {
        let mut slave = slave(Initialising);
        slave.set_heartbeat(10 * MS, Duration::ZERO);
        assert_eq!(slave.poll_transmit(5 * MS), None, "not while initialising");
        slave.handle(Input::Initialised);
        assert_eq!(slave.poll_timeout(), Some(Duration::ZERO));
        let sent = |slave: &mut Slave, now| slave.poll_transmit(now).map(|f| f.to_string());
        assert_eq!(sent(&mut slave, 5 * MS).unwrap(), "705#00");
        assert_eq!(sent(&mut slave, 14 * MS), None);
        assert_eq!(sent(&mut slave, 15 * MS).unwrap(), "705#7F");
        slave.handle(Input::Command(NmtCommand::Start));
        assert_eq!(sent(&mut slave, 26 * MS).unwrap(), "705#05");
        // On the grid, not 10 ms after the late one; no burst after a pause.
        assert_eq!(slave.poll_timeout(), Some(35 * MS));
        assert_eq!(sent(&mut slave, 99 * MS).unwrap(), "705#05");
        assert_eq!(sent(&mut slave, 99 * MS), None);
        let reset = slave.handle(Input::Command(NmtCommand::ResetNode));
        assert_eq!(reset, Some(Reset::Node));
        slave.handle(Input::Initialised);
        assert_eq!(sent(&mut slave, 100 * MS).unwrap(), "705#00");
    }

    #[test]
    fn nmt_slave_guarding_toggles_and_times_out() {
        let mut slave = slave(PreOperational);
        slave.set_life_time(30 * MS);
        assert!(
            !slave.poll_life(100 * MS),
            "it starts with the first request"
        );
        let answers: Vec<_> = (0..3)
            .map(|n| slave.handle_guard(n * 10 * MS).unwrap().to_string())
            .collect();
        assert_eq!(answers, ["705#7F", "705#FF", "705#7F"]);
        assert_eq!(slave.poll_timeout(), Some(50 * MS));
        assert!(!slave.poll_life(49 * MS));
        assert!(slave.poll_life(50 * MS));
        assert!(!slave.poll_life(51 * MS), "reported once");
        slave.set_heartbeat(10 * MS, 60 * MS);
        assert_eq!(
            slave.handle_guard(60 * MS),
            None,
            "heartbeat has priority over guarding"
        );
    }
}
