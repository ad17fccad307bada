//! Two power bases under one platform on mecanum wheels, with the true pose of the platform. Each has its own link;
//! they are coupled by the ground only.

use std::time::Duration;

use super::super::omni::wheels_of;
use super::super::{Channel, Model, Odometer, OmniConfig, Pose};
use super::{Powerbase, PowerbaseConfig};
use crate::Frame;

/// Integration step of the true pose.
const STEP: Duration = Duration::from_millis(1);

/// The platform.
#[derive(Clone, Debug)]
pub struct Pair {
    config: OmniConfig,
    /// Front and back.
    pub parts: [Powerbase; 2],
    turned: [f64; 4],
    odometer: Odometer,
    now: Duration,
}

impl Pair {
    /// A platform whose power bases send half a cycle apart.
    pub fn new(config: OmniConfig) -> Self {
        let part = |start_ms| {
            Powerbase::new(PowerbaseConfig {
                model: Model::Rmp50,
                turn_gain: Some(config.turn_gain),
                start: Duration::from_millis(start_ms),
                ..PowerbaseConfig::default()
            })
        };
        Self {
            config,
            parts: [part(0), part(5)],
            turned: [0.0; 4],
            odometer: Odometer::default(),
            now: Duration::ZERO,
        }
    }

    /// True pose.
    pub const fn truth(&self) -> Pose {
        self.odometer.pose()
    }

    /// Handles a frame of the host for one part.
    pub fn handle_frame(&mut self, part: usize, frame: &Frame, now: Duration) {
        self.advance(now);
        if let Some(part) = self.parts.get_mut(part) {
            part.handle_frame(frame, now);
        }
    }

    /// The next due message of one part.
    pub fn poll_transmit(&mut self, part: usize, now: Duration) -> Option<(Channel, Frame)> {
        self.advance(now);
        self.parts.get_mut(part)?.poll_transmit(now)
    }

    /// Advances to a time.
    pub fn advance(&mut self, now: Duration) {
        while self.now + STEP <= now {
            self.now += STEP;
            let mut steps = [0.0; 4];
            for (index, part) in self.parts.iter_mut().enumerate() {
                part.advance(self.now);
                let sides = part.turned();
                for (wheel, side, sign) in wheels_of(index) {
                    let angle = sign * sides[side] / self.config.counts_per_radian;
                    steps[wheel] = angle - self.turned[wheel];
                    self.turned[wheel] = angle;
                }
            }
            self.odometer.add(self.config.geometry.velocity(steps));
        }
    }
}
