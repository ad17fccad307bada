//! Limits of a CiA 402 drive for a jog: the speed that its objects allow, checked before it moves, and the bounds of the
//! runaway monitor while it has power. It reads no wire; the caller uploads the objects.

mod profile;

use std::fmt;
use std::time::Duration;

use takt_cia402::dictionary::Address;
use takt_cia402::{RunawayLimits, Standstill};

pub(crate) use profile::Profile;

/// A motor faster than its drive allows by this factor runs away; it may overshoot by less.
const OVERSPEED: f64 = 1.5;
/// Largest lag behind set-points, as time at the largest commanded speed: servo lag and the ramp of the drive.
const LAG: Duration = Duration::from_millis(250);
/// Longest stall of the host that causes no false alarm.
const STALL: Duration = Duration::from_millis(50);
/// Largest lag without speed, turns of the motor.
const LAG_TURNS: f64 = 0.5;
/// A motor that moves less than this within [`Standstill::TIME`] is at standstill, turns.
const STANDSTILL_TURNS: f64 = 2e-3;
/// Largest lag without speed of a drive that shows neither 6065h nor its encoder, increments.
const LAG_UNKNOWN: f64 = 65_536.0;

/// The limits that a drive shows. Speeds are in increments of 6064h per second.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Limits {
    /// 607Fh, velocity units.
    profile: Option<f64>,
    /// 6080h, rpm of the motor.
    motor_rpm: Option<f64>,
    /// Increments of a turn of the motor.
    turn: Option<f64>,
    /// 6065h, increments.
    window: Option<f64>,
    /// Increments per second of a velocity unit.
    unit: Option<f64>,
    /// Limits that are not compared, and why.
    notes: Vec<String>,
}

/// A speed that is requested of a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Speed {
    /// Increments of 6064h per second.
    Increments(f64),
    /// Velocity units, as 60FFh has them.
    Units(f64),
}

/// A speed above a limit of the drive. Both are in the unit of the request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TooFast {
    object: &'static str,
    requested: Speed,
    /// The largest speed that the object allows.
    pub(crate) allowed: f64,
}

impl fmt::Display for TooFast {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (speed, unit) = match self.requested {
            Speed::Increments(speed) => (speed, "increments/s"),
            Speed::Units(speed) => (speed, "velocity units"),
        };
        let Self {
            object, allowed, ..
        } = self;
        write!(
            f,
            "the jog is too fast: {:.0} {unit} requested, {object} allows {allowed:.0}",
            speed.abs()
        )
    }
}

impl Limits {
    /// Uploads the objects of an axis; `None` from `upload` means that the drive does not have the object.
    pub(crate) fn read<E>(
        axis: u8,
        mut upload: impl FnMut(Address) -> Result<Option<u32>, E>,
    ) -> Result<Self, E> {
        let mut number = |index, sub| {
            let address = Address::new(index, sub);
            upload(address.on_axis(axis).unwrap_or(address)).map(|raw| raw.map(f64::from))
        };
        let mut limits = Self {
            profile: number(0x607F, 0)?,
            motor_rpm: number(0x6080, 0)?,
            // 0 and the largest number switch the window off.
            window: number(0x6065, 0)?.filter(|window| (1.0..4e9).contains(window)),
            ..Self::default()
        };
        let mut ratio = |index| -> Result<Option<f64>, E> {
            let (above, below) = (number(index, 1)?, number(index, 2)?);
            let both = above.zip(below).filter(|(a, b)| *a > 0.0 && *b > 0.0);
            Ok(both.map(|(above, below)| above / below))
        };
        let feed = ratio(0x6092)?;
        let gear = ratio(0x6091)?.unwrap_or(1.0);
        let encoder = ratio(0x608F)?;
        let velocity_factor = ratio(0x6096)?.unwrap_or(1.0);
        limits.turn = feed.map(|feed| feed / gear).or(encoder);
        let si = number(0x60A9, 0)?.filter(|unit| *unit > 0.0);
        limits.unit = match si {
            Some(si) => limits.turn_units(si),
            None if (velocity_factor - 1.0).abs() < 1e-9 => Some(1.0),
            None => None,
        };
        limits.note();
        Ok(limits)
    }

    /// Increments per second of an SI unit of velocity (60A9h): prefix, numerator, denominator, 0.
    fn turn_units(&self, si: f64) -> Option<f64> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "it was an u32"
        )]
        let [_, per, what, prefix] = (si as u32).to_le_bytes();
        let whole = match what {
            // Revolutions, increments.
            0xB4 => self.turn?,
            0xB5 => 1.0,
            _ => return None,
        };
        let seconds = match per {
            0x03 => 1.0,
            0x47 => 60.0,
            _ => return None,
        };
        Some(whole * 10f64.powi(prefix.cast_signed().into()) / seconds)
    }

    fn note(&mut self) {
        let named = [("607Fh", self.profile), ("6080h", self.motor_rpm)];
        for (name, value) in named {
            let why = match value {
                None => "does not exist",
                // Some drives have 0 for no limit; one that means it does not turn, which is reported then.
                Some(0.0) => "is 0",
                Some(_) => continue,
            };
            self.notes.push(format!(
                "{name} {why}: the speed of a jog is not compared with it"
            ));
        }
        if self.motor_rpm.is_some_and(|rpm| rpm > 0.0) && self.turn.is_none() {
            self.notes.push(
                "608Fh and 6092h do not exist: the speed of a jog is not compared with 6080h"
                    .to_owned(),
            );
        }
        if self.unit.is_none() {
            self.notes.push(
                "the unit of velocity (60A9h, 6096h) is not known: 607Fh is compared with 60FFh only"
                    .to_owned(),
            );
        }
    }

    /// Limits that are not compared, and why; a line each.
    pub(crate) fn notes(&self) -> &[String] {
        &self.notes
    }

    /// 607Fh and 6080h, increments per second.
    fn increments(&self) -> [(&'static str, Option<f64>); 2] {
        let product = |a: Option<f64>, b: Option<f64>| {
            let limit = a.zip(b).map(|(a, b)| a * b);
            limit.filter(|limit| *limit > 0.0)
        };
        let motor = product(self.motor_rpm, self.turn).map(|speed| speed / 60.0);
        [
            (
                "607Fh (max profile velocity)",
                product(self.profile, self.unit),
            ),
            ("6080h (max motor speed)", motor),
        ]
    }

    /// The speed in increments per second, if the unit is known.
    fn speed(&self, speed: Speed) -> Option<f64> {
        match speed {
            Speed::Increments(speed) => Some(speed),
            Speed::Units(speed) => self.unit.map(|unit| unit * speed),
        }
    }

    /// The first limit that is lower than a requested speed.
    pub(crate) fn check(&self, requested: Speed) -> Result<(), TooFast> {
        let factor = match requested {
            Speed::Increments(_) => Some(1.0),
            Speed::Units(_) => self.unit,
        };
        let speed = match requested {
            Speed::Increments(speed) | Speed::Units(speed) => speed.abs(),
        };
        let [profile, motor] = self.increments();
        let in_unit = |(object, limit): (&'static str, Option<f64>)| {
            let limit = limit.zip(factor).map(|(limit, factor)| limit / factor);
            (object, limit)
        };
        let profile = match requested {
            // Of the same unit, whatever that is.
            Speed::Units(_) => (profile.0, self.profile.filter(|limit| *limit > 0.0)),
            Speed::Increments(_) => in_unit(profile),
        };
        for (object, allowed) in [profile, in_unit(motor)] {
            if let Some(allowed) = allowed.filter(|allowed| speed > *allowed) {
                return Err(TooFast {
                    object,
                    requested,
                    allowed,
                });
            }
        }
        Ok(())
    }

    /// Bounds of the monitor for motion up to this speed by cycles of this length. The thread of a tool is not real-time:
    /// a stall of the host up to [`STALL`] stays within them.
    pub(crate) fn monitor(&self, speed: Speed, cycle: Duration) -> RunawayLimits {
        let speed = self.speed(speed).unwrap_or(0.0).abs();
        let resting = match (self.turn, self.window) {
            (Some(turn), _) => turn.abs() * LAG_TURNS,
            (None, Some(window)) => window,
            (None, None) => LAG_UNKNOWN,
        };
        let lag = resting + speed * LAG.as_secs_f64();
        let lag = self.window.map_or(lag, |window| window.min(lag));
        let late = (STALL + 2 * cycle).as_secs_f64();
        let most = self.increments().into_iter().filter_map(|(_, limit)| limit);
        RunawayLimits {
            following: lag + speed * late,
            speed: most.fold(f64::INFINITY, f64::min) * OVERSPEED,
        }
    }

    /// Standstill of the motor; a drive that does not show its encoder has the smallest play.
    pub(crate) fn standstill(&self) -> Standstill {
        Standstill::new(self.turn.unwrap_or(0.0) * STANDSTILL_TURNS)
    }

    /// Increments that a velocity covers in this time. `None` if the unit of velocity is not known.
    pub(crate) fn distance(&self, velocity: i32, time: Duration) -> Option<i32> {
        let distance = self.unit? * f64::from(velocity) * time.as_secs_f64();
        let distance = distance.clamp(f64::from(i32::MIN), f64::from(i32::MAX));
        #[expect(clippy::cast_possible_truncation, reason = "clamped to an i32")]
        let distance = distance.round() as i32;
        Some(distance)
    }

    /// Of the positions that a motor can have reached from `start` by profile velocity in this time, the nearest to
    /// `actual`. `None` if the unit of velocity is not known.
    pub(crate) fn nearest(
        &self,
        start: i32,
        actual: i32,
        velocity: i32,
        time: Duration,
    ) -> Option<i32> {
        let range = self.unit? * f64::from(velocity) * time.as_secs_f64();
        let moved = f64::from(actual.wrapping_sub(start));
        let nearest = moved.clamp(range.min(0.0), range.max(0.0));
        #[expect(
            clippy::cast_possible_truncation,
            reason = "no farther than the difference of two i32"
        )]
        let nearest = nearest.round() as i32;
        Some(start.wrapping_add(nearest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_cia402::{Monitor, Runaway};

    const MS: Duration = Duration::from_millis(1);

    /// Limits by these objects.
    fn limits(objects: &[(u16, u8, u32)]) -> Limits {
        let upload = |address: Address| -> Result<Option<u32>, ()> {
            let same = |row: &&(u16, u8, u32)| Address::new(row.0, row.1) == address;
            Ok(objects.iter().find(same).map(|row| row.2))
        };
        Limits::read(0, upload).unwrap()
    }

    const ENCODER: [(u16, u8, u32); 2] = [(0x608F, 1, 4096), (0x608F, 2, 1)];

    #[test]
    fn jog_above_profile_or_motor_speed_is_rejected() {
        let profile = limits(&[(0x607F, 0, 5000)]);
        let error = profile.check(Speed::Increments(-5001.0)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the jog is too fast: 5001 increments/s requested, 607Fh (max profile velocity) allows 5000"
        );
        assert_eq!(profile.check(Speed::Units(5000.0)), Ok(()));
        assert!(profile.check(Speed::Units(-5001.0)).is_err());
        let mut objects = vec![(0x6080, 0, 60)];
        objects.extend(ENCODER);
        let motor = limits(&objects);
        assert_eq!(motor.check(Speed::Increments(4096.0)), Ok(()));
        let error = motor.check(Speed::Increments(4097.0)).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("6080h (max motor speed) allows 4096")
        );
    }

    #[test]
    fn jog_speed_is_compared_in_the_unit_of_velocity() {
        let mut objects = vec![(0x607F, 0, 60), (0x6080, 0, 30), (0x60A9, 0, 0x00B4_4700)];
        objects.extend(ENCODER);
        let rpm = limits(&objects);
        assert_eq!(rpm.check(Speed::Units(30.0)), Ok(()));
        let error = rpm.check(Speed::Units(31.0)).unwrap_err();
        assert!((error.allowed - 30.0).abs() < 1e-9, "{error}");
        // Half a turn in a second.
        assert_eq!(rpm.check(Speed::Increments(2048.0)), Ok(()));
        assert!(rpm.check(Speed::Increments(2049.0)).is_err());
        let unknown = limits(&[(0x607F, 0, 60), (0x60A9, 0, 0x0001_4700)]);
        assert_eq!(unknown.check(Speed::Increments(1e9)), Ok(()));
        assert!(unknown.check(Speed::Units(61.0)).is_err());
        assert!(unknown.notes().iter().any(|note| note.contains("60A9h")));
    }

    #[test]
    fn jog_without_limit_objects_is_noted_once() {
        let none = limits(&[]);
        assert_eq!(none.check(Speed::Increments(1e9)), Ok(()));
        let missing = |name: &str| {
            let exact = |note: &&String| note.starts_with(&format!("{name} does not exist"));
            none.notes().iter().filter(exact).count()
        };
        assert_eq!((missing("607Fh"), missing("6080h")), (1, 1));
        assert_eq!(none.notes().len(), 2, "{:?}", none.notes());
        let zero = limits(&[(0x607F, 0, 0), (0x6080, 0, 0)]);
        assert_eq!(zero.check(Speed::Units(1e9)), Ok(()));
        assert!(zero.notes()[0].starts_with("607Fh is 0"));
    }

    /// A motor with a lag of 20 ms on its set-points, which stop for `stall` once, and whether the monitor trips.
    fn stalled(stall: Duration) -> Option<Runaway> {
        let mut objects = vec![(0x607F, 0, 200_000), (0x6065, 0, 2000)];
        objects.extend(ENCODER);
        let cycle = 4 * MS;
        let speed = 100_000.0;
        let mut monitor = Monitor::new(limits(&objects).monitor(Speed::Increments(speed), cycle));
        let (mut target, mut actual, mut stalls) = (0.0, 0.0, stall);
        (0..1000).find_map(|n| {
            let now = n * MS;
            let is_due = n % 4 == 0;
            if now > 300 * MS && !stalls.is_zero() {
                // The drive goes on to its last target meanwhile.
                stalls = stalls.saturating_sub(MS);
            } else if is_due {
                target = speed * now.as_secs_f64();
            }
            actual += (target - actual) * 0.05;
            #[expect(clippy::cast_possible_truncation, reason = "some 100,000")]
            let (to, at) = (target.round() as i32, actual.round() as i32);
            is_due.then(|| monitor.step(Some(to), at, now)).flatten()
        })
    }

    #[test]
    fn jog_monitor_passes_host_stalls() {
        for ms in [0, 5, 10, 20, 50] {
            assert_eq!(stalled(ms * MS), None, "{ms} ms");
        }
        assert!(stalled(400 * MS).is_some());
    }

    #[test]
    fn jog_corridor_follows_the_commanded_velocity() {
        let limits = limits(&[]);
        let nearest =
            |actual, velocity| limits.nearest(100, actual, velocity, Duration::from_secs(1));
        // Behind on its ramp, too far, backwards.
        assert_eq!(nearest(600, 1000), Some(600));
        assert_eq!(nearest(2000, 1000), Some(1100));
        assert_eq!(nearest(-300, 1000), Some(100));
        assert_eq!(nearest(-300, -1000), Some(-300));
        // Across the end of the counter.
        let wrapped = limits.nearest(i32::MAX, i32::MIN + 9, 1000, Duration::from_secs(1));
        assert_eq!(wrapped, Some(i32::MIN + 9));
    }
}
