//! The supervisor thread: net threads wake it to apply their events and to announce changed results; between that it
//! watches the devices, and writes the log without the lock.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::controller::admission::MemoryReturn;
use crate::controller::changed::Changed;
use crate::controller::driver_log;
use crate::controller::registry::Registry;
use crate::controller::shared::Shared;
use crate::executor::report::Notifier;
use crate::record::RecordingEvent;

/// Interval at which the supervisor watches the devices. Net threads wake it between.
const SUPERVISION: Duration = Duration::from_millis(2);

/// Applies the events of the net threads to the registry, and detects changes of devices.
pub(super) fn supervise(inner: &Shared, notifier: &Notifier) {
    notifier.attach();
    let mut memory_return = MemoryReturn::default();
    while !inner.stop.load(Ordering::Relaxed) {
        watch(inner, &mut memory_return);
        let next = Instant::now() + SUPERVISION;
        loop {
            apply(inner, notifier.take());
            let left = next.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            notifier.wait(left);
        }
    }
}

/// Applies the events of the net threads and announces what changed.
fn apply(inner: &Shared, has_results: bool) {
    let mut registry = inner.lock();
    if std::mem::take(&mut registry.unannounced) {
        inner.announce(&registry);
    } else if has_results {
        registry.watches.wake(Changed::Results);
    }
}

/// Detects changes of devices, and logs what they and the recorder report.
fn watch(inner: &Shared, memory_return: &mut MemoryReturn) {
    let mut registry = inner.lock();
    registry.nets.drop_expired();
    registry.nets.drain_taps();
    let has_events = std::mem::take(&mut registry.unannounced);
    let Registry {
        monitor,
        devices,
        threads,
        permission,
        flights,
        ..
    } = &mut *registry;
    let mut has_changes = monitor.poll((devices, threads), permission, flights.as_ref());
    let Registry {
        rejections,
        devices,
        nets,
        ..
    } = &mut *registry;
    has_changes |= rejections.poll(devices, nets, takt_rt::monotonic());
    registry.end_rejected();
    if has_events || has_changes {
        inner.announce(&registry);
    }
    let now = Instant::now();
    let recording = registry.recorder.as_mut().and_then(|it| it.poll_event(now));
    let Registry {
        monitor,
        devices,
        rejections,
        ..
    } = &mut *registry;
    let driver_events = monitor.take_driver_events(devices, rejections.take_lines(), now);
    let returns = memory_return.is_due(now) && memory_return.check(registry.nets.memory_taken());
    drop(registry);
    if returns && let Err(error) = takt_rt::host::return_memory() {
        tracing::warn!(
            "cannot lock the heap again, cycles may fault: {error}\nhint: LimitMEMLOCK=infinity"
        );
    }
    match recording {
        Some(RecordingEvent::Failed(error)) => {
            tracing::error!("{error}");
        }
        Some(RecordingEvent::CyclesLost(lost)) => tracing::warn!(
            lost,
            "cycles are missing in the recording: the disk is too slow or a cycle too large\nhint: record to a \
             faster disk, or to memory (/dev/shm)"
        ),
        None => {}
    }
    for (driver, event) in driver_events {
        driver_log::report(&driver, &event);
    }
}
