//! Modes of operation: from the objects of a mode to a demand for the servo, and the bits of the statusword that the
//! mode owns. The power state decides whether the motor may follow.

mod cyclic;
mod position;
mod velocity;

use crate::ControlWord;
use crate::dictionary::{Dictionary, Key};

use super::homing::{Homing, HomingInput};
use super::motor::Switches;
use super::objects::Keys;
use super::power::{Motion, Stop};
use super::quirks::Quirks;
use super::ramp::{Bounds, Ramp};

use cyclic::{Cyclic, Period, Records};
use position::SetPoints;
pub(super) use velocity::shown;

/// Profile position.
pub(super) const PP: i8 = 1;
/// Velocity of a frequency converter.
pub(super) const VL: i8 = 2;
/// Profile velocity.
pub(super) const PV: i8 = 3;
/// Profile torque.
pub(super) const TQ: i8 = 4;
/// Homing.
pub(super) const HM: i8 = 6;
/// Interpolated position.
pub(super) const IP: i8 = 7;
/// Cyclic synchronous position.
pub(super) const CSP: i8 = 8;
/// Cyclic synchronous velocity.
pub(super) const CSV: i8 = 9;
/// Cyclic synchronous torque.
pub(super) const CST: i8 = 10;

/// Profile type of 6086h: jerk-limited ramp.
pub(super) const JERK_LIMITED: i16 = 3;

/// Whether a drive with that 6502h supports a mode; 0 is no mode and always supported.
pub(super) fn is_supported(mode: i8, supported: u32) -> bool {
    match mode {
        0 => true,
        PP | VL | PV | TQ | HM | IP | CSP | CSV | CST => supported >> (mode - 1) & 1 == 1,
        _ => false,
    }
}

/// Inputs of a mode in a step; positions and velocities in user units.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub(super) word: ControlWord,
    pub(super) motion: Motion,
    /// The master sent new cyclic set-points.
    pub(super) set_point: bool,
    pub(super) position: f64,
    pub(super) velocity: f64,
    pub(super) switches: Switches,
    pub(super) index: Option<f64>,
    pub(super) at_rest: bool,
    /// Largest velocity of motor and profile.
    pub(super) velocity_max: f64,
    /// User units of one turn of the motor; negative if 607Eh turns it round.
    pub(super) turn: f64,
    /// s
    pub(super) dt: f64,
}

/// The demand that the servo follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Follow {
    /// Nothing.
    Nothing,
    /// Position and velocity of [`Modes::ramp`], with the torque offset.
    Position,
    /// Velocity of [`Modes::ramp`], with the torque offset.
    Velocity,
    /// [`Modes::torque`].
    Torque,
}

/// Outputs of a mode in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModeOutput {
    pub(super) follow: Follow,
    /// Statusword bit 10.
    pub(super) reached: bool,
    /// Statusword bits 12 and 13.
    pub(super) bit_12: bool,
    pub(super) bit_13: bool,
    /// A target was clamped to a software limit.
    pub(super) limited: bool,
    /// Too many cyclic set-points are missing.
    pub(super) missing: bool,
    /// Home position that was found: the origin moves.
    pub(super) home: Option<f64>,
}

impl ModeOutput {
    const fn new(follow: Follow) -> Self {
        Self {
            follow,
            reached: false,
            bit_12: false,
            bit_13: false,
            limited: false,
            missing: false,
            home: None,
        }
    }
}

/// State of the modes.
#[derive(Clone, Debug, Default)]
pub(super) struct Modes {
    /// Where 60C2h is from.
    period: Period,
    /// The mode that 6061h shows.
    pub(super) mode: i8,
    /// The next mode, and the time until it is active, s.
    coming: Option<(i8, f64)>,
    /// The demand in user units.
    pub(super) ramp: Ramp,
    /// The demanded torque, per mille of 6076h.
    pub(super) torque: f64,
    /// The demand that the servo followed in the last step.
    follow: Option<Follow>,
    set_points: SetPoints,
    cyclic: Cyclic,
    records: Records,
    homing: Homing,
    homing_bit: bool,
    /// How long the actual value has been within its window, s.
    inside: f64,
    /// How long the motor has been slow, s.
    slow: f64,
}

impl Modes {
    /// The origin moved by so many user units.
    pub(super) fn shift(&mut self, by: f64) {
        self.ramp.position += by;
    }

    /// Applies a change of 6060h; returns whether the mode changed.
    pub(super) fn switch(
        &mut self,
        dictionary: &Dictionary,
        keys: &Keys,
        halt: bool,
        quirks: &Quirks,
        dt: f64,
    ) -> bool {
        let wanted = dictionary.get(keys.mode);
        let supported = dictionary.get(keys.supported_modes);
        let refused = quirks.mode_needs_no_halt && halt;
        if wanted == self.mode || refused || !is_supported(wanted, supported) {
            self.coming = None;
            return false;
        }
        let delay = quirks.mode_delay.as_secs_f64();
        let left = match self.coming {
            Some((mode, left)) if mode == wanted => left - dt,
            _ => delay,
        };
        if left > 0.0 {
            self.coming = Some((wanted, left));
            return false;
        }
        self.mode = wanted;
        self.coming = None;
        self.forget();
        true
    }

    /// Drops all targets, on a change of mode and on leaving Operation enabled.
    fn forget(&mut self) {
        self.set_points = SetPoints::default();
        self.cyclic = Cyclic::default();
        self.records = Records::default();
        self.homing.interrupt();
        self.homing_bit = false;
        (self.inside, self.slow) = (0.0, 0.0);
    }

    /// One step.
    pub(super) fn step(
        &mut self,
        d: &Dictionary,
        k: &Keys,
        quirks: &Quirks,
        see: &View,
    ) -> ModeOutput {
        if self.follow != Some(Follow::Position) {
            // Position control starts at the actual position.
            if self.follow != Some(Follow::Velocity) {
                (self.ramp.velocity, self.ramp.acceleration) = (see.velocity, 0.0);
            }
            self.ramp.position = see.position;
        }
        let output = match see.motion {
            Motion::Off => {
                self.forget();
                self.torque = 0.0;
                (self.ramp.velocity, self.ramp.acceleration) = (0.0, 0.0);
                ModeOutput::new(Follow::Nothing)
            }
            Motion::Opening => {
                (self.ramp.velocity, self.ramp.acceleration) = (0.0, 0.0);
                ModeOutput::new(Follow::Position)
            }
            Motion::Stopping(stop) => {
                self.forget();
                self.stop(stop, d, k, see)
            }
            Motion::Follow => self.follow(d, k, quirks, see),
        };
        if output.follow != Follow::Torque {
            self.torque = 0.0;
        }
        self.follow = match see.motion {
            Motion::Off => None,
            Motion::Opening | Motion::Follow | Motion::Stopping(_) => Some(output.follow),
        };
        output
    }

    fn follow(&mut self, d: &Dictionary, k: &Keys, quirks: &Quirks, see: &View) -> ModeOutput {
        let halted = see.word.halt() && matches!(self.mode, PP | VL | PV | TQ | HM);
        if halted {
            self.homing.interrupt();
            let stop = Stop::from_option(d.get(k.halt_option));
            let mut output = self.stop(stop, d, k, see);
            output.reached = see.at_rest;
            return output;
        }
        match self.mode {
            PP => self.profile_position(d, k, see),
            VL => self.converter_velocity(d, k, see),
            PV => self.profile_velocity(d, k, see),
            TQ => self.profile_torque(d, k, see),
            HM => self.home(d, k, quirks, see),
            IP | CSP | CSV | CST => self.cyclic(d, k, quirks, see),
            _ => self.stop(Stop::Ramp, d, k, see),
        }
    }

    /// Bounds of the profile objects.
    fn bounds(d: &Dictionary, k: &Keys, see: &View) -> Bounds {
        let rate = |key: Key<u32>, max: Key<u32>| {
            f64::from(d.get(key)).min(f64::from(d.get(max))).max(1.0)
        };
        Bounds {
            velocity: f64::from(d.get(k.profile_velocity)).min(see.velocity_max),
            acceleration: rate(k.profile_acceleration, k.max_acceleration),
            deceleration: rate(k.profile_deceleration, k.max_deceleration),
            jerk: (d.get(k.motion_profile) == JERK_LIMITED)
                .then(|| f64::from(d.get(k.profile_jerk)).max(1.0)),
        }
    }

    fn stop(&mut self, stop: Stop, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        let mut bounds = Self::bounds(d, k, see);
        bounds.velocity = f64::INFINITY;
        bounds.deceleration = match stop {
            Stop::Ramp | Stop::Coast => bounds.deceleration,
            Stop::QuickRamp => f64::from(d.get(k.quick_stop_deceleration)).max(1.0),
            Stop::Limit => f64::from(d.get(k.max_deceleration)).max(1.0),
        };
        // Quick stops are not jerk-limited.
        bounds.jerk = bounds.jerk.filter(|_| stop == Stop::Ramp);
        self.ramp.toward_velocity(0.0, &bounds, see.dt);
        ModeOutput::new(Follow::Position)
    }

    fn profile_velocity(&mut self, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        let target = f64::from(d.get(k.target_velocity));
        let mut bounds = Self::bounds(d, k, see);
        bounds.velocity = see.velocity_max;
        self.ramp.toward_velocity(target, &bounds, see.dt);
        let window = f64::from(d.get(k.velocity_window));
        let within = (see.velocity - target).abs() <= window;
        let slow = see.velocity.abs() <= f64::from(d.get(k.velocity_threshold));
        let mut output = ModeOutput::new(Follow::Velocity);
        output.reached = held(
            &mut self.inside,
            within,
            d.get(k.velocity_window_time),
            see.dt,
        );
        output.bit_12 = held(
            &mut self.slow,
            slow,
            d.get(k.velocity_threshold_time),
            see.dt,
        );
        output.limited = target.abs() > see.velocity_max;
        output
    }

    fn profile_torque(&mut self, d: &Dictionary, k: &Keys, see: &View) -> ModeOutput {
        let target = f64::from(d.get(k.target_torque));
        let change = f64::from(d.get(k.torque_slope)) * see.dt;
        self.torque += (target - self.torque).clamp(-change, change);
        let mut output = ModeOutput::new(Follow::Torque);
        output.reached = self.torque.total_cmp(&target).is_eq();
        output
    }

    fn home(&mut self, d: &Dictionary, k: &Keys, quirks: &Quirks, see: &View) -> ModeOutput {
        let bit = see.word.raw() & 0x0010 != 0;
        let input = HomingInput {
            position: see.position,
            velocity: see.velocity,
            switches: see.switches,
            index: see.index,
            at_rest: see.at_rest,
        };
        match (self.homing_bit, bit) {
            (false, true) => self.homing.start(d.get(k.homing_method), &input),
            (true, false) => self.homing.interrupt(),
            (false, false) | (true, true) => {}
        }
        self.homing_bit = bit;
        let request = self.homing.step(&input);
        let speed = if request.fast {
            k.homing_fast
        } else {
            k.homing_slow
        };
        let rate = f64::from(d.get(k.homing_acceleration)).max(1.0);
        let bounds = Bounds {
            velocity: see.velocity_max,
            acceleration: rate,
            deceleration: rate,
            jerk: None,
        };
        let velocity = f64::from(request.direction) * f64::from(d.get(speed));
        self.ramp.toward_velocity(velocity, &bounds, see.dt);
        let mut output = ModeOutput::new(Follow::Position);
        (output.reached, output.bit_12, output.bit_13) = self.homing.bits(see.at_rest);
        output.reached &= !(quirks.homing_without_target_reached && output.bit_12);
        output.home = request.home;
        output
    }
}

/// Counts how long a condition holds; returns whether it has held for `wanted` ms.
fn held(since: &mut f64, so: bool, wanted: u16, dt: f64) -> bool {
    *since = if so { *since + dt } else { 0.0 };
    so && *since * 1000.0 >= f64::from(wanted)
}

/// The position nearest to `reference` whose lowest 32 bits are `raw`: positions wrap.
fn extend(reference: f64, raw: i32) -> f64 {
    let near = reference.round();
    let wrapped = wrap(near);
    near + f64::from(raw.wrapping_sub(wrapped))
}

/// The lowest 32 bits of a position.
pub(super) fn wrap(position: f64) -> i32 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "positions stay far within 2^53; the lowest 32 bits are needed"
    )]
    let bits = position.round() as i64 as i32;
    bits
}
