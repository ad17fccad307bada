//! A port of the in-process bus on the host's clock, for threads that run as on a real bus. It replaces hardware in
//! tests; it locks, so it is not real-time capable.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::monotonic;
use crate::AnyFrame;
use crate::bus::{Bus, PortId};
use crate::link::{Link, LinkError, Received};

#[derive(Debug)]
struct Hub {
    bus: Mutex<Bus>,
    /// Signals a sent frame, so that waiting threads recompute when the next transmission ends.
    changed: Condvar,
}

/// A port of a bus whose time is [`monotonic`]. A clone is the same port.
#[derive(Clone, Debug)]
pub struct LivePort {
    hub: Arc<Hub>,
    id: PortId,
}

impl LivePort {
    /// Creates a bus and its first port.
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

    /// Adds a port to the same bus.
    pub fn attach(&self) -> Self {
        Self {
            hub: Arc::clone(&self.hub),
            id: self.with_bus(Bus::attach),
        }
    }

    /// Its number on the bus.
    pub const fn id(&self) -> PortId {
        self.id
    }

    /// Locks the bus, advanced to the present, to inject faults or read its state.
    pub(crate) fn with_bus<R>(&self, use_it: impl FnOnce(&mut Bus) -> R) -> R {
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
            // Not shorter than the host can sleep: that would be a busy loop.
            let wait = next.saturating_sub(now).max(Duration::from_micros(50));
            let waited = self.hub.changed.wait_timeout(bus, wait);
            bus = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn bit_rate(&self) -> Option<u32> {
        Some(self.with_bus(|bus| bus.rates().nominal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::Config;
    use crate::{Frame, Id};

    const TIMEOUT: Duration = Duration::from_secs(10);

    #[test]
    fn live_port_waiting_thread_receives_frame() {
        let mut a = LivePort::first_of(Bus::new(Config::default()));
        let mut b = a.attach();
        let frame: AnyFrame = Frame::new(Id::standard(0x181).unwrap(), &[1])
            .unwrap()
            .into();
        std::thread::scope(|scope| {
            let received = scope.spawn(move || b.receive(TIMEOUT).unwrap().unwrap());
            a.send(&frame).unwrap();
            let received = received.join().unwrap();
            assert_eq!(received.frame, frame);
            assert!(received.at <= monotonic());
        });
        assert_eq!(a.receive(Duration::ZERO), Ok(None));
        assert_eq!(a.with_bus(|bus| bus.traffic().frames), 1);
    }
}
