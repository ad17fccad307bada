//! Arms from URDF files: links, joints and masses as the file gives them, and the serial arm between two of its links. Everything
//! that is wrong with a file is reported at once, by line. Macros (xacro) and materials are not read; of meshes only whether they are
//! there.

mod arm;
mod file;
mod read;
#[cfg(test)]
mod tests;

use std::fmt;

use nalgebra::Vector3;
use takt_net::Frame;

pub use arm::{ArmJoint, ArmModel, Visual};
pub use file::{FileError, read_arm};

use crate::dynamics::Body;

/// Largest file, bytes.
pub const FILE_MAX: usize = 8 << 20;
/// Longest distance from one joint to the next, m: a file that exceeds it counts in other units.
const LENGTH_MAX: f64 = 20.0;
/// Largest limit of a joint that turns, rad: a file that exceeds it counts in degrees.
const ANGLE_MAX: f64 = 40.0;

/// What is wrong with a file, at a line of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// From 1.
    pub line: u32,
    /// What is wrong.
    pub cause: String,
    /// What repairs it; may be empty.
    pub hint: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.cause)?;
        if !self.hint.is_empty() {
            write!(f, "\nhint: {}", self.hint)?;
        }
        Ok(())
    }
}

/// A file that is no URDF, or whose arm cannot be used: all that is wrong with it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct UrdfError {
    /// At least one.
    pub findings: Vec<Finding>,
}

impl fmt::Display for UrdfError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, finding) in self.findings.iter().enumerate() {
            let separator = if number == 0 { "" } else { "\n" };
            write!(f, "{separator}{finding}")?;
        }
        Ok(())
    }
}

/// What a joint of a file allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names of the format")]
pub enum Kind {
    Revolute,
    Continuous,
    Prismatic,
    Fixed,
    Floating,
    Planar,
}

/// The limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Smallest position, rad or m.
    pub lower: f64,
    /// Largest position, rad or m.
    pub upper: f64,
    /// Largest torque or force, Nm or N; `None` if not given.
    pub effort: Option<f64>,
    /// Largest speed, rad/s or m/s; `None` if not given.
    pub velocity: Option<f64>,
}

/// A joint of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct UrdfJoint {
    /// Its name.
    pub name: String,
    /// Its line, from 1.
    pub line: u32,
    /// What it allows.
    pub kind: Kind,
    /// The link before it.
    pub parent: String,
    /// The link behind it.
    pub child: String,
    /// Its frame in that of the link before it, m.
    pub origin: Frame,
    /// Its axis in its own frame; any length but 0.
    pub axis: Vector3<f64>,
    /// Its limits; `None` if not given.
    pub limit: Option<Limit>,
    /// The joint that it follows, if any.
    pub mimic: Option<String>,
}

/// A solid by which a link is drawn.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Sizes along x, y, z, m.
    Box(Vector3<f64>),
    /// Radius and length along z, m.
    Cylinder(f64, f64),
    /// Radius, m.
    Sphere(f64),
    /// A file, as it is named, and the scale of its axes.
    Mesh(String, Vector3<f64>),
}

/// A link of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// Its line, from 1.
    pub line: u32,
    /// Its mass and inertia in its own frame; `None` if not given.
    pub body: Option<Body>,
    /// What it looks like, with the frame of each solid in its own, m.
    pub visuals: Vec<(Frame, Shape)>,
}

/// A URDF file: a tree of links and joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Urdf {
    /// The name of the robot.
    pub name: String,
    /// Its links, in the order of the file.
    pub links: Vec<Link>,
    /// Its joints, in the order of the file.
    pub joints: Vec<UrdfJoint>,
    /// The link that is behind no joint.
    pub root: String,
    /// What is wrong, but does not matter for the kinematics.
    pub warnings: Vec<Finding>,
}

impl Urdf {
    /// Reads a file's text.
    ///
    /// # Errors
    /// If it is no URDF, is larger than [`FILE_MAX`], or its links and joints are not one tree: all findings.
    pub fn parse(text: &str) -> Result<Self, UrdfError> {
        read::parse(text)
    }
}
