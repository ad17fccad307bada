//! Position jumps while a device follows commands: an encoder that jumped, an odometry that was reset. Scheduled nets
//! were meant for another position and are returned by the executor; running nets continue from commanded, not
//! measured, positions.

use std::fmt;

use takt_rt::Nanos;

use super::{ARM_JOINTS_MAX, DeviceState, DeviceStatus};

/// Plausible measured speed, as a multiple of the speed limit.
const SPEED_SHARE: f64 = 2.0;
/// Plausible measured motion on top of that, rad: noise, play, and measurements in quick succession.
const PLAY_RAD: f64 = 0.02;

/// The part of a device that a position belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JumpPart {
    /// A base along the floor, m.
    #[default]
    Floor,
    /// A base that turns, rad.
    Turning,
    /// The joint of that number, rad.
    Joint(usize),
}

impl fmt::Display for JumpPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Floor => f.write_str("its odometry along the floor"),
            Self::Turning => f.write_str("its heading"),
            Self::Joint(number) => write!(f, "joint {number}"),
        }
    }
}

/// Number of position jumps while the device followed commands, and the last one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jumped {
    /// How often.
    pub count: u64,
    /// Where.
    pub part: JumpPart,
    /// By how much, m or rad.
    pub by: f64,
    /// Largest plausible motion.
    pub most: f64,
}

impl Jumped {
    /// Adds a jump.
    pub const fn add(&mut self, part: JumpPart, by: f64, most: f64) {
        *self = Self {
            count: self.count + 1,
            part,
            by,
            most,
        };
    }
}

impl fmt::Display for Jumped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { part, by, most, .. } = self;
        let unit = match part {
            JumpPart::Floor => "m",
            JumpPart::Turning | JumpPart::Joint(_) => "rad",
        };
        write!(
            f,
            "{part} jumped by {by:.4} {unit}, the most plausible is {most:.4} {unit}; scheduled nets of the device are \
             returned\nhint: check the encoder, its cable and its supply, then schedule the nets again"
        )
    }
}

/// The last measured joint positions of a device.
#[derive(Debug, Default)]
pub struct Continuity {
    last: Option<(Nanos, [Option<f64>; ARM_JOINTS_MAX])>,
}

impl Continuity {
    /// Checks a state before it is published and adds a jump if a joint jumped since the last one. `velocity_max` is
    /// the limit of each joint, rad/s.
    pub fn check(&mut self, state: &mut DeviceState, velocity_max: impl Fn(usize) -> Option<f64>) {
        if state.status != DeviceStatus::Operational {
            self.last = None;
            return;
        }
        let now = state.joints.map(|joint| joint.measured_position);
        let Some((at, before)) = self.last.replace((state.stamp, now)) else {
            return;
        };
        let span_s = super::seconds(state.stamp - at).max(0.0);
        for (number, (now, before)) in now.into_iter().zip(before).enumerate() {
            let (Some(now), Some(before), Some(speed)) = (now, before, velocity_max(number)) else {
                continue;
            };
            let (by, most) = (
                (now - before).abs(),
                speed * SPEED_SHARE * span_s + PLAY_RAD,
            );
            if by > most {
                state.jumped.add(JumpPart::Joint(number), by, most);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joint_jump_is_counted_once_with_its_figures() {
        let mut continuity = Continuity::default();
        let mut state = DeviceState {
            status: DeviceStatus::Operational,
            ..DeviceState::default()
        };
        let mut at = |millis: i64, position: Option<f64>| {
            state.stamp = Nanos(millis * 1_000_000);
            state.joints[2].measured_position = position;
            continuity.check(&mut state, |_| Some(2.0));
            state.jumped
        };
        // As fast as it may be, over a silence, and noise.
        for (millis, position) in [
            (0, Some(0.0)),
            (4, Some(0.02)),
            (104, Some(0.42)),
            (104, Some(0.41)),
            (105, None),
            (106, Some(1.0)),
        ] {
            assert_eq!(at(millis, position).count, 0, "{millis}");
        }
        let jumped = at(110, Some(1.5));
        assert_eq!(jumped.count, 1);
        assert_eq!(
            jumped.to_string().lines().next().unwrap(),
            "joint 2 jumped by 0.5000 rad, the most plausible is 0.0360 rad; scheduled nets of the device are returned"
        );
        assert_eq!(at(114, Some(1.5)).count, 1);
    }
}
