//! A port of the bus as a [`Link`], for owners that know links only. Time is that of the bus: waiting moves
//! it on, and nobody else runs meanwhile. For threads that run by the host's clock there is
//! [`crate::linux::LivePort`].

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::{Bus, PortId};
use crate::AnyFrame;
use crate::link::{Link, LinkError, Received};

/// A bus that several owners use.
#[derive(Clone, Debug)]
pub struct Shared {
    bus: Arc<Mutex<Bus>>,
}

impl Shared {
    /// Shares a bus.
    #[must_use]
    pub fn new(bus: Bus) -> Self {
        Self {
            bus: Arc::new(Mutex::new(bus)),
        }
    }

    /// The bus itself, to let time go on, to inject faults, to ask. Others wait as long as it is held.
    pub fn lock(&self) -> MutexGuard<'_, Bus> {
        // A thread that panicked has left the bus as it is after some frame; that is good enough to go on.
        self.bus.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One more participant.
    #[must_use]
    pub fn attach(&self) -> Port {
        let id = self.lock().attach();
        Port {
            bus: self.clone(),
            id,
        }
    }
}

/// A participant.
#[derive(Clone, Debug)]
pub struct Port {
    bus: Shared,
    id: PortId,
}

impl Port {
    /// Which one it is.
    #[must_use]
    pub const fn id(&self) -> PortId {
        self.id
    }

    /// The bus it is on.
    #[must_use]
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
                // An arbitration that is due now ends only a little later.
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
}
