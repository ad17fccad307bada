//! Figures of a running controller: timing of its threads and counters of its drivers. This module does
//! not evaluate them.

use std::any::Any;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use takt_rt::stats::StallReader;

use crate::controller::Controller;
use crate::controller::clock::ClockInfo;
use crate::controller::driver_log::{DriverReport, EventCounts};
use crate::controller::faults::{DeviceFault, FaultCounts, StallCause, StallFigures};
use crate::controller::last_values::LastValues;
use crate::controller::limited::{self, LimitedInfo};
use crate::controller::registry::Registry;
use crate::controller::rejections::{RejectedCounts, RejectedInfo};
use crate::device::bus::BusAccess;
use crate::device::driver::{BusLoad, DeviceDriver};
use crate::executor::figures::{NetCounts, budget};
use crate::executor::thread::NetThread;
use crate::ids::NetId;

/// Timing of a net thread.
#[derive(Clone, Debug)]
pub struct ThreadInfo {
    /// Its period.
    pub period: Duration,
    /// Its cycles.
    pub stats: takt_rt::stats::Snapshot,
    /// Time between handing over set-points to its first and to its last device in a cycle.
    pub hand_over: takt_rt::stats::Summary,
    /// The device clock that it follows; `None` if it follows the host's clock. The deviation of its cycles
    /// from that clock is `stats.phase_error`.
    pub clock: Option<ClockInfo>,
}

/// Declared and measured cost of a net's evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetFigures {
    /// Its period.
    pub period: Duration,
    /// Period of the thread that evaluates it.
    pub thread_period: Duration,
    /// Budget of one of its cycles.
    pub budget: Duration,
    /// Cost bound of one of its cycles, as declared by its primitives, with everything active.
    pub cost: Duration,
    /// Number of its primitives.
    pub primitives: usize,
    /// Counters of its run.
    pub counts: NetCounts,
}

impl Controller {
    /// Cost of a net's evaluation; `None` if there is no such net, or it was rejected.
    #[must_use]
    pub fn net_figures(&self, id: NetId) -> Option<NetFigures> {
        self.inner.lock().net_figures(id)
    }

    /// The net threads, the first one first.
    #[must_use]
    pub fn threads(&self) -> Vec<ThreadInfo> {
        self.inner.lock().thread_infos()
    }

    /// Whether the emergency stop is active: no device follows commands.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.inner.lock().permission.is_stopped()
    }

    /// Timing of the first net thread.
    #[must_use]
    pub fn stats(&self) -> takt_rt::stats::Snapshot {
        self.inner.lock().thread_stats()
    }

    /// Allocations in real-time threads, expected to be 0; also 0 if the program does
    /// not count them.
    #[must_use]
    pub fn real_time_allocations(&self) -> u64 {
        takt_rt::alloc::real_time_allocations()
    }

    /// Page faults of real-time threads and drivers since their first cycle; 0 if
    /// memory could be locked.
    #[must_use]
    pub fn real_time_page_faults(&self) -> takt_rt::alloc::PageFaults {
        takt_rt::alloc::real_time_page_faults()
    }

    /// Time between handing over set-points to the first and to the last arm of a cycle of the first net thread.
    #[must_use]
    pub fn hand_over(&self) -> takt_rt::stats::Summary {
        self.inner.lock().hand_over()
    }

    /// Settings that the host granted to the threads, by thread name.
    #[must_use]
    pub fn grants(&self) -> Vec<(String, takt_rt::Grant)> {
        self.inner.lock().grants()
    }

    /// Reads a figure of every driver of one kind.
    pub fn with_drivers<D: DeviceDriver, T>(&self, read: impl Fn(&D) -> T) -> Vec<T> {
        let registry = self.inner.lock();
        let drivers = registry
            .devices
            .drivers
            .iter()
            .map(|driver| driver.as_ref() as &dyn Any);
        drivers
            .filter_map(|driver| driver.downcast_ref())
            .map(read)
            .collect()
    }

    /// The buses whose drivers offer access for diagnosis.
    #[must_use]
    pub fn buses(&self) -> Vec<Arc<dyn BusAccess>> {
        let registry = self.inner.lock();
        let drivers = registry.devices.drivers.iter();
        drivers.filter_map(|driver| driver.bus()).collect()
    }

    /// The figures of a device's driver, by name: counts, states and advice, as its log lines have them. Empty without a driver.
    #[must_use]
    pub fn driver_figures(&self, device: &str) -> Vec<(&'static str, String)> {
        let registry = self.inner.lock();
        let driver = registry.devices.driver_of(device);
        driver.map(|driver| driver.figures()).unwrap_or_default()
    }

    /// The loads of all buses that drivers measure, each bus once, by name.
    #[must_use]
    pub fn bus_loads(&self) -> Vec<BusLoad> {
        let registry = self.inner.lock();
        let drivers = registry.devices.drivers.iter();
        let mut loads: Vec<_> = drivers.flat_map(|driver| driver.bus_loads()).collect();
        loads.sort_by(|one, other| one.bus.cmp(&other.bus));
        loads.dedup_by(|one, other| one.bus == other.bus);
        loads
    }

    /// The UDP addresses at which drivers wait for their robots, by device.
    #[must_use]
    pub fn waits_at(&self) -> Vec<(String, SocketAddr)> {
        let registry = self.inner.lock();
        let drivers = registry.devices.drivers.iter();
        let waiting = drivers.filter_map(|it| Some((it.name().to_owned(), it.waits_at()?)));
        waiting.collect()
    }

    /// The state that a device's driver published last.
    #[must_use]
    pub fn arm_state(&self, name: &str) -> Option<crate::device::DeviceState> {
        let device = self.inner.lock().devices.table.find(name).cloned();
        device.map(|device| device.state())
    }

    /// Limiting by the last stages of a device, part by part; empty if there is no such device or no part of it
    /// moves.
    #[must_use]
    pub fn limited(&self, name: &str) -> Vec<LimitedInfo> {
        let device = self.inner.lock().devices.table.find(name).cloned();
        device.map_or_else(Vec::new, |device| limited::infos(&device))
    }

    /// The last events of a device and of its driver, oldest first: at most 8 of each.
    #[must_use]
    pub fn device_reports(&self, name: &str) -> Vec<DriverReport> {
        let registry = self.inner.lock();
        let reports = registry.monitor.reports();
        let driver = registry.devices.driver_of(name).map(DeviceDriver::name);
        let of_driver = driver.filter(|driver| *driver != name);
        let names = of_driver.into_iter().chain([name]);
        let mut found: Vec<_> = names.flat_map(|name| reports.of(name)).cloned().collect();
        found.sort_by_key(|report| report.at);
        found
    }

    /// The last second of values of a device before its last fault, or before now if it had none; `None` if there is no
    /// such device.
    #[must_use]
    pub fn last_values(&self, device: &str) -> Option<Arc<LastValues>> {
        let registry = self.inner.lock();
        let found = registry.devices.table.find(device)?;
        let kept = registry.monitor.flights().of_device(device);
        Some(kept.unwrap_or_else(|| {
            let device = std::iter::once(Arc::clone(found));
            Arc::new(LastValues::of_devices(device))
        }))
    }

    /// The last second of values of a net that failed, and of the devices that it commanded; `None` if it did not fail, or
    /// long ago.
    #[must_use]
    pub fn last_values_of_net(&self, net: NetId) -> Option<Arc<LastValues>> {
        self.inner.lock().monitor.flights().of_net(net)
    }

    /// The last rejections of set-points, at most 256 in all, oldest first: those of a net, or all.
    #[must_use]
    pub fn rejected(&self, net: Option<NetId>) -> Vec<RejectedInfo> {
        let registry = self.inner.lock();
        let recent = registry.rejections.recent();
        let of_net = recent.filter(|it| net.is_none() || it.net == net);
        of_net.cloned().collect()
    }

    /// How often set-points began to be rejected, by device, part and reason.
    #[must_use]
    pub fn rejected_counts(&self) -> RejectedCounts {
        self.inner.lock().rejections.counts().clone()
    }

    /// Number of events by driver or device, each by severity.
    #[must_use]
    pub fn event_counts(&self) -> BTreeMap<String, EventCounts> {
        self.inner.lock().monitor.reports().counts()
    }

    /// Includes the stalls of another thread of this process in the search for causes, such as that of an emulated
    /// device; at most 64 threads.
    pub fn watch_stalls(&self, thread: &str, stalls: StallReader) {
        self.inner.lock().monitor.watch_stalls(thread, stalls);
    }

    /// Fault counters by device name; only of devices that had faults.
    #[must_use]
    pub fn fault_counts(&self) -> BTreeMap<String, FaultCounts> {
        self.inner.lock().monitor.faults().counts().clone()
    }

    /// The last 64 faults of devices, oldest first.
    #[must_use]
    pub fn faults(&self) -> Vec<DeviceFault> {
        let registry = self.inner.lock();
        registry.monitor.faults().recent().cloned().collect()
    }

    /// Stalls of net and driver threads that lasted at least four of their cycles.
    #[must_use]
    pub fn stalls(&self) -> StallFigures {
        let registry = self.inner.lock();
        registry
            .monitor
            .stalls(&registry.devices, &registry.threads)
    }

    /// The stall of this host that ended within a second before now; `None` if there was none.
    #[must_use]
    pub fn last_stall(&self) -> Option<StallCause> {
        let registry = self.inner.lock();
        registry
            .monitor
            .last_stall(&registry.devices, &registry.threads)
    }
}

impl Registry {
    fn net_figures(&self, id: NetId) -> Option<NetFigures> {
        let net = self.nets.get(id)?;
        let counted = net.counted()?;
        let thread_period = self.threads.period(net.thread())?;
        Some(NetFigures {
            period: counted.period,
            thread_period,
            budget: budget(thread_period),
            cost: counted.cost,
            primitives: counted.primitives,
            counts: counted.counters.read(),
        })
    }

    fn thread_stats(&self) -> takt_rt::stats::Snapshot {
        match self.threads.first() {
            Some(thread) => thread.stats.snapshot(),
            None => takt_rt::stats::pair().1.snapshot(),
        }
    }

    /// Figures of all net threads.
    fn thread_infos(&mut self) -> Vec<ThreadInfo> {
        let clock = &mut self.devices.clock;
        let info = |(number, thread): (usize, &NetThread)| ThreadInfo {
            period: thread.period,
            stats: thread.stats.snapshot(),
            hand_over: thread.hand_over.read().summary(),
            clock: clock.as_mut().and_then(|clock| clock.info(number)),
        };
        self.threads.iter().enumerate().map(info).collect()
    }

    fn hand_over(&self) -> takt_rt::stats::Summary {
        match self.threads.first() {
            Some(thread) => thread.hand_over.read().summary(),
            None => takt_rt::stats::Recorder::new().reader().read().summary(),
        }
    }

    fn grants(&self) -> Vec<(String, takt_rt::Grant)> {
        let nets = self.threads.iter().flat_map(|t| t.grants().iter());
        let nets = nets.map(|grant| ("net thread".to_owned(), grant.clone()));
        let drivers = self.devices.drivers.iter().flat_map(|driver| {
            let name = driver.name().to_owned();
            driver
                .grants()
                .iter()
                .map(move |grant| (name.clone(), grant.clone()))
        });
        nets.chain(drivers).collect()
    }
}
