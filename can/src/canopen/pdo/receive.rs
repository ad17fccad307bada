//! A PDO that a device receives: when its values count, and whether it is late. It looks at no
//! identifiers but its own.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Dictionary, Mapping};

use super::parameters::mapping;
use super::{Direction, Parameters, Transmission};
use crate::Id;

/// What became of a received PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// Its values are in the dictionary.
    Taken,
    /// Its values count with the next SYNC.
    Waits,
    /// It came outside of the SYNC window and was dropped.
    OutsideWindow,
    /// It is too short and was dropped.
    Short {
        /// Bytes that came.
        len: usize,
        /// Bytes that are mapped.
        expected: usize,
    },
}

/// A PDO to receive.
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
    /// Zero is none.
    deadline: Duration,
    data: [u8; 8],
    waits: bool,
    /// What waited is in the dictionary, and nobody was told.
    applied: bool,
    heard: Option<Duration>,
    late: bool,
}

impl Rpdo {
    /// The PDO of that number (from 0) in a dictionary; `None` if there is none.
    ///
    /// # Errors
    /// If its mapping is none.
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
            heard: None,
            late: false,
        }))
    }

    /// Its identifier, if it exists.
    #[must_use]
    pub const fn id(&self) -> Option<Id> {
        self.id
    }

    /// What it carries.
    #[must_use]
    pub const fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// Whether it came late and has not come again.
    #[must_use]
    pub const fn is_late(&self) -> bool {
        self.late
    }

    /// Whether more bytes came than are mapped: the rest is dropped, and an emergency is due.
    #[must_use]
    pub const fn is_long(&self, len: usize) -> bool {
        len > self.mapping.len()
    }

    /// Takes its frame. `window`: synchronous PDOs count now.
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
        (self.heard, self.late) = (Some(now), false);
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

    /// SYNC: what waits goes into the dictionary. Returns whether something did.
    pub fn handle_sync(&mut self, dictionary: &mut Dictionary) -> bool {
        let waited = std::mem::take(&mut self.waits);
        if waited {
            self.mapping.unpack(dictionary, &self.data);
        }
        self.applied |= waited;
        waited
    }

    /// Whether a SYNC put new values into the dictionary since this was asked last.
    pub(in crate::canopen) const fn take_applied(&mut self) -> bool {
        std::mem::replace(&mut self.applied, false)
    }

    /// Whether it has just become late; told once.
    pub fn poll(&mut self, now: Duration) -> bool {
        let late = self.poll_timeout().is_some_and(|due| now >= due);
        self.late |= late;
        late
    }

    /// When it becomes late.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Duration> {
        let watched = self.id.is_some() && !self.deadline.is_zero() && !self.late;
        self.heard
            .filter(|_| watched)
            .map(|heard| heard + self.deadline)
    }

    /// Drops what waits; supervision begins with the next frame. As leaving Operational does.
    pub const fn stop(&mut self) {
        (self.waits, self.heard, self.late) = (false, None, false);
    }
}
