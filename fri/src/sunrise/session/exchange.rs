//! Inputs, outputs and frames that a robot program shares with its client. They carry no motion command.

use super::Session;
use crate::sunrise::wire::{
    CommandData, Dialect, IoDirection, IoType, IoValue, Name, Placement, TimeStamp, Transformation,
};

/// Value of an input or output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum IoLevel {
    /// Boolean.
    Boolean(bool),
    /// Unsigned integer.
    Digital(u64),
    /// Real number.
    Analog(f64),
}

/// Why an output was not written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum IoError {
    /// The last message does not list it.
    #[error(
        "the controller does not share it\nhint: add it to the FRI configuration of the robot program"
    )]
    NotListed,
    /// It is an input.
    #[error("it is an input for this client\nhint: let the robot program share it as output")]
    Input,
    /// It has another type.
    #[error(
        "it is of type {actual}, not {given}\nhint: write it as {actual}, or change the robot program"
    )]
    Type {
        /// Type on the controller.
        actual: IoType,
        /// Type of the value given.
        given: IoType,
    },
    /// It is of type digital, and the value is negative, too large or no number.
    #[error("it takes whole numbers from 0 to 2^53\nhint: limit the value in the net")]
    Range,
    /// All output slots are in use.
    #[error("more than 10 outputs")]
    Full,
}

/// Why a frame was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// No robot program requests it.
    #[error("not requested by the robot program")]
    NotRequested,
    /// The dialect of the controller requires the other form.
    #[error("{dialect} requires frames as {}", if *dialect == Dialect::V1 { "matrix" } else { "quaternion" })]
    Form {
        /// Dialect of the controller.
        dialect: Dialect,
    },
    /// All frame slots are in use.
    #[error("more than 5 frames")]
    Full,
}

impl IoLevel {
    fn kind(self) -> IoType {
        match self {
            Self::Boolean(_) => IoType::Boolean,
            Self::Digital(_) => IoType::Digital,
            Self::Analog(_) => IoType::Analog,
        }
    }

    /// The level in a message; `None` if the message has no value of the stated type.
    pub fn of(io: &IoValue) -> Option<Self> {
        match io.kind {
            IoType::Boolean => io.digital.map(|value| Self::Boolean(value != 0)),
            IoType::Digital => io.digital.map(Self::Digital),
            IoType::Analog => io.analog.map(Self::Analog),
            IoType::Other(_) => None,
        }
    }

    fn output(self, name: Name) -> IoValue {
        let (digital, analog) = match self {
            Self::Boolean(value) => (Some(u64::from(value)), None),
            Self::Digital(value) => (Some(value), None),
            Self::Analog(value) => (None, Some(value)),
        };
        IoValue {
            name,
            kind: self.kind(),
            direction: IoDirection::Output,
            digital,
            analog,
        }
    }
}

/// The nearest whole number, up to the largest below which every whole number is an f64.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "within 0 and 2^53"
)]
fn whole(value: f64) -> Option<u64> {
    const MAX: f64 = 9_007_199_254_740_992.0;
    let rounded = value.round();
    (0.0..=MAX).contains(&rounded).then_some(rounded as u64)
}

impl Session {
    fn listed(&self, name: &[u8]) -> Option<&IoValue> {
        let data = self.message.monitor.as_ref()?;
        data.ios.iter().find(|io| io.name.as_bytes() == name)
    }

    /// Value of an input or output in the newest message.
    pub fn read(&self, name: &str) -> Option<IoLevel> {
        self.listed(name.as_bytes()).and_then(IoLevel::of)
    }

    /// Writes an output with every answer from now on, while the controller lists it.
    pub fn write(&mut self, name: &str, level: IoLevel) -> Result<(), IoError> {
        let io = self.listed(name.as_bytes()).ok_or(IoError::NotListed)?;
        let given = level.kind();
        if io.direction != IoDirection::Output {
            return Err(IoError::Input);
        }
        if io.kind != given {
            let actual = io.kind;
            return Err(IoError::Type { actual, given });
        }
        let output = level.output(io.name);
        if let Some(known) = self
            .outputs
            .iter_mut()
            .find(|known| known.name == output.name)
        {
            *known = output;
            return Ok(());
        }
        self.outputs.push(output).map_err(|_| IoError::Full)
    }

    /// Writes a number to an output, as [`write`](Self::write) does: to a digital one the nearest whole number.
    pub fn write_number(&mut self, name: &str, value: f64) -> Result<(), IoError> {
        let is_digital = self
            .listed(name.as_bytes())
            .is_some_and(|io| io.kind == IoType::Digital);
        let level = if is_digital {
            IoLevel::Digital(whole(value).ok_or(IoError::Range)?)
        } else {
            IoLevel::Analog(value)
        };
        self.write(name, level)
    }

    /// Sends a requested frame with every answer from now on, while the robot program requests it.
    pub fn send_frame(
        &mut self,
        name: &str,
        placement: Placement,
        stamp: Option<TimeStamp>,
    ) -> Result<(), FrameError> {
        let requested = self.message.requested.iter().find(|it| it.name.is(name));
        let name = requested.ok_or(FrameError::NotRequested)?.name;
        let is_matrix = match placement {
            Placement::Matrix(_) => true,
            Placement::Quaternion(_) => false,
        };
        if let Some(dialect) = self.dialect.filter(|it| (*it == Dialect::V1) != is_matrix) {
            return Err(FrameError::Form { dialect });
        }
        let frame = Transformation {
            name,
            placement: Some(placement),
            stamp,
        };
        if let Some(known) = self.frames.iter_mut().find(|known| known.name == name) {
            *known = frame;
            return Ok(());
        }
        self.frames.push(frame).map_err(|_| FrameError::Full)
    }

    /// Adds the frames and outputs of the newest message to an answer.
    pub(super) fn exchange(&self, data: &mut CommandData) {
        for output in self.outputs.iter() {
            let io = self.listed(output.name.as_bytes());
            let fits =
                |io: &&IoValue| io.direction == IoDirection::Output && io.kind == output.kind;
            if io.filter(fits).is_some() {
                let _full = data.ios.push(*output);
            }
        }
        for frame in self.frames.iter() {
            let mut requested = self.message.requested.iter();
            if requested.any(|it| it.name == frame.name) {
                let _full = data.transformations.push(*frame);
            }
        }
    }
}
