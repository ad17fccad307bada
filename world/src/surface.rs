//! Flat surfaces: tables, decks, walls; and the law of contact with friction. Surfaces are rectangles with one solid side.

use crate::body::Carrier;
use crate::geometry::Pose;
use nalgebra::{Matrix3, Vector3};

/// Stiffest contact, N/m: beyond, the explicit coupling to an arm's emulator would not be stable.
pub(crate) const STIFFNESS_MAX: f64 = 50_000.0;
/// Strongest damping towards a hand, Ns/m.
const HAND_DAMPING: f64 = 60.0;
/// What is further behind a surface is on its other side, m.
const DEPTH_MAX: f64 = 0.03;

/// A rectangle, for [`Builder::surface`](crate::Builder::surface): solid below (z < 0), free above.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceConfig {
    /// Its name, unique among surfaces.
    pub name: String,
    /// Its centre, z outwards, in the frame of the base on which it is or in the world.
    pub pose: Pose,
    /// Base that carries it.
    pub on_base: Option<String>,
    /// Half lengths along x and y, m.
    pub half_m: [f64; 2],
    /// N/m, up to 50,000.
    pub stiffness: f64,
    /// Coefficient of friction.
    pub friction: f64,
}

impl SurfaceConfig {
    /// A horizontal table top of wood or metal: 20,000 N/m, friction 0.4.
    #[must_use]
    pub fn table(name: &str, pose: Pose, half_m: [f64; 2]) -> Self {
        Self {
            name: name.into(),
            pose,
            on_base: None,
            half_m,
            stiffness: 20_000.0,
            friction: 0.4,
        }
    }
}

#[derive(Debug, Clone)]
pub(crate) struct Surface {
    pub(crate) config: SurfaceConfig,
    pub(crate) carrier: Carrier,
}

impl Surface {
    /// How deep a point of its frame is below it, m.
    pub(crate) fn depth(&self, point: &Vector3<f64>) -> Option<f64> {
        let [x, y] = self.config.half_m;
        let is_over = point.x.abs() <= x && point.y.abs() <= y;
        let depth = -point.z;
        (is_over && (0.0..DEPTH_MAX).contains(&depth)).then_some(depth)
    }
}

/// Where a point sticks by friction, in the frame of the surface, and which it is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Anchor(pub(crate) Option<(usize, Vector3<f64>)>);

/// Contact of a point with a plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Touch {
    /// Outwards.
    pub(crate) normal: Vector3<f64>,
    /// m.
    pub(crate) depth: f64,
    /// N/m.
    pub(crate) stiffness: f64,
    pub(crate) friction: f64,
    /// From the anchor to the point along the plane, m.
    pub(crate) slide: Vector3<f64>,
}

/// Force of a contact: springs, and what they resist with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Push {
    pub(crate) force: Vector3<f64>,
    pub(crate) resistance: Matrix3<f64>,
    /// Share of the slide that friction could not hold; the anchor follows by it.
    pub(crate) excess: Vector3<f64>,
}

impl Touch {
    /// Force on the point, for the implicit step: `velocity` relative to the plane, mass of the body, step.
    pub(crate) fn push(&self, velocity: &Vector3<f64>, mass: f64, dt: f64) -> Option<Push> {
        let damping = 2.0 * 0.7 * (self.stiffness * mass).sqrt();
        let outward = self.normal.dot(velocity);
        let normal = self.stiffness * self.depth;
        // A contact that separates faster than the spring pushes would pull.
        if normal - damping * outward <= 0.0 {
            return None;
        }
        let along = self.normal * self.normal.transpose();
        let (held, excess) = self.held(normal);
        let resistance = self.stiffness * dt + damping;
        let across = if excess.norm_squared() > 0.0 {
            Matrix3::zeros()
        } else {
            (Matrix3::identity() - along) * resistance
        };
        Some(Push {
            force: self.normal * normal + held,
            resistance: along * resistance + across,
            excess,
        })
    }

    /// Force on the tip of a hand, which moves as prescribed.
    pub(crate) fn push_hand(&self, velocity: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let outward = self.normal.dot(velocity);
        let normal = (self.stiffness * self.depth - HAND_DAMPING * outward).max(0.0);
        let (held, excess) = self.held(normal);
        (self.normal * normal + held, excess)
    }

    /// Friction, and how much of the slide it does not hold.
    fn held(&self, normal: f64) -> (Vector3<f64>, Vector3<f64>) {
        let wanted = self.slide.norm() * self.stiffness;
        let limit = self.friction * normal;
        if wanted <= limit {
            return (-self.slide * self.stiffness, Vector3::zeros());
        }
        let share = limit / wanted;
        (
            -self.slide * (self.stiffness * share),
            self.slide * (1.0 - share),
        )
    }
}
