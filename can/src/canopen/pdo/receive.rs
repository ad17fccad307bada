//! RPDO of a device: when its values take effect, and whether it missed its deadline.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Dictionary, Mapping};

use super::parameters::mapping;
use super::{Direction, Parameters, Transmission};
use crate::Id;

/// Result of a received PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// Its values were written to the dictionary.
    Taken,
    /// Its values take effect with the next SYNC.
    Waits,
    /// It was received outside of the SYNC window and dropped.
    OutsideWindow,
    /// It was too short and dropped.
    Short {
        /// Received bytes.
        len: usize,
        /// Mapped bytes.
        expected: usize,
    },
}

/// A receive PDO.
///
/// ```text
///              1 frame (synchronous type)
///       empty ----------------------------> waiting --+ 2 newer frame
///         ^                                  |   ^----+
///         +------- 3 SYNC: into dictionary --+
/// ```
#[derive(Clone, Debug)]
pub struct Rpdo {
    id: Option<Id>,
    transmission: Transmission,
    mapping: Mapping,
    /// Zero: no deadline.
    deadline: Duration,
    data: [u8; 8],
    waits: bool,
    /// Waiting values were written to the dictionary but not yet reported.
    applied: bool,
    last_received: Option<Duration>,
    late: bool,
}

impl Rpdo {
    /// The PDO with that number (from 0) in a dictionary; `None` if it does not exist.
    pub fn new(dictionary: &Dictionary, number: u16) -> Result<Option<Self>, AbortCode> {
        let direction = Direction::Receive;
        let Some(parameters) = Parameters::communication(dictionary, direction, number) else {
            return Ok(None);
        };
        let mapping = mapping(dictionary, direction, number)?;
        Ok(Some(Self {
            id: parameters.cob.id(),
            transmission: parameters.transmission,
            mapping,
            deadline: Duration::from_millis(parameters.event.into()),
            data: [0; 8],
            waits: false,
            applied: false,
            last_received: None,
            late: false,
        }))
    }

    /// Its identifier, if enabled.
    pub const fn id(&self) -> Option<Id> {
        self.id
    }

    /// Its mapping.
    pub const fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// Whether it missed its deadline and was not received since.
    pub const fn is_late(&self) -> bool {
        self.late
    }

    /// Whether it has more bytes than mapped: the excess is dropped and an EMCY is due.
    pub const fn is_long(&self, len: usize) -> bool {
        len > self.mapping.len()
    }

    /// Handles its frame. `window`: the SYNC window is open.
    pub fn handle(
        &mut self,
        data: &[u8],
        dictionary: &mut Dictionary,
        window: bool,
        now: Duration,
    ) -> Received {
        let expected = self.mapping.len();
        if data.len() < expected {
            let len = data.len();
            return Received::Short { len, expected };
        }
        (self.last_received, self.late) = (Some(now), false);
        if !self.transmission.is_synchronous() {
            self.mapping.unpack(dictionary, data);
            return Received::Taken;
        }
        if !window {
            return Received::OutsideWindow;
        }
        self.data
            .iter_mut()
            .zip(data)
            .for_each(|(to, from)| *to = *from);
        self.waits = true;
        Received::Waits
    }

    /// SYNC: writes waiting values to the dictionary. Returns whether there were any.
    pub(crate) fn handle_sync(&mut self, dictionary: &mut Dictionary) -> bool {
        let waited = std::mem::take(&mut self.waits);
        if waited {
            self.mapping.unpack(dictionary, &self.data);
        }
        self.applied |= waited;
        waited
    }

    /// Whether a SYNC wrote new values to the dictionary since the last call.
    pub(in crate::canopen) const fn take_applied(&mut self) -> bool {
        std::mem::replace(&mut self.applied, false)
    }

    /// Whether it has just missed its deadline; returned once.
    pub fn poll(&mut self, now: Duration) -> bool {
        let late = self.poll_timeout().is_some_and(|due| now >= due);
        self.late |= late;
        late
    }

    /// Its deadline.
    pub fn poll_timeout(&self) -> Option<Duration> {
        let watched = self.id.is_some() && !self.deadline.is_zero() && !self.late;
        self.last_received
            .filter(|_| watched)
            .map(|last_received| last_received + self.deadline)
    }

    /// Drops waiting values; monitoring restarts with the next frame. For leaving Operational.
    pub const fn stop(&mut self) {
        (self.waits, self.last_received, self.late) = (false, None, false);
    }
}
