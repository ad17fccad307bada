//! The gripper of a youBot: two bars that stepper motors move without seeing where they are. The
//! drive of the last joint passes on what is for them.

use super::parameters::{Parameters, whole};
use super::tmcl::{Refusal, Request, command};

/// A bar of the gripper: a stepper motor that does not see where it is.
#[derive(Clone, Debug)]
pub struct Bar {
    /// What it has counted, steps.
    count: f64,
    target: f64,
    /// Where it is: 0 closed, -67000 open, steps.
    pub(super) place: f64,
    parameters: Parameters,
    /// Something holds it: its motor stalls, stops and does not count.
    pub jammed: bool,
}

/// Where a bar stops when it opens, steps: 11.5 mm.
const OPEN: f64 = -67_000.0;
/// Steps a second for each unit of parameter 4.
const BAR_SPEED: f64 = 25.0;

impl Bar {
    pub(super) fn new(place: f64) -> Self {
        Self {
            count: 0.0,
            target: 0.0,
            place,
            parameters: Parameters::bar(),
            jammed: false,
        }
    }

    /// How far it is open, m.
    #[must_use]
    pub fn opening(&self) -> f64 {
        self.place / OPEN * 0.0115
    }

    pub(super) fn step(&mut self, dt: f64) {
        let speed = if self.jammed { 0.0 } else { BAR_SPEED };
        let most = f64::from(self.parameters.value(4)) * speed * dt;
        let by = (self.target - self.count).clamp(-most, most);
        self.count += by;
        // At its stop it loses steps.
        self.place = (self.place + by).clamp(OPEN, 0.0);
        let reached = (self.target - self.count).abs() < 0.5;
        self.parameters.set(8, i32::from(reached));
        self.parameters.set(1, whole(self.count));
        self.parameters.set(0, whole(self.target));
    }

    pub(super) fn tmcl(&mut self, request: &Request) -> Result<i32, Refusal> {
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
            _ => return Err(Refusal::InvalidCommand),
        }
        Ok(request.value)
    }
}
