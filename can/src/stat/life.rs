//! The life cycle of one node: its NMT state as commanded and reported, PDOs that it must not send in that state, and
//! states that contradict each other, as of two nodes with one number.

use std::time::Duration;

use super::Interleaved;
use crate::canopen::{NmtCommand, NmtState};

/// Time after a change of state in which PDOs of the state before may still be sent.
const GRACE: Duration = Duration::from_millis(100);

/// How much of a node runs in a state.
const fn rank(state: NmtState) -> u8 {
    match state {
        NmtState::BootUp | NmtState::Stopped | NmtState::Other(_) => 0,
        NmtState::PreOperational => 1,
        NmtState::Operational => 2,
    }
}

/// Life cycle of one node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Life {
    /// State as last commanded or reported, and since when.
    state: Option<(NmtState, Duration)>,
    /// A command was sent since the last report.
    commanded: bool,
    /// Number of changes of the reported state without a command towards Operational. By itself a node only leaves that, by
    /// an error, or enters it once after its start.
    pub flips: u32,
    /// Number of TPDOs outside of Operational; number of the last one, and the state then.
    pub stray_pdos: (u32, Option<(u8, NmtState)>),
    /// Its heartbeats, if they are those of two nodes.
    pub(super) beats: Interleaved,
}

impl Life {
    /// The state as last commanded or reported.
    pub fn state(&self) -> Option<NmtState> {
        self.state.map(|(state, _)| state)
    }

    fn enter(&mut self, state: NmtState, at: Duration) {
        if self.state() != Some(state) {
            self.state = Some((state, at));
        }
    }

    /// Handles a command to the node.
    pub(super) fn command(&mut self, command: NmtCommand, at: Duration) {
        self.commanded = true;
        match command {
            NmtCommand::Start => self.enter(NmtState::Operational, at),
            NmtCommand::Stop => self.enter(NmtState::Stopped, at),
            NmtCommand::EnterPreOperational => self.enter(NmtState::PreOperational, at),
            // What it does afterwards, it reports; some nodes start by themselves.
            NmtCommand::ResetNode | NmtCommand::ResetCommunication => self.state = None,
            NmtCommand::Other(_) => {}
        }
    }

    /// Handles a heartbeat, or an answer to guarding.
    pub(super) fn report(&mut self, state: NmtState, at: Duration) {
        let was_commanded = std::mem::take(&mut self.commanded);
        if matches!(state, NmtState::BootUp | NmtState::Other(_)) {
            self.state = None;
            self.beats = Interleaved::default();
            return;
        }
        self.beats.record(at);
        let is_upward = self
            .state()
            .is_some_and(|before| rank(state) > rank(before));
        self.flips += u32::from(is_upward && !was_commanded);
        self.enter(state, at);
    }

    /// Handles a TPDO.
    pub(super) fn pdo(&mut self, number: u8, at: Duration) {
        if let Some((state @ (NmtState::Stopped | NmtState::PreOperational), since)) = self.state
            && at.saturating_sub(since) > GRACE
        {
            let count = self.stray_pdos.0.saturating_add(1);
            self.stray_pdos = (count, Some((number, state)));
        }
    }
}
