//! The weight of what an arm carries, for arms of any kinematics: the torques that hold it. The arm's own masses are not known here.

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use takt_net::Twist;
use takt_net::device::Kinematics;

use super::{Body, GRAVITY};
use crate::kinematics::JOINTS_MAX;

/// Heaviest payload, kg, and farthest centre of mass, m: beyond is an error of a unit.
const MASS_MAX: f64 = 2000.0;
const CENTRE_MAX: f64 = 10.0;

/// What an arm carries at its flange, as a cell file has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, try_from = "Given")]
pub struct Payload {
    /// Mass, kg.
    pub mass: f64,
    /// Centre of mass in the flange, m.
    pub centre_of_mass: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Given {
    mass: f64,
    #[serde(default)]
    centre_of_mass: [f64; 3],
}

impl TryFrom<Given> for Payload {
    type Error = String;

    fn try_from(given: Given) -> Result<Self, String> {
        let Given {
            mass,
            centre_of_mass,
        } = given;
        if !(0.0..=MASS_MAX).contains(&mass) {
            return Err(format!("`mass` is {mass}; it must be 0 to {MASS_MAX} kg"));
        }
        let is_near = |at: &f64| at.abs() <= CENTRE_MAX;
        if !centre_of_mass.iter().all(is_near) {
            return Err(format!(
                "`centre_of_mass` is {centre_of_mass:?}; each must be within {CENTRE_MAX} m\nhint: metres, in the frame of the flange"
            ));
        }
        Ok(Self {
            mass,
            centre_of_mass,
        })
    }
}

impl Payload {
    /// The payload as a body of the flange: all its mass in its centre.
    #[must_use]
    pub fn body(&self) -> Body {
        Body::new(self.mass, self.centre_of_mass.into(), Matrix3::zeros())
    }
}

/// The direction of gravity in the base of an arm, as a cell file has it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "[f64; 3]")]
pub struct Down([f64; 3]);

impl Default for Down {
    /// Of an arm that stands.
    fn default() -> Self {
        Self([0.0, 0.0, -1.0])
    }
}

impl TryFrom<[f64; 3]> for Down {
    type Error = String;

    /// Of any length but 0.
    fn try_from(given: [f64; 3]) -> Result<Self, String> {
        if (1e-3..=1e3).contains(&Vector3::from(given).norm()) {
            return Ok(Self(given));
        }
        Err(format!(
            "{given:?} is no direction\nhint: `down` is [0, 0, -1] for an arm that stands, [0, 0, 1] for one that hangs"
        ))
    }
}

impl Down {
    /// The acceleration of gravity, m/s².
    #[must_use]
    pub fn gravity(&self) -> Vector3<f64> {
        Vector3::from(self.0).normalize() * GRAVITY
    }
}

/// The torque (Nm) or force (N) of each joint that holds a load at rest, in the frame of the flange, at these joint positions.
/// `gravity` is its acceleration in the base of the arm, m/s². NaN for all if there are not as many positions and torques as joints.
pub fn weight(
    arm: &dyn Kinematics,
    joints: &[f64],
    load: &Body,
    gravity: &Vector3<f64>,
    torques: &mut [f64],
) {
    let count = arm.joints();
    let mut columns = [Twist::default(); JOINTS_MAX];
    let Some(columns) = columns.get_mut(..count) else {
        return torques.fill(f64::NAN);
    };
    if [joints.len(), torques.len()] != [count; 2] {
        return torques.fill(f64::NAN);
    }
    arm.jacobian(joints, columns);
    let moment = arm.forward(joints).rotation * load.moment;
    for (torque, Twist { vel, rot }) in torques.iter_mut().zip(columns) {
        let vel = Vector3::new(vel.x, vel.y, vel.z);
        let rot = Vector3::new(rot.x, rot.y, rot.z);
        *torque = -gravity.dot(&(vel * load.mass + rot.cross(&moment)));
    }
}
