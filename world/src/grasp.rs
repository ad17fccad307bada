//! Fingers that close on a body: a compliant grasp with a friction limit. Fingers are not simulated one by one; they
//! centre the body along their closing axis, y of the tool centre point.

use crate::geometry::{Pose, local, origin, point};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Properties of the fingers of a hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspConfig {
    /// Of a grasp, N/m, up to 50,000; two hands on a rigid body are two such springs in series.
    pub stiffness: f64,
    /// Nm/rad, up to 500.
    pub turn_stiffness: f64,
    /// Coefficient of friction between pad and body; a grasp has two pads.
    pub friction: f64,
    /// Half length of a pad, m.
    pub pad_m: f64,
    /// A grip this far away can be grasped, along x, y and z of its frame, m.
    pub reach_m: [f64; 3],
}

impl Default for GraspConfig {
    /// Rubber pads: 20,000 N/m, 60 Nm/rad, friction 0.6, pads of 30 mm.
    fn default() -> Self {
        Self {
            stiffness: 20_000.0,
            turn_stiffness: 60.0,
            friction: 0.6,
            pad_m: 0.015,
            reach_m: [0.012, 0.015, 0.015],
        }
    }
}

/// Smallest cosine between closing axis and that of the grip.
const ALIGNED: f64 = 0.94;

/// Fingers of a hand at run time.
#[derive(Debug, Clone)]
pub(crate) struct FingersState {
    pub(crate) config: GraspConfig,
    /// m.
    pub(crate) width: f64,
    /// N.
    pub(crate) force: f64,
    pub(crate) held: Option<Held>,
    /// Scales the friction of its pads: 1, less for oil on them.
    pub(crate) friction: f64,
    /// Fully slid so far, m.
    pub(crate) slip_m: f64,
}

/// A body between the fingers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Held {
    pub(crate) body: usize,
    pub(crate) grip: usize,
    /// Pose of the body in the frame of the tool centre point at which the grasp is at ease.
    pub(crate) anchor: Pose,
    pub(crate) slips: bool,
}

/// Springs of a grasp.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Hold {
    /// Point of the body, in the world.
    pub(crate) at: Vector3<f64>,
    pub(crate) force: Vector3<f64>,
    pub(crate) torque: Vector3<f64>,
    pub(crate) resistance: Matrix3<f64>,
    pub(crate) turn_resistance: Matrix3<f64>,
}

/// Whether a grip in the world is between fingers at `tcp`.
pub(crate) fn is_within(config: &GraspConfig, tcp: &Pose, grip: &Pose) -> bool {
    let [.., z] = config.reach_m;
    is_over(config, tcp, grip) && local(grip, &origin(tcp)).z >= -z
}

/// Whether fingers at `tcp` are around a grip, or before it on the way along its z.
pub(crate) fn is_over(config: &GraspConfig, tcp: &Pose, grip: &Pose) -> bool {
    let off = local(grip, &origin(tcp));
    let [x, y, z] = config.reach_m;
    let closing = (tcp.rotation * Vector3::y()).dot(&(grip.rotation * Vector3::y()));
    off.x.abs() <= x && off.y.abs() <= y && off.z <= z && closing.abs() > ALIGNED
}

/// Where a body rests between fingers that closed on it: centred, pads flat on its sides.
pub(crate) fn anchor(tcp: &Pose, body: &Pose, grip: &Pose, is_notched: bool) -> Pose {
    let in_hand = tcp.inverse() * body;
    let grip = tcp.inverse() * grip;
    let side = grip.rotation * Vector3::y();
    let flat = Vector3::y() * side.y.signum();
    let turn = UnitQuaternion::rotation_between(&side, &flat).unwrap_or_default();
    let centre = origin(&grip);
    let from_centre = turn * (origin(&in_hand) - centre);
    let beside = if is_notched { 0.0 } else { centre.x };
    let centred = Vector3::new(beside, 0.0, centre.z);
    Pose::from_parts((centred + from_centre).into(), turn * in_hand.rotation)
}

impl Held {
    /// Force on the body; slides if friction does not hold it. `slack` scales friction. The second value is the slide, m.
    pub(crate) fn hold(
        &mut self,
        fingers: &FingersState,
        slack: f64,
        (tcp, body): (&Pose, &Pose),
        mass: f64,
        dt: f64,
    ) -> (Hold, f64) {
        let GraspConfig {
            stiffness: k,
            turn_stiffness: turn_k,
            friction,
            pad_m,
            ..
        } = fingers.config;
        let turned = tcp.rotation.inverse();
        let grasped = local(&self.anchor, &Vector3::zeros());
        let at = point(body, &grasped);
        // In the axes of the hand.
        let mut force = turned * (origin(tcp) - at) * k;
        let rest = tcp.rotation * self.anchor.rotation;
        let mut torque = turned * (rest * body.rotation.inverse()).scaled_axis() * turn_k;
        let grip = fingers.force.max(0.0);
        let hold = (2.0 * friction * slack * grip).max(1e-6);
        let load = force.x.hypot(force.z) / hold;
        let twist = torque.y.abs() / (hold * pad_m * 0.7);
        let pads = torque.x.hypot(torque.z) / (grip * pad_m * 2.0).max(1e-6);
        let mut share = Vector3::repeat(1.0);
        let sliding = load.hypot(twist);
        if sliding > 1.0 {
            (share.x, share.z) = (1.0 / sliding, 1.0 / sliding);
            torque.y /= sliding;
        }
        if pads > 1.0 {
            torque.x /= pads;
            torque.z /= pads;
        }
        if force.y.abs() > grip.max(1e-6) {
            share.y = grip.max(1e-6) / force.y.abs();
        }
        let lost = force - force.component_mul(&share);
        force -= lost;
        self.slips = sliding > 1.0;
        let slid = lost / k;
        self.relax(
            tcp,
            body,
            &slid,
            &(torque / turn_k),
            sliding > 1.0 || pads > 1.0,
        );
        let damping = 2.0 * 0.7 * (k * mass).sqrt();
        let turn_damping = 2.0 * 0.7 * (turn_k * mass * 4e-3).sqrt();
        let free = |is_free: bool, full: f64| if is_free { 0.0 } else { full };
        let c = k * dt + damping;
        let across = free(self.slips, c);
        let local = Matrix3::from_diagonal(&Vector3::new(across, free(share.y < 1.0, c), across));
        let turn_c = turn_k * dt + turn_damping;
        let spin = Vector3::new(
            free(pads > 1.0, turn_c),
            free(self.slips, turn_c),
            free(pads > 1.0, turn_c),
        );
        let frame = tcp.rotation.to_rotation_matrix();
        let outer = |local: Matrix3<f64>| frame.matrix() * local * frame.matrix().transpose();
        let hold = Hold {
            at,
            force: tcp.rotation * force,
            torque: tcp.rotation * torque,
            resistance: outer(local),
            turn_resistance: outer(Matrix3::from_diagonal(&spin)),
        };
        (hold, slid.x.hypot(slid.z))
    }

    /// Moves the anchor by what friction did not hold; all in the axes of the hand.
    fn relax(
        &mut self,
        tcp: &Pose,
        body: &Pose,
        slid: &Vector3<f64>,
        turn_left: &Vector3<f64>,
        turns: bool,
    ) {
        if slid.norm_squared() > 0.0 {
            self.anchor.translation.vector -= slid;
        }
        if turns {
            let in_hand = tcp.rotation.inverse() * body.rotation;
            let back = UnitQuaternion::from_scaled_axis(*turn_left);
            // The grasped point stays: the anchor turns about the tool centre point.
            let old = self.anchor.rotation;
            self.anchor.rotation = back * in_hand;
            let turn = self.anchor.rotation * old.inverse();
            self.anchor.translation.vector = turn * self.anchor.translation.vector;
        }
    }
}
