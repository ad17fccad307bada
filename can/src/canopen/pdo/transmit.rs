//! TPDO of a device: SYNC, events, inhibit time and event timer. Every change of its content is an
//! event; profile-specific events are not supported.

use std::time::Duration;

use takt_cia402::dictionary::{AbortCode, Dictionary, Mapping};

use super::parameters::mapping;
use super::{Direction, Parameters, Transmission};
use crate::canopen::message::frame;
use crate::{Frame, Id};

/// A transmit PDO.
///
/// | type | sampled | sent |
/// |---|---|---|
/// | 0 | with SYNC | with the SYNC after a change or [`Tpdo::trigger`] |
/// | 1 to 240 | with SYNC | with every n-th, from the SYNC start value on |
/// | 252 | with SYNC | on a remote frame |
/// | 253 | on a remote frame | on a remote frame |
/// | 254, 255 | when sent | on a change, [`Tpdo::trigger`] or the event timer, after the inhibit time |
#[derive(Clone, Debug)]
pub struct Tpdo {
    id: Option<Id>,
    remote: bool,
    transmission: Transmission,
    mapping: Mapping,
    inhibit: Duration,
    /// Zero: none.
    event: Duration,
    sync_start: u8,
    /// SYNCs since the last transmission.
    syncs: u8,
    /// The SYNC start value was seen, or is not required.
    begun: bool,
    triggered: bool,
    sent: Option<Duration>,
    last: Option<[u8; 8]>,
}

impl Tpdo {
    /// The PDO with that number (from 0) in a dictionary; `None` if it does not exist.
    pub fn new(dictionary: &Dictionary, number: u16) -> Result<Option<Self>, AbortCode> {
        let direction = Direction::Transmit;
        let Some(parameters) = Parameters::communication(dictionary, direction, number) else {
            return Ok(None);
        };
        let mapping = mapping(dictionary, direction, number)?;
        let mut tpdo = Self {
            id: parameters.cob.id(),
            remote: parameters.cob.allows_remote(),
            transmission: parameters.transmission,
            mapping,
            inhibit: Duration::from_micros(100) * parameters.inhibit.into(),
            event: Duration::from_millis(parameters.event.into()),
            sync_start: parameters.sync_start,
            syncs: 0,
            begun: false,
            triggered: false,
            sent: None,
            last: None,
        };
        tpdo.start();
        Ok(Some(tpdo))
    }

    /// Its identifier, if enabled.
    pub const fn id(&self) -> Option<Id> {
        self.id
    }

    /// Its mapping.
    pub const fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// Restarts, for entering Operational: event-driven PDOs are due at once.
    pub const fn start(&mut self) {
        self.syncs = 0;
        self.begun = self.sync_start == 0;
        self.triggered = true;
        (self.sent, self.last) = (None, None);
    }

    /// Triggers its transmission.
    pub const fn trigger(&mut self) {
        self.triggered = true;
    }

    /// Handles SYNC with its counter; returns the frame to send, if any.
    pub(crate) fn handle_sync(
        &mut self,
        counter: Option<u8>,
        dictionary: &Dictionary,
        now: Duration,
    ) -> Option<Frame> {
        match self.transmission {
            Transmission::SyncAcyclic => {
                let due = self.triggered || self.is_changed(dictionary);
                due.then(|| self.send(dictionary, now))?
            }
            Transmission::Sync(every) => {
                if !self.begun {
                    // Without a counter the start value is ignored.
                    self.begun = counter.is_none_or(|counter| counter == self.sync_start);
                    self.syncs = every - 1;
                }
                if !self.begun {
                    return None;
                }
                self.syncs += 1;
                if self.syncs < every {
                    return None;
                }
                self.syncs = 0;
                self.send(dictionary, now)
            }
            Transmission::RemoteSync => {
                self.last = Some(self.pack(dictionary));
                None
            }
            Transmission::Remote
            | Transmission::EventManufacturer
            | Transmission::EventProfile
            | Transmission::Reserved(_) => None,
        }
    }

    /// Handles a remote frame.
    pub(crate) fn handle_remote(
        &mut self,
        dictionary: &Dictionary,
        now: Duration,
    ) -> Option<Frame> {
        if !self.remote {
            return None;
        }
        match (self.transmission, self.last) {
            (Transmission::RemoteSync, Some(data)) => self.frame(&data),
            _ => self.send(dictionary, now),
        }
    }

    /// The frame to send now without a SYNC, if any.
    pub fn poll(&mut self, dictionary: &Dictionary, now: Duration) -> Option<Frame> {
        if self.id.is_none() || !self.transmission.is_event_driven() {
            return None;
        }
        let inhibited = self.sent.is_some_and(|sent| now < sent + self.inhibit);
        let timer = self.timer().is_some_and(|due| now >= due);
        let due = timer || self.triggered || self.is_changed(dictionary);
        (due && !inhibited).then(|| self.send(dictionary, now))?
    }

    fn timer(&self) -> Option<Duration> {
        let sent = self.sent.filter(|_| !self.event.is_zero())?;
        Some(sent + self.event)
    }

    /// Time of the next poll, apart from changes in the dictionary.
    pub fn poll_timeout(&self, dictionary: &Dictionary) -> Option<Duration> {
        if self.id.is_none() || !self.transmission.is_event_driven() {
            return None;
        }
        if self.triggered || self.is_changed(dictionary) {
            return Some(self.sent.map_or(Duration::ZERO, |sent| sent + self.inhibit));
        }
        self.timer()
    }

    fn is_changed(&self, dictionary: &Dictionary) -> bool {
        self.last != Some(self.pack(dictionary))
    }

    fn pack(&self, dictionary: &Dictionary) -> [u8; 8] {
        let mut data = [0; 8];
        self.mapping.pack(dictionary, &mut data);
        data
    }

    fn send(&mut self, dictionary: &Dictionary, now: Duration) -> Option<Frame> {
        let data = self.pack(dictionary);
        self.triggered = false;
        (self.sent, self.last) = (Some(now), Some(data));
        self.frame(&data)
    }

    /// A PDO without mapped entries is never sent.
    fn frame(&self, data: &[u8; 8]) -> Option<Frame> {
        let data = data
            .get(..self.mapping.len())
            .filter(|data| !data.is_empty())?;
        self.id.map(|id| frame(id, data))
    }
}
