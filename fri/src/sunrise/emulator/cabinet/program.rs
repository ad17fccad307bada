//! Causes for overlays to begin and end: timing, drives, the robot program. Commands are checked elsewhere.

use super::{AWAIT, Added, Cabinet, Exit, LOG_LEN};
use crate::sunrise::emulator::{Control, ExitReason, Program};
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
            // After such a silence another client may answer, with another counter.
            self.tracker.forget();
        }
    }

    pub(super) fn check_timing(&mut self) {
        let forced = self.config.faults.quality;
        let rank = i32::from(self.window.rank(&self.config.timing));
        self.quality = forced.unwrap_or_else(|| rank.into());
        let now = self.grid.time();
        self.good_since = self.good_since.or(Some(now)).filter(|_| self.is_good());
        let answer_rate = self.window.answer_rate();
        if self.misses >= self.misses_max() {
            let cycles = self.misses;
            let period = self.grid.period() * self.multiplier();
            let span_ms = period.as_secs_f64() * 1e3 * f64::from(cycles);
            self.leave(ExitReason::Misses { cycles, span_ms });
        } else if !self.is_good() {
            self.leave(ExitReason::Quality { answer_rate });
        }
        if !self.is_commanding() {
            self.state = self.monitoring();
        }
    }

    fn is_good(&self) -> bool {
        self.quality.code() >= Quality::Good.code()
    }

    fn monitoring(&self) -> SessionState {
        let wait = self.config.monitoring_wait;
        let is_settled = self
            .good_since
            .is_some_and(|since| self.grid.time() >= since + wait);
        if is_settled && self.misses < self.misses_max() {
            SessionState::MonitoringReady
        } else {
            SessionState::MonitoringWait
        }
    }

    pub(super) fn check_drives(&mut self) {
        if !self.has_power() {
            self.leave(ExitReason::Power);
        } else if self.safety != Safety::Normal {
            self.leave(ExitReason::Safety(self.safety));
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
            self.note(ExitReason::Await { answer_rate });
        }
    }

    pub(super) fn leave(&mut self, reason: ExitReason) {
        if !self.is_commanding() {
            return;
        }
        if self.overlay.control != Control::Position {
            self.arm.sync_set_point();
        }
        self.added = Added::default();
        self.state = self.monitoring();
        self.note(reason);
    }

    fn note(&mut self, reason: ExitReason) {
        let at = self.grid.time();
        self.program_at = match self.config.program {
            Program::Manual => None,
            Program::Auto { restart, .. } => restart.map(|pause| at + pause),
        };
        if self.log.len() == LOG_LEN {
            self.log.pop_front();
        }
        self.log.push_back(Exit { at, reason });
        self.exits += 1;
    }
}
