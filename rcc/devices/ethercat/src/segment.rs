//! The driver of an EtherCAT segment: one thread that sends a frame each cycle, in phase with SYNC0, and between two
//! frames steps the arms and the inputs and outputs. The protocol, the drive profile and the state of every slave are
//! in `takt_ethercat` and `takt_cia402`.
//!
//! A cycle sends its frame first, with values computed in the previous cycle, so that the send time does not depend on
//! any computation. It waits at most half a cycle for the answer, then steps the drives and publishes their state to
//! nets.

mod access;
mod arm;
mod describe;
mod events;
mod io;
mod servo;
mod units;
mod wire;
mod wires;
mod youbot;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_ethercat::link::Port;
use takt_ethercat::master::{Difference, Master, Phase};
use takt_rt::alloc::enter_real_time;
use takt_rt::cycle::{Cycles, Follow, Tick};
use takt_rt::interface::Medium;
use takt_rt::latest::{LatestReader, LatestWriter, latest};
use takt_rt::ring::{Consumer, Producer, ring};
use takt_rt::servo::{Estimate, Servo, ServoConfig};
use takt_rt::stats::{self, StatsReader};
use takt_rt::{Nanos, monotonic};

use crate::config::EthercatConfig;
use access::{Access, Inspector};
use arm::Arm;
pub use describe::{check, describe, master_config};
use events::SegmentEvent;
use takt_core::Error;
use takt_core::device::bus::BusAccess;
use takt_core::device::driver::{
    DeviceDriver, DriverEnds, DriverEvent, DriverThread, SHUTDOWN_MAX,
};
use takt_core::device::link_watch::{LinkErrors, LinkWatch};
use takt_device_drives as drives;
use units::Units;
use wire::WireNotes;
pub use wires::{EthernetLink, Wire, Wires, open};
use youbot::Waiting;
pub use youbot::{Wait, YouBotFigures};

/// Longest Ethernet payload.
const FRAME: usize = 1500;
/// Most frames received while waiting for one answer; more are a flood from another sender.
const ANSWERS: usize = 64;
/// Capacity of the event queue.
const EVENTS_MAX: usize = 256;
/// Most events handled in one cycle.
const EVENTS: usize = 32;
/// Time between two checks of a segment that is not as expected.
const REFUSED: Duration = Duration::from_secs(2);
/// Time slice of each link while waiting for both.
const TURN: Duration = Duration::from_micros(20);

/// Counters of a running segment that other threads read.
#[derive(Debug, Default)]
struct Shared {
    cycles: AtomicU64,
    lost: AtomicU64,
    events: AtomicU64,
    operational: AtomicBool,
    unproven: AtomicU64,
    /// In the order of the fields of [`YouBotFigures`].
    youbots: [AtomicU64; 4],
}

/// Figures of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EthercatFigures {
    /// Time from one frame to the next.
    pub period: Duration,
    /// Frames with process data.
    pub cycles: u64,
    /// Frames without an answer in their cycle.
    pub lost: u64,
    /// Events: slaves found, lost and returned, cables.
    pub events: u64,
    /// Whether all slaves are in their requested states.
    pub operational: bool,
    /// Fault counters of youBot drives.
    pub youbots: YouBotFigures,
}

/// A running driver.
#[derive(Debug)]
pub struct Ethercat {
    devices: Vec<String>,
    on_restart: Vec<String>,
    period: Duration,
    shared: Arc<Shared>,
    /// Names of its slaves, and the youBot drive that the segment waits for.
    slaves: Vec<String>,
    waiting: Mutex<LatestReader<Option<Waiting>>>,
    events: Mutex<Consumer<SegmentEvent>>,
    /// Diagnosis by other threads.
    access: Arc<Access>,
    /// One per wire.
    links: Vec<LinkWatch>,
    /// Timing of the cycle; its phase error is relative to SYNC0.
    pub stats: StatsReader,
    thread: DriverThread,
}

impl Ethercat {
    /// Starts the driver thread. The endpoints are those of the devices of [`describe`], in that order.
    ///
    /// # Errors
    /// If the configuration is invalid or the thread cannot be created.
    pub fn start(
        config: &EthercatConfig,
        wires: impl Into<Wires>,
        ends: DriverEnds,
    ) -> Result<Self, Error> {
        check(config).map_err(Error::Cell)?;
        drives::report_quirks(&config.name, &config.arms);
        let master = Master::new(master_config(config));
        let master = master.map_err(|e| Error::Cell(e.to_string()))?;
        let Wires { first, second } = wires.into();
        let links = watched(&config.name, &first, second.as_ref());
        let ports = [first]
            .into_iter()
            .chain(second)
            .map(|wire| Port::new(wire.link, wire.source));
        let devices = describe(config).into_iter().map(|d| d.name).collect();
        let units = Units::new(config, ends.devices);
        let shared = Arc::<Shared>::default();
        let (own_clock, followed) = latest(1, Estimate::default);
        let (own_waiting, waiting) = latest(1, || None);
        let (mut recorded, stats) = stats::pair();
        let (own_events, events) = ring(EVENTS_MAX);
        let (access, inspector) = access::pair(config);
        let slaves = slave_names(&master);
        let mut driver = Box::new(Driver {
            master,
            ports: ports.collect(),
            errors: links.iter().map(LinkWatch::errors).collect(),
            servo: Servo::new(&ServoConfig::new(config.cycle)),
            cycle: config.cycle,
            units,
            buffer: [0; FRAME],
            clocks: [own_clock, ends.clock],
            shared: Arc::clone(&shared),
            waiting: own_waiting,
            events: own_events,
            wire: WireNotes::default(),
            inspector,
            refused: Refused::default(),
            stop_by: None,
        });
        let (period, name, cpus) = (config.cycle, &config.name, &config.cpus);
        let phase = config.phase.unwrap_or(period / 2).into();
        let thread = DriverThread::start(name, config.priority, cpus, move |stopping| {
            let cycles = Cycles {
                follow: Some(Follow::new(followed, phase)),
                ..Cycles::every(period)
            };
            let mut scope = None;
            cycles.run(&mut recorded, |tick| {
                // Memory locks are entered and left once each time the segment starts. Before that, a cycle may
                // allocate: scan results need memory.
                let runs = driver.master.is_exchanging();
                if runs != scope.is_some() {
                    scope = runs.then(enter_real_time);
                }
                driver.cycle(tick, stopping.load(Ordering::Relaxed))
            });
            drop(scope);
            let [_, clock] = driver.clocks;
            clock
        })?;
        Ok(Self {
            devices,
            on_restart: config.on_restart(),
            period,
            shared,
            slaves,
            waiting: Mutex::new(waiting),
            events: Mutex::new(events),
            access: Arc::new(access),
            links,
            stats,
            thread,
        })
    }

    /// The youBot drive that the segment waits for, and why; `None` if all follow or there is no youBot.
    #[must_use]
    pub fn waits_for(&self) -> Option<String> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let Waiting { slave, why } = waiting.read()?;
        let name = self.slaves.get(slave).map_or("", String::as_str);
        Some(format!("{name}: {why}"))
    }

    /// Current figures.
    #[must_use]
    pub fn figures(&self) -> EthercatFigures {
        let Shared {
            cycles,
            lost,
            events,
            operational,
            youbots,
            ..
        } = &*self.shared;
        let [timeouts, i2t, clamped, repeats] = youbots
            .each_ref()
            .map(|count| count.load(Ordering::Relaxed));
        EthercatFigures {
            period: self.period,
            cycles: cycles.load(Ordering::Relaxed),
            lost: lost.load(Ordering::Relaxed),
            events: events.load(Ordering::Relaxed),
            operational: operational.load(Ordering::Relaxed),
            youbots: YouBotFigures {
                timeouts,
                i2t,
                clamped,
                repeats,
            },
        }
    }
}

/// Watches the link of each wire.
fn watched(name: &str, first: &Wire, second: Option<&Wire>) -> Vec<LinkWatch> {
    let watch = |wire: &Wire| LinkWatch::new(name, wire.link.interface(), Medium::Ethernet);
    std::iter::once(first).chain(second).map(watch).collect()
}

impl DeviceDriver for Ethercat {
    fn thread(&self) -> &DriverThread {
        &self.thread
    }

    fn into_thread(self: Box<Self>) -> DriverThread {
        self.thread
    }

    fn drives(&self, device: &str) -> bool {
        self.devices.iter().any(|name| name == device)
    }

    fn figures(&self) -> Vec<(&'static str, String)> {
        let figures = self.figures();
        let mut reported = vec![
            ("cycles", figures.cycles.to_string()),
            ("lost", figures.lost.to_string()),
            ("events", figures.events.to_string()),
        ];
        let failed: u64 = self.links.iter().map(LinkWatch::failed).sum();
        if failed > 0 {
            reported.push(("not sent", failed.to_string()));
        }
        let unproven = self.shared.unproven.load(Ordering::Relaxed);
        if unproven > 0 {
            reported.push(("axes not proven", unproven.to_string()));
        }
        let YouBotFigures { timeouts, i2t, .. } = figures.youbots;
        if timeouts + i2t > 0 {
            reported.push(("youbot timeouts", timeouts.to_string()));
            reported.push(("youbot i2t", i2t.to_string()));
        }
        reported.extend(self.waits_for().map(|why| ("waits for", why)));
        reported
    }

    fn is_held_after_faults(&self, device: &str) -> bool {
        self.on_restart.iter().any(|name| name == device)
    }

    fn stalls(&self) -> Option<&stats::StallReader> {
        Some(self.stats.stalls())
    }

    fn poll_event(&self) -> Option<DriverEvent> {
        let now = Instant::now();
        if let Some(event) = self.links.iter().find_map(|link| link.poll(now)) {
            return Some(event);
        }
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let event = events.pop()?;
        self.access.note(&event);
        Some(event.event())
    }

    fn bus(&self) -> Option<Arc<dyn BusAccess>> {
        Some(Arc::clone(&self.access) as Arc<dyn BusAccess>)
    }
}

/// A segment that is not as expected.
#[derive(Debug, Default)]
struct Refused {
    since: Option<Nanos>,
    /// The difference reported last; only changes are reported.
    differences: Vec<Difference>,
    too_large: Option<usize>,
}

struct Driver {
    master: Master,
    /// One, or two of a ring.
    ports: Vec<Port<Box<dyn EthernetLink>>>,
    /// One per wire.
    errors: Vec<Arc<LinkErrors>>,
    servo: Servo,
    cycle: Duration,
    units: Units,
    buffer: [u8; FRAME],
    /// Clock of the segment, for this thread and for the controller.
    clocks: [LatestWriter<Estimate>; 2],
    shared: Arc<Shared>,
    waiting: LatestWriter<Option<Waiting>>,
    /// Events; unread ones are dropped.
    events: Producer<SegmentEvent>,
    wire: WireNotes,
    inspector: Inspector,
    refused: Refused,
    /// Deadline of the shutdown, once requested.
    stop_by: Option<Nanos>,
}

impl Driver {
    /// One cycle.
    fn cycle(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        // A thread that woke late waits too: the answer is on its way.
        let until = (tick.scheduled + Nanos::from(self.cycle / 2))
            .max(tick.woken + Nanos::from(self.cycle / 4));
        if self.master.is_exchanging() {
            self.exchange(until);
        } else {
            while self.exchange(until) && !self.master.is_exchanging() {}
            self.start_up(tick);
        }
        self.lead(tick, stopping);
        self.end(tick, stopping)
    }

    /// Reports differences from the expected segment, and checks again after a while: a slave may have got power
    /// meanwhile.
    fn start_up(&mut self, tick: &Tick) {
        if self.master.is_exchanging() {
            (self.refused.since, self.refused.too_large) = (None, None);
            if !std::mem::take(&mut self.refused.differences).is_empty() {
                self.send(SegmentEvent::AsExpected);
            }
            let lacks: Vec<_> = self
                .units
                .ios
                .iter_mut()
                .flat_map(|io| io.find(&self.master))
                .collect();
            for lack in lacks {
                self.send(SegmentEvent::Lack(lack));
            }
            return;
        }
        if self.master.phase() != Phase::Refused {
            return;
        }
        let since = *self.refused.since.get_or_insert(tick.scheduled);
        if self.refused.differences != self.master.differences() {
            self.refused.differences = self.master.differences().to_vec();
            for difference in self.refused.differences.clone() {
                self.send(SegmentEvent::Difference(difference));
            }
        }
        let too_large = self.master.image_too_large();
        if self.refused.too_large != too_large {
            self.refused.too_large = too_large;
            if let Some(bytes) = too_large {
                self.send(SegmentEvent::TooLarge(bytes));
            }
        }
        if tick.scheduled - since > Nanos::from(REFUSED) {
            self.refused.since = None;
            self.master.restart();
        }
    }

    fn send(&mut self, event: SegmentEvent) {
        self.events.push(event).ok();
    }

    /// Sends the frame that is due and waits for its answer, or for that of a frame still in flight; false if there
    /// is neither or no time is left.
    fn exchange(&mut self, until: Nanos) -> bool {
        // An answer that came after its wait is no loss.
        if self.master.awaits_frame() {
            self.answered(monotonic());
        }
        let now = since_start(monotonic());
        if let Some(len) = self.master.poll_transmit(now, &mut self.buffer) {
            let mut sent = false;
            for (port, errors) in self.ports.iter_mut().zip(&self.errors) {
                match port.send(&self.buffer[..len]) {
                    Ok(()) => sent = true,
                    Err(error) => errors.note_io(&error),
                }
            }
            self.wire.sent(now);
            return sent && self.answered(until);
        }
        // The last frame of a burst returns after the burst: if not received now, it would count as lost and be
        // repeated.
        self.master.awaits_frame() && self.answered(until)
    }

    /// Waits for the answer, alternating between both ends of a ring, and takes what has been received by then; false on
    /// timeout.
    fn answered(&mut self, until: Nanos) -> bool {
        let both = self.ports.len() > 1;
        let mut looked = 0;
        while looked < ANSWERS {
            let left = since_start(until - monotonic());
            let wait = if both { left.min(TURN) } else { left };
            let mut deaf = 0;
            let mut is_empty = true;
            for (number, port) in self.ports.iter_mut().enumerate() {
                match port.receive(wait) {
                    Ok(Some((frame, at))) => {
                        looked += 1;
                        is_empty = false;
                        if self.master.handle_frame(number, frame, at) {
                            self.wire.answered(at);
                            return !left.is_zero();
                        }
                    }
                    Ok(None) => {}
                    Err(error) => {
                        deaf += 1;
                        if let Some(errors) = self.errors.get(number) {
                            errors.note_io(&error);
                        }
                    }
                }
            }
            if deaf == self.ports.len() || (left.is_zero() && is_empty) {
                return false;
            }
        }
        false
    }

    fn lead(&mut self, tick: &Tick, stopping: bool) {
        self.take_samples();
        let mut happened = 0;
        while happened < EVENTS
            && let Some(event) = self.master.poll_event()
        {
            happened += 1;
            self.events.push(SegmentEvent::Event(event)).ok();
        }
        while let Some(emergency) = self.master.poll_emergency() {
            self.events.push(SegmentEvent::Emergency(emergency)).ok();
        }
        let unproven = self.shared.unproven.load(Ordering::Relaxed);
        let counted = (unproven, self.events.offered());
        let values = self.wire.values(&self.master, tick, counted);
        self.units.report_wire(&values);
        self.units
            .servos
            .iter_mut()
            .for_each(|servo| servo.take(tick));
        for (number, arm) in self.units.arms.iter_mut().enumerate() {
            arm.cycle(&mut self.master, &mut self.units.servos, tick, stopping);
            while let Some((slave, axis, event)) = arm.poll_event() {
                self.events
                    .push(SegmentEvent::Axis(slave, axis, event))
                    .ok();
            }
            while let Some((joint, event)) = arm.poll_joint() {
                self.events
                    .push(SegmentEvent::Joint(number, joint, event))
                    .ok();
            }
        }
        for (number, servo) in self.units.servos.iter_mut().enumerate() {
            servo.publish(tick);
            while let Some(event) = servo.poll_event() {
                self.events.push(SegmentEvent::Servo(number, event)).ok();
            }
        }
        let unproven = self.units.arms.iter().map(Arm::unproven).sum();
        self.shared.unproven.store(unproven, Ordering::Relaxed);
        for io in &mut self.units.ios {
            io.cycle(&mut self.master, tick);
        }
        while let Some(reply) = self.master.poll_reply() {
            let Some(reply) = self.inspector.handle_reply(reply) else {
                continue;
            };
            let mut arms = self.units.arms.iter_mut();
            let other = arms.try_fold(reply, |reply, arm| arm.handle_reply(reply, tick).err());
            if let Some(reply) = other {
                self.units.youbots.handle_reply(reply, tick);
            }
        }
        self.units.youbots.cycle(&mut self.master, tick, stopping);
        self.inspector.cycle(&mut self.master, tick.scheduled);
        self.share(happened);
    }

    /// What is known outside of the thread, after a cycle in which so many events happened.
    fn share(&mut self, happened: usize) {
        let frames = self.master.frames();
        let shared = &self.shared;
        shared.cycles.store(self.master.cycles(), Ordering::Relaxed);
        shared.lost.store(frames.lost, Ordering::Relaxed);
        shared.events.fetch_add(happened as u64, Ordering::Relaxed);
        let YouBotFigures {
            timeouts,
            i2t,
            clamped,
            repeats,
        } = self.units.youbots.figures();
        for (to, count) in shared.youbots.iter().zip([timeouts, i2t, clamped, repeats]) {
            to.store(count, Ordering::Relaxed);
        }
        self.waiting.write(self.units.youbots.waits_for());
        let operational = self.master.is_operational();
        shared.operational.store(operational, Ordering::Relaxed);
    }

    /// Gives the servo the reference clock at half of the frame's round trip.
    fn take_samples(&mut self) {
        while let Some(sample) = self.master.poll_sample() {
            let round_trip = sample.received.saturating_sub(sample.sent);
            let local = Nanos::from(sample.sent + round_trip / 2);
            let remote = i64::try_from(sample.system_ns).unwrap_or(i64::MAX);
            self.servo.handle_sample(local, Nanos(remote));
        }
        self.servo.handle_time(monotonic());
        let estimate = self.servo.estimate();
        for clock in &mut self.clocks {
            clock.write(estimate);
        }
    }

    fn end(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        if !stopping {
            return ControlFlow::Continue(());
        }
        let now = tick.scheduled;
        let latest = now + SHUTDOWN_MAX.into();
        let end = *self.stop_by.get_or_insert(latest);
        let off = self.units.arms.iter().all(Arm::is_off) && self.units.youbots.rest();
        if off || now >= end || !self.master.is_exchanging() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

fn slave_names(master: &Master) -> Vec<String> {
    let slaves = master.config().slaves.iter();
    slaves.map(|slave| slave.name.clone()).collect()
}

/// Monotonic time as the protocol counts it; zero before its start.
fn since_start(time: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(time.0).unwrap_or_default())
}

#[cfg(test)]
mod recovery_tests;
#[cfg(test)]
mod torque_tests;
#[cfg(test)]
mod wire_tests;
