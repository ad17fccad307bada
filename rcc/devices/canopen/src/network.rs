//! The driver of a CANopen network: one thread that sends SYNC and set-points at the start of each cycle, receives
//! until three quarters of it are over, and then steps the arms. Start-up, supervision and SDO transfers, which never
//! delay a cycle, are in `takt_can::canopen::network`.

mod bus;
mod events;

use std::mem::{Discriminant, discriminant};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_can::canopen::NodeId;
use takt_can::canopen::network::{
    AxisCommand, AxisFault, AxisPlan, Event, Network, NetworkConfig, NodePlan, Phase,
};
use takt_can::cia402::DriveFault;
use takt_can::cia402::proof::Objects;
use takt_can::linux::{Options, SocketCan};
use takt_rt::alloc::enter_real_time;
use takt_rt::cycle::{Cycles, Tick};
use takt_rt::interface::Medium;
use takt_rt::ring::{Consumer, Producer, ring};
use takt_rt::stats::{self, StatsReader};
use takt_rt::{Nanos, monotonic};

use crate::config::{CanopenConfig, LinkLoss};
use bus::{BusCounts, bus_figures};
use events::NetworkEvent;
use takt_can::link::CanLink;
use takt_can::load::{Load, LoadMeter, LoadReader};
use takt_core::Error;
use takt_core::device::DeviceDescription;
use takt_core::device::driver::{
    BusLoad, DeviceDriver, DriverEnds, DriverEvent, DriverThread, SHUTDOWN_MAX,
};
use takt_core::device::link_watch::{LinkErrors, LinkWatch};
use takt_device_drives::{self as drives, Arm, DriveJoint, Feedback, Recovery};

/// Cyclic synchronous position (6060h).
const CSP: i8 = 8;
/// Most frames received, and most service frames sent, in one cycle.
const FRAMES: usize = 256;
/// Limits of the master's heartbeat period: the default is not below the minimum, and 1016h cannot represent much
/// more than the maximum.
const HEARTBEAT_MIN: Duration = Duration::from_millis(20);
const HEARTBEAT_MAX: Duration = Duration::from_secs(20);
/// Capacity of the event queue.
const EVENTS_MAX: usize = 256;

/// The devices of a network: its arms.
#[must_use]
pub fn describe(config: &CanopenConfig) -> Vec<DeviceDescription> {
    let arms = config.arms.iter();
    arms.map(|arm| drives::describe(arm, "canopen_arm", bus_figures()))
        .collect()
}

/// Checks a configuration.
///
/// # Errors
/// With a text that names the finding.
pub fn check(config: &CanopenConfig) -> Result<(), String> {
    let name = &config.name;
    if !(Duration::from_millis(1)..=Duration::from_millis(100)).contains(&config.cycle) {
        return Err(format!(
            "{name}: cycle is {:?}; it must be 1ms to 100ms",
            config.cycle
        ));
    }
    if !AxisPlan::supports_period(config.cycle) {
        return Err(format!(
            "{name}: cycle is {:?}; drives support at most 255 times 1us, 10us, 100us or 1ms",
            config.cycle
        ));
    }
    for arm in &config.arms {
        let drive = |joint: &DriveJoint<u8>| match NodeId::new(joint.drive) {
            Ok(_) if joint.axis < 8 => Ok(()),
            Ok(_) => Err(format!("axis {}; a drive has axes 0 to 7", joint.axis)),
            Err(error) => Err(error.to_string()),
        };
        drives::check(arm, drive).map_err(|what| format!("{name}: {what}"))?;
    }
    network(config)
        .map(drop)
        .map_err(|what| format!("{name}: {what}"))
}

/// The configuration of a network's master. An axis has one PDO in each direction, with torques or with its mode, which suffices for
/// six axes at 1 Mbit/s and 2 ms.
fn network(config: &CanopenConfig) -> Result<Network, String> {
    let mut nodes: Vec<(NodeId, Vec<AxisPlan>)> = Vec::new();
    for joint in config.arms.iter().flat_map(|arm| &arm.joints) {
        let id = NodeId::new(joint.drive).map_err(|error| error.to_string())?;
        let axis = AxisPlan {
            axis: joint.axis,
            set_point_period: Some(config.cycle),
            on_link_loss: on_link_loss(config.on_link_loss),
            mode: joint.rated_torque.map(|_| CSP),
            not_mirrored: Objects::of(&joint.not_mirrored).unwrap_or_default(),
            options: joint.master_options(),
            ..AxisPlan::default()
        };
        match nodes.iter_mut().find(|(node, _)| *node == id) {
            Some((_, axes)) if axes.iter().any(|other| other.axis == axis.axis) => {
                return Err(format!("axis {} of node {id} drives two joints", axis.axis));
            }
            Some((_, axes)) => axes.push(axis),
            None => nodes.push((id, vec![axis])),
        }
    }
    let mut plans = Vec::new();
    for (id, axes) in nodes {
        let plan = NodePlan::drives(id, &axes).ok_or_else(|| {
            let count = axes.len();
            format!(
                "node {id} drives {count} joints; the fifth and later ones need the identifiers of the \
                 next node number"
            )
        });
        plans.push(plan?);
    }
    let network = NetworkConfig {
        heartbeat: heartbeat(config)?,
        ..NetworkConfig::default()
    };
    Network::new(network, plans).map_err(|error| error.to_string())
}

/// Node number and heartbeat of the master.
fn heartbeat(config: &CanopenConfig) -> Result<Option<(NodeId, Duration)>, String> {
    let master = NodeId::new(config.master).map_err(|error| format!("master: {error}"))?;
    let usual = (config.cycle * 5).max(HEARTBEAT_MIN);
    let period = config.heartbeat.unwrap_or(usual);
    if period.is_zero() {
        return Ok(None);
    }
    if !(config.cycle * 2..=HEARTBEAT_MAX).contains(&period) {
        return Err(format!(
            "heartbeat is {period:?}; it must be two cycles to {HEARTBEAT_MAX:?}, or zero for none"
        ));
    }
    Ok(Some((master, period)))
}

/// 6007h.
const fn on_link_loss(config: LinkLoss) -> Option<i16> {
    match config {
        LinkLoss::Nothing => Some(0),
        LinkLoss::Fault => Some(1),
        LinkLoss::DisableVoltage => Some(2),
        LinkLoss::QuickStop => Some(3),
        LinkLoss::AsSet => None,
    }
}

/// Opens the CAN interface of a network.
///
/// # Errors
/// If the interface does not exist or access is denied.
pub fn open(config: &CanopenConfig) -> Result<Box<dyn CanLink>, Error> {
    let options = Options {
        errors: false,
        ..Options::default()
    };
    let socket = SocketCan::open(&config.interface, &options).map_err(|source| Error::Device {
        name: config.name.clone(),
        what: format!("open {}", config.interface),
        source,
    })?;
    Ok(Box::new(socket))
}

/// Counters of a running network that other threads read.
#[derive(Debug, Default)]
struct Shared {
    received: AtomicU64,
    faults: AtomicU64,
    unproven: AtomicU64,
}

/// A running driver.
#[derive(Debug)]
pub struct Canopen {
    devices: Vec<String>,
    on_restart: Vec<String>,
    shared: Arc<Shared>,
    events: Mutex<Consumer<NetworkEvent>>,
    link: LinkWatch,
    load: LoadReader,
    /// Timing of SYNC.
    pub stats: StatsReader,
    thread: DriverThread,
}

impl Canopen {
    /// Starts the driver thread. The endpoints are those of the devices of [`describe`], in that order.
    ///
    /// # Errors
    /// If the configuration is invalid or the thread cannot be created.
    pub fn start(
        config: &CanopenConfig,
        link: Box<dyn CanLink>,
        ends: DriverEnds,
    ) -> Result<Self, Error> {
        check(config).map_err(Error::Cell)?;
        drives::report_quirks(&config.name, &config.arms);
        let network = network(config).map_err(Error::Cell)?;
        let devices = config.arms.iter().map(|arm| arm.name.clone()).collect();
        let held = config.arms.iter();
        let held = held.filter(|arm| arm.recovery == Recovery::OnRestart);
        let on_restart = held.map(|arm| arm.name.clone()).collect();
        let arms = config.arms.iter().zip(ends.devices).map(|(arm, end)| {
            let axes = arm.joints.iter().filter_map(|joint| {
                let node = NodeId::new(joint.drive).ok()?;
                Reached::new(&network, node, joint.axis)
            });
            let axes = axes.collect();
            (Arm::new(arm, config.cycle, end, bus_figures()), axes)
        });
        let arms = arms.collect();
        let (own_events, events) = ring(EVENTS_MAX);
        let shared = Arc::new(Shared::default());
        let (mut recorded, stats) = stats::pair();
        let watch = LinkWatch::new(&config.name, link.interface(), Medium::Can);
        let (meter, load) = LoadMeter::new(&*link, &config.name);
        let mut driver = Box::new(Driver {
            link,
            load: meter,
            errors: watch.errors(),
            network,
            arms,
            events: own_events,
            of_bus: bus::BusLoad::new(load.clone()),
            cycle: config.cycle,
            started: false,
            shared: Arc::clone(&shared),
            stop_by: None,
        });
        let CanopenConfig {
            name,
            priority,
            cpus,
            ..
        } = config;
        let (period, clock) = (config.cycle, ends.clock);
        let thread = DriverThread::start(name, *priority, cpus, move |stopping| {
            let scope = enter_real_time();
            Cycles::every(period).run(&mut recorded, |tick| {
                driver.cycle(tick, stopping.load(Ordering::Relaxed))
            });
            drop(scope);
            clock
        })?;
        Ok(Self {
            devices,
            on_restart,
            shared,
            events: Mutex::new(events),
            link: watch,
            load,
            stats,
            thread,
        })
    }
}

impl DeviceDriver for Canopen {
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
        let number = |figure: &AtomicU64| figure.load(Ordering::Relaxed).to_string();
        let mut figures = vec![
            ("received", number(&self.shared.received)),
            ("refused", self.link.failed().to_string()),
            ("troubles", number(&self.shared.faults)),
        ];
        if self.shared.unproven.load(Ordering::Relaxed) > 0 {
            figures.push(("axes not proven", number(&self.shared.unproven)));
        }
        figures
    }

    fn bus_loads(&self) -> Vec<BusLoad> {
        let of = |Load { last, most }| BusLoad {
            bus: self.load.bus().to_owned(),
            bit_rate: self.load.bit_rate(),
            bits_per_s: last,
            bits_per_s_max: most,
        };
        self.load.read().map(of).into_iter().collect()
    }

    fn is_held_after_faults(&self, device: &str) -> bool {
        self.on_restart.iter().any(|name| name == device)
    }

    fn stalls(&self) -> Option<&stats::StallReader> {
        Some(self.stats.stalls())
    }

    fn poll_event(&self) -> Option<DriverEvent> {
        if let Some(event) = self.link.poll(Instant::now()) {
            return Some(event);
        }
        let mut events = self.events.lock().unwrap_or_else(PoisonError::into_inner);
        let event = events.pop()?;
        Some(DriverEvent::new(event.severity(), event.to_string()))
    }
}

/// The kind of an axis fault, without its figures.
type Kind = (Discriminant<AxisFault>, Option<Discriminant<DriveFault>>);

fn kind(fault: &AxisFault) -> Kind {
    let drive_fault = if let AxisFault::Drive(drive_fault) = fault {
        // Resets repeat as long as the fault persists.
        let of_fault = matches!(drive_fault, DriveFault::ResetRefused(_));
        let drive_fault = if of_fault {
            &DriveFault::Fault
        } else {
            drive_fault
        };
        Some(discriminant(drive_fault))
    } else {
        None
    };
    (discriminant(fault), drive_fault)
}

/// Where the axis of a joint is in the network.
#[derive(Debug)]
struct Reached {
    node: NodeId,
    /// Index in the plan of its node.
    place: usize,
    /// Number in its drive.
    axis: u8,
    /// Kind of the fault reported last.
    reported: Option<Kind>,
    /// Duration of the proof reported last.
    proven: Option<Duration>,
}

impl Reached {
    fn new(network: &Network, node: NodeId, axis: u8) -> Option<Self> {
        let place = (0..NodePlan::AXES_MAX).find(|place| {
            let there = network.axis(node, *place);
            there.is_some_and(|there| there.plan().axis == axis)
        })?;
        Some(Self {
            node,
            place,
            axis,
            reported: None,
            proven: None,
        })
    }

    /// The event that its process data are proven, once per proof.
    fn proof(&mut self, network: &Network) -> Option<NetworkEvent> {
        let proof = network.axis(self.node, self.place)?.proof();
        let took = proof.took();
        let newly = took != std::mem::replace(&mut self.proven, took);
        let trusted = proof.taken_on_trust();
        let took = took.filter(|_| newly)?;
        Some(NetworkEvent::Proven(self.node, self.axis, took, trusted))
    }

    /// Its fault, if that changed since the last report.
    fn poll_event(&mut self, network: &Network) -> Option<NetworkEvent> {
        let fault = network.axis(self.node, self.place)?.fault();
        let kind = fault.as_ref().map(kind);
        let before = std::mem::replace(&mut self.reported, kind);
        // A node that is down is reported by an event of the node.
        let fault = fault.filter(|fault| *fault != AxisFault::NodeDown)?;
        (kind != before).then_some(NetworkEvent::Axis(self.node, self.axis, fault))
    }
}

struct Driver {
    link: Box<dyn CanLink>,
    load: LoadMeter,
    errors: Arc<LinkErrors>,
    network: Network,
    /// The arms, and the axis of each joint.
    arms: Vec<(Arm, Vec<Reached>)>,
    /// Events; unread ones are dropped.
    events: Producer<NetworkEvent>,
    of_bus: bus::BusLoad,
    cycle: Duration,
    started: bool,
    shared: Arc<Shared>,
    /// Deadline of the shutdown, once requested.
    stop_by: Option<Nanos>,
}

impl Driver {
    /// One cycle: SYNC and set-points first, then services and received frames until three quarters of the cycle are
    /// over, then the commands of the arms for the next cycle.
    fn cycle(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        self.load.poll(since_start(tick.scheduled));
        self.send_cycle(since_start(monotonic()));
        self.listen(tick.scheduled + Nanos::from(self.cycle * 3 / 4));
        self.lead(tick, stopping)
    }

    /// SYNC and set-points.
    fn send_cycle(&mut self, now: Duration) {
        if !self.started {
            self.started = true;
            self.network.start(now);
        }
        self.network.cycle(now);
        while let Some(frame) = self.network.poll_process() {
            self.send(frame);
        }
    }

    /// Reports events and steps the arms.
    fn lead(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        while let Some(event) = self.network.poll_event() {
            self.report(event);
        }
        let values = self.bus_values(tick);
        let mut unproven = 0;
        for (number, (arm, axes)) in self.arms.iter_mut().enumerate() {
            let network = &mut self.network;
            arm.report_bus(values);
            arm.cycle(tick, stopping, |joint, order| {
                lead(network, axes.get(joint)?, order)
            });
            while let Some((joint, event)) = arm.poll_event() {
                self.events
                    .push(NetworkEvent::Joint(number, joint, event))
                    .ok();
            }
            for axis in axes {
                if let Some(event) = axis.proof(network) {
                    self.events.push(event).ok();
                }
                unproven += u64::from(axis.proven.is_none());
            }
        }
        self.shared.unproven.store(unproven, Ordering::Relaxed);
        self.end(tick, stopping)
    }

    /// The figures of the bus in this cycle.
    fn bus_values(&self, tick: &Tick) -> [Option<f64>; bus::COUNT] {
        let count = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let counts = BusCounts {
            received: count(&self.shared.received),
            failed: self.errors.failed(),
            faults: count(&self.shared.faults),
            unproven: count(&self.shared.unproven),
            events: self.events.offered(),
        };
        self.of_bus.values(&counts, tick)
    }

    fn report(&mut self, event: Event) {
        let event = match event {
            Event::Phase(node, Phase::Running) => NetworkEvent::Runs(node),
            Event::Fault(node, fault) => {
                self.shared.faults.fetch_add(1, Ordering::Relaxed);
                NetworkEvent::Fault(node, fault)
            }
            Event::Emergency(node, emergency, count) => {
                NetworkEvent::Emergency(node, emergency, count)
            }
            Event::Axis(node) => return self.report_axes(node),
            Event::Phase(..) | Event::Homed(_) | Event::Transferred(..) => return,
        };
        self.events.push(event).ok();
    }

    fn report_axes(&mut self, node: NodeId) {
        let axes = self.arms.iter_mut().flat_map(|(_, axes)| axes);
        for axis in axes.filter(|axis| axis.node == node) {
            if let Some(event) = axis.poll_event(&self.network) {
                self.events.push(event).ok();
            }
        }
    }

    fn listen(&mut self, until: Nanos) {
        for _ in 0..FRAMES {
            let now = monotonic();
            if let Some(frame) = self.network.poll_service(since_start(now)) {
                self.send(frame);
            }
            if now >= until {
                return;
            }
            // A received answer can release new service frames; timers wait until the next cycle.
            let received = match self.link.receive(since_start(until - now)) {
                Ok(Some(received)) => received,
                Ok(None) => return,
                Err(error) => return self.errors.note(error.errno()),
            };
            self.load.add(&received.frame);
            if let Some(frame) = received.frame.classic() {
                self.shared.received.fetch_add(1, Ordering::Relaxed);
                self.network.handle_frame(frame, received.at);
            }
        }
    }

    fn send(&mut self, frame: takt_can::Frame) {
        let frame = frame.into();
        match self.link.send(&frame) {
            Ok(()) => self.load.add(&frame),
            Err(error) => self.errors.note(error.errno()),
        }
    }

    fn end(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        if !stopping {
            return ControlFlow::Continue(());
        }
        let now = tick.scheduled;
        let end = *self
            .stop_by
            .get_or_insert_with(|| now + SHUTDOWN_MAX.into());
        if now >= end || self.arms.iter().all(|(arm, _)| arm.is_off()) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

/// Commands an axis and returns its feedback. A past fault of its node does not count.
fn lead(network: &mut Network, reached: &Reached, order: drives::Order) -> Option<Feedback> {
    let running = network.phase(reached.node) == Some(Phase::Running);
    let axis = network.axis_mut(reached.node, reached.place)?;
    if let Some(goal) = order.goal {
        axis.set_goal(goal, CSP);
    }
    if order.reset {
        axis.reset_fault();
    }
    let state = *axis.state();
    // An axis that follows keeps the target sent last, not its current position: the latter would give way to any
    // load.
    let position = match order.target {
        None if state.follows => axis.commanded().position,
        target => target.unwrap_or(state.position),
    };
    axis.command(AxisCommand {
        position,
        torque_offset: order.torque_offset,
        ..AxisCommand::default()
    });
    let has_torques = axis.plan().mode.is_some();
    let refused = axis.proof().fault().is_some();
    Some(Feedback {
        refused,
        is_homing: false,
        online: running && state.missing <= MISSING_MAX && state.status != Default::default(),
        follows: state.follows,
        state: state.status.state().ok(),
        status: Some(state.status),
        increments: state.position,
        torque: has_torques.then_some(state.torque),
    })
}

/// SYNCs without an answer after which a drive counts as lost.
const MISSING_MAX: u32 = 3;

/// Monotonic time as the protocol counts it; zero before its start.
fn since_start(time: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(time.0).unwrap_or_default())
}

#[cfg(test)]
mod torque_tests;
#[cfg(test)]
mod wire_tests;
