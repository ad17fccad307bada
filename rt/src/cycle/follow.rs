//! Keeps a cycle in phase with a device's clock.
//!
//! It measures nothing: the device's driver does, and passes its servo's estimate by a
//! [`latest`](crate::latest) cell. A net thread thus follows a device of another thread in the same way as
//! a driver thread its own.

use super::grid::{Grid, Tick};
use crate::{
    Nanos,
    flight::FlightRecorder,
    latest::LatestReader,
    servo::{Estimate, State},
};

/// A clock to follow: where its estimates come from, and the phase to keep.
#[derive(Debug)]
pub struct Follow {
    estimates: LatestReader<Estimate>,
    phase: Nanos,
    /// The newest estimate that could be followed. If the clock is lost, the cycle continues with this
    /// one: its rate is the best guess and causes no jump.
    line: Estimate,
    /// State of the newest estimate, as last recorded.
    state: State,
}

impl Follow {
    /// Follows the clock of `estimates` so that slots begin `phase` after the instants at which it shows
    /// whole multiples of the cycle's period: 300 µs after SYNC0, if the clock's zero is such a SYNC0 and
    /// its period the cycle's or a whole multiple of it.
    pub fn new(estimates: LatestReader<Estimate>, phase: Nanos) -> Self {
        Self {
            estimates,
            phase,
            line: Estimate::default(),
            state: State::Unlocked,
        }
    }

    /// Reads the newest estimate and moves the next slot, at `now`.
    pub(super) fn steer(&mut self, grid: &mut Grid, now: Nanos, flight: Option<&FlightRecorder>) {
        let newest = self.estimates.read();
        let state = if newest.state.is_followed() && !newest.is_valid_at(now) {
            State::Unlocked
        } else {
            newest.state
        };
        if newest.is_valid_at(now) {
            self.line = newest;
        }
        if self.line.state.is_followed() {
            grid.steer(&self.line, self.phase);
        }
        if state != self.state {
            self.state = state;
            if let Some(flight) = flight {
                flight.note(grid.index, "clock", state.as_str(), newest.uncertainty.0);
            }
        }
    }

    /// Distance of the wake-up of `tick` from its nominal time on the device's clock, while that is known.
    pub(super) fn phase_error(&self, grid: &Grid, tick: &Tick) -> Option<Nanos> {
        let error = || self.line.phase_error(tick.woken, grid.period(), self.phase);
        self.line.is_valid_at(tick.woken).then(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latest::latest;
    use std::time::Duration;

    fn estimate(state: State, remote: i64, expires: i64) -> Estimate {
        Estimate {
            state,
            remote: Nanos(remote),
            expires: Nanos(expires),
            ..Estimate::default()
        }
    }

    /// Deadlines after each estimate, of a grid at multiples of 100 000.
    fn deadlines(estimates: &[Estimate], flight: &FlightRecorder) -> Vec<i64> {
        let (mut writer, reader) = latest(1, Estimate::default);
        let mut follow = Follow::new(reader, Nanos::ZERO);
        let mut grid = Grid::new(Nanos::ZERO, Duration::from_micros(100));
        let mut found = Vec::new();
        for &estimate in estimates {
            writer.write(estimate);
            let now = grid.next(grid.deadline()).woken;
            follow.steer(&mut grid, now, Some(flight));
            found.push(grid.deadline().0);
        }
        found
    }

    #[test]
    fn follow_requires_lock_and_keeps_lost_clock() {
        let flight = FlightRecorder::new(8);
        let far = i64::MAX;
        let found = deadlines(
            &[
                estimate(State::Unlocked, 100, far),
                estimate(State::Jump, 100, far),
                estimate(State::Locked, 100, far), // 100 ns ahead: slots come 100 ns sooner
                estimate(State::Jump, 5_000, far), // lost: the line of before
                estimate(State::Holdover, 200, far), // found again
                estimate(State::Stable, 400, 1_000), // long out of date
            ],
            &flight,
        );
        assert_eq!(
            found,
            [100_000, 200_000, 299_900, 399_900, 499_800, 599_800]
        );
        let notes: Vec<_> = flight.entries().map(|entry| entry.event).collect();
        assert_eq!(notes, ["jump", "locked", "jump", "holdover", "unlocked"]);
    }

    #[test]
    fn follow_reports_phase_error_of_known_clock() {
        let (mut writer, reader) = latest(1, Estimate::default);
        let mut follow = Follow::new(reader, Nanos(30));
        let mut grid = Grid::new(Nanos::ZERO, Duration::from_nanos(1_000));
        let tick = grid.next(Nanos(40));
        assert_eq!(follow.phase_error(&grid, &tick), None);
        writer.write(estimate(State::Locked, 0, 100));
        follow.steer(&mut grid, Nanos(50), None);
        assert_eq!(follow.phase_error(&grid, &tick), Some(Nanos(10)));
        let late = Tick {
            woken: Nanos(100),
            ..tick
        };
        assert_eq!(follow.phase_error(&grid, &late), None);
    }
}
