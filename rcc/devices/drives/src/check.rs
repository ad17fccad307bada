//! Checks the configuration of an arm of drives and describes the arm to nets. It does not access drives.

use takt_cia402::State;
use takt_cia402::proof::Objects;
use takt_net::JointLimits;

use crate::config::{DriveArm, DriveJoint};
use crate::torque::Torques;
use takt_core::device::parts::with_figures;
use takt_core::device::{ARM_JOINTS_MAX, DeviceDescription, Figure, LEAST, MOST, Part};

/// The limits of a joint as nets see them.
pub fn limits_of<D>(joint: &DriveJoint<D>) -> JointLimits {
    JointLimits {
        position_min: joint.range[0].to_radians(),
        position_max: joint.range[1].to_radians(),
        velocity_max: joint.velocity_max.to_radians(),
        acceleration_max: joint.acceleration_max.to_radians(),
    }
}

/// The parts of an arm besides its joints: what its drives measure and report, and what its bus does.
pub fn parts<D>(arm: &DriveArm<D>, of_bus: impl IntoIterator<Item = Figure>) -> Vec<Part> {
    let of_joint = |n| {
        [
            Figure::number(format!("joint.{n}.statusword")),
            Figure::state(format!("joint.{n}.drive_state"), State::ALL),
        ]
    };
    let torques = Torques::is_measuring(arm).then_some(Part::Torques);
    let measured: Vec<_> = torques.into_iter().collect();
    with_figures(
        &measured,
        (0..arm.joints.len()).flat_map(of_joint).chain(of_bus),
    )
}

/// The arm as a device of that type, whose bus has these figures.
pub fn describe<D>(
    arm: &DriveArm<D>,
    kind: &'static str,
    of_bus: impl IntoIterator<Item = Figure>,
) -> DeviceDescription {
    DeviceDescription {
        name: arm.name.clone(),
        kind,
        limits: arm.joints.iter().map(limits_of).collect(),
        model: arm.model.clone(),
        parts: parts(arm, of_bus),
    }
}

/// Checks an arm; `drive` checks the drive of a joint.
pub fn check<D>(
    arm: &DriveArm<D>,
    drive: impl Fn(&DriveJoint<D>) -> Result<(), String>,
) -> Result<(), String> {
    let wrong = |what: String| Err(format!("arm {}: {what}", arm.name));
    let joints = arm.joints.len();
    if !(1..=ARM_JOINTS_MAX).contains(&joints) {
        return wrong(format!("{joints} joints; an arm has 1 to {ARM_JOINTS_MAX}"));
    }
    let limits: Vec<_> = arm.joints.iter().map(limits_of).collect();
    let has_model = arm.model.is_empty() || arm.model.limited(&limits).is_some();
    match arm.model.arm() {
        Some(of_file) if of_file.joints.len() != joints => {
            let (count, file) = (of_file.joints.len(), &of_file.file);
            return wrong(format!("{joints} joints, but {count} in {file}"));
        }
        Some(_) | None if !has_model => {
            let model = &arm.model;
            return wrong(format!("there is no model `{model}` of {joints} joints"));
        }
        Some(_) | None => {}
    }
    for (number, joint) in arm.joints.iter().enumerate() {
        if let Err(what) = check_joint(joint).and_then(|()| drive(joint)) {
            return wrong(format!("joint {number}: {what}"));
        }
    }
    if let Some(of_file) = arm.model.arm() {
        let joints = of_file.joints.iter().zip(&limits).enumerate();
        for (number, (joint, limits)) in joints {
            if let Some(why) = joint.exceeded_by(limits) {
                let (name, file, line) = (&joint.name, &of_file.file, joint.line);
                return wrong(format!("joint {number}: {why} of `{name}` ({file}:{line})"));
            }
        }
    }
    Ok(())
}

fn check_joint<D>(joint: &DriveJoint<D>) -> Result<(), String> {
    let DriveJoint {
        increments_per_turn,
        zero,
        range: [low, high],
        velocity_max,
        acceleration_max,
        following_error_max,
        not_mirrored,
        ..
    } = joint;
    let above_zero = |value: &f64| (LEAST..=MOST).contains(value);
    let sound = increments_per_turn.is_normal()
        && [zero, low, high].iter().all(|value| value.is_finite())
        && low < high
        && above_zero(velocity_max)
        && above_zero(acceleration_max);
    if !sound {
        return Err(
            "increments_per_turn must not be 0, range must go up, velocity_max and acceleration_max must be \
             from 1e-6 to 1e9, and all of them and zero must be finite"
                .to_owned(),
        );
    }
    if following_error_max.is_some_and(|most| !above_zero(&most)) {
        return Err("following_error_max must be from 1e-6 to 1e9".to_owned());
    }
    if let Err(index) = Objects::of(not_mirrored) {
        return Err(format!(
            "not_mirrored: {index:04X}h is no object of an axis; name objects of the first axis that PDOs carry, such as 607Ah"
        ));
    }
    for end in [low, high] {
        let increments = end / 360.0 * increments_per_turn + zero;
        if increments.abs() > f64::from(i32::MAX) {
            return Err(format!(
                "{end} degrees are {increments:.0} increments, which do not fit the 32 bits of 607Ah"
            ));
        }
    }
    Ok(())
}
