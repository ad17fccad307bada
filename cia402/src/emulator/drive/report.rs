//! Reports the statusword and the actual values of an axis to its master. Nothing is decided here.

use super::*;

impl Drive {
    /// Writes the objects that the master reads.
    pub(super) fn report(&mut self, d: &mut Dictionary, output: &ModeOutput, motion: Motion) {
        let k = self.keys;
        let ramp = self.modes.ramp;
        let rated = self.motor.config().rated_torque / 1000.0;
        let position = self.position();
        let velocity = self.motor.velocity * self.scale;
        let increments = f64::from(self.motor.config().increments) / std::f64::consts::TAU;
        let torque = self.motor.torque / rated;
        let next_record = self.modes.next_record(d, &k);
        d.set(k.buffer_position, next_record);
        d.set(k.mode_display, self.modes.mode);
        d.set(k.position_actual, wrap(position));
        d.set(k.position_internal, wrap(self.motor.position * increments));
        d.set(k.velocity_actual, wrap(velocity));
        d.set(k.torque_actual, short(torque));
        d.set(k.current_actual, short(torque));
        d.set(k.position_demand, wrap(ramp.position));
        let internal = (ramp.position - self.origin) / self.scale * increments;
        d.set(k.position_demand_internal, wrap(internal));
        d.set(k.velocity_demand, wrap(ramp.velocity));
        d.set(k.torque_demand, short(self.modes.torque));
        d.set(k.following_error, wrap(ramp.position - position));
        d.set(k.dc_link, milli(self.dc_link));
        let turn = self.scale * std::f64::consts::TAU;
        let vl = [(k.vl_demand, ramp.velocity), (k.vl_actual, velocity)];
        for (key, velocity) in vl {
            let shown = shown(d, &k, turn, velocity);
            d.set(key, shown);
        }
        let switches = self.switches();
        let inputs = u32::from(switches.negative)
            | u32::from(switches.positive) << 1
            | u32::from(switches.home) << 2
            | u32::from(self.interlock) << 3
            | u32::from(self.inputs) << 16;
        d.set(k.digital_inputs, inputs);
        d.set(k.status_word, self.status(output, motion));
    }

    fn status(&self, output: &ModeOutput, motion: Motion) -> u16 {
        let state = self.power.state;
        let mut word = state.status_bits();
        if self.quirks.sod_as_0020 && state == State::SwitchOnDisabled {
            word = 0x0020;
        }
        let following = motion == Motion::Follow;
        let outside = self.guards.is_outside() && self.modes.mode != crate::emulator::modes::HM;
        let (low, high) = DC_LINK;
        let hides_follow = self.quirks.no_follow_bit && (8..=11).contains(&self.modes.mode);
        for (bit, so) in [
            (4, (low..=high).contains(&self.dc_link)),
            (7, self.motor.heat > WARM),
            (9, !self.local && !self.quirks.never_remote),
            (
                10,
                (output.reached && following)
                    || self.is_stopped(motion)
                    || (self.quirks.reached_in_fault && state == State::Fault),
            ),
            (11, output.limited || self.servo.limited),
            (12, output.bit_12 && following && !hides_follow),
            (13, (output.bit_13 || outside) && following),
        ] {
            word |= u16::from(so) << bit;
        }
        word
    }

    /// Target reached during a held quick stop: the motor has stopped.
    fn is_stopped(&self, motion: Motion) -> bool {
        matches!(motion, Motion::Stopping(_)) && self.is_at_rest()
    }
}

/// Thousandths of a positive number.
pub(super) fn milli(value: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates, as a measurement does"
    )]
    let milli = (value * 1000.0).round() as u32;
    milli
}

/// Per mille as 16 bits carry it.
fn short(value: f64) -> i16 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "saturates, as a measurement does"
    )]
    let short = value.round() as i16;
    short
}
