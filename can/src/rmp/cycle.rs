//! Assembles the messages of one 10 ms cycle. Incomplete cycles are dropped: a measurement must not
//! mix values of two cycles.

use std::time::Duration;

use super::command::{Gain, Mode};
use super::status::{ControlUnit, Message};
use super::{Model, Scales};

/// Measurement of one cycle, in SI units; left is left in the direction of travel, and counter-clockwise is positive
/// (opposite to the wire).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measurement {
    /// Time of its last message.
    pub stamp: Duration,
    /// Device time, 10 ms each, modulo 65,536.
    pub frames: u16,
    /// Pitch and roll, rad.
    pub attitude: [f64; 2],
    /// Speed of the left and the right wheel, m/s.
    pub speed: [f64; 2],
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
    /// Displacement of the left and the right wheel, counts.
    pub displacement: [i32; 2],
    /// Displacement forward, counts, and yaw, counts clockwise.
    pub travel: [i32; 2],
    /// Torque of the left and the right motor, Nm.
    pub torque: [f64; 2],
    /// Operational mode.
    pub mode: Mode,
    /// Gain schedule.
    pub gain: Gain,
    /// Battery of the power base, V.
    pub battery: f64,
    /// Command in effect: velocity and turn, counts.
    pub echo: [i16; 2],
    /// Last status of the control unit.
    pub unit: ControlUnit,
}

/// The parts of one cycle, one bit each; a cycle is complete when all are set.
const WHOLE: u8 = 0b111_1110;

/// Assembles cycles.
#[derive(Clone, Copy, Debug)]
pub struct Cycles {
    scales: Scales,
    seen: u8,
    building: Measurement,
    broken: u64,
}

impl Cycles {
    /// For a power base of this model.
    pub const fn new(model: Model) -> Self {
        Self {
            scales: model.scales(),
            seen: 0,
            building: Measurement {
                stamp: Duration::ZERO,
                frames: 0,
                attitude: [0.0; 2],
                speed: [0.0; 2],
                yaw_rate: 0.0,
                displacement: [0; 2],
                travel: [0; 2],
                torque: [0.0; 2],
                mode: Mode::Disabled,
                gain: Gain::Light,
                battery: 0.0,
                echo: [0; 2],
                unit: ControlUnit {
                    mode: 0,
                    word1: super::StatusWord1(0),
                    word2: super::StatusWord2(0),
                    counter: 0,
                },
            },
            broken: 0,
        }
    }

    /// Number of incomplete cycles.
    pub const fn broken(&self) -> u64 {
        self.broken
    }

    /// Handles a message; returns the measurement when the cycle is complete.
    pub fn handle(&mut self, message: &Message, now: Duration) -> Option<Measurement> {
        let scales = self.scales;
        let to = &mut self.building;
        let part = match *message {
            Message::Build { .. } => {
                self.begin();
                return None;
            }
            Message::Attitude { pitch, roll, .. } => {
                to.attitude = [pitch, roll].map(radians);
                1
            }
            Message::Speed {
                left,
                right,
                yaw_rate,
                frames,
            } => {
                to.speed = [left, right].map(|counts| f64::from(counts) / scales.speed);
                (to.yaw_rate, to.frames) = (-radians(yaw_rate), frames);
                2
            }
            Message::Wheels { left, right } => {
                to.displacement = [left, right];
                3
            }
            Message::Travel { forward, yaw } => {
                to.travel = [forward, yaw];
                4
            }
            Message::Torque { left, right, .. } => {
                to.torque = [left, right].map(|counts| f64::from(counts) / scales.torque);
                5
            }
            Message::Operation {
                mode,
                gain,
                battery,
                ..
            } => {
                (to.mode, to.gain, to.battery) = (mode, gain, f64::from(battery) / 4.0);
                6
            }
            Message::Echo { velocity, turn, .. } => {
                to.echo = [velocity, turn];
                return self.end(now);
            }
            Message::ControlUnit(unit) => {
                to.unit = unit;
                return None;
            }
            Message::Heartbeat { .. }
            | Message::PowerbaseOff { .. }
            | Message::Interface(_)
            | Message::Command(_)
            | Message::Shutdown => return None,
        };
        self.seen |= 1 << part;
        None
    }

    /// Starts a cycle; a started one was incomplete.
    fn begin(&mut self) {
        if self.seen != 0 {
            self.broken += 1;
        }
        self.seen = 0;
    }

    fn end(&mut self, now: Duration) -> Option<Measurement> {
        let whole = self.seen == WHOLE;
        self.broken += u64::from(!whole);
        self.seen = 0;
        self.building.stamp = now;
        whole.then_some(self.building)
    }
}

fn radians(counts: i16) -> f64 {
    (f64::from(counts) / super::model::COUNTS_PER_DEGREE).to_radians()
}
