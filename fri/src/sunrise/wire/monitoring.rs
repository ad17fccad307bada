//! The monitoring message, controller to client. Successive messages are related elsewhere.

use super::bounded::List;
use super::codes::{
    CommandMode, ControlMode, Drive, OperationMode, Overlay, Quality, Safety, SessionState,
};
use super::parts::{
    EndOf, Header, IoValue, Joints, Redundancy, TimeStamp, Transformation, read_array, required,
    write_joints, write_vector,
};
use super::proto::{Field, Reader, Writer};
use super::{IOS_MAX, ShowJoints, TRANSFORMATIONS_MAX};
use crate::error::{DecodeError, EncodeError};
use crate::sunrise::AXES;
use std::fmt;

/// `FRIMonitoringMessage`, sent by the controller once per period.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required | [`Header`], id 0x245142 |
/// | 2 | optional | [`RobotInfo`] |
/// | 3 | optional | [`MonitorData`] |
/// | 4 | optional | [`ConnectionInfo`] |
/// | 5 | optional | [`IpoData`] |
/// | 6 | repeated, up to 5 | requested [`Transformation`]s |
/// | 15 | optional, until 2.5 | [`EndOf`] |
///
/// Numbers of a repeated field are read packed and unpacked and written as the SDK writes them. Unknown fields are skipped.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Monitoring {
    /// Sequence numbers.
    pub header: Header,
    /// State of drives and safety.
    pub robot: Option<RobotInfo>,
    /// Measurements.
    pub monitor: Option<MonitorData>,
    /// State of the session.
    pub connection: Option<ConnectionInfo>,
    /// State of the interpolator.
    pub ipo: Option<IpoData>,
    /// Frames that the robot program requests from the client.
    #[doc(alias = "requestedTransformations")]
    pub requested: List<Transformation, TRANSFORMATIONS_MAX>,
    /// Present in messages of some old controllers.
    pub end: Option<EndOf>,
}

/// `RobotInfo`.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | optional int32 | numberOfJoints |
/// | 2 | optional enum | safetyState |
/// | 5 | repeated enum | driveState |
/// | 6 | optional enum | operationMode |
/// | 7 | optional enum | controlMode |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RobotInfo {
    /// Number of axes; 7.
    pub joints: Option<i32>,
    /// Request of the safety controller.
    pub safety: Option<Safety>,
    /// State of each drive; `None` if not reported.
    pub drives: Option<[Drive; AXES]>,
    /// Operation mode at the smartPAD.
    pub operation_mode: Option<OperationMode>,
    /// Control mode of the motion under way.
    pub control_mode: Option<ControlMode>,
}

/// `MessageMonitorData`.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | optional JointValues | measuredJointPosition |
/// | 2 | optional JointValues | measuredTorque |
/// | 3 | optional JointValues, 1.x only | commandedJointPosition |
/// | 4 | optional JointValues | commandedTorque |
/// | 5 | optional JointValues | externalTorque |
/// | 6 | optional CartesianVector, 2.7 | externalForce |
/// | 8 | repeated, up to 10, from 1.14 | readIORequest |
/// | 9 | optional, 2.x | measuredCartesianPose |
/// | 10 | optional, 2.x | measuredRedundancyInformation |
/// | 15 | optional TimeStamp | timestamp |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MonitorData {
    /// Measured joint positions, rad.
    pub measured: Option<Joints>,
    /// Measured joint torques, Nm.
    pub torque: Option<Joints>,
    /// Commanded joint positions, rad (1.x only).
    pub commanded: Option<Joints>,
    /// Commanded joint torques, Nm.
    pub commanded_torque: Option<Joints>,
    /// Estimated external joint torques, Nm.
    pub external_torque: Option<Joints>,
    /// Estimated external force, N, and torque, Nm, at the tool (2.7).
    pub external_force: Option<[f64; 6]>,
    /// Inputs and outputs that the robot program shares, with their values.
    #[doc(alias = "readIORequest")]
    pub ios: List<IoValue, IOS_MAX>,
    /// Measured pose of the tool (2.x).
    pub pose: Option<Transformation>,
    /// Redundant axis of that pose (2.x).
    pub redundancy: Option<Redundancy>,
    /// Time of the measurement, on the controller's clock.
    pub stamp: Option<TimeStamp>,
}

/// `ConnectionInfo`.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required enum | sessionState |
/// | 2 | required enum | quality |
/// | 3 | optional uint32 | sendPeriod, ms |
/// | 4 | optional uint32 | receiveMultiplier |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConnectionInfo {
    /// State of the session.
    pub state: SessionState,
    /// The controller's rating of our timing.
    pub quality: Quality,
    /// Period of monitoring messages, ms, 1..=100.
    #[doc(alias = "sendPeriod")]
    pub send_period_ms: Option<u32>,
    /// An answer is due to every n-th message, from 1.
    pub receive_multiplier: Option<u32>,
}

/// `MessageIpoData`.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | optional JointValues, COMMANDING states only | jointPosition |
/// | 2 | optional, 2.x | cartesianPose |
/// | 3 | optional, 2.x | redundancyInformation |
/// | 10 | optional enum | clientCommandMode |
/// | 11 | optional enum | overlayType |
/// | 12 | optional double | trackingPerformance |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct IpoData {
    /// Joint positions of the interpolator, rad.
    pub joints: Option<Joints>,
    /// Pose of the interpolator (2.x).
    pub pose: Option<Transformation>,
    /// Redundant axis of that pose (2.x).
    pub redundancy: Option<Redundancy>,
    /// Values that the client has to command.
    pub command_mode: Option<CommandMode>,
    /// Kind of overlay.
    pub overlay: Option<Overlay>,
    /// Tracking performance of the robot, 0..=1; 0 unless COMMANDING_ACTIVE.
    #[doc(alias = "trackingPerformance")]
    pub tracking: Option<f64>,
}

impl Monitoring {
    /// Its message identifier.
    pub const ID: u32 = 0x0024_5142;

    /// Reads the protobuf message, without the framing of 2.7; see [`super::unframe`].
    pub fn decode(message: &[u8]) -> Result<Self, DecodeError> {
        let mut monitoring = Self::default();
        let mut header = None;
        let mut from = Reader::new(message);
        while let Some(field) = from.next()? {
            match field.tag {
                1 => header = Some(Header::read(&field, Self::ID)?),
                2 => monitoring.robot = Some(RobotInfo::read(&field)?),
                // In place: the value is large.
                3 => monitoring
                    .monitor
                    .insert(MonitorData::default())
                    .read(&field)?,
                4 => monitoring.connection = Some(ConnectionInfo::read(&field)?),
                5 => monitoring.ipo = Some(IpoData::read(&field)?),
                6 => push(
                    &mut monitoring.requested,
                    Transformation::read(&field)?,
                    "requestedTransformations",
                )?,
                15 => monitoring.end = Some(EndOf::read(&field)?),
                _ => {}
            }
        }
        monitoring.header = required(header, "header")?;
        Ok(monitoring)
    }

    /// Writes the protobuf message to the front of `buf` and returns its length; see [`super::Dialect::frame`].
    pub fn encode(&self, buf: &mut [u8]) -> Result<usize, EncodeError> {
        let mut to = Writer::new(buf);
        self.header.write(&mut to, Self::ID)?;
        if let Some(robot) = &self.robot {
            to.nested(2, |to| robot.write(to))?;
        }
        if let Some(monitor) = &self.monitor {
            to.nested(3, |to| monitor.write(to))?;
        }
        if let Some(connection) = &self.connection {
            to.nested(4, |to| connection.write(to))?;
        }
        if let Some(ipo) = &self.ipo {
            to.nested(5, |to| ipo.write(to))?;
        }
        for requested in self.requested.iter() {
            requested.write(&mut to, 6)?;
        }
        self.end.map_or(Ok(()), |end| end.write(&mut to, 15))?;
        Ok(to.len())
    }

    /// State of the session; IDLE if the message has no connection information.
    pub fn state(&self) -> SessionState {
        self.connection
            .map_or(SessionState::Idle, |connection| connection.state)
    }

    /// Quality; POOR if the message has no connection information.
    pub fn quality(&self) -> Quality {
        self.connection
            .map_or(Quality::Poor, |connection| connection.quality)
    }

    /// Values that the client has to command.
    pub fn command_mode(&self) -> CommandMode {
        self.ipo
            .and_then(|ipo| ipo.command_mode)
            .unwrap_or(CommandMode::None)
    }

    /// Measured joint positions, rad.
    pub fn measured(&self) -> Option<Joints> {
        self.monitor.and_then(|monitor| monitor.measured)
    }
}

pub(super) fn push<T: Copy + Default, const N: usize>(
    list: &mut List<T, N>,
    item: T,
    field: &'static str,
) -> Result<(), DecodeError> {
    list.push(item)
        .map_err(|_| DecodeError::TooMany { field, max: N })
}

impl RobotInfo {
    fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let mut info = Self::default();
        let mut drives = List::<i32, AXES>::new();
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => info.joints = Some(field.i32()?),
                2 => info.safety = Some(field.i32()?.into()),
                5 => field.i32s(|state| push(&mut drives, state, "driveState"))?,
                6 => info.operation_mode = Some(field.i32()?.into()),
                7 => info.control_mode = Some(field.i32()?.into()),
                _ => {}
            }
        }
        info.drives = match <[i32; AXES]>::try_from(&*drives) {
            Ok(drives) => Some(drives.map(Drive::from)),
            Err(_) if drives.is_empty() => None,
            Err(_) => {
                return Err(DecodeError::Count {
                    field: "driveState",
                    expected: AXES,
                    actual: drives.len(),
                });
            }
        };
        Ok(info)
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        self.joints.map_or(Ok(()), |joints| to.i32(1, joints))?;
        self.safety.map_or(Ok(()), |it| to.i32(2, it.code()))?;
        for drive in self.drives.iter().flatten() {
            to.i32(5, drive.code())?;
        }
        self.operation_mode
            .map_or(Ok(()), |it| to.i32(6, it.code()))?;
        self.control_mode.map_or(Ok(()), |it| to.i32(7, it.code()))
    }
}

impl MonitorData {
    fn read(&mut self, field: &Field<'_>) -> Result<(), DecodeError> {
        let data = self;
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => data.measured = read_array(&field, "measuredJointPosition")?,
                2 => data.torque = read_array(&field, "measuredTorque")?,
                3 => data.commanded = read_array(&field, "commandedJointPosition")?,
                4 => data.commanded_torque = read_array(&field, "commandedTorque")?,
                5 => data.external_torque = read_array(&field, "externalTorque")?,
                6 => data.external_force = read_array(&field, "externalForce")?,
                8 => push(&mut data.ios, IoValue::read(&field)?, "readIORequest")?,
                9 => data.pose = Some(Transformation::read(&field)?),
                10 => data.redundancy = Some(Redundancy::read(&field)?),
                15 => data.stamp = Some(TimeStamp::read(&field)?),
                _ => {}
            }
        }
        Ok(())
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        write_joints(to, 1, self.measured.as_ref())?;
        write_joints(to, 2, self.torque.as_ref())?;
        write_joints(to, 3, self.commanded.as_ref())?;
        write_joints(to, 4, self.commanded_torque.as_ref())?;
        write_joints(to, 5, self.external_torque.as_ref())?;
        write_vector(to, 6, self.external_force.as_ref())?;
        for io in self.ios.iter() {
            io.write(to, 8)?;
        }
        write_transformation(to, 9, self.pose.as_ref())?;
        self.redundancy.map_or(Ok(()), |it| it.write(to, 10))?;
        self.stamp.map_or(Ok(()), |it| it.write(to, 15))
    }
}

fn write_transformation(
    to: &mut Writer<'_>,
    tag: u32,
    pose: Option<&Transformation>,
) -> Result<(), EncodeError> {
    pose.map_or(Ok(()), |pose| pose.write(to, tag))
}

impl ConnectionInfo {
    fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let (mut state, mut quality) = (None, None);
        let (mut send_period_ms, mut receive_multiplier) = (None, None);
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => state = Some(field.i32()?.into()),
                2 => quality = Some(field.i32()?.into()),
                3 => send_period_ms = Some(field.u32()?),
                4 => receive_multiplier = Some(field.u32()?),
                _ => {}
            }
        }
        Ok(Self {
            state: required(state, "sessionState")?,
            quality: required(quality, "quality")?,
            send_period_ms,
            receive_multiplier,
        })
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        to.i32(1, self.state.code())?;
        to.i32(2, self.quality.code())?;
        self.send_period_ms.map_or(Ok(()), |it| to.u32(3, it))?;
        self.receive_multiplier.map_or(Ok(()), |it| to.u32(4, it))
    }
}

impl IpoData {
    fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let mut data = Self::default();
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => data.joints = read_array(&field, "ipo jointPosition")?,
                2 => data.pose = Some(Transformation::read(&field)?),
                3 => data.redundancy = Some(Redundancy::read(&field)?),
                10 => data.command_mode = Some(field.i32()?.into()),
                11 => data.overlay = Some(field.i32()?.into()),
                12 => data.tracking = Some(field.f64()?),
                _ => {}
            }
        }
        Ok(data)
    }

    fn write(&self, to: &mut Writer<'_>) -> Result<(), EncodeError> {
        write_joints(to, 1, self.joints.as_ref())?;
        write_transformation(to, 2, self.pose.as_ref())?;
        self.redundancy.map_or(Ok(()), |it| it.write(to, 3))?;
        self.command_mode
            .map_or(Ok(()), |it| to.i32(10, it.code()))?;
        self.overlay.map_or(Ok(()), |it| to.i32(11, it.code()))?;
        self.tracking.map_or(Ok(()), |it| to.f64(12, it))
    }
}

impl fmt::Display for Monitoring {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Header {
            sequence,
            reflected,
        } = self.header;
        write!(f, "MON seq {sequence} refl {reflected}")?;
        if let Some(connection) = &self.connection {
            write!(f, " {} {}", connection.state, connection.quality)?;
            let period = connection.send_period_ms;
            period.map_or(Ok(()), |ms| write!(f, " T {ms} ms"))?;
            let multiplier = connection.receive_multiplier;
            multiplier.map_or(Ok(()), |times| write!(f, " x{times}"))?;
        }
        if let Some(robot) = &self.robot {
            robot.safety.map_or(Ok(()), |it| write!(f, " {it}"))?;
            robot
                .operation_mode
                .map_or(Ok(()), |it| write!(f, " {it}"))?;
            robot.control_mode.map_or(Ok(()), |it| write!(f, " {it}"))?;
        }
        if let Some(ipo) = &self.ipo {
            ipo.command_mode
                .map_or(Ok(()), |it| write!(f, " wants {it}"))?;
        }
        self.measured()
            .map_or(Ok(()), |joints| write!(f, " q {} rad", ShowJoints(&joints)))
    }
}
