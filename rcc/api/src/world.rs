//! Frames of the cell, as the controller's cell file places them: goals of motions may be poses in any frame that is
//! connected with the base of the arm. Flanges and mobile bases move: what is placed in one is connected with that one only.

use std::collections::BTreeMap;

use takt_client::Value;

use crate::description::{Descriptions, text};
use crate::error::{Error, ErrorKind};
use crate::motion::Along;
use crate::pose::Pose;
use crate::session::Session;

/// The frame that every frame without parent is placed in.
const WORLD: &str = "world";

/// A named frame of a cell, where it was placed when the program requested it.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    name: String,
    /// The frame in which it and its parents are placed in the end.
    root: String,
    /// Its pose there.
    pose: Pose,
}

impl Frame {
    /// A frame at a pose in the world.
    pub(crate) fn in_world(name: String, pose: Pose) -> Self {
        let root = WORLD.to_owned();
        Self { name, root, pose }
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The frame in which it is placed in the end, such as `world` or `left.flange`.
    pub fn root(&self) -> &str {
        &self.root
    }

    /// Its pose in [`Self::root`].
    pub(crate) const fn placement(&self) -> Pose {
        self.pose
    }

    /// Whether nothing places it.
    pub(crate) fn is_root(&self) -> bool {
        self.name == self.root
    }

    /// A pose in this frame, as a goal.
    pub fn pose(&self, pose: impl Into<Pose>) -> Goal {
        Goal {
            pose: pose.into(),
            frame: Some(self.clone()),
        }
    }

    /// A direction along the axes of this frame.
    pub fn direction(&self, direction: [f64; 3]) -> Direction {
        Direction {
            frame: Some(self.clone()),
            ..direction.into()
        }
    }

    /// Its pose in another frame.
    ///
    /// # Errors
    /// [`ErrorKind::NotConnected`] if the pose of one in the other changes with motions, or is not known.
    #[track_caller]
    pub fn within(&self, other: &Self) -> Result<Pose, Error> {
        Ok(self.placed_in(other)?)
    }

    pub(crate) fn placed_in(&self, other: &Self) -> Result<Pose, ErrorKind> {
        if self.root == other.root {
            return Ok(other.pose.inverse() * self.pose);
        }
        Err(ErrorKind::NotConnected {
            frames: Box::new([self, other].map(|frame| (frame.name.clone(), frame.root.clone()))),
        })
    }
}

/// The goal of a motion: a pose in the base of the arm, or in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    pose: Pose,
    frame: Option<Frame>,
}

impl Goal {
    /// The goal in the base of an arm.
    pub(crate) fn within(&self, base: &Frame) -> Result<Pose, ErrorKind> {
        let frame = self.frame.as_ref().map(|frame| frame.placed_in(base));
        let frame = frame.transpose()?;
        Ok(frame.map_or(self.pose, |frame| frame * self.pose))
    }
}

impl<P: Into<Pose>> From<P> for Goal {
    fn from(pose: P) -> Self {
        let pose = pose.into();
        Self { pose, frame: None }
    }
}

/// The direction of a force: three coordinates of any length but 0, along the axes of the base of the arm, of a
/// [frame](Frame::direction), or of the motion centre.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction {
    along: Along,
    frame: Option<Frame>,
}

impl From<[f64; 3]> for Direction {
    fn from(direction: [f64; 3]) -> Self {
        Self {
            along: Along::Base(direction),
            frame: None,
        }
    }
}

impl Direction {
    /// A direction along the axes of the motion centre, with which it turns.
    pub const fn of_centre(direction: [f64; 3]) -> Self {
        Self {
            along: Along::Centre(direction),
            frame: None,
        }
    }

    /// The direction for an arm with this base.
    pub(crate) fn within(&self, base: &Frame) -> Result<Along, ErrorKind> {
        let Some(frame) = &self.frame else {
            return Ok(self.along);
        };
        let frame = frame.placed_in(base)?;
        Ok(self.along.turned(&frame))
    }
}

impl Pose {
    /// This pose in a frame of the cell, as a goal.
    pub fn in_(self, frame: &Frame) -> Goal {
        frame.pose(self)
    }
}

/// Where a frame is placed.
#[derive(Debug)]
struct Placed {
    parent: String,
    pose: Pose,
}

/// The frames of a cell.
#[derive(Debug)]
pub(crate) struct World(BTreeMap<String, Option<Placed>>);

impl World {
    pub(crate) fn read(session: &Session, devices: &Descriptions) -> Result<Self, ErrorKind> {
        let reply = session.client().call("fin", [] as [&str; 0])?;
        let frames = reply.values.into_iter().next();
        let frames = frames.as_ref().and_then(Value::as_map);
        Ok(Self::new(frames.unwrap_or(&BTreeMap::new()), devices))
    }

    fn new(frames: &BTreeMap<String, Value>, devices: &Descriptions) -> Self {
        let mut all = BTreeMap::from([(WORLD.to_owned(), None)]);
        let named = frames
            .iter()
            .map(|(name, frame)| (name.clone(), placed(frame)));
        all.extend(named);
        for (device, description) in devices.all() {
            let base = description.as_map().and_then(|it| it.get("base"));
            let base = base.and_then(placed);
            if devices.has(device, "robotbase") {
                // Its [[base]] is where it started, and it moves from there.
                all.insert(format!("{device}.odometry"), base);
                all.insert(format!("{device}.base"), None);
            } else {
                all.insert(format!("{device}.base"), base);
            }
            let flange = format!("{device}.flange");
            let tools = description.as_map().and_then(|it| it.get("tools"));
            for (tool, description) in tools.and_then(Value::as_map).into_iter().flatten() {
                let pose = text(description, "pose").and_then(Pose::read);
                let parent = flange.clone();
                let placed = pose.map(|pose| Placed { parent, pose });
                all.insert(format!("{device}.{tool}"), placed);
            }
            all.insert(flange, None);
        }
        Self(all)
    }

    /// All frames.
    pub(crate) fn frames(&self) -> Result<Vec<Frame>, ErrorKind> {
        self.0.keys().map(|name| self.frame(name)).collect()
    }

    /// A frame by its name.
    pub(crate) fn frame(&self, name: &str) -> Result<Frame, ErrorKind> {
        if !self.0.contains_key(name) {
            let known = self.0.keys().cloned().collect();
            return Err(ErrorKind::no_device("frame", name, known));
        }
        let (mut root, mut pose) = (name, Pose::IDENTITY);
        // The controller refuses cycles; each frame is passed once.
        for _ in 0..self.0.len() {
            let Some(Some(placed)) = self.0.get(root) else {
                break;
            };
            (root, pose) = (&placed.parent, placed.pose * pose);
        }
        Ok(Frame {
            name: name.to_owned(),
            root: root.to_owned(),
            pose,
        })
    }
}

fn placed(frame: &Value) -> Option<Placed> {
    Some(Placed {
        parent: text(frame, "parent")?.to_owned(),
        pose: Pose::read(text(frame, "pose")?)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world() -> World {
        let at = |parent: &str, x: f64| {
            let pose = Pose::xyz(x, 0.0, 0.0);
            let parent = parent.to_owned();
            Some(Placed { parent, pose })
        };
        let frames = [
            ("world", None),
            ("table", at("world", 1.0)),
            ("part", at("table", 0.25)),
            ("left.base", at("table", -0.5)),
            ("left.flange", None),
            ("camera", at("left.flange", 0.1)),
            ("loop", at("loop", 1.0)),
        ];
        World(
            frames
                .map(|(name, placed)| (name.to_owned(), placed))
                .into(),
        )
    }

    #[test]
    fn goal_in_a_frame_is_resolved_to_the_base() {
        let world = world();
        let (part, base) = (
            world.frame("part").unwrap(),
            world.frame("left.base").unwrap(),
        );
        let goal = Pose::xyz(0.0, 0.0, 0.1).in_(&part).within(&base).unwrap();
        let [x, y, z] = goal.position();
        assert!((x - 0.75).abs() < 1e-12 && y.abs() < 1e-12 && (z - 0.1).abs() < 1e-12);
        let plain = Goal::from(Pose::xyz(0.1, 0.0, 0.0)).within(&base).unwrap();
        assert_eq!(plain, Pose::xyz(0.1, 0.0, 0.0));
    }

    #[test]
    fn unconnected_frames_are_both_named() {
        let world = world();
        let (camera, base) = (
            world.frame("camera").unwrap(),
            world.frame("left.base").unwrap(),
        );
        let text = camera.within(&base).unwrap_err().to_string();
        for part in [
            "`camera`",
            "`left.base`",
            "`left.flange`",
            "`world`",
            "\nhint:",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn all_frames_have_their_roots() {
        let frames = world().frames().unwrap();
        let roots: Vec<_> = frames.iter().map(|it| (it.name(), it.root())).collect();
        assert_eq!(roots.len(), 7);
        assert!(roots.contains(&("camera", "left.flange")));
        assert!(roots.contains(&("part", "world")));
        assert!(roots.contains(&("left.flange", "left.flange")));
    }

    #[test]
    fn unknown_frame_lists_known_ones() {
        let error = world().frame("tabel").unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("no frame `tabel`") && text.contains("table"),
            "{text}"
        );
        assert!(world().frame("loop").is_ok());
    }
}
