//! Emergency producer (CiA 301, clause 7.2.7): reports each error of a device once, limited by the
//! inhibit time. The reaction of the device to an error is not part of it.

use std::time::Duration;

use super::Emergency;

/// Maximum number of active errors; a further one replaces the oldest.
pub(crate) const ERRORS_MAX: usize = 8;
/// Length of the queue for the inhibit time; further emergencies are counted and dropped.
pub const QUEUE_MAX: usize = 8;

/// Communication errors of CiA 301 that a node detects.
pub mod code {
    /// A heartbeat or the life guarding was lost.
    pub const HEARTBEAT: u16 = 0x8130;
    /// A PDO was shorter than its mapping and was dropped.
    pub(crate) const PDO_SHORT: u16 = 0x8210;
    /// A PDO was longer than its mapping; the excess was dropped.
    pub(crate) const PDO_LONG: u16 = 0x8220;
    /// A SYNC had an unexpected length.
    pub(crate) const SYNC_LENGTH: u16 = 0x8240;
    /// An RPDO missed its deadline.
    pub(crate) const RPDO_TIMEOUT: u16 = 0x8250;
}

/// Bits of the error register 1001h.
pub mod register {
    /// Generic error.
    pub(crate) const GENERIC: u8 = 0x01;
    /// Communication error.
    pub(crate) const COMMUNICATION: u8 = 0x10;
}

/// Source of an error. Several sources may report the same error; it ends when all have cleared it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The CANopen node: heartbeats, PDOs, SYNC.
    Communication,
    /// The device, by number: an axis of a drive.
    Device(u8),
    /// The node itself, by a quirk: a manufacturer's emergency that only a reset clears.
    Node,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Present {
    source: Source,
    code: u16,
    register: u8,
}

#[derive(Clone, Copy, Debug)]
struct Queued {
    emergency: Emergency,
    logged: bool,
}

/// The emergency producer of a device.
///
/// ```text
/// error free --- raise: EMCY code ---> error <--+ raise, clear with others left: EMCY
///     ^                                  |  ----+
///     +---- clear of the last: EMCY 0 ---+
/// ```
#[derive(Clone, Debug, Default)]
pub struct Producer {
    errors: [Option<Present>; ERRORS_MAX],
    queue: [Option<Queued>; QUEUE_MAX],
    inhibit: Duration,
    sent: Option<Duration>,
    dropped: u32,
}

impl Producer {
    /// Sets the inhibit time, 1015h.
    pub(crate) const fn set_inhibit(&mut self, inhibit: Duration) {
        self.inhibit = inhibit;
    }

    /// The error register 1001h.
    pub fn register(&self) -> u8 {
        self.errors.iter().flatten().fold(0, |register, error| {
            register | error.register | register::GENERIC
        })
    }

    /// Emergencies dropped because the queue was full.
    pub const fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Raises an error. An EMCY is sent unless the error is already active.
    pub fn raise(&mut self, source: Source, code: u16, register: u8, data: [u8; 5]) {
        let known = self.errors.iter().flatten().any(|error| error.code == code);
        let error = Present {
            source,
            code,
            register,
        };
        if self.errors.contains(&Some(error)) {
            return;
        }
        if self.errors.iter().all(Option::is_some) {
            self.errors.rotate_left(1);
            self.errors[ERRORS_MAX - 1] = None;
        }
        if let Some(slot) = self.errors.iter_mut().find(|slot| slot.is_none()) {
            *slot = Some(error);
        }
        if !known {
            self.enqueue(code, data);
        }
    }

    /// Clears an error. Sends "no error" with the register of the remaining errors.
    pub fn clear(&mut self, source: Source, code: u16) {
        let mut found = false;
        for slot in &mut self.errors {
            if slot.is_some_and(|error| (error.source, error.code) == (source, code)) {
                (*slot, found) = (None, true);
            }
        }
        let left = self.errors.iter().flatten().any(|error| error.code == code);
        if found && !left {
            self.enqueue(0, [0; 5]);
        }
    }

    /// Clears all errors of a source.
    pub(crate) fn clear_all(&mut self, source: Source) {
        for at in 0..ERRORS_MAX {
            if let Some(error) = self.errors[at].filter(|error| error.source == source) {
                self.clear(source, error.code);
            }
        }
    }

    /// Discards all state without sending, as a reset does.
    pub fn reset(&mut self) {
        *self = Self {
            inhibit: self.inhibit,
            ..Self::default()
        };
    }

    fn enqueue(&mut self, code: u16, data: [u8; 5]) {
        let emergency = Emergency {
            code,
            register: self.register(),
            data,
        };
        match self.queue.iter_mut().find(|slot| slot.is_none()) {
            Some(slot) => {
                *slot = Some(Queued {
                    emergency,
                    logged: false,
                });
            }
            None => self.dropped = self.dropped.saturating_add(1),
        }
    }

    /// The next code to append to the history 1003h.
    pub(crate) fn poll_log(&mut self) -> Option<Emergency> {
        let new = |queued: &&mut Queued| !queued.logged && queued.emergency.code != 0;
        let queued = self.queue.iter_mut().flatten().find(new)?;
        queued.logged = true;
        Some(queued.emergency)
    }

    /// The next emergency to send.
    pub fn poll(&mut self, now: Duration) -> Option<Emergency> {
        if self.poll_timeout()? > now {
            return None;
        }
        let first = self.queue[0].take()?;
        self.queue.rotate_left(1);
        self.sent = Some(now);
        Some(first.emergency)
    }

    /// When an emergency is due.
    pub fn poll_timeout(&self) -> Option<Duration> {
        self.queue[0]?;
        Some(self.sent.map_or(Duration::ZERO, |sent| sent + self.inhibit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);
    const COMMUNICATION: Source = Source::Communication;
    const AXIS: Source = Source::Device(0);

    fn codes(producer: &mut Producer, now: Duration) -> Vec<(u16, u8)> {
        std::iter::from_fn(|| producer.poll(now))
            .map(|emergency| (emergency.code, emergency.register))
            .collect()
    }

    #[test]
    fn emcy_error_and_its_end_are_sent_once() {
        let mut producer = Producer::default();
        producer.raise(AXIS, 0x8611, 0x21, [0; 5]);
        producer.raise(AXIS, 0x8611, 0x21, [0; 5]);
        producer.raise(COMMUNICATION, 0x8130, 0x11, [0; 5]);
        assert_eq!(codes(&mut producer, MS), [(0x8611, 0x21), (0x8130, 0x31)]);
        producer.clear(AXIS, 0x8611);
        producer.clear(AXIS, 0x8611);
        producer.clear(COMMUNICATION, 0x8130);
        assert_eq!(codes(&mut producer, MS), [(0, 0x11), (0, 0)]);
        assert_eq!(producer.register(), 0);
    }

    #[test]
    fn emcy_error_of_two_sources_ends_with_both() {
        let mut producer = Producer::default();
        producer.raise(COMMUNICATION, 0x8130, 0x11, [0; 5]);
        producer.raise(AXIS, 0x8130, 0x11, [0; 5]);
        producer.clear(COMMUNICATION, 0x8130);
        assert_eq!(codes(&mut producer, MS), [(0x8130, 0x11)]);
        producer.clear_all(AXIS);
        assert_eq!(codes(&mut producer, MS), [(0, 0)]);
    }

    #[test]
    fn emcy_inhibit_time_spaces_messages_queue_is_bounded() {
        let mut producer = Producer::default();
        producer.set_inhibit(10 * MS);
        for code in 1..=20 {
            producer.raise(AXIS, code, 1, [0; 5]);
        }
        assert_eq!(producer.dropped(), 12);
        assert_eq!(codes(&mut producer, MS), [(1, 1)]);
        assert_eq!(producer.poll_timeout(), Some(11 * MS));
        assert_eq!(codes(&mut producer, 10 * MS), []);
        assert_eq!(codes(&mut producer, 11 * MS), [(2, 1)]);
        let logged = std::iter::from_fn(|| producer.poll_log()).count();
        assert_eq!(logged, 6, "the queued ones");
        assert_eq!(producer.poll_log(), None);
    }
}
