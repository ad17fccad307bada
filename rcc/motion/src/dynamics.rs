//! Inverse dynamics of a serial arm: the torques that a motion takes, by the recursive Newton-Euler algorithm. Bounded work, no
//! allocation. Friction, elasticity and rotor inertia are not modelled.

mod load;
mod payload;
#[cfg(test)]
mod tests;
mod weighing;

use nalgebra::{Matrix3, Vector3};
use takt_net::Frame;

use crate::kinematics::{Fixed, JOINTS_MAX, JointKind, Serial};

pub use load::{Down, Payload, weight};
pub use payload::{Identification, IdentifyError, Sample, identify};
pub use weighing::{WeighError, Weighing, weigh};

/// Acceleration of gravity, m/s².
pub const GRAVITY: f64 = 9.806_65;

/// The inertia of a rigid body in some frame, in the form that is linear in the torques: bodies that are fixed to each other add up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Mass times centre of mass, kg m.
    pub moment: Vector3<f64>,
    /// Inertia about the origin of the frame, kg m².
    pub inertia: Matrix3<f64>,
}

impl Body {
    /// A body by its mass (kg), its centre of mass (m), and its inertia about that (kg m²).
    #[must_use]
    pub fn new(mass: f64, centre: Vector3<f64>, inertia: Matrix3<f64>) -> Self {
        Self {
            mass,
            moment: centre * mass,
            inertia: inertia + square(&centre) * mass,
        }
    }

    /// The centre of mass, m; the origin for a body without mass.
    pub fn centre(&self) -> Vector3<f64> {
        if self.mass == 0.0 {
            return Vector3::zeros();
        }
        self.moment / self.mass
    }

    /// The inertia about the centre of mass, kg m².
    pub fn central_inertia(&self) -> Matrix3<f64> {
        self.inertia - square(&self.centre()) * self.mass
    }

    /// Whether a real body can have this inertia: mass and principal moments are positive, and no moment exceeds the sum of the
    /// other two.
    pub fn is_possible(&self) -> bool {
        let moments = self.central_inertia().symmetric_eigenvalues();
        let (sum, largest, least) = (moments.sum(), moments.max(), moments.min());
        let rounding = 1e-9 * sum.abs() + 1e-12;
        self.mass > 0.0 && least >= -rounding && 2.0 * largest <= sum + 2.0 * rounding
    }

    /// The same body in the frame in which its own frame is `at`.
    #[must_use]
    pub fn seen_from(&self, at: &Frame) -> Self {
        let rotation = at.rotation.to_rotation_matrix().into_inner();
        let shift = at.translation.vector;
        let centre = rotation * self.centre() + shift;
        let central = rotation * self.central_inertia() * rotation.transpose();
        if self.mass == 0.0 {
            return Self {
                inertia: central,
                ..Self::default()
            };
        }
        Self::new(self.mass, centre, central)
    }

    /// Both bodies, fixed to each other, in one frame.
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self {
            mass: self.mass + other.mass,
            moment: self.moment + other.moment,
            inertia: self.inertia + other.inertia,
        }
    }

    /// The force and the torque about the origin that a motion of the frame takes.
    fn wrench(&self, motion: &Motion) -> [Vector3<f64>; 2] {
        let Motion {
            turn,
            turning,
            acceleration,
        } = motion;
        let force = acceleration * self.mass
            + turning.cross(&self.moment)
            + turn.cross(&turn.cross(&self.moment));
        let torque = self.inertia * turning
            + turn.cross(&(self.inertia * turn))
            + self.moment.cross(acceleration);
        [force, torque]
    }
}

/// The inertia of a unit mass at this place about the origin.
fn square(at: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() * at.norm_squared() - at * at.transpose()
}

/// The motion of a frame, in its own axes.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Angular velocity, rad/s.
    turn: Vector3<f64>,
    /// Angular acceleration, rad/s².
    turning: Vector3<f64>,
    /// Acceleration of the origin less gravity, m/s².
    acceleration: Vector3<f64>,
}

/// The state of one joint: position, velocity and acceleration, in rad or m, and s.
pub type JointMotion = [f64; 3];

/// The inverse dynamics of a serial arm.
#[derive(Clone, Debug)]
pub struct Dynamics {
    arm: Serial,
    /// What each joint carries, in its frame with the axis along z.
    bodies: Vec<Body>,
}

impl Dynamics {
    /// An arm whose joints carry these bodies, each in the frame of its joint as it was given to [`Serial::new`]; `None` if there
    /// are not as many as joints.
    #[must_use]
    pub fn new(arm: Serial, bodies: &[Body]) -> Option<Self> {
        if bodies.len() != arm.kinds().len() {
            return None;
        }
        let turned = bodies.iter().zip(arm.turns());
        let turned = turned.map(|(body, turn)| Body {
            mass: body.mass,
            moment: turn * body.moment,
            inertia: turn * body.inertia * turn.transpose(),
        });
        let bodies = turned.collect();
        Some(Self { arm, bodies })
    }

    /// The same arm with one more body fixed to its flange, in the frame of that.
    #[must_use]
    pub fn with_payload(mut self, payload: &Body) -> Self {
        let tip = self.arm.links().last().map(Fixed::frame);
        if let (Some(last), Some(tip)) = (self.bodies.last_mut(), tip) {
            *last = last.with(&payload.seen_from(&tip));
        }
        self
    }

    /// The arm.
    pub const fn arm(&self) -> &Serial {
        &self.arm
    }

    /// The mass of all that moves, kg.
    pub fn mass(&self) -> f64 {
        self.bodies.iter().map(|body| body.mass).sum()
    }

    /// The torque (Nm) or force (N) of each joint for this motion. `gravity` is its acceleration in the base of the arm, m/s²:
    /// `(0, 0, -9.81)` for an arm that stands. NaN for all if there are not as many motions and torques as joints.
    pub fn torques(&self, motions: &[JointMotion], gravity: &Vector3<f64>, torques: &mut [f64]) {
        if [motions.len(), torques.len()] != [self.bodies.len(); 2] {
            torques.fill(f64::NAN);
            return;
        }
        let mut links = [Fixed::IDENTITY; JOINTS_MAX];
        let mut wrenches = [[Vector3::zeros(); 2]; JOINTS_MAX];
        let mut motion = Motion {
            turn: Vector3::zeros(),
            turning: Vector3::zeros(),
            acceleration: -gravity,
        };
        let given = self.arm.links().iter().zip(self.arm.kinds()).zip(motions);
        let kept = links.iter_mut().zip(&mut wrenches).zip(&self.bodies);
        for (((link, kind), joint), ((link_now, wrench), body)) in given.zip(kept) {
            (*link_now, motion) = motion.next(link, *kind, joint);
            *wrench = body.wrench(&motion);
        }
        let [mut force, mut torque] = [Vector3::zeros(); 2];
        let each = torques
            .iter_mut()
            .zip(links)
            .zip(wrenches)
            .zip(self.arm.kinds());
        for (((slot, link), wrench), kind) in each.rev() {
            force += wrench[0];
            torque += wrench[1];
            *slot = match kind {
                JointKind::Revolute => torque.z,
                JointKind::Prismatic => force.z,
            };
            // In the frame of the joint before.
            force = link.rotation * force;
            torque = link.rotation * torque + link.position.cross(&force);
        }
    }
}

impl Motion {
    /// The transform of the next joint in this frame, and its motion.
    fn next(&self, link: &Fixed, kind: JointKind, [at, by, rate]: &JointMotion) -> (Fixed, Self) {
        let mut link = *link;
        match kind {
            JointKind::Revolute => link.rotation *= crate::kinematics::rot_z(*at),
            JointKind::Prismatic => link.position += link.rotation.column(2) * *at,
        }
        let back = link.rotation.transpose();
        let (turn, turning) = (back * self.turn, back * self.turning);
        let acceleration = back
            * (self.acceleration
                + self.turning.cross(&link.position)
                + self.turn.cross(&self.turn.cross(&link.position)));
        let axis = Vector3::z();
        let next = match kind {
            JointKind::Revolute => Self {
                turn: turn + axis * *by,
                turning: turning + axis * *rate + turn.cross(&(axis * *by)),
                acceleration,
            },
            JointKind::Prismatic => Self {
                turn,
                turning,
                acceleration: acceleration + axis * *rate + turn.cross(&(axis * *by)) * 2.0,
            },
        };
        (link, next)
    }
}
