//! Objects of a cell, such as tables and fixtures: simple solids that viewers show. Nothing is computed with them: they are no
//! collision model, and no robot avoids them.

use serde::Deserialize;

use super::frames::{Placement, world};

/// Largest dimension of an object, m.
const SIZE_MAX: f64 = 1e3;

/// An object. It has exactly one of the shapes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectConfig {
    /// Its name, without a dot.
    pub name: String,
    /// The frame in which it is placed, and with which it moves.
    #[serde(default = "world")]
    pub parent: String,
    /// Position of its middle in the parent, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Rotations about z, the new y and the new x, degrees.
    #[serde(default)]
    pub rotation: [f64; 3],
    /// Lengths of a box along x, y and z, m.
    #[serde(default, rename = "box")]
    pub cuboid: Option<[f64; 3]>,
    /// Radius of a cylinder and its length along z, m.
    #[serde(default)]
    pub cylinder: Option<[f64; 2]>,
    /// Radius of a sphere, m.
    #[serde(default)]
    pub sphere: Option<f64>,
}

/// What an object looks like; lengths in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObjectShape {
    /// Lengths along x, y and z.
    Box([f64; 3]),
    /// Along z, about its middle.
    Cylinder {
        /// Its radius.
        radius: f64,
        /// Its length.
        length: f64,
    },
    /// Its radius.
    Sphere(f64),
}

impl ObjectConfig {
    /// Where its middle is.
    #[must_use]
    pub const fn placement(&self) -> Placement {
        Placement {
            position: self.position,
            rotation: self.rotation,
        }
    }

    /// Its shape; `None` if it has none or several, which a cell file cannot have.
    #[must_use]
    pub const fn shape(&self) -> Option<ObjectShape> {
        match (self.cuboid, self.cylinder, self.sphere) {
            (Some(lengths), None, None) => Some(ObjectShape::Box(lengths)),
            (None, Some([radius, length]), None) => Some(ObjectShape::Cylinder { radius, length }),
            (None, None, Some(radius)) => Some(ObjectShape::Sphere(radius)),
            _ => None,
        }
    }

    /// Checks its shape and placement.
    pub(super) fn check(&self) -> Result<(), String> {
        let name = &self.name;
        self.placement().check(&format!("object `{name}`"))?;
        let Some(shape) = self.shape() else {
            return Err(format!(
                "object `{name}` has no shape, or several\nhint: give one of box = [x, y, z], cylinder = [radius, length] and \
                 sphere = radius, in m"
            ));
        };
        let dimensions = match &shape {
            ObjectShape::Box(lengths) => lengths.to_vec(),
            ObjectShape::Cylinder { radius, length } => vec![*radius, *length],
            ObjectShape::Sphere(radius) => vec![*radius],
        };
        let is_good = |it: &f64| *it > 0.0 && *it <= SIZE_MAX;
        if dimensions.iter().all(is_good) {
            return Ok(());
        }
        Err(format!(
            "object `{name}`: its dimensions are {dimensions:?}; each must be above 0, at most {SIZE_MAX} m"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::CellConfig;

    fn parse(text: &str) -> Result<CellConfig, String> {
        CellConfig::parse(text, &[]).map_err(|error| error.to_string())
    }

    #[test]
    fn objects_of_each_shape_are_read() {
        let cell = parse(
            "[[frame]]\nname = 'table'\n\
             [[object]]\nname = 'plate'\nparent = 'table'\nposition = [0, 0, -0.02]\nbox = [1.2, 0.8, 0.04]\n\
             [[object]]\nname = 'post'\nrotation = [0, 90, 0]\ncylinder = [0.05, 0.7]\n\
             [[object]]\nname = 'ball'\nsphere = 0.1",
        )
        .unwrap();
        let shapes: Vec<_> = cell.frames.objects.iter().map(|it| it.shape()).collect();
        let post = ObjectShape::Cylinder {
            radius: 0.05,
            length: 0.7,
        };
        let plate = ObjectShape::Box([1.2, 0.8, 0.04]);
        assert_eq!(
            shapes,
            [Some(plate), Some(post), Some(ObjectShape::Sphere(0.1))]
        );
        assert_eq!(cell.frames.objects[0].parent, "table");
    }

    #[test]
    fn object_faults_name_line_cause_and_hint() {
        for (text, cause) in [
            (
                "name = 'plate'",
                "object `plate` has no shape, or several\nhint:",
            ),
            ("name = 'plate'\nsphere = 1\nbox = [1, 1, 1]", "several"),
            ("name = 'plate'\nsphere = 0", "dimensions are [0.0]"),
            ("name = 'plate'\nbox = [1, -1, 1]", "above 0"),
            ("name = 'plate'\ncylinder = [1, nan]", "above 0"),
            ("name = 'plate'\nsphere = 1e9", "at most 1000 m"),
            (
                "name = 'plate'\nsphere = 1\nposition = [inf, 0, 0]",
                "finite",
            ),
            ("name = 'a.b'\nsphere = 1", "contains a dot"),
            ("name = 'world'\nsphere = 1", "reserved"),
            ("name = ''\nsphere = 1", "name"),
            (
                "name = 'plate'\nsphere = 1\nparent = 'b'",
                "which is no frame",
            ),
            (
                "name = 'plate'\nsphere = 1\nmesh = 'x'",
                "unknown field `mesh`",
            ),
            (
                "name = 'plate'\nsphere = 1\n[[object]]\nname = 'plate'\nsphere = 2",
                "object name `plate` is given twice",
            ),
        ] {
            let error = parse(&format!("[[object]]\n{text}")).unwrap_err();
            assert!(error.contains(cause), "{text}: {error}");
            assert!(error.contains("line "), "{text}: {error}");
        }
    }
}
