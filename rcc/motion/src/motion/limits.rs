//! Limits and positions of motions, as parameters: names, definitions and checks. Each motion decides what they bound.

use takt_net::{Build, Definition, Fault};

use super::bounds::Bounds;

/// Largest allowed coordinate (rad or m) and limit: beyond, numbers lose precision.
pub(super) const LARGEST: f64 = 1e6;
/// Smallest allowed limit.
pub(super) const SMALLEST: f64 = 1e-6;

pub(super) const VELOCITY: &str = "Velocity";
pub(super) const ACCELERATION: &str = "Acceleration";
pub(super) const JERK: &str = "Jerk";
pub(super) const SPEED: &str = "Speed";

/// Checks a limit.
pub(super) fn limit(b: &Build<'_, '_>, parameter: &'static str, value: f64) -> Result<f64, Fault> {
    if (SMALLEST..=LARGEST).contains(&value) {
        return Ok(value);
    }
    let why = format!("{value} is not a limit; it must be between {SMALLEST} and {LARGEST}");
    Err(b.parameter_fault(parameter, why))
}

/// The part of the speed at which a motion takes its time.
pub(super) fn speed(b: &Build<'_, '_>) -> Result<f64, Fault> {
    b.double(SPEED, f64::MIN_POSITIVE..=1.0)
}

/// Limits at a part of the speed.
pub(super) fn slowed(b: &Build<'_, '_>, bounds: Bounds, speed: f64) -> Result<Bounds, Fault> {
    let slowed = bounds.at_speed(speed);
    for value in [slowed.velocity, slowed.acceleration, slowed.jerk] {
        limit(b, SPEED, value)?;
    }
    Ok(slowed)
}

/// Adds the parameter of the speed.
pub(super) fn with_speed(definition: Definition) -> Definition {
    definition.parameter::<f64>(
        SPEED,
        "1",
        "part of the speed, above 0 to 1: it scales time, so velocities by it, accelerations by its square, jerks by its cube; \
         what brakes (a stop, a hold, a state beyond these limits) has the whole limits of acceleration and jerk",
    )
}

/// The elements of an array parameter for `joints` joints; a single element applies to all of them.
fn by_joint(b: &Build<'_, '_>, parameter: &'static str, joints: usize) -> Result<Vec<f64>, Fault> {
    let mut values: Vec<f64> = b.array(parameter)?;
    if let [all] = *values {
        values.resize(joints, all);
    }
    if values.len() == joints {
        return Ok(values);
    }
    let found = values.len();
    let why = format!(
        "{found} values, but the motion has {joints} joints; set one value for each or one for all"
    );
    Err(b.parameter_fault(parameter, why))
}

/// The limits of each joint.
pub(super) fn joint_bounds(b: &Build<'_, '_>, joints: usize) -> Result<Vec<Bounds>, Fault> {
    let checked = |parameter| -> Result<Vec<f64>, Fault> {
        let values = by_joint(b, parameter, joints)?;
        values.into_iter().map(|v| limit(b, parameter, v)).collect()
    };
    let [velocity, acceleration, jerk] =
        [checked(VELOCITY)?, checked(ACCELERATION)?, checked(JERK)?];
    let bounds = |joint| Bounds {
        velocity: velocity[joint],
        acceleration: acceleration[joint],
        jerk: jerk[joint],
    };
    Ok((0..joints).map(bounds).collect())
}

/// The positions of all joints, checked for plausible numbers.
pub(super) fn joint_positions(
    b: &Build<'_, '_>,
    parameter: &'static str,
    joints: usize,
) -> Result<Vec<f64>, Fault> {
    let values = by_joint(b, parameter, joints)?;
    match values.iter().find(|v| !is_sensible(**v)) {
        Some(value) => {
            let why = format!("{value} is not a position; it must be within ±{LARGEST}");
            Err(b.parameter_fault(parameter, why))
        }
        None => Ok(values),
    }
}

pub(super) fn is_sensible(value: f64) -> bool {
    value.abs() <= LARGEST
}

/// Adds the parameters of joint limits.
pub(super) fn with_joint_limits(definition: Definition) -> Definition {
    definition
        .array_parameter::<f64>(
            VELOCITY,
            "[0.1]",
            "velocity limit by joint, or one for all, rad/s",
        )
        .array_parameter::<f64>(
            ACCELERATION,
            "[0.5]",
            "acceleration limit by joint, or one for all, rad/s²",
        )
        .array_parameter::<f64>(JERK, "[5]", "jerk limit by joint, or one for all, rad/s³")
}
