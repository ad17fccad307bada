//! What nets see of a servo axis, and request.

use takt_core::device::DeviceStatus;
use takt_core::device::homing::POWER;
use takt_rt::cycle::Tick;

use super::ServoAxis;
use super::power::Power;

impl ServoAxis {
    /// Whether a net requests power.
    pub(super) fn power_is_requested(&self) -> bool {
        let io = self.end.interfaces.io.as_ref();
        let power = io.and_then(|io| io.bool_out.get(POWER));
        let given = power.and_then(|power| power.command.read(&self.end.taken.words));
        let cycle = self.end.taken.cycle;
        // Withdrawn with its net, and when the net thread does not answer.
        self.is_fresh && given.is_some_and(|given| given.value && given.is_in_force(cycle))
    }

    /// Whether a net wants it to home, and then, whether it may leave its switch.
    pub(super) fn home_is_wanted(&self) -> Option<bool> {
        let homing = self.end.interfaces.homing.as_ref()?;
        let given = homing.home.read(&self.end.taken.words)?;
        // Withdrawn with its net, and when the net thread does not answer.
        let is_in_force = self.is_fresh && given.is_in_force(self.end.taken.cycle);
        is_in_force.then_some(given.value)
    }

    pub(super) fn report(&mut self, tick: &Tick) {
        let (sensed, has_request) = (self.sensed, !self.is_withheld());
        let status = if sensed.online {
            DeviceStatus::Operational
        } else {
            DeviceStatus::Offline
        };
        self.end.reported.enter(status, tick.scheduled);
        let failure = self.failure.map_or(0, |error| error.number());
        let signals = &mut self.end.reported.signals;
        let known = |value| Some(value).filter(|_| sensed.online);
        if let Some(homing) = &self.end.interfaces.homing {
            homing.homed.report(signals, known(self.is_homed));
            homing.homing.report(signals, known(self.homing.is_some()));
            let step = i32::from(self.step);
            homing
                .step
                .report(signals, Some(step).filter(|_| sensed.online));
            homing.failure.report(signals, Some(i32::from(failure)));
        }
        let Some(io) = &self.end.interfaces.io else {
            return;
        };
        let truths = [sensed.ready, sensed.proximity, self.power == Power::On];
        for (place, value) in io.bool_in.iter().zip(truths) {
            place.report(signals, known(value));
        }
        for place in io.real_in.iter() {
            place.report(signals, Some(self.offset));
        }
        for place in io.bool_out.iter() {
            place.state.report(signals, Some(has_request));
        }
    }
}
