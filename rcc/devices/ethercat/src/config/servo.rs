//! Cell file configuration of servo axes of terminals: an analogue output for the velocity, an encoder, and digital signals.

use std::time::Duration;

use serde::Deserialize;
use takt_core::span;

use super::AnalogueChannel;

/// A servo axis of terminals. A joint of an arm names it as its drive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EthercatServo {
    /// Name by which a joint finds it, and nets its signals.
    pub name: String,
    /// Slave of its encoder.
    pub encoder: String,
    /// Channel of the encoder, from 0.
    #[serde(default)]
    pub channel: u8,
    /// Analogue output of its velocity. Its `scale` is V of one increment; 10/32767 if left out as 1.
    pub output: AnalogueChannel,
    /// Slave and bit of the output that enables its amplifier; `None` if that is always enabled.
    #[serde(default)]
    pub enable: Option<(String, usize)>,
    /// Slave and bit of the output that releases its brake; `None` without brake.
    #[serde(default)]
    pub brake: Option<(String, usize)>,
    /// Slave and bit of the input that shows that its amplifier is ready; `None` if there is none.
    #[serde(default)]
    pub ready: Option<(String, usize)>,
    /// Slave and bit of the input of its proximity switch; needed to home.
    #[serde(default)]
    pub proximity: Option<(String, usize)>,
    /// Increments per second at 10 V; negative if the encoder counts down then.
    pub velocity_10v: f64,
    /// Velocity for a position error: 1/s.
    #[serde(default = "EthercatServo::default_gain")]
    pub gain: f64,
    /// Largest offset voltage that is compensated, V; 0 compensates none.
    #[serde(default = "EthercatServo::default_offset")]
    pub offset_max: f64,
    /// When it has power.
    #[serde(default)]
    pub power: ServoPower,
    /// Time from a command to its brake to the motion, and from the enabling of the amplifier to its being ready.
    #[serde(
        default = "EthercatServo::default_brake_time",
        deserialize_with = "span::text::deserialize"
    )]
    pub brake_time: Duration,
    /// How its zero is found; `None` if its counter is absolute.
    #[serde(default)]
    pub homing: Option<EthercatHoming>,
}

/// When a servo axis has power and its brake is released.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ServoPower {
    /// Always, as a drive.
    #[default]
    Automatic,
    /// While a net sets its digital output 1.
    OnRequest,
}

/// Homing by proximity switch and index pulse.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EthercatHoming {
    /// Velocity towards the switch, degrees of the joint per second; its sign is the direction.
    pub velocity: f64,
    /// Speed off the switch and to the index pulse, degrees per second.
    pub index_velocity: f64,
    /// Angle of the joint at the first index pulse off the switch, degrees.
    pub index_position: f64,
    /// Increments between two index pulses.
    pub index_every: f64,
    /// Angle to which the joint moves in the end, degrees; `None` to stay at the index pulse.
    #[serde(default)]
    pub start: Option<f64>,
    /// Longest way to the switch, degrees; `None` for the range of the joint.
    #[serde(default)]
    pub travel_max: Option<f64>,
    /// Time for all.
    #[serde(
        default = "EthercatHoming::default_timeout",
        deserialize_with = "span::text::deserialize"
    )]
    pub timeout: Duration,
}

impl EthercatServo {
    const fn default_gain() -> f64 {
        20.0
    }

    const fn default_offset() -> f64 {
        0.2
    }

    const fn default_brake_time() -> Duration {
        Duration::from_millis(100)
    }

    /// Its bits: slave and bit, and whether it is an output.
    pub(crate) fn bits(&self) -> impl Iterator<Item = (&str, &(String, usize), bool)> {
        let all = [
            ("enable", &self.enable, true),
            ("brake", &self.brake, true),
            ("ready", &self.ready, false),
            ("proximity", &self.proximity, false),
        ];
        all.into_iter()
            .filter_map(|(key, bit, outputs)| Some((key, bit.as_ref()?, outputs)))
    }
}

impl EthercatHoming {
    const fn default_timeout() -> Duration {
        Duration::from_mins(2)
    }
}
