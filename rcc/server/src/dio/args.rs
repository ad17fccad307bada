//! The values of a command, read by position and type.

use std::collections::BTreeMap;
use std::time::Duration;

use takt_client::wire::Value;

use super::error::CommandError;
use super::limits::DESCRIPTION_BYTES_MAX;
use super::pace::Pace;

/// The values of a command; excess ones are ignored.
#[derive(Clone, Copy)]
pub(super) struct Args<'a>(pub(super) &'a [Value]);

impl<'a> Args<'a> {
    pub(super) fn get(self, number: usize) -> Result<&'a Value, CommandError> {
        self.0.get(number).ok_or(CommandError::ParameterMissing)
    }

    pub(super) fn optional<T>(
        self,
        number: usize,
        get: impl FnOnce(Self, usize) -> Result<T, CommandError>,
    ) -> Result<Option<T>, CommandError> {
        (number < self.0.len())
            .then(|| get(self, number))
            .transpose()
    }

    pub(super) fn text(self, number: usize) -> Result<&'a str, CommandError> {
        self.get(number)?
            .as_str()
            .ok_or(CommandError::ParameterType)
    }

    pub(super) fn description(self, number: usize) -> Result<&'a str, CommandError> {
        let text = self.text(number)?;
        if text.len() <= DESCRIPTION_BYTES_MAX {
            Ok(text)
        } else {
            Err(CommandError::DescriptionTooLong { bytes: text.len() })
        }
    }

    /// The pace of a subscription, by default the one for the known client.
    pub(super) fn pace(self, number: usize) -> Result<Pace, CommandError> {
        match self.optional(number, Args::text)? {
            None => Ok(Pace::default()),
            Some(word) => Pace::of_word(word).ok_or(CommandError::Pace),
        }
    }

    pub(super) fn map(self, number: usize) -> Result<&'a BTreeMap<String, Value>, CommandError> {
        self.get(number)?
            .as_map()
            .ok_or(CommandError::ParameterType)
    }

    pub(super) fn list(self, number: usize) -> Result<&'a [Value], CommandError> {
        self.get(number)?
            .as_list()
            .ok_or(CommandError::ParameterType)
    }

    pub(super) fn integer(self, number: usize) -> Result<u32, CommandError> {
        if let Value::Integer(n) = self.get(number)? {
            Ok(*n)
        } else {
            Err(CommandError::ParameterType)
        }
    }

    pub(super) fn float(self, number: usize) -> Result<f64, CommandError> {
        if let Value::Float(n) = self.get(number)? {
            Ok(*n)
        } else {
            Err(CommandError::ParameterType)
        }
    }

    /// A time in seconds; must be a float.
    pub(super) fn seconds(self, number: usize) -> Result<Duration, CommandError> {
        let seconds = self.float(number)?;
        Ok(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX))
    }
}
