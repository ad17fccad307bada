//! `Motion::Ptp`: all joints from one position to another, synchronised. The path of the flange is
//! not considered.

use takt_net::{ArrayOut, Build, Cycle, Definition, Fault, NullRule, Primitive};

use super::profile::Bounds;
use super::runner::{Runner, with_ports};
use super::{joint_bounds, joint_positions, with_joint_limits};

struct Ptp {
    runner: Runner,
    from: Box<[f64]>,
    to: Box<[f64]>,
    position: ArrayOut<f64>,
    velocity: ArrayOut<f64>,
}

impl Primitive for Ptp {
    fn step(&mut self, cycle: &Cycle<'_>) {
        let progress = self.runner.step(cycle);
        let ends = || self.from.iter().zip(&self.to);
        let position = |(from, to): (&f64, &f64)| from * (1.0 - progress.part) + to * progress.part;
        let speed = |(from, to): (&f64, &f64)| (to - from) * progress.rate;
        self.position.set(cycle, ends().map(position));
        self.velocity.set(cycle, ends().map(speed));
    }
}

/// Length of the straight line in joint space, measured by the joint with the longest distance
/// (rad), and the bounds along it that keep the bounds of every joint.
fn line(from: &[f64], to: &[f64], bounds: &[Bounds]) -> (f64, Bounds) {
    let distances = || from.iter().zip(to).map(|(from, to)| (to - from).abs());
    let length = distances().fold(0.0, f64::max);
    let first = bounds[0];
    let along = distances()
        .zip(bounds)
        .filter(|(distance, _)| *distance > 0.0);
    let along = along.map(|(distance, bounds)| bounds.scaled(length / distance));
    (length, along.reduce(Bounds::and).unwrap_or(first))
}

fn build(b: &mut Build<'_, '_>) -> Result<Ptp, Fault> {
    let given = |parameter| b.array::<f64>(parameter).map(|values| values.len());
    let joints = given("From")?.max(given("To")?);
    if joints == 0 {
        return Err(b.parameter_fault("From", "a motion needs at least one joint".to_owned()));
    }
    let from = joint_positions(b, "From", joints)?;
    let to = joint_positions(b, "To", joints)?;
    let (length, bounds) = line(&from, &to, &joint_bounds(b, joints)?);
    Ok(Ptp {
        runner: Runner::new(b, length, bounds)?,
        from: from.into(),
        to: to.into(),
        position: b.array_output("outPosition", joints)?,
        velocity: b.array_output("outVelocity", joints)?,
    })
}

pub(super) fn definition() -> Definition {
    let definition = Definition::new(
        "Motion::Ptp",
        "Moves joints from one position to another along a straight line in the space of the \
         joints, as fast as the limits of all of them allow; they start and arrive together.",
        build,
    )
    .array_parameter::<f64>("From", "[0]", "position of each joint at the start, rad")
    .array_parameter::<f64>("To", "[0]", "position of each joint at the end, rad")
    .array_output::<f64>("outPosition", "position of each joint, rad")
    .array_output::<f64>("outVelocity", "velocity of each joint, rad/s");
    with_ports(with_joint_limits(definition)).null(NullRule::Own(
        "Never null while active; a null override holds the motion.",
    ))
}
