//! A bus within the process with emulated devices on it, in virtual time: what the commands are tested
//! against. It is not there outside of tests.

use std::time::Duration;

use takt_can::Frame;
use takt_can::bus::{Bus, Config, PortId};
use takt_can::canopen::NodeId;
use takt_can::canopen::emulator::{DriveNode, DriveNodeConfig};
use takt_can::rmp::emulator::{Powerbase, PowerbaseConfig};

use super::wire::Wire;

/// How finely devices are served.
const TICK: Duration = Duration::from_micros(250);

/// A device.
#[derive(Debug)]
pub(super) enum Device {
    Drive(Box<DriveNode>),
    Rmp(Box<Powerbase>),
    /// Unplugged.
    Nothing,
}

/// What is done to the lab at a time.
type Deed = Box<dyn FnOnce(&mut Vec<Device>)>;

/// The bus, the tool's place at it, and the devices.
pub(super) struct Lab {
    pub(super) bus: Bus,
    own: PortId,
    ports: Vec<PortId>,
    pub(super) devices: Vec<Device>,
    /// When somebody presses Ctrl-C.
    pub(super) stop_at: Option<Duration>,
    /// What happens when, in the order of time.
    deeds: Vec<(Duration, Deed)>,
    /// Every frame that the tool sent.
    pub(super) sent: Vec<(Duration, Frame)>,
    /// Frames of a stranger, one after the other.
    pub(super) stranger: Vec<(Duration, Frame)>,
    stranger_port: PortId,
    /// What becomes of frames of devices on their way.
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
        let (own, stranger_port) = (bus.attach(), bus.attach());
        Self {
            bus,
            own,
            ports: Vec::new(),
            devices: Vec::new(),
            stop_at: None,
            deeds: Vec::new(),
            sent: Vec::new(),
            stranger: Vec::new(),
            stranger_port,
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

    /// The drive that was added as that number, from 0.
    pub(super) fn drive(&mut self, at: usize) -> &mut DriveNode {
        drive(&mut self.devices, at)
    }

    pub(super) fn rmp(&mut self, at: usize) -> &mut Powerbase {
        rmp(&mut self.devices, at)
    }

    /// Does something at a time.
    pub(super) fn at(&mut self, ms: u64, deed: impl FnOnce(&mut Vec<Device>) + 'static) {
        self.deeds.push((Duration::from_millis(ms), Box::new(deed)));
        self.deeds.sort_by_key(|(at, _)| *at);
    }

    /// Lets time pass with nobody at the tool.
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
        while self.deeds.first().is_some_and(|(at, _)| *at <= now) {
            let (_, deed) = self.deeds.remove(0);
            deed(&mut self.devices);
        }
        while self.stranger.first().is_some_and(|(at, _)| *at <= now) {
            let (_, frame) = self.stranger.remove(0);
            self.bus
                .send(self.stranger_port, &frame.into(), now)
                .unwrap();
        }
        while self.bus.receive(self.stranger_port).is_some() {}
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
