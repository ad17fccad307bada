//! Motion of an emulated arm: stiff behind its set-point, or compliant against a contact. Each joint has a constant
//! inertia, and gravity is compensated: enough to try compliant motion, no model of the real arm.

use super::AXES;
use super::chain::{Chain, Jacobian, Pose, turn};
use super::contact::Contact;
use super::surroundings::{Flange, Surroundings};
use nalgebra::{SMatrix, SVector, Vector3};
use std::time::Duration;

/// Of the earth, m/s2.
pub(super) const GRAVITY: f64 = 9.81;
/// Integration step: short against the fastest joint on the stiffest contact.
const STEP_S: f64 = 0.000_25;
/// Effective inertia of each joint, kg m2: *assumption*.
pub(crate) const INERTIA: [f64; AXES] = [1.5, 1.5, 0.8, 0.8, 0.3, 0.3, 0.15];
/// Effective mass and inertia of the flange for the damping of Cartesian impedance, kg and kg m2: *assumption*.
const FLANGE: [f64; 6] = [5.0, 5.0, 5.0, 0.2, 0.2, 0.2];
/// Friction in all control modes, Nms/rad: *assumption*.
const FRICTION: f64 = 1.0;
/// Stiffness that keeps the elbow in place in Cartesian impedance control, Nm/rad: *assumption*.
const NULL_SPACE: f64 = 20.0;

type Joints = [f64; AXES];

/// Active control strategy and its parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Law {
    /// Follows the set-point with the lag of the drives.
    Position,
    /// tau = k (q_set - q) - D + overlay.
    Joint {
        /// Nm/rad.
        stiffness: [f64; AXES],
        /// 0..=1.
        damping: [f64; AXES],
        /// Nm.
        overlay: [f64; AXES],
    },
    /// tau = J^T (k (x_set - x) - D + overlay), x_set the forward kinematics of the set-point.
    Cartesian {
        /// N/m along x, y, z, then Nm/rad about x, y, z.
        stiffness: [f64; 6],
        /// 0..=1.
        damping: [f64; 6],
        /// N along x, y, z, then Nm about x, y, z.
        overlay: [f64; 6],
    },
}

/// The arm and its contact.
#[derive(Debug)]
pub(crate) struct Body {
    chain: Chain,
    /// Time constant of the drives, s.
    lag_s: f64,
    joints: Joints,
    speed: Joints,
    /// Flange pose at `joints`.
    pose: Pose,
    jacobian: Jacobian,
    /// What the tip of the tool touches.
    pub(crate) contact: Option<Contact>,
    /// What else the flange meets.
    pub(crate) surroundings: Option<Box<dyn Surroundings>>,
    /// Load that the controller states, kg, and its centre in the frame of the flange, m. The surroundings are to weigh as
    /// much; without surroundings the arm carries what is stated.
    pub(crate) load: (f64, [f64; 3]),
    /// End of the present cycle.
    pub(crate) now: Duration,
    /// Tip of the tool in the frame of the flange, m.
    pub(crate) tool: [f64; 3],
    /// External force on the flange, N, in the base frame.
    force: [f64; 3],
    /// Its moment about the flange, Nm.
    moment: [f64; 3],
    external: Joints,
    /// Of the drives, Nm, without gravity.
    torque: Joints,
}

impl Body {
    pub(crate) fn new(chain: Chain, joints: Joints, lag: Duration) -> Self {
        let (pose, jacobian) = chain.jacobian(&joints);
        Self {
            chain,
            lag_s: lag.as_secs_f64(),
            joints,
            speed: [0.0; AXES],
            pose,
            jacobian,
            contact: None,
            surroundings: None,
            load: (0.0, [0.0; 3]),
            now: Duration::ZERO,
            tool: [0.0; 3],
            force: [0.0; 3],
            moment: [0.0; 3],
            external: [0.0; AXES],
            torque: [0.0; AXES],
        }
    }

    /// Advances by `span_s` seconds towards `set_point`.
    pub(crate) fn advance(&mut self, set_point: &Joints, law: &Law, span_s: f64) {
        match law {
            Law::Position => {
                self.follow(set_point, span_s);
                self.touch(0.0);
                self.torque = self.external.map(|torque| -torque);
            }
            Law::Joint { .. } => self.integrate(span_s, |body| body.joint(set_point, law)),
            Law::Cartesian { .. } => {
                // Goal and null space do not change noticeably within one cycle.
                let goal = self.chain.forward(set_point);
                let elbow = self.null_space(set_point);
                self.integrate(span_s, |body| {
                    let mut torque = body.cartesian(&goal, law);
                    for (torque, elbow) in torque.iter_mut().zip(elbow) {
                        *torque += elbow;
                    }
                    torque
                });
            }
        }
    }

    fn integrate(&mut self, span_s: f64, law: impl Fn(&Self) -> Joints) {
        let mut left = span_s;
        while left > 1e-9 {
            let step = left.min(STEP_S);
            self.torque = law(self);
            for (joint, inertia) in INERTIA.into_iter().enumerate() {
                let total =
                    self.torque[joint] + self.external[joint] - self.speed[joint] * FRICTION;
                self.speed[joint] += total / inertia * step;
                self.joints[joint] += self.speed[joint] * step;
            }
            left -= step;
            self.touch(left);
        }
    }

    /// Stops: brakes closed.
    pub(crate) fn freeze(&mut self) {
        self.speed = [0.0; AXES];
        self.touch(0.0);
        self.torque = [0.0; AXES];
    }

    fn follow(&mut self, set_point: &Joints, span_s: f64) {
        let share = if self.lag_s > 0.0 {
            1.0 - (-span_s / self.lag_s).exp()
        } else {
            1.0
        };
        for (joint, set_point) in set_point.iter().enumerate() {
            let step = (set_point - self.joints[joint]) * share;
            self.speed[joint] = step / span_s;
            self.joints[joint] += step;
        }
    }

    /// Updates the flange pose and the contact force, `before_s` seconds before the end of the cycle.
    fn touch(&mut self, before_s: f64) {
        (self.pose, self.jacobian) = self.chain.jacobian(&self.joints);
        let flange = self.flange();
        let at = self
            .now
            .saturating_sub(Duration::from_secs_f64(before_s.max(0.0)));
        let mut sum = [0.0; 6];
        if let Some(contact) = &mut self.contact {
            sum = contact.wrench(at, &flange);
        }
        if let Some(surroundings) = &mut self.surroundings {
            let wrench = surroundings.wrench(at, &flange);
            for (sum, part) in sum.iter_mut().zip(wrench) {
                *sum += if part.is_finite() { part } else { 0.0 };
            }
            for (sum, part) in sum.iter_mut().zip(self.relief()) {
                *sum += part;
            }
        }
        let [x, y, z, a, b, c] = sum;
        (self.force, self.moment) = ([x, y, z], [a, b, c]);
        self.external = self.jacobian.torques(&sum);
    }

    fn flange(&self) -> Flange {
        let axes: [[f64; 3]; 3] = self.pose.rotation.into();
        Flange {
            position: self.pose.position.into(),
            axes,
            velocity: self.jacobian.times(&self.speed),
            tip: self.tip(),
        }
    }

    /// What the drives add to carry the stated load, as a wrench on the flange.
    fn relief(&self) -> [f64; 6] {
        let (mass, centre) = self.load;
        let up = Vector3::z() * (mass * GRAVITY);
        let moment = (self.pose.rotation * Vector3::from(centre)).cross(&up);
        [up.x, up.y, up.z, moment.x, moment.y, moment.z]
    }

    fn joint(&self, set_point: &Joints, law: &Law) -> Joints {
        let Law::Joint {
            stiffness,
            damping,
            overlay,
        } = law
        else {
            return [0.0; AXES];
        };
        std::array::from_fn(|i| {
            let k = stiffness[i].max(0.0);
            let d = 2.0 * damping[i].clamp(0.0, 1.0) * (k * INERTIA[i]).sqrt();
            k * (set_point[i] - self.joints[i]) - d * self.speed[i] + overlay[i]
        })
    }

    fn cartesian(&self, goal: &Pose, law: &Law) -> Joints {
        let Law::Cartesian {
            stiffness,
            damping,
            overlay,
        } = law
        else {
            return [0.0; AXES];
        };
        let away = away(&self.pose, goal);
        let velocity = self.jacobian.times(&self.speed);
        let wrench = std::array::from_fn(|i| {
            let k = stiffness[i].max(0.0);
            let d = 2.0 * damping[i].clamp(0.0, 1.0) * (k * FLANGE[i]).sqrt();
            k * away[i] - d * velocity[i] + overlay[i]
        });
        self.jacobian.torques(&wrench)
    }

    /// Torques that hold the elbow without moving the flange.
    fn null_space(&self, set_point: &Joints) -> Joints {
        let wanted: Joints = std::array::from_fn(|i| {
            (set_point[i] - self.joints[i]) * NULL_SPACE - self.speed[i] * (NULL_SPACE / 5.0)
        });
        let Some(inverse) = inverse(&self.jacobian) else {
            return [0.0; AXES];
        };
        let through = inverse * SVector::from(self.jacobian.times(&wanted));
        let moving = self.jacobian.torques(&through.into());
        std::array::from_fn(|i| wanted[i] - moving[i])
    }

    /// Measured joint positions, rad.
    pub(crate) fn joints(&self) -> Joints {
        self.joints
    }

    /// Joint torques that hold the arm's own weight, Nm.
    pub(crate) fn gravity(&self) -> Joints {
        self.chain.gravity(&self.joints)
    }

    /// Measured joint torques, Nm: what the sensors between drives and links read, the arm's own weight included.
    pub(crate) fn measured_torque(&self) -> Joints {
        let gravity = self.gravity();
        std::array::from_fn(|joint| self.torque[joint] + gravity[joint])
    }

    /// External joint torques, Nm.
    pub(crate) fn external(&self) -> Joints {
        self.external
    }

    /// External force on the flange, N, in the base frame.
    pub(crate) fn force(&self) -> [f64; 3] {
        self.force
    }

    /// Moment of that force about the flange in the base frame, about x, y and z, Nm.
    pub(crate) fn moment(&self) -> [f64; 3] {
        self.moment
    }

    /// Tip of the tool in the base frame, m.
    pub(crate) fn tip(&self) -> [f64; 3] {
        (self.pose.position + self.pose.rotation * Vector3::from(self.tool)).into()
    }

    /// Flange pose.
    pub(crate) fn pose(&self) -> Pose {
        self.pose
    }

    /// Flange pose at `joints`.
    pub(crate) fn pose_of(&self, joints: &Joints) -> Pose {
        self.chain.forward(joints)
    }

    /// Speed of the flange, m/s.
    pub(crate) fn flange_speed(&self) -> f64 {
        let [x, y, z, ..] = self.jacobian.times(&self.speed);
        Vector3::new(x, y, z).norm()
    }

    pub(crate) fn jacobian(&self) -> &Jacobian {
        &self.jacobian
    }

    /// Joint positions near `from` that put the flange at `goal`; `None` if a few damped Newton steps do not converge.
    pub(crate) fn reach(&self, from: &Joints, goal: &Pose) -> Option<Joints> {
        const STEPS: usize = 20;
        let mut joints = *from;
        for _ in 0..STEPS {
            let (pose, jacobian) = self.chain.jacobian(&joints);
            let away = SVector::from(away(&pose, goal));
            if away.norm() < 1e-7 {
                return Some(joints);
            }
            let step = jacobian.torques(&(inverse(&jacobian)? * away).into());
            for (joint, step) in joints.iter_mut().zip(step) {
                *joint += step;
            }
        }
        None
    }
}

/// From one pose to another: m, then rad about x, y, z.
fn away(here: &Pose, there: &Pose) -> [f64; 6] {
    let linear = there.position - here.position;
    let turn = turn(&here.rotation, &there.rotation);
    [linear.x, linear.y, linear.z, turn.x, turn.y, turn.z]
}

/// Inverse of the Jacobian times its transpose, damped so that it exists in singularities too.
fn inverse(jacobian: &Jacobian) -> Option<SMatrix<f64, 6, 6>> {
    const DAMPING: f64 = 1e-6;
    let square = SMatrix::<f64, 6, 6>::from_fn(|row, column| {
        let products = jacobian.0.iter().map(|axis| axis[row] * axis[column]);
        products.sum::<f64>() + if row == column { DAMPING } else { 0.0 }
    });
    square.try_inverse()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::contact::Shape;

    const Q: [f64; AXES] = [0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0];

    fn table(body: &Body, stiffness: f64) -> Contact {
        Contact {
            shape: Shape::Wall,
            point: body.pose().position.into(),
            normal: [0.0, 0.0, 1.0],
            stiffness,
            damping: 50.0,
        }
    }

    fn body() -> Body {
        Body::new(Chain::IIWA14, Q, Duration::from_millis(10))
    }

    fn cartesian(force: f64) -> Law {
        Law::Cartesian {
            stiffness: [2000.0, 2000.0, 2000.0, 200.0, 200.0, 200.0],
            damping: [0.7; 6],
            overlay: [0.0, 0.0, force, 0.0, 0.0, 0.0],
        }
    }

    #[test]
    fn body_joint_deflects_by_torque_over_stiffness() {
        let mut body = body();
        let mut overlay = [0.0; AXES];
        overlay[1] = 5.0;
        let law = Law::Joint {
            stiffness: [100.0; AXES],
            damping: [0.7; AXES],
            overlay,
        };
        for _ in 0..5000 {
            body.advance(&Q, &law, 0.001);
        }
        assert!(
            (body.joints()[1] - Q[1] - 0.05).abs() < 1e-6,
            "{:?}",
            body.joints()
        );
        assert!((body.joints()[3] - Q[3]).abs() < 1e-6);
    }

    #[test]
    fn body_cartesian_impedance_applies_commanded_force() {
        let mut body = body();
        body.contact = Some(table(&body, 20_000.0));
        for _ in 0..6000 {
            body.advance(&Q, &cartesian(-22.0), 0.001);
        }
        // 22 N on two parallel springs: 20,000 N/m of the table and 2,000 N/m of the controller.
        let force = body.force();
        assert!((force[2] - 20.0).abs() < 0.05, "{force:?}");
        let external = body
            .jacobian()
            .torques(&[force[0], force[1], force[2], 0.0, 0.0, 0.0]);
        assert!((external[1] - body.external()[1]).abs() < 1e-9 && external[1].abs() > 5.0);
        body.contact = None;
        body.advance(&Q, &cartesian(-22.0), 0.001);
        assert!(body.force()[2].abs() < 1e-12, "the contact is removed");
    }

    #[test]
    fn body_tool_contact_has_moment_about_flange() {
        let mut body = body();
        body.tool = [0.0, 0.0, 0.1];
        body.contact = Some(Contact {
            point: body.tip(),
            shape: Shape::Spring,
            ..table(&body, 20_000.0)
        });
        let mut lower = Q;
        lower[1] += 0.01;
        for _ in 0..1000 {
            body.advance(&lower, &Law::Position, 0.001);
        }
        let (force, moment) = (body.force(), body.moment());
        let lever = Vector3::from(body.tip()) - body.pose().position;
        assert!((lever.norm() - 0.1).abs() < 1e-9);
        let expected = lever.cross(&Vector3::from(force));
        assert!((Vector3::from(moment) - expected).norm() < 1e-9);
        assert!(expected.norm() > 1.0, "{expected}");
        let measured = body.measured_torque();
        assert!((measured[1] - body.torque[1] - body.gravity()[1]).abs() < 1e-9);
        assert!(body.gravity()[1].abs() > 10.0);
    }

    #[test]
    fn body_position_control_stays_stiff() {
        let mut body = body();
        body.contact = Some(table(&body, 20_000.0));
        let mut lower = Q;
        lower[1] += 0.01;
        for _ in 0..1000 {
            body.advance(&lower, &Law::Position, 0.001);
        }
        assert!((body.joints()[1] - lower[1]).abs() < 1e-9);
        assert!(body.force()[2] > 50.0 && body.torque[1] > 20.0);
        body.freeze();
        assert!(body.torque[1].abs() < 1e-12);
    }

    #[test]
    fn body_reaches_near_poses_only() {
        let body = body();
        let mut goal = body.pose();
        goal.position.x -= 0.02;
        let joints = body.reach(&Q, &goal).unwrap();
        assert!((body.pose_of(&joints).position - goal.position).norm() < 1e-6);
        goal.position.x = 3.0;
        assert_eq!(body.reach(&Q, &goal), None);
    }
}
