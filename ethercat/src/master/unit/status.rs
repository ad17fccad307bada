//! AL status of a slave as last read, and what it means. Reactions are decided elsewhere.

use super::op::{Op, StatePhase};
use crate::{AlState, AlStatus, AlStatusCode};

/// AL status and its code.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::master) struct Status {
    /// Interpreted AL status.
    pub(in crate::master) al: AlStatus,
    pub(in crate::master) code: AlStatusCode,
    /// The lower five bits of AL status as read, for the census.
    pub(in crate::master) shown: u8,
}

impl Status {
    /// Handles AL status as read. The error bit is no error without a code where the controller copies AL control, as
    /// the acknowledgement has the same bit (`mirrors`); nor in INIT, which a slave enters with its errors acknowledged.
    pub(super) fn show(&mut self, status: u16, code: AlStatusCode, mirrors: bool) {
        let mut al = AlStatus::from_raw(status);
        let acknowledgement = mirrors || al.state == AlState::Init;
        al.error &= !(acknowledgement && code == AlStatusCode(0));
        *self = Self {
            al,
            code,
            shown: status.to_le_bytes()[0] & 0x1F,
        };
    }

    /// Starts a state change.
    pub(super) const fn change(&self, wanted: AlState) -> Op {
        // INIT is requested with acknowledgement at once: no previous status is needed.
        let acknowledge = self.al.error && !matches!(wanted, AlState::Init);
        let phase = if acknowledge {
            StatePhase::Acknowledge
        } else {
            StatePhase::Request
        };
        Op::State { wanted, phase }
    }
}
