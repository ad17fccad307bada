//! The arms that execute a program: which devices they are, that they have the joints and the geometry that the program was
//! compiled for, and the limits that apply. Set-points are given by other primitives.

use std::sync::Arc;

use takt_net::device::{ArmBinding, Kinematics};
use takt_net::{Build, Fault, FaultKind, JointLimits};

use crate::code::Program;
use crate::spec::Robot;

/// Largest difference between the flange of a device and that of the model of the program, m.
const FLANGE_MAX_M: f64 = 1e-3;

/// The kinematics of the devices that parameter `Robots` names. The smaller one of the limits of device and program applies
/// to each joint from now on.
pub(super) fn arms(
    b: &mut Build<'_, '_>,
    program: &mut Program,
) -> Result<Vec<Option<Arc<dyn Kinematics>>>, Fault> {
    let text = b.text("Robots");
    if text.trim().is_empty() {
        return Ok(Vec::new());
    }
    let names: Vec<&str> = text.split(',').map(str::trim).collect();
    let robots = &mut program.system.robots;
    if names.len() != robots.len() {
        let (found, needed) = (names.len(), robots.len());
        let why = format!("{found} devices, but the program has {needed} robots");
        return Err(b.parameter_fault("Robots", why));
    }
    let mut arms = Vec::new();
    for (name, robot) in names.into_iter().zip(robots) {
        let Some(arm) = b.devices().arm(name) else {
            return Err(b.fault(unknown(b, name)));
        };
        fit(robot, &arm, name).map_err(|why| b.arm_fault("Robots", why))?;
        arms.push(arm.kinematics);
    }
    Ok(arms)
}

fn unknown(b: &Build<'_, '_>, name: &str) -> FaultKind {
    let mut known = b.devices().names();
    known.retain(|name| b.devices().arm(name).is_some());
    FaultKind::Device {
        kind: "robot arm",
        name: name.to_owned(),
        known,
    }
}

/// Compares a robot with a device, and takes over the limits of the device.
fn fit(robot: &mut Robot, arm: &ArmBinding, name: &str) -> Result<(), String> {
    let (found, needed) = (arm.limits.len(), robot.joints.len());
    if found != needed {
        let robot = &robot.name;
        return Err(format!(
            "robot `{robot}` of the program has {needed} joints, device `{name}` has {found}"
        ));
    }
    for (number, (joint, limits)) in (1..).zip(robot.joints.iter_mut().zip(arm.limits.iter())) {
        let JointLimits {
            position_min,
            position_max,
            velocity_max,
            acceleration_max,
        } = *limits;
        joint.min = joint.min.max(position_min.to_degrees());
        joint.max = joint.max.min(position_max.to_degrees());
        joint.speed = joint.speed.min(velocity_max.to_degrees());
        joint.acceleration = joint.acceleration.min(acceleration_max.to_degrees());
        if joint.min >= joint.max {
            return Err(format!(
                "joint {number} of robot `{}` of the program and of device `{name}` have no position in common",
                robot.name
            ));
        }
    }
    if let Some(off) = flange_difference(robot, arm)
        && off > FLANGE_MAX_M
    {
        return Err(format!(
            "robot `{}` of the program is a {}, device `{name}` has other dimensions: its flange is {:.0} mm away in the \
             same joint positions",
            robot.name,
            robot.model,
            off * 1e3
        ));
    }
    Ok(())
}

/// Distance of the flanges with each joint in a different place of its range; `None` if one of them is not known.
fn flange_difference(robot: &Robot, arm: &ArmBinding) -> Option<f64> {
    let device = arm.kinematics.as_ref()?;
    let model = robot.model.unlimited()?;
    let bent = robot
        .joints
        .iter()
        .zip([0.3, 0.6, 0.4, 0.7, 0.45, 0.65, 0.35]);
    let bent: Vec<f64> = bent
        .map(|(joint, part)| (joint.min + (joint.max - joint.min) * part).to_radians())
        .collect();
    let [a, b] = [device, &model].map(|arm| arm.forward(&bent).translation.vector);
    Some((a - b).norm())
}
