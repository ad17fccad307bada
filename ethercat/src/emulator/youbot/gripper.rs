//! The gripper of a youBot: two bars moved by stepper motors without position feedback. The drive of the last joint
//! forwards their requests.

use super::parameters::{Parameters, whole};
use super::tmcl::{Rejection, Request, command};

/// A bar of the gripper: a stepper motor without position feedback.
#[derive(Clone, Debug)]
pub struct Bar {
    /// Its counter, steps.
    count: f64,
    target: f64,
    /// Its position: 0 closed, -67000 open, steps.
    pub(super) position: f64,
    parameters: Parameters,
    /// It is blocked: its motor stalls, stops and does not count.
    pub jammed: bool,
}

/// Open stop of a bar, steps: 11.5 mm.
const OPEN: f64 = -67_000.0;
/// Steps per second for each unit of parameter 4.
const BAR_SPEED: f64 = 25.0;

impl Bar {
    pub(super) fn new(position: f64) -> Self {
        Self {
            count: 0.0,
            target: 0.0,
            position,
            parameters: Parameters::bar(),
            jammed: false,
        }
    }

    /// Opening, m.
    pub fn opening(&self) -> f64 {
        self.position / OPEN * 0.0115
    }

    pub(super) fn step(&mut self, dt: f64) {
        let speed = if self.jammed { 0.0 } else { BAR_SPEED };
        let most = f64::from(self.parameters.value(4)) * speed * dt;
        let by = (self.target - self.count).clamp(-most, most);
        self.count += by;
        // At its stop it loses steps.
        self.position = (self.position + by).clamp(OPEN, 0.0);
        let reached = (self.target - self.count).abs() < 0.5;
        self.parameters.set(8, i32::from(reached));
        self.parameters.set(1, whole(self.count));
        self.parameters.set(0, whole(self.target));
    }

    pub(super) fn tmcl(&mut self, request: &Request) -> Result<i32, Rejection> {
        let value = f64::from(request.value);
        match (request.command, request.kind) {
            (command::MVP, 0) => self.target = value,
            (command::MVP, 1) => self.target = self.count + value,
            (command::MST, _) => self.target = self.count,
            (command::GAP, number) => return self.parameters.get(number),
            (command::SAP, number) => {
                self.parameters.write(number, request.value, true)?;
                match number {
                    0 => self.target = value,
                    1 => (self.count, self.target) = (value, value),
                    _ => {}
                }
            }
            (command::STAP | command::RSAP, number) => {
                let restore = request.command == command::RSAP;
                return self.parameters.store(number, restore);
            }
            _ => return Err(Rejection::InvalidCommand),
        }
        Ok(request.value)
    }
}
