//! The driver of a CANopen network: one thread that sends SYNC and set-points each cycle, hears between two of
//! them, and leads the arms on the network. Start-up, supervision and SDO transfers, which never delay a cycle,
//! are in `takt_can::canopen::network`.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use takt_can::canopen::NodeId;
use takt_can::canopen::network::{AxisCommand, AxisPlan, Event, Network, NetworkConfig, NodePlan};
use takt_can::linux::{Options, SocketCan};
use takt_rt::alloc::enter_real_time;
use takt_rt::cycle::{Cycles, Tick};
use takt_rt::stats::{self, StatsReader};
use takt_rt::{Nanos, monotonic};

use crate::cell::{CanopenConfig, DriveJoint};
use crate::device::DeviceDescription;
use crate::device::driver::{DeviceDriver, DriverEnds, DriverThread};
use crate::device::drives::{self, Arm, Feedback};
use crate::device::rmp::CanLink;
use crate::error::Error;

/// Cyclic synchronous position (6060h).
const CSP: i8 = 8;
/// Cycles in which drives may brake and be switched off before the thread ends.
const FAREWELL: u32 = 500;
/// Frames taken, and service frames sent, in one cycle at most.
const FRAMES: usize = 256;

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

/// The master of a network. A node has one PDO each way, which leaves room for six axes at 1 Mbit/s and 2 ms.
fn network(config: &CanopenConfig) -> Result<Network, String> {
    let mut plans: Vec<NodePlan> = Vec::new();
    for joint in config.arms.iter().flat_map(|arm| &arm.joints) {
        let Ok(id) = NodeId::new(joint.drive) else {
            continue;
        };
        if plans.iter().any(|plan| plan.id == id) {
            return Err(format!(
                "node {id} drives two joints; multi-axis drives go by EtherCAT"
            ));
        }
        let axis = AxisPlan {
            axis: joint.axis,
            ..AxisPlan::default()
        };
        let mut plan = NodePlan::drive(id, axis);
        plan.rpdos.truncate(1);
        plan.tpdos.truncate(1);
        plans.push(plan);
    }
    Network::new(NetworkConfig::default(), plans).map_err(|error| error.to_string())
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

/// Figures of a network that others read while it runs.
#[derive(Debug, Default)]
struct Shared {
    received: AtomicU64,
    refused: AtomicU64,
    troubles: AtomicU64,
}

/// A running driver.
#[derive(Debug)]
pub struct Canopen {
    devices: Vec<String>,
    shared: Arc<Shared>,
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
        let network = network(config).map_err(Error::Cell)?;
        let devices = config.arms.iter().map(|arm| arm.name.clone()).collect();
        let arms = config.arms.iter().zip(ends.devices).map(|(arm, end)| {
            let axes = arm.joints.iter();
            let axes = axes
                .filter_map(|joint| NodeId::new(joint.drive).ok())
                .collect();
            (Arm::new(arm, config.cycle, end), axes)
        });
        let shared = Arc::new(Shared::default());
        let (mut recorded, stats) = stats::pair();
        let mut driver = Box::new(Driver {
            link,
            network,
            arms: arms.collect(),
            cycle: config.cycle,
            started: false,
            shared: Arc::clone(&shared),
            farewell: FAREWELL,
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
            shared,
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
        vec![
            ("received", number(&self.shared.received)),
            ("refused", number(&self.shared.refused)),
            ("troubles", number(&self.shared.troubles)),
        ]
    }
}

struct Driver {
    link: Box<dyn CanLink>,
    network: Network,
    /// The arms, and by joint the node of its axis.
    arms: Vec<(Arm, Vec<NodeId>)>,
    cycle: Duration,
    started: bool,
    shared: Arc<Shared>,
    /// Cycles left once it is to stop.
    farewell: u32,
}

impl Driver {
    /// One cycle: SYNC and set-points at once, then services and whatever comes until three quarters of it are
    /// over, then what the arms are to do in the next.
    fn cycle(&mut self, tick: &Tick, stopping: bool) -> ControlFlow<()> {
        let now = since_start(monotonic());
        if !self.started {
            self.started = true;
            self.network.start(now);
        }
        self.network.cycle(now);
        while let Some(frame) = self.network.poll_process() {
            self.send(frame);
        }
        self.listen(tick.scheduled + Nanos::from(self.cycle * 3 / 4));
        while let Some(event) = self.network.poll_event() {
            if matches!(event, Event::Trouble(..)) {
                self.shared.troubles.fetch_add(1, Ordering::Relaxed);
            }
        }
        for (arm, nodes) in &mut self.arms {
            let network = &mut self.network;
            arm.cycle(tick, stopping, |joint, order| {
                lead(network, *nodes.get(joint)?, order)
            });
        }
        self.end(stopping)
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
            let Ok(Some(received)) = self.link.receive(since_start(until - now)) else {
                return;
            };
            if let Some(frame) = received.frame.classic() {
                self.shared.received.fetch_add(1, Ordering::Relaxed);
                self.network.handle_frame(frame, received.at);
            }
        }
    }

    fn send(&mut self, frame: takt_can::Frame) {
        if self.link.send(&frame.into()).is_err() {
            self.shared.refused.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn end(&mut self, stopping: bool) -> ControlFlow<()> {
        self.farewell -= u32::from(stopping);
        let off = self.arms.iter().all(|(arm, _)| arm.is_off());
        if stopping && (off || self.farewell == 0) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    }
}

/// Gives an order to the first axis of a node, and says how that is.
fn lead(network: &mut Network, node: NodeId, order: drives::Order) -> Option<Feedback> {
    let running = network.trouble(node).is_none();
    let axis = network.axis_mut(node, 0)?;
    if let Some(goal) = order.goal {
        axis.set_goal(goal, CSP);
    }
    if order.reset {
        axis.reset_fault();
    }
    let state = *axis.state();
    axis.command(AxisCommand {
        position: order.target.unwrap_or(state.position),
        ..AxisCommand::default()
    });
    Some(Feedback {
        online: running && state.missing <= MISSING_MAX && state.status != Default::default(),
        follows: state.follows,
        increments: state.position,
    })
}

/// SYNCs without an answer after which a drive counts as gone.
const MISSING_MAX: u32 = 3;

/// Time on the monotonic clock as the protocol counts it; zero before its start.
fn since_start(time: Nanos) -> Duration {
    Duration::from_nanos(u64::try_from(time.0).unwrap_or_default())
}
