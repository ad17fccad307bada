//! Frames that move while an arm follows them, evaluated by the controller in each cycle.

use std::sync::Arc;

use crate::arm::Arm;
use crate::base::{self, Base};
use crate::error::{Error, ErrorKind};
use crate::expression::Number;
use crate::motion::{ArmDescription, centre_of};
use crate::net::{Net, Port};
use crate::pose::Pose;
use crate::world::Frame;

/// A frame that moves.
#[derive(Clone, Debug)]
pub struct MovingFrame {
    source: Source,
    /// The frame in which its source moves; without one, the base of the arm that follows.
    root: Option<Frame>,
    /// The pose in it that is followed.
    offset: Pose,
}

/// What moves a frame.
#[derive(Clone, Debug)]
enum Source {
    /// The motion centre of an arm, as it is commanded.
    Centre(Box<ArmDescription>, Pose),
    /// A mobile base, as it is measured.
    Base(String),
    /// x, y, z in m, and the rotations about z, the new y and the new x in rad.
    Numbers(Arc<[Number; 6]>),
}

impl MovingFrame {
    /// The frame at three numbers, m, and turned by the next three about z, the new y and the new x, rad: in the base of the
    /// arm that follows it, or in the frame of [`Self::in_`].
    pub fn of(position: [Number; 3], rotation: [Number; 3]) -> Self {
        let ([x, y, z], [a, b, c]) = (position, rotation);
        Self {
            source: Source::Numbers(Arc::new([x, y, z, a, b, c])),
            root: None,
            offset: Pose::IDENTITY,
        }
    }

    /// The frame of numbers that are given in a frame of the cell.
    #[must_use]
    pub fn in_(mut self, frame: &Frame) -> Self {
        self.root = Some(frame.clone());
        self
    }

    /// A pose that moves with the frame.
    #[must_use]
    pub fn pose(mut self, pose: impl Into<Pose>) -> Self {
        self.offset = self.offset * pose.into();
        self
    }

    /// The pose in the frame that is followed.
    pub(crate) const fn offset(&self) -> Pose {
        self.offset
    }

    /// The arm that moves it, if one does.
    pub(crate) fn arm(&self) -> Option<&str> {
        match &self.source {
            Source::Centre(arm, _) => Some(&arm.name),
            Source::Base(_) | Source::Numbers(_) => None,
        }
    }

    /// Where its source moves, in the base of an arm.
    pub(crate) fn placed_in(&self, base: &Frame) -> Result<Pose, ErrorKind> {
        let root = self.root.as_ref();
        root.map_or(Ok(Pose::IDENTITY), |root| root.placed_in(base))
    }

    /// Writes where it is, in the frame in which it moves.
    pub(crate) fn write(&self, net: &mut Net) -> Port {
        match &self.source {
            Source::Centre(arm, tool) => centre_of(net, arm, tool),
            Source::Base(name) => base::measured(net, name),
            Source::Numbers(numbers) => {
                let [x, y, z, a, b, c] = numbers.each_ref().map(|number| number.write(net));
                let rotation = [
                    ("inA", (&a).into()),
                    ("inB", (&b).into()),
                    ("inC", (&c).into()),
                ];
                let rotation = net.add("World::RotationFromABC", rotation).out("outValue");
                let frame = [
                    ("inX", (&x).into()),
                    ("inY", (&y).into()),
                    ("inZ", (&z).into()),
                    ("inRot", (&rotation).into()),
                ];
                net.add("World::FrameFromXYZ", frame).out("outValue")
            }
        }
    }
}

impl Arm {
    /// Its motion centre as a frame that moves, where the arm is commanded.
    pub fn centre(&self) -> MovingFrame {
        MovingFrame {
            source: Source::Centre(Box::new(self.description().clone()), self.tool()),
            root: Some(self.base_frame().clone()),
            offset: Pose::IDENTITY,
        }
    }
}

impl Base {
    /// Itself as a frame that moves, where the base is measured.
    ///
    /// # Errors
    /// If the connection is lost.
    #[track_caller]
    pub fn centre(&self) -> Result<MovingFrame, Error> {
        Ok(MovingFrame {
            source: Source::Base(self.name().to_owned()),
            root: Some(self.odometry()?),
            offset: Pose::IDENTITY,
        })
    }
}
