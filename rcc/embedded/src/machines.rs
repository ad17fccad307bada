//! The emulated machines of a cell, each in a thread of its own. They speak the wire protocol of the real ones.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use takt_core::device::DeviceStatus;
use takt_core::{CellConfig, Controller};
use takt_devices::ethercat::{self, Ethercat, EthercatConfig, Wire};
use takt_devices::fri::emulator::{Robot, holding_program, local, resting, tolerant_timing};
use takt_devices::fri::{IiwaConfig, LwrConfig};
use takt_devices::wsg::emulator::{Gripper, GripperConfig, Port};
use takt_ethercat::emulator::{
    Coupler, DriveHandle, Segment, Server, ServoConfig, ServoDrive, SharedSegment, Station,
    StationMotor, YouBot, YouBotConfig,
};
use takt_ethercat::linux::{cable, monotonic};
use takt_fri::lwr::emulator::{Contact, Krc, Script, Shape};
use takt_fri::sunrise::emulator::{Cabinet, CabinetConfig};
use takt_rt::Nanos;
use takt_rt::stats::stalls;
use takt_rt::thread::{Stoppable, ThreadConfig};

use crate::cell::EmulatedCell;
use crate::error::Error;
use crate::surroundings::{CellWorld, Wheeled};

/// Shortest time from one measurement of an emulated LWR to the next.
const LWR_PERIOD: Duration = Duration::from_millis(1);
/// Frame of a cell where its emulated table is.
const TABLE: &str = "table";
/// Stiffness of the table, N/m.
const TABLE_STIFFNESS: f64 = 10_000.0;
/// Damping of the table, Ns/m.
const TABLE_DAMPING: f64 = 100.0;
/// Digital output of the arm, from 0, that takes the table away while it is true.
const TABLE_OFF: u32 = 0;
/// Address of the master in a segment that has no other.
const MASTER: [u8; 6] = [2, 0, 0, 0, 0, 1];
/// Longest wait of an emulated segment for a frame, so that a stop is seen soon.
const WAIT: Duration = Duration::from_millis(5);
/// A turn of this length counts as a stall: its wait, and four cycles of the segments.
const STALL: Nanos = Nanos::from_millis(13);
/// Above drivers: the real device has a processor of its own.
const PRIORITY: u8 = 88;

/// A thread that serves an emulated device.
type Service = Stoppable<io::Result<()>>;

/// The emulated machines of a cell. They are stopped after their controller, so that their end is no fault.
#[derive(Default)]
pub struct Machines {
    krcs: Vec<(String, Robot)>,
    cabinets: Vec<(String, Robot<Cabinet>)>,
    services: Vec<(String, Service)>,
    wheels: Vec<DriveHandle>,
    station: Option<Station>,
    /// Arms that have power while a net requests it.
    on_request: Vec<String>,
}

impl fmt::Debug for Machines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = self.services.iter().map(|(name, _)| name);
        let names = names.chain(self.krcs.iter().map(|(name, _)| name));
        let names = names.chain(self.cabinets.iter().map(|(name, _)| name));
        f.debug_list().entries(names).finish()
    }
}

impl Machines {
    /// Starts them; this share of the datagrams of each LWR is lost in each direction, 0 to 1.
    ///
    /// # Errors
    /// If the system refuses a thread or socket, or the controller a segment.
    pub fn start(controller: &Controller, cell: EmulatedCell, drop: f64) -> Result<Self, Error> {
        let mut machines = Self::default();
        let world = cell.world.as_ref();
        for (seed, (name, address)) in (1..).zip(controller.waits_at()) {
            machines.arm(&cell.config, world, (name, address), seed, drop)?;
        }
        for (name, port) in cell.grippers {
            machines.gripper(name, port, world)?;
        }
        for config in &cell.segments {
            machines.on_request.extend(config.on_request().cloned());
            let slaves = machines.slaves(config)?;
            let service = segment(controller, config, slaves)?;
            machines.services.push((config.name.clone(), service));
        }
        let start = cell.segments.iter().find_map(|it| start(&cell.config, it));
        machines.follow_wheels(world, start.unwrap_or_default())?;
        Ok(machines)
    }

    /// The emulated KRCs, by name of the arm.
    pub fn krcs(&self) -> &[(String, Robot)] {
        &self.krcs
    }

    /// The wheels of an emulated base.
    pub fn wheels(&self) -> &[DriveHandle] {
        &self.wheels
    }

    /// Whether a device in that state is as it is to be before any net runs: arms that have power on request have none.
    #[must_use]
    pub fn is_ready(&self, device: &str, status: DeviceStatus) -> bool {
        let waits = || self.on_request.iter().any(|name| name == device);
        status == DeviceStatus::Operational || (status == DeviceStatus::SafeOperational && waits())
    }

    /// The motors of an emulated test station.
    pub const fn station(&self) -> Option<&Station> {
        self.station.as_ref()
    }

    fn arm(
        &mut self,
        cell: &CellConfig,
        world: Option<&CellWorld>,
        (name, address): (String, SocketAddr),
        seed: u64,
        drop: f64,
    ) -> Result<(), Error> {
        let failed = |error| Error::emulator(&name, error);
        let sensing = world.map(|world| world.sensing).unwrap_or_default();
        let mounted = world.and_then(|world| world.arm(&name));
        let periphery = world
            .map(|world| world.periphery(&name))
            .unwrap_or_default();
        if cell.of_kind::<IiwaConfig>().any(|iiwa| iiwa.name == name) {
            let config = CabinetConfig::default();
            let config = CabinetConfig {
                timing: tolerant_timing(),
                program: holding_program(takt_fri::sunrise::emulator::Overlay::default()),
                seed,
                sensing,
                ..config
            };
            let cabinet = |start| {
                let mut cabinet = Cabinet::new(config, start);
                if let Some(mounted) = mounted {
                    cabinet.set_surroundings(Box::new(mounted));
                }
                cabinet
            };
            let link = local(address).map_err(failed)?;
            let robot = Robot::launch(&format!("cabinet-{name}"), link, cabinet).map_err(failed)?;
            self.cabinets.push((name, robot));
            return Ok(());
        }
        let mut config = resting(cell.controller.period.max(LWR_PERIOD));
        if let Some(table) = contact(cell, TABLE).filter(|_| mounted.is_none()) {
            config.contact = Some(table);
            config.contact_off = Some(TABLE_OFF);
        }
        let mut tools = cell.frames.tools.iter();
        if let Some(tool) = tools.find(|tool| tool.device == name) {
            config.tool_m = tool.placement().frame().translation.vector.into();
        }
        let lwr = cell.of_kind::<LwrConfig>().find(|lwr| lwr.name == name);
        if let Some(handshake) = lwr.and_then(|lwr| lwr.handshake) {
            config.script = Script::Handshake(handshake);
        }
        config.seed = seed;
        config.sensing = sensing;
        config.faults.to_client.drop = drop;
        config.faults.to_krc.drop = drop;
        let krc = |start| {
            let mut krc = Krc::new(config, start);
            if let Some(mounted) = mounted {
                krc.set_surroundings(Box::new(mounted));
            }
            for device in periphery {
                krc.add_periphery(device);
            }
            krc
        };
        let link = local(address).map_err(failed)?;
        let robot = Robot::launch(&format!("krc-{name}"), link, krc).map_err(failed)?;
        self.krcs.push((name, robot));
        Ok(())
    }

    fn gripper(
        &mut self,
        name: String,
        mut port: Port,
        world: Option<&CellWorld>,
    ) -> Result<(), Error> {
        let mut gripper = Gripper::new(GripperConfig::default(), Port::now());
        if let Some(pads) = world.and_then(|world| world.pads(&name)) {
            gripper.set_surroundings(pads);
        }
        let thread = serve(&name, move || port.serve(&mut gripper));
        let service = thread.map_err(|error| Error::emulator(&name, error))?;
        self.services.push((name, service));
        Ok(())
    }

    /// Brings the base of the world to where the wheels of the emulated base roll.
    fn follow_wheels(&mut self, world: Option<&CellWorld>, start: [f64; 3]) -> Result<(), Error> {
        let Some(base) = world.and_then(CellWorld::base) else {
            return Ok(());
        };
        let mut wheeled = Wheeled::new(self.wheels.clone(), base, start);
        let thread = serve("world-base", move || {
            wheeled.follow(Port::now());
            takt_rt::sleep_until(takt_rt::monotonic() + WAIT.into()).map_err(io::Error::other)
        });
        let service = thread.map_err(|error| Error::emulator("world-base", error))?;
        self.services.push(("world-base".into(), service));
        Ok(())
    }

    /// The slaves that a segment is configured for.
    fn slaves(&mut self, config: &EthercatConfig) -> Result<Segment, Error> {
        if !config.youbot_bases.is_empty() {
            let (slaves, bot) = YouBot::segment(&YouBotConfig {
                arms: config.youbot_arms.len(),
                ..YouBotConfig::default()
            });
            self.wheels = bot.wheels.into_iter().collect();
            return Ok(slaves);
        }
        if !config.servos.is_empty() {
            let (slaves, station) = Station::segment(StationMotor::three());
            self.station = Some(station);
            return Ok(slaves);
        }
        let mut tx90 = ServoConfig::tx90();
        // A host without PREEMPT_RT sometimes misses SYNC0, which must not end a motion.
        for axis in &mut tx90.axes {
            axis.quirks.missing_set_points = None;
        }
        let drives = ServoDrive::slave(tx90);
        let (drives, _) = drives.map_err(|error| Error::emulator(&config.name, error))?;
        Ok(Segment::line([Coupler::slave(), drives]))
    }

    /// Ends all of them.
    ///
    /// # Errors
    /// If one had failed; the others are ended nevertheless.
    pub fn stop(self) -> Result<(), Error> {
        let mut ends: Vec<(String, io::Result<()>)> = Vec::new();
        for (name, robot) in self.krcs {
            ends.push((name, robot.stop().map(drop)));
        }
        for (name, robot) in self.cabinets {
            ends.push((name, robot.stop().map(drop)));
        }
        for (name, service) in self.services {
            let ended = service.stop();
            let panicked = |_| Err(io::Error::other("it ended by a panic"));
            ends.push((name, ended.unwrap_or_else(panicked)));
        }
        let failed = ends
            .into_iter()
            .find_map(|(name, ended)| ended.err().map(|error| Error::emulator(name, error)));
        failed.map_or(Ok(()), Err)
    }
}

/// Where the base of a segment stands first: x and y, m, and heading, rad.
fn start(cell: &CellConfig, segment: &EthercatConfig) -> Option<[f64; 3]> {
    let base = segment.youbot_bases.first()?;
    let mut bases = cell.frames.bases.iter();
    let placed = bases.find(|it| it.device == base.name)?.placement().frame();
    let (_, _, heading) = placed.rotation.euler_angles();
    Some([placed.translation.x, placed.translation.y, heading])
}

/// What an emulated arm touches: the plane z = 0 of a frame of the cell, which is placed in the base of the arm, or in the world if
/// that is the base.
fn contact(cell: &CellConfig, name: &str) -> Option<Contact> {
    let frames = &cell.frames.frames;
    let table = frames.iter().find(|frame| frame.name == name)?;
    let frame = table.placement().frame();
    let [_, _, normal]: [[f64; 3]; 3] = (*frame.rotation.to_rotation_matrix().matrix()).into();
    Some(Contact {
        shape: Shape::Wall,
        point: frame.translation.vector.into(),
        normal,
        stiffness: TABLE_STIFFNESS,
        damping: TABLE_DAMPING,
    })
}

/// Serves a device in turns, each of which waits briefly for input.
fn serve(
    name: &str,
    mut turn: impl FnMut() -> io::Result<()> + Send + 'static,
) -> io::Result<Service> {
    let config = ThreadConfig {
        priority: Some(PRIORITY),
        ..ThreadConfig::new(name)
    };
    Stoppable::spawn(config, move |stop| {
        while !stop.load(Ordering::Relaxed) {
            turn()?;
        }
        Ok(())
    })
}

/// Serves a segment inside of this process, and gives it to the controller.
fn segment(
    controller: &Controller,
    config: &EthercatConfig,
    slaves: Segment,
) -> Result<Service, Error> {
    let (near, far) = cable();
    // An emulated segment that stalls puts its devices into fault, as one without power does.
    let (mut stalls, stood_still) = stalls();
    controller.watch_stalls(&format!("emulated {}", config.name), stood_still);
    let mut last = takt_rt::monotonic();
    let mut server = Server::new(SharedSegment::new(slaves), far);
    let service = serve(&config.name, move || {
        let turn = server.turn(WAIT, &mut monotonic);
        let now = takt_rt::monotonic();
        let took = now - std::mem::replace(&mut last, now);
        if took > STALL {
            stalls.note(now, took);
        }
        turn.map(|_| ())
            .map_err(|error| io::Error::other(format!("the cable failed: {error}")))
    });
    let service = service.map_err(|error| Error::emulator(&config.name, error))?;
    let wire = Wire {
        link: Box::new(near),
        source: MASTER,
    };
    let devices = ethercat::describe(config);
    controller.add_driver(&config.name, devices, config.thread, |ends| {
        Ok(Box::new(Ethercat::start(config, wire, ends)?))
    })?;
    Ok(service)
}
