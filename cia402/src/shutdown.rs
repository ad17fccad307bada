//! Removes power from drives that may turn: power is never removed from a motor that can still be braked. One machine
//! for all axes of an arm, or for a single one; it sends nothing itself.
//!
//! ```text
//!        1 standstill                       3 no drive has torque, or too late
//! Brake ─────────────────┬──▶ Disable ───────────────────────────┬──▶ Off
//!   │ 2 too late         │ 1 standstill                          │
//!   └──▶ QuickStop ──────┴───────────────────── 4 too late ──────┘
//! ```
//! All in [`Shutdown::step`].

use std::time::Duration;

use crate::{Goal, State};

/// State of a drive's power stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Power {
    /// No voltage, as far as known.
    Off,
    /// Voltage, but none at the motor.
    On,
    /// It moves or stops the motor.
    Drives,
}

impl From<State> for Power {
    fn from(state: State) -> Self {
        match state {
            State::NotReadyToSwitchOn
            | State::SwitchOnDisabled
            | State::ReadyToSwitchOn
            | State::Fault => Self::Off,
            State::SwitchedOn => Self::On,
            State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive => {
                Self::Drives
            }
        }
    }
}

/// Detects that a motor is at standstill: it moved no more than its play for [`Standstill::TIME`].
#[derive(Clone, Copy, Debug)]
pub struct Standstill {
    play: f64,
    /// 6064h where the motor was last seen to move, and when.
    moved: (i32, Duration),
}

impl Standstill {
    /// Time without motion.
    pub const TIME: Duration = Duration::from_millis(50);
    /// Smallest play, increments: an encoder may rest on an edge.
    const PLAY_MIN: f64 = 2.0;

    /// For a motor that rests within this play, increments of either sign.
    #[must_use]
    pub const fn new(play: f64) -> Self {
        Self {
            play: play.abs().max(Self::PLAY_MIN),
            moved: (0, Duration::ZERO),
        }
    }

    /// Notes the position (6064h) at `now`.
    pub fn note(&mut self, position: i32, now: Duration) {
        let moved = f64::from(position) - f64::from(self.moved.0);
        if moved.abs() > self.play {
            self.moved = (position, now);
        }
    }

    /// Whether the motor is at standstill.
    #[must_use]
    pub const fn is_reached(&self, now: Duration) -> bool {
        now.saturating_sub(self.moved.1).as_nanos() >= Self::TIME.as_nanos()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Motors brake by their targets.
    Brake,
    /// Motors brake by themselves (605Ah).
    QuickStop,
    /// Motors are at standstill; drives close their brakes under torque (605Ch).
    Disable,
    /// Nothing has power.
    Off,
}

/// A shutdown, from the request on.
#[derive(Clone, Copy, Debug)]
pub struct Shutdown {
    phase: Phase,
    since: Duration,
}

impl Shutdown {
    /// Time for motors to reach standstill by their targets; then quick stop.
    pub const BRAKE_WITHIN: Duration = Duration::from_secs(2);
    /// Time for a quick stop; then power is removed.
    pub const QUICK_STOP_WITHIN: Duration = Duration::from_millis(500);
    /// Time for a drive to close its brake and disable operation.
    pub const DISABLE_WITHIN: Duration = Duration::from_millis(500);

    /// Requested at `now`: motors brake by their targets first.
    #[must_use]
    pub const fn new(now: Duration) -> Self {
        Self {
            phase: Phase::Brake,
            since: now,
        }
    }

    /// The goal of all axes at `now`; `None` while their targets brake them. `is_at_rest` is whether no motor moves,
    /// `has_torque` whether a drive still has [`Power::Drives`].
    pub fn step(&mut self, is_at_rest: bool, has_torque: bool, now: Duration) -> Option<Goal> {
        let waited = now.saturating_sub(self.since);
        match self.phase {
            Phase::Brake | Phase::QuickStop if is_at_rest => self.enter(Phase::Disable, now),
            Phase::Brake if waited > Self::BRAKE_WITHIN => self.enter(Phase::QuickStop, now),
            Phase::QuickStop if waited > Self::QUICK_STOP_WITHIN => self.enter(Phase::Off, now),
            Phase::Brake | Phase::QuickStop | Phase::Disable | Phase::Off => {}
        }
        let late = now.saturating_sub(self.since) > Self::DISABLE_WITHIN;
        if self.phase == Phase::Disable && (late || !has_torque) {
            self.enter(Phase::Off, now);
        }
        match self.phase {
            Phase::Brake => None,
            Phase::QuickStop => Some(Goal::QuickStop),
            Phase::Disable => Some(Goal::SwitchedOn),
            Phase::Off => Some(Goal::SwitchOnDisabled),
        }
    }

    const fn enter(&mut self, phase: Phase, now: Duration) {
        self.phase = phase;
        self.since = now;
    }
}

/// The goal of one axis when `goal` is that of all: a runaway axis cannot brake by targets, and a drive without torque
/// has no brake to close, so that [`Goal::SwitchedOn`] would only give it power.
#[must_use]
pub fn axis_goal(goal: Option<Goal>, power: Power, has_run_away: bool) -> Option<Goal> {
    let needs_no_power = goal == Some(Goal::SwitchedOn) && power != Power::Drives;
    if has_run_away || needs_no_power {
        Some(Goal::SwitchOnDisabled)
    } else {
        goal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Goals of a shutdown whose motor rests at a time and whose drive disables operation so long after the request.
    fn goals(rests_ms: u32, disables_ms: u32) -> Vec<(u32, Option<Goal>)> {
        let mut shutdown = Shutdown::new(Duration::ZERO);
        let (mut goals, mut disabling) = (Vec::new(), None);
        for ms in 0..6000 {
            let has_torque = disabling.is_none_or(|since| ms < since + disables_ms);
            let goal = shutdown.step(ms >= rests_ms, has_torque, ms * MS);
            if goal == Some(Goal::SwitchedOn) {
                disabling.get_or_insert(ms);
            }
            if goals.last().is_none_or(|(_, last)| *last != goal) {
                goals.push((ms, goal));
            }
        }
        goals
    }

    #[test]
    fn shutdown_at_standstill_disables_operation_first() {
        let off = Some(Goal::SwitchOnDisabled);
        let switched_on = Some(Goal::SwitchedOn);
        assert_eq!(goals(300, 40), [(0, None), (300, switched_on), (340, off)]);
        // A drive that keeps its torque loses power all the same.
        assert_eq!(goals(0, 9000), [(0, switched_on), (501, off)]);
    }

    #[test]
    fn shutdown_of_a_turning_motor_ends_by_quick_stop() {
        let (quick, off) = (Some(Goal::QuickStop), Some(Goal::SwitchOnDisabled));
        assert_eq!(goals(9000, 0), [(0, None), (2001, quick), (2502, off)]);
        let disabled = [
            (0, None),
            (2001, quick),
            (2100, Some(Goal::SwitchedOn)),
            (2110, off),
        ];
        assert_eq!(goals(2100, 10), disabled);
    }

    #[test]
    fn axis_without_torque_gets_no_power_at_shutdown() {
        let on = Some(Goal::SwitchedOn);
        let off = Some(Goal::SwitchOnDisabled);
        assert_eq!(axis_goal(on, Power::Drives, false), on);
        assert_eq!(axis_goal(on, Power::On, false), off);
        assert_eq!(axis_goal(None, Power::Drives, true), off);
        assert_eq!(axis_goal(None, Power::Off, false), None);
        assert_eq!(Power::from(State::QuickStopActive), Power::Drives);
    }

    #[test]
    fn standstill_begins_after_the_last_motion() {
        let mut motor = Standstill::new(-10.0);
        motor.note(0, Duration::ZERO);
        motor.note(11, 20 * MS);
        // Within the play.
        motor.note(5, 60 * MS);
        assert!(!motor.is_reached(69 * MS));
        assert!(motor.is_reached(70 * MS));
        motor.note(25, 71 * MS);
        assert!(!motor.is_reached(72 * MS));
    }
}
