//! Cyclic synchronous modes and interpolated position: a set-point per cycle of the master, with interpolation over
//! 60C2h and the offsets 60B0h to 60B2h. While a set-point is late, the drive holds the last one; nothing is
//! extrapolated. Interpolated position may use a buffer of records (60C4h).

use crate::dictionary::Dictionary;

use super::super::objects::Keys;
use super::super::power::Stop;
use super::super::quirks::Quirks;
use super::{CSP, CST, CSV, Follow, IP, ModeOutput, Modes, View, extend};

/// Where 60C2h is from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Period {
    /// The master, or the default of a drive that does not know SYNC.
    #[default]
    Set,
    /// It is to be that of SYNC, which is not known yet.
    Expected,
    /// SYNC.
    OfSync,
}

/// 60C2h by default: value and decimal exponent.
const PERIOD_DEFAULT: (u8, i8) = (1, -3);

/// The current set-point.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cyclic {
    /// Demand at the end of the interpolation time; `None` before the first set-point.
    to: Option<f64>,
    /// Time left of the interpolation, s; negative once it is over.
    left: f64,
    /// Margin before the end of an interpolation within which the next set-point is expected, s: adapted to observed
    /// delays.
    margin: f64,
    /// Time since the last one; `None` before the first, s.
    waited: Option<f64>,
}

/// Gain with which the drive's phase follows the phase of the set-points.
const PHASE_GAIN: f64 = 0.1;
/// Decay factor of the margin per set-point.
const MARGIN_KEEPS: f64 = 0.999;

impl Cyclic {
    /// A set-point for the end of a period of `period` s was received. The drive follows the mean phase of SYNC rather
    /// than each SYNC: an early set-point starts at the present demand and takes longer, and a margin covers late ones,
    /// so that the demand never stops. What is not jitter (a first or a missing set-point, a period other than 60C2h)
    /// resets the phase.
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

/// Slots for records of interpolated position (60C4h:01).
const SLOTS_MAX: usize = 16;

/// The buffer of interpolated position.
///
/// | 60C4h | meaning |
/// |---|---|
/// | :01 | maximum number of slots |
/// | :02 | slots in use; with one the last record counts, as without a buffer |
/// | :03 | 0: a FIFO, which refuses records when it is full; 1: a ring, which then overwrites the oldest |
/// | :04 | slot of the next record |
/// | :05 | bytes of a record |
/// | :06 | 0 clears the buffer and keeps it closed, 1 opens it |
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Records {
    records: [i32; SLOTS_MAX],
    /// Slot of the oldest record, and number of records.
    first: usize,
    count: usize,
}

impl Records {
    /// Slots in use; `None` while records are not buffered.
    fn slots(d: &Dictionary, k: &Keys) -> Option<usize> {
        let slots = usize::try_from(d.get(k.buffer_size)).unwrap_or(SLOTS_MAX);
        (slots > 1 && d.get(k.buffer_clear) == 1).then_some(slots.min(SLOTS_MAX))
    }

    /// Returns whether there was a free slot.
    fn push(&mut self, record: i32, slots: usize, ring: bool) -> bool {
        if self.count >= slots && !ring {
            return false;
        }
        if self.count >= slots {
            let _ = self.pop(slots);
        }
        let next = self.next(slots);
        if let Some(slot) = self.records.get_mut(next) {
            *slot = record;
            self.count += 1;
        }
        true
    }

    fn pop(&mut self, slots: usize) -> Option<i32> {
        let record = *self.records.get(self.first).filter(|_| self.count > 0)?;
        self.first = (self.first + 1) % slots;
        self.count -= 1;
        Some(record)
    }

    /// The slot of the next record.
    const fn next(&self, slots: usize) -> usize {
        (self.first + self.count) % slots
    }
}

/// The interpolation time period 60C2h, s; zero for none.
fn period(d: &Dictionary, k: &Keys) -> f64 {
    f64::from(d.get(k.interpolation_value)) * 10_f64.powi(d.get(k.interpolation_index).into())
}

impl Modes {
    pub(super) fn cyclic(
        &mut self,
        d: &Dictionary,
        k: &Keys,
        quirks: &Quirks,
        see: &View,
    ) -> ModeOutput {
        let bits = see.word.raw() & 0x0070;
        let follows = match self.mode {
            IP => bits & 0x0010 != 0,
            _ => !quirks.cyclic_needs_bits_4_to_6 || bits == 0x0070,
        };
        if !follows {
            self.cyclic = Cyclic::default();
            return self.stop(Stop::Ramp, d, k, see);
        }
        let mut output = match self.mode {
            CSV => self.velocity(d, k, see),
            CST => {
                let target = i32::from(d.get(k.target_torque)) + i32::from(d.get(k.torque_offset));
                self.torque = f64::from(target);
                ModeOutput::new(Follow::Torque)
            }
            _ => self.position(d, k, see),
        };
        if self.mode != IP {
            output.missing = self.watch(d, k, quirks, see);
        }
        output.bit_12 = true;
        output
    }

    /// A record of interpolated position was written. Returns whether there was a free slot.
    pub(in super::super) fn take_record(&mut self, d: &Dictionary, k: &Keys, record: i32) -> bool {
        let ring = d.get(k.buffer_organisation) == 1;
        Records::slots(d, k).is_none_or(|slots| self.records.push(record, slots, ring))
    }

    /// 60C4h:04. A buffer that is closed, or was made smaller than what is in it, is empty.
    pub(in super::super) fn next_record(&mut self, d: &Dictionary, k: &Keys) -> u16 {
        let slots = Records::slots(d, k);
        if slots.is_none_or(|slots| self.records.first >= slots || self.records.count > slots) {
            self.records = Records::default();
        }
        let next = slots.map_or(0, |slots| self.records.next(slots));
        u16::try_from(next).unwrap_or(0)
    }

    /// The lower 32 bits of the next demand, if a new one is due.
    fn due(&mut self, d: &Dictionary, k: &Keys, see: &View) -> Option<i32> {
        let first = self.cyclic.to.is_none();
        if self.mode == IP
            && let Some(slots) = Records::slots(d, k)
        {
            // One for each period, to the tick.
            let due = first || self.cyclic.left < see.dt / 2.0;
            return due.then(|| self.records.pop(slots)).flatten();
        }
        let (raw, offset) = match self.mode {
            CSP => (d.get(k.target_position), d.get(k.position_offset)),
            _ => (d.get(k.interpolation_target), 0),
        };
        (see.set_point || first).then(|| raw.wrapping_add(offset))
    }

    fn velocity(&mut self, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        let target = f64::from(d.get(k.target_velocity)) + f64::from(d.get(k.velocity_offset));
        self.ramp.velocity = target.clamp(-see.velocity_max, see.velocity_max);
        let mut output = ModeOutput::new(Follow::Velocity);
        output.limited = target.abs() > see.velocity_max;
        output
    }

    fn position(&mut self, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        let mut output = ModeOutput::new(Follow::Position);
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
            output.limited = clamped.total_cmp(&to).is_ne();
            to = clamped;
        }
        // Linear interpolation to the end of the period; at the end once it is over.
        let fraction = if self.cyclic.left > see.dt {
            see.dt / self.cyclic.left
        } else {
            1.0
        };
        let advance = (to - self.ramp.position) * fraction;
        let most = see.velocity_max * see.dt;
        self.ramp.velocity = advance.clamp(-most, most) / see.dt;
        self.ramp.position += self.ramp.velocity * see.dt;
        self.cyclic.left -= see.dt;
        output
    }

    /// See [`super::super::Drive::expect_sync_period`].
    pub(in super::super) fn expect_sync_period(&mut self, d: &Dictionary, k: &Keys) {
        let set = (d.get(k.interpolation_value), d.get(k.interpolation_index));
        if set == PERIOD_DEFAULT {
            self.period = Period::Expected;
        }
    }

    /// Whether the period of SYNC counts; it is known from now on.
    pub(in super::super) const fn takes_sync_period(&mut self) -> bool {
        if matches!(self.period, Period::Set) {
            return false;
        }
        self.period = Period::OfSync;
        true
    }

    /// The master wrote the period.
    pub(in super::super) const fn keep_period(&mut self) {
        self.period = Period::Set;
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
        let is_known = self.period != Period::Expected;
        quirks
            .missing_set_points
            .filter(|_| is_known)
            .is_some_and(|most| waited > period * (f64::from(most) + 1.0))
    }
}
