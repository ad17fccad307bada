//! What an emulated arm meets, and how its controller senses it: the hook for a world around the arm, stated load, noise
//! and delay of the estimated forces. No world is in this crate but one wall.

use super::body::GRAVITY;
use super::{AXES, Body};
use std::fmt;
use std::time::Duration;
use takt_link::Random;

/// Longest delay of the estimates, in cycles.
const DELAY_MAX: usize = 64;
/// Keeps the noise apart from the random faults of the wire.
const NOISE_SEED: u64 = 0x6e6f_6973_6500_0001;

/// Motion of a flange in the base frame of its arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flange {
    /// m.
    pub position: [f64; 3],
    /// Axes x, y and z of the flange in the base frame.
    pub axes: [[f64; 3]; 3],
    /// m/s along x, y, z, then rad/s about x, y, z of the base frame.
    pub velocity: [f64; 6],
    /// Tip of the tool in the base frame, m.
    pub tip: [f64; 3],
}

/// What the flange meets, such as a [`Contact`](super::Contact) or a hand in a world that several emulators share.
pub trait Surroundings: Send + fmt::Debug {
    /// Force on the flange along x, y, z of the base frame, N, then its moment about the flange, Nm. Called with each step
    /// of the arm, at least once per cycle, with the time on the clock of the controller's owner; times never go back.
    fn wrench(&mut self, at: Duration, flange: &Flange) -> [f64; 6];
}

/// A load at the flange that the controller does not know: its weight alone, as for slow motions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carried {
    /// kg.
    pub mass: f64,
    /// Centre of mass in the frame of the flange, m.
    pub centre: [f64; 3],
}

impl Surroundings for Carried {
    fn wrench(&mut self, _at: Duration, flange: &Flange) -> [f64; 6] {
        let mut lever = [0.0; 3];
        for (axis, along) in flange.axes.iter().zip(self.centre) {
            for (lever, part) in lever.iter_mut().zip(axis) {
                *lever += part * along;
            }
        }
        let force = -self.mass * GRAVITY;
        let [x, y, _] = lever;
        [0.0, 0.0, force, y * force, -x * force, 0.0]
    }
}

/// How a controller estimates external forces.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sensing {
    /// Uniform noise of each external joint torque, plus and minus, Nm.
    pub noise_nm: f64,
    /// Uniform noise of each component of the external force, plus and minus, N; of its moment a tenth of that, Nm.
    pub noise_n: f64,
    /// Age of the estimates; whole cycles, at most 64.
    pub delay: Duration,
}

/// Estimated external forces of a cycle.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Estimate {
    /// Nm.
    pub(crate) joints: [f64; AXES],
    /// N, in the base frame.
    pub(crate) force: [f64; 3],
    /// About the flange, Nm.
    pub(crate) moment: [f64; 3],
}

/// Delays the estimates and adds noise.
#[derive(Debug, Clone)]
pub(crate) struct Sensor {
    pub(crate) sensing: Sensing,
    ring: [Estimate; DELAY_MAX + 1],
    count: usize,
    random: Random,
    now: Estimate,
}

impl Sensor {
    pub(crate) fn new(sensing: Sensing, seed: u64) -> Self {
        Self {
            sensing,
            ring: [Estimate::default(); DELAY_MAX + 1],
            count: 0,
            random: Random::new(seed ^ NOISE_SEED),
            now: Estimate::default(),
        }
    }

    /// The estimate of the last cycle.
    pub(crate) const fn estimate(&self) -> &Estimate {
        &self.now
    }

    /// Senses once per cycle.
    pub(crate) fn sense(&mut self, body: &Body, period: Duration) {
        let index = self.count % self.ring.len();
        self.ring[index] = Estimate {
            joints: body.external(),
            force: body.force(),
            moment: body.moment(),
        };
        let cycles = self.sensing.delay.as_nanos() / period.as_nanos().max(1);
        let cycles = usize::try_from(cycles).unwrap_or(DELAY_MAX);
        let age = cycles.min(DELAY_MAX).min(self.count);
        self.now = self.ring[(self.count - age) % self.ring.len()];
        self.count += 1;
        let Sensing {
            noise_nm, noise_n, ..
        } = self.sensing;
        let random = &mut self.random;
        let mut add = |values: &mut [f64], bound: f64| {
            if bound > 0.0 && bound.is_finite() {
                for value in values {
                    *value += random.between(-bound, bound);
                }
            }
        };
        add(&mut self.now.joints, noise_nm);
        add(&mut self.now.force, noise_n);
        add(&mut self.now.moment, noise_n / 10.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::{Chain, Contact, Shape};

    fn pulled() -> Body {
        let mut body = Body::new(
            Chain::LWR,
            [0.0, 0.5, 0.0, 1.2, 0.0, -1.0, 0.0],
            Duration::ZERO,
        );
        let mut point: [f64; 3] = body.pose().position.into();
        point[2] += 0.001;
        body.contact = Some(Contact {
            shape: Shape::Wall,
            point,
            normal: [0.0, 0.0, 1.0],
            stiffness: 10_000.0,
            damping: 0.0,
        });
        body
    }

    #[test]
    fn sensor_delays_by_whole_cycles() {
        let sensing = Sensing {
            delay: Duration::from_millis(6),
            ..Sensing::default()
        };
        let mut sensor = Sensor::new(sensing, 1);
        let mut body = pulled();
        let period = Duration::from_millis(2);
        sensor.sense(&body, period);
        body.freeze();
        for cycle in 0..4 {
            sensor.sense(&body, period);
            let force = sensor.estimate().force[2];
            let expected = if cycle == 3 { 10.0 } else { 0.0 };
            assert!((force - expected).abs() < 1e-9, "{cycle}: {force}");
        }
    }

    #[test]
    fn sensor_noise_repeats_by_seed_within_bound() {
        let sensing = Sensing {
            noise_nm: 0.3,
            noise_n: 2.0,
            ..Sensing::default()
        };
        let body = pulled();
        let run = |seed| {
            let mut sensor = Sensor::new(sensing, seed);
            (0..100)
                .map(|_| {
                    sensor.sense(&body, Duration::from_millis(1));
                    *sensor.estimate()
                })
                .collect::<Vec<_>>()
        };
        let first = run(1);
        assert_eq!(first, run(1));
        assert_ne!(first, run(2));
        let largest = |of: fn(&Estimate) -> f64| first.iter().map(of).fold(0.0, f64::max);
        let (torque, force) = (
            largest(|it| it.joints[0].abs()),
            largest(|it| it.force[0].abs()),
        );
        assert!((0.2..=0.3).contains(&torque) && (1.5..=2.0).contains(&force));
    }
}
