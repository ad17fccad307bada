//! Cyclic synchronous modes and interpolated position: a set-point per cycle of the master, with
//! interpolation over 60C2h and the offsets 60B0h to 60B2h. A late set-point is waited for at the
//! last one; nothing is extrapolated. Interpolated position may have a buffer of records (60C4h).

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
    /// Time left of it, s; below zero it is over for so long.
    left: f64,
    /// How long before the end of an interpolation the next set-point is expected, s: as late as they were.
    margin: f64,
    /// Time since the last one; `None` before the first, s.
    waited: Option<f64>,
}

/// What of its distance from the phase of set-points the drive's own phase goes with each of them.
const PHASE_GAIN: f64 = 0.1;
/// What the margin keeps with each set-point.
const MARGIN_KEEPS: f64 = 0.999;

impl Cyclic {
    /// A set-point for the end of a period of so many s came. The drive follows the mean phase of SYNC, not each of
    /// them: one that comes early is begun from where the demand is and takes longer, and for those that come late
    /// there is a margin, so that the demand never stands. What is no jitter (a first set-point, one that was
    /// missing, another period than 60C2h says) begins the phase anew.
    fn begin(&mut self, to: f64, period: f64) {
        let jitter = self.to.is_some() && self.left.abs() < period / 2.0;
        self.to = Some(to);
        if !jitter {
            (self.left, self.margin) = (period, 0.0);
            return;
        }
        let late = (-self.left).max(0.0);
        self.margin = (self.margin * MARGIN_KEEPS + late).min(period / 4.0);
        let off = self.left - self.margin;
        self.left = period + self.margin + off * (1.0 - PHASE_GAIN);
    }
}

/// Places for records of interpolated position, as 60C4h:01 tells.
const PLACES: usize = 16;

/// The buffer of interpolated position.
///
/// | 60C4h | what |
/// |---|---|
/// | :01 | places there can be |
/// | :02 | places that are used; with one the last record counts, as if there were no buffer |
/// | :03 | 0: a queue, which refuses what it has no place for; 1: a ring, which loses the oldest record for it |
/// | :04 | place of the next record |
/// | :05 | bytes of a record |
/// | :06 | 0 clears the buffer and keeps it closed, 1 opens it |
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Records {
    records: [i32; PLACES],
    /// Place of the oldest one, and how many there are.
    first: usize,
    count: usize,
}

impl Records {
    /// Places in use; `None` while records are not buffered.
    fn places(d: &Dictionary, k: &Keys) -> Option<usize> {
        let places = usize::try_from(d.get(k.buffer_size)).unwrap_or(PLACES);
        (places > 1 && d.get(k.buffer_clear) == 1).then_some(places.min(PLACES))
    }

    /// Returns whether there was a place for it.
    fn push(&mut self, record: i32, places: usize, ring: bool) -> bool {
        if self.count >= places && !ring {
            return false;
        }
        if self.count >= places {
            let _ = self.pop(places);
        }
        let next = self.next(places);
        if let Some(place) = self.records.get_mut(next) {
            *place = record;
            self.count += 1;
        }
        true
    }

    fn pop(&mut self, places: usize) -> Option<i32> {
        let record = *self.records.get(self.first).filter(|_| self.count > 0)?;
        self.first = (self.first + 1) % places;
        self.count -= 1;
        Some(record)
    }

    /// Where the next record goes.
    const fn next(&self, places: usize) -> usize {
        (self.first + self.count) % places
    }
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

    /// A record of interpolated position was written. Returns whether there was a place for it.
    pub(in super::super) fn take_record(&mut self, d: &Dictionary, k: &Keys, record: i32) -> bool {
        let ring = d.get(k.buffer_organisation) == 1;
        Records::places(d, k).is_none_or(|places| self.records.push(record, places, ring))
    }

    /// 60C4h:04. A buffer that is closed, or was made smaller than what is in it, is empty.
    pub(in super::super) fn next_place(&mut self, d: &Dictionary, k: &Keys) -> u16 {
        let places = Records::places(d, k);
        if places.is_none_or(|places| self.records.first >= places || self.records.count > places) {
            self.records = Records::default();
        }
        let next = places.map_or(0, |places| self.records.next(places));
        u16::try_from(next).unwrap_or(0)
    }

    /// Where the demand is to be next, if something new is due; 32 bits of it.
    fn due(&mut self, d: &Dictionary, k: &Keys, see: &View) -> Option<i32> {
        let first = self.cyclic.to.is_none();
        if self.mode == IP
            && let Some(places) = Records::places(d, k)
        {
            // One for each period, to the tick.
            let due = first || self.cyclic.left < see.dt / 2.0;
            return due.then(|| self.records.pop(places)).flatten();
        }
        let (raw, offset) = match self.mode {
            CSP => (d.get(k.target_position), d.get(k.position_offset)),
            _ => (d.get(k.interpolation_target), 0),
        };
        (see.set_point || first).then(|| raw.wrapping_add(offset))
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
        if let Some(raw) = self.due(d, k, see) {
            let to = extend(self.ramp.position, raw);
            self.cyclic.begin(to, period(d, k));
        }
        let Some(mut to) = self.cyclic.to else {
            return self.stop(Stop::Ramp, d, k, see);
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
