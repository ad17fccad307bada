//! A bus within the process with emulated devices on it, in virtual time, for the tests of the commands.

use std::time::Duration;

use takt_can::Frame;
use takt_can::bus::{Bus, Config, PortId};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};

use super::wire::Wire;

/// Time step of the devices.
const TICK: Duration = Duration::from_micros(250);

/// A device.
#[derive(Debug)]
pub(super) enum Device {
    Drive(Box<DriveNode>),
    Rmp(Box<Powerbase>),
    /// Unplugged.
    Nothing,
}

/// A change of the devices at a time.
type Change = Box<dyn FnOnce(&mut Vec<Device>)>;

/// The bus, the port of the tool, and the devices.
pub(super) struct Lab {
    pub(super) bus: Bus,
    own: PortId,
    ports: Vec<PortId>,
    pub(super) devices: Vec<Device>,
    /// When the user presses Ctrl-C.
    pub(super) stop_at: Option<Duration>,
    /// Changes in the order of time.
    changes: Vec<(Duration, Change)>,
    /// Every frame that the tool sent.
    pub(super) sent: Vec<(Duration, Frame)>,
    /// Frames of another master, in the order of time.
    pub(super) other_master: Vec<(Duration, Frame)>,
    other_port: PortId,
    /// Replaces frames of devices.
    pub(super) tamper: fn(Frame) -> Frame,
}

pub(super) fn node(raw: u8) -> NodeId {
    NodeId::new(raw).unwrap()
}

impl Lab {
    pub(super) fn new() -> Self {
        let mut bus = Bus::new(Config {
            send_queue: 512,
            ..Config::default()
        });
        let (own, other_port) = (bus.attach(), bus.attach());
        Self {
            bus,
            own,
            ports: Vec::new(),
            devices: Vec::new(),
            stop_at: None,
            changes: Vec::new(),
            sent: Vec::new(),
            other_master: Vec::new(),
            other_port,
            tamper: |frame| frame,
        }
    }

    /// A lab with plain drives of these numbers.
    pub(super) fn of_drives(numbers: &[u8]) -> Self {
        let mut lab = Self::new();
        for number in numbers {
            lab.add_drive(DriveNodeConfig::new(node(*number)));
        }
        lab
    }

    pub(super) fn add_drive(&mut self, config: DriveNodeConfig) {
        let drive = DriveNode::power_on(config, self.bus.now()).unwrap();
        self.add(Device::Drive(Box::new(drive)));
    }

    pub(super) fn add_rmp(&mut self, config: PowerbaseConfig) {
        self.add(Device::Rmp(Box::new(Powerbase::new(config))));
    }

    fn add(&mut self, device: Device) {
        self.devices.push(device);
        self.ports.push(self.bus.attach());
    }

    /// The device at this index, a drive.
    pub(super) fn drive(&mut self, at: usize) -> &mut DriveNode {
        drive(&mut self.devices, at)
    }

    pub(super) fn rmp(&mut self, at: usize) -> &mut Powerbase {
        rmp(&mut self.devices, at)
    }

    /// Changes the devices at a time.
    pub(super) fn at(&mut self, ms: u64, change: impl FnOnce(&mut Vec<Device>) + 'static) {
        self.changes
            .push((Duration::from_millis(ms), Box::new(change)));
        self.changes.sort_by_key(|(at, _)| *at);
    }

    /// Runs without the tool.
    pub(super) fn run(&mut self, ms: u64) {
        let until = self.now() + Duration::from_millis(ms);
        while self.now() < until {
            self.step(until);
            while self.bus.receive(self.own).is_some() {}
        }
    }

    fn step(&mut self, until: Duration) {
        let now = (self.bus.now() + TICK).min(until);
        self.bus.advance(now);
        while self.changes.first().is_some_and(|(at, _)| *at <= now) {
            let (_, change) = self.changes.remove(0);
            change(&mut self.devices);
        }
        while self.other_master.first().is_some_and(|(at, _)| *at <= now) {
            let (_, frame) = self.other_master.remove(0);
            self.bus.send(self.other_port, &frame.into(), now).unwrap();
        }
        while self.bus.receive(self.other_port).is_some() {}
        for (port, device) in self.ports.iter().zip(&mut self.devices) {
            serve(&mut self.bus, *port, device, now);
        }
    }
}

pub(super) fn drive(devices: &mut [Device], at: usize) -> &mut DriveNode {
    match &mut devices[at] {
        Device::Drive(drive) => drive,
        Device::Rmp(_) | Device::Nothing => panic!("device {at} is no drive"),
    }
}

pub(super) fn rmp(devices: &mut [Device], at: usize) -> &mut Powerbase {
    match &mut devices[at] {
        Device::Rmp(rmp) => rmp,
        Device::Drive(_) | Device::Nothing => panic!("device {at} is no power base"),
    }
}

fn serve(bus: &mut Bus, port: PortId, device: &mut Device, now: Duration) {
    while let Some(received) = bus.receive(port) {
        let Some(frame) = received.frame.classic() else {
            continue;
        };
        match device {
            Device::Drive(drive) => drive.handle_frame(frame, now),
            Device::Rmp(rmp) => rmp.handle_frame(frame, now),
            Device::Nothing => {}
        }
    }
    loop {
        let frame = match device {
            Device::Drive(drive) => drive.poll_transmit(now),
            Device::Rmp(rmp) => rmp.poll_transmit(now).map(|(_, frame)| frame),
            Device::Nothing => None,
        };
        let Some(frame) = frame else {
            return;
        };
        bus.send(port, &frame.into(), now).unwrap();
    }
}

impl Wire for Lab {
    fn now(&self) -> Duration {
        self.bus.now()
    }

    fn send(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let now = self.bus.now();
        self.sent.push((now, *frame));
        Ok(self.bus.send(self.own, &(*frame).into(), now)?)
    }

    fn receive(&mut self, timeout: Duration) -> anyhow::Result<Option<Frame>> {
        let until = self.now().saturating_add(timeout);
        loop {
            if let Some(received) = self.bus.receive(self.own) {
                return Ok(received.frame.classic().copied().map(self.tamper));
            }
            if self.now() >= until {
                return Ok(None);
            }
            self.step(until);
        }
    }

    fn is_stopped(&self) -> bool {
        self.stop_at.is_some_and(|at| self.now() >= at)
    }
}
