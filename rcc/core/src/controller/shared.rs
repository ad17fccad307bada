//! What the handles of a controller share: the registry behind its lock, and how callers wait for the net threads. Real-time
//! threads never take this lock.

use std::sync::atomic::AtomicBool;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::controller::changed::Changed;
use crate::controller::registry::Registry;
use crate::error::Error;

/// Time within which a net thread must answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(2);

/// The controller behind all its handles.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) registry: Mutex<Registry>,
    /// Signalled after every change of the registry.
    pub(super) changed: Condvar,
    pub(super) stop: AtomicBool,
    pub(super) primitives: takt_net::Registry,
    pub(super) period: Duration,
}

impl Shared {
    /// Locks the registry after all events of the net threads were taken.
    pub(super) fn lock(&self) -> MutexGuard<'_, Registry> {
        let mut registry = self.registry.lock().unwrap_or_else(PoisonError::into_inner);
        registry.unannounced |= registry.take_events();
        registry
    }

    /// Wakes waiting callers and watchers.
    pub(super) fn announce(&self, registry: &Registry) {
        self.changed.notify_all();
        registry.watches.wake(Changed::States);
    }

    /// Waits for a thread's answer.
    pub(super) fn wait_for<T>(
        &self,
        registry: MutexGuard<'_, Registry>,
        done: impl FnMut(&mut Registry) -> Option<T>,
    ) -> Result<T, Error> {
        self.wait_until(registry, ANSWER_TIMEOUT, done)
    }

    /// Waits until `done` returns a value or the timeout expires.
    pub(super) fn wait_until<T>(
        &self,
        mut registry: MutexGuard<'_, Registry>,
        timeout: Duration,
        mut done: impl FnMut(&mut Registry) -> Option<T>,
    ) -> Result<T, Error> {
        let until = std::time::Instant::now() + timeout;
        loop {
            if let Some(result) = done(&mut registry) {
                return Ok(result);
            }
            let left = until.saturating_duration_since(std::time::Instant::now());
            if left.is_zero() {
                return Err(Error::NoAnswer(timeout));
            }
            let waited = self.changed.wait_timeout(registry, left);
            registry = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
