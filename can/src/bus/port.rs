//! A port of the bus as a [`Link`]. It runs in the virtual time of the bus: waiting advances it, and nothing else runs
//! meanwhile. Threads that run on the host's clock use [`crate::linux::LivePort`].

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::{Bus, PortId};
use crate::AnyFrame;
use crate::link::{Link, LinkError, Received};

/// A bus with several owners.
#[derive(Clone, Debug)]
pub struct Shared {
    bus: Arc<Mutex<Bus>>,
}

impl Shared {
    /// Shares a bus.
    pub fn new(bus: Bus) -> Self {
        Self {
            bus: Arc::new(Mutex::new(bus)),
        }
    }

    /// Locks the bus, to advance time, inject faults or read its state. Other owners wait until the guard is dropped.
    pub fn lock(&self) -> MutexGuard<'_, Bus> {
        // The bus is consistent after each frame, also if a thread panicked.
        self.bus.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a port.
    pub fn attach(&self) -> Port {
        let id = self.lock().attach();
        Port {
            bus: self.clone(),
            id,
        }
    }
}

/// A port of a shared bus.
#[derive(Clone, Debug)]
pub struct Port {
    bus: Shared,
    id: PortId,
}

impl Port {
    /// Its number on the bus.
    pub const fn id(&self) -> PortId {
        self.id
    }

    /// The bus it belongs to.
    pub const fn bus(&self) -> &Shared {
        &self.bus
    }
}

impl Link for Port {
    fn send(&mut self, frame: &AnyFrame) -> Result<(), LinkError> {
        let mut bus = self.bus.lock();
        let now = bus.now();
        bus.send(self.id, frame, now)
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<Received>, LinkError> {
        let mut bus = self.bus.lock();
        let until = bus.now().saturating_add(timeout);
        loop {
            if let Some(received) = bus.receive(self.id) {
                return Ok(Some(received));
            }
            match bus
                .next_event()
                .filter(|at| *at <= until && bus.now() < until)
            {
                // An arbitration that starts now ends only after a frame time.
                Some(at) if at <= bus.now() => {
                    let soon = bus.now() + Duration::from_nanos(1);
                    bus.advance(soon);
                }
                Some(at) => bus.advance(at),
                None => {
                    bus.advance(until);
                    return Ok(bus.receive(self.id));
                }
            }
        }
    }

    fn bit_rate(&self) -> Option<u32> {
        Some(self.bus.lock().rates().nominal)
    }
}
