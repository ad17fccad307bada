//! What nets see of a servo axis, and command: an interface of inputs and outputs.

use takt_core::device::DeviceStatus;
use takt_rt::cycle::Tick;

use super::ServoAxis;

impl ServoAxis {
    /// Whether a net wants it to home.
    pub(super) fn home_is_wanted(&self) -> bool {
        let io = self.end.interfaces.io.as_ref();
        let home = io.and_then(|io| io.bool_out.first());
        let given = home.and_then(|home| home.command.read(&self.end.taken.words));
        let cycle = self.end.taken.cycle;
        // Withdrawn with its net, and when the net thread does not answer.
        self.is_fresh && given.is_some_and(|given| given.value && given.is_in_force(cycle))
    }

    pub(super) fn report(&mut self, tick: &Tick) {
        let (sensed, wanted) = (self.sensed, self.wanted);
        let status = if sensed.online {
            DeviceStatus::Operational
        } else {
            DeviceStatus::Offline
        };
        self.end.reported.enter(status, tick.scheduled);
        let Some(io) = &self.end.interfaces.io else {
            return;
        };
        let is_homing = self.homing.is_some();
        let failure = self.failure.map_or(0, |error| error.number());
        let signals = &mut self.end.reported.signals;
        let truths = [self.is_homed, is_homing, sensed.ready, sensed.proximity];
        for (place, value) in io.bool_in.iter().zip(truths) {
            place.report(signals, Some(value).filter(|_| sensed.online));
        }
        for (place, value) in io.real_in.iter().zip([f64::from(failure), self.offset]) {
            place.report(signals, Some(value));
        }
        for place in io.bool_out.iter() {
            place.state.report(signals, Some(wanted));
        }
    }
}
