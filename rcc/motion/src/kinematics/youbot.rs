//! The arm of the KUKA youBot. Its five axes reach only frames whose z axis is in one plane with
//! the first axis; others are out of reach. The caller chooses the nearest reachable frame, because
//! it knows which part of the orientation matters.

use nalgebra::Vector3;
use takt_net::device::{Kinematics, Unreachable};
use takt_net::{Frame, Twist};

use super::{
    Nearest, Range, checked, columns_or_nan, frame, joints_or_nan, rot_y, rot_z, two_links,
};

/// From axis 2 to axis 3, m.
const UPPER: f64 = 0.155;
/// From axis 3 to axis 4, m.
const LOWER: f64 = 0.135;

/// What the descriptions of the arm differ in.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Chain {
    /// Position of axis 1 in the base, m.
    base: [f64; 3],
    /// From axis 1 to axis 2: along x and z, m.
    shoulder: [f64; 2],
    /// From axis 4 to the flange: along x and z, m.
    hand: [f64; 2],
    /// Axis angles at joint position 0, degrees, and the signs of the joints.
    zero: [(f64, f64); 5],
}

/// The vendor's: flange `arm_link_5` in `arm_link_0`, joints counted from their stops.
const FOLDED: Chain = Chain {
    base: [0.024, 0.0, 0.096],
    shoulder: [0.033, 0.019],
    hand: [-0.002, 0.130],
    zero: [
        (170.0, -1.0),
        (-65.0, 1.0),
        (146.0, 1.0),
        (-102.5, 1.0),
        (167.5, -1.0),
    ],
};

/// That of the Robotics API: the palm of the gripper, seen from the floor of the arm below axis 1, joints counted from
/// the upright arm.
const UPRIGHT: Chain = Chain {
    base: [0.0, 0.0, 0.147],
    shoulder: [0.033, 0.0],
    hand: [0.0, 0.171],
    zero: [(0.0, -1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, -1.0)],
};

/// Tolerance for position (m) and z axis (sine) relative to a plane through axis 1: the error of
/// frames written with six digits.
const OFF_PLANE: f64 = 1e-6;
/// Distance from axis 1 (m), or sine of the angle to it, above which the direction of the plane is
/// defined.
const ON_AXIS: f64 = 1e-9;

/// Closed-form kinematics of the arm of the KUKA youBot.
#[derive(Clone, Debug, PartialEq)]
pub struct YouBot {
    chain: Chain,
    ranges: [Range; 5],
}

impl Default for YouBot {
    fn default() -> Self {
        Self::new([
            Range::degrees(0.0, 338.0),
            Range::degrees(0.0, 155.0),
            Range::degrees(-297.0, 0.0),
            Range::degrees(0.0, 205.0),
            Range::degrees(0.0, 335.0),
        ])
    }
}

impl Chain {
    /// Axis angles of joint positions, rad.
    fn angles(&self, joints: [f64; 5]) -> [f64; 5] {
        std::array::from_fn(|i| {
            let (zero, sign) = self.zero[i];
            zero.to_radians() + sign * joints[i]
        })
    }

    /// Joint positions of axis angles, rad.
    fn positions(&self, angles: [f64; 5]) -> [f64; 5] {
        std::array::from_fn(|i| {
            let (zero, sign) = self.zero[i];
            sign * (angles[i] - zero.to_radians())
        })
    }
}

impl YouBot {
    /// An arm with these joint ranges as its vendor describes it: joints count from their stops, where the arm is
    /// folded; flange `arm_link_5` in `arm_link_0`.
    pub const fn new(ranges: [Range; 5]) -> Self {
        let chain = FOLDED;
        Self { chain, ranges }
    }

    /// An arm with these joint ranges as the Robotics API describes it: at zero it stands upright; the palm of its
    /// gripper is the flange, and axis 1 the z axis of its base.
    pub const fn upright(ranges: [Range; 5]) -> Self {
        let chain = UPRIGHT;
        Self { chain, ranges }
    }

    /// The ranges of the upright arm.
    pub const UPRIGHT_RANGES: [Range; 5] = [
        Range::degrees(-169.0, 169.0),
        Range::degrees(-65.0, 90.0),
        Range::degrees(-151.0, 146.0),
        Range::degrees(-102.5, 102.5),
        Range::degrees(-167.5, 167.5),
    ];

    /// The joint ranges of its solutions.
    pub const fn ranges(&self) -> [Range; 5] {
        self.ranges
    }
}

/// The angle of the plane through axis 1 that contains position and z axis of the flange; `None` if
/// both are on the axis. The better conditioned of the two is used.
fn plane(from_base: &Vector3<f64>, approach: &Vector3<f64>, side: f64) -> Option<f64> {
    let (near, far) = (from_base.xy(), approach.xy());
    let longer = if near.norm() > far.norm() { near } else { far };
    (longer.norm() > ON_AXIS).then(|| (side * longer.y).atan2(side * longer.x))
}

/// Axis angles for the arm in front of its base (`side` 1) or reaching over it (-1).
fn solution(
    chain: &Chain,
    flange: &Frame,
    side: f64,
    bend: f64,
    hint: f64,
) -> Result<[f64; 5], Unreachable> {
    let rotation = flange.rotation.to_rotation_matrix().into_inner();
    let from_base = flange.translation.vector - Vector3::from(chain.base);
    let approach = rotation.column(2);
    let a1 = plane(&from_base, &approach.into_owned(), side).unwrap_or(hint);
    let in_plane = rot_z(-a1) * rotation;
    let approach = in_plane.column(2);
    let from_axis = rot_z(-a1) * from_base;
    if approach.y.abs() > OFF_PLANE || from_axis.y.abs() > OFF_PLANE {
        return Err(Unreachable::Reach);
    }
    let pitch = approach.x.atan2(approach.z);
    let hand = rot_y(pitch) * Vector3::new(chain.hand[0], 0.0, chain.hand[1]);
    let wrist = from_axis - hand;
    let (x, z) = (wrist.x - chain.shoulder[0], wrist.z - chain.shoulder[1]);
    let [a2, a3] = two_links(x, z, UPPER, LOWER, bend)?;
    let roll = rot_y(-pitch) * in_plane;
    let a5 = roll[(1, 0)].atan2(roll[(0, 0)]);
    Ok([a1, a2, a3, pitch - a2 - a3, a5])
}

impl Kinematics for YouBot {
    fn joints(&self) -> usize {
        5
    }

    fn forward(&self, joints: &[f64]) -> Frame {
        let chain = &self.chain;
        let [a1, a2, a3, a4, a5] = chain.angles(joints_or_nan(joints));
        let hand = rot_y(a2 + a3 + a4);
        let in_plane = Vector3::new(chain.shoulder[0], 0.0, chain.shoulder[1])
            + rot_y(a2).column(2) * UPPER
            + rot_y(a2 + a3).column(2) * LOWER
            + hand * Vector3::new(chain.hand[0], 0.0, chain.hand[1]);
        let base = rot_z(a1);
        frame(
            Vector3::from(chain.base) + base * in_plane,
            &(base * hand * rot_z(a5)),
        )
    }

    fn inverse(&self, flange: &Frame, hint: &[f64], joints: &mut [f64]) -> Result<(), Unreachable> {
        let hint = checked(flange, hint, joints)?;
        let [base, ..] = self.chain.angles(hint);
        let mut nearest = Nearest::new(hint, self.ranges);
        let mut is_reached = false;
        for (side, bend) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            if let Ok(solution) = solution(&self.chain, flange, side, bend, base) {
                is_reached = true;
                nearest.offer(self.chain.positions(solution));
            }
        }
        if !is_reached {
            return Err(Unreachable::Reach);
        }
        joints.copy_from_slice(&nearest.result()?);
        Ok(())
    }

    fn jacobian(&self, joints: &[f64], columns: &mut [Twist]) {
        let chain = &self.chain;
        let [a1, a2, a3, a4, _] = chain.angles(joints_or_nan(joints));
        let base = rot_z(a1);
        let hand = base * rot_y(a2 + a3 + a4);
        // From axis 4, axis 3, axis 2 and axis 1 to the flange.
        let wrist = hand * Vector3::new(chain.hand[0], 0.0, chain.hand[1]);
        let elbow = wrist + base * rot_y(a2 + a3).column(2) * LOWER;
        let shoulder = elbow + base * rot_y(a2).column(2) * UPPER;
        let whole = shoulder + base * Vector3::new(chain.shoulder[0], 0.0, chain.shoulder[1]);
        let lateral = base.column(1).into_owned();
        let axes = [
            (Vector3::z(), whole),
            (lateral, shoulder),
            (lateral, elbow),
            (lateral, wrist),
            (hand.column(2).into_owned(), Vector3::zeros()),
        ];
        let signed = axes.into_iter().zip(chain.zero);
        columns_or_nan(
            columns,
            signed.map(|((axis, arm), (_, sign))| (axis * sign, arm)),
        );
    }
}
