//! Enabling of a servo axis and its brake, in the order that keeps a load up: the position loop holds before the brake opens, and
//! until it is closed.

use std::time::Duration;

use takt_cia402::{Goal, State};
use takt_device_drives::Order;

use super::{ServoAxis, ServoEvent, ServoFault};
use crate::config::ServoPower;

/// An axis whose target does not change for this time is at rest: it moved less than an increment.
const REST: Duration = Duration::from_millis(50);
/// Time for an amplifier to become ready.
const READY_WITHIN: Duration = Duration::from_secs(2);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Power {
    /// No power, brake closed.
    Off,
    /// Enabled since; the amplifier is not ready yet.
    Enabling(Duration),
    /// The brake opens since.
    Releasing(Duration),
    /// It follows.
    On,
    /// The brake closes since.
    Braking(Duration),
    /// No power, brake closed, until a reset.
    Fault(ServoFault),
}

impl Power {
    pub(super) const fn is_enabled(self) -> bool {
        !matches!(self, Self::Off | Self::Fault(_))
    }

    pub(super) const fn is_released(self) -> bool {
        matches!(self, Self::Releasing(_) | Self::On)
    }

    /// Whether the position loop runs.
    pub(super) const fn is_controlled(self) -> bool {
        matches!(self, Self::Releasing(_) | Self::On | Self::Braking(_))
    }

    /// The state of a drive that corresponds to it.
    pub(super) const fn state(self) -> State {
        match self {
            Self::Off => State::SwitchOnDisabled,
            Self::Enabling(_) => State::SwitchedOn,
            Self::Releasing(_) | Self::On | Self::Braking(_) => State::OperationEnabled,
            Self::Fault(_) => State::Fault,
        }
    }
}

impl ServoAxis {
    /// Removes its power at once.
    pub(super) fn fail(&mut self, fault: ServoFault) {
        if self.power.is_enabled() {
            self.power = Power::Fault(fault);
            self.note(ServoEvent::Fault(fault));
        }
    }

    /// Whether it must not move, as no net wants it to have power. Its arm brakes, and then its brake closes.
    pub(in crate::segment) fn is_withheld(&self) -> bool {
        self.config.power == ServoPower::OnRequest && !self.power_is_requested()
    }

    /// Whether its target rests.
    fn is_at_rest(&self, now: Duration) -> bool {
        self.homing.is_none() && now.saturating_sub(self.moved) >= REST
    }

    pub(super) fn step_power(&mut self, order: Order, now: Duration) {
        if !self.sensed.online {
            self.lose();
            return;
        }
        if let Some(goal) = order.goal {
            self.is_wanted_on = goal == Goal::OperationEnabled;
            if goal == Goal::SwitchOnDisabled && self.power.is_enabled() {
                self.power = Power::Off;
            }
        }
        let is_latched = self.power == Power::Fault(ServoFault::NotFollowing);
        if order.reset && matches!(self.power, Power::Fault(_)) && !is_latched {
            self.power = Power::Off;
        }
        let is_open = self.sensed.encoder.open_circuit;
        let was_open = std::mem::replace(&mut self.was_open, is_open);
        if is_open && self.power.is_enabled() {
            self.fail(ServoFault::OpenCircuit);
        } else if is_open && !was_open {
            self.note(ServoEvent::Fault(ServoFault::OpenCircuit));
        }
        let passed = |since: Duration| now.saturating_sub(since);
        let brake_time = self.config.brake_time;
        let is_withheld = self.is_withheld();
        let is_wanted_on = self.is_wanted_on && !is_withheld;
        self.power = match self.power {
            Power::Off if is_wanted_on && !is_open => Power::Enabling(now),
            Power::Enabling(_) | Power::Releasing(_) if !is_wanted_on => Power::Off,
            Power::Enabling(since) if self.sensed.ready && passed(since) >= brake_time => {
                Power::Releasing(now)
            }
            Power::Releasing(since) if passed(since) >= brake_time => Power::On,
            Power::On if !self.is_wanted_on => Power::Braking(now),
            Power::On if is_withheld && self.is_at_rest(now) => Power::Braking(now),
            Power::Braking(since) if passed(since) >= brake_time => Power::Off,
            state @ (Power::Off
            | Power::Enabling(_)
            | Power::Releasing(_)
            | Power::On
            | Power::Braking(_)
            | Power::Fault(_)) => state,
        };
        let late = matches!(self.power, Power::Enabling(since) if passed(since) > READY_WITHIN);
        let lost = self.power.is_controlled() && !self.sensed.ready;
        if late || lost {
            self.fail(ServoFault::NotReady);
        }
    }
}
