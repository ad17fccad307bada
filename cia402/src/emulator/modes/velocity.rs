//! Velocity mode VL, the mode of frequency converters: speeds in revolutions per minute, ramps as a change of speed in
//! a time. It does not control position.
//!
//! | bit of 6040h | low | high |
//! |---|---|---|
//! | 4 enable ramp | stop with the deceleration | follow the ramp |
//! | 5 unlock ramp | the ramp stays where it is | the ramp runs |
//! | 6 reference ramp | towards zero | towards 6042h |

use crate::dictionary::{Dictionary, Key};

use super::super::objects::Keys;
use super::super::ramp::Bounds;
use super::{Follow, ModeOutput, Modes, View};

/// rpm of a value in the unit of VL, by 604Ch.
fn dimension(d: &Dictionary, k: &Keys) -> f64 {
    let (numerator, denominator) = (d.get(k.vl_numerator), d.get(k.vl_denominator));
    let factor = f64::from(numerator) / f64::from(denominator);
    if factor.is_finite() && numerator != 0 {
        factor
    } else {
        1.0
    }
}

/// User units/s of one rpm.
fn of_rpm(see: &View) -> f64 {
    see.turn / 60.0
}

/// What 6043h and 6044h show: the unit of VL, saturated to 16 bits.
pub(in super::super) fn shown(d: &Dictionary, k: &Keys, turn: f64, velocity: f64) -> i16 {
    let value = velocity / (turn / 60.0) / dimension(d, k);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "saturates, as a measurement does"
    )]
    let shown = value.round() as i16;
    shown
}

impl Modes {
    pub(super) fn converter_velocity(
        &mut self,
        d: &Dictionary,
        k: &Keys,
        see: &View,
    ) -> ModeOutput {
        let bit = |n: u16| see.word.raw() >> n & 1 == 1;
        let unit = dimension(d, k) * of_rpm(see);
        let rate = |speed: Key<u32>, time: Key<u16>| {
            let per_second = f64::from(d.get(speed)) / f64::from(d.get(time).max(1));
            (per_second * unit).abs().max(1.0)
        };
        let bounds = Bounds {
            velocity: see.velocity_max,
            acceleration: rate(k.vl_acceleration_speed, k.vl_acceleration_time),
            deceleration: rate(k.vl_deceleration_speed, k.vl_deceleration_time),
            jerk: None,
        };
        let target = f64::from(d.get(k.vl_target));
        let (low, high) = (f64::from(d.get(k.vl_min)), f64::from(d.get(k.vl_max)));
        let amount = target.abs().max(low).min(high.max(low));
        let limited = target.abs().total_cmp(&amount).is_ne() && target.abs() > 0.0;
        // A target of zero gives no direction for the minimum speed.
        let wanted = if target.abs() > 0.0 {
            amount.copysign(target) * unit
        } else {
            0.0
        };
        let target = if bit(4) && bit(6) { wanted } else { 0.0 };
        let frozen = bit(4) && !bit(5);
        let target = if frozen { self.ramp.velocity } else { target };
        self.ramp.toward_velocity(target, &bounds, see.dt);
        let mut output = ModeOutput::new(Follow::Velocity);
        output.reached = (self.ramp.velocity - wanted).abs() < 1e-6 * wanted.abs().max(1.0);
        output.limited = limited;
        output
    }
}
