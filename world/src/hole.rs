//! A round peg in a round hole: chamfer, clearance, two-point contact, friction, bottom. Chamfers have 45 degrees.

use crate::body::Carrier;
use crate::geometry::{Pose, local, origin, point};
use nalgebra::{Matrix3, Vector3};

/// Slower than this, friction grows with the speed, m/s: a jammed peg creeps by less than 0.02 mm in a second.
const STICK_SPEED: f64 = 2e-5;
/// What is deeper in the wall is no contact of this hole, m.
const DEPTH_MAX: f64 = 0.01;

/// A peg of a body, for [`BodyConfig::peg`](crate::BodyConfig::peg).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PegConfig {
    /// Centre of its end face in the frame of the body, z out of the body and into the hole; m.
    pub tip: Pose,
    /// m.
    pub radius_m: f64,
}

/// A hole, for [`Builder::hole`](crate::Builder::hole).
#[derive(Debug, Clone, PartialEq)]
pub struct HoleConfig {
    /// Its name, unique among holes.
    pub name: String,
    /// Centre of its mouth, z out of the hole; in the frame of the body, or in the world.
    pub pose: Pose,
    /// Body in which it is; `None` for the world.
    pub in_body: Option<String>,
    /// m; peg radius and half of the clearance.
    pub radius_m: f64,
    /// m.
    pub depth_m: f64,
    /// Width of the chamfer, m: a peg that is off by less slides in.
    pub chamfer_m: f64,
    /// Radius of the face around it, m.
    pub face_radius_m: f64,
    /// N/m, up to 200,000.
    pub stiffness: f64,
    /// Coefficient of friction.
    pub friction: f64,
}

#[derive(Debug, Clone)]
pub(crate) struct Hole {
    pub(crate) config: HoleConfig,
    pub(crate) carrier: Carrier,
}

/// One point of contact in the frame of the hole.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) at: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
    pub(crate) depth: f64,
}

/// Contact of a peg with a hole.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Contact {
    pub(crate) spots: [Option<Spot>; 5],
    /// Of the tip below the mouth, m; negative above.
    pub(crate) depth: f64,
    /// Of the tip from the axis, m.
    pub(crate) offset: f64,
}

impl Hole {
    /// Contact of a peg whose tip is there, in the world; `bottom` replaces the depth of the hole.
    pub(crate) fn contact(&self, hole: &Pose, tip: &Pose, radius: f64, bottom: f64) -> Contact {
        let centre = local(hole, &origin(tip));
        let axis = hole.rotation.inverse() * (tip.rotation * Vector3::z());
        let depth = -centre.z;
        let offset = centre.xy().norm();
        let mut contact = Contact {
            depth,
            offset,
            ..Contact::default()
        };
        let is_near = depth > -radius && offset < self.config.face_radius_m + radius;
        if !is_near || axis.z > -0.5 {
            return contact;
        }
        let radial = if offset > 1e-9 {
            Vector3::new(centre.x, centre.y, 0.0) / offset
        } else {
            Vector3::x()
        };
        let side = radial.cross(&Vector3::z());
        let ways = [radial, -radial, side, -side];
        for (spot, way) in contact.spots.iter_mut().zip(ways) {
            let flat = (way - axis * way.dot(&axis)).normalize();
            *spot = self.profile(&(centre + flat * radius), bottom);
        }
        contact.spots[4] = self.rim(&centre, &axis, radius);
        contact
    }

    /// The nearest point of the surface to a point of the solid.
    fn profile(&self, at: &Vector3<f64>, bottom: f64) -> Option<Spot> {
        let (radius, chamfer) = (self.config.radius_m, self.config.chamfer_m);
        let (r, s) = (at.xy().norm(), -at.z);
        let is_free = r < radius + (chamfer - s).max(0.0) && s < bottom;
        if s <= 0.0 || r > self.config.face_radius_m || is_free {
            return None;
        }
        let corners = [
            [self.config.face_radius_m, 0.0],
            [radius + chamfer, 0.0],
            [radius, chamfer.min(bottom)],
            [radius, bottom],
            [0.0, bottom],
        ];
        let nearest = corners
            .windows(2)
            .filter_map(|pair| pair.as_array::<2>())
            .map(|[from, to]| nearest(from, to, r, s))
            .min_by(|a, b| a.2.total_cmp(&b.2))?;
        let (dr, ds, depth) = nearest;
        if !(1e-12..=DEPTH_MAX).contains(&depth) {
            return None;
        }
        let outward = if r > 1e-9 {
            Vector3::new(at.x / r, at.y / r, 0.0)
        } else {
            Vector3::x()
        };
        let normal = (outward * dr - Vector3::z() * ds) / depth;
        Some(Spot {
            at: *at,
            normal,
            depth,
        })
    }

    /// Contact of the side of a tilted peg with the edge of the hole.
    fn rim(&self, centre: &Vector3<f64>, axis: &Vector3<f64>, radius: f64) -> Option<Spot> {
        let edge = self.config.chamfer_m;
        let back = (-edge - centre.z) / axis.z;
        // The edge is above the tip: against the axis.
        if back >= 0.0 {
            return None;
        }
        let middle = centre + axis * back;
        let off = middle.xy().norm();
        let depth = off + radius - self.config.radius_m;
        if depth <= 0.0 || depth > DEPTH_MAX || off < 1e-9 {
            return None;
        }
        let out = Vector3::new(middle.x / off, middle.y / off, 0.0);
        let normal = (-out + axis * out.dot(axis)).normalize();
        Some(Spot {
            at: middle + out * radius,
            normal,
            depth,
        })
    }
}

/// From a point to the nearest one of a segment, and the distance.
fn nearest(from: &[f64; 2], to: &[f64; 2], r: f64, s: f64) -> (f64, f64, f64) {
    let (dr, ds) = (to[0] - from[0], to[1] - from[1]);
    let length = dr * dr + ds * ds;
    let share = if length > 0.0 {
        (((r - from[0]) * dr + (s - from[1]) * ds) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (er, es) = (from[0] + dr * share - r, from[1] + ds * share - s);
    (er, es, er.hypot(es))
}

/// Force and resistance of a spot, with `velocity` of the peg against the hole.
pub(crate) fn push(
    config: &HoleConfig,
    spot: &Spot,
    normal: &Vector3<f64>,
    velocity: &Vector3<f64>,
    mass: f64,
    dt: f64,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let damping = 2.0 * 0.7 * (config.stiffness * mass).sqrt();
    let force = config.stiffness * spot.depth;
    let outward = normal.dot(velocity);
    if force - damping * outward <= 0.0 {
        return None;
    }
    let along = normal * normal.transpose();
    let sliding = (velocity - normal * outward).norm();
    let drag = config.friction * force / (sliding + STICK_SPEED);
    let across = (Matrix3::identity() - along) * drag;
    Some((
        normal * force,
        along * (config.stiffness * dt + damping) + across,
    ))
}

/// A spot in the world.
pub(crate) fn outer(hole: &Pose, spot: &Spot) -> (Vector3<f64>, Vector3<f64>) {
    (point(hole, &spot.at), hole.rotation * spot.normal)
}
