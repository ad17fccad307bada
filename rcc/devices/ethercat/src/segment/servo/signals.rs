//! What nets see of a servo axis, and request.

use takt_core::device::DeviceStatus;
use takt_rt::cycle::Tick;

use super::ServoAxis;

impl ServoAxis {
    /// Whether a net wants it to home, and then, whether it may leave its switch.
    pub(super) fn home_is_wanted(&self) -> Option<bool> {
        let homing = self.end.interfaces.homing.as_ref()?;
        let given = homing.home.read(&self.end.taken.words)?;
        // Withdrawn with its net, and when the net thread does not answer.
        let is_in_force = self.is_fresh && given.is_in_force(self.end.taken.cycle);
        is_in_force.then_some(given.value)
    }

    pub(super) fn report(&mut self, tick: &Tick) {
        let sensed = self.sensed;
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
        for (place, value) in io.bool_in.iter().zip([sensed.ready, sensed.proximity]) {
            place.report(signals, known(value));
        }
        for place in io.real_in.iter() {
            place.report(signals, Some(self.offset));
        }
    }
}
