//! The command message, client to controller. It does not check that its fields fit a command mode.

use super::bounded::List;
use super::monitoring::push;
use super::parts::{
    EndOf, Header, IoValue, Joints, Redundancy, Transformation, read_array, required, write_joints,
    write_vector,
};
use super::proto::{Field, Reader, Writer};
use super::{IOS_MAX, ShowJoints, TRANSFORMATIONS_MAX};
use crate::error::{DecodeError, EncodeError};
use std::fmt;

/// `FRICommandMessage`, sent by the client for every `receiveMultiplier`-th monitoring message.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required | [`Header`], id 0x34001 |
/// | 2 | optional | [`CommandData`] |
/// | 15 | optional, until 2.5 | [`EndOf`] |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Command {
    /// Sequence numbers.
    pub header: Header,
    /// Commanded values.
    pub data: Option<CommandData>,
    /// Never sent by known clients.
    pub end: Option<EndOf>,
}

/// `MessageCommandData`.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | optional JointValues | jointPosition |
/// | 2 | optional CartesianVector | cartesianWrenchFeedForward |
/// | 3 | optional JointValues | jointTorque |
/// | 4 | repeated, up to 5 | commandedTransformations |
/// | 5 | repeated, up to 10, from 1.14 | writeIORequest |
/// | 6 | optional, 2.x | cartesianPose |
/// | 7 | optional, 2.x | redundancyInformation |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CommandData {
    /// Joint positions, rad.
    pub joints: Option<Joints>,
    /// Added force Fx, Fy, Fz in N and torque about A, B, C in Nm.
    #[doc(alias = "cartesianWrenchFeedForward")]
    pub wrench: Option<[f64; 6]>,
    /// Added joint torques, Nm.
    pub torque: Option<Joints>,
    /// Frames that the robot program requested.
    pub transformations: List<Transformation, TRANSFORMATIONS_MAX>,
    /// Outputs to be written.
    #[doc(alias = "writeIORequest")]
    pub ios: List<IoValue, IOS_MAX>,
    /// Pose of the tool (2.x).
    pub pose: Option<Transformation>,
    /// Redundant axis of that pose (2.x).
    pub redundancy: Option<Redundancy>,
}

impl Command {
    /// Its message identifier.
    pub const ID: u32 = 0x0003_4001;

    /// Reads the protobuf message, without the framing of 2.7; see [`super::unframe`].
    pub fn decode(message: &[u8]) -> Result<Self, DecodeError> {
        let mut command = Self::default();
        let mut header = None;
        let mut from = Reader::new(message);
        while let Some(field) = from.next()? {
            match field.tag {
                1 => header = Some(Header::read(&field, Self::ID)?),
                2 => command.data = Some(CommandData::read(&field)?),
                15 => command.end = Some(EndOf::read(&field)?),
                _ => {}
            }
        }
        command.header = required(header, "header")?;
        Ok(command)
    }

    /// Writes the protobuf message to the front of `buf` and returns its length; see [`super::Dialect::frame`].
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        let mut to = Writer::new(buf);
        self.header.write(&mut to, Self::ID)?;
        if let Some(data) = &self.data {
            to.nested(2, |to| data.write(to))?;
        }
        self.end.map_or(Ok(()), |end| end.write(&mut to, 15))?;
        Ok(to.len())
    }
}

impl CommandData {
    fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let mut data = Self::default();
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => data.joints = read_array(&field, "jointPosition")?,
                2 => data.wrench = read_array(&field, "cartesianWrenchFeedForward")?,
                3 => data.torque = read_array(&field, "jointTorque")?,
                4 => push(
                    &mut data.transformations,
                    Transformation::read(&field)?,
                    "commandedTransformations",
                )?,
                5 => push(&mut data.ios, IoValue::read(&field)?, "writeIORequest")?,
                6 => data.pose = Some(Transformation::read(&field)?),
                7 => data.redundancy = Some(Redundancy::read(&field)?),
                _ => {}
            }
        }
        Ok(data)
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        write_joints(to, 1, self.joints.as_ref())?;
        write_vector(to, 2, self.wrench.as_ref())?;
        write_joints(to, 3, self.torque.as_ref())?;
        for transformation in self.transformations.iter() {
            transformation.write(to, 4)?;
        }
        for io in self.ios.iter() {
            io.write(to, 5)?;
        }
        if let Some(pose) = &self.pose {
            pose.write(to, 6)?;
        }
        self.redundancy.map_or(Ok(()), |it| it.write(to, 7))
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Header {
            sequence,
            reflected,
        } = self.header;
        write!(f, "COM seq {sequence} refl {reflected}")?;
        let Some(data) = &self.data else {
            return f.write_str(" empty");
        };
        if let Some(joints) = &data.joints {
            write!(f, " q {} rad", ShowJoints(joints))?;
        }
        if let Some(torque) = &data.torque {
            write!(f, " tau {} Nm", ShowJoints(torque))?;
        }
        if let Some(wrench) = &data.wrench {
            write!(f, " wrench {} N, Nm", ShowJoints(wrench))?;
        }
        if data.pose.is_some() {
            f.write_str(" pose")?;
        }
        for io in data.ios.iter() {
            write!(f, " {}", io.name)?;
        }
        Ok(())
    }
}
