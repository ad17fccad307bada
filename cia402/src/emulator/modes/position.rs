//! Profile position mode: the hand-shake of set-points and the motion from one to the next. The ramp itself is
//! elsewhere.

use crate::dictionary::Dictionary;

use super::super::objects::Keys;
use super::super::ramp::Bounds;
use super::{Follow, ModeOutput, Modes, View, extend, held};

/// A set-point as it was latched.
#[derive(Clone, Copy, Debug)]
struct Target {
    position: f64,
    bounds: Bounds,
    end_velocity: f64,
}

/// The current set-point and the next one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SetPoints {
    active: Option<Target>,
    next: Option<Target>,
    /// Bit 4 of the last controlword.
    bit: bool,
    acknowledged: bool,
    /// The next set-point starts without a stop.
    blends: bool,
    limited: bool,
}

impl Modes {
    pub(super) fn profile_position(&mut self, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        self.take_set_point(d, k, see);
        if let Some(active) = self.set_points.active {
            let next = self.set_points.next;
            let passes = next.is_some() && self.set_points.blends;
            // Only a target ahead in the same direction can be passed.
            let ahead = next.is_some_and(|n| {
                (n.position - active.position) * (active.position - self.ramp.position) > 0.0
            });
            let end = if passes && ahead {
                active.bounds.velocity
            } else {
                active.end_velocity
            };
            let left = active.position - self.ramp.position;
            if passes && ahead && left.abs() <= self.ramp.velocity.abs() * see.dt {
                self.set_points.active = self.set_points.next.take();
                return self.profile_position(d, k, see);
            }
            let to = active.position;
            self.ramp.toward_position(to, end, &active.bounds, see.dt);
            if self.ramp.is_at(to)
                && let Some(next) = self.set_points.next.take()
            {
                self.set_points.active = Some(next);
            }
        } else {
            (self.ramp.velocity, self.ramp.acceleration) = (0.0, 0.0);
        }
        let target = self.set_points.active.map(|target| target.position);
        let window = d.get(k.position_window);
        let within = target.is_none_or(|target| {
            let off = window == u32::MAX;
            off || (see.position - target).abs() <= f64::from(window)
        });
        let within = within && self.set_points.next.is_none();
        let mut output = ModeOutput::new(Follow::Position);
        output.reached = held(
            &mut self.inside,
            within,
            d.get(k.position_window_time),
            see.dt,
        );
        output.bit_12 = self.set_points.acknowledged;
        output.limited = self.set_points.limited;
        output
    }

    /// The hand-shake of bits 4 (new set-point), 5 (change at once), 6 (relative) and 9 (change on
    /// set-point).
    fn take_set_point(&mut self, d: &Dictionary, k: &Keys, see: &View) {
        let word = see.word.raw();
        let bit = word & 0x0010 != 0;
        let was = std::mem::replace(&mut self.set_points.bit, bit);
        let rises = bit && !was;
        if rises {
            let at_once = word & 0x0020 != 0;
            let target = self.latch(d, k, see, word & 0x0040 != 0);
            let moving = self
                .set_points
                .active
                .is_some_and(|active| !self.ramp.is_at(active.position));
            if at_once || !moving {
                self.set_points.active = Some(target);
                self.set_points.next = None;
                self.set_points.acknowledged = true;
            } else if self.set_points.next.is_none() {
                self.set_points.next = Some(target);
                self.set_points.blends = word & 0x0200 != 0;
                self.set_points.acknowledged = true;
            }
            self.inside = 0.0;
        } else if !bit && self.set_points.next.is_none() {
            self.set_points.acknowledged = false;
        }
    }

    fn latch(&mut self, d: &Dictionary, k: &Keys, see: &View, relative: bool) -> Target {
        let raw = d.get(k.target_position);
        let last = self.set_points.next.or(self.set_points.active);
        let demand = self.ramp.position;
        let position = if relative {
            let from = match d.get(k.positioning_option) & 0x03 {
                0 => last.map_or(demand, |target| target.position),
                1 => demand,
                _ => see.position,
            };
            from + f64::from(raw)
        } else {
            extend(demand, raw)
        };
        let (low, high) = (d.get(k.limit_min), d.get(k.limit_max));
        let clamped = if (low, high) == (0, 0) || low > high {
            position
        } else {
            position.clamp(low.into(), high.into())
        };
        self.set_points.limited = clamped.total_cmp(&position).is_ne();
        Target {
            position: clamped,
            bounds: Self::bounds(d, k, see),
            end_velocity: f64::from(d.get(k.end_velocity)),
        }
    }
}
