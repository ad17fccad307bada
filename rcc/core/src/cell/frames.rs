//! Where things are in a cell: its named frames, the bases of its devices, the tools of its arms and their home positions.
//! The controller keeps them for programs and computes nothing with them.
//!
//! Frames are named `world`, by the name of a `[[frame]]`, or by device and part: `left.base`, `left.flange`,
//! `left.screwdriver` for a tool of `left`, and `platform.odometry` for the frame in which a mobile base starts.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;
use takt_motion::dynamics::{Body, Payload};
use takt_net::{Frame, Rotation, Vector};

use crate::cell::objects::ObjectConfig;
use crate::ids::check_device_name;

/// Name of the frame that has no parent.
pub const WORLD: &str = "world";

/// Most frames, bases, tools, home positions and objects of a cell, of each kind.
pub const FRAMES_MAX: usize = 1024;

/// Frames of a device that need no entry.
const PARTS: [&str; 3] = ["base", "flange", "odometry"];

/// Longest distance of a frame from its parent, m.
const DISTANCE_MAX: f64 = 1e6;

/// All frames of a cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellFrames {
    /// Named frames.
    pub frames: Vec<FrameConfig>,
    /// Bases of devices.
    pub bases: Vec<BaseConfig>,
    /// Tools of arms.
    pub tools: Vec<ToolConfig>,
    /// Home positions of arms.
    pub homes: Vec<HomeConfig>,
    /// Objects that viewers show.
    pub objects: Vec<ObjectConfig>,
}

/// A position and an orientation in a parent, as cell files have them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// Position, m.
    pub position: [f64; 3],
    /// Rotations about z, the new y and the new x, degrees.
    pub rotation: [f64; 3],
}

impl Placement {
    /// The frame, m.
    #[must_use]
    pub fn frame(&self) -> Frame {
        let [a, b, c] = self.rotation.map(f64::to_radians);
        let rotation = Rotation::from_euler_angles(c, b, a);
        Frame::from_parts(Vector::from(self.position).into(), rotation)
    }

    pub(super) fn check(&self, name: &str) -> Result<(), String> {
        if !self
            .position
            .iter()
            .all(|value| value.abs() <= DISTANCE_MAX)
        {
            return Err(format!(
                "{name}: position is {:?}; it must be finite, at most {DISTANCE_MAX} m",
                self.position
            ));
        }
        if !self.rotation.iter().all(|value| value.is_finite()) {
            return Err(format!(
                "{name}: rotation is {:?}; it must be finite",
                self.rotation
            ));
        }
        Ok(())
    }
}

/// A named frame.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrameConfig {
    /// Its name, without a dot.
    pub name: String,
    /// The frame in which it is placed.
    #[serde(default = "world")]
    pub parent: String,
    /// Position in the parent, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Rotations about z, the new y and the new x, degrees.
    #[serde(default)]
    pub rotation: [f64; 3],
    /// Joint positions with which arms reach it, by arm, degrees.
    #[serde(default)]
    pub hints: BTreeMap<String, Vec<f64>>,
}

/// The base of a device: where an arm or a gripper is mounted, and where a mobile base starts.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BaseConfig {
    /// The device.
    pub device: String,
    /// The frame in which it is placed.
    #[serde(default = "world")]
    pub parent: String,
    /// Position in the parent, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Rotations about z, the new y and the new x, degrees.
    #[serde(default)]
    pub rotation: [f64; 3],
}

/// A tool at the flange of an arm.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolConfig {
    /// Its name, without a dot.
    pub name: String,
    /// The arm.
    pub device: String,
    /// Position of its tip in the flange, m.
    #[serde(default)]
    pub position: [f64; 3],
    /// Rotations of its tip in the flange about z, the new y and the new x, degrees.
    #[serde(default)]
    pub rotation: [f64; 3],
    /// Mass, kg.
    #[serde(default)]
    pub mass: f64,
    /// Centre of mass in the flange, m.
    #[serde(default)]
    pub centre_of_mass: [f64; 3],
}

impl ToolConfig {
    /// Its mass in its centre, in the frame of the flange.
    pub(super) fn body(&self) -> Body {
        let payload = Payload {
            mass: self.mass,
            centre_of_mass: self.centre_of_mass,
        };
        payload.body()
    }
}

/// Where the joints of an arm are at home.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HomeConfig {
    /// The arm.
    pub device: String,
    /// Position of each joint, from the base, degrees.
    pub joints: Vec<f64>,
}

macro_rules! placed {
    ($($kind:ty)*) => {$(
        impl $kind {
            /// Where it is.
            #[must_use]
            pub const fn placement(&self) -> Placement {
                Placement { position: self.position, rotation: self.rotation }
            }
        }
    )*};
}

placed! { FrameConfig BaseConfig ToolConfig }

pub(super) fn world() -> String {
    WORLD.to_owned()
}

impl CellFrames {
    /// The base of a device; `None` if the cell does not place it.
    #[must_use]
    pub fn base(&self, device: &str) -> Option<&BaseConfig> {
        self.bases.iter().find(|base| base.device == device)
    }

    /// The tools of an arm.
    pub fn tools<'a>(&'a self, device: &'a str) -> impl Iterator<Item = &'a ToolConfig> {
        self.tools.iter().filter(move |tool| tool.device == device)
    }

    /// The home position of an arm; `None` if the cell gives it none.
    #[must_use]
    pub fn home(&self, device: &str) -> Option<&HomeConfig> {
        self.homes.iter().find(|home| home.device == device)
    }

    /// Devices that have a base, a tool or a home position.
    pub fn devices(&self) -> BTreeSet<&str> {
        let bases = self.bases.iter().map(|base| base.device.as_str());
        let tools = self.tools.iter().map(|tool| tool.device.as_str());
        let homes = self.homes.iter().map(|home| home.device.as_str());
        bases.chain(tools).chain(homes).collect()
    }

    /// Checks names, numbers and parents; `devices` are those of the cell file.
    pub(super) fn check(&self, devices: &[String]) -> Result<(), String> {
        self.check_counts()?;
        self.check_names()?;
        for frame in &self.frames {
            frame.placement().check(&frame.name)?;
            for (arm, joints) in &frame.hints {
                if joints.is_empty() || !joints.iter().all(|joint| joint.is_finite()) {
                    let name = &frame.name;
                    return Err(format!(
                        "{name}: hints of `{arm}` are {joints:?}; one finite angle for each joint is expected"
                    ));
                }
            }
            self.check_parent(&frame.name, &frame.parent, devices)?;
        }
        for object in &self.objects {
            object.check()?;
            self.check_parent(&object.name, &object.parent, devices)?;
        }
        for base in &self.bases {
            base.placement()
                .check(&format!("base of {}", base.device))?;
            self.check_parent(&base.device, &base.parent, devices)?;
        }
        for tool in &self.tools {
            let name = format!("tool {}", tool.name);
            tool.placement().check(&name)?;
            if !(0.0..=DISTANCE_MAX).contains(&tool.mass) {
                return Err(format!(
                    "{name}: mass is {} kg; it must be 0 or more",
                    tool.mass
                ));
            }
            if !tool
                .centre_of_mass
                .iter()
                .all(|value| value.abs() <= DISTANCE_MAX)
            {
                let centre = tool.centre_of_mass;
                return Err(format!(
                    "{name}: centre_of_mass is {centre:?}; it must be finite, m"
                ));
            }
        }
        self.check_homes()?;
        self.check_cycles()
    }

    /// Checks home positions as far as they do not depend on the arm.
    fn check_homes(&self) -> Result<(), String> {
        let mut known = BTreeSet::new();
        for HomeConfig { device, joints } in &self.homes {
            check_device_name(device)?;
            if !known.insert(device) {
                return Err(format!("the home of device `{device}` is given twice"));
            }
            if joints.is_empty() || !joints.iter().all(|joint| joint.is_finite()) {
                return Err(format!(
                    "home of device `{device}`: joints are {joints:?}; one finite angle for each joint is expected"
                ));
            }
        }
        Ok(())
    }

    fn check_counts(&self) -> Result<(), String> {
        let counts = [
            ("frame", self.frames.len()),
            ("base", self.bases.len()),
            ("tool", self.tools.len()),
            ("home", self.homes.len()),
            ("object", self.objects.len()),
        ];
        match counts.into_iter().find(|(_, count)| *count > FRAMES_MAX) {
            None => Ok(()),
            Some((kind, count)) => Err(format!(
                "{count} tables [[{kind}]]; at most {FRAMES_MAX} are possible"
            )),
        }
    }

    fn check_names(&self) -> Result<(), String> {
        let mut known = BTreeSet::new();
        let frames = self.frames.iter().map(|frame| ("frame", &frame.name, None));
        let tools = self.tools.iter();
        let tools = tools.map(|tool| ("tool", &tool.name, Some(tool.device.as_str())));
        let objects = self.objects.iter();
        let objects = objects.map(|object| ("object", &object.name, None));
        for (kind, name, device) in frames.chain(tools).chain(objects) {
            let is_taken = if device.is_some() {
                PARTS.contains(&name.as_str())
            } else {
                name == WORLD
            };
            if is_taken || name.contains('.') {
                return Err(format!(
                    "{kind} name `{name}` is reserved or contains a dot\nhint: `world`, `base`, `flange`, \
                     `odometry` and names with a dot are those of the cell and of its devices"
                ));
            }
            check_device_name(name).map_err(|why| why.replacen("device name", "name", 1))?;
            // An object is no frame, so it may have the name of one.
            if !known.insert((kind == "object", device, name.clone())) {
                return Err(format!("{kind} name `{name}` is given twice"));
            }
        }
        let mut placed = BTreeSet::new();
        for device in self.bases.iter().map(|base| &base.device) {
            check_device_name(device)?;
            if !placed.insert(device) {
                return Err(format!("the base of device `{device}` is given twice"));
            }
        }
        let arms = self.tools.iter().map(|tool| &tool.device);
        arms.into_iter()
            .try_for_each(|device| check_device_name(device))
    }

    fn check_parent(&self, name: &str, parent: &str, devices: &[String]) -> Result<(), String> {
        let is_frame = |name: &str| self.frames.iter().any(|frame| frame.name == name);
        if parent == WORLD || is_frame(parent) {
            return Ok(());
        }
        let of_device = parent.rsplit_once('.').is_some_and(|(device, part)| {
            let is_known =
                devices.iter().any(|known| known == device) || self.devices().contains(device);
            let is_tool = self.tools(device).any(|tool| tool.name == part);
            is_known && (PARTS.contains(&part) || is_tool)
        });
        if of_device {
            return Ok(());
        }
        let frames: Vec<_> = self
            .frames
            .iter()
            .map(|frame| format!(", `{}`", frame.name))
            .collect();
        Err(format!(
            "{name}: parent is `{parent}`, which is no frame\nhint: there are `{WORLD}`{}, and of each device \
             `DEVICE.base`, `DEVICE.flange`, `DEVICE.odometry` and its tools",
            frames.concat()
        ))
    }

    /// The parent of a frame, as far as placements go: parts of a device are placed by its base.
    fn parent(&self, name: &str) -> Option<&str> {
        if let Some(frame) = self.frames.iter().find(|frame| frame.name == name) {
            return Some(&frame.parent);
        }
        let (device, _) = name.rsplit_once('.')?;
        Some(&self.base(device)?.parent)
    }

    fn check_cycles(&self) -> Result<(), String> {
        let frames = self
            .frames
            .iter()
            .map(|frame| (frame.name.as_str(), frame.parent.as_str()));
        let bases = self.bases.iter();
        let bases = bases.map(|base| (base.device.as_str(), base.parent.as_str()));
        let steps = self.frames.len() + self.bases.len();
        for (name, parent) in frames.chain(bases) {
            let chain = std::iter::successors(Some(parent), |at| self.parent(at));
            // A chain without a cycle has each frame and each device at most once.
            if chain.take(steps + 1).count() > steps {
                return Err(format!(
                    "{name}: parent is `{parent}`, and the chain of parents does not end\nhint: one of its \
                     frames must be placed in `{WORLD}`"
                ));
            }
        }
        Ok(())
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
    fn frames_bases_and_tools_are_read() {
        let cell = parse(
            "[[frame]]\nname = 'table'\nposition = [1, 0, 0.7]\nrotation = [90, 0, 0]\n\
             hints = { left = [0, 30, 0, -60, 0, 90, 0] }\n\
             [[frame]]\nname = 'slot'\nparent = 'table'\n\
             [[base]]\ndevice = 'left'\nparent = 'table'\nposition = [0, 0, 0.1]\n\
             [[base]]\ndevice = 'hand'\nparent = 'left.flange'\n\
             [[frame]]\nname = 'camera'\nparent = 'left.pen'\n\
             [[tool]]\nname = 'pen'\ndevice = 'left'\nposition = [0, 0, 0.2]\nmass = 0.3\n\
             centre_of_mass = [0, 0, 0.05]\n\
             [[home]]\ndevice = 'right'\njoints = [0, 30, 0]",
        )
        .unwrap();
        let frames = &cell.frames;
        assert_eq!(frames.frames.len(), 3);
        assert_eq!(frames.base("hand").unwrap().parent, "left.flange");
        assert_eq!(frames.tools("left").next().unwrap().mass.to_string(), "0.3");
        let x = frames.frames[0].placement().frame() * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!(
            (x - nalgebra::Point3::new(1.0, 1.0, 0.7)).norm() < 1e-12,
            "{x}"
        );
        assert_eq!(
            frames.devices().into_iter().collect::<Vec<_>>(),
            ["hand", "left", "right"]
        );
        assert_eq!(frames.home("right").unwrap().joints.len(), 3);
        assert_eq!(frames.home("left"), None);
    }

    #[test]
    #[expect(clippy::too_many_lines, reason = "a table")]
    fn frame_faults_name_line_cause_and_hint() {
        for (text, line, cause) in [
            (
                "[[frame]]\nname = 'a'\nparent = 'b'",
                3,
                "a: parent is `b`, which is no frame\nhint:",
            ),
            (
                "[[frame]]\nname = 'a'\nparent = 'left.flange'",
                3,
                "which is no frame",
            ),
            (
                "[[frame]]\nname = 'a'\nparent = 'a'",
                3,
                "chain of parents does not end\nhint:",
            ),
            (
                "[[frame]]\nname = 'a'\nparent = 'b'\n[[frame]]\nname = 'b'\nparent = 'a'",
                3,
                "a: parent is `b`, and the chain",
            ),
            (
                "[[base]]\ndevice = 'left'\nparent = 'cart'\n[[frame]]\nname = 'cart'\nparent = 'left.flange'",
                6,
                "the chain of parents does not end",
            ),
            (
                "[[frame]]\nname = 'a'\nposition = [0, nan, 0]",
                3,
                "it must be finite",
            ),
            (
                "[[frame]]\nname = 'a'\nrotation = [inf, 0, 0]",
                3,
                "it must be finite",
            ),
            (
                "[[frame]]\nname = 'a'\n[[frame]]\nname = 'a'",
                4,
                "frame name `a` is given twice",
            ),
            ("[[frame]]\nname = 'world'", 2, "is reserved"),
            ("[[frame]]\nname = 'a.b'", 2, "contains a dot"),
            (
                "[[frame]]\nname = 'a'\nhints = { left = [nan] }",
                3,
                "hints of `left`",
            ),
            (
                "[[base]]\ndevice = 'left'\n[[base]]\ndevice = 'left'",
                4,
                "base of device `left` is given twice",
            ),
            (
                "[[tool]]\nname = 'pen'\ndevice = 'left'\nmass = -1",
                4,
                "mass is -1 kg",
            ),
            (
                "[[tool]]\nname = 'pen'\ndevice = 'left'\ncentre_of_mass = [nan, 0, 0]",
                4,
                "centre_of_mass",
            ),
            (
                "[[tool]]\nname = 'flange'\ndevice = 'left'",
                2,
                "is reserved",
            ),
            (
                "[[home]]\ndevice = 'left'\njoints = [0]\n[[home]]\ndevice = 'left'\njoints = [1]",
                5,
                "home of device `left` is given twice",
            ),
            (
                "[[home]]\ndevice = 'a'\njoints = []\n[[home]]\ndevice = 'left'\njoints = [0]",
                2,
                "home of device `a`: joints are []",
            ),
            (
                "[[home]]\ndevice = 'left'\njoints = [0, nan]",
                2,
                "one finite angle for each joint",
            ),
            (
                "[[frame]]\nname = 'a'\nposition = [0, 0]",
                3,
                "invalid length 2",
            ),
            (
                "[[frame]]\nname = 'a'\npos = [0, 0, 0]",
                3,
                "unknown field `pos`",
            ),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(cause), "{text}: {error}");
            assert!(
                error.contains(&format!("at line {line},")),
                "{text}: {error}"
            );
        }
        let many = "[[base]]\ndevice = 'a'\n".repeat(FRAMES_MAX + 1);
        assert!(parse(&many).unwrap_err().contains("at most 1024"));
    }
}
