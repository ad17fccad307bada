//! Rigid bodies: box-shaped for inertia and resting contact, with places to grasp and perhaps a peg. Their frames have
//! their origin in the centre of mass. Boxes do not collide with boxes.

use crate::geometry::{Pose, Twist};
use crate::hole::PegConfig;
use crate::surface::Anchor;
use nalgebra::{Matrix3, Vector3};

/// A body, for [`Builder::body`](crate::Builder::body).
#[derive(Debug, Clone, PartialEq)]
pub struct BodyConfig {
    /// Its name, unique among bodies.
    pub name: String,
    /// kg, at least 0.001.
    pub mass_kg: f64,
    /// Full lengths along its axes, m, at least 1 mm each.
    pub size_m: Vector3<f64>,
    /// Where it is, in the frame of what it rests on or in the world.
    pub pose: Pose,
    /// Surface or body on which it lies and with which it moves until a hand takes it; `None` floats free and falls.
    pub rests_on: Option<String>,
    /// Where fingers may grasp it, in its frame: the fingers close along y, the hand comes along z. With the width there, m.
    pub grips: Vec<(Pose, f64)>,
    /// Its grips have notches: fingers centre it along x of the grip too.
    pub is_notched: bool,
    /// Its peg, if it has one.
    pub peg: Option<PegConfig>,
    /// Thickness of its walls and bottom, m, if it is open at its top, z: hands reach into it. `None` for a solid one.
    pub wall_m: Option<f64>,
}

impl BodyConfig {
    /// A box that rests on something, without grips.
    #[must_use]
    pub fn new(name: &str, mass_kg: f64, size_m: [f64; 3]) -> Self {
        Self {
            name: name.into(),
            mass_kg,
            size_m: size_m.into(),
            pose: Pose::identity(),
            rests_on: None,
            grips: Vec::new(),
            is_notched: false,
            peg: None,
            wall_m: None,
        }
    }

    /// Puts it at a pose of the world, or of the frame of `on`.
    #[must_use]
    pub fn at(self, pose: Pose, on: Option<&str>) -> Self {
        Self {
            pose,
            rests_on: on.map(Into::into),
            ..self
        }
    }

    /// Adds a place to grasp it, where it is `width_m` wide.
    #[must_use]
    pub fn grip(mut self, at: Pose, width_m: f64) -> Self {
        self.grips.push((at, width_m));
        self
    }

    /// Gives its grips notches.
    #[must_use]
    pub fn notched(self) -> Self {
        Self {
            is_notched: true,
            ..self
        }
    }

    /// Opens its top; walls and bottom are that thick.
    #[must_use]
    pub fn open(self, wall_m: f64) -> Self {
        Self {
            wall_m: Some(wall_m),
            ..self
        }
    }

    /// Gives it a peg.
    #[must_use]
    pub fn peg(self, peg: PegConfig) -> Self {
        Self {
            peg: Some(peg),
            ..self
        }
    }
}

/// What something is fixed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Carrier {
    World,
    Base(usize),
    Body(usize),
}

/// A body at run time.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    pub(crate) config: BodyConfig,
    /// Half lengths, m.
    pub(crate) half: Vector3<f64>,
    pub(crate) pose: Pose,
    pub(crate) twist: Twist,
    /// It lies there and moves with it.
    pub(crate) rest: Option<(Carrier, Pose)>,
    /// Its number among the moving bodies in this step.
    pub(crate) slot: Option<usize>,
    /// Friction anchors of its corners.
    pub(crate) anchors: [Anchor; 8],
    /// What carries it in this step.
    pub(crate) support: Option<Carrier>,
    /// Since when it has been calm on a surface, s.
    pub(crate) calm_s: f64,
    pub(crate) falls: bool,
    /// Removed from the world.
    pub(crate) is_missing: bool,
    /// Hands that hold it in this step: forces on it, N, and where, m.
    pub(crate) held: Vec<(usize, Vector3<f64>, Vector3<f64>)>,
    /// Largest internal force so far, N.
    pub(crate) internal_max: f64,
    /// Least and greatest distance of two hands while they held it, m.
    pub(crate) distances: Option<[f64; 2]>,
}

impl Body {
    pub(crate) fn new(config: BodyConfig, pose: Pose, rest: Option<(Carrier, Pose)>) -> Self {
        Self {
            half: config.size_m / 2.0,
            pose,
            twist: Twist::default(),
            rest,
            slot: None,
            anchors: [Anchor::default(); 8],
            support: None,
            calm_s: 0.0,
            falls: false,
            is_missing: false,
            held: Vec::with_capacity(4),
            internal_max: 0.0,
            distances: None,
            config,
        }
    }

    /// In the axes of the world, kg m2. At least that of a cube of 20 mm, so that slender parts do not spin up.
    pub(crate) fn inertia(&self) -> Matrix3<f64> {
        let least = self.config.mass_kg * 0.02 * 0.02 / 6.0;
        let squares = self.config.size_m.component_mul(&self.config.size_m);
        let about = |a: f64, b: f64| (self.config.mass_kg / 12.0 * (a + b)).max(least);
        let own = Vector3::new(
            about(squares.y, squares.z),
            about(squares.x, squares.z),
            about(squares.x, squares.y),
        );
        let turn = self.pose.rotation.to_rotation_matrix();
        turn.matrix() * Matrix3::from_diagonal(&own) * turn.matrix().transpose()
    }

    /// Its corners, in its frame.
    pub(crate) fn corners(&self) -> [Vector3<f64>; 8] {
        let sign = |corner: usize, bit: usize| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
        std::array::from_fn(|corner| {
            Vector3::new(sign(corner, 0), sign(corner, 1), sign(corner, 2))
                .component_mul(&self.half)
        })
    }

    /// Lifts it off its rest: from now on it moves by forces.
    pub(crate) fn wake(&mut self) {
        self.rest = None;
        self.calm_s = 0.0;
    }
}
