//! What a net thread reports to the controller, and how the thread that takes it is woken: at most once a cycle, at its
//! end, and only if there is something to take. A waker that is not parked costs an atomic exchange, a parked one a
//! futex wake; neither allocates, locks or waits.

use std::sync::Arc;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;
use std::time::Duration;

use takt_rt::ring::Producer;

use crate::executor::thread::Event;

/// Wakes the thread that takes what net threads report.
#[derive(Debug, Default)]
pub struct Notifier {
    receiver: OnceLock<Thread>,
    /// Whether there is anything that the receiver has not taken.
    is_pending: AtomicBool,
    /// Whether Boolean out values changed.
    has_results: AtomicBool,
}

impl Notifier {
    /// Makes the calling thread the one that is woken; only the first call has an effect.
    pub fn attach(&self) {
        let _ = self.receiver.set(std::thread::current());
    }

    /// Wakes the receiver; `has_results` is whether Boolean out values changed. Real-time safe.
    pub fn notify(&self, has_results: bool) {
        if has_results {
            self.has_results.store(true, Ordering::Relaxed);
        }
        // A receiver that was woken and has not come to take it needs no second wake.
        if !self.is_pending.swap(true, Ordering::Release)
            && let Some(receiver) = self.receiver.get()
        {
            receiver.unpark();
        }
    }

    /// Waits for [`Self::notify`], at most for `timeout`; only for the attached thread.
    pub fn wait(&self, timeout: Duration) {
        if !self.is_pending.load(Ordering::Relaxed) {
            std::thread::park_timeout(timeout);
        }
    }

    /// Whether Boolean out values changed since the last call. What is reported from now on wakes again.
    pub fn take(&self) -> bool {
        self.is_pending.swap(false, Ordering::Acquire);
        self.has_results.swap(false, Ordering::Relaxed)
    }
}

/// The net thread's end: its events, and whether the controller is to be woken in this cycle.
#[derive(Debug)]
pub(super) struct Reports {
    events: Producer<Event>,
    notifier: Arc<Notifier>,
    is_due: bool,
    has_results: bool,
}

impl Reports {
    pub(super) const fn new(events: Producer<Event>, notifier: Arc<Notifier>) -> Self {
        Self {
            events,
            notifier,
            is_due: false,
            has_results: false,
        }
    }

    /// Queues an event.
    ///
    /// # Errors
    /// If the queue is full.
    pub(super) fn push(&mut self, event: Event) -> Result<(), Event> {
        self.is_due = true;
        self.events.push(event)
    }

    /// Records that Boolean out values changed.
    pub(super) const fn note_results(&mut self) {
        self.has_results = true;
    }

    /// Wakes the controller if there is anything for it.
    pub(super) fn flush(&mut self) {
        if self.is_due || self.has_results {
            self.notifier.notify(self.has_results);
            (self.is_due, self.has_results) = (false, false);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn notifier_wakes_waiting_receiver() {
        let notifier = Arc::new(Notifier::default());
        let waits = Arc::clone(&notifier);
        let receiver = std::thread::spawn(move || {
            waits.attach();
            waits.notify(false);
            let begin = Instant::now();
            let mut seen = waits.take();
            while !seen && begin.elapsed() < LONG {
                waits.wait(LONG);
                seen = waits.take();
            }
            (seen, begin.elapsed())
        });
        while notifier.receiver.get().is_none() {
            std::thread::yield_now();
        }
        notifier.notify(true);
        let (seen, took) = receiver.join().unwrap();
        assert!(seen && took < LONG, "woken after {took:?}");
    }

    #[test]
    fn notified_before_wait_returns_at_once() {
        let notifier = Notifier::default();
        notifier.attach();
        notifier.notify(true);
        let begin = Instant::now();
        notifier.wait(LONG);
        assert!(begin.elapsed() < LONG);
        assert!(notifier.take() && !notifier.take());
    }
}
