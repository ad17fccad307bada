//! The driver of a CANopen network: one thread that sends SYNC and set-points each cycle, hears between two of
//! them, and leads the arms on the network. Start-up, supervision and SDO transfers, which never delay a cycle,
//! are in `takt_can::canopen::network`.

use std::fmt;
use std::mem::{Discriminant, discriminant};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use takt_can::canopen::network::{
    AxisCommand, AxisFault, AxisPlan, Event, Network, NetworkConfig, NodeFault, NodePlan, Phase,
};
use takt_can::canopen::{Emergency, NodeId};
use takt_can::cia402::DriveFault;
use takt_can::cia402::proof::Objects;
use takt_can::linux::{Options, SocketCan};
use takt_rt::alloc::enter_real_time;
use takt_rt::cycle::{Cycles, Tick};
use takt_rt::interface::Medium;
use takt_rt::ring::{Consumer, Producer, ring};
use takt_rt::stats::{self, StatsReader};
use takt_rt::{Nanos, monotonic};

use crate::device::DeviceDescription;
use crate::device::config::{CanopenConfig, DriveJoint, LinkLoss, Recovery};
use crate::device::driver::{DeviceDriver, DriverEnds, DriverThread, FAREWELL, Notice, Severity};
use crate::device::drives::{self, Arm, Feedback, JointNews};
use crate::device::link_watch::{LinkErrors, LinkWatch};
use crate::device::rmp::CanLink;
use crate::error::Error;

/// Cyclic synchronous position (6060h).
const CSP: i8 = 8;
/// Frames taken, and service frames sent, in one cycle at most.
const FRAMES: usize = 256;
/// Heartbeats of the master: not oftener unless asked, and as rarely as 1016h can tell.
const HEARTBEAT_MIN: Duration = Duration::from_millis(20);
const HEARTBEAT_MAX: Duration = Duration::from_secs(20);
/// What waits to be told.
const NEWS: usize = 256;

/// The devices of a network: its arms.
#[must_use]
pub fn describe(config: &CanopenConfig) -> Vec<DeviceDescription> {
    let arms = config.arms.iter();
    arms.map(|arm| drives::describe(arm, "canopen_arm"))
        .collect()
}

/// What is wrong with a configuration.
///
/// # Errors
/// A text that names it.
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
            "{name}: cycle is {:?}; drives can be told at most 255 of 1us, 10us, 100us or 1ms",
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

/// The master of a network. An axis has one PDO each way, which leaves room for six axes at 1 Mbit/s and 2 ms.
fn network(config: &CanopenConfig) -> Result<Network, String> {
    let mut nodes: Vec<(NodeId, Vec<AxisPlan>)> = Vec::new();
    for joint in config.arms.iter().flat_map(|arm| &arm.joints) {
        let id = NodeId::new(joint.drive).map_err(|error| error.to_string())?;
        let axis = AxisPlan {
            axis: joint.axis,
            set_point_period: Some(config.cycle),
            on_link_loss: on_link_loss(config.on_link_loss),
            not_mirrored: Objects::of(&joint.not_mirrored).unwrap_or_default(),
            patience: joint.patience(),
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
                "node {id} drives {count} joints; from the fifth on they need the identifiers of the \
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

/// Number and heartbeat of the master.
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
/// If there is no such interface or no right to open it.
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

/// What is told of a network.
#[derive(Debug)]
enum News {
    Runs(NodeId),
    Trouble(NodeId, NodeFault),
    Emergency(NodeId, Emergency, u32),
    /// Of the axis of that number in its drive.
    Axis(NodeId, u8, AxisFault),
    /// The process data of an axis are proven, but for these.
    Proven(NodeId, u8, Duration, Objects),
    /// Of a joint of an arm, in their order.
    Joint(usize, usize, JointNews),
}

impl News {
    /// How much it matters.
    const fn severity(&self) -> Severity {
        match self {
            Self::Runs(_) | Self::Proven(..) => Severity::Info,
            // Error code 0000h takes an emergency back.
            Self::Emergency(_, emergency, _) if emergency.code == 0 => Severity::Info,
            Self::Trouble(_, NodeFault::Garbled { .. } | NodeFault::PdoShort { .. })
            | Self::Joint(_, _, JointNews::OutOfRange { .. }) => Severity::Warning,
            Self::Trouble(..)
            | Self::Emergency(..)
            | Self::Axis(..)
            | Self::Joint(_, _, JointNews::Runaway(_)) => Severity::Error,
        }
    }
}

impl fmt::Display for News {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Runs(node) => write!(f, "node {node}: it runs"),
            Self::Trouble(node, trouble) => write!(f, "node {node}: {trouble}"),
            Self::Emergency(node, emergency, 1) => {
                write!(f, "node {node}: {}", NodeFault::Emergency(*emergency))
            }
            Self::Emergency(node, emergency, count) => write!(
                f,
                "node {node}: {count} emergencies, the last of them: {}",
                NodeFault::Emergency(*emergency)
            ),
            Self::Axis(node, axis, trouble) => write!(f, "node {node}, axis {axis}: {trouble}"),
            Self::Proven(node, axis, took, trusted) => {
                let proven = drives::proven(*took, *trusted);
                write!(f, "node {node}, axis {axis}: {proven}")
            }
            Self::Joint(arm, joint, news) => write!(f, "arm {arm}, joint {joint}: {news}"),
        }
    }
}

/// Figures of a network that others read while it runs.
#[derive(Debug, Default)]
struct Shared {
    received: AtomicU64,
    troubles: AtomicU64,
    unproven: AtomicU64,
}

/// A running driver.
#[derive(Debug)]
pub struct Canopen {
    devices: Vec<String>,
    on_restart: Vec<String>,
    shared: Arc<Shared>,
    news: Mutex<Consumer<News>>,
    link: LinkWatch,
    /// How SYNC keeps its time.
    pub stats: StatsReader,
    thread: DriverThread,
}

impl Canopen {
    /// Starts the driver thread. The ends are those of the devices of [`describe`], in that order.
    ///
    /// # Errors
    /// If the configuration makes no sense or the system has no thread to give.
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
            (Arm::new(arm, config.cycle, end), axes)
        });
        let arms = arms.collect();
        let (own_news, news) = ring(NEWS);
        let shared = Arc::new(Shared::default());
        let (mut recorded, stats) = stats::pair();
        let watch = LinkWatch::new(&config.name, link.interface(), Medium::Can);
        let mut driver = Box::new(Driver {
            link,
            errors: watch.errors(),
            network,
            arms,
            news: own_news,
            cycle: config.cycle,
            started: false,
            shared: Arc::clone(&shared),
            farewell: None,
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
            news: Mutex::new(news),
            link: watch,
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
            ("troubles", number(&self.shared.troubles)),
        ];
        if self.shared.unproven.load(Ordering::Relaxed) > 0 {
            figures.push(("axes not proven", number(&self.shared.unproven)));
        }
        figures
    }

    fn is_held_after_faults(&self, device: &str) -> bool {
        self.on_restart.iter().any(|name| name == device)
    }

    fn stalls(&self) -> Option<&stats::StallReader> {
        Some(self.stats.stalls())
    }

    fn news(&self) -> Option<Notice> {
        if let Some(notice) = self.link.poll(Instant::now()) {
            return Some(notice);
        }
        let mut news = self.news.lock().unwrap_or_else(PoisonError::into_inner);
        news.pop().map(|news| Notice {
            severity: news.severity(),
            text: news.to_string(),
        })
    }
}

/// What a trouble of an axis is, whatever its figures are.
type Kind = (Discriminant<AxisFault>, Option<Discriminant<DriveFault>>);

fn kind(trouble: &AxisFault) -> Kind {
    let drive_fault = if let AxisFault::Drive(drive_fault) = trouble {
        // Resets go on as long as the fault does.
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
    (discriminant(trouble), drive_fault)
}

/// Where the axis of a joint is in the network.
#[derive(Debug)]
struct Reached {
    node: NodeId,
    /// In the plan of its node.
    place: usize,
    /// In its drive.
    axis: u8,
    /// What was told of it last.
    told: Option<Kind>,
    /// How long the proof took that was reported last.
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
            told: None,
            proven: None,
        })
    }

    /// That its process data are proven, once each time.
    fn proof(&mut self, network: &Network) -> Option<News> {
        let proof = network.axis(self.node, self.place)?.proof();
        let took = proof.took();
        let newly = took != std::mem::replace(&mut self.proven, took);
        let trusted = proof.taken_on_trust();
        let took = took.filter(|_| newly)?;
        Some(News::Proven(self.node, self.axis, took, trusted))
    }

    /// What is to be told of it, once each time that it comes to be so.
    fn news(&mut self, network: &Network) -> Option<News> {
        let trouble = network.axis(self.node, self.place)?.fault();
        let kind = trouble.as_ref().map(kind);
        let before = std::mem::replace(&mut self.told, kind);
        // That its node is down is told of the node.
        let trouble = trouble.filter(|trouble| *trouble != AxisFault::NodeDown)?;
        (kind != before).then_some(News::Axis(self.node, self.axis, trouble))
    }
}

struct Driver {
    link: Box<dyn CanLink>,
    errors: Arc<LinkErrors>,
    network: Network,
    /// The arms, and by joint its axis.
    arms: Vec<(Arm, Vec<Reached>)>,
    /// What is told; if nobody takes it, it is lost.
    news: Producer<News>,
    cycle: Duration,
    started: bool,
    shared: Arc<Shared>,
    /// When it ends at the latest, once it is to stop.
    farewell: Option<Nanos>,
}

impl Driver {
    /// One cycle: SYNC and set-points at once, then services and whatever comes until three quarters of it are
    /// over, then what the arms are to do in the next.
    fn cycle(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
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

    /// Reports what happened and leads the arms on.
    fn lead(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        while let Some(event) = self.network.poll_event() {
            self.tell(event);
        }
        let mut unproven = 0;
        for (number, (arm, axes)) in self.arms.iter_mut().enumerate() {
            let network = &mut self.network;
            arm.cycle(tick, stopping, |joint, order| {
                lead(network, axes.get(joint)?, order)
            });
            while let Some((joint, news)) = arm.poll_news() {
                self.news.push(News::Joint(number, joint, news)).ok();
            }
            for axis in axes {
                if let Some(news) = axis.proof(network) {
                    self.news.push(news).ok();
                }
                unproven += u64::from(axis.proven.is_none());
            }
        }
        self.shared.unproven.store(unproven, Ordering::Relaxed);
        self.end(tick, stopping)
    }

    fn tell(&mut self, event: Event) {
        let news = match event {
            Event::Phase(node, Phase::Running) => News::Runs(node),
            Event::Fault(node, trouble) => {
                self.shared.troubles.fetch_add(1, Ordering::Relaxed);
                News::Trouble(node, trouble)
            }
            Event::Emergency(node, emergency, count) => News::Emergency(node, emergency, count),
            Event::Axis(node) => return self.tell_axes(node),
            Event::Phase(..) | Event::Homed(_) | Event::Transferred(..) => return,
        };
        self.news.push(news).ok();
    }

    fn tell_axes(&mut self, node: NodeId) {
        let axes = self.arms.iter_mut().flat_map(|(_, axes)| axes);
        for axis in axes.filter(|axis| axis.node == node) {
            if let Some(news) = axis.news(&self.network) {
                self.news.push(news).ok();
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
            // Services have something new to send when an answer came; timers wait until the next cycle.
            let received = match self.link.receive(since_start(until - now)) {
                Ok(Some(received)) => received,
                Ok(None) => return,
                Err(error) => return self.errors.note_can(error),
            };
            if let Some(frame) = received.frame.classic() {
                self.shared.received.fetch_add(1, Ordering::Relaxed);
                self.network.handle_frame(frame, received.at);
            }
        }
    }

    fn send(&mut self, frame: takt_can::Frame) {
        if let Err(error) = self.link.send(&frame.into()) {
            self.errors.note_can(error);
        }
    }

    fn end(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        if !stopping {
            return ControlFlow::Continue(());
        }
        let now = tick.scheduled;
        let end = *self.farewell.get_or_insert_with(|| now + FAREWELL.into());
        if now >= end || self.arms.iter().all(|(arm, _)| arm.is_off()) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

/// Gives an order to an axis, and says how that is. A trouble of its node that is over does not count.
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
    // One that follows goes where it was sent last, not where it happens to be: that would give way to any load.
    let position = match order.target {
        None if state.follows => None,
        target => Some(target.unwrap_or(state.position)),
    };
    if let Some(position) = position {
        axis.command(AxisCommand {
            position,
            ..AxisCommand::default()
        });
    }
    let refused = axis.proof().fault().is_some();
    Some(Feedback {
        refused,
        online: running && state.missing <= MISSING_MAX && state.status != Default::default(),
        follows: state.follows,
        state: state.status.state().ok(),
        increments: state.position,
    })
}

/// SYNCs without an answer after which a drive counts as gone.
const MISSING_MAX: u32 = 3;

/// Time on the monotonic clock as the protocol counts it; zero before its start.
fn since_start(time: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(time.0).unwrap_or_default())
}

#[cfg(test)]
mod wire_tests;
