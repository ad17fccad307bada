//! A simulated gripper: its fingers move to the ordered distance within their speed and acceleration. There is no
//! object to grip, so only a withdrawn order stops them.
//!
//! Parameters: `max_distance` (m, 0.023), `max_vel` (m/s, 0.01) and `max_acc` (m/s², 1), all of the distance
//! between the fingers.

use takt_net::JointLimits;
use takt_net::device::{Answer, Gripper, Layout};
use takt_rt::Nanos;

use super::{Made, Parameters, Simulated, seconds};
use crate::device::last_stage::LastStage;
use crate::device::{DeviceCommand, DeviceDescription, DeviceState, DeviceStatus, Part};
use crate::error::Error;

/// Two bars that move 11.5 mm each.
const DISTANCE_MAX: f64 = 0.023;
const VELOCITY_MAX: f64 = 0.01;
/// Not specified for the real fingers.
const ACCELERATION_MAX: f64 = 1.0;
/// Distance at which an order is fulfilled, m.
const ARRIVED: f64 = 1e-9;

/// Error values of answers.
mod error {
    /// The distance is out of range or not finite.
    pub(super) const RANGE: i32 = 1;
    /// Its net ended before the order was executed.
    pub(super) const WITHDRAWN: i32 = 3;
}

pub(super) fn youbot(parameters: &Parameters<'_>, kind: &'static str) -> Result<Made, Error> {
    let distance_max = parameters.positive("max_distance", DISTANCE_MAX)?;
    let velocity_max = parameters.positive("max_vel", VELOCITY_MAX)?;
    let limits = JointLimits {
        position_min: 0.0,
        position_max: distance_max,
        velocity_max,
        acceleration_max: parameters.positive("max_acc", ACCELERATION_MAX)?,
    };
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
    gripper.distance.report(&mut state.signals, Some(0.0));
    let fingers = Fingers {
        gripper,
        stage: LastStage::new(limits),
        order: 0,
        state,
    };
    Ok((description, Box::new(fingers)))
}

#[derive(Debug)]
struct Fingers {
    gripper: Gripper,
    stage: LastStage,
    /// The order in progress.
    order: u64,
    state: DeviceState,
}

impl Simulated for Fingers {
    fn step(&mut self, command: &DeviceCommand, dt: Nanos) {
        self.state.stamp = command.time;
        let Some(order) = self.gripper.order.command.read(&command.words) else {
            self.stage.brake(seconds(dt));
            return;
        };
        let possible = (0.0..=self.gripper.distance_max).contains(&order.value);
        if self.order != order.cycle {
            self.order = order.cycle;
            // An order is no set-point that the fingers could fall behind.
            self.stage.begin_quietly(self.gripper.distance_max);
        }
        let mut arrived = false;
        // The fingers brake without their net.
        if possible && !order.is_withdrawn() {
            let distance = self.stage.track(order.value, 0.0, seconds(dt));
            arrived = (distance - order.value).abs() <= ARRIVED;
        } else {
            self.stage.brake(seconds(dt));
        }
        self.state.limited[0] = *self.stage.limited();
        let (distance, ..) = self.stage.motion();
        let is_there = (distance - order.value).abs() <= ARRIVED;
        let error = match (possible, order.is_withdrawn()) {
            (false, _) => Some(error::RANGE),
            (true, true) => (!is_there).then_some(error::WITHDRAWN),
            (true, false) => arrived.then_some(0),
        };
        let answer = error.map(|error| Answer {
            order: order.cycle,
            error,
        });
        let signals = &mut self.state.signals;
        self.gripper.distance.report(signals, Some(distance));
        // Answers belong to an order by its number.
        if answer.is_some() {
            self.gripper.order.answer.report(signals, answer);
        }
    }

    fn state(&self) -> &DeviceState {
        &self.state
    }
}
