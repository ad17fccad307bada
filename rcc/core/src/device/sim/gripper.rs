//! A simulated gripper: its fingers move to the ordered distance at a constant speed. They grip
//! nothing, so nothing stops them on the way.
//!
//! Parameters: `max_distance` (m, 0.023) and `max_vel` (m/s, 0.01), both of the distance between
//! the fingers.

use takt_net::device::{Answer, Gripper, Layout};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated, seconds};
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part};
use crate::error::Error;

/// Two bars that move 11.5 mm each.
const DISTANCE_MAX: f64 = 0.023;
const VELOCITY_MAX: f64 = 0.01;

/// Values of the answer's error.
mod error {
    /// The distance is out of range or no number.
    pub(super) const RANGE: i32 = 1;
}

pub(super) fn youbot(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let distance_max = parameters.positive("max_distance", DISTANCE_MAX)?;
    let velocity_max = parameters.positive("max_vel", VELOCITY_MAX)?;
    let description = DeviceDescription {
        name: parameters.name.to_owned(),
        kind,
        limits: Vec::new(),
        model: "".into(),
        parts: vec![Part::Gripper { distance_max }],
    };
    let mut layout = Layout::default();
    let gripper = Gripper::new(&mut layout, distance_max);
    let mut state = DeviceState::new(layout.signals);
    state.status = DeviceStatus::Operational;
    gripper.distance.tell(&mut state.signals, Some(0.0));
    let fingers = Fingers {
        gripper,
        velocity_max,
        distance: 0.0,
        state,
    };
    Ok((description, Box::new(fingers)))
}

#[derive(Debug)]
struct Fingers {
    gripper: Gripper,
    velocity_max: f64,
    distance: f64,
    state: DeviceState,
}

impl Simulated for Fingers {
    fn step(&mut self, command: &DeviceCommand, dt: Nanos) {
        self.state.stamp = command.time;
        let Some(order) = self.gripper.order.command.read(&command.words) else {
            return;
        };
        let possible = (0.0..=self.gripper.distance_max).contains(&order.value);
        let mut arrived = false;
        if possible {
            let way = order.value - self.distance;
            let step = self.velocity_max * seconds(dt);
            arrived = way.abs() <= step;
            self.distance = if arrived {
                order.value
            } else {
                self.distance + step.copysign(way)
            };
        }
        let answer = (arrived || !possible).then_some(Answer {
            order: order.cycle,
            error: if possible { 0 } else { error::RANGE },
        });
        let signals = &mut self.state.signals;
        self.gripper.distance.tell(signals, Some(self.distance));
        // An earlier answer is no answer to a new order; its number tells.
        if answer.is_some() {
            self.gripper.order.answer.tell(signals, answer);
        }
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}
