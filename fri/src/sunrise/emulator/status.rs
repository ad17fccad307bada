//! What other threads see of a served cabinet: its words for the status that both generations share.

use super::cabinet::Cabinet;
use super::leave::Leave;
use crate::emulator::{Contact, LineFaults, Served, Shown, Status};
use crate::sunrise::wire::{Quality, SessionState};
use std::time::Duration;

/// Live state of a cabinet in [`super::serve`], shared by an `Arc`.
pub type CabinetStatus = Status<Cabinet>;

impl Served for Cabinet {
    type State = SessionState;
    type Quality = Quality;
    type Leave = Leave;

    fn transmit(&mut self, now: Duration, buf: &mut [u8]) -> Option<usize> {
        self.poll_transmit(now, buf)
    }

    fn take(&mut self, bytes: &[u8], now: Duration) {
        let _malformed = self.handle_datagram(bytes, now);
    }

    fn due(&self) -> Duration {
        self.poll_timeout()
    }

    fn state_of(code: i32) -> SessionState {
        code.into()
    }

    fn quality_of(code: i32) -> Quality {
        code.into()
    }

    fn leave_of(words: [u64; 3]) -> Option<Leave> {
        Leave::from_words(words)
    }

    fn shown(&self) -> Shown {
        let counters = self.counters();
        Shown {
            state: self.state().code(),
            quality: self.quality().code(),
            has_power: self.has_power(),
            sent: counters.sent,
            answers: counters.answers,
            missed: counters.missed,
            old: counters.old,
            malformed: counters.malformed,
            stalls: counters.stalls,
            commanded: self.set_point(),
            measured: self.joints(),
            force: self.force(),
            falls: self.falls(),
        }
    }

    fn last_leave(&self) -> Option<[u64; 3]> {
        self.log().next_back().map(|left| left.reason.to_words())
    }

    fn switch(&mut self, power: bool) {
        self.set_power(power);
    }

    fn lines(&mut self) -> [&mut LineFaults; 2] {
        let faults = self.faults_mut();
        [&mut faults.to_client, &mut faults.to_cabinet]
    }

    fn contact(&mut self) -> &mut Option<Contact> {
        self.contact_mut()
    }
}
