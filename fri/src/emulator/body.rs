//! How an emulated arm moves: stiff behind its set-point, or compliant against a contact. Its inertia is a constant per joint
//! and its gravity compensated: enough to try compliant motion, no model of the real arm.

use super::AXES;
use super::chain::{Chain, Jacobian, Place, turn};
use super::contact::Contact;
use nalgebra::{SMatrix, SVector, Vector3};
use std::time::Duration;

/// Step of integration: short against the fastest joint on the stiffest contact.
const STEP_S: f64 = 0.000_25;
/// Effective inertia of each joint, kg m2: *assumption*.
pub(crate) const INERTIA: [f64; AXES] = [1.5, 1.5, 0.8, 0.8, 0.3, 0.3, 0.15];
/// Effective mass and inertia of the flange for the damping of Cartesian impedance, kg and kg m2: *assumption*.
const FLANGE: [f64; 6] = [5.0, 5.0, 5.0, 0.2, 0.2, 0.2];
/// Friction that is always there, Nms/rad: *assumption*.
const FRICTION: f64 = 1.0;
/// Stiffness that keeps the elbow where it is in Cartesian impedance control, Nm/rad: *assumption*.
const NULL_SPACE: f64 = 20.0;

type Joints = SVector<f64, AXES>;

/// The control strategy in force and its parameters.
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

/// The arm and what it touches.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    chain: Chain,
    /// Time constant of the drives, s.
    lag_s: f64,
    joints: Joints,
    speed: Joints,
    /// What the flange touches.
    pub(crate) contact: Option<Contact>,
    /// External force on the flange, N, in the base frame.
    force: Vector3<f64>,
    external: Joints,
    torque: Joints,
}

impl Body {
    pub(crate) fn new(chain: Chain, joints: [f64; AXES], lag: Duration) -> Self {
        Self {
            chain,
            lag_s: lag.as_secs_f64(),
            joints: joints.into(),
            speed: Joints::zeros(),
            contact: None,
            force: Vector3::zeros(),
            external: Joints::zeros(),
            torque: Joints::zeros(),
        }
    }

    /// Moves on for `span_s` seconds towards `set_point`.
    pub(crate) fn advance(&mut self, set_point: &[f64; AXES], law: &Law, span_s: f64) {
        let set_point = Joints::from(*set_point);
        if *law == Law::Position {
            self.follow(&set_point, span_s);
            self.touch();
            self.torque = -self.external;
            return;
        }
        let mut left = span_s;
        while left > 0.0 {
            let step = left.min(STEP_S);
            let jacobian = self.touch();
            self.torque = self.law(&set_point, law, &jacobian);
            let total = self.torque + self.external - self.speed * FRICTION;
            self.speed += total.component_div(&Joints::from(INERTIA)) * step;
            self.joints += self.speed * step;
            left -= step;
        }
    }

    /// Stands still: brakes closed.
    pub(crate) fn freeze(&mut self) {
        self.speed = Joints::zeros();
        self.touch();
        self.torque = Joints::zeros();
    }

    fn follow(&mut self, set_point: &Joints, span_s: f64) {
        let share = if self.lag_s > 0.0 {
            1.0 - (-span_s / self.lag_s).exp()
        } else {
            1.0
        };
        let step = (set_point - self.joints) * share;
        self.speed = step / span_s;
        self.joints += step;
    }

    /// Feels the contact; the Jacobian is needed again.
    fn touch(&mut self) -> Jacobian {
        let (place, jacobian) = self.chain.jacobian(&self.joints.into());
        let linear = jacobian.fixed_view::<3, AXES>(0, 0);
        let velocity = linear * self.speed;
        self.force = self
            .contact
            .map_or_else(Vector3::zeros, |it| it.force(&place.position, &velocity));
        self.external = linear.tr_mul(&self.force);
        jacobian
    }

    fn law(&self, set_point: &Joints, law: &Law, jacobian: &Jacobian) -> Joints {
        match law {
            Law::Position => Joints::zeros(),
            Law::Joint {
                stiffness,
                damping,
                overlay,
            } => Joints::from_fn(|i, _| {
                let k = stiffness[i].max(0.0);
                let d = 2.0 * damping[i].clamp(0.0, 1.0) * (k * INERTIA[i]).sqrt();
                k * (set_point[i] - self.joints[i]) - d * self.speed[i] + overlay[i]
            }),
            Law::Cartesian {
                stiffness,
                damping,
                overlay,
            } => {
                let away = self.away(set_point);
                let velocity = jacobian * self.speed;
                let force = SVector::<f64, 6>::from_fn(|i, _| {
                    let k = stiffness[i].max(0.0);
                    let d = 2.0 * damping[i].clamp(0.0, 1.0) * (k * FLANGE[i]).sqrt();
                    k * away[i] - d * velocity[i] + overlay[i]
                });
                jacobian.tr_mul(&force) + self.null_space(set_point, jacobian)
            }
        }
    }

    /// From here to where the set-point wants the flange.
    fn away(&self, set_point: &Joints) -> SVector<f64, 6> {
        let here = self.chain.forward(&self.joints.into());
        let there = self.chain.forward(&(*set_point).into());
        let turn = turn(&here.rotation, &there.rotation);
        let linear = there.position - here.position;
        SVector::from_fn(|i, _| if i < 3 { linear[i] } else { turn[i - 3] })
    }

    fn null_space(&self, set_point: &Joints, jacobian: &Jacobian) -> Joints {
        let wanted = (set_point - self.joints) * NULL_SPACE - self.speed * (NULL_SPACE / 5.0);
        let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let through = square
            .try_inverse()
            .map_or_else(SVector::zeros, |inverse| inverse * (jacobian * wanted));
        wanted - jacobian.tr_mul(&through)
    }

    /// Measured joint positions, rad.
    pub(crate) fn joints(&self) -> [f64; AXES] {
        self.joints.into()
    }

    /// Measured joint torques, Nm, without gravity.
    pub(crate) fn torque(&self) -> [f64; AXES] {
        self.torque.into()
    }

    /// External joint torques, Nm.
    pub(crate) fn external(&self) -> [f64; AXES] {
        self.external.into()
    }

    /// External force on the flange, N, in the base frame.
    pub(crate) fn force(&self) -> [f64; 3] {
        self.force.into()
    }

    /// Where the flange is.
    pub(crate) fn place(&self) -> Place {
        self.chain.forward(&self.joints.into())
    }

    /// Where the flange would be.
    pub(crate) fn place_of(&self, joints: &[f64; AXES]) -> Place {
        self.chain.forward(joints)
    }

    /// Speed of the flange, m/s.
    pub(crate) fn flange_speed(&self) -> f64 {
        let (_, jacobian) = self.chain.jacobian(&self.joints.into());
        (jacobian.fixed_view::<3, AXES>(0, 0) * self.speed).norm()
    }

    pub(crate) fn jacobian(&self) -> Jacobian {
        self.chain.jacobian(&self.joints.into()).1
    }

    /// Joint positions near `from` that put the flange at `goal`; `None` if a few damped Newton steps do not lead there.
    pub(crate) fn reach(&self, from: &[f64; AXES], goal: &Place) -> Option<[f64; AXES]> {
        const STEPS: usize = 20;
        let mut joints = Joints::from(*from);
        for _ in 0..STEPS {
            let (place, jacobian) = self.chain.jacobian(&joints.into());
            let turn = turn(&place.rotation, &goal.rotation);
            let linear = goal.position - place.position;
            let away =
                SVector::<f64, 6>::from_fn(|i, _| if i < 3 { linear[i] } else { turn[i - 3] });
            if away.norm() < 1e-7 {
                return Some(joints.into());
            }
            let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
            joints += jacobian.tr_mul(&(square.try_inverse()? * away));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::contact::Shape;

    const Q: [f64; AXES] = [0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0];

    fn table(body: &Body, stiffness: f64) -> Contact {
        Contact {
            shape: Shape::Wall,
            place: body.place().position.into(),
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
    fn a_joint_gives_way_by_torque_over_stiffness() {
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
    fn cartesian_impedance_presses_with_what_is_asked_for() {
        let mut body = body();
        body.contact = Some(table(&body, 20_000.0));
        for _ in 0..6000 {
            body.advance(&Q, &cartesian(-22.0), 0.001);
        }
        // 22 N on two springs side by side: 20,000 of the table and 2,000 of the controller.
        let force = body.force();
        assert!((force[2] - 20.0).abs() < 0.05, "{force:?}");
        let external = body
            .jacobian()
            .fixed_view::<3, AXES>(0, 0)
            .tr_mul(&Vector3::from(force));
        assert!((external - Joints::from(body.external())).norm() < 1e-9);
        body.contact = None;
        body.advance(&Q, &cartesian(-22.0), 0.001);
        assert!(body.force()[2].abs() < 1e-12, "the table is gone");
    }

    #[test]
    fn position_control_does_not_give_way() {
        let mut body = body();
        body.contact = Some(table(&body, 20_000.0));
        let mut lower = Q;
        lower[1] += 0.01;
        for _ in 0..1000 {
            body.advance(&lower, &Law::Position, 0.001);
        }
        assert!((body.joints()[1] - lower[1]).abs() < 1e-9);
        assert!(body.force()[2] > 50.0 && body.torque()[1] > 20.0);
        body.freeze();
        assert!(body.torque()[1].abs() < 1e-12);
    }

    #[test]
    fn poses_nearby_are_reached_and_far_ones_are_not() {
        let body = body();
        let mut goal = body.place();
        goal.position.x -= 0.02;
        let joints = body.reach(&Q, &goal).unwrap();
        assert!((body.place_of(&joints).position - goal.position).norm() < 1e-6);
        goal.position.x = 3.0;
        assert_eq!(body.reach(&Q, &goal), None);
    }
}
