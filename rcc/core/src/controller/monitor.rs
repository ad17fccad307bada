//! Watches devices, drivers and the stop channel: changes, faults and limiting are logged once per onset. It starts
//! nothing: drivers bring devices back, programs request their motion.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use takt_rt::Nanos;
use takt_rt::stats::StallReader;

use crate::controller::device_set::DeviceSet;
use crate::controller::driver_log::{DriverLog, DriverReports};
use crate::controller::faults::{Faults, StallCause, StallFigures, cause};
use crate::controller::flight_recorder::{FlightRecorder, Trigger};
use crate::controller::last_values::Flights;
use crate::controller::limited::MotionReports;
use crate::controller::permission::Permission;
use crate::controller::threads::NetThreads;
use crate::device::DeviceStatus;
use crate::device::driver::DriverEvent;
use crate::stop_channel::{Generation, StopSwitch};

/// Events of one driver that are taken before the next driver is polled.
const EVENTS_AT_ONCE: usize = 32;
/// Minimum interval between reports of requests that the stop channel rejected.
const REJECTED_EVERY: Duration = Duration::from_secs(10);
/// Maximum number of other monitored threads.
const WATCHED_MAX: usize = 64;
/// Added to the text for a device that does not recover by itself.
const HELD: &str =
    "\nhint: with `recovery = \"on_restart\"` it stays so until the controller restarts";

/// What was reported of the stop channel.
#[derive(Debug, Default)]
struct StopReport {
    generation: Generation,
    /// Rejected requests.
    rejected: u64,
    /// When these were reported.
    at: Option<Instant>,
}

impl StopReport {
    /// Logs the stop channel's actions; returns whether there were any. Rejected requests are logged at
    /// most once per [`REJECTED_EVERY`], with their number.
    fn poll(&mut self, switch: &StopSwitch) -> bool {
        let (generation, rejected) = (switch.generation(), switch.refused());
        let is_due = self.at.is_none_or(|at| at.elapsed() > REJECTED_EVERY);
        if rejected != self.rejected && is_due {
            let count = rejected - self.rejected;
            tracing::warn!(
                count,
                "the stop channel rejected requests: wrong token, or user without permission"
            );
            (self.rejected, self.at) = (rejected, Some(Instant::now()));
        }
        let before = std::mem::replace(&mut self.generation, generation);
        if generation == before {
            return false;
        }
        if generation.stops() != before.stops() {
            let by = switch.last_stop().map(|(by, _)| by.to_string());
            let by = by.unwrap_or_default();
            tracing::warn!(
                by,
                "stopped: all nets end, all devices stop, nothing starts\nhint: release the stop with `takt stop --release`"
            );
        }
        if !generation.is_stopped() {
            tracing::info!("the stop is released; programs may start nets again");
        }
        true
    }
}

/// What was last seen and reported.
#[derive(Debug, Default)]
pub(super) struct Monitor {
    statuses: BTreeMap<String, DeviceStatus>,
    /// Whether devices were stopped.
    was_stopped: bool,
    stop: StopReport,
    log: DriverLog,
    reports: DriverReports,
    motion: MotionReports,
    faults: Faults,
    flights: Flights,
    /// Other threads of this process that measure their stalls, by name.
    watched: Vec<(String, StallReader)>,
}

impl Monitor {
    /// Includes the stalls of another thread of this process.
    pub(super) fn watch_stalls(&mut self, thread: &str, stalls: StallReader) {
        if self.watched.len() < WATCHED_MAX {
            self.watched.push((thread.to_owned(), stalls));
        }
    }

    /// The faults of devices.
    pub(super) const fn faults(&self) -> &Faults {
        &self.faults
    }

    /// The last values before the last faults.
    pub(super) const fn flights(&self) -> &Flights {
        &self.flights
    }

    /// The same, to be changed.
    pub(super) const fn flights_mut(&mut self) -> &mut Flights {
        &mut self.flights
    }

    /// The last events of drivers and devices.
    pub(super) const fn reports(&self) -> &DriverReports {
        &self.reports
    }

    /// Stalls of net and driver threads that lasted at least four of their cycles.
    pub(super) fn stalls(&self, devices: &DeviceSet, threads: &NetThreads) -> StallFigures {
        let mut figures = StallFigures::default();
        for (thread, stalls) in stalling(devices, threads, &self.watched) {
            figures.count += stalls.count();
            if stalls.longest() > figures.longest {
                (figures.longest, figures.thread) = (stalls.longest(), thread);
            }
        }
        figures
    }

    /// The stall of this host that ended within a second before now.
    pub(super) fn last_stall(
        &self,
        devices: &DeviceSet,
        threads: &NetThreads,
    ) -> Option<StallCause> {
        let threads = stalling(devices, threads, &self.watched);
        cause(threads, takt_rt::monotonic())
    }

    /// Events of drivers, limiting, jumps and the lines of rejections for the log, with the names of drivers or devices.
    pub(super) fn take_driver_events(
        &mut self,
        devices: &DeviceSet,
        rejections: Vec<(String, DriverEvent)>,
        now: Instant,
    ) -> Vec<(String, DriverEvent)> {
        let mut lines = Vec::new();
        for driver in &devices.drivers {
            let events = std::iter::from_fn(|| driver.poll_event()).take(EVENTS_AT_ONCE);
            let events = self.log.take(driver.name(), events, now).into_iter();
            lines.extend(events.map(|line| (driver.name().to_owned(), line)));
        }
        let motion = self.motion.poll(&devices.table).into_iter();
        let motion = motion.map(|(device, line)| (device, DriverEvent::warning(line)));
        for (device, event) in motion.chain(rejections) {
            let events = self.log.take(&device, std::iter::once(event), now);
            let events = events.into_iter();
            lines.extend(events.map(|line| (device.clone(), line)));
        }
        let at = takt_rt::monotonic();
        for (name, event) in &lines {
            self.reports.note(name, event, at);
        }
        lines
    }

    /// Logs changes of devices; returns whether there were any.
    pub(super) fn poll(
        &mut self,
        (devices, threads): (&DeviceSet, &NetThreads),
        permission: &Permission,
        recorder: Option<&FlightRecorder>,
    ) -> bool {
        let faulted = self.poll_faults((devices, threads), recorder, takt_rt::monotonic());
        let is_stopped = permission.is_stopped();
        let statuses = devices.statuses(is_stopped);
        let is_switched = self.stop.poll(permission.switch());
        if is_stopped != self.was_stopped {
            self.was_stopped = is_stopped;
            if permission.switch().is_stopped() || (is_switched && !is_stopped) {
                // The stop itself was reported.
            } else if is_stopped {
                tracing::warn!(
                    "emergency stop: all devices stop, and the nets that command them end"
                );
            } else {
                tracing::info!("the emergency stop is over");
            }
        } else if statuses == self.statuses {
            return is_switched;
        }
        // A device that was disabled on purpose is no fault.
        let on_purpose = is_stopped || permission.is_closing();
        for (name, now) in &statuses {
            let before = self.statuses.get(name).copied().unwrap_or_default();
            // The fault was reported with its cause.
            if before != *now && !faulted.contains(name) {
                let figures = devices.figures_of(name);
                if *now < before && !on_purpose {
                    tracing::warn!(device = name, %before, %now, figures, "device");
                } else {
                    tracing::info!(device = name, %before, %now, figures, "device");
                }
            }
        }
        self.statuses = statuses;
        true
    }

    /// Records new and ended faults of devices, with one log line each. Returns the devices
    /// with new faults.
    fn poll_faults(
        &mut self,
        (devices, threads): (&DeviceSet, &NetThreads),
        recorder: Option<&FlightRecorder>,
        at: Nanos,
    ) -> Vec<String> {
        let Self {
            faults,
            reports,
            flights,
            watched,
            ..
        } = self;
        let mut faulted = Vec::new();
        faults.retain(|name| devices.table.find(name).is_some());
        reports.retain(|name| {
            let mut drivers = devices.drivers.iter();
            devices.table.find(name).is_some() || drivers.any(|driver| driver.name() == name)
        });
        for (_, device) in devices.table.all() {
            let (count, status) = device.faults();
            let found = faults.note(&device.name, count, status, at, || {
                cause(stalling(devices, threads, watched), at)
            });
            if let Some(fault) = found {
                let figures = devices.figures_of(&device.name);
                let driver = devices.driver_of(&device.name);
                let is_held = driver.is_some_and(|it| it.is_held_after_faults(&device.name));
                let hint = if is_held { HELD } else { "" };
                let (name, table) = (&device.name, flights.keep_device(device).table());
                let written =
                    recorder.map(|it| it.trigger(Trigger::Fault, name, &fault.to_string()).line());
                let written = written.unwrap_or_default();
                tracing::warn!(
                    device = name,
                    figures,
                    "{fault}{hint}{written}\nlast values, all at /devices/{name}/last:\n{table}"
                );
                faulted.push(device.name.clone());
            }
            if status == DeviceStatus::Operational
                && let Some(after) = faults.note_following(&device.name, at)
            {
                let after_s = after.as_secs_f64();
                tracing::info!(
                    device = device.name,
                    "it follows commands again after {after_s:.1} s; a program may request its motion"
                );
            }
        }
        faulted
    }
}

/// The threads that measure their stalls, by name.
fn stalling<'t>(
    devices: &'t DeviceSet,
    threads: &'t NetThreads,
    watched: &'t [(String, StallReader)],
) -> impl Iterator<Item = (String, &'t StallReader)> {
    let nets = threads.iter();
    let nets = nets.map(|thread| {
        let name = format!("nets of {:?}", thread.period);
        (name, thread.stats.stalls())
    });
    let drivers = devices.drivers.iter();
    let drivers = drivers.filter_map(|it| Some((it.name().to_owned(), it.stalls()?)));
    let watched = watched.iter().map(|(name, stalls)| (name.clone(), stalls));
    nets.chain(drivers).chain(watched)
}
