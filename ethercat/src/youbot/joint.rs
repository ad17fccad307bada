//! A joint of the arm: converts encoder ticks, motor speed and motor current to angle, speed and torque of the joint,
//! and computes joint impedance. Limits and set-points belong to the device.

use std::f64::consts::TAU;

use super::HomingConfig;

/// Encoder ticks in a revolution of the motor.
const TICKS: f64 = 4000.0;
/// Inertia of a motor's rotor, kg m²: a typical value, as its data sheet was not available. It affects damping, and
/// which springs a cycle admits.
const ROTOR: f64 = 1.35e-5;

/// Transmission from a motor to its joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointGeometry {
    /// Gear ratio: motor revolutions per joint revolution.
    pub gear: f64,
    /// 1 if both count in the same direction, else -1.
    pub sign: f64,
    /// Angle of the joint at its home stop, where the encoder is zero, rad.
    pub offset: f64,
    /// Torque constant of the motor, N m/A.
    pub torque_constant: f64,
}

const fn joint(gear: f64, sign: f64, torque_constant: f64) -> JointGeometry {
    JointGeometry {
        gear,
        sign,
        offset: 0.0,
        torque_constant,
    }
}

/// The joints of the arm, from the base. At the home stop all angles are 0, as in the kinematics `kuka_youbot`.
pub const ARM: [JointGeometry; 5] = [
    joint(156.0, -1.0, 0.0335),
    joint(156.0, -1.0, 0.0335),
    joint(100.0, 1.0, 0.0335),
    joint(71.0, -1.0, 0.051),
    joint(71.0, -1.0, 0.049),
];

/// Homing of each joint: about 1 rad/s towards its stop, up to a current threshold.
pub const HOMING: [HomingConfig; 5] = [
    HomingConfig::new(156, 2000),
    HomingConfig::new(156, 500),
    HomingConfig::new(100, 1000),
    HomingConfig::new(71, 500),
    HomingConfig::new(71, 500),
];

/// Largest current of each motor unless configured otherwise, mA.
pub const CURRENT_MAX_MA: [i32; 5] = [4000, 4000, 3000, 2000, 1500];

#[expect(
    clippy::cast_possible_truncation,
    reason = "it saturates, which no angle of a joint reaches"
)]
const fn whole(value: f64) -> i32 {
    value.round() as i32
}

impl JointGeometry {
    /// Ticks at an angle of the joint, rad.
    pub fn ticks(&self, angle: f64) -> i32 {
        whole(self.sign * (angle - self.offset) * self.gear * TICKS / TAU)
    }

    /// Angle of the joint, rad.
    pub fn angle(&self, ticks: i32) -> f64 {
        self.sign * f64::from(ticks) * TAU / (self.gear * TICKS) + self.offset
    }

    /// Motor speed at a speed of the joint, rad/s.
    pub fn rpm(&self, speed: f64) -> i32 {
        whole(self.sign * speed * self.gear * 60.0 / TAU)
    }

    /// Speed of the joint, rad/s.
    pub fn speed(&self, rpm: i32) -> f64 {
        self.sign * f64::from(rpm) * TAU / (60.0 * self.gear)
    }

    /// Motor current for a torque at the joint, N m; gear losses are unknown.
    pub fn current_ma(&self, torque: f64) -> i32 {
        whole(self.sign * torque / (self.gear * self.torque_constant) * 1000.0)
    }

    /// Torque at the joint, N m.
    pub fn torque(&self, current_ma: i32) -> f64 {
        self.sign * f64::from(current_ma) / 1000.0 * self.torque_constant * self.gear
    }

    /// Inertia of the rotor at the joint, kg m².
    pub fn inertia(&self) -> f64 {
        ROTOR * self.gear * self.gear
    }
}

/// Joint impedance: a spring to the commanded position and a damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impedance {
    /// N m/rad, from 0.
    pub stiffness: f64,
    /// Damping ratio, 0 to 1.
    pub damping: f64,
    /// Largest torque of spring and damper, N m; none up to 0.
    pub torque_max: f64,
    /// Additional torque, N m.
    pub added: f64,
}

impl Default for Impedance {
    fn default() -> Self {
        Self {
            stiffness: 50.0,
            damping: 0.7,
            torque_max: 0.0,
            added: 0.0,
        }
    }
}

impl Impedance {
    /// Torque at the joint for a position error (rad) and a speed error (rad/s), both commanded minus measured.
    pub fn torque(&self, joint: &JointGeometry, deviation: f64, speed: f64) -> f64 {
        let damper = 2.0 * self.damping * (self.stiffness * joint.inertia()).sqrt();
        let torque = self.stiffness * deviation + damper * speed;
        let limited = if self.torque_max > 0.0 {
            torque.clamp(-self.torque_max, self.torque_max)
        } else {
            torque
        };
        limited + self.added
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values recorded from the vendor's driver for these angles.
    #[test]
    fn angles_match_ticks_of_the_vendor_driver() {
        let cases = [
            (1.0, -99_313),
            (0.5, -49_656),
            (-1.0, -63_662),
            (0.8, -36_160),
            (1.5, -67_800),
        ];
        for ((angle, ticks), joint) in cases.into_iter().zip(ARM) {
            assert!((joint.ticks(angle) - ticks).abs() <= 1, "{angle}");
            assert!((joint.angle(ticks) - angle).abs() < 1e-4);
        }
    }

    #[test]
    fn speeds_and_torques_convert_back() {
        for joint in ARM {
            let turned = JointGeometry {
                offset: 0.3,
                ..joint
            };
            assert_eq!(turned.ticks(0.3), 0);
            assert!((joint.speed(joint.rpm(1.0)) - 1.0).abs() < 0.01);
            assert!((joint.torque(joint.current_ma(2.0)) - 2.0).abs() < 0.01);
            assert!(joint.torque(joint.current_ma(-1.0)) < 0.0);
            // Homing moves towards the stop, away from the joint's range.
        }
        assert!((ARM[0].torque(1000) + 5.226).abs() < 1e-9, "156 * 0.0335");
    }

    #[test]
    fn impedance_spring_stays_within_its_torque() {
        let law = Impedance {
            stiffness: 20.0,
            damping: 0.5,
            torque_max: 3.0,
            added: 0.25,
        };
        assert!((law.torque(&ARM[0], 0.1, 0.0) - 2.25).abs() < 1e-9);
        assert!((law.torque(&ARM[0], -1.0, 0.0) + 2.75).abs() < 1e-9);
        assert!(law.torque(&ARM[0], 0.0, -0.1) < 0.25, "it damps");
        let free = Impedance {
            torque_max: 0.0,
            ..law
        };
        assert!((free.torque(&ARM[0], 1.0, 0.0) - 20.25).abs() < 1e-9);
    }
}
