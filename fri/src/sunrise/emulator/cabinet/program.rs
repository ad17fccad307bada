//! What ends and begins overlays: timing, drives, the robot program. It judges no command.

use super::{AWAIT, Added, Cabinet, LOG_LEN, Left};
use crate::sunrise::emulator::{Control, Leave, Program};
use crate::sunrise::wire::{Quality, Safety, SessionState};

impl Cabinet {
    pub(super) fn close_period(&mut self, is_void: bool) {
        let latency = self.latency.take();
        match latency {
            Some(_) => self.misses = 0,
            None if is_void => return,
            None => self.misses = self.misses.saturating_add(1),
        }
        self.window.record(latency);
        if self.misses >= self.misses_max() {
            // Who answers after such a silence may be somebody else, with another counter.
            self.tracker.forget();
        }
    }

    pub(super) fn judge_timing(&mut self) {
        let forced = self.config.faults.quality;
        let rank = i32::from(self.window.rank(&self.config.timing));
        self.quality = forced.unwrap_or_else(|| rank.into());
        let answer_rate = self.window.answer_rate();
        if self.misses >= self.misses_max() {
            let cycles = self.misses;
            let period = self.grid.period() * self.multiplier();
            let span_ms = period.as_secs_f64() * 1e3 * f64::from(cycles);
            self.leave(Leave::Misses { cycles, span_ms });
        } else if !self.is_good() {
            self.leave(Leave::Quality { answer_rate });
        }
        if !self.is_commanding() {
            self.state = self.monitoring();
        }
    }

    fn is_good(&self) -> bool {
        self.quality.code() >= Quality::Good.code()
    }

    fn monitoring(&self) -> SessionState {
        if self.is_good() && self.misses < self.misses_max() {
            SessionState::MonitoringReady
        } else {
            SessionState::MonitoringWait
        }
    }

    pub(super) fn judge_drives(&mut self) {
        if !self.has_power() {
            self.leave(Leave::Power);
        } else if self.safety != Safety::Normal {
            self.leave(Leave::Safety(self.safety));
        }
    }

    pub(super) fn run_program(&mut self) {
        let Program::Auto { overlay, .. } = self.config.program else {
            return;
        };
        let (now, Some(at)) = (self.grid.time(), self.program_at) else {
            return;
        };
        if self.is_commanding() || now < at {
            return;
        }
        if self.state == SessionState::MonitoringReady {
            // Refused while the robot brakes or has no power: the program tries again in the next period.
            let _refused = self.start_overlay(overlay);
        } else if now >= at + AWAIT {
            let answer_rate = self.window.answer_rate();
            self.note(Leave::Await { answer_rate });
        }
    }

    pub(super) fn leave(&mut self, reason: Leave) {
        if !self.is_commanding() {
            return;
        }
        if self.overlay.control != Control::Position {
            self.arm.take_up();
        }
        self.added = Added::default();
        self.state = self.monitoring();
        self.note(reason);
    }

    fn note(&mut self, reason: Leave) {
        let at = self.grid.time();
        self.program_at = match self.config.program {
            Program::Manual => None,
            Program::Auto { restart, .. } => restart.map(|pause| at + pause),
        };
        if self.log.len() == LOG_LEN {
            self.log.pop_front();
        }
        self.log.push_back(Left { at, reason });
        self.falls += 1;
    }
}
