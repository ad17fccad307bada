//! The messages nested in both datagrams: joint values, vectors, frames, inputs and outputs.

use super::bounded::Name;
use super::codes::{IoDirection, IoType, RedundancyStrategy};
use super::proto::{Field, Reader, Writer};
use crate::error::{DecodeError, EncodeError};
use crate::sunrise::AXES;

/// Numbers of all axes.
pub type Joints = [f64; AXES];

/// Collects exactly `N` doubles from fields of one tag, packed or not; an empty message counts as missing.
struct Collector<const N: usize> {
    values: [f64; N],
    len: usize,
    field: &'static str,
}

impl<const N: usize> Collector<N> {
    fn new(field: &'static str) -> Self {
        Self {
            values: [0.0; N],
            len: 0,
            field,
        }
    }

    fn take(&mut self, field: &Field<'_>) -> Result<(), DecodeError> {
        field.f64s(|value| self.push(value))
    }

    fn push(&mut self, value: f64) -> Result<(), DecodeError> {
        let too_many = DecodeError::TooMany {
            field: self.field,
            max: N,
        };
        *self.values.get_mut(self.len).ok_or(too_many)? = value;
        self.len += 1;
        Ok(())
    }

    fn finish(self) -> Result<Option<[f64; N]>, DecodeError> {
        match self.len {
            0 => Ok(None),
            len if len == N => Ok(Some(self.values)),
            actual => Err(DecodeError::Count {
                field: self.field,
                expected: N,
                actual,
            }),
        }
    }
}

/// `JointValues` and `CartesianVector`: `repeated double = 1`.
pub(super) fn read_array<const N: usize>(
    field: &Field<'_>,
    name: &'static str,
) -> Result<Option<[f64; N]>, DecodeError> {
    let mut from = field.message()?;
    let mut values = Collector::new(name);
    loop {
        while let Some(value) = from.double() {
            values.push(value)?;
        }
        let Some(field) = from.next()? else {
            return values.finish();
        };
        if field.tag == 1 {
            values.take(&field)?;
        }
    }
}

pub(super) fn write_joints(
    to: &mut Writer<'_>,
    tag: u32,
    joints: Option<&Joints>,
) -> Result<(), EncodeError> {
    joints.map_or(Ok(()), |joints| to.nested(tag, |to| to.unpacked(1, joints)))
}

pub(super) fn write_vector(
    to: &mut Writer<'_>,
    tag: u32,
    vector: Option<&[f64; 6]>,
) -> Result<(), EncodeError> {
    vector.map_or(Ok(()), |vector| to.nested(tag, |to| to.packed(1, vector)))
}

pub(super) fn required<T>(value: Option<T>, field: &'static str) -> Result<T, DecodeError> {
    value.ok_or(DecodeError::Missing { field })
}

/// `MessageHeader` without its message identifier, which is a constant of each message.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required uint32 | messageIdentifier |
/// | 2 | required uint32 | sequenceCounter |
/// | 3 | required uint32 | reflectedSequenceCounter |
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Header {
    /// The sender's own counter, +1 per datagram.
    #[doc(alias = "sequenceCounter")]
    pub sequence: u32,
    /// Counter of the last datagram that the sender received; in a command, of the one it answers.
    #[doc(alias = "reflectedSequenceCounter")]
    pub reflected: u32,
}

impl Header {
    pub(super) fn read(field: &Field<'_>, expected: u32) -> Result<Self, DecodeError> {
        let (mut id, mut sequence, mut reflected) = (None, None, None);
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => id = Some(field.u32()?),
                2 => sequence = Some(field.u32()?),
                3 => reflected = Some(field.u32()?),
                _ => {}
            }
        }
        let actual = required(id, "messageIdentifier")?;
        if actual != expected {
            return Err(DecodeError::MessageId { expected, actual });
        }
        Ok(Self {
            sequence: required(sequence, "sequenceCounter")?,
            reflected: required(reflected, "reflectedSequenceCounter")?,
        })
    }

    pub(super) fn write(self, to: &mut Writer<'_>, id: u32) -> Result<(), EncodeError> {
        to.nested(1, |to| {
            to.u32(1, id)?;
            to.u32(2, self.sequence)?;
            to.u32(3, self.reflected)
        })
    }
}

/// `TimeStamp`: required uint32 sec = 1, required uint32 nanosec = 2.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TimeStamp {
    /// Seconds since 1970.
    pub seconds: u32,
    /// Nanoseconds in that second.
    pub nanoseconds: u32,
}

impl TimeStamp {
    pub(super) fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let (mut seconds, mut nanoseconds) = (None, None);
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => seconds = Some(field.u32()?),
                2 => nanoseconds = Some(field.u32()?),
                _ => {}
            }
        }
        Ok(Self {
            seconds: required(seconds, "TimeStamp.sec")?,
            nanoseconds: required(nanoseconds, "TimeStamp.nanosec")?,
        })
    }

    pub(super) fn write(self, to: &mut Writer<'_>, tag: u32) -> Result<(), EncodeError> {
        to.nested(tag, |to| {
            to.u32(1, self.seconds)?;
            to.u32(2, self.nanoseconds)
        })
    }
}

/// Pose of a frame: the form depends on the generation of the SDK.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Placement {
    /// 1.x: 3x4 row-major; translation at indices 3, 7, 11 in mm.
    Matrix([f64; 12]),
    /// 2.x: translation x, y, z in mm, then the quaternion w, x, y, z.
    Quaternion([f64; 7]),
}

/// `Transformation` of 1.x and `QuaternionTransformation` of 2.x, distinguished by the number of elements.
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required string, 63 bytes | name |
/// | 2 | repeated double, 12 or 7 | matrix or element |
/// | 3 | optional [`TimeStamp`] | timestamp |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Transformation {
    /// Name of the frame in the robot program.
    pub name: Name,
    /// Pose; missing in a request.
    pub placement: Option<Placement>,
    /// Time of the pose.
    pub stamp: Option<TimeStamp>,
}

impl Transformation {
    pub(super) fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let (mut name, mut stamp) = (None, None);
        let mut values = Collector::<12>::new("Transformation.element");
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => name = Some(read_name(&field, "Transformation.name")?),
                2 => values.take(&field)?,
                3 => stamp = Some(TimeStamp::read(&field)?),
                _ => {}
            }
        }
        let placement = match (values.len, values.values) {
            (7, [x, y, z, w, i, j, k, ..]) => Some(Placement::Quaternion([x, y, z, w, i, j, k])),
            _ => values.finish()?.map(Placement::Matrix),
        };
        Ok(Self {
            name: required(name, "Transformation.name")?,
            placement,
            stamp,
        })
    }

    pub(super) fn write(&self, to: &mut Writer<'_>, tag: u32) -> Result<(), EncodeError> {
        to.nested(tag, |to| {
            to.bytes(1, self.name.as_bytes())?;
            match &self.placement {
                Some(Placement::Matrix(matrix)) => to.packed(2, matrix)?,
                Some(Placement::Quaternion(element)) => to.packed(2, element)?,
                None => {}
            }
            self.stamp.map_or(Ok(()), |stamp| stamp.write(to, 3))
        })
    }
}

fn read_name(field: &Field<'_>, what: &'static str) -> Result<Name, DecodeError> {
    Name::read(
        field.message().map(|reader: Reader<'_>| reader.bytes())?,
        what,
    )
}

/// `RedundancyInformation` (2.x): required enum strategy = 1, required double value = 2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Redundancy {
    /// What determines the redundant axis.
    pub strategy: RedundancyStrategy,
    /// Its value; for E1 rad.
    pub value: f64,
}

impl Redundancy {
    pub(super) fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let (mut strategy, mut value) = (None, None);
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => strategy = Some(field.i32()?.into()),
                2 => value = Some(field.f64()?),
                _ => {}
            }
        }
        Ok(Self {
            strategy: required(strategy, "RedundancyInformation.strategy")?,
            value: required(value, "RedundancyInformation.value")?,
        })
    }

    pub(super) fn write(self, to: &mut Writer<'_>, tag: u32) -> Result<(), EncodeError> {
        to.nested(tag, |to| {
            to.i32(1, self.strategy.code())?;
            to.f64(2, self.value)
        })
    }
}

/// `FriIOValue` (from 1.14).
///
/// | tag | type | field |
/// |--:|---|---|
/// | 1 | required string, 63 bytes | name, `Group.Name` |
/// | 2 | required enum | type |
/// | 3 | required enum | direction |
/// | 4 | optional uint64 | digitalValue, also of booleans |
/// | 5 | optional double | analogValue |
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct IoValue {
    /// `Group.Name` as in the I/O configuration.
    pub name: Name,
    /// Type of the value.
    pub kind: IoType,
    /// Whether the client may write it.
    pub direction: IoDirection,
    /// Value of a boolean (0, 1) or of an integer.
    pub digital: Option<u64>,
    /// Value of a real number.
    pub analog: Option<f64>,
}

impl IoValue {
    pub(super) fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let (mut name, mut kind, mut direction) = (None, None, None);
        let (mut digital, mut analog) = (None, None);
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => name = Some(read_name(&field, "FriIOValue.name")?),
                2 => kind = Some(field.i32()?.into()),
                3 => direction = Some(field.i32()?.into()),
                4 => digital = Some(field.u64()?),
                5 => analog = Some(field.f64()?),
                _ => {}
            }
        }
        Ok(Self {
            name: required(name, "FriIOValue.name")?,
            kind: required(kind, "FriIOValue.type")?,
            direction: required(direction, "FriIOValue.direction")?,
            digital,
            analog,
        })
    }

    pub(super) fn write(&self, to: &mut Writer<'_>, tag: u32) -> Result<(), EncodeError> {
        to.nested(tag, |to| {
            to.bytes(1, self.name.as_bytes())?;
            to.i32(2, self.kind.code())?;
            to.i32(3, self.direction.code())?;
            self.digital.map_or(Ok(()), |value| to.u64(4, value))?;
            self.analog.map_or(Ok(()), |value| to.f64(5, value))
        })
    }
}

/// `MessageEndOf` (until 2.5): optional int32 messageLength = 1, optional `Checksum` { optional int32 crc32 = 1 } = 2.
/// Controllers and SDKs leave it empty or omit it; Takt does not send it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EndOf {
    /// Length of the message, bytes.
    pub length: Option<i32>,
    /// Checksum.
    pub crc32: Option<i32>,
}

impl EndOf {
    pub(super) fn read(field: &Field<'_>) -> Result<Self, DecodeError> {
        let mut end = Self::default();
        let mut from = field.message()?;
        while let Some(field) = from.next()? {
            match field.tag {
                1 => end.length = Some(field.i32()?),
                2 => end.crc32 = read_checksum(&field)?,
                _ => {}
            }
        }
        Ok(end)
    }

    pub(super) fn write(self, to: &mut Writer<'_>, tag: u32) -> Result<(), EncodeError> {
        to.nested(tag, |to| {
            self.length.map_or(Ok(()), |length| to.i32(1, length))?;
            let crc32 = |crc32| to.nested(2, |to| to.i32(1, crc32));
            self.crc32.map_or(Ok(()), crc32)
        })
    }
}

fn read_checksum(field: &Field<'_>) -> Result<Option<i32>, DecodeError> {
    let mut from = field.message()?;
    let mut crc32 = None;
    while let Some(field) = from.next()? {
        if field.tag == 1 {
            crc32 = Some(field.i32()?);
        }
    }
    Ok(crc32)
}
