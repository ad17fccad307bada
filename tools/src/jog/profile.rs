//! A motion from rest to rest whose speed and acceleration have no steps, and its braking. It knows no drive.

use std::f64::consts::TAU;
use std::time::Duration;

/// A motion by a number of increments.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile {
    increments: f64,
    time: f64,
    /// When braking began, s; position and speed then.
    braked: Option<(f64, f64, f64)>,
}

impl Profile {
    /// With this duration, at least 10 ms.
    pub(crate) fn new(increments: i32, time: Duration) -> Self {
        Self {
            increments: increments.into(),
            time: time.as_secs_f64().max(0.01),
            braked: None,
        }
    }

    /// Position and speed after `s` seconds; the speed is one turn of a cosine.
    fn whole(&self, s: f64) -> (f64, f64) {
        let x = (s / self.time).clamp(0.0, 1.0);
        let position = self.increments * (x - (TAU * x).sin() / TAU);
        let speed = self.increments / self.time * (1.0 - (TAU * x).cos());
        (position, speed)
    }

    /// The largest speed of the whole motion, increments/s.
    pub(crate) fn speed(&self) -> f64 {
        2.0 * self.increments.abs() / self.time
    }

    /// The largest acceleration of the whole motion.
    fn acceleration(&self) -> f64 {
        (self.increments * TAU / self.time.powi(2)).abs().max(1.0)
    }

    /// Duration of braking from a speed, s.
    fn braking(&self, speed: f64) -> f64 {
        speed.abs() / self.acceleration()
    }

    /// Brakes from now on, as hard as the motion accelerates at most.
    pub(crate) fn brake(&mut self, now: Duration) {
        let s = now.as_secs_f64();
        let (position, speed) = self.whole(s);
        self.braked = Some((s, position, speed));
    }

    /// Position, increments from the start.
    pub(crate) fn at(&self, now: Duration) -> i32 {
        let s = now.as_secs_f64();
        let position = match self.braked {
            None => self.whole(s).0,
            Some((since, from, speed)) => {
                let passed = (s - since).clamp(0.0, self.braking(speed));
                let slowing = self.acceleration().copysign(speed);
                from + speed * passed - slowing * passed.powi(2) / 2.0
            }
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "between zero and increments, which are an i32"
        )]
        let rounded = position.round() as i32;
        rounded
    }

    /// When it is at rest.
    pub(crate) fn end(&self) -> Duration {
        let end = match self.braked {
            None => self.time,
            Some((since, _, speed)) => since + self.braking(speed),
        };
        Duration::from_secs_f64(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Largest differences of positions and of speeds from one millisecond to the next.
    fn steps(position: impl Fn(Duration) -> i32, count: u32) -> (i32, i32) {
        let at: Vec<i32> = (0..count).map(|n| position(n * MS)).collect();
        let speeds: Vec<i32> = at.windows(2).map(|two| two[1] - two[0]).collect();
        let most = |all: &mut dyn Iterator<Item = i32>| all.map(i32::abs).max().unwrap();
        let jumps = most(&mut speeds.windows(2).map(|two| two[1] - two[0]));
        (most(&mut speeds.iter().copied()), jumps)
    }

    #[test]
    fn jog_profile_begins_and_ends_at_rest() {
        for increments in [100_000, -100_000] {
            let profile = Profile::new(increments, Duration::from_secs(2));
            assert_eq!(
                (profile.at(Duration::ZERO), profile.at(profile.end())),
                (0, increments)
            );
            let (speed, jump) = steps(|now| profile.at(now), 2100);
            assert!((profile.speed() / 1000.0 - f64::from(speed)).abs() < 1.0);
            assert!(speed == 100 && jump <= 2, "{speed} {jump}");
        }
    }

    #[test]
    fn jog_profile_braked_comes_to_rest() {
        for at in [0, 300, 1000, 1900] {
            let mut profile = Profile::new(-100_000, Duration::from_secs(2));
            let before = profile;
            let when = at * MS;
            profile.brake(when);
            let now = |now: Duration| {
                if now < when {
                    before.at(now)
                } else {
                    profile.at(now)
                }
            };
            let (_, jump) = steps(now, 3000);
            assert!(jump <= 2, "{at} {jump}");
            let at_rest = profile.at(profile.end());
            assert_eq!(profile.at(profile.end() + Duration::from_secs(9)), at_rest);
            assert!((-100_001..=0).contains(&at_rest), "{at_rest}");
        }
    }
}
