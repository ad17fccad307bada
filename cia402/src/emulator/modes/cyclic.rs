//! Cyclic synchronous modes and interpolated position: a set-point per cycle of the master, with
//! interpolation over 60C2h and the offsets 60B0h to 60B2h. A late set-point is waited for at the
//! last one; nothing is extrapolated.

use crate::dictionary::Dictionary;

use super::super::objects::Keys;
use super::super::power::Stop;
use super::super::quirks::Quirks;
use super::{CSP, CST, CSV, Follow, IP, Modes, Said, View, extend};

/// The set-point under way.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cyclic {
    /// Where the demand is to be at the end of the interpolation time; `None` before the first.
    to: Option<f64>,
    /// Time left of it, s.
    left: f64,
    /// Time since the last one; `None` before the first, s.
    waited: Option<f64>,
}

/// The interpolation time period 60C2h, s; zero for none.
fn period(d: &Dictionary, k: &Keys) -> f64 {
    f64::from(d.get(k.interpolation_value)) * 10_f64.powi(d.get(k.interpolation_index).into())
}

impl Modes {
    pub(super) fn cyclic(&mut self, d: &Dictionary, k: &Keys, quirks: &Quirks, see: &View) -> Said {
        let bits = see.word.raw() & 0x0070;
        let follows = match self.mode {
            IP => bits & 0x0010 != 0,
            _ => !quirks.cyclic_needs_bits_4_to_6 || bits == 0x0070,
        };
        if !follows {
            self.cyclic = Cyclic::default();
            return self.stop(Stop::Ramp, d, k, see);
        }
        let mut said = match self.mode {
            CSV => self.velocity(d, k, see),
            CST => {
                let target = i32::from(d.get(k.target_torque)) + i32::from(d.get(k.torque_offset));
                self.torque = f64::from(target);
                Said::new(Follow::Torque)
            }
            _ => self.position(d, k, see),
        };
        if self.mode != IP {
            said.missing = self.watch(d, k, quirks, see);
        }
        said.bit_12 = true;
        said
    }

    fn velocity(&mut self, d: &Dictionary, k: &Keys, see: &View) -> Said {
        let target = f64::from(d.get(k.target_velocity)) + f64::from(d.get(k.velocity_offset));
        self.ramp.velocity = target.clamp(-see.velocity_max, see.velocity_max);
        let mut said = Said::new(Follow::Velocity);
        said.limited = target.abs() > see.velocity_max;
        said
    }

    fn position(&mut self, d: &Dictionary, k: &Keys, see: &View) -> Said {
        let mut said = Said::new(Follow::Position);
        let (low, high) = (d.get(k.limit_min), d.get(k.limit_max));
        if see.set_point || self.cyclic.to.is_none() {
            let (raw, offset) = match self.mode {
                CSP => (d.get(k.target_position), d.get(k.position_offset)),
                _ => (d.get(k.interpolation_target), 0),
            };
            let target = extend(self.ramp.position, raw.wrapping_add(offset));
            self.cyclic.to = Some(target);
            self.cyclic.left = period(d, k);
        }
        let Some(mut to) = self.cyclic.to else {
            return said;
        };
        if (low, high) != (0, 0) && low <= high {
            let clamped = to.clamp(low.into(), high.into());
            said.limited = clamped.total_cmp(&to).is_ne();
            to = clamped;
        }
        // On the straight line to the end of the period; there already if it is over.
        let share = if self.cyclic.left > see.dt {
            see.dt / self.cyclic.left
        } else {
            1.0
        };
        let way = (to - self.ramp.position) * share;
        let most = see.velocity_max * see.dt;
        self.ramp.velocity = way.clamp(-most, most) / see.dt;
        self.ramp.position += self.ramp.velocity * see.dt;
        self.cyclic.left -= see.dt;
        said
    }

    /// Counts periods without a set-point; returns whether there are too many.
    fn watch(&mut self, d: &Dictionary, k: &Keys, quirks: &Quirks, see: &View) -> bool {
        let period = period(d, k).max(see.dt);
        if see.set_point {
            self.cyclic.waited = Some(0.0);
        } else if let Some(waited) = &mut self.cyclic.waited {
            *waited += see.dt;
        }
        let waited = self.cyclic.waited.unwrap_or(0.0);
        quirks
            .missing_set_points
            .is_some_and(|most| waited > period * (f64::from(most) + 1.0))
    }
}
