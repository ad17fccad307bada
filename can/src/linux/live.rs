//! A port of the in-process bus by the host's clock, for threads that run as on a real bus. It stands in for
//! hardware: it locks, so no promise about real time holds with it.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::monotonic;
use crate::AnyFrame;
use crate::bus::{Bus, PortId};
use crate::link::{Link, LinkError, Received};

#[derive(Debug)]
struct Hub {
    bus: Mutex<Bus>,
    /// Somebody sent, so that those who wait must find out anew when the next frame is over.
    changed: Condvar,
}

/// A participant of a bus whose time is [`monotonic`]. A clone is the same participant.
#[derive(Clone, Debug)]
pub struct LivePort {
    hub: Arc<Hub>,
    id: PortId,
}

impl LivePort {
    /// The first participant of a bus.
    #[must_use]
    pub fn first_of(mut bus: Bus) -> Self {
        bus.advance(monotonic());
        let id = bus.attach();
        let hub = Hub {
            bus: Mutex::new(bus),
            changed: Condvar::new(),
        };
        Self {
            hub: Arc::new(hub),
            id,
        }
    }

    /// One more participant of the same bus.
    #[must_use]
    pub fn attach(&self) -> Self {
        Self {
            hub: Arc::clone(&self.hub),
            id: self.with_bus(Bus::attach),
        }
    }

    /// Which one it is.
    #[must_use]
    pub const fn id(&self) -> PortId {
        self.id
    }

    /// The bus itself, brought to the present: to inject faults, to ask.
    pub fn with_bus<R>(&self, use_it: impl FnOnce(&mut Bus) -> R) -> R {
        let mut bus = self.hub.bus.lock().unwrap_or_else(PoisonError::into_inner);
        bus.advance(monotonic());
        let result = use_it(&mut bus);
        self.hub.changed.notify_all();
        result
    }
}

impl Link for LivePort {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        let id = self.id;
        self.with_bus(|bus| {
            let now = bus.now();
            bus.send(id, frame, now)
        })
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError> {
        let until = monotonic() + timeout;
        let mut bus = self.hub.bus.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let now = monotonic();
            bus.advance(now);
            let received = bus.receive(self.id);
            if received.is_some() || now >= until {
                return Ok(received);
            }
            let next = bus.next_event().unwrap_or(until).min(until);
            // Not shorter than the host can sleep, or this becomes a busy loop.
            let wait = next.saturating_sub(now).max(Duration::from_micros(50));
            let waited = self.hub.changed.wait_timeout(bus, wait);
            bus = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Config;
    use crate::{Frame, Id};

    const PATIENCE: Duration = Duration::from_secs(10);

    #[test]
    fn a_waiting_thread_gets_what_another_sends() {
        let mut a = LivePort::first_of(Bus::new(Config::default()));
        let mut b = a.attach();
        let frame: AnyFrame = Frame::new(Id::standard(0x181).unwrap(), &[1])
            .unwrap()
            .into();
        std::thread::scope(|scope| {
            let heard = scope.spawn(move || b.receive(PATIENCE).unwrap().unwrap());
            a.send(&frame).unwrap();
            let heard = heard.join().unwrap();
            assert_eq!(heard.frame, frame);
            assert!(heard.at <= monotonic());
        });
        assert_eq!(a.receive(Duration::ZERO), Ok(None));
        assert_eq!(a.with_bus(|bus| bus.traffic().frames), 1);
    }
}
